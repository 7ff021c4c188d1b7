"""The program ``guide``, as the wheel installs it."""

from __future__ import annotations

import signal
import sys

from . import _core


def main() -> int:
    """Runs ``guide`` with the arguments of this process; returns its exit code."""
    # Ctrl-C is the program's own affair: it stops the guide and keeps what was recorded.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _core.program(["guide", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
