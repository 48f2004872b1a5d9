"""Where a model fails, on the command line: maps, picture, and the errors of every channel."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrowheel.models.page import difference
from gyrowheel.show.error_table import error_table
from gyrowheel_analysis.model import Model, Override

from .conftest import Wheel
from .findings import TABLE
from .helpers import Shell
from .test_render import text_of


@pytest.mark.slow
def test_maps_and_a_picture(gyrowheel: Shell, wheel: Wheel, tmp_path: Path):
    picture = tmp_path / "where.png"
    options = ["--map", "speed", "--map", "azimuth,time", "--picture", picture]
    shown = gyrowheel.good("compare", wheel.recording, "--model", wheel.model, *options).out
    assert "Residual over the spin rate" in shown
    assert "over tilt direction and time" in shown
    assert "s of steady motion take part (of" in shown
    assert f"picture: {picture}" in shown
    assert all(len(line) <= 80 for line in shown.splitlines() if "picture" not in line)
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize("over", ["sped", "speed,speed", "speed,tilt,time"])
def test_an_unknown_map_is_refused_before_a_file_is_read(gyrowheel: Shell, over: str):
    result = gyrowheel("compare", "nowhere", "--model", "none.yaml", "--map", over)
    assert result.code == 2
    (line,) = result.err.splitlines()
    assert "map: " in line


def test_the_error_table_has_errors_and_noise_of_every_channel():
    text = text_of([error_table(TABLE)])
    for words in ("fitted", "validation", "before", "after", "noise", "tilt x", "spin", "χ²/N"):
        assert words in text


def test_a_difference_names_effects_and_the_parameters_that_moved():
    old = Model.new()
    new = old.changed(
        {"time": "2026-01-01T00:00:00+00:00", "what": "add windage"},
        overrides={"coil_constant": Override(0.01952, 5e-5), "tilt_scale": Override(1.0001, 5e-4)},
        effects={"windage": {"w": 1e-3, "n": 1.48}},
        effect_errors={"windage": {"w": 1e-5, "n": 0.02}},
    )
    text = text_of(difference(old, new))
    assert "+ windage" in text
    assert "1.000 ± 0.010 mN·m" in text
    assert "coil_constant" in text
    assert "as stated" in text
    assert "−1.2 σ" in text
    assert "1 more parameters" in text
    assert "− windage" in text_of(difference(new, old))
    assert text_of(difference(old, old)) == "no difference\n"
