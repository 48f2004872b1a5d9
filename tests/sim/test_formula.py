"""Formulas of users: what is read, what is refused and where, and how they are printed."""

from __future__ import annotations

from typing import Any

import pytest
import sympy as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects import (
    Effect,
    effect_from_mapping,
)
from gyrowheel_sim.effects.complex_parts import COMPONENTS, ComplexArgumentError, split
from gyrowheel_sim.effects.formula import parse, to_text
from gyrowheel_sim.effects.grammar import MAX_DEPTH, MAX_LENGTH
from gyrowheel_sim.effects.law_code import laws_source
from gyrowheel_sim.effects.quantities import Omega, Omega_ref, rho, rho_ref, z, z_rate, z_ref

from .every_effect import EACH, EVERY

NAMES = ("a", "b", "k", "n", "p")


def refusal(text: Any, *names: str) -> str:
    """Return the message with which a formula is refused, checked for its form."""
    with pytest.raises(InputError) as caught:
        parse(text, names or NAMES, "model.yaml: torque")
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
def test_formula_values(text: str, expression: sp.Expr) -> None:
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
def test_invalid_formula_is_refused_with_its_column(text: str, column: int, what: str) -> None:
    message = refusal(text)
    assert message.startswith(f"column {column}: ")
    assert what in message


@pytest.mark.parametrize("text", ["(" * 10000 + ")" * 10000, "k+" * 10000 + "k", "9" * 10**6])
def test_a_long_formula_is_refused_at_once(text: str) -> None:
    assert f"allowed: up to {MAX_LENGTH}" in refusal(text)


@pytest.mark.parametrize("text", ["", "  \n", None, 5, ["z"], {"z": 1}])
def test_text_that_is_no_formula_is_refused(text: Any) -> None:
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
def test_a_formula_of_unbounded_cost_is_refused_at_once(text: str) -> None:
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
def test_a_long_formula_is_declared_and_compiled(text: str) -> None:
    """It ends; where expanding it would take for ever, so would this test."""
    unit = "1/rad" if "abs" in text and "r" not in text.replace("sqrt", "") else "1"
    effect = effect_from_mapping("long", {"coil_gain": f"k*({text})", "coefficients": {"k": unit}})
    assert "gain +=" in laws_source([effect])


@given(st.text(alphabet="kz+-*/^()|.,0123456789eri Ω²ⁿ_'\"[]{};:=abcmaxsqrtconj\n\t", max_size=60))
@settings(max_examples=300, deadline=None)
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
def test_printed_formulas_are_read_back(text: str) -> None:
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
def test_the_printed_formula_of_every_effect_is_read_back(effect: Effect) -> None:
    names = [c.name for c in effect.coefficients] + [state.name for state in effect.states]
    # whether a name stands for a real or a complex number is declared elsewhere
    real = {state.symbol: sp.Symbol(state.name, real=True) for state in effect.states}
    declared = [(law.target, law.expression) for law in effect.laws]
    for state in effect.states:
        declared.append((f"d({state.name})/dt", state.rate))
        declared += [(f"{state.name}(0)", state.start)] if state.start != 0 else []
    for part, (target, expression) in zip(effect.formula.split("; "), declared, strict=True):
        printed, _, text = part.partition(" = ")
        assert printed == target
        assert parse(text, names) == expression.xreplace(real)


def test_formulas_are_printed_in_usual_notation() -> None:
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
    components = {"Vx": 3.0, "Vy": -2.0, "zx": 0.02, "zy": -0.03, "zx_rate": 0.4, "zy_rate": 0.1}
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
