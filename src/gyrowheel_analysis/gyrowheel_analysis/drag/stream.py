"""Drag estimates from serialized samples and setpoints, as the topics deliver them. Needs no ROS."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.drag.agreement import Agreement, agreement
from gyrowheel_analysis.drag.estimate import Draft, DragEstimator, Estimate
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import SETTLING, SPEED_CHANGE, SPIN_SETTLING, steady_spans
from gyrowheel_control.plans.plan import HOLD, RAMP, SETPOINT_DTYPE, SETPOINT_PERIOD
from gyrowheel_core import wire
from gyrowheel_core.readings import READINGS, Readings
from gyrowheel_core.units import DEG
from gyrowheel_recording.bags import Recording
from gyrowheel_sim import environment as environments
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment

#: Samples that are passed on together: estimates are rare, and a block costs little more than a sample.
BLOCK: Final = 100
#: The same of a finished run.
RUN_BLOCK: Final = 1 << 14
#: Estimates of a finished run that one prediction serves.
TOGETHER: Final = 256
#: Most samples that wait for the setpoint after them: beyond it none is expected.
PATIENCE: Final = 2000
_SETPOINT_PERIOD_NS: Final = round(SETPOINT_PERIOD * 1e9)
_STILL: Final = 0.1 * DEG  # a tilt that changes less is held


@dataclass(frozen=True)
class DragTest:
    """Drag estimates of the holds of recordings.

    Attributes
    ----------
    holds : tuple of tuple of gyrowheel_analysis.drag.estimate.Estimate
        Drag estimates of the settled holds, for each recording.
    bench : Bench
        The bench, with the parameters of the believed model.
    recordings : tuple of str
        Paths of the recordings.
    signals : tuple of dict
        For each recording ``stamp`` [s] and the notch-filtered readings, of which the DC voltages are means:
        ``notched_tilt_x``, ``notched_tilt_y`` [rad], ``notched_coil_voltage_x``, ``notched_coil_voltage_y``,
        ``notched_motor_voltage`` [V] and ``notched_motor_current`` [A]; ndarrays (n,), NaN where a sample is lost.
        Empty if they were not kept.
    """

    holds: tuple[tuple[Estimate, ...], ...]
    bench: Bench
    recordings: tuple[str, ...]
    signals: tuple[Mapping[str, Any], ...]

    @property
    def estimates(self) -> list[Estimate]:
        """The estimates of all recordings in one list."""
        return [estimate for own in self.holds for estimate in own]

    @property
    def agreements(self) -> tuple[tuple[Agreement, ...], ...]:
        """Whether measured and simulated torques of coil x, coil y and motor agree, for each recording."""
        return tuple(tuple(agreement(own, place, self.bench) for place in range(3)) for own in self.holds)


def drag_estimates(
    stamps_ns: NDArray[np.int64],
    readings: Readings,
    setpoints: Any,
    model: Model,
    environment: Sequence[Environment] = (),
    period: float | None = None,
    *,
    settled: bool = False,
) -> Iterator[Estimate]:
    """Yield the drag estimates of a whole run, as a `DragStream` gives them.

    `stamps_ns` (n,) are the sampling instants, ascending [ns], of `readings` (n) [SI]; `setpoints` have ``stamp_ns``
    and the fields of the Setpoint message, in the order of time; the times of `environment` [s] are on the clock of the
    stamps. `model`, `period` and `settled` are those of `DragEstimator`.
    """
    estimator = DragEstimator(model, period, settled=settled)
    estimator.set_environment(environment)
    waiting: list[Draft] = []
    asked = setpoints[["stamp_ns", "segment", "phase", *wire.SETPOINT.fields]]
    passed = 0
    for start in range(0, len(stamps_ns), RUN_BLOCK):
        block = slice(start, start + RUN_BLOCK)
        # setpoints are passed on as they begin: hours of them at once take several times the memory
        begun = int(np.searchsorted(asked["stamp_ns"][passed:], stamps_ns[block][-1], side="right"))
        for stamp, segment, phase, *values in asked[passed : passed + begun].tolist():
            estimator.setpoint(stamp, segment, phase, values)
        passed += begun
        waiting += estimator.drafts(stamps_ns[block], readings[block])
        if len(waiting) >= TOGETHER:
            yield from estimator.completed(waiting)
            waiting.clear()
    yield from estimator.completed([*waiting, *estimator.last_drafts()])


def recorded_holds(recording: Recording, model: Model) -> list[Estimate]:
    """Return the last drag estimates of the holds of a recording, computed from its measurements.

    Without setpoints the holds are found in the motion, and numbered from 0.

    Raises
    ------
    InputError
        If a reading without a substitute was never taken.
    """
    # takes long to load, and the node does not need it
    from gyrowheel_analysis.fitting.preparation import samples_of

    samples = samples_of(recording)
    setpoints = recording.setpoint
    if not len(setpoints):
        setpoints = _found_setpoints(samples, recording.start_ns)
    stamps = recording.measurement["stamp_ns"]
    start = recording.start_ns * 1e-9
    environment = [replace(event, time=event.time + start) for event in recording.environment]
    period = samples.period(model.bench.sample_period)
    return list(drag_estimates(stamps, samples.readings, setpoints, model, environment, period, settled=True))


def _found_setpoints(samples: Samples, start_ns: int) -> Any:
    """Return setpoints of the holds in the motion: one at the beginning of each, one at its end."""
    rows: list[tuple[Any, ...]] = []
    before = math.nan
    for start, stop, _, turn in steady_spans(samples):
        first, last = np.searchsorted(samples.time, (start, stop))
        tilt_x, tilt_y, spin = (samples.readings[n][first:last] for n in ("tilt_x", "tilt_y", "spin_rate"))
        # a ramp is a steady motion, too
        if turn > 0.0 or _moves(spin, SPEED_CHANGE) or _moves(tilt_x, _STILL) or _moves(tilt_y, _STILL):
            continue
        motion = float(np.nanmean(tilt_x)), float(np.nanmean(tilt_y)), 0.0, 0.0, float(np.nanmean(spin)), 0.0
        # the estimator waits until a motion has settled, but this one has
        settling = SPIN_SETTLING if abs(motion[4] - before) > SPEED_CHANGE else SETTLING
        before = motion[4]
        for time, phase in ((start - settling, HOLD), (stop, RAMP)):
            rows.append((start_ns + round(time * wire.SECOND), len(rows) // 2, phase, *motion))
    found = np.array(rows, dtype=SETPOINT_DTYPE)
    found["stamp_ns"] = np.maximum.accumulate(found["stamp_ns"])
    return found


def _moves(column: NDArray[np.float64], least: float) -> bool:
    """Whether a reading changes by more than `least` from the first third of its time to the last one."""
    third = len(column) // 3
    if not third or np.isnan(column).all():
        return True
    return bool(abs(np.nanmean(column[-third:]) - np.nanmean(column[:third])) > least)


class DragStream:
    """Turns serialized samples and setpoints into drag estimates.

    The estimates do not depend on how the messages of the two topics interleave. A stamp that decreases begins another
    run. `model` gives the simulated torques.

    Attributes
    ----------
    samples, missing, malformed : int
        Processed samples, samples missing by their sequence numbers, and messages without the layout of the bench; of
        the current run.
    first : int
        Sequence number of the first sample of the run; -1 before it.
    """

    _sample_ns: int
    _latest: bytes
    _setpoint_ns: int

    def __init__(self, model: Model) -> None:
        self._model = model
        self._begin()

    @staticmethod
    def warm_up(model: Model) -> None:
        """Load compiled code, which takes seconds at its first call."""
        DragEstimator(model).add_block(np.zeros(1, np.int64), Readings(np.ones((1, len(READINGS)))))

    def take_measurement(self, raw: bytes) -> list[Estimate]:
        """Take a serialized Measurement; return the last estimates of a run that it ends."""
        try:
            stamp = wire.stamp(raw)
        except ValueError:
            stamp = -1
        if stamp < 0 or len(raw) != wire.MEASUREMENT.size:
            self.malformed += 1
            return []
        if raw == self._latest:  # sent again, for a node that started late
            return []
        estimates = self.finish() if stamp <= self._sample_ns else []  # the plant was started again
        self._sample_ns, self._latest = stamp, raw
        self._waiting.append(raw)
        return estimates

    def take_setpoint(self, raw: bytes) -> list[Estimate]:
        """Take a serialized Setpoint; return the last estimates of a run that it ends."""
        try:
            stamp, segment, phase, *values = wire.SETPOINT.unpack(raw)
        except ValueError:
            self.malformed += 1
            return []
        if 0 <= self._sample_ns < stamp + _SETPOINT_PERIOD_NS and stamp <= self._setpoint_ns:
            return []  # sent again, for a node that started late
        estimates = self.finish() if stamp <= self._setpoint_ns else []
        self._setpoint_ns = stamp
        self._estimator.setpoint(stamp, segment, phase, values)
        return estimates

    def take_environment(self, raw: bytes) -> None:
        """Take a serialized message of the environment.

        It counts for holds whose setpoints are taken after it. The known environment outlives a run, as the topic keeps
        it for late subscribers.
        """
        try:
            events = environments.from_json(wire.unpack_text(raw))
        except ValueError:  # also an InputError: a value out of range
            self.malformed += 1
            return
        self._estimator.set_environment(events)

    def estimates(self) -> list[Estimate]:
        """Return the estimates of the full blocks of samples whose setpoints are all known."""
        found: list[Estimate] = []
        while len(self._waiting) >= BLOCK and (
            len(self._waiting) >= PATIENCE or wire.stamp(self._waiting[BLOCK - 1]) < self._setpoint_ns
        ):
            found += self._hand_over()
        return found

    def finish(self) -> list[Estimate]:
        """Return the remaining estimates of a run, and be ready for the next one."""
        found: list[Estimate] = []
        while self._waiting:
            found += self._hand_over()
        found += self._estimator.finish()
        self._begin(self._estimator.environment)
        return found

    def _begin(self, environment: Sequence[Environment] = ()) -> None:
        self._estimator = DragEstimator(self._model)
        self._estimator.set_environment(environment)
        self._waiting: list[bytes] = []  # samples that were not passed on
        self.samples = self.missing = self.malformed = 0
        self.first = self._sequence = -1  # sequence numbers of the first and the last sample
        self._sample_ns, self._latest = -1, b""  # stamp of the last sample, and its message
        self._setpoint_ns = -1  # stamp of the last setpoint

    def _hand_over(self) -> list[Estimate]:
        """Pass a block of samples, or all remaining ones if they are fewer, to the estimator."""
        block, self._waiting = self._waiting[:BLOCK], self._waiting[BLOCK:]
        rows = np.frombuffer(b"".join(block), wire.MEASUREMENT.dtype)
        self.samples += len(rows)
        first, last = int(rows["sequence"][0]), int(rows["sequence"][-1])
        if self.first < 0:
            self.first, self._sequence = first, first - 1
        # samples that arrive after their successors are rare, and were counted as missing
        self.missing += max(last - self._sequence - len(rows), 0)
        self._sequence = last
        readings = Readings(np.stack([rows[name] for name in READINGS], axis=1))
        return self._estimator.add_block(wire.MEASUREMENT.stamps(rows), readings)
