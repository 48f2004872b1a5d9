"""The loop on data with a hidden effect: compare, see where, learn what, add, watch the error fall."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from gyrowheel.show.contract import comparison_json, diagnosis_json
from gyrowheel.show.sentences.diagnosis import verdict_sentence
from gyrowheel.show.sentences.residuals import region_name
from gyrowheel_analysis.add import add_effect
from gyrowheel_analysis.compare import compare
from gyrowheel_analysis.criteria import SETTLING_SEPARATION
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.model import Model, Override
from gyrowheel_control.loops.controller import Gains
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
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
