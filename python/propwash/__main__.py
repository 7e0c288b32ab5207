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
    if own and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return run_program(sys.argv[1:], [sys.executable, "-m", "propwash"])


if __name__ == "__main__":
    sys.exit(main())
