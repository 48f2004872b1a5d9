"""Two sets of recordings under one model: what changed is found with its size, and equal sets have changed nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel_control.plans.plan import Plan

from .conftest import Wheel
from .helpers import DRAG_PLAN, OTHER_PLAN, Shell

PLAN = Plan.load(DRAG_PLAN)


def recorded(
    folder: Path, name: str, seed: int, machine: int = 4, **effects: dict[str, float]
) -> gw.Recording:
    path = folder / name
    gw.simulate(PLAN, effects=effects, machine=machine, seed=seed).save(path)
    return gw.Recording.open(path)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> gw.Recording:
    return recorded(tmp_path_factory.mktemp("sets"), "first", 1, windage={"w": 0.0010, "n": 1.48})


@pytest.fixture(scope="module")
def model(first: gw.Recording) -> gw.Model:
    return gw.Model("gyrowheel").add("windage", fit=first)


@pytest.mark.slow
def test_equal_sets_have_changed_nothing(first: gw.Recording, model: gw.Model, tmp_path: Path) -> None:
    again = recorded(tmp_path, "again", 2, windage={"w": 0.0010, "n": 1.48})
    found = gw.compare_sets(model, first, again)
    assert found.changes == ()
    assert found.explains
    assert found.p > 1e-3
    assert "Nothing changed" in found.headline()
    assert all(own.p > 1e-3 for own in found.tested)
    assert {"windage.w", "coil_constant"} <= {own.name for own in found.tested}
    assert found.to_columns()["name"] == [own.name for own in found.tested]


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.slow
def test_a_coefficient_that_changed_is_found_with_its_size_and_sign(
    first: gw.Recording, model: gw.Model, tmp_path: Path, *, turned: bool
) -> None:
    other = recorded(tmp_path, "other", 3, windage={"w": 0.0014, "n": 1.48})
    found = gw.compare_sets(model, other, first) if turned else gw.compare_sets(model, first, other)
    (change,) = found.changes
    (step,) = change.differences
    assert step.in_model
    assert step.name == "windage.w"
    size = -0.0004 if turned else 0.0004
    assert abs(step.difference - size) < 4.0 * step.standard_error
    assert step.second - step.first == pytest.approx(step.difference)
    assert abs(step.difference) > step.visible
    assert f"windage.w by {'−' if turned else '+'}" in found.headline()
    assert found.explains
    assert found.chi2_per_n < found.common_chi2_per_n


@pytest.mark.slow
def test_an_effect_that_is_in_one_set_alone_is_found(
    first: gw.Recording, model: gw.Model, tmp_path: Path
) -> None:
    other = recorded(tmp_path, "rotated", 3, windage={"w": 0.0010, "n": 1.48}, tilt_rotation={"a": 0.01})
    found = gw.compare_sets(model, first, other)
    (change,) = found.changes
    assert change.name == "tilt_rotation"
    (step,) = change.differences
    assert not step.in_model
    assert abs(step.difference - 0.01) < 4.0 * step.standard_error
    assert abs(step.first) < 4.0 * step.standard_error


@pytest.mark.slow
def test_the_verb_reports_the_change_as_page_and_json(gyrowheel: Shell, wheel: Wheel, tmp_path: Path) -> None:
    recorded(tmp_path, "calm", 5, machine=4)
    arguments = ("compare", "--model", wheel.model, "--on", tmp_path / "calm", "--against", wheel.recording)
    file = tmp_path / "found.json"
    assert "windage" in gyrowheel.good(*arguments, "--json", file).out.split("What changed")[1]
    found = json.loads(file.read_text(encoding="utf-8"))
    assert found["schema"] == 1
    assert "windage" in {change["name"] for change in found["changes"]}
    assert set(found["changes"][0]["differences"][0]) >= {"name", "unit", "difference", "standard_error", "p"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("compare", "--on", "DIR", "--against", "DIR2"), "--model: is missing"),
        (("compare", "--model", "M", "--against", "DIR"), "--against: compares two sets"),
        (
            ("compare", "DIR", "--model", "M", "--on", "DIR", "--against", "DIR2"),
            "--against: compares two sets",
        ),
        (("compare", "--model", "M", "--on", "DIR", "--against", "DIR"), "DIR"),
        (("compare", "--model", "M"), "DIR: is missing"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    gyrowheel: Shell, wheel: Wheel, arguments: tuple[str, ...], message: str
) -> None:
    names = {"M": wheel.model, "DIR": wheel.recording, "DIR2": wheel.other}
    refused = gyrowheel(*(names.get(word, word) for word in arguments))
    assert refused.code == 2
    assert (str(wheel.recording) if message == "DIR" else message) in refused.err


@pytest.mark.study
@pytest.mark.parametrize("seed", range(40))
def test_equal_machines_on_other_plans_have_changed_nothing(seed: int) -> None:
    """No false alarm on forty pairs; a machine's parameters lie anywhere within their stated uncertainties."""
    plans = [PLAN, Plan.load(OTHER_PLAN)]
    own, its = (gw.simulate(plan, machine=seed, seed=100 * seed + k) for k, plan in enumerate(plans))
    found = gw.compare_sets(gw.Model("gyrowheel"), own, its)
    assert found.changes == ()
