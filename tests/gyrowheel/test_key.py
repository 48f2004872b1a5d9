"""The verb `key` and its Python face: a sealed key opened and judged against a model."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import gyrowheel as gw

from .conftest import Wheel
from .helpers import Shell, write

WINDAGE = {"w": 0.0013, "n": 1.5}


def sealed(folder: Path, **effects: dict[str, float]) -> Path:
    content = {"values": {"rotor_inertia_z": 1.766e-3}, "effects": effects}
    return write(folder / "key.json", json.dumps(content))


@pytest.fixture(scope="module")
def learned(wheel: Wheel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a model that has learned the windage of the machine."""
    path = Path(shutil.copy(wheel.model, tmp_path_factory.mktemp("learned") / "model.yaml"))
    gw.Model.load(path).add("windage", fit=wheel.recording).save(path)
    return path


def test_a_drawn_key_is_shown_in_readable_units(gyrowheel: Shell, tmp_path: Path) -> None:
    key = tmp_path / "key.json"
    plan = write(
        tmp_path / "plan.yaml",
        "schema: 1\nname: p\nhold_s: 0.2\nsegments:\n  - {spin_rpm: 3000, tilt_deg: [[0, 0]]}\n",
    )
    gyrowheel.good("simulate", "--plan", plan, "--blind", key, "--seed", 5, "-o", tmp_path / "run")
    drawn = json.loads(key.read_text(encoding="utf-8"))
    text = gyrowheel.good("key", key).out
    assert max(map(len, text.splitlines())) <= 80
    assert all(name in text for name in (*drawn["effects"], *drawn["values"]))
    shown = gyrowheel.good("key", key, "--json", "-").json
    assert shown["outcome"] is None
    hidden = {row["parameter"]: row["hidden"] for row in shown["parameters"]}
    assert hidden == drawn["values"]
    inertia = drawn["values"]["rotor_inertia_z"]
    assert any(line.split()[:2] == ["rotor_inertia_z", f"{1e6 * inertia:.4g}"] for line in text.splitlines())


@pytest.mark.parametrize(
    ("hidden", "outcome", "words"),
    [
        ({"windage": WINDAGE}, "right", "Right: the model has windage"),
        ({"windage": {"w": 0.0023, "n": 1.5}}, "inaccurate", "windage w"),
        ({"windage": WINDAGE, "earth_rate": {"E_x": 2e-5, "E_y": 2e-5}}, "incomplete", "lacks earth_rate"),
        ({}, "wrong", "WRONG: the model has windage"),
        ({"aero_cross": {"c": 5e-3}}, "wrong", "Hidden: aero_cross."),
    ],
)
def test_a_model_is_judged(
    gyrowheel: Shell,
    learned: Path,
    tmp_path: Path,
    hidden: dict[str, dict[str, float]],
    outcome: str,
    words: str,
) -> None:
    key = sealed(tmp_path, **hidden)
    result = gyrowheel("key", key, "--against", learned, "--fail-on-finding")
    assert result.code == (0 if outcome == "right" else 1)
    assert words in result.out
    found = gyrowheel.good("key", key, "--against", learned, "--json", "-").json
    assert found["outcome"] == outcome
    (w,) = (row for row in found["effects"] if (row["effect"], row["coefficient"]) == ("windage", "w"))
    assert w["model"] == pytest.approx(1.3e-3, rel=0.1)
    if "windage" in hidden:
        assert w["distance"] == pytest.approx((w["model"] - w["hidden"]) / w["standard_error"])
    else:
        assert w["hidden"] is None


def test_an_empty_model_is_right_without_a_hidden_effect(
    gyrowheel: Shell, wheel: Wheel, tmp_path: Path
) -> None:
    result = gw.open_key(sealed(tmp_path), gw.Model.load(wheel.model))
    assert result.outcome == "right"
    (inertia,) = result.parameters
    # as stated in the bench file: 1779 +- 8.9
    assert inertia.distance == pytest.approx(13.0 / 8.895, rel=0.01)
    assert result.headline() == "Right: no effect was hidden, and the model has none."
    assert "rotor_inertia_z" in result._repr_html_()
    assert list(result.to_columns()["name"]) == ["rotor_inertia_z"]


def test_a_formula_may_describe_an_effect_outside_the_library(wheel: Wheel, tmp_path: Path) -> None:
    key = sealed(tmp_path, speed_bump={"A": 0.04, "p": 0.8, "w": 0.11})
    model = gw.Model.load(wheel.model)
    assert gw.open_key(key, model).outcome == "incomplete"
    own = model.add(gw.own_effect("-k*z", name="bump"), fit=wheel.recording)
    judged = gw.open_key(key, own)
    assert judged.outcome == "described"
    assert "formula bump" in judged.sentence
    # but not for an effect that has a name
    known = sealed(tmp_path, windage=WINDAGE)
    assert gw.open_key(known, own).outcome == "wrong"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.json"], ["nowhere.json"]),
        (["broken.json"], ["broken.json", "effects"]),
        (["odd.json"], ["odd.json", "rotor_inertia_q"]),
        (["good.json", "--fail-on-finding"], ["--fail-on-finding", "--against"]),
        (["good.json", "--against", "m.yaml", "--bench", "dtg"], ["bench", "leave it out"]),
    ],
)
def test_bad_input_is_one_line(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    gw.Model().save("m.yaml")
    write(tmp_path / "good.json", json.dumps({"values": {}, "effects": {}}))
    write(tmp_path / "broken.json", json.dumps({"values": {}}))
    write(tmp_path / "odd.json", json.dumps({"values": {"rotor_inertia_q": 1.0}, "effects": {}}))
    result = gyrowheel("key", *arguments)
    assert result.code == 2
    (line,) = result.err.splitlines()
    assert all(word in line for word in words), line
    assert "name a new file" not in line
