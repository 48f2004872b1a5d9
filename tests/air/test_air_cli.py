"""The verbs `air` and `cfd`: what they show, what they write, what they say to bad input."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from gyrowheel.cli.app import app
from gyrowheel.cli.console import run
from gyrowheel_air import geometry
from gyrowheel_air.table import TorqueTable
from gyrowheel_core.units import DEG, RPM

from .helpers import Player, made_up


class Shell:
    """Calls `gyrowheel ...` in this process: exit code, stdout, stderr."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object) -> tuple[int, str, str]:
        self._capsys.readouterr()
        code = run(app, [str(argument) for argument in arguments])
        captured = self._capsys.readouterr()
        return code, captured.out, captured.err


@pytest.fixture
def gyrowheel(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "table.json"
    made_up().write(path)
    return path


TINY = ["--mesh", "tiny", "--iterations", 40]


@pytest.mark.parametrize(
    "verb", ["air", *(f"cfd {verb}" for verb in ("mesh", "run", "sweep", "table", "pictures"))]
)
def test_every_verb_has_help_with_an_example(gyrowheel: Shell, verb: str):
    code, out, _ = gyrowheel(*verb.split(), "--help")
    assert code == 0
    assert f"Example: gyrowheel {verb}" in out


def test_models_side_by_side(gyrowheel: Shell, table: Path, tmp_path: Path):
    code, out, _ = gyrowheel("air", "--table", table, "--tilt", 3, "--json", tmp_path / "air.json")
    assert code == 0
    for word in ("correlation", "vorticity", "table", "surrogate", "aero_restoring", "k = 22"):
        assert word in out
    content = json.loads((tmp_path / "air.json").read_text())
    assert content["models"]["correlation"]["components"][0] is None
    assert content["coefficients"]["surrogate"]["windage"]["w"]["value"] == pytest.approx(0.95e-3)
    assert content["reynolds"] == pytest.approx(6.98e4, rel=1e-3)


def test_only_models_valid_at_a_tilt_are_compared(gyrowheel: Shell, table: Path):
    code, out, _ = gyrowheel("air", "--table", table, "--tilt", 7)
    assert code == 0
    assert "0 .. 5" in " ".join(out.split())


def test_thin_air_brakes_less(gyrowheel: Shell, table: Path):
    drags = []
    for pressure in (1013.25, 500):
        code, out, _ = gyrowheel("air", "--table", table, "--pressure", pressure, "--json", "-")
        assert code == 0
        drags.append(json.loads(out)["models"]["table"]["components"][2])
    assert drags[1] / drags[0] == pytest.approx((500 / 1013.25) ** 0.48, rel=0.02)


def test_run_prints_three_torques_with_scatter(gyrowheel: Shell, player: Player, tmp_path: Path):
    code, out, _ = gyrowheel("cfd", "run", "--tilt", 5, "--speed", 3500, *TINY, "-o", tmp_path / "study")
    assert code == 0
    for word in ("T1 back", "T2 across", "T3 along", "−0.9437", "not settled", "OpenFOAM 1912", "y+"):
        assert word in out
    code, out, _ = gyrowheel(
        "cfd", "run", "--tilt", 5, "--speed", 3500, *TINY, "-o", tmp_path / "study", "--json", "-"
    )
    assert json.loads(out)["torque"]["mean"][0] == pytest.approx(-0.944e-3, rel=0.01)
    assert len(player.calls) == 1


def test_mesh_reports_the_findings_of_checkmesh(gyrowheel: Shell, player: Player, tmp_path: Path):
    code, out, _ = gyrowheel("cfd", "mesh", "--mesh", "tiny", "--tilt", 2, "-o", tmp_path / "study")
    assert code == 0
    assert "1824" in out
    assert "mesh OK" in out


def test_a_sweep_becomes_a_table(gyrowheel: Shell, player: Player, tmp_path: Path):
    study = tmp_path / "study"
    code, out, err = gyrowheel(
        "cfd", "sweep", *TINY, "--tilts", "0,5", "--speeds", "2000,3500", "--jobs", 1, "-o", study
    )
    assert code == 0, err
    assert "4 cases finished, 0 of them earlier; 0 failed" in out
    assert "4/4" in err
    code, out, _ = gyrowheel("cfd", "table", study, "-o", tmp_path / "mine.json")
    assert code == 0
    assert "T3 along the rotor" in out
    written = TorqueTable.load(tmp_path / "mine.json")
    assert written.tilts / DEG == pytest.approx([0, 5])
    assert written.speeds / RPM == pytest.approx([2000, 3500])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--tilts", "0"], "tilts: [0.0] is not that of the sweep in {}, [0.0, 5.0]"),
        (["--speeds", "1000"], "speeds: [1000.0] is not that of the sweep in {}, [3500.0]"),
        (["--iterations", "60"], "iterations: 60 is not that of the sweep in {}, 40"),
        (["--pressure", "900"], "pressure: 900.0 is not that of the sweep in {}, none"),
        (["--geometry", "mine.yaml"], "geometry: "),
        (["-o", "x"], "-o: with --resume the folder is {}"),
    ],
)
def test_other_settings_of_a_sweep_are_refused(
    gyrowheel: Shell,
    player: Player,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    words: str,
):
    monkeypatch.chdir(tmp_path)
    shipped = (Path(geometry.__file__).parent / "geometry.yaml").read_text(encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(shipped, encoding="utf-8")
    study = tmp_path / "study"
    command = ["cfd", "sweep", *TINY, "--tilts", "0,5", "--speeds", "3500", "--jobs", 1]
    assert gyrowheel(*command, "-o", study)[0] == 0
    code, out, err = gyrowheel("cfd", "sweep", "--resume", study, *options)
    assert (code, out) == (2, "")
    assert err.startswith(f"error: {words.format(study)}")
    code, out, _ = gyrowheel("cfd", "sweep", "--resume", study, "--tilts", "5,0")
    assert code == 0
    assert "2 cases finished, 2 of them earlier; 0 failed" in out


def test_check_can_fail_a_script(gyrowheel: Shell, table: Path, player: Player, tmp_path: Path):
    code, out, _ = gyrowheel("cfd", "table", "--check")
    assert code == 0
    assert "MISSES" not in out
    assert "cause:" in out
    # the player gives the same torque at every speed
    sweep = [
        "cfd",
        "sweep",
        *TINY,
        "--tilts",
        "0,5",
        "--speeds",
        "1000,3500",
        "--jobs",
        1,
        "-o",
        tmp_path / "study",
    ]
    assert gyrowheel(*sweep)[0] == 0
    code, out, _ = gyrowheel("cfd", "table", tmp_path / "study", "--check")
    assert code == 1
    assert "MISSES" in out


@pytest.mark.slow
def test_pictures_of_a_table_need_no_solutions(gyrowheel: Shell, table: Path, tmp_path: Path):
    code, out, _ = gyrowheel("cfd", "pictures", "--table", table, "-o", tmp_path / "pictures")
    assert code == 0
    drawn = sorted(path.name for path in (tmp_path / "pictures").glob("*.png"))
    assert drawn == ["reynolds.png", "torque_by_speed.png", "torque_by_tilt.png"]
    assert all(name in out for name in drawn)


@pytest.mark.parametrize("verb", ["mesh", "run", "sweep"])
def test_without_openfoam_one_line_and_exit_2(gyrowheel: Shell, verb: str, tmp_path: Path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    code, out, err = gyrowheel("cfd", verb, "-o", tmp_path / "study")
    assert (code, out) == (2, "")
    assert [line for line in err.splitlines() if line.startswith("error: ")] == [err.splitlines()[-1]]
    assert "apt-get install openfoam" in err
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["air", "--tilt", "95"], ["tilt", "below 90 deg"]),
        (["air", "--tilt", "60"], ["tilt", "60 deg", "allowed: up to"]),
        (["air", "--speed", "-5"], ["speed", "-5 rpm", "> 0"]),
        (["air", "--speed", "nan"], ["speed", "nan rpm"]),
        (["air", "--speed", "100000"], ["speed", "100000 rpm", "allowed"]),
        (["air", "--temperature", "900"], ["temperature", "200 .. 400 K"]),
        (["air", "--geometry", "nowhere.yaml"], ["nowhere.yaml", "shipped: gyrowheel"]),
        (["air", "--table", "nowhere.json"], ["nowhere.json", "shipped: gyrowheel"]),
        (["cfd", "run", "--mesh", "huge", "-o", "x"], ["mesh", "'huge'"]),
        (["cfd", "run", "--tilt", "8", "-o", "x"], ["tilt", "8 deg"]),
        (["cfd", "sweep", "--tilts", "0,five", "-o", "x"], ["--tilts", "'0,five'"]),
        (["cfd", "sweep", "--tilts", "0,6", "-o", "x"], ["tilt", "6 deg"]),
        (["cfd", "table", "nowhere"], ["nowhere"]),
    ],
)
def test_bad_input_is_one_line(
    gyrowheel: Shell, table: Path, arguments: list[str], words: list[str], tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    if arguments[0] == "air" and "--table" not in arguments:
        arguments = [*arguments, "--table", str(table)]
    code, out, err = gyrowheel(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert len(err.splitlines()) == 1
    assert all(word in err for word in words)
    assert not (tmp_path / "x").exists()


def test_missing_dask_is_reported_in_one_line(gyrowheel: Shell, player: Player, tmp_path: Path, monkeypatch):
    monkeypatch.setitem(sys.modules, "dask.distributed", None)
    code, _, err = gyrowheel("cfd", "sweep", *TINY, "-o", tmp_path / "study", "--dask", "tcp://127.0.0.1:1")
    assert code == 2
    assert "gyrowheel-sim[dask]" in err
