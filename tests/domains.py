"""ROS domains for the tests that start nodes: each has one of its own, so that they may run beside each other."""

from __future__ import annotations

import fcntl
import itertools
import os
import tempfile
from pathlib import Path

_numbers = itertools.count()
_held: list[int] = []  # the one that was given longest ago first
_MOST = 16  # of a process: four of them, and another run, find theirs among the 80


def next_domain() -> int:
    """Return a ROS domain that no other test uses, of this run or of another one on this computer.

    A file that stays locked until this process ends keeps it.
    """
    if len(_held) == _MOST:  # the nodes of the test that had it ended long ago
        _held.append(_held.pop(0))
        return _held[-1]
    for _ in range(80):
        domain = 20 + (7 * os.getpid() + next(_numbers)) % 80
        if domain in _held:
            continue
        place = Path(tempfile.gettempdir()) / f"gyrowheel_test_domain_{domain}"
        try:
            handle = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        except PermissionError:  # another user's
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
        else:
            _held.append(domain)
            return domain
    raise RuntimeError("every ROS domain is in use")
