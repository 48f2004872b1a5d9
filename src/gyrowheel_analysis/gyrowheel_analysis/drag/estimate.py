"""Drag estimates of the published ground test, one per hold: notch-filtered mean voltages and simulated torques."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.drag.notch import COLUMNS, RADIUS, notch
from gyrowheel_analysis.drag.prediction import HoldPrediction, Predictor
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.quality import NEEDED
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import LONGEST, SETTLING, SPEED_CHANGE, SPIN_SETTLING
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_control.plans.plan import HOLD, SETPOINT_DTYPE
from gyrowheel_core import wire
from gyrowheel_core.readings import Readings
from gyrowheel_core.units import DEG
from gyrowheel_sim.environment import Environment, merged

Array = NDArray[np.float64]

#: Places among the filtered readings.
_TILT, _DC, _ACTUATION, _CURRENT = slice(0, 2), slice(2, 5), slice(2, 6), 5
_NOTCH_SETTLING = 0.15  # s
_UPDATE, _SELDOM = 0.5, 5.0  # s between two estimates of one hold, at its beginning and in the long run
_SHARE = 0.1  # of a hold's length that is new in the next estimate
_BATCH, _FEWEST = 0.1, 4  # s, and the number of them from which the noise of a mean is estimated
_MOST_PARTS = 64  # of a hold that are kept one by one
_UPRIGHT = 0.05 * DEG  # a hold tilted less is at zero tilt
_NOISY = ("coil_voltage", "coil_voltage", "motor_voltage", "motor_current")
#: Readings of the torques of coil x, coil y and motor, and the constants that convert them.
READINGS_OF = ("coil_voltage", "coil_voltage", "motor_current")
CONSTANTS = ("coil_constant", "coil_constant", "motor_constant")


@dataclass(frozen=True)
class Estimate:
    """One drag estimate; the fields of the DragEstimate message [SI], every one finite.

    Arrays are those of coil x, coil y and motor; torques are in case axes.

    Attributes
    ----------
    stamp_ns : int
        End of the averaged stretch [ns].
    segment : int
        Segment of the test plan.
    settled : bool
        Whether the hold is over: this is its last estimate.
    duration : float
        Length of the averaged stretch [s].
    tilt_x, tilt_y, spin_rate : float
        Mean tilt [rad] and spin rate [rad/s].
    dc_voltage, dc_voltage_std : ndarray (3,)
        Mean voltages [V] and their standard errors: the scatter of the readings within the hold, and the slow drift of
        the readings as the bench states it, which a hold does not show.
    motor_current, motor_current_std : float
        Mean current [A] and its standard error.
    reference_segment : int
        The hold from which increments are taken: the last one before at zero tilt and the same speed; for the first
        one at zero tilt itself; for a tilted one without such a hold the first settled one.
    voltage_increment, voltage_increment_std, simulated_voltage_increment : ndarray (3,)
        Change of `dc_voltage` from the reference hold, its standard error, and the prediction of the model [V].
    calibrated : bool
        Whether the model has learned both constants, of coils and motor, from recordings; else the bench's stated
        constants are used, with their stated uncertainty.
    measured_torque : ndarray (3,)
        Torque by voltages of coils, current of motor and the constants of the model, without the predicted errors of
        actuators and readings [N m].
    measured_torque_std : ndarray (3,)
        Its standard error from the noise of the readings [N m].
    constants_std : ndarray (3,)
        Standard error of the residual from the model: the uncertainties of the constants of coils and motor and of all
        other parameters of the bench, as stated or as learned, and those of its effects [N m].
    simulated_torque, simulated_air_torque : ndarray (3,)
        Torque that the motion needs by the model, and the share of effects of the air in it [N m].
    residual : ndarray (3,)
        `measured_torque` less `simulated_torque` [N m].
    changes : ndarray (uncertainties, 3)
        Change of the expected torque reading if one uncertain quantity of the model is one standard error larger [N m]:
        what holds share of their errors. Not in the message, and empty in an estimate read from one.
    """

    stamp_ns: int
    segment: int
    settled: bool
    duration: float
    tilt_x: float
    tilt_y: float
    spin_rate: float
    dc_voltage: Array
    dc_voltage_std: Array
    motor_current: float
    motor_current_std: float
    reference_segment: int
    voltage_increment: Array
    voltage_increment_std: Array
    simulated_voltage_increment: Array
    calibrated: bool
    measured_torque: Array
    measured_torque_std: Array
    constants_std: Array
    simulated_torque: Array
    simulated_air_torque: Array
    residual: Array
    changes: Array = field(default_factory=lambda: np.zeros((0, 3)), repr=False, compare=False)

    @property
    def residual_std(self) -> Array:
        """Standard error of the residual, from the noise and from the model together [N m]."""
        return np.hypot(self.measured_torque_std, self.constants_std)

    def serialized(self) -> bytes:
        """Return the DragEstimate message as bytes."""
        values: list[float] = []
        for name in wire.DRAG_ESTIMATE.names:
            value = getattr(self, name)
            values += list(value) if isinstance(value, np.ndarray) else [value]
        return wire.DRAG_ESTIMATE.pack(self.stamp_ns, *values)

    @classmethod
    def from_bytes(cls, data: bytes) -> Estimate:
        """Read a serialized DragEstimate message.

        Raises
        ------
        ValueError
            For any other content.
        """
        stamp, *values = wire.DRAG_ESTIMATE.unpack(data)
        rest = iter(values)
        content: dict[str, Any] = {
            name: np.array([next(rest) for _ in range(3)]) if kind.endswith("[3]") else next(rest)
            for name, kind in ((n, wire.DRAG_ESTIMATE.declaration[n]) for n in wire.DRAG_ESTIMATE.names)
        }
        return cls(stamp, **content)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields of the message by name, arrays as lists; ``stamp`` in s."""
        content = {name: getattr(self, name) for name in wire.DRAG_ESTIMATE.names}
        return {
            "stamp": self.stamp_ns / wire.SECOND,
            **{n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in content.items()},
        }


class _Setpoint(NamedTuple):
    """One setpoint: a row of `SETPOINT_DTYPE`."""

    stamp_ns: int
    segment: int
    phase: int
    tilt_x: float
    tilt_y: float
    tilt_rate_x: float
    tilt_rate_y: float
    spin_rate: float
    spin_acceleration: float


class _Batches:
    """Sums of filtered readings over batches of samples, for their scatter; no sample is kept."""

    def __init__(self, size: int) -> None:
        self._size = size  # samples in a batch
        self._sum, self._filled = np.zeros(len(COLUMNS)), 0  # of the incomplete batch
        self._count = 0  # of the complete ones
        # of them, about their mean
        self._mean, self._squares = np.zeros(len(COLUMNS)), np.zeros(len(COLUMNS))

    def add(self, filtered: Array) -> None:
        """Take samples."""
        while len(filtered):
            some, filtered = filtered[: self._size - self._filled], filtered[self._size - self._filled :]
            self._sum += some.sum(axis=0)
            self._filled += len(some)
            if self._filled == self._size:
                self._complete()

    def errors(self) -> Array | None:
        """Return the standard errors of the means of the samples; None if there are too few batches."""
        if self._count < _FEWEST:
            return None
        return np.asarray(np.sqrt(self._squares / (self._count - 1)) / self._size / math.sqrt(self._count))

    def _complete(self) -> None:
        self._count += 1
        before = self._sum - self._mean
        self._mean += before / self._count
        self._squares += before * (self._sum - self._mean)  # Welford's: a sum of squares would lose digits
        self._sum, self._filled = np.zeros(len(COLUMNS)), 0


@dataclass
class _Part:
    """Windows of a hold, and their prediction once it was made."""

    windows: Windows
    simulated: HoldPrediction | None = None


@dataclass
class _Hold:
    """The current hold: sums over all of it, and the samples whose windows are not final yet."""

    setpoint: _Setpoint
    start: float  # s, when the motion has settled
    due: float  # s, when the next estimate is due
    parts: list[_Part]  # of the dropped samples
    environment: Sequence[Environment]
    batches: _Batches
    first: float = math.nan
    last: float = math.nan
    count: int = 0
    filtered: Array = field(default_factory=lambda: np.zeros(len(COLUMNS)))  # sum
    spin: float = 0.0  # sum
    times: list[Array] = field(default_factory=list)
    readings: list[Array] = field(default_factory=list)

    def add(self, time: Array, readings: Readings, filtered: Array) -> None:
        """Take samples."""
        if not self.count:
            self.first = float(time[0])
        self.last = float(time[-1])
        self.count += len(time)
        self.filtered += filtered.sum(axis=0)
        self.spin += float(readings.spin_rate.sum())
        self.times.append(time)
        self.readings.append(readings.array)
        self.batches.add(filtered)


@dataclass
class _Mean:
    """The mean readings over a hold until now, and its windows; a settled one is a reference of later ones."""

    setpoint: _Setpoint
    settled: bool
    first: float  # s, of the averaged stretch
    last: float
    average: Array  # of the filtered readings
    spin: float
    noise: Array  # standard errors of coil voltages, motor voltage and current, without drift
    parts: tuple[_Part, ...]
    simulated: HoldPrediction | None = None

    @property
    def upright(self) -> bool:
        return _upright(self.setpoint)

    @property
    def dc(self) -> Array:
        return self.average[_DC]

    @property
    def time(self) -> float:
        """Time of its middle [s]."""
        return 0.5 * (self.first + self.last)

    @property
    def voltage(self) -> Array:
        """The predicted mean voltages [V]."""
        assert self.simulated is not None
        return self.simulated.voltage / self.simulated.length


class Draft(NamedTuple):
    """An estimate before its prediction, and the hold from which its increments are taken."""

    own: _Mean
    reference: _Mean


def _upright(setpoint: _Setpoint) -> bool:
    return math.hypot(setpoint.tilt_x, setpoint.tilt_y) < _UPRIGHT


class DragEstimator:
    """Turns samples and setpoints into drag estimates, block by block.

    Parameters
    ----------
    model : Model
        The model whose torques are simulated.
    period : float, optional
        Sampling period of the readings, if not that of the bench [s].
    settled : bool
        Whether to estimate settled holds only, instead of repeatedly during a hold.
    """

    def __init__(self, model: Model, period: float | None = None, *, settled: bool = False) -> None:
        self._bench = model.bench
        self._settled = settled
        self._period = self._bench.sample_period if period is None else period
        self._predictor = Predictor(model)
        self._state = np.full(4 * len(COLUMNS) + 1, math.nan)
        self._setpoints: deque[_Setpoint] = deque()
        self._asked: tuple[float, ...] = ()  # content of the last one
        self._hold: _Hold | None = None
        self._spin_before: float | None = None
        self._batch = max(round(_BATCH / self._period), 1)
        v, learned = self._bench.value, model.overrides
        self._drift = np.array([v(f"{name}_drift") for name in _NOISY])
        self._white = np.array([v(f"{name}_noise") for name in _NOISY])
        self._constants = np.array([v(name) for name in CONSTANTS])
        self._calibrated = all(name in learned for name in CONSTANTS)
        self._first: _Mean | None = None
        # the last settled hold at zero tilt of each speed, in the order of time: older ones are never references
        self._last_upright: dict[float, _Mean] = {}
        self._environment: list[Environment] = []

    @property
    def environment(self) -> Sequence[Environment]:
        """The known environments, by their times."""
        return self._environment

    def set_environment(self, events: Sequence[Environment]) -> None:
        """Take environments of the rig, with times [s] on the clock of the stamps.

        They replace all known ones from the first of them on. A hold that began later than that keeps the previous
        ones: the new ones are those of another run.
        """
        if not events:
            return
        self._environment = merged(self._environment, events)
        if self._hold is not None and events[0].time >= self._hold.start:
            self._hold.environment = self._environment

    def setpoint(self, stamp_ns: int, segment: int, phase: int, values: Sequence[float]) -> None:
        """Take a setpoint: tilt_x, tilt_y, their rates, spin rate and acceleration; stamps must ascend.

        One that repeats the previous one changes nothing; a hold has hundreds of them in a second.
        """
        content = segment, phase, *values
        if content != self._asked:
            self._setpoints.append(_Setpoint(stamp_ns, segment, phase, *values))
            self._asked = content

    def add_block(self, stamps_ns: NDArray[np.int64], readings: Readings) -> list[Estimate]:
        """Take consecutive samples, stamped in ns, and return the estimates that they complete.

        A sample without one of the readings `NEEDED` (not finite) counts as lost.
        """
        return self.completed(self.drafts(stamps_ns, readings))

    def finish(self) -> list[Estimate]:
        """Return the estimate of the current hold, at the end of a test."""
        return self.completed(self.last_drafts())

    def drafts(self, stamps_ns: NDArray[np.int64], readings: Readings) -> list[Draft]:
        """Take samples as `add_block` does, and return the drafts of the estimates, for `completed`."""
        whole = readings.whole(NEEDED)
        if not whole.all():  # a filter never recovers from NaN
            stamps_ns, readings = stamps_ns[whole], readings[whole]
        filtered = np.empty((len(readings), len(COLUMNS)))
        notch(readings.array, COLUMNS, readings.spin_rate, self._period, RADIUS, self._state, filtered)
        drafts: list[Draft] = []
        at = 0
        while at < len(stamps_ns):
            # a setpoint that begins within the block splits it, and so does an estimate that falls due
            if self._setpoints and self._setpoints[0].stamp_ns <= stamps_ns[at]:
                drafts += self._take(self._setpoints.popleft())
                continue
            stop = len(stamps_ns)
            if self._setpoints:
                stop = int(np.searchsorted(stamps_ns, self._setpoints[0].stamp_ns))
            if self._hold is not None:
                time = np.asarray(stamps_ns[at:stop] * 1e-9, dtype=np.float64)
                first, due = np.searchsorted(time, (self._hold.start, self._hold.due)).tolist()
                is_due = due < len(time)
                stop = at + due + 1 if is_due else stop
                part = slice(at + first, stop)
                if part.start < stop:
                    self._hold.add(time[first : stop - at], readings[part], filtered[part])
                if is_due:
                    step = _SHARE * (self._hold.last - self._hold.first)
                    self._hold.due = self._hold.last + min(max(step, _UPDATE), _SELDOM)
                    if self._settled:
                        self._shorten(self._hold)
                    else:
                        drafts += self._draft(self._hold, settled=False)
            at = stop
        return drafts

    def last_drafts(self) -> list[Draft]:
        """Return the draft of the current hold, at the end of a test."""
        hold, self._hold = self._hold, None
        return [] if hold is None else self._draft(hold, settled=True)

    def completed(self, drafts: Sequence[Draft]) -> list[Estimate]:
        """Return the estimates of drafts, in their order; one prediction serves all of them."""
        self._predict([part for draft in drafts for part in draft.own.parts])
        return [self._estimate(*draft) for draft in drafts]

    def _predict(self, parts: Sequence[_Part]) -> None:
        """Predict those of some parts that have no prediction yet."""
        new = list({id(part): part for part in parts if part.simulated is None}.values())
        for part, simulated in zip(new, self._predictor.of([part.windows for part in new]), strict=True):
            part.simulated = simulated

    def _take(self, setpoint: _Setpoint) -> list[Draft]:
        hold, spin = setpoint.phase == HOLD, float(setpoint.spin_rate)
        if self._hold is not None and hold and setpoint.segment == self._hold.setpoint.segment:
            return []
        drafts = self.last_drafts()
        turning = math.hypot(setpoint.tilt_rate_x, setpoint.tilt_rate_y)
        if hold and turning < 0.1 * DEG and abs(setpoint.spin_acceleration) < 0.5:
            changed = self._spin_before is not None and abs(spin - self._spin_before) > SPEED_CHANGE
            start = setpoint.stamp_ns * 1e-9 + (SPIN_SETTLING if changed else SETTLING)
            batches = _Batches(self._batch)
            self._hold = _Hold(setpoint, start, start + _UPDATE, [], self._environment, batches)
        if hold:
            self._spin_before = spin
        return drafts

    def _shorten(self, hold: _Hold) -> None:
        """Reduce the old samples of a hold once and drop them, so that work and memory do not grow with the hold."""
        time, readings = np.concatenate(hold.times), np.vstack(hold.readings)
        while time[-1] - time[0] >= LONGEST + _UPDATE:
            cut = int(np.searchsorted(time, time[0] + LONGEST))
            hold.parts.append(self._reduced(hold, time[:cut], readings[:cut]))
            time, readings = time[cut:], readings[cut:]
        hold.times, hold.readings = [time], [readings]
        if len(hold.parts) > _MOST_PARTS:
            self._predict(hold.parts)
            total = self._predictor.total(part.simulated for part in hold.parts)
            hold.parts = [_Part(hold.parts[-1].windows, total)]

    def _reduced(self, hold: _Hold, time: Array, readings: Array) -> _Part:
        """Return the windows of some samples of a hold."""
        # the reduction cuts off the settling itself, so it gets the original start of the hold
        setpoint = np.array([hold.setpoint] * 2, dtype=SETPOINT_DTYPE)
        start = np.array([time[0] - SETTLING, time[-1]])
        samples = Samples(time, Readings(readings), start, setpoint, hold.environment)
        return _Part(self._predictor.windows(samples))

    def _draft(self, hold: _Hold, *, settled: bool) -> list[Draft]:
        if not hold.count or hold.last - hold.first < _NOTCH_SETTLING:
            return []
        self._shorten(hold)
        parts = *hold.parts, self._reduced(hold, hold.times[0], hold.readings[0])
        if not any(len(part.windows) for part in parts):
            return []
        scatter = hold.batches.errors()
        own = _Mean(
            setpoint=hold.setpoint,
            settled=settled,
            first=hold.first,
            last=hold.last,
            average=hold.filtered / hold.count,
            spin=hold.spin / hold.count,
            noise=self._white / math.sqrt(hold.count) if scatter is None else scatter[_ACTUATION],
            parts=parts,
        )
        reference = self._reference(own)
        if settled:
            self._keep(own)
        return [Draft(own, reference)]

    def _estimate(self, own: _Mean, reference: _Mean) -> Estimate:
        """Return the estimate of a draft whose parts are predicted."""
        simulated = own.simulated = self._predictor.total(part.simulated for part in own.parts)
        own.parts = ()
        torque, air, errors = (
            total / simulated.length for total in (simulated.torque, simulated.air, simulated.errors)
        )
        changes = simulated.changes / simulated.length
        std = np.hypot(own.noise, self._drift)  # averaging over a hold does not remove the drift
        current = float(own.average[_CURRENT])
        increment_std = np.zeros(3)
        if reference is not own:
            # drift between the two holds
            change = -2.0 * math.expm1(-(own.time - reference.time) / self._bench.value("drift_time"))
            increment_std = np.sqrt(
                own.noise[:3] ** 2 + reference.noise[:3] ** 2 + change * self._drift[:3] ** 2
            )
        read = np.array([*own.dc[:2], current])
        measured = self._constants * read - errors
        return Estimate(
            stamp_ns=round(own.last * 1e9),
            segment=int(own.setpoint.segment),
            settled=own.settled,
            duration=own.last - own.first,
            tilt_x=float(own.average[_TILT][0]),
            tilt_y=float(own.average[_TILT][1]),
            spin_rate=own.spin,
            dc_voltage=own.dc,
            dc_voltage_std=std[:3],
            motor_current=current,
            motor_current_std=float(std[3]),
            reference_segment=int(reference.setpoint.segment),
            voltage_increment=own.dc - reference.dc,
            voltage_increment_std=increment_std,
            simulated_voltage_increment=own.voltage - reference.voltage,
            calibrated=self._calibrated,
            measured_torque=measured,
            measured_torque_std=self._constants * std[[0, 1, 3]],
            constants_std=np.sqrt(np.sum(changes**2, axis=0)),
            simulated_torque=torque,
            simulated_air_torque=air,
            residual=measured - torque,
            changes=changes,
        )

    def _keep(self, own: _Mean) -> None:
        """Keep a settled hold as a possible reference of later ones."""
        self._first = self._first or own
        if own.upright:
            self._last_upright.pop(own.setpoint.spin_rate, None)
            self._last_upright[own.setpoint.spin_rate] = own

    def _reference(self, own: _Mean) -> _Mean:
        """Return the hold from which the increments of a hold are taken."""
        speed = own.setpoint.spin_rate
        for earlier in reversed(self._last_upright.values()):
            if abs(earlier.setpoint.spin_rate - speed) < SPEED_CHANGE:
                return earlier
        return own if own.upright or self._first is None else self._first
