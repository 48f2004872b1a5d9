"""Benches that run a test: the simulated machine of the recordings, or a running graph of this computer."""

from __future__ import annotations

import argparse
import contextlib
import math
import shlex
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gyrowheel.models.api import Model
from gyrowheel.recordings.api import Recording, machine_options, note_machine, noted_machine
from gyrowheel.simulation.api import simulate
from gyrowheel.workbench.setpoints import Allowed, Setpoint
from gyrowheel.workbench.trace import Trace
from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_control.plans.plan import HOLD, Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM

#: Key of a running bench among the recordings: this, and its namespace.
KEY = "live"
_PACE = 0.3  # s between two readings of the messages
_TELL = 1.0  # s between two changes, of which each has every page ask for its state
#: Time between two readings while the signals are watched [s], and between two pieces of the stream.
FRAME = 1.0 / 40.0
_LOOK = 1.0  # s between two searches for benches
_SILENT = 5.0  # s without a message after which a bench counts as stopped
_MOST_HOLDS = 5000
_NEVER = -1  # stamp before the first message


class _Words(argparse.ArgumentParser):
    """Parser of the options of a machine."""

    def error(self, message: str) -> Any:
        raise InputError(f"machine: {message}")


def _reader() -> _Words:
    reader = _Words(add_help=False, allow_abbrev=False)
    reader.add_argument("--effect", action="append")
    for name, kind in (("truth", Path), ("blind", Path), ("machine", int), ("bench", str)):
        reader.add_argument(f"--{name}", type=kind)
    reader.add_argument("--seed", type=int, default=0)
    return reader


@dataclass(frozen=True)
class SimulatedBench:
    """A simulated machine, by its options on the command line."""

    effect: tuple[str, ...] = ()
    truth: Path | None = None
    blind: Path | None = None
    machine: int | None = None
    bench: str | None = None
    seed: int = 0

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> SimulatedBench | None:
        """Return the machine noted in recordings; None without a note, as of a real machine."""
        note = noted_machine(recordings)
        if not note:
            return None
        read = vars(_reader().parse_args(shlex.split(note)))
        return cls(**read | {"effect": tuple(read["effect"] or ())})

    def record(
        self, plan: str, folder: Path, model: Model, number: int, progress: Callable[[float], None]
    ) -> Recording:
        """Run a plan into a new folder; `model` is the one under test, and each `number` has its own noise."""
        made = simulate(
            plan,
            effects=self.effect,
            truth=None if self.truth is None else Model.load(self.truth),
            model=model,
            bench=self.bench,
            machine=self.machine,
            seed=self.seed + number,
            blind=self.blind,
            folder=folder,
            progress=progress,
        )
        note_machine(
            made,
            machine_options(
                effect=self.effect,
                truth=self.truth,
                blind=self.blind,
                machine=self.machine,
                seed=self.seed,
                bench=self.bench,
            ),
        )
        return made


@dataclass(frozen=True)
class Running:
    """A run of the bench, as far as it was received."""

    start_ns: int  # first stamp received [ns]; negative before
    stamp_ns: int  # latest stamp [ns]
    #: Setpoint of the plan: segment, phase, tilt about x and y [rad], spin rate [rad/s]; empty if not received.
    asked: tuple[float, ...] = ()
    holds: tuple[Estimate, ...] = ()  # its settled holds, from the drag estimator of the graph
    silent: bool = False  # whether messages have stopped
    allowed: Allowed | None = None  # range of its setpoints by its description, once that was received
    namespace: str = ""  # its namespace; empty for the root

    @property
    def title(self) -> str:
        """Its name on the page."""
        return f"running bench {self.namespace}".rstrip()

    def words(self) -> str:
        """Return its state in a line."""
        if self.stamp_ns < 0:
            return "stopped" if self.silent else "running; no plan yet"
        text = f"{(self.stamp_ns - self.start_ns) / wire.SECOND:.0f} s received, {len(self.holds)} holds"
        if self.silent:
            return f"{text}; no more messages"
        if self.asked:
            segment, phase, x, y, spin = self.asked
            kind = "hold" if phase == HOLD else "ramp"
            text += (
                f"; segment {segment:.0f}, {kind}: tilt {x / DEG:.1f}, {y / DEG:.1f} °, {spin / RPM:.0f} rpm"
            )
        return text


class LiveBenches:
    """Listens to the running benches in a thread, during a block, and calls `changed` after every message.

    Nothing is sent to them unless a test is requested. Without ROS it receives nothing; `missing` gives the reason.
    """

    def __init__(self, changed: Callable[[], None], domain: int | None = None) -> None:
        self._changed, self._domain = changed, domain
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._heard: dict[str, float] = {}
        self._runs: dict[str, Running] = {}
        self._traces: dict[str, Trace] = {}
        self._watched = Counter[str]()
        self._lock = threading.Lock()
        self.missing = ""

    @property
    def runs(self) -> Mapping[str, Running]:
        """The running benches by their keys, in the order of the namespaces."""
        return {f"{KEY}{name}": own for name, own in sorted(self._runs.copy().items())}

    def __enter__(self) -> LiveBenches:
        """Begin to listen."""
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stop listening; the benches go on."""
        self._end.set()
        self._thread.join(10.0)

    @contextlib.contextmanager
    def watching(self, key: str) -> Iterator[Trace]:
        """Receive the signals of a running bench during a block; InputError if it does not run.

        Without a watcher they are not received: that costs the bench nothing.
        """
        if key not in self.runs:
            raise InputError(f"bench {key[:60]!r}: does not run")
        namespace = key.removeprefix(KEY)
        with self._lock:
            self._watched[namespace] += 1
            trace = self._traces.setdefault(namespace, Trace())
        try:
            yield trace
        finally:
            with self._lock:
                self._watched[namespace] -= 1
                if not self._watched[namespace]:
                    del self._watched[namespace], self._traces[namespace]

    def setpoint_of(self, key: str) -> Setpoint:
        """Return the setpoint of a running bench: the last one published, or else its state, if that is received.

        InputError if neither is known.
        """
        own = self.runs.get(key)
        if own is not None and own.asked:
            _, _, x, y, spin = own.asked
            return Setpoint(x / DEG, y / DEG, spin / RPM)
        trace = self._traces.get(key.removeprefix(KEY))
        latest = None if trace is None else trace.latest()
        if latest is None:
            raise InputError(f"bench {key[:60]!r}: neither a setpoint nor a sample of it was received yet")
        return Setpoint(*latest)

    def walk(
        self,
        key: str,
        plan: str,
        folder: Path | None,
        progress: Callable[[float], None],
        ended: Callable[[], bool],
    ) -> bool:
        """Have a running bench run a plan; return whether the plan was finished.

        `plan` is a name or the text of a plan, and `folder` a new one for its recording; None: it is not recorded.
        `ended` is polled: whether the bench is to stop the plan. InputError if the bench does not run or answer, or
        refuses or aborts the plan.
        """
        own = self.runs.get(key)
        if own is None or own.silent:
            raise InputError(f"bench {key[:60]!r}: does not run")
        try:
            from gyrowheel.graph.api import GraphError, run_and_record
        except ImportError as error:
            raise InputError(f"ROS is not installed here ({error})") from None
        try:
            return run_and_record(
                Plan.load(plan),
                folder,
                namespace=own.namespace,
                domain=self._domain,
                progress=lambda now: progress(now.elapsed / now.duration),
                ended=ended,
            )
        except GraphError as error:
            raise InputError(f"{own.title}: {error}") from None

    def _listen(self) -> None:
        try:
            from gyrowheel_bringup.graph.local_node import listening
        except ImportError as error:
            self.missing = f"ROS is not installed here ({error})"
            return
        takers = {
            topics.SETPOINT: self._take_setpoint,
            topics.DRAG_ESTIMATE: self._take_estimate,
            topics.BENCH: self._take_description,
        }
        with listening("workbench", tuple(takers), self._domain) as ear:
            looked, told, there = -math.inf, -math.inf, set[str]()
            before: dict[str, Running] = {}
            while not self._end.wait(FRAME if self._watched else _PACE):
                now = time.monotonic()
                with self._lock:
                    traces = self._traces.copy()
                ear.follow(topics.MEASUREMENT, traces.keys())
                if now - looked > _LOOK:
                    there, looked = ear.look(), now
                    for namespace in there - self._runs.keys():
                        self._runs[namespace] = Running(_NEVER, _NEVER, namespace=namespace)
                samples = defaultdict[str, list[bytes]](list)
                for namespace, topic, data in ear.messages():
                    self._heard[namespace] = now
                    if topic is topics.MEASUREMENT:
                        samples[namespace].append(data)
                    else:
                        takers[topic](namespace, data)
                for namespace, some in samples.items():
                    if (trace := traces.get(namespace)) is not None:
                        trace.take(some)
                for namespace, own in self._runs.items():
                    quiet = now - self._heard.get(namespace, -math.inf) > _SILENT
                    silent = quiet and namespace not in there
                    self._runs[namespace] = replace(own, silent=silent)
                if now - told >= _TELL and self._runs != before:
                    before, told = self._runs.copy(), now
                    self._changed()

    def _take_setpoint(self, namespace: str, data: bytes) -> None:
        try:
            stamp, segment, phase, *values = wire.SETPOINT.unpack(data)
        except ValueError:  # a message of another program
            return
        x, y, _, _, spin, _ = values
        self._runs[namespace] = replace(self._at(namespace, stamp), asked=(segment, phase, x, y, spin))
        if (trace := self._traces.get(namespace)) is not None:
            trace.set(stamp, x, y, spin)

    def _take_estimate(self, namespace: str, data: bytes) -> None:
        try:
            estimate = Estimate.from_bytes(data)
        except ValueError:
            return
        if estimate.settled:
            own = self._at(namespace, estimate.stamp_ns, late=True)
            if own.holds and own.holds[-1].stamp_ns == estimate.stamp_ns:  # a repetition
                return
            self._runs[namespace] = replace(own, holds=(*own.holds, estimate)[-_MOST_HOLDS:])

    def _take_description(self, namespace: str, data: bytes) -> None:
        with contextlib.suppress(ValueError):
            own = self._runs.get(namespace) or Running(_NEVER, _NEVER, namespace=namespace)
            self._runs[namespace] = replace(own, allowed=Allowed.described(wire.unpack_text(data)))

    def _at(self, namespace: str, stamp: int, *, late: bool = False) -> Running:
        """Return the run at a time; a setpoint before the last one begins another run, an estimate may come late."""
        own = self._runs.get(namespace)
        if own is None or own.stamp_ns < 0 or (stamp < own.stamp_ns and not late):
            return Running(stamp, stamp, namespace=namespace, allowed=None if own is None else own.allowed)
        return replace(own, start_ns=min(own.start_ns, stamp), stamp_ns=max(own.stamp_ns, stamp))
