"""Laws that are not in the library: unknown, with the formula that predicts other recordings, and nothing invented."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel.show.sentences.diagnosis import verdict_sentence
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.events import explain
from gyrowheel_analysis.diagnosis.free_forms import kind_of
from gyrowheel_analysis.diagnosis.selection import select
from gyrowheel_analysis.diagnosis.unknown import search
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.model import Model
from gyrowheel_core.arrays import one_thread
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import EffectValues

from .machines import BENCH, found_in, hidden_law, hidden_machine, record


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


@pytest.mark.study
def test_a_torque_that_falls_with_the_speed_has_a_negative_exponent(tmp_path: Path) -> None:
    found = found_in("torque = a*conj(z/z_ref)^2*exp(-r); a = 0.0015 [N*m]", "quick", tmp_path)
    (form,) = found.free_form
    # the slope of exp(-r) in logarithms is -r
    assert -1.2 < form.coefficients["q"].value < -0.3
    assert found.error is not None
    assert found.error.validation_after is not None
    assert found.error.validation_after.chi2_per_n < 1.2


@pytest.mark.study  # test_memory.py has another law that is unknown, and its proof
@pytest.mark.slow
def test_a_motor_constant_that_depends_on_the_speed_is_no_drag(tmp_path: Path) -> None:
    found = found_in("motor_gain = g*r; g = 0.01 [1]", "quick", tmp_path)
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
    "flexure_square": (
        "flexure_torque = -a*theta^2; a = 0.05 [N*m/rad^2]",
        {"a": -0.05 * math.radians(5.0) ** 2},
        0.04,
    ),
    "flexure_friction": (
        "flexure_torque = -a*tanh(theta_rate/v); a = 4e-4 [N*m]; v = 0.5 +- 0.01 [rad/s]",
        {"a": -4e-4},
        0.04,
    ),
    "axial_rate": ("axial_torque = -a*r^2*abs(z_rate); a = 0.02 [N*m*s/rad]", {"k": 1.0, "q": 2.0}, 0.05),
    "turning_rate": (
        "torque = a*exp(i*theta_z)*abs(z_rate); a = 0.002 [N*m*s/rad]",
        {"k": 1.0, "q": 0.0},
        0.0,
    ),
    "coil_sided": ("coil_gain = a*re(V_coil); a = 0.005 [1/V]", {"a": 0.005}, 0.04),
    "coil_gain_by_time": ("supply_drop = a*t; a = 0.01 [V/s]", {"q": 0.0}, 0.0),
}


@pytest.mark.study
@pytest.mark.parametrize("name", BENT)
def test_resonances_coils_that_bend_and_temperatures_are_formulas(name: str, tmp_path: Path) -> None:
    law, expected, other = BENT[name]
    found = found_in(law, "survey", tmp_path)
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
    assert set(found.ties) == {"windage"}


@pytest.mark.study
def test_a_dynamic_imbalance_is_the_runout_that_looks_the_same(tmp_path: Path) -> None:
    """The rotor turns about its principal axis where its own stiffness, (C - A) Omega^2, balances the torque."""
    found = found_in("torque = a*r^2*exp(i*theta_z); a = 0.0005 [N*m]", "survey", tmp_path)
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
    found = found_in("tilt_reading = a*re(z)*im(z); a = 0.15 [1/rad]", "survey", tmp_path)
    assert found.verdict == "unknown"
    assert not found.effects
    assert not found.laws
    assert found.drift_scales["coil_voltage"] > 2.0
    assert max(found.drift_scales["motor_voltage"], found.drift_scales["motor_current"]) < 1.3


@pytest.mark.slow
def test_a_law_that_acts_in_a_cone_is_no_event(tmp_path: Path) -> None:
    """The coils are loaded most while the tilt goes round: once, and for some seconds."""
    found = found_in("motor_gain = -g*abs(V_coil)^2; g = 0.001 [1/V^2]", "survey", tmp_path)
    assert found.verdict == "unknown"
    assert not found.events
    assert "rate" in {law.depends_on for law in found.laws}


@pytest.mark.study
def test_a_torque_that_follows_a_lagging_temperature_is_a_formula(tmp_path: Path) -> None:
    law = "torque = k*s*z; d(s)/dt = (T_coil - T_air - s)/tau; k = 0.002 [N*m/K/rad]; tau = 40 +- 0.1 [s]"
    found = found_in(law, "survey", tmp_path)
    assert not found.events
    (form,) = found.free_form
    time = form.coefficients["s"]
    assert abs(time.value - 40.0) < 3.0 * time.standard_error
    assert found.proof is not None
    assert found.proof.proven


@pytest.mark.slow
def test_a_torque_that_follows_a_temperature_is_a_law_and_no_drift(tmp_path: Path) -> None:
    """A law predicts the other recording; of a drift nobody knows that."""
    found = found_in("torque = -k*(T_coil - T_ref)*z; k = 0.0004 [N*m/K/rad]", "survey", tmp_path)
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


@pytest.mark.slow
def test_two_effects_that_work_against_each_other_are_not_replaced_by_a_formula_that_does_so_too(
    tmp_path: Path,
) -> None:
    machine = hidden_machine(41, {"coil_tilt": {"g": -5.0e-3}, "tilt_nonlinearity": {"q": 1.0}})
    problem = prepare([record(tmp_path, "run", machine, "survey")], Model(BENCH)).problem
    selection = select(problem)
    assert {term.name for term in selection.best.terms} == {"coil_tilt", "tilt_nonlinearity"}
    assert search(problem, selection) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "law", "exponents"),
    [
        ("air_spin_power", "shaft_torque = -w*r^2*rho/rho_ref; w = 0.001 [N*m]", {"q": 2.0, "m": 1.0}),
        pytest.param(
            "air_lobes",
            "torque = a*conj(z)*r*rho/rho_ref; a = 0.006 [N*m/rad]",
            {"q": 1.0, "m": 1.0},
            marks=pytest.mark.study,
        ),
    ],
)
def test_a_torque_of_the_air_that_no_effect_has_is_a_formula_with_its_density(
    name: str, law: str, exponents: dict[str, float], tmp_path: Path
) -> None:
    """Windage acts along the axis of the tilted rotor: what a fan on the shaft lacks passed for a remanence."""
    found = found_in(law, "quick", tmp_path)
    assert not found.effects
    (form,) = found.free_form
    assert form.name == name
    for exponent, value in exponents.items():
        own = form.coefficients[exponent]
        assert abs(own.value - value) < 4.0 * own.standard_error
    assert "density" in found.sentence
    assert found.proof is not None
    assert found.proof.proven
