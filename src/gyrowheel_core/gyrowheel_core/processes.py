"""Child processes that end with their parent."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal

_PR_SET_PDEATHSIG = 1


def die_with_parent() -> None:
    """Have the kernel end this process when its parent ends, also when that is killed (Linux)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def end_with(parent: int) -> None:
    """End this process with the one that started it, also if that has ended already.

    Parameters
    ----------
    parent : int
        Id of the process that started it; the own id changes nothing.
    """
    if os.getpid() == parent:
        return
    die_with_parent()
    if os.getppid() != parent:
        os._exit(1)


def hindrance() -> str:
    """Return why several processes cannot work together here; empty if they can.

    They need semaphores, which Linux keeps in ``/dev/shm``: in a container it may be missing, full or read-only.
    """
    from multiprocessing import get_context

    try:
        get_context("spawn").Lock()
    except (OSError, ImportError) as error:
        return f"no semaphore can be made in /dev/shm: {getattr(error, 'strerror', None) or error}"
    return ""
