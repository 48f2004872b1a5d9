"""The `gyrowheel` command. Each module holds the verbs of one subject; heavy imports happen inside the verbs."""

from __future__ import annotations

import sys

from gyrowheel_bringup.cli.app import app
from gyrowheel_bringup.cli.shell import run

__all__ = ["app", "main"]


def main() -> None:
    """Run the command line and end the process with its exit code."""
    sys.exit(run(app))
