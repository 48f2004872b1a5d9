"""Work that is killed at random instants."""

from __future__ import annotations

import math
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest


def killed(work: Callable[[], object], after: float, since: Callable[[], bool] = lambda: True) -> bool:
    """Do some work in a process that is killed a while [s] after something holds; return whether it ended before."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work()
            code = 0
        finally:
            os._exit(code)
    end = math.inf
    while time.monotonic() < end:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            assert os.waitstatus_to_exitcode(status) == 0
            return True
        if end == math.inf and since():
            end = time.monotonic() + after
        time.sleep(0.001)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status) == 0


def until_done(
    work: Callable[[], object], begun: Path, finished: Path, seed: int, longest: float
) -> Iterator[None]:
    """Do some work again and again; yield after each kill, at an instant at random, until it ends.

    The last of the three kinds of instants makes sure that it ends on any machine.

    Parameters
    ----------
    work : callable
        Goes on where it was.
    begun : Path
        File that grows as parts of the work begin.
    finished : Path
        Folder that gets a file for each part that is finished.
    seed : int
        Seed of the instants.
    longest : float
        Longest time until a kill [s]: in turn since the beginning, since a part of the work has begun, and since one
        was finished.
    """
    rng = random.Random(seed)

    def parts() -> tuple[int, int]:
        return begun.stat().st_size if begun.exists() else 0, len(list(finished.glob("[!.]*")))

    for number in range(600):
        kind, before = number % 3, parts()

        def since(kind: int = kind, before: tuple[int, int] = before) -> bool:
            return kind == 0 or parts()[kind - 1] > before[kind - 1]

        if killed(work, rng.uniform(0.0, longest), since):
            return
        yield
    pytest.fail("does not end")
