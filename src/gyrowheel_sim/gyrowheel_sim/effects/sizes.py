"""Usual sizes of effects on benches other than the default one, for which they are declared.

A small rotor on soft flexures has small effects. Sizes are carried over by their units: torques go with the torque that
the flexures give at the reference tilt, angles with that tilt, rates with the reference speed.
"""

from __future__ import annotations

import functools
from dataclasses import replace

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.dimensions import Unit


def for_bench(effect: Effect, bench: Bench) -> Effect:
    """Return an effect with the usual sizes and bounds that it has on a bench; on the default bench, the effect itself.

    Coefficients that shape a law keep theirs, unless they have a unit: an exponent is the same for every size.
    """
    return _sized(effect, _scales(bench))


def torque_scale(bench: Bench) -> float:
    """Return the torque of the flexures at the reference tilt over that of the default bench."""
    return _scales(bench)[0]


@functools.cache
def _default() -> Bench:
    return Bench.load()


def _measures(bench: Bench) -> tuple[float, float, float, float]:
    """Return what sizes go with: torque [N m], tilt [rad], spin rate [rad/s] and current of the motor [A]."""
    v = bench.value
    tilt = v("tilt_reference")
    torque = 0.5 * (v("flexure_stiffness_x") + v("flexure_stiffness_y")) * tilt
    return torque, tilt, v("spin_rate_reference"), torque / v("motor_constant")


def _scales(bench: Bench) -> tuple[float, float, float, float]:
    own, default = _measures(bench), _measures(_default())
    return (own[0] / default[0], own[1] / default[1], own[2] / default[2], own[3] / default[3])


@functools.lru_cache(maxsize=1024)
def _sized(effect: Effect, scales: tuple[float, float, float, float]) -> Effect:
    if scales == (1.0, 1.0, 1.0, 1.0):
        return effect
    coefficients = []
    for c in effect.coefficients:
        factor = _factor(c.unit, scales)
        low, high = c.usual
        coefficients.append(
            replace(
                c,
                usual=(low * factor, high * factor),
                bounds=(c.bounds[0] * factor, c.bounds[1] * factor),
                shape=None if c.shape is None else c.shape * factor,
                shape_uncertainty=c.shape_uncertainty * factor,
                possible=None if c.possible is None else (c.possible[0] * factor, c.possible[1] * factor),
            )
        )
    if effect.greatest is None:
        return replace(effect, coefficients=tuple(coefficients))
    return replace(
        effect,
        coefficients=tuple(coefficients),
        greatest=effect.greatest * _factor(effect.amplitudes[0].unit, scales),
    )


def _factor(unit: str, scales: tuple[float, float, float, float]) -> float:
    """Return by how much a coefficient of a unit is larger than on the default bench."""
    torque, tilt, rate, current = scales
    parsed = Unit.of(unit)
    powers = {name: float(power) for name, power in parsed.dimension.items()}
    mass, length = powers.pop("[mass]", 0.0), powers.pop("[length]", 0.0)
    time, amperes = powers.pop("[time]", 0.0), powers.pop("[current]", 0.0)
    # not made of torques, inertias, angles and times: nothing of the bench scales it
    if length != 2.0 * mass or (mass == 0.0 and time < 0.0):
        return 1.0
    # kg m^2 is torque over rate squared, a second is one over the rate
    return (
        (torque / rate**2) ** mass
        * rate**-time
        * current**amperes
        * tilt ** float(parsed.powers.get("radian", 0))
    )
