"""The model file: what is written is read back, what is wrong is named, every change can be undone."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gyrowheel.show.contract import diagnosis_json
from gyrowheel_analysis.add import add_effect
from gyrowheel_analysis.compare import compare
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.drag.estimate import DragEstimator
from gyrowheel_analysis.model import Model, Override
from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects import Effect, effect_from_mapping, effect_from_text, registry
from gyrowheel_sim.plant.scenario import Scenario

from .machines import hidden_machine, record

#: In proportion to the speed: with its square it could not be told from the inertia of the gimbal.
OWN = "stator_pull: torque = -k*r*z; k = 0.02 [N*m/rad]"


@pytest.fixture
def own() -> Effect:
    return effect_from_text(OWN)


def content(**changes: Any) -> dict[str, Any]:
    """Return the content of a model file with a registered and a declared effect."""
    base: dict[str, Any] = {
        "schema": 1,
        "bench": "gyrowheel",
        "overrides": {"shaft_inertia": {"value": 1.1e-4, "standard_error": 2e-6}},
        "effects": {
            "windage": {"w": {"value": 0.001, "standard_error": 1e-5}, "n": 1.5},
            "stator_pull": {
                "declaration": {
                    "torque": "-k*r*z",
                    "coefficients": {"k": {"unit": "N*m/rad", "usual": [0.01, 0.05]}},
                },
                "k": {"value": 0.02, "standard_error": 0.001},
            },
        },
        "history": [],
    }
    return {key: value for key, value in {**base, **changes}.items() if value is not ...}


def written(folder: Path, raw: Any) -> Path:
    file = folder / "model.yaml"
    file.write_text(raw if isinstance(raw, str) else yaml.safe_dump(raw, sort_keys=False))
    return file


def refusal(folder: Path, raw: Any) -> str:
    """Return the message with which a model file is refused, checked for its form."""
    file = written(folder, raw)
    with pytest.raises(InputError) as caught:
        Model.load(file)
    message = str(caught.value)
    assert str(file) in message
    assert "\n" not in message
    return message.replace(str(file), "FILE")


# --- reading and writing -----------------------------------------------------------------------------------------


def test_model_file_is_parsed_into_effects_overrides_and_declarations(tmp_path: Path) -> None:
    model = Model.load(written(tmp_path, content()))
    assert model.effects == {"windage": {"w": 0.001, "n": 1.5}, "stator_pull": {"k": 0.02}}
    assert model.effect_errors == {"windage": {"w": 1e-5, "n": 0.0}, "stator_pull": {"k": 0.001}}
    assert model.overrides == {"shaft_inertia": Override(1.1e-4, 2e-6)}
    assert model.bench.value("shaft_inertia") == 1.1e-4
    assert model.stated_bench.value("shaft_inertia") != 1.1e-4
    assert list(model.declared) == ["stator_pull"]
    assert model.declared["stator_pull"].formula == "rotor_torque = -k*Omega*z/Omega_ref"
    assert model.library == {**registry(), **model.declared}


def test_a_model_is_written_and_read_back(tmp_path: Path) -> None:
    model = Model.load(written(tmp_path, content()))
    file = tmp_path / "sub" / "again.yaml"
    model.save(file)
    again = Model.load(file)
    assert again.to_mapping() == model.to_mapping()
    assert again.declared == model.declared
    assert model.diff(again) == []
    # the declaration as it is written is complete: it reads the same by itself
    declaration = yaml.safe_load(file.read_text())["effects"]["stator_pull"]["declaration"]
    assert effect_from_mapping("stator_pull", declaration) == model.declared["stator_pull"]


def test_a_new_model_is_written_and_read_back(tmp_path: Path) -> None:
    Model.new().save(tmp_path / "m.yaml")
    assert Model.load(tmp_path / "m.yaml").to_mapping() == Model.new().to_mapping()


def test_a_coefficient_not_given_has_its_usual_value(tmp_path: Path) -> None:
    raw = content()
    del raw["effects"]["stator_pull"]["k"]
    model = Model.load(written(tmp_path, raw))
    assert model.effects["stator_pull"]["k"] == pytest.approx(np.sqrt(0.01 * 0.05))


def test_a_model_that_is_saved_elsewhere_has_the_same_bench(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not one of the same name that lies there, nor one that depends on where it is read from."""
    from importlib import resources

    text = resources.files("gyrowheel_sim").joinpath("config/bench.yaml").read_text()
    for place in ("one", "two", "three"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "my.yaml").write_text(text.replace("name: gyrowheel", f"name: {place}"))
    model = Model.load(written(tmp_path / "one", content(bench="my.yaml")))
    model.save(tmp_path / "two" / "m.yaml")
    monkeypatch.chdir(tmp_path / "three")
    assert Model.load(tmp_path / "two" / "m.yaml").stated_bench.name == "one"
    (tmp_path / "deeper").mkdir()
    Model.new("my.yaml").save(tmp_path / "deeper" / "m.yaml")
    monkeypatch.chdir(tmp_path / "two")
    assert Model.load(tmp_path / "deeper" / "m.yaml").stated_bench.name == "three"
    # a file that happens to be called like a shipped bench is not taken for it
    (tmp_path / "one" / "gyrowheel").write_text(text.replace("name: gyrowheel", "name: other"))
    assert Model.load(written(tmp_path / "one", content())).stated_bench.name == "gyrowheel"


def test_a_bench_file_is_found_next_to_the_model(tmp_path: Path) -> None:
    from importlib import resources

    text = resources.files("gyrowheel_sim").joinpath("config/bench.yaml").read_text()
    (tmp_path / "my_bench.yaml").write_text(text.replace("name: gyrowheel", "name: mine"))
    model = Model.load(written(tmp_path, content(bench="my_bench.yaml")))
    assert model.bench_source == "my_bench.yaml"
    model.save(tmp_path / "model.yaml")
    assert Model.load(tmp_path / "model.yaml").stated_bench == model.stated_bench


def _declared(**changes: Any) -> dict[str, Any]:
    declaration = {"torque": "-k*z", "coefficients": {"k": {"unit": "N*m/rad"}}}
    kept = {key: value for key, value in {**declaration, **changes}.items() if value is not ...}
    return content(effects={"own": {"declaration": kept}})


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        ("a: [1", "FILE: not valid YAML"),
        ("[" * 5000, "FILE: not valid YAML"),
        ("!!python/object/apply:os.system [ls]", "FILE: not valid YAML"),
        ("- 1", "FILE: not a model file"),
        ("", "FILE: not a model file"),
        (content(schema=2), "FILE: schema: 2 is not known; allowed: 1"),
        (content(schema=...), "FILE: schema: missing; allowed: 1"),
        (content(extra=1), "FILE: extra: no such field; allowed: schema, bench, overrides, effects, history"),
        (content(bench=5), "FILE: bench: 5 is not a text; allowed: the name of a bench, or the path of its file"),
        (content(overrides=[1]), "FILE: overrides: [1] is not a mapping"),
        (content(overrides={"shaft_inertja": 1}), "FILE: overrides.shaft_inertja: the bench has no such parameter"),
        (content(overrides={"shaft_inertia": -1}), "FILE: overrides.shaft_inertia: -1 is out of range; allowed: > 0"),
        (content(overrides={"shaft_inertia": "much"}), "FILE: overrides.shaft_inertia: 'much' is not a number"),
        (content(overrides={"shaft_inertia": {"val": 1}}), "shaft_inertia.val: no such field; did you mean value?"),
        (
            content(overrides={"shaft_inertia": {"value": 1e-4, "standard_error": -1}}),
            "FILE: overrides.shaft_inertia.standard_error: -1 is out of range",
        ),
        (content(effects=[]), "FILE: effects: [] is not a mapping"),
        (content(effects="windage"), "FILE: effects: 'windage' is not a mapping"),
        (content(effects={"windgae": {}}), "FILE: effects: 'windgae' is not a known effect; did you mean windage"),
        (content(effects={"windage": 5}), "FILE: effects.windage: 5 is not a mapping"),
        (content(effects={"windage": {"q": 1}}), "FILE: effects.windage.q: no such coefficient; it has w, n"),
        (content(effects={"windage": {"w": "x"}}), "FILE: effects.windage.w: 'x' is not a number"),
        (content(effects={"windage": {"w": True}}), "FILE: effects.windage.w: True is not a number"),
        (content(effects={"windage": {"w": float("nan")}}), "FILE: effects.windage.w: nan is out of range"),
        (content(effects={"windage": {"w": 7}}), "FILE: effects.windage.w: 7 is out of range; allowed: -0.1 .. 0.1"),
        (
            content(effects={"windage": {"w": {"value": 0.001, "standard_error": "x"}}}),
            "FILE: effects.windage.w.standard_error: 'x' is not a number",
        ),
        (content(history={}), "FILE: history: {} is not a list"),
        (content(history=["x"]), "FILE: history.0: 'x' is not a mapping"),
        (content(history=[{"calibrated": 5}]), "FILE: history.0.calibrated: 5 is not a mapping"),
        (content(history=[{"restated": {"shaft_inertia": {"value": 1, "standard_error": "x"}}}]),
         "FILE: history.0.restated.shaft_inertia.standard_error: 'x' is not a number; allowed: >= 0"),
        # declarations
        (content(effects={"own": {"k": 1}}), "FILE: effects: 'own' is not a known effect"),
        (content(effects={"own": {"declaration": "-k*z"}}), "FILE: effects.own.declaration: a mapping"),
        (content(effects={"windage": {"declaration": {}}}), "FILE: effects.windage: there is an effect named"),
        (content(effects={"a b": {"declaration": {}}}), "FILE: effects.a b: 'a b' is not a name for an effect"),
        (content(effects={5: {"declaration": {}}}), "FILE: effects.5: '5' is not a name for an effect"),
        (_declared(torque=...), "FILE: effects.own.declaration: a law is missing"),
        (_declared(torque="-k*z*"), "own.declaration.torque: column 6: the formula ends"),
        (_declared(torque="-k*__import__('os')"), "own.declaration.torque: column 4: '__import__'"),
        (_declared(torque="-k*Omega"), "own.declaration.torque: column 1: '-k*Omega' has the unit N*m/s"),
        (_declared(coefficients={"k": {}}), "own.declaration.coefficients.k.unit: missing; N*m/rad would fit"),
        (_declared(coefficients={"k": "mN*m"}), "own.declaration.coefficients.k.unit: 'mN' is no SI unit"),
        (_declared(colour="red"), "own.declaration.colour: no such field"),
    ],
)  # fmt: skip
def test_a_bad_model_file_is_refused_with_the_field(raw: Any, message: str, tmp_path: Path) -> None:
    assert message in refusal(tmp_path, raw)


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        Model.load(tmp_path / "none.yaml")
    with pytest.raises(InputError, match="cannot be read"):
        Model.load(tmp_path)
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="not a text file"):
        Model.load(tmp_path / "b.yaml")


def test_a_model_is_saved_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "m.yaml"
    Model.new().save(file)
    before = file.read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    model = Model.load(written(tmp_path, content()))
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match="cannot be written: No space left"):
        model.save(file)
    monkeypatch.undo()
    assert file.read_bytes() == before
    assert sorted(os.listdir(tmp_path)) == ["m.yaml", "model.yaml"]


def test_a_model_cannot_be_saved_in_the_place_of_a_folder(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        Model.new().save(tmp_path / "m.yaml")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        Model.new().save(tmp_path / "file" / "m.yaml")
    assert sorted(os.listdir(tmp_path)) == ["file", "m.yaml"]


# --- changing ----------------------------------------------------------------------------------------------------


def test_removed_effect_is_restored_by_undo(tmp_path: Path) -> None:
    model = Model.load(written(tmp_path, content()))
    removed = model.removed("stator_pull", "2026-01-01T00:00:00+00:00")
    assert list(removed.effects) == ["windage"]
    assert not removed.declared
    assert removed.history[-1]["what"] == "remove stator_pull"
    removed.save(tmp_path / "r.yaml")
    undone = Model.load(tmp_path / "r.yaml").undone()
    assert undone.to_mapping() == model.to_mapping()
    assert undone.declared == model.declared
    with pytest.raises(
        InputError, match=r"effects\.stator_pull: the model has no such effect; it has: windage"
    ):
        removed.removed("stator_pull", "now")
    with pytest.raises(InputError, match="history: nothing to undo"):
        undone.undone()


def test_every_kind_of_change_can_be_undone(tmp_path: Path) -> None:
    """Values, order, further and fewer effects; what the history keeps of a change is what it changed."""
    first = Model.load(written(tmp_path, content()))
    own = {name: {**values} for name, values in first.effects.items()}

    def change(model: Model, effects: Any, **values: Override) -> Model:
        errors = {name: dict.fromkeys(entry, 1e-3) for name, entry in effects.items()}
        return model.changed({"what": "x"}, overrides=values, effects=effects, effect_errors=errors)

    states = [first]
    for effects, values in (
        (own | {"windage": {"w": 0.002, "n": 1.5}}, {"shaft_inertia": Override(1.2e-4, 2e-6)}),
        ({"stator_pull": own["stator_pull"], "windage": own["windage"]}, {}),
        ({"windage": own["windage"]}, {"shaft_inertia": Override(1.3e-4), "supply_voltage": Override(28.0)}),
        ({"windage": {"w": 0.001, "n": 1.6}}, {"supply_voltage": Override(28.0)}),
        ({}, {}),
    ):
        states.append(change(states[-1], effects, **values))
    assert list(states[1].history[-1]["undo"]["back"]["effects"]) == ["windage"]
    states[-1].save(tmp_path / "m.yaml")
    model = Model.load(tmp_path / "m.yaml")
    for before in reversed(states[:-1]):
        model = model.undone()
        assert yaml.safe_dump(model.to_mapping(), sort_keys=False) == yaml.safe_dump(
            before.to_mapping(), sort_keys=False
        )


@pytest.mark.slow
def test_file_with_a_hundred_changes_is_read_back(tmp_path: Path) -> None:
    """The history does not keep the model as a whole at every change, until nothing would read it again."""
    model = Model.load(written(tmp_path, content(effects={})))
    sizes = []
    for k in range(100):
        effects = {**model.effects, f"own_{k}": {"k": 0.02}}
        declared = {
            f"own_{k}": effect_from_mapping(f"own_{k}", content()["effects"]["stator_pull"]["declaration"])
        }
        model = model.changed(
            {"what": f"add own_{k}"}, overrides={}, effects=effects, effect_errors={}, declared=declared
        )
        if k in (24, 49, 99):
            model.save(tmp_path / f"{k}.yaml")
            sizes.append((tmp_path / f"{k}.yaml").stat().st_size)
    assert sizes[2] < 2.2 * sizes[1] < 4.8 * sizes[0]
    assert Model.load(tmp_path / "99.yaml").undone().to_mapping()["effects"].keys() == {
        f"own_{k}" for k in range(99)
    }


def test_a_model_too_long_to_be_read_is_not_written(tmp_path: Path) -> None:
    model = Model.load(written(tmp_path, content()))
    before = (tmp_path / "model.yaml").read_text()
    with pytest.raises(InputError, match=r"the model would have 1\d{6} characters; allowed: up to 1000000"):
        replace(model, history=({"what": "x" * 1_000_000},)).save(tmp_path / "model.yaml")
    assert (tmp_path / "model.yaml").read_text() == before


@pytest.mark.parametrize(
    "undo",
    [
        {"back": 1},
        {"back": {"effects": [1]}},
        {"back": {"effects": {"windage": 3}}},
        {"back": {}, "order": 7},
    ],
)
def test_an_invalid_undo_entry_is_refused(undo: Any, tmp_path: Path) -> None:
    model = Model.load(written(tmp_path, content(history=[{"what": "add", "undo": undo}])))
    with pytest.raises(InputError):
        model.undone()


def test_a_change_without_an_undo_entry_cannot_be_undone(tmp_path: Path) -> None:
    model = Model.load(written(tmp_path, content(history=[{"what": "by hand"}])))
    with pytest.raises(InputError, match=r"history\.0\.undo: missing"):
        model.undone()


def test_diff_lists_additions_and_changes(tmp_path: Path) -> None:
    model = Model.load(written(tmp_path, content()))
    lines = Model.new().diff(model)
    assert "+ overrides.shaft_inertia: 0.00011 ± 2e-06" in lines
    assert "+ effects.windage.w: 0.001 ± 1e-05" in lines
    assert "+ effects.stator_pull.k: 0.02 ± 0.001" in lines
    assert "+ effects.stator_pull.rotor_torque: -k*Omega*z/Omega_ref" in lines
    raw = content()
    raw["effects"]["stator_pull"]["declaration"]["torque"] = "-k*r^3*z"
    other = Model.load(written(tmp_path, raw))
    assert model.diff(other) == [
        "~ effects.stator_pull.rotor_torque: -k*Omega*z/Omega_ref -> -k*Omega^3*z/Omega_ref^3"
    ]
    assert model.diff(model) == []


# --- effects of one's own in the loop ------------------------------------------------------------------------------


@pytest.mark.study  # tests/gyrowheel/test_front_door.py does the same
def test_a_user_defined_effect_is_added_fitted_and_used(own: Effect, tmp_path: Path) -> None:
    truth = {"stator_pull": {"k": 0.025}}
    drawn = hidden_machine(21, {})
    machine = Scenario(drawn.values, truth, 21, {"stator_pull": own})
    fit = record(tmp_path, "fit", machine, "quick")
    unused = record(tmp_path, "unused", machine, "check", noise_seed=9000)

    added = add_effect(Model.new(), [own], [fit], [unused])
    estimate = added.coefficients["stator_pull"]["k"]
    assert abs(estimate.value - 0.025) < 4.0 * estimate.standard_error
    assert estimate.unit == "N*m/rad"
    assert added.error.validation_before is not None
    assert added.error.validation_after is not None
    assert added.error.validation_after.chi2_per_n < 0.5 * added.error.validation_before.chi2_per_n

    added.model.save(tmp_path / "m.yaml")
    model = Model.load(tmp_path / "m.yaml")
    assert model.declared == {"stator_pull": own}
    assert model.effects == added.model.effects
    assert model.history[-1]["what"] == "add stator_pull"
    # the model with it is used everywhere
    assert compare([unused], model).error_before.chi2_per_n < 2.0
    assert diagnose([fit], model).verdict == "nothing_missing"
    estimator = DragEstimator(model)
    assert estimator.finish() == []
    # a further effect beside it, and both taken back
    both = add_effect(model, ["windage"], [fit], [unused]).model
    assert set(both.effects) == {"stator_pull", "windage"}
    assert both.declared == model.declared
    assert both.undone().to_mapping() == model.to_mapping()
    assert both.undone().undone().to_mapping() == Model.new().to_mapping()
    with pytest.raises(InputError, match=r"effects\.stator_pull: the model has it already"):
        add_effect(model, [own], [fit])


@pytest.mark.slow
def test_a_registered_effect_as_an_object_is_no_declaration(tmp_path: Path) -> None:
    machine = hidden_machine(22, {"windage": {"w": 0.001, "n": 1.5}})
    fit = record(tmp_path, "fit", machine, "check")
    added = add_effect(Model.new(), [registry()["windage"]], [fit])
    assert not added.model.declared
    assert set(added.model.effects) == {"windage"}


def test_an_effect_that_takes_a_name_in_use_is_refused(tmp_path: Path) -> None:
    fit = record(tmp_path, "fit", hidden_machine(22, {}), "check")
    taken = effect_from_text("windage: axial_torque = -w*r; w [N*m]")
    with pytest.raises(InputError, match="there is an effect named 'windage' already"):
        add_effect(Model.new(), [taken], [fit])
    own = effect_from_text(OWN)
    with pytest.raises(InputError, match="'stator_pull' is given twice"):
        add_effect(Model.new(), [own, own], [fit])


@pytest.mark.study  # test_unknown_laws.py finds the formula
@pytest.mark.slow
def test_a_proposal_is_added_to_the_model_unchanged(tmp_path: Path) -> None:
    machine = hidden_machine(8, {"three_lobed": {"A": 0.003}})
    fit = record(tmp_path, "fit", machine, "quick")
    unused = record(tmp_path, "unused", machine, "check", noise_seed=9000)
    found = diagnose([fit], Model.new())
    (form,) = diagnosis_json(found)["free_form"]

    added = add_effect(Model.new(), [effect_from_mapping(form["name"], form["declaration"])], [fit], [unused])
    assert added.error.validation_before is not None
    assert added.error.validation_after is not None
    assert added.error.validation_after.chi2_per_n < 0.1 * added.error.validation_before.chi2_per_n

    # or by hand: the mapping under its name, the coefficients beside it
    raw = content(effects={form["name"]: {"declaration": form["declaration"], **{
        key: {"value": c["value"], "standard_error": c["standard_error"]} for key, c in form["coefficients"].items()
    }}})  # fmt: skip
    model = Model.load(written(tmp_path, raw))
    assert model.declared == added.model.declared
