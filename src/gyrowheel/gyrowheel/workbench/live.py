"""Benches that run on this computer: what the plan asks of them, and their holds as they come.

Nothing is sent to them, unless a test is asked for.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_control.plans.plan import HOLD, Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM

#: Key of a running bench among the recordings: this, and its namespace.
KEY = "live"
_PACE = 0.3  # s between two looks at what has arrived
_LOOK = 1.0  # s between two looks for further benches
_SILENT = 5.0  # s without a message after which the bench is not running any more
_MOST_HOLDS = 5000
_NEVER = -1  # stamp of what was not heard


@dataclass(frozen=True)
class Running:
    """A run of the bench as far as it was heard.

    Attributes
    ----------
    start_ns : int
        Its first stamp that was heard [ns]; negative before that.
    stamp_ns : int
        Its last one [ns].
    asked : tuple of float
        Segment, phase, tilt about x and y [rad] and spin rate [rad/s] that the plan asks for; empty if not heard.
    holds : tuple of Estimate
        Its settled holds, as the drag estimator of the graph has them.
    silent : bool
        Whether nothing comes any more.
    namespace : str
        Its namespace; empty for the root.
    """

    start_ns: int
    stamp_ns: int
    asked: tuple[float, ...] = ()
    holds: tuple[Estimate, ...] = ()
    silent: bool = False
    namespace: str = ""

    @property
    def title(self) -> str:
        """What it is called on the page."""
        return f"running bench {self.namespace}".rstrip()

    def words(self) -> str:
        """Return where it is, in a line."""
        if self.stamp_ns < 0:
            return "it is gone" if self.silent else "it runs; no plan is heard yet"
        text = f"{(self.stamp_ns - self.start_ns) / wire.SECOND:.0f} s heard, {len(self.holds)} holds"
        if self.silent:
            return f"{text}; nothing comes any more"
        if self.asked:
            segment, phase, x, y, spin = self.asked
            kind = "hold" if phase == HOLD else "ramp"
            text += (
                f"; segment {segment:.0f}, {kind}: tilt {x / DEG:.1f}, {y / DEG:.1f} °, {spin / RPM:.0f} rpm"
            )
        return text


class LiveBenches:
    """Listens to the graphs of the benches in a thread of its own, for as long as a block lasts.

    Without ROS in this environment it hears nothing, and says so in `missing`.

    Parameters
    ----------
    changed : callable
        Called when something has been heard.
    domain : int, optional
        ROS domain; by default that of the environment.
    """

    def __init__(self, changed: Callable[[], None], domain: int | None = None) -> None:
        self._changed, self._domain = changed, domain
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._heard: dict[str, float] = {}
        self._runs: dict[str, Running] = {}
        self.missing = ""

    @property
    def runs(self) -> Mapping[str, Running]:
        """The runs of the benches that were heard, by their keys, in the order of the namespaces."""
        return {f"{KEY}{name}": own for name, own in sorted(self._runs.copy().items())}

    def __enter__(self) -> LiveBenches:
        """Begin to listen."""
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stop listening; the benches go on."""
        self._end.set()
        self._thread.join(10.0)

    def walk(
        self,
        key: str,
        plan: str,
        folder: Path,
        progress: Callable[[float], None],
        ended: Callable[[], bool],
    ) -> bool:
        """Have a running bench walk a plan and record it in a new folder; return whether it went to its end.

        Parameters
        ----------
        key : str
            Key of the bench.
        plan : str
            The plan.
        folder : Path
            New folder for the recording.
        progress : callable
            Called with the fraction done.
        ended : callable
            Asked all along whether the bench is to stop the plan.

        Raises
        ------
        InputError
            If no such bench runs, it does not answer, or it refuses or aborts the plan.
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
        takers = {topics.SETPOINT: self._take_setpoint, topics.DRAG_ESTIMATE: self._take_estimate}
        with listening("workbench", tuple(takers), self._domain) as ear:
            looked, there = -math.inf, set[str]()
            while not self._end.wait(_PACE):
                before, now = self._runs.copy(), time.monotonic()
                if now - looked > _LOOK:
                    there, looked = ear.look(), now
                    for namespace in there - self._runs.keys():
                        self._runs[namespace] = Running(_NEVER, _NEVER, namespace=namespace)
                for namespace, topic, data in ear.messages():
                    self._heard[namespace] = now
                    takers[topic](namespace, data)
                for namespace, own in self._runs.items():
                    quiet = now - self._heard.get(namespace, -math.inf) > _SILENT
                    silent = quiet and namespace not in there
                    self._runs[namespace] = replace(own, silent=silent)
                if self._runs != before:
                    self._changed()

    def _take_setpoint(self, namespace: str, data: bytes) -> None:
        try:
            stamp, segment, phase, *values = wire.SETPOINT.unpack(data)
        except ValueError:  # of a node that is not of this bench
            return
        x, y, _, _, spin, _ = values
        self._runs[namespace] = replace(self._at(namespace, stamp), asked=(segment, phase, x, y, spin))

    def _take_estimate(self, namespace: str, data: bytes) -> None:
        try:
            estimate = Estimate.from_bytes(data)
        except ValueError:
            return
        if estimate.settled:
            own = self._at(namespace, estimate.stamp_ns, late=True)
            if own.holds and own.holds[-1].stamp_ns == estimate.stamp_ns:  # said twice
                return
            self._runs[namespace] = replace(own, holds=(*own.holds, estimate)[-_MOST_HOLDS:])

    def _at(self, namespace: str, stamp: int, *, late: bool = False) -> Running:
        """Return the run at a time; a setpoint before the last one begins another run, an estimate may come late."""
        own = self._runs.get(namespace)
        if own is None or own.stamp_ns < 0 or (stamp < own.stamp_ns and not late):
            return Running(stamp, stamp, namespace=namespace)
        return replace(own, start_ns=min(own.start_ns, stamp), stamp_ns=max(own.stamp_ns, stamp))
