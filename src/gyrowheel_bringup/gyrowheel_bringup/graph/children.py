"""The processes of the nodes, and the removal of what killed ones leave behind."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

_SHARED = Path("/dev/shm")
_LOCKS = ("_el", "_sl")  # held by the one process that reads, and by those that share a port


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
        """Note which shared memory of the middleware the process uses, for `remove_left` if it is killed."""
        process = Path(f"/proc/{self.process.pid}")
        with contextlib.suppress(OSError):
            lines = (process / "maps").read_text(encoding="utf-8", errors="replace").splitlines()
            found = {line.rpartition("/")[2] for line in lines if f"{_SHARED}/fastrtps_" in line}
            self.memory |= {name.removesuffix(" (deleted)") for name in found}

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
        return code == 0 or (self.expected and code == -signal.SIGINT)

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


def remove_left(names: Collection[str]) -> None:
    """Remove shared memory of Fast DDS that no process holds any longer.

    A process that is killed leaves its segments behind, and the ports that it listened to: megabytes that stay until
    the computer is restarted. Whoever uses one holds a lock on a file beside it, which ends with the process.

    Parameters
    ----------
    names : collection of str
        Files below ``/dev/shm``; those in use or already gone are left alone.
    """
    for name in names:
        if any(_is_locked(_SHARED / f"{name}{suffix}") for suffix in _LOCKS):
            continue
        for file in (name, *(f"{name}{suffix}" for suffix in _LOCKS), f"sem.{name}_mutex"):
            with contextlib.suppress(OSError):
                (_SHARED / file).unlink(missing_ok=True)


def _is_locked(path: Path) -> bool:
    try:
        handle = os.open(path, os.O_RDWR)
    except OSError as error:
        return not isinstance(error, FileNotFoundError)  # belongs to another user
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False
