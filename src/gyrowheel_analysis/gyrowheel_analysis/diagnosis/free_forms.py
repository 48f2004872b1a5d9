"""The family of free forms: formulas for an effect that no declaration describes.

The family has torques that depend on any multiple of the tilt's azimuth and any power of tilt and speed, on a power of
the tilt rate, bumps, resonances and changes at one speed, dead zones in the tilt, torques that decay with time, gains
of coils, motor and tilt sensors that depend on the speed or on the square of a warming, tilt readings whose zero
depends on the speed, torques in proportion to a temperature or to the motor's current, torques on the spin that depend
on the direction of the tilt, and coils whose torque is not in proportion to their voltage, turns with the speed, or
brakes the spin. `further_forms` has gains and tilt readings that depend on a temperature, the current or the tilt,
torques of the coils with any multiple of the direction of their voltage or with its amount by axis, torques that grow
with the time, others that depend on the tilt rate, torques that turn with the rotor, and torques of the flexures by
their angle and rate. Where the air changes, `air_forms` has torques that its density multiplies. Where laws with a
memory are candidates, torques, stiffnesses and gains of coils may lag behind the tilt, the speed or the temperature of
the coils, and the motion of the tilt may pull a torque along.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Collection, Mapping
from dataclasses import replace

import sympy as sp

from gyrowheel_analysis.criteria import EXPONENT_CLOSE, EXPONENT_KNOWN, EXPONENT_WITHIN
from gyrowheel_analysis.fitting.fit import Term
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law, LawState
from gyrowheel_sim.effects.quantities import (
    QUANTITIES,
    Omega,
    Omega_ref,
    T_air,
    T_coil,
    T_motor,
    T_ref,
    T_winding,
    V_coil,
    i_motor,
    rho,
    rho_ref,
    theta,
    theta_rate,
    theta_z,
    z,
    z_rate,
    z_ref,
)
from gyrowheel_sim.effects.targets import TARGETS

_EXPONENT = 1.0  # prior deviation of an exponent
_IS_EXPONENT = "exponent of the "
_TINY = sp.Float(1e-9)  # keeps powers of a vanishing tilt finite

_a, _b, _p, _w, _k, _q, _s, _m = (sp.Symbol(name, real=True) for name in "abpwkqsm")
_t = QUANTITIES["t"].symbol
_r = Omega / Omega_ref
_u = z / z_ref
_square = z * sp.conjugate(z) / z_ref**2
_size = sp.sqrt(z * sp.conjugate(z)) / z_ref
_TURNING = Omega_ref / 250  # angular rate at which a tilt usually goes round
_swift = z_rate * sp.conjugate(z_rate) / (z_ref * _TURNING) ** 2


#: Usual sizes of a free form: on rotor and shaft, in proportion to the tilt rate, to a temperature, and of a gain.
_SIZES = {
    "rotor_torque": (1.0e-4, 2.0e-3), "rate": (2.0e-2, 0.4), "warming": (1.0e-5, 2.0e-4), "gain": (2.0e-3, 0.05),
    "coils": (5.0e-5, 1.0e-3), "current": (1.0e-4, 1.0e-2),
    "offset": (1.0e-4, 2.0e-3),
    "gain_warming": (1.0e-4, 5.0e-3), "gain_current": (5.0e-3, 0.5), "volts": (2.0e-4, 5.0e-3),
    "cube": (2.0e-6, 5.0e-5), "time": (5.0e-7, 1.0e-5),
    "gain_time": (1.0e-5, 1.0e-3), "gain_volt": (5.0e-4, 0.02),
    "per_volt": (2.0e-5, 1.0e-3), "square": (1.0e-6, 5.0e-5), "warming_square": (2.0e-5, 5.0e-4),
}  # fmt: skip
_UNITS = {
    "warming": "N*m/K", "current": "N*m/A", "gain_warming": "1/K", "gain_current": "1/A", "gain": "1",
    "volts": "1/V^2", "cube": "N*m/V^3", "time": "N*m/s", "gain_time": "1/s", "gain_volt": "1/V", "offset": "rad",
    "per_volt": "N*m/V", "square": "N*m/V^2", "warming_square": "1/K^2",
}  # fmt: skip
_SIZE = (5.0e-5, 1.0e-3)
_LARGEST = 20.0  # usual sizes: the least bound of a free form


def _amplitude(name: str, kind: str) -> Coefficient:
    size = _SIZES.get(kind, _SIZE)
    text = "size at the reference tilt and speed"
    widest = max(_LARGEST * size[1], 1.0)
    return Coefficient(name, _UNITS.get(kind, "N*m"), text, size, (-widest, widest), "fitted", signed=True)


def _form(
    name: str,
    sentence: str,
    target: str,
    shape: sp.Expr,
    *shapes: Coefficient,
    sized: str = "",
    state: LawState | None = None,
    direction: sp.Expr | None = None,
) -> Term:
    """Return a free form; a real target may have a part by each axis of a complex `direction`, times the shape."""
    across = TARGETS[target].complex
    law = (_a + sp.I * _b) * shape if across else _a * shape
    if direction is not None:
        law = (_a * sp.re(direction) + _b * sp.im(direction)) * shape
    names = ("a", "b") if across or direction is not None else ("a",)
    amplitudes = [_amplitude(own, sized or target) for own in names]
    name = name.replace(".", "_")
    effect = Effect(
        name=name,
        title="free form",
        category="other",
        sentence=sentence,
        laws=(Law(target, law),),
        coefficients=(*amplitudes, *shapes),
        validity="the range of the recording",
        source="proposed from the recording",
        states=(state,) if state else (),
    )
    return Term(name, effect)


def _shape(
    name: str, value: float, spread: float, description: str, bounds: tuple[float, float] = (0.01, 3.0)
) -> Coefficient:
    usual = (value - spread, value + spread)
    return Coefficient(name, "1", description, usual, bounds, "fitted", shape=value, shape_uncertainty=spread)


def _at(what: str, centre: float) -> Coefficient:
    return _shape("p", centre, 0.05, f"speed of the {what} over the reference speed")


def _exponent(name: str, value: float, of: str) -> Coefficient:
    # a torque may fall with the speed, but none is infinite at an upright rotor
    bounds = (-4.0 if of == "speed" else 0.0, 8.0)
    return _shape(name, value, _EXPONENT, f"{_IS_EXPONENT}{of}", bounds)


_OF_SPEED, _OF_TILT = ("spin_rate_reference", "rad/s"), ("tilt_reference", "rad")
#: Coefficients that are shares of a reference: edges, centres and widths, by the kind of the form.
_PLACES = {
    "tilt_bump": {"p": _OF_SPEED, "w": _OF_SPEED},
    "resonance": {"p": _OF_SPEED},
    "mirrored_resonance": {"p": _OF_SPEED},
    "spin_bump": {"p": _OF_SPEED, "w": _OF_SPEED},
    "tilt_beyond": {"p": _OF_SPEED, "w": _OF_SPEED},
    "spin_beyond": {"p": _OF_SPEED, "w": _OF_SPEED},
    "dead_zone": {"p": _OF_TILT},
    "pulled": {"p": _OF_TILT},
}

#: Kinds of forms that may act through the air; a drag along the spin axis is like windage (`like`).
_IN_AIR = {
    "lobes", "power", "fixed_tilt", "fixed_power", "rate", "spin_power", "spin_tilt", "axial_tilt", "spin_rate",
    "axial_rate",
}  # fmt: skip


def _scale(name: str, unit: str, description: str, value: float, bounds: tuple[float, float]) -> Coefficient:
    usual = (0.5 * value, 2.0 * value)
    return Coefficient(
        name, unit, description, usual, bounds, "fitted", shape=value, shape_uncertainty=0.5 * value
    )


def _time(description: str, value: float) -> Coefficient:
    return _scale("s", "s", description, value, (1.0, 1.0e4))


def _direction(order: int) -> str:
    """Return a multiple of the direction of the tilt in words."""
    return "the direction of the tilt" if order == 1 else f"{order} times the direction of the tilt"


@functools.cache
def forms() -> tuple[Term, ...]:
    """Return the family of free forms; exponents, edges, places and times in them are fitted."""
    result = []
    of_speed, of_tilt = "speed", "tilt"
    for order in (-3, -2, -1, 2, 3):
        direction = _u**order if order > 0 else sp.conjugate(_u) ** (-order)
        for q in (0, 2):
            text = f"torque with {order} times the direction of the tilt, |tilt|^{abs(order)}, speed^q"
            name, power = f"lobes_{order}_{q}".replace("-", "m"), _exponent("q", q, of_speed)
            result.append(_form(name, text, "rotor_torque", direction * _r**_q, power))
    for k, q in ((1, 1), (1, 3), (1, 4), (0, 0), (0, 2), (2, 0), (2, 2), (3, 1), (5, 0), (5, 2)):
        exponents = _exponent("k", k, of_tilt), _exponent("q", q, of_speed)
        shape = _u * (_square + _TINY) ** ((_k - 1) / 2) * _r**_q
        text = "torque along or across the tilt, |tilt|^k, speed^q"
        result.append(_form(f"power_{k}_{q}", text, "rotor_torque", shape, *exponents))
    mirrored = sp.conjugate(_u)
    resonates = "torque of a part that resonates near one speed, in proportion to"
    for centre in (0.3, 0.37, 0.45, 0.53, 0.6, 0.68, 0.76, 0.84, 0.92, 1.0, 1.08):
        around = _shape("w", 0.12, 0.03, "width of the bump over the reference speed")
        bump = sp.exp(-(((_r - _p) / _w) ** 2)), _at("bump", centre), around
        during = _shape("w", 0.03, 0.03, "width of the change over the reference speed", (0.003, 0.5))
        beyond = 1 / (1 + sp.exp((_p - _r) / _w)), _at("change", centre), during
        damping = _shape("w", 0.05, 0.03, "damping of the resonance over the critical one", (0.005, 0.5))
        answer = 1 / (1 - (_r / _p) ** 2 + 2 * sp.I * _w * _r / _p), _at("resonance", centre), damping
        for name, text, target, (shape, *shapes), direction in (
            ("tilt_bump", "torque along the tilt near one speed", "rotor_torque", bump, _u),
            ("spin_bump", "torque on the spin near one speed", "shaft_torque", bump, sp.S.One),
            ("tilt_beyond", "torque in proportion to the tilt beyond one speed", "rotor_torque", beyond, _u),
            ("spin_beyond", "torque on the spin beyond one speed", "shaft_torque", beyond, sp.S.One),
            ("resonance", f"{resonates} the tilt", "rotor_torque", answer, _u),
            # one that resonates about one axis only answers to the mirrored tilt as well
            ("mirrored_resonance", f"{resonates} the mirrored tilt", "rotor_torque", answer, mirrored),
        ):
            result.append(_form(f"{name}_{centre:g}", text, target, shape * direction, *shapes))
    for edge in (0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65):
        zone = sp.Max(_size - _p, 0) * _u / (_size + sp.Float(1e-9))
        begins = _shape("p", edge, 0.04, "tilt where it begins over the reference tilt")
        text = "torque along the tilt beyond an edge"
        result.append(_form(f"dead_zone_{edge:g}", text, "rotor_torque", zone, begins))
    for q in (0, 2):
        exponents = _exponent("k", 2, of_tilt), _exponent("q", q, of_speed)
        shape = (_square + _TINY) ** (_k / 2) * _r**_q
        text = "torque in a direction that is fixed in the case, |tilt|^k, speed^q"
        result.append(_form(f"fixed_tilt_{q}", text, "rotor_torque", shape, *exponents))
    for q in (1, 2, 3):
        power = _exponent("q", q, of_speed)
        text = "torque in a direction that is fixed in the case, speed^q"
        result.append(_form(f"fixed_power_{q}", text, "rotor_torque", _r**_q, power))
    for k, q in ((1, 0), (1, 2), (2, 0)):
        exponents = _exponent("k", k, "tilt rate"), _exponent("q", q, of_speed)
        shape = z_rate / (z_ref * Omega_ref) * (_swift + _TINY) ** ((_k - 1) / 2) * _r**_q
        text = "torque along or across the tilt rate, |tilt rate|^k, speed^q"
        result.append(_form(f"rate_{k}_{q}", text, "rotor_torque", shape, *exponents, sized="rate"))
    for q in (1, 3, 4):
        power = _exponent("q", q, of_speed)
        result.append(_form(f"spin_power_{q}", "torque on the shaft, speed^q", "shaft_torque", _r**_q, power))
        text = "torque along the spin axis, speed^q"
        result.append(_form(f"axial_power_{q}", text, "axial_torque", _r**_q, power))
    for q in (0, 2):
        exponents = _exponent("k", 2, of_tilt), _exponent("q", q, of_speed)
        shape = (_square + _TINY) ** (_k / 2) * _r**_q
        text = "torque on the spin, |tilt|^k, speed^q"
        result.append(_form(f"spin_tilt_{q}", text, "shaft_torque", shape, *exponents))
    for order, turn in ((1, _u), (2, _u**2)):
        text = f"torque on the spin with {_direction(order)}, |tilt|^{order}, speed^q"
        power = _exponent("q", 0, of_speed)
        result.append(_form(f"spin_lobes_{order}", text, "shaft_torque", _r**_q, power, direction=turn))
    for name, target, shape, text in (
        ("coil_gain", "coil_gain", sp.S.One, "change of the torque per volt of the coils"),
        ("motor_gain", "motor_gain", sp.S.One, "change in torque and voltage constant of the motor"),
        ("resistance", "winding_resistance", sp.S.One, "change in the resistance of the motor's winding"),
        ("tilt_gain", "tilt_reading", z, "error of the tilt readings in proportion to the tilt"),
    ):
        law = shape * _r**_q
        result.append(
            _form(f"{name}_1", f"{text}, speed^q", target, law, _exponent("q", 1, of_speed), sized="gain")
        )
    text, power = "error of the zero of the tilt readings, speed^q", _exponent("q", 2, of_speed)
    result.append(_form("tilt_zero_2", text, "tilt_reading", _r**_q, power, sized="offset"))
    for name, cause, what in (
        ("coils", T_coil - T_ref, "temperature of the coils"),
        ("motor", T_motor - T_ref, "temperature of the motor"),
        ("current", i_motor, "current of the motor"),
    ):
        where = f"to the {what}, speed^q"
        for kind, text, target, shape in (
            (
                "fixed",
                "torque in a direction that is fixed in the case, in proportion",
                "rotor_torque",
                sp.S.One,
            ),
            ("tilt", "torque in proportion to the tilt and", "rotor_torque", _u),
            ("spin", "torque on the spin in proportion", "shaft_torque", sp.S.One),
        ):
            if (kind, name) == ("spin", "current"):
                continue  # the constant of the motor
            law, power = cause * shape * _r**_q, _exponent("q", 0, of_speed)
            sized = "current" if name == "current" else "warming"
            result.append(_form(f"{kind}_by_{name}", f"{text} {where}", target, law, power, sized=sized))
    for target, warmth, text in (
        (
            "coil_gain",
            T_coil - T_ref,
            "change of the torque per volt of the coils with the square of their warming",
        ),
        ("motor_gain", T_motor - T_ref, "change of the motor's constant with the square of its warming"),
        (
            "winding_resistance",
            T_winding - T_ref,
            "change in the resistance of the motor's winding with the square of its warming",
        ),
    ):
        result.append(_form(f"{target}_warming", text, target, warmth**2, sized="warming_square"))
    law, power = V_coil * _r**_q, _exponent("q", 1, of_speed)
    text = "torque of the coils along or across that of their voltage, speed^q"
    result.append(_form("coil_turn_1", text, "rotor_torque", law, power, sized="per_volt"))
    for name, law, of, sized in (
        ("coil_brake_amount", sp.Abs(V_coil), "amount", "per_volt"),
        ("coil_brake", V_coil * sp.conjugate(V_coil), "square", "square"),
    ):
        text, power = (
            f"torque on the spin with the {of} of the coils' voltage, speed^q",
            _exponent("q", 0, of_speed),
        )
        result.append(_form(f"{name}_0", text, "shaft_torque", law * _r**_q, power, sized=sized))
    each = [f(V_coil) for f in (sp.re, sp.im)]
    for width in (0.03, 0.3):
        bends = _scale("w", "V", "voltage within which it changes its sign", width, (1.0e-3, 2.0))
        law = V_coil / sp.sqrt(V_coil * sp.conjugate(V_coil) + _w**2)
        text = "torque by the direction of the coils' voltage"
        result.append(_form(f"coil_offset_{width:g}", text, "rotor_torque", law, bends, sized="coils"))
        turned = [v / sp.sqrt(v**2 + _w**2) for v in each]
        text = "torque of each coil pair by the sign of its voltage"
        law = turned[0] + sp.I * turned[1]
        result.append(_form(f"coil_crossover_{width:g}", text, "rotor_torque", law, bends, sized="coils"))
    text = "change of the torque per volt of the coils with the square of their voltage"
    result.append(_form("coil_saturation", text, "coil_gain", V_coil * sp.conjugate(V_coil), sized="volts"))
    text = "torque of each coil pair in proportion to the cube of its voltage"
    law = each[0] ** 3 + sp.I * each[1] ** 3
    result.append(_form("coil_cube", text, "rotor_torque", law, sized="cube"))
    for time in (15.0, 40.0, 120.0):
        fades = _time("time in which it fades", time)
        fading = sp.exp(-_t / _s)
        text = "torque on the spin that fades with the time since the start of the recording"
        result.append(_form(f"spin_fading_{time:g}", text, "shaft_torque", fading, fades))
        text = "torque in proportion to the tilt that fades with the time since the start of the recording"
        result.append(_form(f"tilt_fading_{time:g}", text, "rotor_torque", _u * fading, fades))
    return tuple(result)


@functools.cache
def further_forms() -> tuple[Term, ...]:
    """Return the free forms that are compared where the others may not suffice (`unknown.search`)."""
    result = []
    of_tilt = (_square + _TINY) ** (_k / 2) * _r**_q
    for name, target, unit, text in (
        ("coil_gain", "coil_gain", sp.S.One, "change of the torque per volt of the coils"),
        (
            "coil_mirror",
            "coil_anisotropy",
            sp.S.One,
            "difference between the torque per volt of the two coil axes",
        ),
        ("motor_gain", "motor_gain", sp.S.One, "change in torque and voltage constant of the motor"),
        ("resistance", "winding_resistance", sp.S.One, "change in the resistance of the motor's winding"),
        ("tilt_gain", "tilt_reading", z, "error of the tilt readings in proportion to the tilt and"),
    ):
        for cause, of, what, sized in (
            ("coils", T_coil - T_ref, "to the temperature of the coils", "gain_warming"),
            ("motor", T_motor - T_ref, "to the temperature of the motor", "gain_warming"),
            ("current", i_motor, "to the current of the motor", "gain_current"),
        ):
            power = _exponent("q", 0, "speed")
            words = f"{text} {'' if unit is z else 'in proportion '}{what}, speed^q"
            law = unit * of * _r**_q
            result.append(_form(f"{name}_by_{cause}", words, target, law, power, sized=sized))
        exponents = _exponent("k", 2, "tilt"), _exponent("q", 0, "speed")
        words = f"{text.removesuffix(' and')}, |tilt|^k, speed^q"
        result.append(_form(f"{name}_of_tilt", words, target, unit * of_tilt, *exponents, sized="gain"))
        for order in (-3, -2, -1, 1, 2, 3) if unit is z else (-2, -1, 1, 2):
            if not TARGETS[target].complex and order < 0:
                continue  # real and imaginary part have both signs
            if name == "tilt_gain" and order == 1:
                continue  # the gain itself
            turn = _u**order if order > 0 else sp.conjugate(_u) ** (-order)
            words = "error of the tilt readings" if unit is z else text
            words = f"{words} with {_direction(order)}, |tilt|^{abs(order)}, speed^q"
            law, power = _r**_q, _exponent("q", 0, "speed")
            own, direction = (
                f"{name}_lobes_{order}".replace("-", "m"),
                None if TARGETS[target].complex else turn,
            )
            if direction is None:
                law = law * turn * (z_ref if unit is z else 1)
            result.append(_form(own, words, target, law, power, sized="gain", direction=direction))
    for order in (-3, -2, 0, 2, 3):
        law = V_coil**order if order > 0 else sp.conjugate(V_coil) ** (-order)
        if order == 0:
            law = V_coil * sp.conjugate(V_coil)
        text = f"torque with {order} times the direction of the coils' voltage, |voltage|^{abs(order) or 2}, speed^q"
        name, sized = f"coil_lobes_{order}".replace("-", "m"), "cube" if abs(order) == 3 else "square"
        power = _exponent("q", 0, "speed")
        result.append(_form(name, text, "rotor_torque", law * _r**_q, power, sized=sized))
    each = [f(V_coil) for f in (sp.re, sp.im)]
    for width in (0.03, 0.3):
        # what follows the amount of a voltage is blurred by its ripple
        bends = _scale("w", "V", "voltage within which it turns", width, (1.0e-3, 2.0))
        even = [sp.sqrt(v**2 + _w**2) - _w for v in each]
        text = "torque of each coil pair with the amount of its voltage, the same for either sign"
        law = even[0] + sp.I * even[1]
        result.append(_form(f"coil_even_{width:g}", text, "rotor_torque", law, bends, sized="per_volt"))
    for name, text, target, shape, q in (
        (
            "fixed_by_time",
            "torque in a direction that is fixed in the case, in proportion",
            "rotor_torque",
            sp.S.One,
            1,
        ),
        ("tilt_by_time", "torque in proportion to the tilt and", "rotor_torque", _u, 0),
        ("spin_by_time", "torque on the spin in proportion", "shaft_torque", sp.S.One, 1),
        (
            "coil_gain_by_time",
            "change of the torque per volt of the coils in proportion",
            "coil_gain",
            sp.S.One,
            0,
        ),
        (
            "motor_gain_by_time",
            "change in torque and voltage constant of the motor in proportion",
            "motor_gain",
            sp.S.One,
            0,
        ),
    ):
        words = f"{text} to the time since the start of the recording, speed^q"
        law, power = _t * shape * _r**_q, _exponent("q", q, "speed")
        sized = "gain_time" if TARGETS[target].unit == "1" else "time"
        result.append(_form(f"{name}_{q}", words, target, law, power, sized=sized))
    # a rotor that turns bends its flexures to and fro by the tilt
    text, bent = "torque of each flexure by its rate, |rate|^k", theta_rate / (z_ref * Omega_ref)
    law = bent * (bent**2 + _TINY) ** ((_k - 1) / 2)
    result.append(_form("flexure_rate", text, "flexure_torque", law, _exponent("k", 2, "rate")))
    for width in (0.5, 5.0):
        text = "dry friction of each flexure"
        bends = _scale("w", "rad/s", "rate within which it changes its sign", width, (1.0e-2, 100.0))
        law = theta_rate / sp.sqrt(theta_rate**2 + _w**2)
        result.append(_form(f"flexure_friction_{width:g}", text, "flexure_torque", law, bends))
    text, power = (
        "torque in a direction that turns with the rotor, |tilt rate|^k, speed^q",
        _exponent("q", 0, "speed"),
    )
    law = sp.exp(sp.I * theta_z) * (_swift + _TINY) ** (_k / 2) * _r**_q
    result.append(_form("turning_rate", text, "rotor_torque", law, _exponent("k", 1, "tilt rate"), power))
    text = "change of the torque per volt of the coils with the direction of their voltage"
    result.append(_form("coil_sided", text, "coil_gain", sp.S.One, sized="gain_volt", direction=V_coil))
    text = "torque of each flexure with the square of its angle"
    result.append(_form("flexure_square", text, "flexure_torque", (theta / z_ref) ** 2))
    exponents = _exponent("k", 2, "tilt"), _exponent("q", 0, "speed")
    text = "torque in a direction that turns with the rotor, |tilt|^k, speed^q"
    result.append(_form("turning", text, "rotor_torque", sp.exp(sp.I * theta_z) * of_tilt, *exponents))
    power, at_rate = _exponent("q", 1, "speed"), z_rate / (z_ref * Omega_ref)
    text = "torque along or across the tilt rate, |tilt|^k, speed^q"
    exponents = _exponent("k", 1, "tilt"), power
    result.append(_form("rate_of_tilt", text, "rotor_torque", at_rate * of_tilt, *exponents, sized="rate"))
    text, law = "torque with -1 times the direction of the tilt rate, speed^q", sp.conjugate(at_rate) * _r**_q
    result.append(_form("rate_mirror", text, "rotor_torque", law, power, sized="rate"))
    for name, target, text in (
        ("spin", "shaft_torque", "torque on the spin"),
        ("axial", "axial_torque", "torque along the spin axis"),
    ):
        words, law = f"{text}, |tilt rate|^k, speed^q", (_swift + _TINY) ** (_k / 2) * _r**_q
        exponents = _exponent("k", 1, "tilt rate"), power
        result.append(_form(f"{name}_rate", words, target, law, *exponents))
    text, exponents = "torque along the spin axis, |tilt|^k, speed^q", (_exponent("k", 2, "tilt"), power)
    result.append(_form("axial_tilt", text, "axial_torque", of_tilt, *exponents))
    return tuple(result)


@functools.cache
def memory_forms() -> tuple[Term, ...]:
    """Return the free forms with a state; the time or way over which they remember is fitted, too."""
    result = []
    m, late = sp.Symbol("m", complex=True), sp.Symbol("m", real=True)
    power = _exponent("q", 0, "speed")
    for part in (0.3, 1.0):
        way = _shape("p", part, 0.5 * part, "way over which the pull builds up, over the reference tilt")
        state = LawState("m", "1", (z_rate - m * sp.Abs(z_rate)) / (_p * z_ref), complex=True)
        text = "torque that the motion of the tilt pulls along, speed^q"
        result.append(_form(f"pulled_{part:g}", text, "rotor_torque", m * _r**_q, way, power, state=state))
    for time in (15.0, 60.0):
        # what warms behind the coils has the temperature of the air at first
        lag = _time("time by which it warms behind the coils", time)
        state = LawState("m", "K", (T_coil - T_air - late) / _s)
        for name, text, target, shape in (
            ("tilt_warming", "torque in proportion to the tilt and to a temperature", "rotor_torque", _u),
            ("spin_warming", "torque on the spin in proportion to a temperature", "shaft_torque", sp.S.One),
        ):
            text, law = f"{text} that lags behind that of the coils", late * shape
            result.append(_form(f"{name}_{time:g}", text, target, law, lag, sized="warming", state=state))
    for time in (4.0, 30.0):
        lag = _time("time by which it lags", time)
        state = LawState("m", "1", (_u - m) / _s, _u, complex=True)
        text = "torque that lags behind the tilt, speed^q"
        result.append(_form(f"tilt_lag_{time:g}", text, "rotor_torque", m * _r**_q, power, lag, state=state))
        # a bearing that was at rest has another state than one that runs
        begun = _shape("p", 0.5, 0.5, "state at the start over that of a long run", (-1.0, 2.0))
        of_tilt = (_square + _TINY) ** (_k / 2) * _r**_q
        for drives, behind, drive, exponents in (
            ("lag", "speed^q", _r**_q, (_exponent("q", 1, "speed"),)),
            ("tilt_lag", "|tilt|^k, speed^q", of_tilt, (_exponent("k", 2, "tilt"), power)),
        ):
            state = LawState("m", "1", (drive - late) / _s, _p * drive)
            for changes, text, target, law, sized in (
                ("spin", "torque on the spin", "shaft_torque", late, ""),
                (
                    "stiffness",
                    "torque along or across the tilt, of a stiffness",
                    "rotor_torque",
                    late * _u,
                    "",
                ),
                ("fixed", "torque in a direction that is fixed in the case", "rotor_torque", late, ""),
                ("coil_gain", "change of the torque per volt of the coils", "coil_gain", late, "gain"),
            ):
                name, text = f"{changes}_{drives}_{time:g}", f"{text} that lags behind {behind}"
                shapes = (*exponents, lag, begun)
                result.append(_form(name, text, target, law, *shapes, sized=sized, state=state))
    return tuple(result)


@functools.cache
def air_forms() -> tuple[Term, ...]:
    """Return forms of the others that the density of the air multiplies; its exponent is fitted, too."""
    result = []
    for term in (*forms(), *further_forms()):
        effect = term.effect
        if effect is None or kind_of(term.name) not in _IN_AIR:
            continue
        (law,) = effect.laws
        own = replace(
            effect,
            name=f"air_{effect.name}",
            sentence=f"{effect.sentence}, density^m",
            laws=(replace(law, expression=law.expression * (rho / rho_ref) ** _m),),
            coefficients=(*effect.coefficients, _density(1.0)),
        )
        result.append(Term(own.name, own))
    return tuple(result)


def _density(power: float) -> Coefficient:
    return _shape("m", power, 0.5, f"{_IS_EXPONENT}density", (-4.0, 8.0))


def like(effect: Effect, shapes: Collection[str], name: str) -> Effect:
    """Return a form with the law of an effect, but some of its shapes free, and any exponent of the air's density."""
    free = tuple(_freed(c) if c.name in shapes else c for c in effect.coefficients)
    form = _with_density(replace(effect, coefficients=free))
    powers = [c for c in form.shapes if c.description.startswith(_IS_EXPONENT)]
    but = ", ".join(f"{c.description.removeprefix(_IS_EXPONENT)}^{c.name}" for c in powers)
    return replace(
        form,
        name=name,
        sentence=f"like {effect.name} ({effect.title}), but {but or 'with another ' + ' and '.join(shapes)}",
        validity="the range of the recording",
        source="proposed from the recording",
    )


def _freed(shape: Coefficient) -> Coefficient:
    """Return a shape as any value within its bounds; that of an effect of the air is an exponent of the speed."""
    low, high = shape.bounds
    of_speed = shape.description.startswith(_IS_EXPONENT)
    text = f"{_IS_EXPONENT}speed" if of_speed else shape.description
    return replace(shape, description=text, source="fitted", shape_uncertainty=(high - low) / 4.0)


def _with_density(effect: Effect) -> Effect:
    """Return an effect with one law that depends on the density, with a separate exponent of it; others as they are."""
    law, *others = effect.laws
    usual = {c.symbol: c.default for c in effect.coefficients}
    power = sp.simplify(rho * sp.diff(law.expression, rho) / law.expression).subs(usual)
    if others or _m in usual or not power.is_number or power == 0:
        return effect
    law = replace(law, expression=law.expression.subs(rho, rho_ref) * (rho / rho_ref) ** _m)
    return replace(effect, laws=(law,), coefficients=(*effect.coefficients, _density(float(power))))


def kind_of(name: str) -> str:
    """Return the kind of a free form by its name: without the numbers at which its fit begins."""
    return re.sub(r"(_m?\d+)+$", "", name)


def whole_exponents(effect: Effect, found: Mapping[str, tuple[float, float]]) -> dict[str, int]:
    """Return the exponents of a form as whole numbers, where every one is known well and whole within its error.

    `found` has the value and standard error of its coefficients.
    """
    whole = {}
    for c in effect.coefficients:
        if c.description.startswith(_IS_EXPONENT):
            value, error = found[c.name]
            number = round(value)
            off = abs(value - number)
            if not error < EXPONENT_KNOWN or off > max(EXPONENT_WITHIN * error, EXPONENT_CLOSE):
                return {}
            whole[c.name] = number
    return whole


def with_exponents(effect: Effect, whole: Mapping[str, int]) -> Effect:
    """Return a form as the simple law with these exponents."""
    values = {sp.Symbol(name, real=True): sp.Integer(number) for name, number in whole.items()}
    # a whole power of the tilt from the first on is finite where the tilt vanishes, without the tiny constant
    without = {_TINY: sp.Integer(0)} if whole.get(_k.name, 1) > 0 else {}

    def simple(expression: sp.Expr) -> sp.Expr:
        return expression.subs(values).subs(without)

    return replace(
        effect,
        laws=tuple(replace(law, expression=simple(law.expression)) for law in effect.laws),
        states=tuple(replace(s, rate=simple(s.rate), start=simple(s.start)) for s in effect.states),
        coefficients=tuple(c for c in effect.coefficients if c.name not in whole),
    )


def places(term: Term, bench: Bench) -> dict[str, tuple[float, str]]:
    """Return the unit, by size and name, of edges, centres and widths of a free form, shares of a reference."""
    names = _PLACES.get(kind_of(term.name), {})
    return {name: (bench.value(reference), unit) for name, (reference, unit) in names.items()}
