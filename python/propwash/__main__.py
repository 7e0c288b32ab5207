"""The program ``propwash``: the console script of the package, and ``python -m propwash``."""

from __future__ import annotations

import signal
import sys
import threading

from ._native import run_program


def main() -> int:
    """Runs the command line of this process; returns the exit code: 0 fine, 1 a check found a problem, 2 error."""
    if threading.current_thread() is threading.main_thread():
        # Python's own handler waits for the compiled code to return; the system's ends the program at once.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return run_program(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
