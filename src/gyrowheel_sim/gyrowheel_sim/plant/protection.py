"""Protection of the machine: voltage limits, hard stop, watchdog, refusal of invalid commands.

A `Guard` sits between the commands and the machine. `Guard.take` checks each command, `Guard.output` returns the
voltages of the next sample, `Guard.observe` checks each sample. It uses neither ROS nor a clock: it counts time in
samples, so that it acts in the same way at any pace.

Its state has a name (`GuardState`), which the plant's node reports on ``/diagnostics``. Two states are final:
``controller_lost`` and ``tilt_stop`` switch the coils off and let the motor spin down, regardless of commands, until
the next call of `Guard.start`.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from gyrowheel_core.errors import InputError

#: A working loop never commands more than this multiple of a limit: beyond it a command is refused.
NONSENSE = 2.0
#: Consecutive samples beyond the hard stop that trip the guard: one wrong reading does not stop a test.
STOP_SAMPLES = 4
#: Share of samples without a new command, or made late, that is a warning: a computer with other work has a few.
HELD_SHARE = 0.01


class GuardState(enum.StrEnum):
    """State of the guard.

    The states between ``normal`` and ``controller_lost`` describe the time since the last `Guard.report`; the most
    severe counts. Holding no more than `HELD_SHARE` of the samples is the least severe: it must not hide the others.
    """

    STOPPED = "stopped"
    WAITING = "waiting"
    NORMAL = "normal"
    VOLTAGE_LIMITED = "voltage_limited"
    COMMAND_REFUSED = "command_refused"
    HOLDING = "holding"
    RELEASED = "released"
    CONTROLLER_LOST = "controller_lost"
    TILT_STOP = "tilt_stop"


class Refusal(enum.StrEnum):
    """Why a command was refused; the last voltages stay."""

    MALFORMED = "malformed"
    NOT_FINITE = "not_finite"
    OUT_OF_RANGE = "out_of_range"
    STALE = "stale"
    AHEAD = "ahead"


@dataclass(frozen=True)
class GuardLimits:
    """Limits of the guard."""

    #: Largest voltages [V]. Commands beyond them are limited; beyond `NONSENSE` times them they are refused.
    coil_voltage: float
    motor_voltage: float
    tilt_stop: float  # hard stop: tilt beyond which the coils are switched off and the motor spins down [rad]
    watchdog: int = 500  # consecutive samples without a new command after which the controller counts as lost
    oldest: int = 20  # age, in samples, up to which a sample may still be answered
    spin_down: float = 1.5e-3  # how fast the motor voltage goes to zero at a spin-down [V per sample]
    #: Consecutive samples without a controller, after the last one has left in order, after which it counts
    #: as lost.
    exchange: int = 20_000

    def __post_init__(self) -> None:
        """Check every limit."""
        for name in ("coil_voltage", "motor_voltage", "tilt_stop", "spin_down"):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise InputError(f"guard.{name}: {value!r} is out of range; allowed: > 0")
        for name, low in (("watchdog", 1), ("oldest", 0), ("exchange", 1)):
            if getattr(self, name) < low:
                raise InputError(f"guard.{name}: {getattr(self, name)!r} is out of range; allowed: >= {low}")


class Guard:
    """Checks commands and returns the voltages that are applied.

    Parameters
    ----------
    limits : GuardLimits
        The limits; may be replaced at any time.
    motor_voltage : float
        Voltage of the motor until the first command [V]: the one at which the machine is started.

    Attributes
    ----------
    limits : GuardLimits
        As given.
    trip : GuardState or None
        ``controller_lost`` or ``tilt_stop`` once it has happened.
    reason : str
        One line about the trip; empty without one.
    taken, late, missing, held, limited : int
        Commands taken; commands taken that came after the next sample; samples that no command answered, by
        sequence number; samples for which the last voltages were held; commands beyond a voltage limit.
    steady : int
        Commands in a row of which each answered the sample after that of the one before.
    refused : dict of Refusal to int
        Commands refused, by the reason.
    """

    def __init__(self, limits: GuardLimits, *, motor_voltage: float = 0.0) -> None:
        self.limits = limits
        self._first = (0.0, 0.0, motor_voltage)
        self.trip: GuardState | None = None
        self.reason = ""
        self.taken = self.late = self.missing = self.held = self.limited = 0
        self.refused = dict.fromkeys(Refusal, 0)
        self.steady = 0
        self._voltages = (0.0, 0.0, 0.0)
        self._last: int | None = None  # sequence that the last command answered
        self._running = self._commanded = self._fresh = False
        self._released = False  # the controller has left in order
        self._idle = 0  # samples in a row without a new command
        self._refused_before = dict(self.refused)  # at the last new command
        self._beyond = 0  # samples in a row beyond the hard stop
        self._told = (0, 0, 0, 0)  # limited, refused, held, and all samples at the last report
        self._samples = 0

    def start(self) -> None:
        """Start, also after a trip: wait for the first command."""
        self.trip, self.reason = None, ""
        self._voltages, self._first = self._first, (0.0, 0.0, 0.0)
        self._running, self._commanded, self._fresh = True, False, False
        self._released = False
        self._last = None
        self._idle = self._beyond = 0
        self._refused_before = dict(self.refused)

    def release(self) -> bool:
        """Wait for another controller: the last one has left in order; return whether there was one to wait for.

        The coils are switched off and the motor keeps its voltage, until a command comes or `GuardLimits.exchange` is
        over.
        """
        if not self._commanded or self._released or not self.running:
            return False
        self._released, self._idle = True, 0
        self._voltages = (0.0, 0.0, self._voltages[2])
        return True

    def stop(self) -> None:
        """Switch off: no voltage on coils and motor."""
        self._running = False
        self._voltages = (0.0, 0.0, 0.0)

    @property
    def running(self) -> bool:
        """Whether voltages are applied: it was started, and has neither been stopped nor tripped."""
        return self._running and self.trip is None

    @property
    def voltages(self) -> tuple[float, float, float]:
        """Coil x, coil y, motor: what is applied at present [V]."""
        return self._voltages

    @property
    def off(self) -> bool:
        """Whether there is no voltage on coils and motor."""
        return self._voltages == (0.0, 0.0, 0.0)

    def take(self, answered: int, newest: int, x: float, y: float, motor: float) -> Refusal | None:
        """Check a command; return the reason of its refusal, or None.

        `answered`: sequence number of the sample that it answers; `newest`: that of the newest sample; `x`,
        `y`, `motor`: voltages [V].
        """
        if answered > newest:
            return self.refuse(Refusal.AHEAD)
        last = self._last
        if newest - answered > self.limits.oldest or (last is not None and answered <= last):
            return self.refuse(Refusal.STALE)
        if last is not None:
            self.missing += answered - last - 1
        self.steady = self.steady + 1 if last is not None and answered == last + 1 else 0
        self._last = answered
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(motor)):
            return self.refuse(Refusal.NOT_FINITE)
        coil, top = self.limits.coil_voltage, self.limits.motor_voltage
        if abs(x) > coil or abs(y) > coil or abs(motor) > top:
            self.limited += 1
            if abs(x) > NONSENSE * coil or abs(y) > NONSENSE * coil or abs(motor) > NONSENSE * top:
                return self.refuse(Refusal.OUT_OF_RANGE)
            x, y = min(max(x, -coil), coil), min(max(y, -coil), coil)
            motor = min(max(motor, -top), top)
        self.late += answered < newest
        self.taken += 1
        if self._running and self.trip is None:
            self._voltages = (x, y, motor)
            self._commanded = self._fresh = True
            self._released = False
        return None

    def unanswered(self, newest: int) -> int:
        """Return how many samples up to the newest one no command has answered; all of them if none was."""
        return newest + 1 if self._last is None else newest - self._last

    def refuse(self, why: Refusal) -> Refusal:
        """Count a command that is refused, also one that could not even be read."""
        self.refused[why] += 1
        return why

    def output(self) -> tuple[float, float, float]:
        """Return coil x, coil y and motor voltage up to the next sample [V]; call once a sample."""
        self._samples += 1
        if self._fresh:
            self._fresh, self._idle = False, 0
            self._refused_before.update(self.refused)
        elif self.trip is not None:
            motor, step = self._voltages[2], self.limits.spin_down
            motor = 0.0 if abs(motor) <= step else motor - math.copysign(step, motor)
            self._voltages = (0.0, 0.0, motor)
        elif self._released and self._running:
            self._idle += 1
            if self._idle >= self.limits.exchange:
                self._trip(GuardState.CONTROLLER_LOST, f"no controller for {self._idle} samples")
        elif self._commanded and self._running:
            self.held += 1
            self._idle += 1
            if self._idle >= self.limits.watchdog:
                self._trip(
                    GuardState.CONTROLLER_LOST, f"no valid command for {self._idle} samples{self.refusals()}"
                )
        return self._voltages

    def refusals(self) -> str:
        """Return the commands refused since the last one taken, with reasons, in words; empty if there were none."""
        came = {why: count - self._refused_before[why] for why, count in self.refused.items()}
        kinds = [f"{count} {why.replace('_', ' ')}" for why, count in came.items() if count]
        return f": {sum(came.values())} came and were refused ({', '.join(kinds)})" if kinds else ""

    def observe(self, tilt_x: float, tilt_y: float) -> None:
        """Check the tilt of a sample [rad]; a tilt that is not a number counts as beyond the hard stop."""
        if tilt_x * tilt_x + tilt_y * tilt_y <= self.limits.tilt_stop**2:
            self._beyond = 0
        elif self._running:
            self._beyond += 1
            if self._beyond >= STOP_SAMPLES and self.trip is None:
                tilt, stop = math.hypot(tilt_x, tilt_y), self.limits.tilt_stop
                self._trip(
                    GuardState.TILT_STOP,
                    f"tilt {math.degrees(tilt):.2f} deg, hard stop at {math.degrees(stop):.2f} deg",
                )

    @property
    def state(self) -> GuardState:
        """State of the guard, including events since the last `report`."""
        if self.trip is not None:
            return self.trip
        if not self._running:
            return GuardState.STOPPED
        if not self._commanded:
            return GuardState.WAITING
        if self._released:
            return GuardState.RELEASED
        limited, refused, held, _ = self._told
        if self.held_share > HELD_SHARE:
            return GuardState.HOLDING
        if sum(self.refused.values()) > refused:
            return GuardState.COMMAND_REFUSED
        if self.limited > limited:
            return GuardState.VOLTAGE_LIMITED
        return GuardState.HOLDING if self.held > held else GuardState.NORMAL

    @property
    def held_share(self) -> float:
        """Share of the samples since the last `report` for which the last voltages were held."""
        return (self.held - self._told[2]) / max(self._samples - self._told[3], 1)

    def report(self) -> GuardState:
        """Return the state, and start a new interval for the counts."""
        state = self.state
        self._told = (self.limited, sum(self.refused.values()), self.held, self._samples)
        return state

    def _trip(self, state: GuardState, reason: str) -> None:
        self.trip, self.reason = state, reason
        self._fresh = False
        self._voltages = (0.0, 0.0, self._voltages[2])
