"""Segments of a plan, what they demand of a bench, and which demands exceed its limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment


@dataclass(frozen=True)
class Segment:
    """One ramp to a state and the steady motion after it [SI]."""

    #: Start time, time of the ramp, and time of the steady motion [s].
    start: float
    ramp: float
    hold: float
    #: Tilt angles phi_x + i phi_y before and after the ramp [rad].
    tilt_from: complex
    tilt: complex
    #: Spin rate before and after the ramp, and at the end of the steady motion [rad/s].
    spin_from: float
    spin: float
    spin_end: float
    #: Rate at which the tilt turns about the case axis during the steady motion [rad/s]; 0 for a hold.
    cone_rate: float
    environment: Environment  # the environment in which it runs
    label: str
    block: int = 0  # number of the block of the plan file that it comes from

    @property
    def end(self) -> float:
        """End time [s]."""
        return self.start + self.ramp + self.hold


#: Share of the coils' range for slewing and holding; the rest is for damping the nutation.
COIL_SHARE: Final = 0.75
#: Usual tilt limit over the largest tilt of the bench: 3 deg of 5 deg on the default one.
USUAL_SHARE: Final = 0.6
#: Share of the supply voltage for the motor.
SUPPLY_SHARE: Final = 0.95


class Excess(NamedTuple):
    """A demand of a segment that exceeds a bench."""

    segment: int
    key: str
    """Kind of the demand: ``spin``, ``tilt``, ``slew`` or ``acceleration``."""
    said: str
    """Value and allowed range, in words."""


def holding_torque(bench: Bench, spin_rate: float, tilt: float) -> float:
    """Return the torque of the detuned flexures at a tilt [N m].

    `spin_rate`: spin rate [rad/s]; `tilt`: tilt [rad].
    """
    return abs(bench.flexure_stiffness - 0.5 * bench.tuning_inertia * spin_rate * spin_rate) * tilt


def slew_rate(s: Segment) -> float:
    """Return the rate at which the tilt of a segment turns in space, on its ramp or on its cone [rad/s]."""
    rate = abs(s.tilt - s.tilt_from) / s.ramp
    rate = max(rate, abs(s.cone_rate) * abs(s.tilt))
    # a turning case takes the torque of a tilt that turns in a case at rest
    return rate + table_rate(s)


def table_rate(s: Segment) -> float:
    """Return the part of it that the rate table gives [rad/s]."""
    return abs(s.environment.table_rate * s.environment.up_across)


def top_speed(s: Segment) -> float:
    """Return the highest spin rate of a segment [rad/s]."""
    return max(s.spin_from, s.spin, s.spin_end)


def held_torque(bench: Bench, s: Segment) -> float:
    """Return the largest torque with which the coils hold the flexures during a segment [N m]."""
    return max(
        holding_torque(bench, w, max(abs(s.tilt), abs(s.tilt_from)))
        for w in (s.spin_from, s.spin, s.spin_end)
    )


def coil_volts(bench: Bench, s: Segment) -> float:
    """Return the voltage of the coils that slewing and holding take in a segment [V]."""
    torque = bench.precession_inertia * top_speed(s) * slew_rate(s) + held_torque(bench, s)
    return torque / bench.value("coil_constant")


def spin_acceleration(s: Segment) -> float:
    """Return the largest acceleration of a segment [rad/s^2]."""
    return max(abs(s.spin - s.spin_from) / s.ramp, abs(s.spin_end - s.spin) / s.hold)


def motor_volts(bench: Bench, spin_rate: float, acceleration: float) -> float:
    """Return the voltage of the motor for a speed [rad/s] and an acceleration [rad/s^2], losses aside [V]."""
    v = bench.value
    return v("motor_constant") * spin_rate + v("motor_resistance") * bench.axial_inertia * acceleration / v(
        "motor_constant"
    )


def possible_slew(bench: Bench, s: Segment, share: float = 1.0, table: float = 1.0) -> float:
    """Return the rate of the tilt that the coils can follow in a segment [rad/s]; 0 or less where there is none.

    `s`: the segment, whose speed, tilts and rate table count, not its own rates; `share`: part of what the
    coils may give; `table`: part of the rate of the table.
    """
    v = bench.value
    torque = share * COIL_SHARE * v("coil_voltage_limit") * v("coil_constant") - held_torque(bench, s)
    return torque / (bench.precession_inertia * top_speed(s)) - table * table_rate(s)


def possible_acceleration(bench: Bench, s: Segment, share: float = 1.0) -> float:
    """Return the acceleration that the motor can follow at the top speed of a segment [rad/s^2]."""
    v = bench.value
    left = SUPPLY_SHARE * v("supply_voltage") - motor_volts(bench, top_speed(s), 0.0)
    return share * left * v("motor_constant") / (v("motor_resistance") * bench.axial_inertia)


def excesses(segments: Sequence[Segment], bench: Bench) -> Iterator[Excess]:
    """Yield the demands of segments beyond a bench: tilt, speed, voltages for slewing and spin-up."""
    v = bench.value
    low, high, tilt_limit = v("spin_rate_minimum"), v("spin_rate_maximum"), v("tilt_limit")
    allowed = COIL_SHARE * v("coil_voltage_limit"), SUPPLY_SHARE * v("supply_voltage")
    for index, s in enumerate(segments):
        for spin in dict.fromkeys((s.spin, s.spin_end)):
            if not low * (1 - 1e-9) <= spin <= high * (1 + 1e-9):
                yield Excess(
                    index,
                    "spin",
                    f"spin {spin / RPM:.0f} rpm is beyond the bench; "
                    f"allowed: {low / RPM:.0f} .. {high / RPM:.0f} rpm",
                )
        if abs(s.tilt) > tilt_limit * (1 + 1e-9):
            yield Excess(
                index,
                "tilt",
                f"tilt {abs(s.tilt) / DEG:.2f} deg is beyond the bench; "
                f"allowed: up to {tilt_limit / DEG:.2f} deg",
            )
        top, rate, volts = top_speed(s), slew_rate(s), coil_volts(bench, s)
        if volts > allowed[0]:
            yield Excess(
                index,
                "slew",
                f"slewing at {rate / DEG:.1f} deg/s and {top / RPM:.0f} rpm needs {volts:.1f} V of the "
                f"coils; allowed: {allowed[0]:.1f} V",
            )
        acceleration = spin_acceleration(s)
        volts = motor_volts(bench, top, acceleration)
        if volts > allowed[1]:
            yield Excess(
                index,
                "acceleration",
                f"{acceleration / RPM:.0f} rpm/s at {top / RPM:.0f} rpm needs {volts:.1f} V of the motor; "
                f"allowed: {allowed[1]:.1f} V",
            )
