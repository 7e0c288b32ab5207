"""The program ``propwash``: the console script of the package, and ``python -m propwash``."""

from __future__ import annotations

import signal
import sys
import threading

from ._native import run_program


def main() -> int:
    """Runs the command line of this process; returns the exit code: 0 fine, 1 a check found a problem, 2 error."""
    if sys.argv[1:2] == ["evaluate"]:
        # The one command that flies policies, and so needs Python.
        from .policies._command import evaluate

        return evaluate(sys.argv[2:])
    # Python's own handler waits for the compiled code to return; the system's ends the program at once. Who started the program with the
    # signal ignored, as shells do in the background, has it ignored.
    own = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    own = own and threading.current_thread() is threading.main_thread()
    words, film = _without_video(sys.argv[1:])
    if film is not None and (fault := _fault_of(film)) is not None:
        print(f"error: {fault}", file=sys.stderr)
        return 2
    if own:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    code = run_program(words, [sys.executable, "-m", "propwash"])
    if film is None or code != 0:
        return code
    if own:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return _film(_value(words, "--out"), film, "--json" in words)


def _value(words: list[str], flag: str) -> str | None:
    """What a flag of the command line says; the last one, as the program takes it."""
    for k in range(len(words) - 1, -1, -1):
        if words[k] == flag and k + 1 < len(words):
            return words[k + 1]
        if words[k].startswith(f"{flag}="):
            return words[k].split("=", 1)[1]
    return None


def _without_video(words: list[str]) -> tuple[list[str], str | None]:
    """The command line without ``--video FILE``, which the compiled program cannot make, and the file; of ``fly`` alone."""
    if next((w for w in words if not w.startswith("-")), None) != "fly" or {"-h", "--help"} & set(words):
        return words, None
    out: list[str] = []
    file = None
    rest = iter(words)
    for word in rest:
        if word.startswith("--video="):
            file = word.split("=", 1)[1]
        elif word == "--video":
            file = next(rest, None)
            if file is None:
                return words, None  # the program says what is missing
        else:
            out.append(word)
    return out, file


def _fault_of(film: str) -> str | None:
    """Why a video cannot be made, told before the flight."""
    from . import _video

    try:
        _video.check(film)
    except (ImportError, OSError, RuntimeError, ValueError) as e:
        return str(e)
    return None


def _film(folder: str | None, film: str, json: bool) -> int:
    """Makes the video of the data set that was flown, and says so where the program does, or beside its JSON."""
    from . import _video

    if folder is None:  # the program does not fly without it
        return 0
    try:
        print(f"video     {_video.video(folder, film)}", file=sys.stderr if json else sys.stdout)
    except (ImportError, OSError, RuntimeError, ValueError) as e:
        print(f"error: {e}; the data set in {folder} is whole", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
