"""Pictures of the error that falls, of the verbs that have a before and an after."""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import gyrowheel as gw
from gyrowheel.comparison.picture import arrow_scale, arrows
from gyrowheel.investigation.page import unseen_sentence
from gyrowheel_analysis.channels import CHANNELS
from gyrowheel_analysis.diagnosis.estimates import DetectionLimit
from gyrowheel_analysis.diagnosis.findings import NextTest
from gyrowheel_analysis.residuals.error_table import Part
from gyrowheel_core.units import DEG

from ..letters import check_letters
from .conftest import Wheel
from .findings import diagnosis, finding
from .helpers import Shell


def colours(path: Path) -> set[object]:
    """Return the colours of a picture that fill more than a few dots."""
    with Image.open(io.BytesIO(path.read_bytes())) as image:
        assert image.size == (1600, 1000)
        found = image.convert("RGB").getcolors(1 << 24)
    assert found is not None
    return {colour for count, colour in found if count > 200}


@pytest.mark.slow
def test_diagnose_and_add_draw_the_error_before_and_after(
    gyrowheel: Shell, wheel: Wheel, tmp_path: Path
) -> None:
    found, added = tmp_path / "found.png", tmp_path / "added.png"
    options = ["--model", wheel.model, "--picture", found]
    result = gyrowheel.good("diagnose", wheel.recording, *options)
    assert result.out.rstrip().endswith(f"picture: {found}")
    model = shutil.copy(wheel.model, tmp_path / "model.yaml")
    fit = ["--model", model, "--fit", wheel.recording, "--validate", wheel.other]
    result = gyrowheel.good("model", "add", "windage", *fit, "--picture", added, "--json", "-")
    assert set(result.json) >= {"error", "effects"}  # nothing but JSON on stdout
    # before and after are there, each in its colour
    assert len(colours(found) & colours(added)) >= 4
    assert found.read_bytes() != added.read_bytes()


@pytest.mark.study  # diagnose and add draw the same pictures
def test_investigate_ends_with_the_table_and_draws_the_last_diagnosis(
    gyrowheel: Shell, wheel: Wheel, tmp_path: Path
) -> None:
    picture = tmp_path / "last.png"
    options = ["--model", wheel.model, "--budget", 0, "--simulate", "-o", tmp_path / "run"]
    result = gyrowheel.good("investigate", wheel.recording, *options, "--picture", picture)
    table = result.out.partition("Error before and after")[2]
    assert "χ²/N" in table
    assert "Settled" in table
    assert len(colours(picture)) >= 4
    # recordings of eight holds do not show everything, and it is said how to go on
    assert "To be thorough" in result.out
    (again,) = (line for line in result.out.splitlines() if line.endswith("--thorough"))
    words = f"  gyrowheel investigate {wheel.recording} --model {wheel.model} --simulate --thorough"
    assert again == words


@pytest.mark.study  # test_same_machine.py goes on with the command of a diagnosis
def test_the_resuming_command_names_the_same_machine(gyrowheel: Shell, wheel: Wheel, tmp_path: Path) -> None:
    machine = ["--effect", "windage:w=0.0013", "--effect", "earth_rate", "--machine", 3, "--seed", 4]
    options = ["--model", wheel.model, "--budget", 0, "--simulate", "-o", tmp_path / "run", "--averages"]
    out = gyrowheel.good("investigate", wheel.recording, *options, *machine).out
    (again,) = (line for line in out.splitlines() if "gyrowheel investigate" in line)
    for words in (
        "--effect windage:w=0.0013 --effect earth_rate",
        "--machine 3 --seed 4",
        "--averages --simulate",
    ):
        assert words in again
    thorough = gyrowheel.good(
        "investigate", wheel.recording, *options[:-2], tmp_path / "other", "--averages", "--thorough"
    ).out
    assert "To be thorough" not in thorough


def test_undetectable_effects_are_named_if_a_test_can_show_them() -> None:
    limits = (
        DetectionLimit("windage", "", "w", 1.0, "N*m", (2.0, 3.0)),
        DetectionLimit("gravity_offset", "", "G", 9.0, "N*m", (2.0, 3.0)),
    )
    found = replace(diagnosis("effect", finding("aero_cross")), limits=limits)
    assert unseen_sentence(found) == ""
    sentence = unseen_sentence(
        replace(found, next_test=NextTest("inverted", 60.0, 0.7, reveals="gravity_offset"))
    )
    assert "gravity_offset" in sentence
    assert "windage" not in sentence


@pytest.mark.parametrize("verb", ["diagnose", "add", "investigate"])
def test_a_picture_replaces_only_pictures(gyrowheel: Shell, wheel: Wheel, tmp_path: Path, verb: str) -> None:
    notes = tmp_path / "notes.png"
    notes.write_text(json.dumps({"mine": 1}), encoding="utf-8")
    before = wheel.model.read_bytes()
    arguments = {
        "diagnose": ["diagnose", wheel.recording],
        "add": ["model", "add", "windage", "--fit", wheel.recording],
        "investigate": ["investigate", wheel.recording, "-o", tmp_path / "run"],
    }[verb]
    result = gyrowheel(*arguments, "--model", wheel.model, "--picture", notes)
    assert result.code == 2
    assert "--picture" in result.err
    assert notes.read_text(encoding="utf-8") == '{"mine": 1}'
    assert wheel.model.read_bytes() == before
    assert not (tmp_path / "run").exists()


def longest(windows: int, wrong: float, noise: float, *, wrong_there: bool = False) -> float:
    """Return the longest arrow of what is wrong, in degrees, where one window of twelve is noisy."""
    values = np.full(windows, wrong, dtype=complex)
    sigma = np.full(windows, 1e-5)
    values[::12], sigma[::12] = (10.0 if wrong_there else 1.0) * noise, noise
    part = Part(CHANNELS["tilt"], values, sigma, np.abs(values) ** 2 / sigma**2)
    data = SimpleNamespace(parts={"tilt": part}, windows=SimpleNamespace(mean_tilt=np.full(windows, 4 * DEG)))
    return wrong * arrow_scale(data)  # type: ignore[arg-type]


def test_arrow_lengths_follow_the_misfit_and_not_the_noise() -> None:
    assert longest(48, 1e-4, 1e-5) == pytest.approx(0.55 * 4.0)
    # a noisy window does not make the others short
    assert longest(48, 1e-4, 1e-2) == pytest.approx(0.55 * 4.0)
    # nor does one that is wrong
    assert longest(48, 1e-4, 1e-2, wrong_there=True) == pytest.approx(0.55 * 4.0)
    # noise alone has short arrows
    assert longest(48, 1e-5, 1e-5) == pytest.approx(0.12 * 4.0)


def test_an_outlier_of_usual_noise_sets_no_scale_and_its_arrow_is_cut_off() -> None:
    values = 1e-4 * np.exp(1j * np.arange(24.0))
    values[5] *= 40.0
    sigma = np.full(24, 1e-5)
    part = Part(CHANNELS["tilt"], values, sigma, np.abs(values) ** 2 / sigma**2)
    data = SimpleNamespace(parts={"tilt": part}, windows=SimpleNamespace(mean_tilt=np.full(24, 4 * DEG)))
    drawn = np.abs(arrows(data))  # type: ignore[arg-type]
    assert np.delete(drawn, 5) == pytest.approx(0.55 * 4.0)
    assert drawn[5] == pytest.approx(2 * 0.55 * 4.0)


@pytest.mark.slow
def test_letters_of_pictures_lie_within_them_and_apart(wheel: Wheel) -> None:
    model = gw.Model.load(wheel.model)
    check_letters(gw.compare(wheel.recording, model).plot())
    check_letters(gw.torques(wheel.recording, model).plot())
    check_letters(gw.momentum("dtg").plot())
    check_letters(gw.momentum().plot("body"))
    check_letters(gw.Recording.open(wheel.recording).plot())
