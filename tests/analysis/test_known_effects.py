"""Effects that the model has already: of the right size, of a wrong one, and on a machine that does not have them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gyrowheel.show.contract import diagnosis_json
from gyrowheel.show.sentences.diagnosis import verdict_sentence
from gyrowheel.show.sentences.proof import doubt_sentence
from gyrowheel_analysis.add import add_effect
from gyrowheel_analysis.compare import compare
from gyrowheel_analysis.diagnosis.diagnose import diagnose, misstated
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.model import Model, Override
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import effect_from_text

from .machines import hidden_machine, record

TRUTH = {"c": 0.0054, "n": 1.9}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """Return recordings of a machine with a cross torque of the air, and of one without."""
    folder: Path = tmp_path_factory.mktemp("known")
    machine, bare = hidden_machine(6, {"aero_cross": TRUTH}), hidden_machine(7, {})
    return {
        "with": record(folder, "with", machine, "quick"),
        "unused": record(folder, "unused", machine, "check"),
        "without": record(folder, "without", bare, "quick"),
    }


def model_with(c: float, error: float = 8.0e-5) -> Model:
    """Return a model that has the cross torque already."""
    errors = {"c": error, "n": 0.05} if error else {"c": 0.0, "n": 0.0}
    return replace(
        Model.new(), effects={"aero_cross": {"c": c, "n": 1.9}}, effect_errors={"aero_cross": errors}
    )


@pytest.mark.slow
def test_an_effect_of_the_right_size_leaves_nothing_missing(recordings: dict[str, Recording]) -> None:
    found = diagnose([recordings["with"]], model_with(TRUTH["c"]))
    assert found.verdict == "nothing_missing"
    assert not found.effects


@pytest.mark.slow
@pytest.mark.parametrize("error", [8.0e-5, pytest.param(0.0, marks=pytest.mark.study)])
def test_an_effect_of_a_wrong_size_is_the_only_finding(
    recordings: dict[str, Recording], error: float
) -> None:
    found = diagnose([recordings["with"]], model_with(0.003, error))
    assert found.verdict == "effect"
    assert verdict_sentence(found) == "The size of aero_cross in the model disagrees with these recordings."
    (effect,) = found.effects
    assert effect.name == "aero_cross"
    # the size that it has, not what is to be added to that of the model
    assert abs(effect.coefficients["c"].value - TRUTH["c"]) < 3.0 * effect.coefficients["c"].standard_error
    assert effect.in_model is not None
    assert (effect.in_model["c"].value, effect.in_model["c"].standard_error) == (0.003, error)
    assert diagnosis_json(found)["effects"][0]["in_model"]["c"]["value"] == 0.003
    assert found.error is not None
    assert found.error.after.chi2_per_n < 1.2 < found.error.before.chi2_per_n


@pytest.mark.study  # a wrong size like the one above
@pytest.mark.slow
def test_an_effect_that_the_machine_lacks_is_fitted_as_zero(recordings: dict[str, Recording]) -> None:
    found = diagnose([recordings["without"]], model_with(TRUTH["c"]))
    assert found.verdict == "effect"
    (effect,) = found.effects
    assert effect.name == "aero_cross"
    assert abs(effect.coefficients["c"].value) < 3.0 * effect.coefficients["c"].standard_error


@pytest.mark.slow
def test_an_effect_of_the_model_is_fitted_again(recordings: dict[str, Recording]) -> None:
    added = add_effect(model_with(0.003), ["aero_cross"], [recordings["with"]], [recordings["unused"]])
    assert added.model.history[-1]["what"] == "fit again aero_cross"
    error = added.model.effect_errors["aero_cross"]["c"]
    assert abs(added.model.effects["aero_cross"]["c"] - TRUTH["c"]) < 3.0 * error
    assert added.error.validation_before is not None
    assert added.error.validation_after is not None
    assert added.error.validation_after.chi2_per_n < 1.2 < added.error.validation_before.chi2_per_n
    assert diagnose([recordings["unused"]], added.model).verdict == "nothing_missing"


@pytest.mark.slow
def test_a_size_biased_by_another_effect_gives_a_warning(recordings: dict[str, Recording]) -> None:
    added = add_effect(model_with(0.003), ["windage"], [recordings["with"]])
    assert ("moved", "aero_cross", "c") in [(d.kind, d.effect, d.coefficient) for d in added.doubts]
    assert "aero_cross c of the model moved by" in " ".join(map(doubt_sentence, added.doubts))
    fine = add_effect(model_with(TRUTH["c"]), ["windage"], [recordings["with"]])
    assert "moved" not in [doubt.kind for doubt in fine.doubts]


@pytest.mark.study  # test_support.py has a law that predicts worse
@pytest.mark.slow
def test_a_formula_that_explains_nothing_does_not_raise_the_noise(recordings: dict[str, Recording]) -> None:
    useless = effect_from_text("stator_pull: torque = -k*r*z; k [N*m/rad]")
    added = add_effect(Model.new(), [useless], [recordings["with"]], [recordings["unused"]])
    plain = compare([recordings["with"]], Model.new())
    noise = plain.channels["tilt_x"].noise_floor_rms
    assert added.error.noise_floor.rms["tilt_x"] == pytest.approx(noise, rel=0.05)
    assert added.error.after.chi2_per_n > 5.0
    # and it is not taken twice
    with pytest.raises(InputError, match=r"effects\.stator_pull: the model has it already"):
        add_effect(added.model, [useless], [recordings["with"]])


@pytest.mark.slow
def test_a_bench_parameter_ends_at_the_limit_of_what_a_model_file_holds(
    recordings: dict[str, Recording], tmp_path: Path
) -> None:
    """The model has six times the drag that the bearing has: only a bearing that drives would make up for it."""
    model = replace(Model.new(), effects={"eddy_drag": {"e": 6e-6}})
    added = add_effect(model, ["aero_cross"], [recordings["without"]])
    viscous = added.model.overrides["bearing_viscous"].value
    assert 0.0 <= viscous < 1e-12
    assert (
        Model.load(_saved(added.model, tmp_path / "model.yaml")).overrides["bearing_viscous"].value == viscous
    )
    (doubt,) = (own for own in added.doubts if own.kind == "bounded")
    assert doubt_sentence(doubt) == (
        "bearing_viscous ends at a limit of its possible values: aero_cross, or another effect of the model, takes too "
        "much of its place; fit recordings at more spin rates and tilts as well, or remove that effect"
    )
    free = add_effect(Model.new(), ["aero_cross"], [recordings["with"]])
    assert not [own for own in free.doubts if own.kind == "bounded"]


def _saved(model: Model, path: Path) -> Path:
    model.save(path)
    return path


@pytest.mark.slow
def test_a_model_far_from_the_recordings_is_reported_before_anything_else(
    recordings: dict[str, Recording],
) -> None:
    """Its value is fitted again in any case, so that nothing else shows it."""
    stated = {"flexure_stiffness_x": Override(0.1345, 0.0005)}
    for value in (0.07, 1e308):
        model = replace(model_with(TRUTH["c"]), overrides={"flexure_stiffness_x": Override(value)})
        found = diagnose([recordings["with"]], model)
        (wrong,) = found.misstated
        assert (wrong.name, wrong.value, found.verdict) == ("flexure_stiffness_x", value, "insufficient_data")
        assert wrong.found == pytest.approx(0.136, rel=0.05)
        assert "flexure_stiffness_x is" in diagnosis_json(found)["summary"]
        assert "take overrides.flexure_stiffness_x out" in diagnosis_json(found)["misstated"][0]["sentence"]
    assert compare([recordings["with"]], model).misstated == (wrong,)
    for other in ("with", "without"):  # of another machine, and with an effect that it lacks
        model = replace(model_with(TRUTH["c"]), overrides=stated)
        assert misstated(model, prepare([recordings[other]], model).problem) == ()
