"""The loop on data with a hidden effect: compare, see where, learn what, add, watch the error fall."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel.show.contract import comparison_json, diagnosis_json
from gyrowheel.show.sentences.diagnosis import verdict_sentence
from gyrowheel.show.sentences.residuals import region_name
from gyrowheel_analysis.add import add_effect
from gyrowheel_analysis.compare import compare
from gyrowheel_analysis.criteria import SETTLING_SEPARATION
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.events import explain
from gyrowheel_analysis.diagnosis.free_forms import kind_of
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.diagnosis.selection import select
from gyrowheel_analysis.diagnosis.unknown import search
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.model import Model, Override
from gyrowheel_control.loops.controller import Gains
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim import blind
from gyrowheel_sim.effects import EffectValues, physical, registry, remembering
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH, hidden_machine, record

#: Sizes in the middle of what is usual, but for some that a minute on the bench shows only where they are large.
LARGE: EffectValues = {
    "stiffness_anisotropy": {"k": 0.02},
    "cogging": {"C_x": 0.008, "C_y": -0.006},
    "winding_heating": {"a": 0.012},
    "coil_inductance": {"t_L": 4.0e-4},
    "windage_tilt": {"w": -0.0005, "n": 1.48},
    # their time constants are longer than these plans
    "stiffness_memory": {"k": 0.025},
    "coil_remanence": {"k": 4.0e-4, "tau": 8.0},
    "grease_warming": {"v": 1.5e-5, "tau": 60.0},
    "magnet_warming": {"a": 0.01, "tau": 60.0},
}
#: Looked for again once it is in the model; the others are a study.
AGAIN = ("coil_remanence",)
#: What these plans cannot show; most have tests of their own.
NOT_SHOWN = ("gravity_offset", "earth_rate", "tilt_scale", "supply_sag")
HIDDEN: dict[str, EffectValues] = {
    name: {name: LARGE.get(name, effect.defaults())}
    for name, effect in {**physical(), **remembering()}.items()
    if name not in NOT_SHOWN
}


def named(diagnosis: Diagnosis) -> set[str]:
    return set(diagnosis.ties)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in AGAIN else [pytest.mark.study]) for name in HIDDEN]
)
def test_a_hidden_effect_is_found_added_and_validated(name: str, tmp_path: Path) -> None:
    truth = HIDDEN[name]
    machine = hidden_machine(seed=40 + list(HIDDEN).index(name), effects=truth)
    fit = record(tmp_path, "fit", machine, "quick")
    unused = record(tmp_path, "unused", machine, "check", noise_seed=9000)
    model = Model.new()

    found = diagnose([fit], model, validate=[unused])
    tied = {tie.name for ties in found.ties.values() for tie in ties}
    tied_with = name not in AGAIN and len(found.ties) == 1 and name in tied
    assert named(found) == {name} or tied_with, verdict_sentence(found)
    if named(found) == {name}:
        effect = found.effects[0]
        for key, estimate in effect.coefficients.items():
            assert abs(estimate.value - truth[name][key]) < 4.0 * estimate.standard_error

    added = add_effect(model, [name], [fit], [unused])
    assert added.error.validation_before is not None
    assert added.error.validation_after is not None
    # in units of the noise floor
    assert math.sqrt(added.error.validation_after.chi2_per_n) <= 1.3
    assert added.error.validation_after.chi2_per_n < added.error.validation_before.chi2_per_n
    assert added.error.after.chi2_per_n < 0.9 * added.error.before.chi2_per_n
    if name in AGAIN:  # with the effect in the model, nothing is missing any more
        again = diagnose([fit], added.model)
        assert again.verdict == "nothing_missing", verdict_sentence(again)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [700, *(pytest.param(seed, marks=pytest.mark.study) for seed in range(701, 710))]
)
def test_without_a_hidden_effect_nothing_is_missing(seed: int, tmp_path: Path) -> None:
    machine = hidden_machine(seed=seed, effects={})
    found = diagnose([record(tmp_path, "fit", machine, "quick")], Model.new())
    assert found.verdict == "nothing_missing", verdict_sentence(found)
    assert not found.effects
    assert not found.free_form


@pytest.mark.study  # the gravity offset below is one of them
@pytest.mark.slow
@pytest.mark.parametrize("name", NOT_SHOWN)
def test_an_effect_that_the_plan_cannot_show_is_reported_as_hidden(name: str, tmp_path: Path) -> None:
    usual = registry()[name].defaults()
    found = diagnose([record(tmp_path, "fit", hidden_machine(4, {name: usual}), "quick")], Model.new())
    assert found.verdict == "nothing_missing"
    limits = {limit.coefficient: limit.value for limit in found.limits if limit.effect == name}
    assert all(limits[key] > abs(value) for key, value in usual.items())


@pytest.mark.study  # one plan more
@pytest.mark.slow
def test_yawing_the_rig_separates_the_earth_from_a_fixed_torque(tmp_path: Path) -> None:
    truth = {"earth_rate": {"E_x": 4.0e-5, "E_y": 4.0e-5}}
    found = diagnose([record(tmp_path, "yaw", hidden_machine(5, truth), "yaw")], Model.new())
    assert named(found) == {"earth_rate"}
    (effect,) = found.effects
    assert not effect.ties
    for estimate in effect.coefficients.values():
        assert abs(estimate.value - 4.0e-5) < 4.0 * estimate.standard_error


@pytest.mark.slow
def test_two_hidden_effects_are_both_found(tmp_path: Path) -> None:
    truth = {"aero_cross": {"c": 0.006, "n": 1.98}, "coil_heating": {"a": -0.003}}
    found = diagnose([record(tmp_path, "fit", hidden_machine(3, truth), "quick")], Model.new())
    assert named(found) == set(truth)


@pytest.mark.slow
def test_an_effect_that_bench_parameters_nearly_replace_is_no_wrong_instrument(tmp_path: Path) -> None:
    """Where readings are precise, the linear gain of a lag is several times too small next to that of a delay."""
    machine = hidden_machine(3, {"coil_inductance": {"t_L": 2.7e-4}})
    precise = {
        name: 0.2 * BENCH.value(name) for name in BENCH.values() if name.endswith(("_noise", "_drift"))
    }
    machine = replace(machine, values={**machine.values, **precise})
    found = diagnose([record(tmp_path, "run", machine, "survey")], Model.new())
    assert [f.name for f in found.effects] == ["coil_inductance"]
    assert not found.instruments


@pytest.mark.slow
def test_an_effect_below_the_detection_limit_is_reported_as_such(tmp_path: Path) -> None:
    truth = {"gravity_offset": {"G": 0.003}}
    found = diagnose([record(tmp_path, "fit", hidden_machine(4, truth), "quick")], Model.new())
    assert found.verdict == "nothing_missing"
    limit = next(limit for limit in found.limits if limit.effect == "gravity_offset")
    assert limit.value > 0.003
    assert not limit.visible
    # and the test that would show it is named; run, it does
    assert found.next_test is not None
    assert found.next_test.plan == "inverted"


@pytest.mark.slow
def test_next_test_reveals_the_effect_hidden_from_the_first_plan(tmp_path: Path) -> None:
    machine = hidden_machine(4, {"gravity_offset": {"G": 0.003}})
    recordings = [
        record(tmp_path, "fit", machine, "quick"),
        record(tmp_path, "inverted", machine, "inverted", noise_seed=8),
    ]
    found = diagnose(recordings, Model.new())
    assert named(found) == {"gravity_offset"}
    assert found.verdict == "effect"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["aero_restoring", "gimbal_inertia_error"])
@pytest.mark.study
def test_the_torque_twice_a_revolution_separates_gimbal_inertia_from_air(name: str, tmp_path: Path) -> None:
    """In the averages both are a torque against the tilt that grows as the square of the speed."""
    if name == "aero_restoring":
        machine = hidden_machine(5, {"aero_restoring": {"k": 0.12, "n": 2.0}})
    else:
        machine = with_gimbal_inertia(hidden_machine(7, {}), 1.7)
    recordings = [
        record(tmp_path, "speed", machine, "paper_speed"),
        record(tmp_path, "tilt", machine, "paper_tilt", noise_seed=6),
    ]
    found = diagnose(recordings, Model.new())
    assert named(found) == {name}
    assert found.verdict == "effect", verdict_sentence(found)


@pytest.mark.study  # tests/bringup/test_investigate.py goes the same way
def test_look_alikes_are_a_tie_with_the_test_that_separates_them(tmp_path: Path) -> None:
    """By averages alone, speeds and tilts cannot tell a strong restoring torque of the air from a wrong inertia."""
    machine = hidden_machine(5, {"aero_restoring": {"k": 0.12, "n": 2.0}})
    recordings = [
        record(tmp_path, "s", machine, "paper_speed"),
        record(tmp_path, "t", machine, "paper_tilt", noise_seed=6),
    ]
    found = diagnose(recordings, Model.new(), averages=True)
    assert found.verdict == "ambiguous", verdict_sentence(found)
    (effect,) = found.effects
    ties = {tie.name: tie for tie in effect.ties}
    assert {effect.name, *ties} >= {"aero_restoring", "gimbal_inertia_error"}
    assert found.next_test is not None
    assert found.next_test.expected_separation > SETTLING_SEPARATION
    # whatever its name, it changes what only the air can answer
    densities = {event.air_density_ratio for event in Plan.load(found.next_test.plan).environment()}
    assert min(densities) < 0.5
    recordings.append(record(tmp_path, "d", machine, found.next_test.plan, noise_seed=7))
    settled = diagnose(recordings, Model.new(), averages=True)
    assert settled.verdict == "effect"
    assert named(settled) == {"aero_restoring"}


def with_gimbal_inertia(machine: Scenario, factor: float) -> Scenario:
    names = [f"gimbal_inertia_{axis}" for axis in "xyz"]
    return replace(machine, values={**machine.values, **{n: BENCH.value(n) * factor for n in names}})


@pytest.mark.slow
def test_a_wrong_bench_parameter_is_a_separate_finding(tmp_path: Path) -> None:
    machine = hidden_machine(6, {})
    values = {**machine.values, "coil_constant": 0.02 * 1.2}
    wrong = type(machine)(values, {}, 6)
    found = diagnose([record(tmp_path, "fit", wrong, "quick")], Model.new())
    assert named(found) == {"coil_gain_error"}
    estimate = found.effects[0].coefficients["relative_error"]
    assert abs(estimate.value - 0.2) < 4.0 * max(estimate.standard_error, 0.005)
    own = found.nuisance["coil_constant"]
    assert own.value == pytest.approx(0.02 * (1.0 + estimate.value))
    assert own.standard_error == pytest.approx(0.02 * estimate.standard_error)
    assert own.scatter == pytest.approx(0.02 * (estimate.scatter or 0.0))


@pytest.mark.slow
def test_an_instrument_that_was_found_is_a_parameter_of_that_value_and_in_a_model_once(
    tmp_path: Path,
) -> None:
    machine = hidden_machine(6, {"encoder_once": {"E_x": 0.01, "E_y": 0.0}})
    recording = record(tmp_path, "fit", machine, "quick")
    found = diagnose([recording], Model.new())
    (own,) = (i for i in found.instruments if i.quantity == "encoder_once_x")
    shown = found.nuisance["encoder_once_x"]
    assert (shown.value, shown.standard_error) == pytest.approx((own.value, own.standard_error), rel=1e-4)
    assert own.standard_error > 1e-6
    model = add_effect(Model.new(), ["encoder_once"], [recording]).model
    assert model.effects["encoder_once"]["E_x"] == pytest.approx(own.value, rel=1e-3)
    assert model.overrides["encoder_once_x"] == Override(0.0, 0.0)


@pytest.mark.study
def test_a_very_different_rotor_is_one_finding(tmp_path: Path) -> None:
    """Its torques twice a revolution are noisier than those of the stated one, which nearly cancel."""
    machine = hidden_machine(21, {})
    values = {**machine.values, "rotor_inertia_z": 0.68 * BENCH.value("rotor_inertia_z")}
    found = diagnose([record(tmp_path, "fit", type(machine)(values, {}, 21), "quick")], Model.new())
    assert (found.verdict, named(found)) == ("effect", {"rotor_inertia_error"})
    estimate = found.effects[0].coefficients["relative_error"]
    assert abs(estimate.value + 0.32) < 4.0 * max(estimate.standard_error, 0.005)


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth",
    [
        pytest.param({"three_lobed": {"A": 0.003}}, id="three_lobed", marks=pytest.mark.study),
        pytest.param({"contact": {"A": 0.01, "p": 0.5}}, id="contact", marks=pytest.mark.study),
        pytest.param(
            {"speed_bump": {"A": 0.04, "p": 0.71, "w": 0.1}}, id="speed_bump", marks=pytest.mark.study
        ),
    ],
)
def test_an_effect_outside_the_library_is_unknown_with_a_formula(truth: EffectValues, tmp_path: Path) -> None:
    found = diagnose([record(tmp_path, "fit", hidden_machine(8, truth), "quick")], Model.new())
    assert found.verdict == "unknown", verdict_sentence(found)
    assert not found.effects
    assert found.free_form[0].formula
    assert found.error is not None
    assert found.error.after.chi2_per_n < 0.5 * found.error.before.chi2_per_n


def hidden_law(formula: str, plan: str, folder: Path) -> tuple[Path, Path]:
    """Return two recordings of a machine with a user-defined law, by a plan and by plan check."""
    law = gw.own_effect(formula, name="hidden")
    for name, seed in ((plan, 31), ("check", 32)):
        gw.simulate(name, effects=[law], machine=31, seed=seed, folder=folder / name)
    return folder / plan, folder / "check"


@pytest.mark.study
def test_a_torque_that_falls_with_the_speed_has_a_negative_exponent(tmp_path: Path) -> None:
    fit, check = hidden_law("torque = a*conj(z/z_ref)^2*exp(-r); a = 0.0015 [N*m]", "quick", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    (form,) = found.free_form
    # the slope of exp(-r) in logarithms is -r
    assert -1.2 < form.coefficients["q"].value < -0.3
    assert found.error is not None
    assert found.error.validation_after is not None
    assert found.error.validation_after.chi2_per_n < 1.2


@pytest.mark.study  # test_memory.py has another law that is unknown, and its proof
@pytest.mark.slow
def test_a_motor_constant_that_depends_on_the_speed_is_no_drag(tmp_path: Path) -> None:
    fit, check = hidden_law("motor_gain = g*r; g = 0.01 [1]", "quick", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    assert not found.effects
    (form,) = found.free_form
    assert form.formula.startswith("motor_gain = ")
    assert abs(form.coefficients["q"].value - 1.0) < 3.0 * form.coefficients["q"].standard_error
    assert found.error is not None
    assert found.error.validation_after is not None
    assert found.error.validation_after.chi2_per_n < 1.2


#: Hidden laws, by the kind of the form that describes them: the law, its coefficients, and by how much they may differ
#: besides their errors. The machine's torque per volt is known to 2 %; the slope of another function differs by more.
BENT = {
    "resonance": (
        "torque = a*z/(1 - (r/p)^2 + i*0.12*r/p); a = 0.0008 [N*m]; p = 0.8 +- 0.001 [1]",
        {"p": 0.8, "w": 0.06},
        0.0,
    ),
    "coil_saturation": ("torque = -s*V_coil*abs(V_coil)^2; s = 2e-5 [N*m/V^3]", {"a": -2e-5 / 0.02}, 0.04),
    "coil_crossover": (
        "torque = -f*(tanh(re(V_coil)/v) + i*tanh(im(V_coil)/v)); f = 0.0003 [N*m]; v = 0.2 +- 0.001 [V]",
        {"a": -3e-4},
        0.2,
    ),
    "coil_cube": ("torque = -s*(re(V_coil)^3 + i*im(V_coil)^3); s = 2e-5 [N*m/V^3]", {"a": -2e-5}, 0.04),
    "coil_even": ("torque = a*(abs(re(V_coil)) + i*abs(im(V_coil))); a = 4e-4 [N*m/V]", {"a": 4e-4}, 0.04),
    "fixed_by_motor": (
        "torque = a*(T_motor - T_ref)*exp(i*0.7); a = 5e-5 [N*m/K]",
        {"a": 5e-5 * math.cos(0.7), "b": 5e-5 * math.sin(0.7)},
        0.04,
    ),
    "fixed_by_current": (
        "torque = a*i_motor*exp(i); a = 0.01 [N*m/A]",
        {"a": 0.01 * math.cos(1.0), "b": 0.01 * math.sin(1.0)},
        0.04,
    ),
    "tilt_by_coils": (
        "torque = a*z*r^2*(T_coil - T_ref); a = 6e-4 [N*m/rad/K]",
        {"a": 6e-4 * math.radians(5.0), "q": 2.0},
        0.04,
    ),
    "spin_lobes": ("shaft_torque = -a*re(z)*r; a = 0.03 [N*m/rad]", {"q": 1.0}, 0.0),
    "coil_gain_lobes": ("coil_gain = a*re(z); a = 0.4 [1/rad]", {"q": 0.0}, 0.0),
    "tilt_gain_lobes": ("tilt_reading = a*conj(z)^2; a = 0.05 [1/rad]", {"q": 0.0}, 0.0),
    "tilt_gain_of_tilt": ("tilt_reading = a*z*abs(z)^2; a = 12 [1/rad^2]", {"k": 2.0, "q": 0.0}, 0.0),
    "motor_gain_by_motor": (
        "motor_gain = -a*r*(T_motor - T_ref); a = 0.002 [1/K]",
        {"a": -0.002, "q": 1.0},
        0.04,
    ),
    "fixed_by_time": (
        "case_rate = a*exp(i*0.8)*t/T; a = 5e-4 [rad/s]; T = 100 +- 0.01 [s]",
        {"q": 1.0},
        0.0,
    ),
    "coil_mirror_by_coils": (
        "coil_anisotropy = a*(T_coil - T_ref); a = 0.001 [1/K]",
        {"a": 0.001, "q": 0.0},
        0.04,
    ),
    "coil_turn": ("torque = a*i*V_coil*r; a = 4e-4 [N*m/V]", {"b": 4e-4, "q": 1.0}, 0.04),
    "coil_brake": ("shaft_torque = -a*abs(V_coil)^2; a = 2e-5 [N*m/V^2]", {"a": -2e-5}, 0.04),
    "coil_gain_warming": ("coil_gain = -a*(T_coil - T_ref)^2; a = 3e-4 [1/K^2]", {"a": -3e-4}, 0.04),
    "coil_lobes": (
        "torque = a*conj(V_coil)^2*exp(i*0.4); a = 4e-5 [N*m/V^2]",
        {"a": 4e-5 * math.cos(0.4), "b": 4e-5 * math.sin(0.4), "q": 0.0},
        0.04,
    ),
    "rate_mirror": ("torque = a*conj(z_rate)*r; a = 0.02 [N*m*s/rad]", {"q": 1.0}, 0.0),
    "rate_of_tilt": ("torque = -a*abs(z)*r*z_rate; a = 0.5 [N*m*s/rad^2]", {"k": 1.0, "q": 1.0}, 0.0),
    "rate": ("torque = -a*z_rate*abs(z_rate); a = 0.2 [N*m*s^2/rad^2]", {"k": 2.0, "q": 0.0}, 0.0),
    "stiffness_tilt_lag": (
        "torque = a*s*z; d(s)/dt = (abs(z)^2/0.0009 - s)/tau; a = 0.005 [N*m/rad]; tau = 15 +- 0.01 [s]",
        {"k": 2.0, "q": 0.0, "s": 15.0},
        0.0,
    ),
    "tilt_beyond": (
        "torque = a*i*z/(1 + exp((p - r)/w)); a = 0.01 [N*m/rad]; p = 0.75 +- 0.001 [1]; w = 0.01 +- 0.0001 [1]",
        {"p": 0.75},
        0.0,
    ),
}


@pytest.mark.study
@pytest.mark.parametrize("name", BENT)
def test_resonances_coils_that_bend_and_temperatures_are_formulas(name: str, tmp_path: Path) -> None:
    law, expected, other = BENT[name]
    fit, check = hidden_law(law, "survey", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    assert not found.effects
    assert not found.events
    (form,) = found.free_form
    assert form.name == name
    for key, value in expected.items():
        own = form.coefficients[key]
        assert abs(own.value - value) < 4.0 * own.standard_error + other * abs(value)
    assert found.proof is not None
    assert found.proof.proven


@pytest.mark.slow
def test_formulas_that_describe_the_recording_as_well_come_with_the_test_that_separates_them() -> None:
    """Three speeds do not show whether the torque on the spin grows at one of them, beyond it, or with a power."""
    law = gw.own_effect("shaft_torque = -a*max(r - p, 0)^2; a = 0.01 [N*m]; p = 0.6 +- 0.001 [1]")
    few = gw.simulate("quick", effects=[law], machine=5, seed=5)
    found = gw.diagnose(few, gw.Model())
    (form,) = found.free_form
    names = {form.name, *(tie.name for tie in form.ties)}
    assert {"spin_bump", "spin_beyond", "spin_power"} <= names
    assert "describe these recordings as well" in found.sentence
    assert found.next_test is not None
    assert set(found.next_test.separates or ()) <= names


@pytest.mark.slow
def test_a_drag_of_the_air_with_another_exponent_is_a_formula_and_no_windage(tmp_path: Path) -> None:
    fit, check = hidden_law("axial_torque = -w*r^2.5*rho/rho_ref; w = 0.004 [N*m]", "quick", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    assert found.verdict == "unknown"
    (form,) = found.free_form
    assert form.name == "windage_like"
    for name, value in {"n": 2.5, "m": 1.0}.items():
        own = form.coefficients[name]
        assert abs(own.value - value) < 4.0 * own.standard_error
    assert found.proof is not None
    assert found.proof.proven
    added = gw.Model().add(found, fit=fit, validate=check).added
    assert added is not None
    assert added.error.validation_after is not None
    assert added.error.validation_after.chi2_per_n < 1.3


@pytest.mark.slow
def test_a_formula_like_an_effect_has_another_name_than_effects_of_the_model(tmp_path: Path) -> None:
    fit, _ = hidden_law("axial_torque = -w*r^2.5*rho/rho_ref; w = 0.004 [N*m]", "quick", tmp_path)
    known = gw.own_effect("windage_like: shaft_torque = a*z*conj(z); a = 1e-6 [N*m/rad^2]")
    model = gw.Model().add(known, fit=gw.simulate("quick", machine=31, seed=33))
    found = gw.diagnose(fit, model)
    (form,) = found.free_form
    assert form.name == "windage_like_2"
    assert form.coefficients["n"].value == pytest.approx(2.5, abs=0.2)


@pytest.mark.slow
def test_windage_with_an_exponent_between_laminar_and_turbulent_flow_is_windage(tmp_path: Path) -> None:
    fit = record(tmp_path, "fit", hidden_machine(77, {"windage": {"w": 0.004, "n": 1.7}}), "quick")
    found = diagnose([fit], Model.new())
    assert found.verdict == "effect"
    assert named(found) == {"windage"}


@pytest.mark.study
def test_a_dynamic_imbalance_is_the_runout_that_looks_the_same(tmp_path: Path) -> None:
    """The rotor turns about its principal axis where its own stiffness, (C - A) Omega^2, balances the torque."""
    fit, check = hidden_law("torque = a*r^2*exp(i*theta_z); a = 0.0005 [N*m]", "survey", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    (effect,) = found.effects
    assert effect.name == "runout"
    assert "dynamic imbalance" in effect.effect_sentence
    assert found.proof is not None
    assert found.proof.proven
    inertia = BENCH.value("rotor_inertia_z") - BENCH.value("rotor_inertia_x")
    angle = 0.0005 / (inertia * BENCH.value("spin_rate_reference") ** 2)
    assert effect.coefficients["R_x"].value == pytest.approx(angle, rel=0.03)


@pytest.mark.slow
def test_a_law_in_one_channel_enlarges_no_drift_of_another(tmp_path: Path) -> None:
    """Known effects of the spin that bend to what a tilt reading leaves would make the motor's rows unlikely."""
    fit, check = hidden_law("tilt_reading = a*re(z)*im(z); a = 0.15 [1/rad]", "survey", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    assert found.verdict == "unknown"
    assert not found.effects
    assert not found.laws
    assert found.drift_scales["coil_voltage"] > 2.0
    assert max(found.drift_scales["motor_voltage"], found.drift_scales["motor_current"]) < 1.3


@pytest.mark.slow
def test_a_law_that_acts_in_a_cone_is_no_event(tmp_path: Path) -> None:
    """The coils are loaded most while the tilt goes round: once, and for some seconds."""
    fit, check = hidden_law("motor_gain = -g*abs(V_coil)^2; g = 0.001 [1/V^2]", "survey", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    assert found.verdict == "unknown"
    assert not found.events
    assert "rate" in {law.depends_on for law in found.laws}


@pytest.mark.study
def test_a_torque_that_follows_a_lagging_temperature_is_a_formula(tmp_path: Path) -> None:
    law = "torque = k*s*z; d(s)/dt = (T_coil - T_air - s)/tau; k = 0.002 [N*m/K/rad]; tau = 40 +- 0.1 [s]"
    fit, check = hidden_law(law, "survey", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    assert not found.events
    (form,) = found.free_form
    time = form.coefficients["s"]
    assert abs(time.value - 40.0) < 3.0 * time.standard_error
    assert found.proof is not None
    assert found.proof.proven


@pytest.mark.slow
def test_a_torque_that_follows_a_temperature_is_a_law_and_no_drift(tmp_path: Path) -> None:
    """A law predicts the other recording; of a drift nobody knows that."""
    fit, check = hidden_law("torque = -k*(T_coil - T_ref)*z; k = 0.0004 [N*m/K/rad]", "survey", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    assert not found.drift_shapes
    (form,) = found.free_form
    assert kind_of(form.name) == "tilt_by_coils"
    assert found.proof is not None
    assert found.proof.proven


@pytest.mark.slow
def test_a_law_that_the_largest_drift_alone_hides_is_no_event(tmp_path: Path) -> None:
    law = "torque = k*s*conj(z); d(s)/dt = (T_coil - T_air - s)/tau; k = 0.0024 [N*m/K/rad]; tau = 25 +- 0.1 [s]"
    fit, _ = hidden_law(law, "survey", tmp_path)
    recording = Recording.open(fit)
    with one_thread():
        problem = prepare([recording], Model.new()).problem
        found = explain(problem, select(problem), [recording], among=())
    assert not found.events


@pytest.mark.study
def test_a_torque_that_swings_is_no_map(tmp_path: Path) -> None:
    law = "torque = a*(sin(t/b) + i*cos(0.86*t/b)); a = 0.0003 [N*m]; b = 7 +- 0.1 [s]"
    fit, check = hidden_law(law, "survey", tmp_path)
    found = gw.diagnose(fit, gw.Model(), validate=check)
    assert found.map is None
    assert {shape.kind for shape in found.drift_shapes} == {"swing"}


@pytest.mark.study
def test_the_diagnosis_does_not_depend_on_the_controller(tmp_path: Path) -> None:
    truth = {"aero_cross": {"c": 0.0053, "n": 1.98}}
    gains = Gains(spin_proportional=12.7, spin_integral=21.0, tilt_bandwidth=9.0)
    found = diagnose([record(tmp_path, "fit", hidden_machine(9, truth), "quick", gains=gains)], Model.new())
    assert named(found) == {"aero_cross"}


@pytest.mark.slow
def test_without_setpoints_the_steady_motion_is_found(tmp_path: Path) -> None:
    machine = hidden_machine(10, {"aero_cross": {"c": 0.0053, "n": 1.98}})
    recording = record(tmp_path, "fit", machine, "quick")
    alone = replace(recording, setpoint=recording.setpoint[:0])
    found = diagnose([alone], Model.new())
    assert named(found) == {"aero_cross"}


def test_too_little_data_is_reported(tmp_path: Path) -> None:
    text = (
        "schema: 1\nname: short\nsegments:\n  - {spin_rpm: 3000, tilt_deg: [[0, 0], [2, 0]], hold_s: 1.2}\n"
    )
    found = diagnose([record(tmp_path, "short", hidden_machine(11, {}), Plan.load(text))], Model.new())
    assert found.verdict == "insufficient_data"
    json.dumps(diagnosis_json(found))


@pytest.mark.slow
def test_compare_reports_regions_and_variables(tmp_path: Path) -> None:
    machine = hidden_machine(12, {"aero_cross": {"c": 0.008, "n": 1.98}})
    result = compare([record(tmp_path, "fit", machine, "quick")], Model.new())
    assert region_name(result.where[0]).startswith("tilt, 3500 rpm")
    assert sum(region.share_of_chi2 for region in result.where) > 0.6
    assert result.channels["tilt_x"].chi2_per_n > 3.0
    assert result.channels["spin"].chi2_per_n < 2.0
    for metrics in result.channels.values():
        parts = metrics.theil_bias + metrics.theil_variance + metrics.theil_covariance
        assert parts == pytest.approx(1.0, abs=1e-6)
    content = json.loads(json.dumps(comparison_json(result)))
    assert set(content["error"]["before"]["rms"]) == {"tilt_x", "tilt_y", "spin"}


def test_recording_contains_no_hidden_truth(tmp_path: Path) -> None:
    machine = blind.draw(BENCH, 21, kinds=("single",))
    record(tmp_path, "fit", machine, "check")
    effect = next(iter(machine.effects))
    for path in (tmp_path / "fit").iterdir():
        content = path.read_bytes()
        assert effect.encode() not in content
        assert b"noise_seed" not in content


@pytest.mark.study  # test_known_effects.py fits an effect of the model again
@pytest.mark.slow
def test_adding_twice_fits_again_and_an_unknown_effect_is_refused(tmp_path: Path) -> None:
    machine = hidden_machine(15, {"windage": {"w": 0.001, "n": 1.48}})
    fit = record(tmp_path, "fit", machine, "quick")
    added = add_effect(Model.new(), ["windage"], [fit])
    again = add_effect(added.model, ["windage"], [fit])
    # it knows the bench better than the first time, the sizes agree
    error = added.model.effect_errors["windage"]["w"]
    assert again.model.effects["windage"]["w"] == pytest.approx(
        added.model.effects["windage"]["w"], abs=0.3 * error
    )
    with pytest.raises(InputError, match="did you mean windage"):
        add_effect(Model.new(), ["windadge"], [fit])
    with pytest.raises(InputError, match="no recording"):
        add_effect(Model.new(), ["windage"], [])


def test_two_recordings_of_one_run_are_the_same_bytes(tmp_path: Path) -> None:
    # what is between the fields of a message must not be whatever memory held: it might be the truth
    machine = hidden_machine(16, {"windage": {"w": 0.001, "n": 1.48}})
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        record(tmp_path / name, "run", machine, "check")
    first, second = (next((tmp_path / name / "run").glob("*.mcap")).read_bytes() for name in ("one", "two"))
    assert first == second


@pytest.mark.slow
def test_two_effects_that_work_against_each_other_are_not_replaced_by_a_formula_that_does_so_too(
    tmp_path: Path,
) -> None:
    machine = hidden_machine(41, {"coil_tilt": {"g": -5.0e-3}, "tilt_nonlinearity": {"q": 1.0}})
    problem = prepare([record(tmp_path, "run", machine, "survey")], Model(BENCH)).problem
    selection = select(problem)
    assert {term.name for term in selection.best.terms} == {"coil_tilt", "tilt_nonlinearity"}
    assert search(problem, selection) is None
