"""Two models on the same recordings: the right one is preferred, or nothing is decided and a test is named."""

from __future__ import annotations

from pathlib import Path

import pytest

import gyrowheel as gw

from .conftest import Wheel
from .helpers import Shell


@pytest.fixture(scope="module")
def models(wheel: Wheel) -> dict[str, gw.Model]:
    plain = gw.Model.load(wheel.model)
    return {name: plain.add(name, fit=wheel.recording) for name in ("windage", "bearing_coulomb")} | {
        "plain": plain
    }


@pytest.mark.parametrize("wrong", ["bearing_coulomb", "plain"])
@pytest.mark.slow
def test_the_right_model_is_preferred_in_either_order(
    wheel: Wheel, models: dict[str, gw.Model], wrong: str
) -> None:
    found = gw.compare_models(models["windage"], models[wrong], wheel.recording)
    assert found.preferred == "first"
    assert found.evidence > 7.0
    assert found.first.explains
    assert found.first.chi2_per_n < found.second.chi2_per_n
    assert found.test is None
    turned = gw.compare_models(models[wrong], models["windage"], wheel.recording)
    assert turned.preferred == "second"
    assert turned.evidence == pytest.approx(-found.evidence, rel=0.05)


@pytest.mark.slow
def test_models_that_cannot_be_told_apart_come_with_the_test_that_decides(wheel: Wheel) -> None:
    """The same drag by two laws that differ at other speeds and densities."""
    plain = gw.Model.load(wheel.model)
    laws = {"one": "axial_torque = -k*r^1.5", "two": "axial_torque = -k*r^1.45"}
    one, two = (plain.add(gw.own_effect(law, name=name), fit=wheel.recording) for name, law in laws.items())
    found = gw.compare_models(one, two, wheel.recording)
    assert found.preferred == "none"
    assert abs(found.evidence) < 7.0
    assert "cannot decide between" in found.headline()
    assert (found.test is not None) == ("run plan" in found.headline())


def test_the_verb_compares_two_model_files(
    gyrowheel: Shell, wheel: Wheel, models: dict[str, gw.Model], tmp_path: Path
) -> None:
    files = []
    for name in ("windage", "bearing_coulomb"):
        files.append(tmp_path / f"{name}.yaml")
        models[name].save(files[-1])
    shown = gyrowheel.good("compare", *files, "--on", wheel.recording)
    assert "These recordings prefer windage.yaml to bearing_coulomb.yaml" in shown.out.replace("\n", " ")
    found = gyrowheel.good("compare", *files, "--on", wheel.recording, "--json", "-").json
    assert found["preferred"] == "first"
    assert set(found["models"][0]["channels"]) == set(found["models"][1]["channels"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("compare", "A.yaml", "B.yaml"),
            "--model: is missing; allowed: --model M.yaml, or two model files and --on",
        ),
        (("compare", "A.yaml", "--on", "DIR"), "--on: compares two models; 1 files are given"),
        (
            ("compare", "A.yaml", "B.yaml", "--on", "DIR", "--model", "A.yaml"),
            "--on: compares two models; allowed",
        ),
        (("compare", "A.yaml", "A.yaml", "--on", "DIR"), "has the same effects as"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    gyrowheel: Shell,
    wheel: Wheel,
    models: dict[str, gw.Model],
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    names = {"A.yaml": tmp_path / "A.yaml", "B.yaml": tmp_path / "B.yaml", "DIR": wheel.recording}
    models["windage"].save(names["A.yaml"])
    models["plain"].save(names["B.yaml"])
    refused = gyrowheel(*(names.get(word, word) for word in arguments))
    assert refused.code == 2
    assert message in refused.err


def test_models_of_different_benches_are_refused(wheel: Wheel, models: dict[str, gw.Model]) -> None:
    with pytest.raises(gw.InputError, match=r"is of another bench than .* allowed: models of one bench"):
        gw.compare_models(models["windage"], gw.Model("dtg"), wheel.recording)
