"""The capability of a bench: voltages and rates at its speeds and its largest tilt, with usual air."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.reduction.segmentation import planned_windows
from gyrowheel_control.plans import demands
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import get

#: Effects of the air that are included, in their usual sizes.
AIR: Final = ("aero_restoring", "aero_cross", "windage")
_FAST: Final = 1000.0 * RPM  # a speed at which every hold has one window


@dataclass(frozen=True)
class SpeedReach:
    """Capability of a bench at one speed.

    Attributes
    ----------
    spin_rate : float
        [rad/s]
    momentum : float
        Angular momentum that a slow precession turns [N m s].
    slew : float
        Rate at which the coils can turn the upright rotor [rad/s]; 0 or less where there is nothing left for it.
    acceleration : float
        Acceleration that the motor can give [rad/s^2]; negative where the supply does not even hold the speed.
    coil_volts, coil_volts_air : float
        Voltage of the coils that holds the largest tilt [V], and the part of it that the air takes.
    motor_volts, motor_volts_air : float
        Voltage of the motor with the rotor upright, losses included [V], and the part of it that the air takes.
    nutation : float
        Frequency of the nutation [Hz].
    """

    spin_rate: float
    momentum: float
    slew: float
    acceleration: float
    coil_volts: float
    coil_volts_air: float
    motor_volts: float
    motor_volts_air: float
    nutation: float


@dataclass(frozen=True)
class Reach:
    """Capability of a bench at its lowest, its reference and its highest speed.

    Attributes
    ----------
    bench : Bench
        The bench.
    speeds : tuple of SpeedReach
        From the lowest on.
    top_speed : float
        The highest speed that the supply holds, air and bearing included [rad/s]; infinite where it is not the limit.
    largest_tilt : float
        The largest tilt that the coils hold at all speeds [rad], at most the hard stop.
    """

    bench: Bench
    speeds: tuple[SpeedReach, ...]
    top_speed: float
    largest_tilt: float


def reach(bench: Bench) -> Reach:
    """Return the capability of a bench by its torque balance; nothing is simulated."""
    v = bench.value
    low, top, reference = v("spin_rate_minimum"), v("spin_rate_maximum"), v("spin_rate_reference")
    rates = sorted({low, top, *([reference] if low < reference < top else [])})
    limit = v("tilt_limit")
    with_air, still = _holds(bench, rates, [0.0, limit], AIR), _holds(bench, rates, [0.0, limit], ())
    allowed = demands.COIL_SHARE * v("coil_voltage_limit")
    transverse = bench.transverse_inertia
    found = []
    for k, rate in enumerate(rates):
        coil, motor = with_air
        found.append(
            SpeedReach(
                spin_rate=rate,
                momentum=bench.precession_inertia * rate,
                slew=allowed * v("coil_constant") / (bench.precession_inertia * rate),
                acceleration=(demands.SUPPLY_SHARE * v("supply_voltage") - motor[k, 0])
                * v("motor_constant")
                / (v("motor_resistance") * bench.axial_inertia),
                coil_volts=float(coil[k, 1]),
                coil_volts_air=float(coil[k, 1] - still[0][k, 1]),
                motor_volts=float(motor[k, 0]),
                motor_volts_air=float(motor[k, 0] - still[1][k, 0]),
                nutation=bench.precession_inertia / transverse * rate / (2.0 * math.pi),
            )
        )
    most = max(own.coil_volts for own in found)
    return Reach(
        bench,
        tuple(found),
        _top_speed(found, demands.SUPPLY_SHARE * v("supply_voltage")),
        limit * min(1.0, allowed / most) if most > 0.0 else limit,
    )


def _holds(
    bench: Bench, rates: Sequence[float], tilts: Sequence[float], air: Sequence[str]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the voltages of coils and motor (speeds, tilts) that hold tilts about x at speeds [V]."""
    pairs = [[tilt / DEG, 0.0] for tilt in tilts]
    blocks = f"  - {{spin_rpm: {_FAST / RPM!r}, tilt_deg: {pairs}}}\n" * len(rates)
    windows = planned_windows(Plan.load(f"schema: 1\nname: reach\nhold_s: 2.0\nsegments:\n{blocks}"), bench)
    # a recording has no windows of a slow rotor, but its torques are known
    spin = windows.spin.copy()
    spin[:, 0] = np.repeat(rates, len(tilts))
    windows, values = replace(windows, spin=spin), bench.values()
    effects = [ActiveEffect(effect, effect.defaults()) for effect in (get(name, bench=bench) for name in air)]
    balance = Balance(windows, bench, harmonics=False)
    current = balance.predicted(values, effects)[balance.row("spin")] / bench.value("motor_constant")
    balance = Balance(replace(windows, motor_current=current), bench, harmonics=False)
    rows = balance.predicted(values, effects)
    shape = (len(rates), len(tilts))
    coil = np.hypot(rows[balance.row("tilt_x")], rows[balance.row("tilt_y")]) / bench.value("coil_constant")
    return coil.reshape(shape), np.asarray(rows[balance.row("motor_voltage")]).reshape(shape)


def _top_speed(speeds: Sequence[SpeedReach], allowed: float) -> float:
    """Return the speed at which the motor takes all that the supply allows; infinite beyond the highest one."""
    if speeds[-1].motor_volts <= allowed:
        return math.inf
    rates = [0.0, *(own.spin_rate for own in speeds)]
    volts = [0.0, *(own.motor_volts for own in speeds)]
    return float(np.interp(allowed, volts, rates))
