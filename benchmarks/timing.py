"""Timing of contestants by turns, so that other load affects all of them equally; time of other processes."""

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
    """Times of one contestant, one entry per call.

    Attributes
    ----------
    cpu : tuple of float
        Processor time [s]: on an idle machine equal to the wall-clock time.
    wall : tuple of float
        Wall-clock time [s].
    """

    cpu: tuple[float, ...]
    wall: tuple[float, ...]

    @property
    def best(self) -> float:
        """The shortest processor time [s]: that of the undisturbed work."""
        return min(self.cpu)

    @property
    def median(self) -> float:
        """The median processor time [s]."""
        return statistics.median(self.cpu)

    @property
    def clock(self) -> float:
        """The shortest wall-clock time [s]."""
        return min(self.wall)


def by_turns(
    contestants: Mapping[str, Callable[[], object]],
    rounds: int,
    *,
    turn_s: float = 0.05,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Timing]:
    """Run every contestant in every round and return their times; a first warm-up round is not counted.

    Parameters
    ----------
    contestants : mapping of str to callable
        Functions to run; preparation is done beforehand, so that a call is the work alone.
    rounds : int
        Number of rounds.
    turn_s : float
        Minimum duration of a contestant's turn [s]: a fast function is called several times.
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
    """Return the processor time of a process [s]; NaN if the system does not report it."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def stolen_time() -> float:
    """Return the total time that the host has withheld the processors of a virtual machine so far (steal time) [s].

    Zero if the system does not report it.
    """
    try:
        first = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()
        return float(first[8]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0
