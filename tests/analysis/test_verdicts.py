"""What no diagnosis may say, whatever is hidden: a verdict that its own numbers contradict."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import pytest

from gyrowheel.show.contract import diagnosis_json
from gyrowheel.show.sentences.diagnosis import beyond_sentences, verdict_sentence
from gyrowheel.show.sentences.proof import proof_sentence
from gyrowheel_analysis.criteria import CHI2_RANGE, FAR_FROM_USUAL
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.estimates import Beyond
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.diagnosis.selection import threshold
from gyrowheel_analysis.fitting.fit import ERRORS, Term
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import Effect, EffectValues, effect_from_mapping, registry
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH, hidden_machine, record

pytestmark = pytest.mark.slow


def formula(target: str, law: str, **values: tuple[float, str]) -> tuple[Effect, dict[str, float]]:
    """Return an effect that no library has, with the values of its coefficients."""
    units = {name: {"unit": unit} for name, (_, unit) in values.items()}
    effect = effect_from_mapping("own", {target: law, "coefficients": units})
    return effect, {name: value for name, (value, _) in values.items()}


#: What no known effect explains, or only one of an impossible size or sign.
FORMULAS = {
    "torque of the square of the speed, fixed in the case": formula(
        "rotor_torque", "(a + i*b)*r^2", a=(3e-4, "N*m"), b=(-2e-4, "N*m")
    ),
    "torque that drives the tilt": formula("rotor_torque", "a*z_rate", a=(5e-3, "N*m*s/rad")),
    "torque that drives the spin": formula("axial_torque", "a*r^2", a=(2.5e-3, "N*m")),
}
EFFECTS: dict[str, EffectValues] = {
    "nothing": {},
    "one effect": {"aero_cross": {"c": 0.006, "n": 1.98}},
    "two effects that oppose each other": {"coil_tilt": {"g": 0.08}, "cubic_stiffness": {"q": -3.0}},
    "an effect eight times as large as usual": {"static_imbalance": {"S_x": 1.6e-3, "S_y": -1.2e-3}},
    "an Earth that turns ten times too fast": {"earth_rate": {"E_x": 6e-4, "E_y": -4e-4}},
    "three effects": {
        "fixed_torque": {"F_x": 0.002, "F_y": -0.001},
        "bearing_viscous": {"b": 8e-6},
        "tilt_rotation": {"a": 0.02},
    },
}


@functools.cache
def hidden(name: str, seed: int = 31) -> Scenario:
    if name in EFFECTS:
        return hidden_machine(seed, EFFECTS[name])
    effect, values = FORMULAS[name]
    return replace(hidden_machine(seed, {"own": values}), declared={"own": effect})


def consistent(found: Diagnosis) -> None:
    """Check that nothing in a diagnosis contradicts its verdict."""
    for finding in found.effects:
        effect = registry().get(finding.name)
        assert finding.delta_chi2 >= threshold(Term(finding.name, effect), 1.0) > 0.0
        for tie in finding.ties:
            assert all(name in registry() or name in ERRORS for name in tie.names)
        if effect is None:
            continue
        for c in effect.coefficients:
            estimate, (low, high) = finding.coefficients[c.name], c.physical
            assert low - 2.0 * estimate.standard_error <= estimate.value
            assert estimate.value <= high + 2.0 * estimate.standard_error
    assert all(finding.delta_chi2 > 0.0 for finding in found.instruments)
    far = [b for b in found.beyond if b.kind == "unusual"]
    assert all(b.times > FAR_FROM_USUAL or b.name in ERRORS for b in far)
    sentence = verdict_sentence(found)
    if far:
        assert sentence.startswith(far[0].name), "what is far beyond the usual is said first"
        alone = len(found.effects) + len(found.instruments) == 1
        assert found.verdict == "unknown" or (alone and found.lack_of_fit <= CHI2_RANGE)
    proof = found.proof
    assert proof is not None
    if proof.proven:
        assert proof.chi2_per_n <= proof.allowed
    if found.verdict == "nothing_missing":
        assert not found.effects
        assert not found.instruments
        assert not found.free_form
        assert not far
        assert found.lack_of_fit <= CHI2_RANGE
        assert proof.proven is not False
    else:
        assert not sentence.startswith(("Nothing is missing", "Nothing shows:"))
    assert proof_sentence(proof).startswith(
        {True: "Consistent", False: "NOT consistent", None: "Not tested"}[proof.proven]
    )
    written = diagnosis_json(found)
    assert written["proof"]["proven"] is proof.proven
    assert all(effect["delta_chi2"] > 0.0 for effect in written["effects"])


def diagnosed(folder: Path, name: str, *, validate: str = "") -> Diagnosis:
    machine = hidden(name)
    others = [record(folder, "check", machine, validate, noise_seed=77)] if validate else []
    return diagnose([record(folder, "fit", machine, "quick")], Model.new(), validate=others)


@pytest.mark.study  # that of one effect is consistent where it is proven, below
@pytest.mark.parametrize("name", [*EFFECTS, *FORMULAS])
def test_verdict_is_consistent_with_its_findings(name: str, tmp_path: Path) -> None:
    found = diagnosed(tmp_path, name, validate="check" if name in FORMULAS else "")
    consistent(found)
    named = {finding.name for finding in found.effects}
    if name in FORMULAS or "Earth" in name:
        assert found.verdict == "unknown" or found.proof is None or not found.proof.proven, verdict_sentence(
            found
        )
        assert "earth_rate" not in named
        assert "earth_rate" not in {tie.name for finding in found.effects for tie in finding.ties}
    elif "effects" not in name:
        assert named == set(EFFECTS[name]), verdict_sentence(found)


@pytest.mark.study  # 20 s for one law
def test_a_torque_that_grows_with_the_square_of_the_speed_is_not_the_earth(tmp_path: Path) -> None:
    found = diagnosed(tmp_path, "torque of the square of the speed, fixed in the case", validate="check")
    consistent(found)
    assert found.verdict == "unknown"
    assert not found.effects
    (form,) = found.free_form
    assert "fixed in the case" in form.description
    assert form.coefficients["a"].value == pytest.approx(
        3e-4, abs=4.0 * form.coefficients["a"].standard_error
    )
    assert form.coefficients["b"].value == pytest.approx(
        -2e-4, abs=4.0 * form.coefficients["b"].standard_error
    )
    assert found.proof is not None
    assert found.proof.proven


@pytest.mark.study  # an event does the same below
def test_effect_in_the_validation_alone_prevents_the_verdict_nothing_missing(tmp_path: Path) -> None:
    """A centre of gravity off the pivot cannot be seen upright, but a model without it fails upside down."""
    machine = hidden_machine(4, {"gravity_offset": {"G": 0.005}})
    fit = record(tmp_path, "fit", machine, "quick")
    alone = diagnose([fit], Model.new())
    assert alone.verdict == "nothing_missing"
    assert "gravity_offset" in verdict_sentence(alone)
    unused = record(tmp_path, "inverted", machine, "inverted", noise_seed=8)
    found = diagnose([fit], Model.new(), validate=[unused])
    consistent(found)
    assert found.verdict in ("unknown", "insufficient_data")
    assert found.proof is not None
    assert found.proof.proven is False
    assert (found.proof.reason, found.proof.causes) == ("resembles", ("gravity_offset",))


@pytest.mark.study
def test_long_recording_of_repeated_holds_gives_no_finding(tmp_path: Path) -> None:
    """So many windows of one tilt and speed weigh more than what is known beforehand: noise must not decide."""
    holds = "{spin_rpm: 3500, tilt_deg: [[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]], repeat: 120}"
    plan = Plan.load(f"schema: 1\nname: long\nhold_s: 2.0\nsegments:\n  - {holds}\n")
    found = diagnose([record(tmp_path, "long", Scenario(noise_seed=4), plan)], Model.new())
    consistent(found)
    assert found.verdict == "nothing_missing"


@pytest.mark.study
def test_changed_machine_in_the_validation_gives_no_proof(tmp_path: Path) -> None:
    machine = hidden_machine(6, {})
    stiff = {name: 1.1 * BENCH.value(name) for name in ("flexure_stiffness_x", "flexure_stiffness_y")}
    other = replace(machine, values={**machine.values, **stiff})
    found = diagnose(
        [record(tmp_path, "fit", machine, "quick")],
        Model.new(),
        validate=[record(tmp_path, "other", other, "check", noise_seed=9)],
    )
    consistent(found)
    assert not found.setup
    assert found.verdict == "unknown"
    assert found.proof is not None
    assert found.proof.proven is False
    assert "NOT consistent with other" in proof_sentence(found.proof)


def test_another_machine_in_the_validation_is_a_wrong_setup(tmp_path: Path) -> None:
    machine = hidden_machine(6, {})
    heavy = {
        name: 1.3 * BENCH.value(name) for name in ("rotor_inertia_x", "rotor_inertia_y", "rotor_inertia_z")
    }
    other = replace(machine, values={**machine.values, **heavy})
    found = diagnose(
        [record(tmp_path, "fit", machine, "quick")],
        Model.new(),
        validate=[record(tmp_path, "other", other, "check", noise_seed=9)],
    )
    assert found.verdict == "insufficient_data"
    assert found.setup
    assert found.proof is None
    assert proof_sentence(found.proof).startswith("NOT tested")


def test_an_event_in_the_validation_is_named_as_the_cause(tmp_path: Path) -> None:
    machine = hidden_machine(14, {})
    unused = record(tmp_path, "check", machine, "check", noise_seed=9)
    measurement = unused.measurement.copy()
    late = unused.time > 0.5 * unused.time[-1]
    measurement["coil_voltage_x"] += late * 1.5e-3 / BENCH.value("coil_constant")
    fit = record(tmp_path, "fit", machine, "quick")
    found = diagnose([fit], Model.new(), validate=[replace(unused, measurement=measurement)])
    consistent(found)
    assert found.proof is not None
    assert (found.proof.proven, found.proof.reason) == (False, "event")
    assert found.verdict == "insufficient_data"


def test_a_finding_is_proven_on_the_part_left_out(tmp_path: Path) -> None:
    machine = hidden("one effect")
    recording = record(tmp_path, "fit", machine, "quick")
    found = diagnose([recording], Model.new())
    consistent(found)
    assert [finding.name for finding in found.effects] == ["aero_cross"], verdict_sentence(found)
    assert found.proof is not None
    assert found.proof.left_out == "speed"
    assert found.proof.proven
    assert found.proof.after < 0.5 * found.proof.before
    # two recordings: each is predicted from the other
    again = Recording.open(record(tmp_path, "check", machine, "check", noise_seed=5).path)
    both = diagnose([recording, again], Model.new())
    assert both.proof is not None
    assert (both.proof.left_out, both.proof.parts) == ("recording", 2)
    assert both.proof.proven


@pytest.mark.parametrize("count", [1, 3, 4, 17])
def test_of_many_parameters_that_go_astray_together_the_furthest_are_named(count: int) -> None:
    astray = [
        Beyond("not_as_stated", f"parameter_{k}", "", 2.0 * k, 1.0, "N*m", 10.0 + k) for k in range(count)
    ]
    impossible = Beyond("impossible", "coil_constant", "", -1.0, 0.0, "N*m/V", 0.0)
    first, *texts = beyond_sentences([impossible, *astray])
    assert first.startswith("coil_constant would have to be")
    if count <= 3:
        assert [text.split()[0] for text in texts] == [own.name for own in astray]
        return
    (text,) = texts
    assert text.startswith(f"{count} bench parameters would have to lie at least 10 stated uncertainties")
    named = [own.name for own in astray if f"{own.name} (" in text]
    assert named == [own.name for own in astray[-3:]]
