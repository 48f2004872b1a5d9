"""ROS domains for the tests that start nodes: each has one of its own, so that they may run beside each other."""

from __future__ import annotations

import fcntl
import itertools
import os
import tempfile
from pathlib import Path

_numbers = itertools.count()
_held: set[int] = set()


def next_domain() -> int:
    """Return a ROS domain that no other test uses, of this run or of another one on this computer.

    A file that stays locked until this process ends keeps it.
    """
    for _ in range(80):
        domain = 20 + (7 * os.getpid() + next(_numbers)) % 80
        if domain in _held:  # by a test of this run that ended long ago
            return domain
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
            _held.add(domain)
            return domain
    raise RuntimeError("every ROS domain is in use")
