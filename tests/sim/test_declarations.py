"""Effects that a user declares: what is taken, what is refused, and that they run as any other."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

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
from gyrowheel_sim.effects.law_code import array_law, laws_source
from gyrowheel_sim.effects.quantities import QUANTITIES
from gyrowheel_sim.plant.compiled import Further
from gyrowheel_sim.plant.machine import Machine, compiled_effects, simulated_effects
from gyrowheel_sim.plant.scenario import Scenario

from .every_effect import EACH
from .helpers import BENCH


def declaration(**changes: Any) -> dict[str, Any]:
    base: dict[str, Any] = {
        "torque": "-k*r^2*z",
        "coefficients": {"k": {"unit": "N*m/rad", "usual": [0.01, 0.05]}},
    }
    return {key: value for key, value in {**base, **changes}.items() if value is not ...}


def test_a_complete_declaration_is_read() -> None:
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


def test_shape_coefficients_are_distinguished_from_amplitudes() -> None:
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
def test_reserved_effect_names_are_refused(name: Any) -> None:
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


# --- they run as any other


@pytest.mark.study  # test_effects.py compares compiled and declared laws
def test_a_declared_effect_runs_as_the_same_registered_one() -> None:
    values = {"k": 0.02, "n": 2.05}
    text = "own: torque = -k*(Ω/Ω₀)ⁿ·(ρ/ρ₀)ⁿ⁻¹·z; k = 0.02 [N*m/rad]; n = 2.05 ± 0.03 [1]"
    own = effect_from_text(text)
    plan = Plan.load("check")
    expected = simulate(BENCH, Scenario.nominal({"aero_restoring": values}), plan)
    found = simulate(BENCH, Scenario(effects={"own": values}, declared={"own": own}), plan)
    np.testing.assert_array_equal(found.measurement, expected.measurement)


def test_a_declared_effect_joins_the_compiled_plant() -> None:
    own = effect_from_text("own: torque = -k*z*r; k [N*m]")
    scenario = Scenario(effects={"own": {"k": 1e-4}}, declared={"own": own})
    machine = Machine(BENCH, scenario, initial_spin_rate=300.0)
    assert machine.compiled == compiled_effects()
    assert [place for place in Further if machine.laws[2][place]] == [Further.evaluate_laws]


def test_a_declared_effect_may_have_the_name_of_one_for_blind_tests() -> None:
    own = effect_from_text("contact: shaft_torque = -k*r; k [N*m]")
    effects = simulated_effects((own,))
    assert [e for e in effects if e.name == "contact"] == [own]
    machine = Machine(BENCH, Scenario(declared={"contact": own}), initial_spin_rate=300.0)
    assert "contact" not in {effect.name for effect in machine.compiled}


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


#: What the sentence of an effect says where its coefficient is negative, and where it is positive.
SAID = {
    "coil_tilt": ("less torque", "more torque"),
    "coil_heating": ("less torque", "more torque"),
    "motor_heating": ("less torque per ampere", "grow"),
    "cubic_stiffness": ("soften", "adds a restoring torque"),
    "gravity_offset": (
        "below the joint: upright, the weight turns the tilted rotor back",
        "above the joint.* over",
    ),
    "stiffness_memory": ("stiffer", "softer"),
    "grease_warming": ("brakes more as it warms", "thins it"),
    "magnet_warming": ("lose field", "more torque"),
    "coil_remanence": ("opposite", "past voltages"),
    "windage_tilt": ("less than in the middle", "more than in the middle"),
    "tilt_scale": ("too small", "too large"),
    "tilt_rotation": ("from the y towards the x axis", "from the x towards the y axis"),
    "tilt_nonlinearity": ("too little", "too much"),
    "tilt_cross_talk": ("obtuse", "acute"),
    "encoder_zero": ("lags", "leads"),
    "stiffness_anisotropy": ("The outer flexure is stiffer", "The inner flexure is stiffer"),
    "inertia_anisotropy": ("about its y axis", "about its x axis"),
    **{
        f"{channel}_delay": ("early: it shows a later", "late: it shows an earlier")
        for channel in ("tilt", "spin_angle", "coil_voltage", "motor_voltage", "motor_current")
    },
}


def test_every_effect_with_two_directions_has_a_sentence_for_each() -> None:
    """An effect of two amplitudes has a direction in a plane, which its coefficients state; others have one sign."""
    two = {name for name, e in registry().items() if len(e.amplitudes) == 1 and e.amplitudes[0].signed}
    assert two == SAID.keys() == {name for name, effect in registry().items() if effect.directions}


@pytest.mark.parametrize("name", SAID)
def test_the_sentence_of_an_effect_agrees_with_the_sign_of_its_coefficient(name: str) -> None:
    effect = registry()[name]
    (amplitude,) = effect.amplitudes
    for sign, said in zip((-1.0, 1.0), SAID[name], strict=True):
        for size in amplitude.usual:
            assert re.search(said, effect.sentence_for({amplitude.name: sign * size}))
    # the catalogue, which knows no sign, takes no side
    assert not re.search(r"\b(less|more|early|late)\b", effect.sentence)
