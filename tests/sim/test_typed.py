"""Effects typed in one line: what may be left out, what follows, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from gyrowheel.show.formulas import plain, pretty
from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects import Effect, effect_from_text
from gyrowheel_sim.effects.dimensions import Unit
from gyrowheel_sim.effects.law_code import array_law
from gyrowheel_sim.effects.quantities import QUANTITIES
from gyrowheel_sim.effects.user_defined_line import effect_to_line, typed_effect

from .every_effect import EACH


def values(effect: Effect) -> dict[str, complex]:
    """Return what the laws of an effect give at some instant, by target; coefficients differ from one another."""
    rng = np.random.default_rng(5)
    instant = {name: rng.uniform(0.5, 2.0) for name in QUANTITIES} | {"z": 0.3 + 0.2j, "z_rate": -0.4 + 0.1j}
    instant |= {state.name: 0.7 for state in effect.states}
    given = instant | {c: 0.6 + 0.13 * k for k, c in enumerate(sorted(x.name for x in effect.coefficients))}
    result: dict[str, complex] = {}
    for index, law in enumerate(effect.laws):
        result[law.target] = result.get(law.target, 0.0) + complex(array_law(effect, index)(given))
    return result


@EACH
def test_one_line_declarations_are_read_back(effect: Effect) -> None:
    line = effect_to_line(effect)
    assert "\n" not in line
    again = typed_effect(line, name="again")
    assert {c.name: c.unit for c in again.coefficients} == {c.name: c.unit for c in effect.coefficients}
    assert {c.name: c.shape for c in again.shapes} == pytest.approx({c.name: c.shape for c in effect.shapes})
    assert values(again) == pytest.approx(values(effect), rel=1e-12)


@EACH
def test_displayed_formulas_can_be_typed(effect: Effect) -> None:
    """Laws as the terminal prints them; units follow, only shapes must have their values, and of states their units."""
    shapes = "".join(
        f"; {c.name} = {c.shape} ± {c.shape_uncertainty}{f' [{c.unit}]' * bool(effect.states)}"
        for c in effect.shapes
    )
    again = typed_effect(plain(pretty(effect.formula)) + shapes, name="again")
    assert values(again) == pytest.approx(values(effect), rel=1e-12)
    declared = {c.name: c.unit for c in effect.coefficients}
    assert all((Unit.of(c.unit) / Unit.of(declared[c.name])).simple for c in again.coefficients)


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("-k*r**2*z", {"k": "N*m/rad"}),  # the example of the design
        ("-k*r^2*z; k", {"k": "N*m/rad"}),
        ("a + i*b", {"a": "N*m", "b": "N*m"}),
        ("-k*z - c*z_rate", {"k": "N*m/rad", "c": "N*m*s/rad"}),
        ("-k1*z - k2*z*|z|^2", {"k1": "N*m/rad", "k2": "N*m/rad^3"}),
        ("coil_gain = g*(T_coil - T_ref)", {"g": "1/K"}),
        ("shaft_torque = -T; torque = k*z; T [N*m]", {"T": "N*m", "k": "N*m/rad"}),
        ("tilt_reading = B_x + i*B_y", {"B_x": "rad", "B_y": "rad"}),
        ("a*exp(-((r - p)/w)^2)*z; p = 0.6 +- 0.05; w = 0.1 +- 0.02", {"a": "N*m/rad", "p": "1", "w": "1"}),
        ("-k*r^n*z; n = 2 +- 0.1", {"k": "N*m/rad", "n": "1"}),
        ("1e5*k*z", {"k": "N*m/rad"}),
        ("-k*(Ω/Ω₀)²·z·(T_coil - T₀)", {"k": "N*m/rad/K"}),
    ],
)
def test_units_follow_from_the_law(text: str, units: dict[str, str]) -> None:
    assert {c.name: c.unit for c in typed_effect(text, name="own").coefficients} == units


def test_names_and_targets_of_declarations() -> None:
    assert typed_effect("pull: -k*z").name == "pull"
    assert typed_effect("-k*z", name="pull").name == "pull"
    assert typed_effect("-k*z", otherwise="pull").name == "pull"
    assert typed_effect("drag: -w*r", target="axial_torque").laws[0].target == "axial_torque"
    assert typed_effect("drag: shaft_torque = -w*r", target="axial_torque").laws[0].target == "shaft_torque"
    whole = "pull: torque = -k*r*z; k = 0.02 [N*m/rad]"
    assert typed_effect(whole) == effect_from_text(whole)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "own.coefficients: missing"),
        ("-k*z*", "own.rotor_torque: column 6"),
        ("-k*Omgea*z", "own.rotor_torque: column 4: 'Omgea' is neither a quantity"),
        ("-k*foo*z", "own.rotor_torque: column 4: 'foo' is neither"),
        ("-kk*z", "own.rotor_torque: column 2: 'kk' is neither"),
        ("__import__('os').system('ls')", "own.rotor_torque: column 1: '__import__'"),
        ("k*z.__class__", "own.rotor_torque: column 4"),
        ("(" * 10_000, "10000 characters"),
        ("(" * 900, "own.rotor_torque: column 31"),
        ("-k*z; k [N*m*s]", "own.rotor_torque: column 1: '-k*z' has the unit N*m*s*rad; N*m is needed"),
        ("-k*z; k [mN*m]", "coefficients.k.unit: 'mN' is no SI unit"),
        ("-k*z - c*z_rate; k [N*m]; c [N*m]", "their units differ"),
        ("-k*q*z", "k and q multiply each other"),
        ("-k*r^n*z", "coefficients.n: the law is not linear in it: give its value"),
        ("-z", "own.coefficients: missing"),
        ("-k*z + 0.01", "own.rotor_torque: column 1: '-k*z + 0.01' has the unit 1; N*m is needed"),
        ("torqe = -k*z", "'torqe = -k*z' is neither a law nor a coefficient"),
        ("-k*z; torque = c*z", "rotor_torque is given twice"),
        ("-k*z; k [", "'k [' is neither a law nor a coefficient"),
        ("-k*z; k = nan", "'k = nan' is neither"),
        ("-k*z; k = 1e999", "coefficients.k.value"),
        ("k*z/0", "division by '0'"),
    ],
)
def test_errors_name_their_place(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        typed_effect(text, name="own", where="--formula")
    assert message in str(caught.value)
    assert str(caught.value).startswith("--formula: ")
    assert "\n" not in str(caught.value)


def test_a_typed_effect_has_exactly_one_name() -> None:
    with pytest.raises(InputError, match="the text names it 'pull', not 'push'"):
        typed_effect("pull: -k*z", name="push")
    with pytest.raises(InputError, match="needs a name"):
        typed_effect("-k*z")
    with pytest.raises(InputError, match="target 'rotor' is not known; allowed: rotor_torque"):
        typed_effect("-k*z", name="own", target="rotor")
