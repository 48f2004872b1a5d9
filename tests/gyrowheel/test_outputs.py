"""What commands write: never in the place of an input or of anything else, and checked before the work begins."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from gyrowheel.show.figure import BLUE, Curve, Panel, curves_figure, write_figure

from .conftest import Wheel
from .helpers import SHORT_PLAN, Result, Shell, write

#: Commands with inputs of every kind: the options, and the input that --json names.
INPUTS = {
    "model": (["compare", "REC", "--model", "MODEL"], "MODEL"),
    "model shown": (["model", "show", "--model", "MODEL"], "MODEL"),
    "model compared": (["model", "diff", "MODEL", "MODEL"], "MODEL"),
    "plan": (["simulate", "--plan", "PLAN", "-o", "NEW"], "PLAN"),
    "plan shown": (["plans", "PLAN"], "PLAN"),
    "key": (["simulate", "--plan", "PLAN", "--blind", "KEY", "-o", "NEW"], "KEY"),
    "table of the air": (["air", "--table", "AIR"], "AIR"),
    "storage": (["info", "REC"], "REC/drag_0.mcap"),
    "metadata": (["info", "REC"], "REC/metadata.yaml"),
    "notes": (["plans"], "NOTES"),
    "settings": (["plans"], "SETTINGS"),
    "folder": (["plans"], "FOLDER"),
}


def refused(result: Result, *words: str) -> None:
    assert result.code == 2
    assert result.err.startswith("error: ")
    assert result.err.count("\n") == 1
    for word in words:
        assert word in result.err


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture
def bench(wheel: Wheel, tmp_path: Path) -> Path:
    """Return a folder with files of a user."""
    shutil.copytree(wheel.recording, tmp_path / "drag")
    shutil.copy(wheel.model, tmp_path / "wheel.yaml")
    write(tmp_path / "plan.yaml", SHORT_PLAN)
    write(tmp_path / "key.json", json.dumps({"values": {}, "effects": {}}))
    write(tmp_path / "settings.json", json.dumps({"mine": [1, 2]}))
    write(tmp_path / "notes.txt", "mine\n")
    (tmp_path / "folder").mkdir()
    return tmp_path


@pytest.mark.parametrize("case", INPUTS)
def test_a_result_replaces_neither_an_input_nor_another_file(gyrowheel: Shell, bench: Path, case: str):
    arguments, target = INPUTS[case]
    if "AIR" in arguments:
        gyrowheel.good("cfd", "table", "-o", bench / "air.json")
    places = {"MODEL": "wheel.yaml", "REC": "drag", "PLAN": "plan.yaml", "KEY": "key.json", "NEW": "new"}
    places |= {"AIR": "air.json", "NOTES": "notes.txt", "SETTINGS": "settings.json", "FOLDER": "folder"}

    def placed(text: str) -> str:
        first, _, rest = text.partition("/")
        return str(bench / places[first] / rest) if first in places else text

    file = next((bench / "drag").glob("*.mcap")).name
    before = content(bench)
    target = placed(target.replace("drag_0.mcap", file))
    refused(gyrowheel(*map(placed, arguments), "--json", target), "--json", target)
    assert content(bench) == before


@pytest.mark.parametrize("way", ["symbolic", "hard", "relative"])
def test_an_input_is_recognised_under_any_path(
    gyrowheel: Shell, bench: Path, way: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(bench)
    gyrowheel.good("cfd", "table", "-o", "air.json")
    gyrowheel.good("plans", "--json", "plan.json")
    name = Path("other.json")
    if way == "symbolic":
        name.symlink_to("plan.json")
    elif way == "hard":
        name.hardlink_to("plan.json")
    else:
        name = Path("folder/../plan.json")
    before = content(bench)
    refused(gyrowheel("plans", "plan.json", "--json", name), "is an input of this command")
    assert content(bench) == before


def test_an_output_within_a_recording_is_refused(gyrowheel: Shell, bench: Path):
    refused(gyrowheel("info", bench / "drag", "--json", bench / "drag/info.json"), "lies in the recording")
    refused(gyrowheel("plans", "--json", bench / "drag/sub/plans.json"), "lies in the recording")
    new = bench / "new"
    refused(
        gyrowheel("simulate", "--plan", bench / "plan.yaml", "-o", new, "--json", new / "run.json"), "lies in"
    )
    assert not new.exists()
    (bench / "drag/metadata.yaml").unlink()
    broken = bench / "drag"
    refused(gyrowheel("salvage", broken, "-o", new, "--json", broken / "s.json"), "lies in the recording")


@pytest.mark.parametrize(
    "arguments",
    [
        ["plans"],
        ["plans", "quick"],
        ["effects"],
        ["effects", "windage"],
        ["bench"],
        ["info", "REC"],
        ["model", "show", "--model", "MODEL"],
        ["model", "diff", "MODEL", "MODEL"],
        ["compare", "REC", "--model", "MODEL"],
        ["air"],
        ["cfd", "table"],
    ],
    ids=" ".join,
)
def test_a_command_can_be_repeated(gyrowheel: Shell, wheel: Wheel, tmp_path: Path, arguments: list[str]):
    places = {"REC": wheel.recording, "MODEL": wheel.model}
    command = [places.get(text, text) for text in arguments]
    target = tmp_path / "made" / "result.json"
    gyrowheel.good(*command, "--json", target)
    first = json.loads(target.read_text(encoding="utf-8"))
    target.write_text(json.dumps(first | {"mark": 1}), encoding="utf-8")
    gyrowheel.good(*command, "--json", target)
    assert json.loads(target.read_text(encoding="utf-8")) == first


def test_an_empty_file_is_replaced(gyrowheel: Shell, tmp_path: Path):
    gyrowheel.good("plans", "--json", write(tmp_path / "empty", ""))
    assert (tmp_path / "empty").stat().st_size


def test_export_replaces_only_its_own_tables(gyrowheel: Shell, bench: Path):
    mine, model = write(bench / "mine.csv", "time,load\n0,1\n"), bench / "wheel.yaml"
    before = content(bench)
    refused(gyrowheel("export", bench / "drag", "-o", mine), "--output", str(mine))
    refused(gyrowheel("export", bench / "drag", "-o", bench / "t.csv", "--map", model), "--map", str(model))
    assert content(bench) == before
    for ending in ("csv", "parquet"):
        for _ in range(2):
            out = bench / f"t.{ending}"
            gyrowheel.good("export", bench / "drag", "-o", out, "--map", bench / "t.map.yaml")
    assert (bench / "t.csv").stat().st_size > 1000
    same = bench / "one.csv"
    refused(gyrowheel("export", bench / "drag", "-o", same, "--map", same), "is the file of --output, too")


@pytest.mark.slow
def test_a_picture_replaces_only_pictures_of_its_format(gyrowheel: Shell, bench: Path):
    draw = ["momentum", "--picture"]
    refused(gyrowheel(*draw, bench / "x.txt"), "'.txt'", ".png")
    photo = bench / "photo.png"
    photo.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    refused(gyrowheel(*draw, photo), "--picture", str(photo))
    for ending, begin in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        picture = bench / f"picture{ending}"
        write_figure(
            curves_figure("title", "remark", [Panel("panel", "x", "y", [Curve("a", [0], [1], BLUE)])]),
            picture,
        )
        assert picture.read_bytes().startswith(begin)
        gyrowheel.good(*draw, picture)
        foreign = bench / f"foreign{ending}"
        foreign.write_bytes(begin + bytes(100))
        refused(gyrowheel(*draw, foreign), "--picture", str(foreign))


def test_outputs_are_checked_before_the_work(gyrowheel: Shell, bench: Path):
    recording, model = bench / "drag", bench / "wheel.yaml"
    beyond = bench / "notes.txt" / "x.json"
    for arguments in (
        ["compare", recording, "--model", model, "--json", beyond],
        ["compare", recording, "--model", model, "--picture", beyond.with_suffix(".png")],
        ["diagnose", recording, "--model", model, "--json", beyond],
    ):
        result = gyrowheel(*arguments)
        refused(result, str(beyond.with_suffix("")), "cannot be written")


def test_the_check_leaves_no_file(gyrowheel: Shell, bench: Path):
    before = content(bench)
    refused(gyrowheel("info", bench / "none", "--json", bench / "new.json"), "none")
    assert content(bench) == before


def test_an_empty_name_is_refused(gyrowheel: Shell):
    refused(gyrowheel("simulate", "--plan", "quick", "-o", ""), "-o: ", "empty")
    refused(gyrowheel("plans", "--json="), "--json: ", "empty")


def test_an_interruption_before_the_first_case_writes_nothing(
    gyrowheel: Shell, bench: Path, monkeypatch: pytest.MonkeyPatch
):
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("gyrowheel.campaigns.api.finished", stop)
    cases = gyrowheel("campaign", "--cases", 1, "--json", bench / "cases.json")
    assert (cases.code, cases.out) == (130, "")
    assert not (bench / "cases.json").exists()
    monkeypatch.setattr("gyrowheel.simulation.api.record_simulation", stop)
    model = bench / "wheel.yaml"
    found = gyrowheel("investigate", "--model", model, "--simulate", "-o", bench / "all")
    assert found.code == 130
    assert "recordings:" not in found.out


def test_a_pipe_named_as_metadata_is_not_opened(gyrowheel: Shell, tmp_path: Path):
    """As anybody may put one into a folder for temporary files."""
    os.mkfifo(tmp_path / "metadata.yaml")
    gyrowheel.good("plans", "--json", tmp_path / "plans.json")
    assert json.loads((tmp_path / "plans.json").read_text(encoding="utf-8"))
