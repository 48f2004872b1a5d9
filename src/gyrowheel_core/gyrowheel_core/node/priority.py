"""Real-time priority of a process, for nodes that keep pace with wall-clock time."""

from __future__ import annotations

import os
from pathlib import Path

from gyrowheel_core.node.parameters import Param

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

    Parameters
    ----------
    level : int
        Priority, 1 .. 99; 0 changes nothing.
    """
    if level == 0:
        return True
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(level))
    except OSError:
        return False
    return True
