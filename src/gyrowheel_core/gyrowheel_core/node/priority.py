"""Real-time priority and memory of a process, for nodes that keep pace with wall-clock time."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
from pathlib import Path
from typing import Final

from rclpy.node import Node

from gyrowheel_core.node.parameters import Param

_REFUSED: Final = "not allowed"
#: Of mlockall(2): pages that are there, pages to come, each as it is used. Without the last one every process would
#: take all the memory that its libraries have only reserved.
_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
_CAP_IPC_LOCK = 14
#: For nodes that have to keep pace with wall-clock time.
PRIORITY = Param(
    "priority",
    0,
    "Real-time priority of the process (SCHED_FIFO), where the system allows it; 0: no change",
    low=0,
    high=99,
)


def raise_priority(level: int) -> bool:
    """Give this process a real-time priority (``SCHED_FIFO``); return whether the system allows it.

    `level`: priority, 1 .. 99; 0 changes nothing.
    """
    if level == 0:
        return True
    try:
        for thread in Path("/proc/self/task").iterdir():
            if not _sends_again(thread):
                os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(level))
    except OSError:
        return False
    return True


def _sends_again(thread: Path) -> bool:
    """Whether a thread of this process is that of Fast DDS that repeats messages to a reader.

    It does not rest until the reader has them. With a real-time priority it would block a reader on the same core with
    the same priority or none.
    """
    with contextlib.suppress(OSError):
        return (thread / "comm").read_text(encoding="utf-8", errors="replace").startswith("dds.asyn")
    return False


def lock_memory() -> bool:
    """Keep the memory of this process from being swapped out; return whether the system allows it.

    Only where it allows so without limit: below one, every later allocation might fail.
    """
    unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    if not unlimited and not _has_capability(_CAP_IPC_LOCK):
        return False
    with contextlib.suppress(OSError, AttributeError):  # another C library, or none
        return ctypes.CDLL(None, use_errno=True).mlockall(_CURRENT | _FUTURE | _ON_FAULT) == 0
    return False


def keep_pace(level: int) -> dict[str, str]:
    """Raise the priority and lock the memory as far as the system allows; return the result as values of a status.

    `level`: real-time priority, 1 .. 99; 0 changes nothing.
    """
    if level == 0:
        return {}
    granted = str(level) if raise_priority(level) else f"{_REFUSED}: {level} (ulimit -r, or CAP_SYS_NICE)"
    locked = "yes" if lock_memory() else f"{_REFUSED} (ulimit -l unlimited, or CAP_IPC_LOCK)"
    return {PRIORITY.name: granted, "memory_locked": locked}


def is_refused(values: dict[str, str]) -> bool:
    """Return whether the values of a status report a refused real-time priority."""
    return values.get(PRIORITY.name, "").startswith(_REFUSED)


def prioritise(node: Node, level: int) -> dict[str, str]:
    """Call `keep_pace` for the process of a node, and log a warning if the system refuses the priority."""
    granted = keep_pace(level)
    if is_refused(granted):
        node.get_logger().warning(f"real-time priority {granted[PRIORITY.name]}")
    return granted


def _has_capability(number: int) -> bool:
    with contextlib.suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
        held = int(next(line.split()[1] for line in lines if line.startswith("CapEff:")), 16)
        return bool(held >> number & 1)
    return False
