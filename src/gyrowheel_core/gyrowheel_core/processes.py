"""Processes that others start."""

from __future__ import annotations

import contextlib
import ctypes
import signal

_PR_SET_PDEATHSIG = 1


def die_with_parent() -> None:
    """Have the kernel end this process when its parent ends: one that is killed can end nothing any more (Linux)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def hindrance() -> str:
    """Return why several processes cannot work together here; empty where they can.

    They need semaphores, which Linux keeps in ``/dev/shm``: in a container it may be missing, full or read-only.
    """
    from multiprocessing import get_context

    try:
        get_context("spawn").Lock()
    except (OSError, ImportError) as error:
        return f"no semaphore can be made in /dev/shm: {getattr(error, 'strerror', None) or error}"
    return ""
