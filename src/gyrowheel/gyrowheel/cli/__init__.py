"""The `gyrowheel` command. Each module holds the verbs of one subject; heavy imports happen inside the verbs."""

from __future__ import annotations

import gc
import io
import signal
import sys
from types import FrameType

from gyrowheel.cli.app import app
from gyrowheel.cli.shell import run

__all__ = ["app", "main"]


def main() -> None:
    """Run the command line and end the process with its exit code."""
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, _terminate)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that has no ± gets a question mark
            stream.reconfigure(errors="replace")
    code = run(app)
    # what is left goes with the process; looking through it for garbage first takes a tenth of a short verb
    gc.freeze()
    sys.exit(code)


def _terminate(number: int, frame: FrameType | None) -> None:
    # unwinds, so that nothing half-written and no child process stays behind
    raise SystemExit(128 + number)
