"""A bench that runs on this computer: what the plan asks of it, and its holds as they come. Nothing is sent to it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from gyrowheel_analysis.drag import Estimate
from gyrowheel_control.plans.plan import HOLD
from gyrowheel_core import topics, wire
from gyrowheel_core.units import DEG, RPM

#: Key of the running bench among the recordings.
KEY = "live"
_PACE = 0.3  # s between two looks at what has arrived
_SILENT = 5.0  # s without a message after which the bench is not running any more
_MOST_HOLDS = 5000


@dataclass(frozen=True)
class Running:
    """A run of the bench as far as it was heard.

    Attributes
    ----------
    start_ns : int
        Its first stamp that was heard [ns].
    stamp_ns : int
        Its last one [ns].
    asked : tuple of float
        Segment, phase, tilt about x and y [rad] and spin rate [rad/s] that the plan asks for; empty if not heard.
    holds : tuple of Estimate
        Its settled holds, as the drag estimator of the graph has them.
    silent : bool
        Whether nothing comes any more.
    """

    start_ns: int
    stamp_ns: int
    asked: tuple[float, ...] = ()
    holds: tuple[Estimate, ...] = ()
    silent: bool = False

    def words(self) -> str:
        """Return where it is, in a line."""
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


class LiveBench:
    """Listens to the graph of the bench in a thread of its own, for as long as a block lasts.

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
        self.running: Running | None = None
        self.missing = ""

    def __enter__(self) -> LiveBench:
        """Begin to listen."""
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stop listening; the bench goes on."""
        self._end.set()
        self._thread.join(10.0)

    def _listen(self) -> None:
        try:
            from gyrowheel_bringup.graph.listening import listening
        except ImportError as error:
            self.missing = f"ROS is not installed here ({error})"
            return
        takers = (self._take_setpoint, self._take_estimate)
        with listening("workbench", (topics.SETPOINT, topics.DRAG_ESTIMATE), self._domain) as inboxes:
            heard = -math.inf
            while not self._end.wait(_PACE):
                before = self.running
                for inbox, take in zip(inboxes, takers, strict=True):
                    for data in inbox.take():
                        heard = time.monotonic()
                        take(data)
                if self.running is not None:
                    self.running = replace(self.running, silent=time.monotonic() - heard > _SILENT)
                if self.running != before:
                    self._changed()

    def _take_setpoint(self, data: bytes) -> None:
        try:
            stamp, segment, phase, *values = wire.SETPOINT.unpack(data)
        except ValueError:  # of a node that is not of this bench
            return
        x, y, _, _, spin, _ = values
        self.running = replace(self._at(stamp), asked=(segment, phase, x, y, spin))

    def _take_estimate(self, data: bytes) -> None:
        try:
            estimate = Estimate.from_bytes(data)
        except ValueError:
            return
        if estimate.settled:
            own = self._at(estimate.stamp_ns, late=True)
            if own.holds and own.holds[-1].stamp_ns == estimate.stamp_ns:  # said twice
                return
            self.running = replace(own, holds=(*own.holds, estimate)[-_MOST_HOLDS:])

    def _at(self, stamp: int, *, late: bool = False) -> Running:
        """Return the run at a time; a setpoint before the last one begins another run, an estimate may come late."""
        own = self.running
        if own is None or (stamp < own.stamp_ns and not late):
            return Running(stamp, stamp)
        return replace(own, start_ns=min(own.start_ns, stamp), stamp_ns=max(own.stamp_ns, stamp))
