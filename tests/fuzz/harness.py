"""One input after the other, each under a limit of time and memory, and what became of them.

Allowed is an answer that is right, or one error of the user in one line. Everything else is a failure: another
exception, more than `PATIENCE` of the processor or `WAIT` of the clock, more than `MEMORY`, or a wrong answer.
"""

from __future__ import annotations

import contextlib
import os
import random
import re
import resource
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import NamedTuple, Protocol

import psutil

from gyrowheel_core.errors import InputError

#: Time of the processor after which an input is said to hang [s].
PATIENCE = 10.0
#: The same by the clock, for what waits and does not work [s]; long, since others may have the processor.
WAIT = 60.0
#: The same with that of the processes that it starts, which have limits of their own [s].
APART = 30.0
#: Memory that one input may add to the process, and that each process it starts may take [bytes].
MEMORY = 2 << 30


class WrongAnswer(Exception):
    """What came out is not what went in, and nothing says so."""


class Hang(BaseException):
    """An input took too long; no reader can catch it by mistake."""


class Case(NamedTuple):
    """One input.

    Attributes
    ----------
    name : str
        What it was made of.
    data : bytes
        The input.
    use : callable
        Uses an input as the program would, and returns what became of it in a word; raises `WrongAnswer`.
    """

    name: str
    data: bytes
    use: Callable[[bytes], str]


class Kind(Protocol):
    """A kind of input: makes cases without end, in a folder of its own."""

    def __call__(self, rng: random.Random, folder: Path) -> Iterator[Case]:
        """Make cases."""


@dataclass
class Failure:
    """An input with which something went wrong.

    Attributes
    ----------
    what : str
        ``traceback``, ``hang``, ``memory`` or ``wrong``.
    case : Case
        The input.
    said : str
        What happened, in a line.
    """

    what: str
    case: Case
    said: str

    @property
    def kind(self) -> tuple[str, str]:
        """What failures have in common that have one cause: what is said but for numbers."""
        return self.what, re.sub(r"\w*\d\w*", "#", self.said)

    def __str__(self) -> str:
        """Return it in one line."""
        return f"{self.what}: {self.case.name}: {self.said}"[:400]


@dataclass
class Tally:
    """What became of the inputs of one kind.

    Attributes
    ----------
    outcomes : Counter of str
        How many were ``refused``, ``failed``, or what their use said of them.
    failures : list of Failure
        Those that failed; of failures that say the same the first one.
    longest : float
        Longest time of the processor for one input, in this process and those that it started [s].
    largest : int
        Most memory that one of these processes had [bytes].
    interrupted : bool
        Whether Ctrl-C ended it; what was tried until then counts.
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: list[Failure] = field(default_factory=list)
    longest: float = 0.0
    largest: int = 0
    interrupted: bool = False

    @property
    def count(self) -> int:
        """Number of inputs."""
        return sum(self.outcomes.values())

    def take(self, case: Case) -> None:
        """Try one input."""
        begin = _processor()
        outcome, failure = tried(case)
        self.longest = max(self.longest, _processor() - begin)
        whose = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
        self.largest = max(self.largest, *(resource.getrusage(own).ru_maxrss * 1024 for own in whose))
        self.outcomes[outcome] += 1
        if failure is not None and failure.kind not in {known.kind for known in self.failures}:
            self.failures.append(failure)


def _processor() -> float:
    """Return the time of the processor that this process and those that it started have taken [s]."""
    return sum(os.times()[:4])


def tried(case: Case) -> tuple[str, Failure | None]:
    """Try one input; return what became of it, and what went wrong."""

    def failed(what: str, said: str) -> tuple[str, Failure]:
        return "failed", Failure(what, case, said)

    begin = _processor()
    try:
        with _limits():
            outcome = case.use(case.data)
        if _processor() - begin > APART:
            return failed("hang", f"more than {APART:g} s, with the processes that it started")
        return outcome, None
    except InputError as error:
        text = str(error)
        if not text or not text.isprintable():
            return failed("wrong", f"the error is not one line of text: {text[:80]!r}")
        return "refused", None
    except Hang:
        return failed("hang", f"more than {PATIENCE:g} s")
    except WrongAnswer as error:
        return failed("wrong", str(error))
    except MemoryError:
        return failed("memory", f"more than {MEMORY >> 30} GiB")
    except Exception as error:
        return failed("traceback", f"{type(error).__name__}: {' '.join(str(error).split())[:160]}")


@contextlib.contextmanager
def _limits() -> Iterator[None]:
    """Raise `Hang` after `PATIENCE` or `WAIT`, and MemoryError beyond `MEMORY`."""

    def give_up(number: int, frame: FrameType | None) -> None:
        raise Hang

    before = {number: signal.signal(number, give_up) for number in (signal.SIGPROF, signal.SIGALRM)}
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + MEMORY, hard))
    _set_timers(PATIENCE, WAIT)
    try:
        yield
    finally:
        _set_timers(0.0, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _set_timers(processor: float, clock: float) -> None:
    signal.setitimer(signal.ITIMER_PROF, processor)
    signal.setitimer(signal.ITIMER_REAL, clock)


def begin_again(times: float = 1.0) -> None:
    """Give what follows the whole time of an input, or some times as much.

    For a use that does its work a second time, to compare, and for one that is known to be long.
    """
    if signal.getitimer(signal.ITIMER_REAL)[0] > 0.0:
        _set_timers(times * PATIENCE, times * WAIT)


def smallest(failure: Failure, seconds: float = 20.0) -> bytes:
    """Return the smallest input found within a time with which the same goes wrong, by leaving out parts."""
    data, end = failure.case.data, time.monotonic() + seconds

    def same(tried_data: bytes) -> bool:
        _, found = tried(failure.case._replace(data=tried_data))
        return found is not None and found.what == failure.what

    size = max(len(data) // 2, 1)
    while size and time.monotonic() < end:
        place, shorter = 0, False
        while place < len(data) and time.monotonic() < end:
            less = data[:place] + data[place + size :]
            if same(less):
                data, shorter = less, True
            else:
                place += size
        if not shorter or size > len(data):
            size //= 2
    return data


def run(kind: Kind, seed: int, folder: Path, *, count: int = 0, seconds: float = 0.0) -> Tally:
    """Try inputs of one kind: `count` of them, or as many as fit into a time.

    Parameters
    ----------
    kind : Kind
        The kind.
    seed : int
        Of what is drawn at random.
    folder : Path
        To work in.
    count : int
        How many; 0: no limit.
    seconds : float
        For how long [s]; 0: no limit.
    """
    tally = Tally()
    end = time.monotonic() + seconds
    folder.mkdir(parents=True, exist_ok=True)
    try:
        for number, case in enumerate(kind(random.Random(seed), folder)):
            if (count and number >= count) or (seconds and time.monotonic() > end):
                break
            tally.take(case)
    except KeyboardInterrupt:
        tally.interrupted = True
    return tally
