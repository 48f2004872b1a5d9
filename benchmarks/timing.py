"""Timing of contestants by turns, so that what else the machine does falls on all of them; time of other processes."""

from __future__ import annotations

import gc
import os
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Timing:
    """Times of one contestant, one entry a call.

    Attributes
    ----------
    cpu : tuple of float
        Time of the processor [s]: on a machine that does nothing else, the time by the clock.
    wall : tuple of float
        Time by the clock [s].
    """

    cpu: tuple[float, ...]
    wall: tuple[float, ...]

    @property
    def best(self) -> float:
        """The shortest time of the processor [s]: what the work takes when nothing else disturbs it."""
        return min(self.cpu)

    @property
    def median(self) -> float:
        """The median time of the processor [s]."""
        return statistics.median(self.cpu)

    @property
    def clock(self) -> float:
        """The shortest time by the clock [s]."""
        return min(self.wall)


def by_turns(
    contestants: Mapping[str, Callable[[], object]],
    rounds: int,
    *,
    turn_s: float = 0.05,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Timing]:
    """Run every contestant in every round and return their times; one round before the first is not counted.

    Parameters
    ----------
    contestants : mapping of str to callable
        What to run; each prepares what it needs beforehand, so that a call is the work alone.
    rounds : int
        How many rounds.
    turn_s : float
        How long a contestant's turn lasts at least [s]: what is quick is called several times.
    progress : callable, optional
        Called after every round with the fraction done.
    """
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in contestants}
    gc.collect()
    gc.disable()
    try:
        for turn in range(rounds + 1):
            for name, run in contestants.items():
                start = time.perf_counter()
                while True:
                    begin = time.process_time(), time.perf_counter()
                    run()
                    end = time.process_time(), time.perf_counter()
                    if turn:
                        times[name].append((end[0] - begin[0], end[1] - begin[1]))
                    if end[1] - start >= turn_s:
                        break
            if progress is not None:
                progress((turn + 1) / (rounds + 1))
    finally:
        gc.enable()
    return {name: Timing(*zip(*calls, strict=True)) for name, calls in times.items()}


def processor_time(pid: int) -> float:
    """Return the time of the processor that a process has taken [s]; NaN where the system does not tell."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def stolen_time() -> float:
    """Return how long the host of a virtual machine has kept its processors to itself so far, all together [s].

    Zero where the system does not tell.
    """
    try:
        first = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()
        return float(first[8]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0
