"""The processes of the nodes."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gyrowheel_bringup.graph.shared_memory import used_by
from gyrowheel_core.node import TORN


@dataclass
class Child:
    """A node's process."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path
    expected: bool = False  # whether it was asked to end
    shown: int = 0  # bytes of its log that were shown so far
    memory: set[str] = field(default_factory=set)  # shared memory that it was found to use

    def note_memory(self) -> None:
        """Note which shared memory of the middleware the process uses, to remove it if it is killed."""
        self.memory |= used_by(self.process.pid)

    def show_log(self) -> None:
        """Copy to stderr what the process has written since the last call."""
        with contextlib.suppress(OSError), self.log.open("rb") as log:
            log.seek(self.shown)
            new = log.read()
            self.shown += len(new)
            sys.stderr.write(new.decode("utf-8", errors="replace"))

    @property
    def last_words(self) -> str:
        """The last lines that the process wrote to stderr."""
        with contextlib.suppress(OSError):
            return self.log.read_text(encoding="utf-8", errors="replace")[-4000:].strip()
        return ""

    @property
    def ended_well(self) -> bool:
        """Whether the process ended well; until a node handles signals, SIGINT ends it."""
        code = self.process.returncode
        return code == 0 or (self.expected and (code == -signal.SIGINT or code in TORN))

    @property
    def ending(self) -> str:
        """How the process ended, in words."""
        code = self.process.returncode
        if code is not None and code < 0:
            return f"killed by {signal.Signals(-code).name}"
        if code == 0:
            return "was shut down while the bench ran"
        return f"exit code {code}"


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Block every signal except SIGKILL; only the main thread gets signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {n: signal.signal(n, signal.SIG_IGN) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
