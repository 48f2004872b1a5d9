"""The verb `momentum` and `gyrowheel.momentum`: angular momentum that a wheel can reach."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_core.units import DEG, RPM

from .helpers import Shell

_INERTIA = {"gyrowheel": 1.779e-3, "dtg": 2.4e-5}  # kg m^2, about the spin axis


@pytest.mark.parametrize("bench", list(gw.benches))
def test_momenta_lie_on_spheres(gyrowheel: Shell, bench: str) -> None:
    found = gyrowheel.good("momentum", "--bench", bench, "--json", "-").json
    assert found["bench"] == bench
    speed, tilt = np.array(found["spin_rate"]), np.array(found["tilt"])
    radius = _INERTIA[bench] * speed[:, None]
    np.testing.assert_allclose(found["along_axis"], radius * np.cos(tilt), rtol=1e-3)
    np.testing.assert_allclose(found["across_axis"], radius * np.sin(tilt), rtol=1e-3)
    # the exact momentum is greater and smaller within a revolution
    assert np.all(np.array(found["exact_smallest"])[:, 1:] < np.array(found["exact_largest"])[:, 1:])


def test_tables_fit_80_columns_and_have_the_numbers_of_the_paper(gyrowheel: Shell) -> None:
    text = gyrowheel.good("momentum", "--speed", "3000,4000").out
    assert max(map(len, text.splitlines())) <= 80
    rows = [line.split() for line in text.splitlines()]
    assert [row[1] for row in rows if row and row[0] in ("3000", "4000")] == ["0.5589", "0.7452"]
    assert ["5", "0.38", "5.2"] in rows


def test_pictures_are_written(gyrowheel: Shell, tmp_path: Path) -> None:
    caps, body = tmp_path / "caps.png", tmp_path / "body.png"
    text = gyrowheel.good("momentum", "--bench", "dtg", "--picture", caps, "--body", body).out
    assert f"picture: {caps}" in text
    assert f"picture: {body}" in text
    assert caps.read_bytes() != body.read_bytes()
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in (caps, body))


def test_the_result_from_python() -> None:
    result = gw.momentum(spin_rate=[rpm * RPM for rpm in (1500, 3000, 2000, 3500, 4000)])
    assert np.all(np.diff(result.speed) > 0.0)
    assert result.across == pytest.approx(1.779e-3 * 4000 * RPM * math.sin(5 * DEG), rel=1e-3)
    assert result.headline().startswith("gyrowheel: 0.2784 to 0.7452 N·m·s along")
    columns = result.to_columns()
    assert {len(values) for values in columns.values()} == {5 * 6 * 12}
    sizes = np.sqrt(sum(columns[f"h_{axis}"] ** 2 for axis in "xyz"))
    np.testing.assert_allclose(sizes, 1.779e-3 * columns["spin_rate"], rtol=1e-3)
    # of five speeds three are drawn, the lowest and the highest among them
    titles = [axes.get_title() for axes in result.plot().axes]
    assert [title.split(":")[0] for title in titles[:3]] == [
        "(a)  1500 rpm",
        "(b)  3000 rpm",
        "(c)  4000 rpm",
    ]
    assert "1500 to 4000 rpm" in result.plot("body").texts[0].get_text()
    assert "middle expression" in result._repr_html_()


def test_a_model_uses_its_estimated_inertia(tmp_path: Path) -> None:
    path = tmp_path / "model.yaml"
    gw.Model().save(path)
    stated = gw.momentum(gw.Model.load(path)).across
    text = path.read_text(encoding="utf-8")
    override = "overrides: {rotor_inertia_z: {value: 1.8e-3, standard_error: 1.0e-6}}"
    assert "overrides: {}" in text
    path.write_text(text.replace("overrides: {}", override), encoding="utf-8")
    estimated = gw.momentum(gw.Model.load(path)).across
    assert estimated / stated == pytest.approx(1.8 / 1.779, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--speed", "fast"], ["--speed", "fast", "0..5"]),
        (["--speed", "12500"], ["12500 rpm", "1000 .. 4000 rpm"]),
        (["--speed", "nan"], ["--speed", "nan"]),
        (["--bench", "nothing"], ["nothing"]),
        (["--speed", "3000", "--body", "body.png"], ["two spin rates"]),
        (["--picture", "caps.jpg"], ["--picture", ".jpg", ".png"]),
    ],
)
def test_invalid_input_is_refused(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    result = gyrowheel("momentum", *arguments)
    assert result.code == 2
    assert len(result.err.strip().splitlines()) == 1
    assert all(word in result.err for word in words), result.err
    assert not list(tmp_path.iterdir())
