"""Formulas of users: what is read, what is refused and where, units, printing, and that they run as written."""

from __future__ import annotations

import dataclasses
import logging
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gyrowheel_analysis.diagnosis.unknown import forms
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects import (
    Effect,
    effect_from_mapping,
    effect_from_text,
    effect_to_mapping,
    parse_option,
    registry,
)
from gyrowheel_sim.effects.code import array_law, laws_source
from gyrowheel_sim.effects.dimensions import Unit, check_effect, check_unit
from gyrowheel_sim.effects.formula import parse, read
from gyrowheel_sim.effects.grammar import MAX_DEPTH, MAX_LENGTH
from gyrowheel_sim.effects.parts import COMPONENTS, ComplexArgumentError, split
from gyrowheel_sim.effects.printing import to_text
from gyrowheel_sim.effects.quantities import QUANTITIES, Omega, Omega_ref, rho, rho_ref, z, z_rate, z_ref
from gyrowheel_sim.plant.machine import plant_code, simulated_effects
from gyrowheel_sim.plant.outside import OUTSIDE
from gyrowheel_sim.plant.scenario import Scenario

from .helpers import BENCH

NAMES = ("a", "b", "k", "n", "p")
EVERY: list[Effect] = [*registry().values(), *OUTSIDE, *(t.effect for t in forms() if t.effect is not None)]
EACH = pytest.mark.parametrize("effect", EVERY, ids=lambda effect: effect.name)


def refusal(text: Any, *names: str) -> str:
    """Return the message with which a formula is refused, checked for its form."""
    began = time.monotonic()
    with pytest.raises(InputError) as caught:
        parse(text, names or NAMES, "model.yaml: torque")
    assert time.monotonic() - began < 1.0
    message = str(caught.value)
    assert message.startswith("model.yaml: torque: ")
    assert message.isprintable()
    assert len(message) < 400
    return message.removeprefix("model.yaml: torque: ")


def attempt(text: str) -> sp.Expr | str:
    """Return the expression, or the message with which the text is refused."""
    try:
        return parse(text, NAMES)
    except InputError as error:
        return str(error)


# --- reading -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "expression"),
    [
        ("-k*r^2*z", -sp.Symbol("k", real=True) * (Omega / Omega_ref) ** 2 * z),
        ("2^3^2/8", sp.Integer(64)),
        ("-2^2", sp.Integer(-4)),
        ("2^-1", sp.Rational(1, 2)),
        ("1-2-3", sp.Integer(-4)),
        ("12/2/3", sp.Integer(2)),
        ("2*-3", sp.Integer(-6)),
        ("--1", sp.Integer(1)),
        (" ( z ) ", z),
        ("i*i", sp.Integer(-1)),
        ("1.5e3", sp.Float(1500.0)),
        (".5", sp.Float(0.5)),
        ("abs(z)", sp.Abs(z)),
        ("|z|", sp.Abs(z)),
        ("re(z) + i*im(z_rate)", sp.re(z) + sp.I * sp.im(z_rate)),
        ("conj(z)", sp.conjugate(z)),
        ("max(re(z), 0)", sp.Max(sp.re(z), 0)),
        ("re(t)", sp.Symbol("t", real=True)),
        ("im(t)", sp.Integer(0)),
        ("cos(pi)", sp.Integer(-1)),
        # as the project shows formulas
        ("(Ω/Ω₀)²·z₀", (Omega / Omega_ref) ** 2 * z_ref),
        ("ρ⁻¹·ρ₀ − z'", rho_ref / rho - z_rate),
        ("z\u0304²", sp.conjugate(z) ** 2),
        ("(Ω/Ω₀)ⁿ⁻¹", (Omega / Omega_ref) ** (sp.Symbol("n", real=True) - 1)),
    ],
)
def test_what_a_formula_means(text: str, expression: sp.Expr) -> None:
    assert parse(text, NAMES) == expression


@pytest.mark.parametrize(
    ("text", "column", "what"),
    [
        ("__import__('os')", 1, "'__import__' is not a known function"),
        ("eval(z)", 1, "'eval' is not a known function"),
        ("z.real", 2, "'.' does not belong in a formula"),
        ("z[0]", 2, "'[' does not belong"),
        ("k; z", 2, "';' does not belong"),
        ("k\x00", 2, r"'\x00' does not belong"),
        ("lambda: k", 1, "'lambda' is neither a quantity nor a declared coefficient"),
        ("k*q*z", 3, "'q' is neither a quantity nor a declared coefficient"),
        ("k*Omeag", 3, "did you mean Omega"),
        ("k*inf", 3, "'inf' is neither"),
        ("k*nan", 3, "'nan' is neither"),
        ("k(z)", 2, "'k' is not a function: an operator is missing"),
        ("sqrt*z", 1, "sqrt needs its argument in brackets"),
        ("2z", 2, "an operator is missing before it"),
        ("k z", 3, "an operator is missing before it"),
        ("k*", 3, "the formula ends where"),
        ("*k", 1, "'*' stands where a number, a name or a bracket is expected"),
        ("(k", 1, "this bracket is never closed"),
        ("(k*(z)", 1, "this bracket is never closed"),
        ("|z", 1, "'|' is never closed"),
        ("k)", 2, "a bracket too many"),
        ("sin(k, k)", 1, "sin takes one argument, not 2"),
        ("max(k)", 1, "max needs two arguments or more"),
        ("1e999*z", 1, "the number 1e999 is out of range"),
        ("1e-400*z", 1, "is out of range"),
        ("k/0", 3, "division by '0', which is zero"),
        ("1/(t - t)", 3, "division by '(t - t)', which is zero"),
        ("log(t - t)", 1, "is not finite"),
        ("0^-1", 1, "is not finite"),
        ("9^9^9^9", 5, "the power '9^9' is out of range; allowed: -20 .. 20"),
        ("z^21", 3, "the power '21' is out of range"),
        ("z^i", 3, "the power 'i' is out of range"),
        ("k*exp(1000)", 3, "is not a finite number below 1e100"),
        ("exp(exp(exp(exp(9))))", 9, "is not a finite number below 1e100"),
        ("sqrt(z)", 6, "'z' is complex, but the argument of sqrt must be real: use abs, re or im"),
        ("max(z, 0)", 5, "'z' is complex, but the argument of max must be real"),
        ("z^k", 1, "'z' is complex, but the base of a power that is no whole number must be real"),
        ("k^z", 3, "'z' is complex, but an exponent must be real"),
        ("zⁿⁿ", 2, "'ⁿⁿ' is no exponent here"),
        ("1" * 200, 1, "a number of more than 100 digits"),
        ("k*z/min(1,0)", 5, "division by 'min(1,0)', which is zero"),
        ("k*z*max(-1,0)^-1", 5, "is not finite"),
        ("(" * 400 + "k" + ")" * 400, MAX_DEPTH + 1, "nested too deeply"),
        ("k^" * 300 + "k", 2 * MAX_DEPTH + 1, "nested too deeply"),
        ("-(" * 300 + "k" + ")" * 300, 2 * MAX_DEPTH + 1, "nested too deeply"),
    ],
)
def test_what_is_refused_and_where(text: str, column: int, what: str) -> None:
    message = refusal(text)
    assert message.startswith(f"column {column}: ")
    assert what in message


@pytest.mark.parametrize("text", ["(" * 10000 + ")" * 10000, "k+" * 10000 + "k", "9" * 10**6])
def test_a_long_formula_is_refused_at_once(text: str) -> None:
    assert f"allowed: up to {MAX_LENGTH}" in refusal(text)


@pytest.mark.parametrize("text", ["", "  \n", None, 5, ["z"], {"z": 1}])
def test_what_is_no_formula_is_refused(text: Any) -> None:
    assert "the formula is empty" in refusal(text) or "a text is expected" in refusal(text)


@pytest.mark.parametrize(
    "text",
    [
        "(1+z*" * 28 + "1" + ")" * 28,
        "*".join(f"(1+{n}*z)^19" for n in range(2, 60)),
        "re(" + "*".join(f"(1+{n}*z)^19" for n in range(2, 60)) + ")",
        "abs((1+z)^20*(1+conj(z))^20*(t+k*z)^19)",
        "conj(exp(" * 12 + "i*z" + "))" * 12,
    ],
)
def test_a_formula_that_would_take_ages_is_refused_at_once(text: str) -> None:
    assert "too complicated" in refusal(text)


@pytest.mark.parametrize(
    "text",
    [
        "tanh(" * 25 + "r" + ")" * 25,
        "sqrt(abs(z)+" * 25 + "r" + ")" * 25,
        "max(abs(z)-1," * 20 + "r" + ")" * 20,
        "exp(" + "+".join(f"sin({n}*r)" for n in range(60)) + ")",
        "+".join(f"abs(z-{n}*i)" for n in range(1, 60)),
    ],
)
def test_a_long_formula_is_declared_and_compiled_in_seconds(text: str) -> None:
    began = time.monotonic()
    unit = "1/rad" if "abs" in text and "r" not in text.replace("sqrt", "") else "1"
    effect = effect_from_mapping("long", {"coil_gain": f"k*({text})", "coefficients": {"k": unit}})
    assert "gain +=" in laws_source([effect])
    assert time.monotonic() - began < 10.0


@given(st.text(alphabet="kz+-*/^()|.,0123456789eri Ω²ⁿ_'\"[]{};:=abcmaxsqrtconj\n\t", max_size=60))
@settings(max_examples=300, deadline=2000)
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    found = attempt(text)
    if isinstance(found, str):
        assert "\n" not in found
        assert found.startswith("formula: ")


# --- printing ------------------------------------------------------------------------------------------------


def _longer(part: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    exponents = ["2", "3", "-1", "-2", "(1/2)", "(-3/2)", "0.5", "n", "(n - 1)", "-n", "(2*n)", "5"]
    return st.one_of(
        st.tuples(part, st.sampled_from([" + ", " - ", "*", "/"]), part).map("".join),
        part.map("({})".format),
        part.map("-{}".format),
        st.tuples(part, st.sampled_from(exponents)).map(lambda x: f"({x[0]})^{x[1]}"),
        st.tuples(st.sampled_from(["conj", "abs", "re", "im"]), part).map(lambda x: f"{x[0]}({x[1]})"),
        st.tuples(st.sampled_from(["sqrt", "exp", "log", "sin", "cos", "tanh", "sign"]), part).map(
            lambda x: f"{x[0]}(abs({x[1]}))"
        ),
        st.tuples(st.sampled_from(["max", "min"]), part, part).map(
            lambda x: f"{x[0]}(re({x[1]}), abs({x[2]}))"
        ),
    )


_QUANTITIES = [
    "z",
    "z_rate",
    "Omega",
    "Omega_ref",
    "r",
    "rho",
    "rho_ref",
    "t",
    "theta",
    "T_coil",
    "up",
    "z_ref",
]
_NUMBERS = ["0", "1", "2", "7", "12345678", "0.5", "1e-9", "2.50", "1e22", "i", "pi"]
formulas = st.recursive(st.sampled_from([*NAMES, *_QUANTITIES, *_NUMBERS]), _longer, max_leaves=25)


@pytest.mark.slow
@given(formulas)
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_what_is_printed_is_read_back(text: str) -> None:
    expression = attempt(text)
    if isinstance(expression, str):
        return  # complex where it must be real, or not finite
    again = attempt(to_text(expression))
    if isinstance(again, str):
        # multiplied out, a formula or a number in it can be longer than may be typed
        assert "too complicated" in again or "out of range" in again
    else:
        assert again == expression


@EACH
def test_the_formula_of_every_effect_can_be_typed_in(effect: Effect) -> None:
    names = [c.name for c in effect.coefficients]
    for part, law in zip(effect.formula.split("; "), effect.laws, strict=True):
        target, _, text = part.partition(" = ")
        assert target == law.target
        assert parse(text, names) == law.expression


def test_formulas_are_printed_as_one_would_write_them() -> None:
    written = {effect.name: effect.formula for effect in EVERY}
    assert written["aero_restoring"] == "rotor_torque = -k*(Omega/Omega_ref)^n*(rho/rho_ref)^(n - 1)*z"
    assert written["coil_heating"] == "coil_gain = a*(T_coil - T_ref)"
    assert written["fixed_torque"] == "rotor_torque = F_x + i*F_y"
    assert written["three_lobed"] == "rotor_torque = A*conj(z)^2/z_ref^2"
    assert to_text(parse("k/(2*n^2)*z - 3/4", NAMES)) == "k*z/(2*n^2) - 3/4"


# --- real and imaginary part, and code --------------------------------------------------------------------------


@given(formulas)
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_real_and_imaginary_part_are_those_of_the_formula(text: str) -> None:
    values = {
        "a": 0.7,
        "b": -1.3,
        "k": 0.9,
        "n": 2.05,
        "p": 0.6,
        "Omega": 310.0,
        "Omega_ref": 366.5,
        "rho": 1.1,
    }
    values |= {"rho_ref": 1.2, "t": 3.0, "theta": 0.03, "T_coil": 310.0, "up": -1.0, "z_ref": 0.05}
    components = {"zx": 0.02, "zy": -0.03, "zx_rate": 0.4, "zy_rate": 0.1}
    components |= {"up_x": 0.6, "up_y": -0.8, "home_xx": 0.8, "home_xy": 0.1, "home_yx": -0.2, "home_yy": 0.9}
    assert {s.name for pair in COMPONENTS.values() for s in pair} == set(components)
    expression = attempt(text)
    if isinstance(expression, str):
        return
    try:
        real, imaginary = split(expression)
    except ComplexArgumentError:
        return
    complex_ = {
        symbol.name: complex(*(components[part.name] for part in pair)) for symbol, pair in COMPONENTS.items()
    }

    def value(e: sp.Expr, given: dict[str, Any]) -> complex:
        return complex(e.evalf(30, subs={s: given[s.name] for s in e.free_symbols}))

    roots = [
        part.args[0]
        for part in sp.preorder_traversal(real + sp.I * imaginary)
        if part.func is sp.log or (part.is_Pow and not part.exp.is_Integer)
    ]
    try:
        if any(value(root, values | components).real <= 0.0 for root in roots):
            return  # a root of a negative number: no number in the simulation
        whole = value(expression, values | complex_)
        parts = value(real, values | components) + 1j * value(imaginary, values | components)
    except (TypeError, OverflowError, ZeroDivisionError):
        return  # not finite at this instant
    assert parts == pytest.approx(whole, rel=1e-6, abs=1e-9 * max(1.0, abs(whole)))


def test_a_declared_effect_runs_as_the_same_registered_one() -> None:
    values = {"k": 0.02, "n": 2.05}
    text = "own: torque = -k*(Ω/Ω₀)ⁿ·(ρ/ρ₀)ⁿ⁻¹·z; k = 0.02 [N*m/rad]; n = 2.05 ± 0.03 [1]"
    own = effect_from_text(text)
    plan = Plan.load("check")
    expected = simulate(BENCH, Scenario.nominal({"aero_restoring": values}), plan)
    found = simulate(BENCH, Scenario(effects={"own": values}, declared={"own": own}), plan)
    np.testing.assert_array_equal(found.measurement, expected.measurement)


def test_a_declared_effect_may_have_the_name_of_one_for_blind_tests() -> None:
    own = effect_from_text("contact: shaft_torque = -k*r; k [N*m]")
    effects = simulated_effects((own,))
    assert [e for e in effects if e.name == "contact"] == [own]
    assert plant_code((own,)) is not plant_code()


def test_coefficients_may_have_the_names_of_variables_in_the_code() -> None:
    names = ["x0", "coef", "active", "v0_0_0", "Tx", "math", "np"]
    law = " + ".join(f"{name}*re(z)*abs(z)" for name in names)
    own = effect_from_mapping(
        "own", {"coil_gain": law, "coefficients": {name: {"unit": "1/rad^2"} for name in names}}
    )
    assert "gain +=" in laws_source([own])
    values = {name: float(index) for index, name in enumerate(names)}
    z_now = np.array([0.03 + 0.04j])
    quantities = dict.fromkeys(QUANTITIES, 1.0)
    got = array_law(own, 0)({**quantities, "z": z_now, **values})
    assert got == pytest.approx(sum(values.values()) * 0.03 * 0.05)


# --- units ---------------------------------------------------------------------------------------------------


@EACH
def test_every_law_has_the_unit_of_what_it_acts_on(effect: Effect) -> None:
    check_effect(effect)
    # and the check can fail: with another unit of its first coefficient no law that has it passes
    first = effect.coefficients[0]
    other = dataclasses.replace(first, unit=f"{first.unit}*K")
    wrong = dataclasses.replace(effect, coefficients=(other, *effect.coefficients[1:]))
    with pytest.raises(InputError, match=f"{effect.name}."):
        check_effect(wrong)


@pytest.mark.parametrize(
    ("text", "unit", "message"),
    [
        ("k*z", "N*m", None),  # radians count as dimensionless
        ("k*z", "N*m/rad", None),
        ("k*z*z_rate/Omega", "N*m/rad^2", None),
        ("k*Omega^(3/2)*Omega^0.5", "N*m*s^2", None),
        ("k*sqrt(Omega)*sqrt(Omega)", "N*m*s", None),
        ("k*max(abs(z), 0)", "N*m/rad", None),
        ("k*exp(-z*conj(z)/z_ref^2)", "N*m", None),
        ("k*(1 + abs(z))", "N*m", None),
        ("k*z", "N", "column 1: 'k*z' has the unit N*rad; N*m is needed"),
        (
            "k*z + Omega",
            "N*m",
            "column 7: 'k*z' [N*m*rad] and 'Omega' [rad/s] cannot be added: their units differ",
        ),
        ("k*(z + Omega)", "N*m", "column 8: 'z' [rad] and 'Omega' [rad/s] cannot be added"),
        (
            "k*exp(Omega)",
            "N*m",
            "column 7: 'Omega' has the unit rad/s; the argument of exp must be a pure number",
        ),
        ("k*r^t", "N*m", "column 5: 't' has the unit s; an exponent must be a pure number"),
        ("k*Omega^n", "N*m", "column 3: 'Omega' has the unit rad/s; with the exponent 'n' it must be"),
        ("k*max(t, abs(z))", "N*m", "column 10: 't' [s] and 'abs(z)' [rad] cannot be compared"),
        ("k*(T_coil - 20)", "N*m/K", "column 13: 'T_coil' [K] and '20' [1] cannot be added"),
    ],
)
def test_units_are_checked(text: str, unit: str, message: str | None) -> None:
    formula = read(text, NAMES)
    units = {"k": unit, "n": "1"}
    if message is None:
        check_unit(formula, units, "N*m")
        return
    with pytest.raises(InputError) as caught:
        check_unit(formula, units, "N*m")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["N*m/rad", "kg/m^3", "1", "1/K", "N*m*s/rad", "ohm", "rad/s"])
def test_units_are_printed_so_that_they_are_read_back(text: str) -> None:
    unit = Unit.of(text)
    assert Unit.of(str(unit)) == unit


@pytest.mark.parametrize(
    "text",
    ["mN*m", "rpm", "deg", "degC", "N m", "furlong", "", "9**9**9", "N^99", "N*(m)", "/s", "__class__", None],
)
def test_units_beyond_plain_si_are_refused(text: Any) -> None:
    with pytest.raises(InputError, match=r"is no (SI )?unit"):
        Unit.of(text)


# --- declarations --------------------------------------------------------------------------------------------


def declaration(**changes: Any) -> dict[str, Any]:
    base: dict[str, Any] = {
        "torque": "-k*r^2*z",
        "coefficients": {"k": {"unit": "N*m/rad", "usual": [0.01, 0.05]}},
    }
    return {key: value for key, value in {**base, **changes}.items() if value is not ...}


def test_a_declaration_in_full() -> None:
    effect = effect_from_mapping(
        "stator_pull",
        declaration(
            title="pull of the stator",
            category="motor",
            sentence="The stator pulls.",
            axial_torque="-m*r",
            coefficients={
                "k": {"unit": "N*m/rad", "usual": [0.01, 0.05], "bounds": [-0.5, 0.5], "description": "pull"},
                "m": {"unit": "N*m", "usual": [1e-4, 1e-3], "bounds": [0, 0.1], "source": "guessed"},
            },
            look_alikes={"aero_restoring": "low pressure"},
        ),
    )
    assert effect.formula == "rotor_torque = -k*Omega^2*z/Omega_ref^2; axial_torque = -m*Omega/Omega_ref"
    assert (effect.title, effect.category, effect.look_alikes) == (
        "pull of the stator", "motor", {"aero_restoring": "low pressure"},
    )  # fmt: skip
    k, m = effect.coefficients
    assert (k.unit, k.usual, k.bounds, k.signed, k.shape) == (
        "N*m/rad",
        (0.01, 0.05),
        (-0.5, 0.5),
        True,
        None,
    )
    assert (m.bounds, m.signed, m.source) == ((0.0, 0.1), False, "guessed")


@EACH
def test_a_declaration_is_written_and_read_back(effect: Effect) -> None:
    name = effect.name
    assert effect_from_mapping(name, effect_to_mapping(effect)) == effect


def test_what_shapes_a_law_is_told_from_its_size() -> None:
    text = "own: shaft_torque = -A*exp(-((r - p)/w)^2); w = 0.1 +- 0.02 [1]; p = 0.6 ± 0.05 [1]; A [N*m]"
    effect = effect_from_text(text)
    assert [c.name for c in effect.amplitudes] == ["A"]
    assert [(c.name, c.shape, c.shape_uncertainty) for c in effect.shapes] == [
        ("w", 0.1, 0.02),
        ("p", 0.6, 0.05),
    ]
    assert effect.coefficients[0].name == "A"
    assert effect.shapes[0].bounds[0] > 0.0, "a width must not become zero"


def test_a_usual_size_is_found_where_none_is_given() -> None:
    (k,) = effect_from_text("own: torque = -k*z; k [N*m/rad]").coefficients
    # a torque of a few tenths of a millinewton metre at a tilt of 3 deg
    assert 0.9e-4 < k.usual[0] * 0.05 < k.usual[1] * 0.05 < 3e-3
    assert k.bounds[0] < -k.usual[1] < k.usual[1] < k.bounds[1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"torque": ...}, "own: a law is missing; allowed: torque, rotor_torque"),
        ({"torque": 5}, "own.torque: 5 is not a formula"),
        ({"torqe": "k*z"}, "own.torqe: no such field; did you mean torque?"),
        ({"rotor_torque": "k*z"}, "own.rotor_torque: torque and rotor_torque are the same"),
        ({"torque": "-k*r^2*z*q"}, "own.torque: column 10: 'q' is neither"),
        ({"torque": "-k*t*z"}, "own.torque: column 1: '-k*t*z' has the unit N*m*s; N*m is needed"),
        (
            {"torque": ..., "axial_torque": "k*z"},
            "own.axial_torque: column 1: axial_torque is real, but the formula",
        ),
        ({"torque": "k*theta"}, "only flexure_torque has them"),
        ({"torque": "k*z/abs(z)*z_ref"}, "own: rotor_torque is not finite at rest (z = 0, t = 0)"),
        ({"torque": "k*sqrt(r + k)*z", "coefficients": {"k": {"unit": "1", "value": 1.0}}}, "own"),
        ({"category": "magic"}, "own.category: 'magic' is not known; allowed: air"),
        ({"title": ["x"]}, "own.title: ['x'] is not a text"),
        ({"look_alikes": "x"}, "own.look_alikes: a mapping"),
        ({"coefficients": ...}, "own.coefficients: missing"),
        ({"coefficients": {}}, "own.coefficients: missing"),
        ({"coefficients": {"k": 5}}, "own.coefficients.k: 5 is not a unit or a mapping"),
        ({"coefficients": {"k": None}}, "own.coefficients.k.unit: missing; N*m/rad would fit"),
        (
            {"coefficients": {"k": {"unit": "mN*m"}}},
            "own.coefficients.k.unit: 'mN' is no SI unit without prefix",
        ),
        (
            {"coefficients": {"k": {"unit": "N*m", "ussual": [1, 2]}}},
            "k.ussual: no such field; did you mean usual?",
        ),
        ({"coefficients": {"k": {"unit": "N*m", "usual": [1]}}}, "k.usual: [1] is not a pair of numbers"),
        ({"coefficients": {"k": {"unit": "N*m", "usual": [2, 1]}}}, "k.usual: [2, 1] is empty"),
        ({"coefficients": {"k": {"unit": "N*m", "usual": [-1, 1]}}}, "k.usual: -1 is out of range"),
        (
            {"coefficients": {"k": {"unit": "N*m", "usual": [1, float("inf")]}}},
            "k.usual.1: inf is not finite",
        ),
        ({"coefficients": {"k": {"unit": "N*m", "value": float("nan")}}}, "k.value: nan is not finite"),
        ({"coefficients": {"k": {"unit": "N*m", "value": "much"}}}, "k.value: 'much' is not a number"),
        ({"coefficients": {"k": {"unit": "N*m", "value": True}}}, "k.value: True is not a number"),
        ({"coefficients": {"k": {"unit": "N*m", "bounds": [1, 2]}}}, "k.bounds: 1 .. 2 leave out 0"),
        ({"coefficients": {"k": {"unit": "N*m", "possible": [1, 2]}}}, "k.possible: 1 .. 2 leave out 0"),
        ({"greatest": -1}, "own.greatest: -1 is out of range; allowed: > 0"),
        (
            {"coefficients": {"k": {"unit": "N*m", "signed": "yes"}}},
            "k.signed: 'yes' is neither true nor false",
        ),
        ({"coefficients": {"k": "N*m", "m": "N*m"}}, "own.coefficients.m: not used in any law"),
        ({"coefficients": {"z": "N*m"}}, "own.coefficients.z: the name is taken"),
        ({"coefficients": {"i": "N*m"}}, "own.coefficients.i: the name is taken"),
        ({"coefficients": {"zx": "N*m"}}, "own.coefficients.zx: the name is taken"),
        ({"coefficients": {"a b": "N*m"}}, "'a b' is no name of a coefficient"),
        ({"coefficients": {5: "N*m"}}, "5 is no name of a coefficient"),
        ({"coefficients": {f"k{n}": "N*m" for n in range(20)}}, "20 coefficients; allowed: up to 12"),
        (
            {"torque": "k*m*z", "coefficients": {"k": "N*m", "m": "1"}},
            "k and m multiply each other; give all but one of them a value with an uncertainty",
        ),
        ({"torque": "k*r^n*z", "coefficients": {"k": "N*m", "n": "1"}}, "n: the law is not linear in it"),
        (
            {"torque": "k*z + 0.1*z*up*m", "coefficients": {"k": "1", "m": "1"}},
            "has the unit rad; N*m is needed",
        ),
        (
            {
                "torque": "k*z + 0.1*m*r*z_ref",
                "coefficients": {"k": "N*m", "m": {"unit": "N*m", "value": 1, "uncertainty": 1}},
            },
            "own: every term of a law needs a factor that switches it off",
        ),
    ],
)
def test_a_bad_declaration_is_refused_with_the_field(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        effect_from_mapping("own", declaration(**changes), "own")
    assert message in str(caught.value)
    assert str(caught.value).startswith("own")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", ["", "a b", "1a", "a\nb", "x" * 50, "stiffness_error", 5])
def test_names_that_no_effect_can_have(name: Any) -> None:
    with pytest.raises(InputError):
        effect_from_mapping(name, declaration())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("torque = k*z", "has no name; expected NAME: TARGET = FORMULA"),
        ("own: k*z", "'k*z' is neither a law nor a coefficient"),
        ("own: torque = k*z; torque = k; k [N*m]", "torque is given twice"),
        ("own: torque = k*z; k [N*m]; k [N*m]", "the coefficient k is given twice"),
        ("own: torque = k*z; k", "own.coefficients.k.unit: missing; N*m/rad would fit"),
        ("own: torque = k*z", "own.coefficients: missing"),
    ],
)
def test_a_bad_line_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        effect_from_text(text, "--formula")
    assert message in str(caught.value)
    assert str(caught.value).startswith("--formula: ")


def test_coefficients_of_a_declared_effect_are_options_too() -> None:
    own = effect_from_text("own: torque = -k*z; k = 0.02 [N*m/rad]")
    assert parse_option("own:k=0.03", {"own": own}) == ("own", {"k": 0.03})
    with pytest.raises(InputError, match="out of range"):
        parse_option("own:k=1e9", {"own": own})


def test_a_scenario_keeps_its_declarations(tmp_path: Path) -> None:
    own = effect_from_text("own: torque = -k*z; k = 0.02 [N*m/rad]")
    scenario = Scenario(effects={"own": {"k": 0.03}}, noise_seed=3, declared={"own": own})
    scenario.save(tmp_path / "s.json")
    assert Scenario.load(tmp_path / "s.json", BENCH) == scenario
    text = (tmp_path / "s.json").read_text().replace("-k*z", "-k*__import__")
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(InputError, match=r"declared\.own\.rotor_torque: column 4"):
        Scenario.load(tmp_path / "bad.json", BENCH)


# --- effects of other packages -----------------------------------------------------------------------------------


@pytest.fixture
def distribution(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder of installed packages; the registry is read again before and after."""
    monkeypatch.syspath_prepend(str(tmp_path))
    registry.cache_clear()
    yield tmp_path
    monkeypatch.undo()
    registry.cache_clear()


def install(folder: Path, name: str, source: str, points: dict[str, str]) -> None:
    (folder / f"{name}.py").write_text(textwrap.dedent(source))
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = "".join(f"{point} = {value}\n" for point, value in points.items())
    (info / "entry_points.txt").write_text(f"[gyrowheel.effects]\n{lines}")


def test_effects_of_another_package_are_registered(distribution: Path) -> None:
    source = """
        from gyrowheel_sim.effects import effect_from_text
        PULL = effect_from_text("plugin_pull: torque = -k*z; k = 0.01 [N*m/rad]")
        MORE = [effect_from_text("plugin_drag: shaft_torque = -m*r; m [N*m]")]
    """
    install(distribution, "gw_plugin", source, {"pull": "gw_plugin:PULL", "more": "gw_plugin:MORE"})
    assert {"plugin_pull", "plugin_drag", "windage"} <= set(registry())
    assert parse_option("plugin_pull:k=0.02") == ("plugin_pull", {"k": 0.02})


#: A package with two effects, the second of which has a law of a wrong unit.
WRONG_UNIT = """
import sympy as sp
from gyrowheel_sim.effects import Coefficient, Effect, Law, effect_from_text
from gyrowheel_sim.effects.quantities import Omega, Omega_ref, z
k = sp.Symbol("k", real=True)
EFFECT = [
    effect_from_text("gw_good: torque = -k*z; k [N*m/rad]"),
    Effect(
        name="gw_pull", title="pull", category="other", sentence="It pulls.",
        laws=(Law("rotor_torque", -k * Omega * z),),
        coefficients=(Coefficient("k", "N*m/rad", "size", (0.01, 0.05), (-0.5, 0.5), "assumed"),),
        validity="everywhere", source="assumed",
    ),
]
"""


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("raise RuntimeError('broken')", "broken"),
        ("EFFECT = 5", "not iterable"),
        ("EFFECT = ['windage']", "is no Effect"),
        (
            "from gyrowheel_sim.effects.library.air import WINDAGE as EFFECT",
            "taken",
        ),
        ("OTHER = 1", "EFFECT"),
        (WRONG_UNIT, "gw_pull.rotor_torque: column 1: '-k*Omega*z' has the unit N*m*rad/s; N*m is needed"),
        (WRONG_UNIT.replace("Omega * ", "sp.sinh(Omega/Omega_ref) * "), "'sinh' is not a known function"),
        (WRONG_UNIT.replace('"rotor_torque"', '"coil_gain"'), "gw_pull.coil_gain: column 1"),
    ],
    ids=["raises", "number", "strings", "taken", "missing", "unit", "function", "target"],
)
def test_a_broken_package_is_skipped_with_a_warning(
    source: str,
    reason: str,
    distribution: Path,
    caplog: pytest.LogCaptureFixture,
    request: pytest.FixtureRequest,
) -> None:
    name = f"gw_broken_{request.node.callspec.id}"
    install(distribution, name, source, {"broken": f"{name}:EFFECT"})
    with caplog.at_level(logging.WARNING):
        assert set(registry()) == {effect.name for effect in EVERY[: len(registry())]}
    (record,) = caplog.records
    assert name in record.getMessage()
    assert reason in record.getMessage()


def test_a_declaration_in_python_is_checked_too() -> None:
    windage = registry()["windage"]
    coefficient = dataclasses.replace(windage.coefficients[0], name="r")
    with pytest.raises(ValueError, match="which is taken"):
        dataclasses.replace(windage, coefficients=(coefficient,), laws=())
