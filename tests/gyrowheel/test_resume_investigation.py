"""Investigations that were interrupted or killed go on where they were."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import gyrowheel as gw
from gyrowheel.investigation.api import _once
from gyrowheel_analysis.diagnosis.findings import NextTest
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.journal import FINISHED, Work, journal

from .findings import AMBIGUOUS, diagnosis, finding
from .helpers import Shell, write
from .killing import until_done

NOTHING = diagnosis("nothing_missing")
ANSWERS = [
    replace(AMBIGUOUS, next_test=NextTest("air_density", 88.0, 1.2, separates=("aero_cross", "windage"))),
    diagnosis("insufficient_data"),
    diagnosis("effect", finding("aero_cross")),
]


@pytest.fixture
def answered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Diagnoses that depend on the number of recordings alone."""

    def diagnose(recordings: Sequence[Path], *_: Any, averages: bool = False, **__: Any) -> Diagnosis:
        return NOTHING if averages else ANSWERS[len(recordings) - 1]

    monkeypatch.setattr("gyrowheel_recording.bags.Recording.open", lambda path: path)
    monkeypatch.setattr("gyrowheel_analysis.diagnosis.diagnose.diagnose", diagnose)
    monkeypatch.setattr(
        "gyrowheel_analysis.diagnosis.experiment_design.precision_test", lambda *_, **__: None
    )
    # a report reads the recordings, of which there are none here
    monkeypatch.setattr("gyrowheel.investigation.verb._report", lambda *_: None)


@pytest.mark.usefixtures("answered")
def test_a_killed_investigation_resumes(tmp_path: Path):
    begun = tmp_path / "begun"
    here: list[int] = []  # what this process has begun

    def run(plan: Plan, place: Path, number: int) -> None:
        """Record a plan as the recorder of the graph does: bit by bit."""
        if len(here) == most:  # so that no process is quick enough to run them all
            time.sleep(600.0)
        here.append(number)
        with begun.open("a") as file:
            file.write(f"{place.name}\n")
        place.mkdir()
        with (place / "samples").open("w") as samples:
            for part in range(10):
                samples.write(f"{plan.called} {number} {part}\n")
                samples.flush()
                time.sleep(0.004)

    def go(folder: Path, **options: Any) -> Any:
        return gw.investigate(gw.Model(), plans=["check"], folder=folder, run=run, **options).to_dict()

    most = 99
    straight = go(tmp_path / "straight")
    assert len(straight["steps"]) == 3
    begun.unlink()
    here.clear()
    most = 1
    folder = tmp_path / "killed"
    kills = sum(
        1
        for _ in until_done(
            lambda: go(folder, resume=(folder / "settings.json").exists()),
            begun,
            folder / FINISHED,
            seed=2,
            longest=0.06,
        )
    )
    assert kills >= 2
    assert len(begun.read_text().split()) <= 3 + kills
    most = 99
    result = go(folder, resume=True)
    assert len(begun.read_text().split()) <= 3 + kills
    told = json.dumps(result).replace(str(folder), str(tmp_path / "straight"))
    assert told == json.dumps(straight)
    assert json.loads((folder / "investigation.json").read_text()) == json.loads(json.dumps(result))
    for step in straight["steps"]:
        for path in map(Path, step["recordings"]):
            whole = (path / "samples").read_text()
            assert (folder / path.name / "samples").read_text() == whole
            # what was recorded until the kill is kept next to it
            for part in folder.glob(f"{path.name}-interrupted-*/samples"):
                assert whole.startswith(part.read_text())


@pytest.mark.usefixtures("answered")
def test_an_investigation_resumes_by_its_printed_command(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def record(place: Path, *_: Any, **__: Any) -> None:
        if place.name == interrupted:
            raise KeyboardInterrupt
        assert not place.exists()
        place.mkdir()

    interrupted = "2-air_density"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gyrowheel.simulation.api.record_simulation", record)
    monkeypatch.setattr("gyrowheel.investigation.verb._finish", lambda *_, **__: None)
    monkeypatch.setattr("gyrowheel.recordings.api.note_machine", lambda *_: None)
    gyrowheel.good("model", "new", "--model", "m.yaml")
    hidden = ["--effect", "windage:w=0.0013", "--machine", 5, "--seed", 3]
    settings = ["--model", "m.yaml", "--simulate", "--plan", "check", *hidden]
    first = gyrowheel("investigate", *settings, "--json", "out.json")
    assert first.code == 130
    command = "gyrowheel investigate --resume out/investigation-1 --json out.json"
    assert f"if this is interrupted: {command}" in first.err
    assert json.loads(Path("out.json").read_text())["reason"] == ""
    interrupted = ""
    for options, words in (
        (["--seed", 4], "seed: 4 is not that of the investigation in out/investigation-1, 3"),
        (["--plan", "quick"], 'plans: ["quick"] is not that of'),
        (["--budget", 3], "budget: 3.0 is not that of the investigation in out/investigation-1, 15.0"),
        (["--effect", "windage"], 'effects: ["windage"] is not that of'),
        (["--blind", "key.json"], "blind: cannot be combined with effects"),
    ):
        refused = gyrowheel(*shlex.split(command)[1:], *options)
        assert (refused.code, refused.out) == (2, "")
        assert words in refused.err
    gyrowheel.good(*shlex.split(command)[1:])
    resumed = json.loads(Path("out.json").read_text())
    gyrowheel.good("investigate", *settings, "--json", "straight.json", "-o", "straight")
    straight = json.loads(Path("straight.json").read_text().replace("straight/", "out/investigation-1/"))
    assert resumed == straight
    assert len(straight["steps"]) == 3
    # another model behind the same name
    other = "overrides: {coil_constant: {value: 0.0201, standard_error: 0.00001}}"
    write(Path("m.yaml"), Path("m.yaml").read_text().replace("overrides: {}", other))
    refused = gyrowheel(*shlex.split(command)[1:])
    assert (refused.code, refused.out) == (2, "")
    assert "model: has changed since the investigation in out/investigation-1 was begun" in refused.err


@pytest.mark.usefixtures("answered")
def test_resume_refuses_another_key_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def record(place: Path, *_: Any, **__: Any) -> None:
        if place.name.startswith("2-"):
            raise KeyboardInterrupt
        place.mkdir()

    monkeypatch.setattr("gyrowheel.simulation.api.record_simulation", record)
    key, folder = tmp_path / "key.json", tmp_path / "run"

    def go(**options: Any) -> gw.Investigation:
        return gw.investigate(gw.Model(), plans=["check"], blind=key, folder=folder, **options)

    assert go().interrupted
    kept = key.read_text()
    assert go(resume=True).interrupted
    key.unlink()
    with pytest.raises(InputError, match=r"blind: .*key\.json is not the key file with which"):
        go(resume=True)
    assert not key.exists()
    write(key, kept)
    assert go(resume=True).interrupted


def test_resume_refuses_a_changed_recording(tmp_path: Path):
    made: list[str] = []

    def run(plan: Plan, directory: Path, number: int) -> None:
        made.append(directory.name)
        directory.mkdir()
        (directory / "run_0.mcap").write_text("as it was")

    work = Work(kind="investigation", settings={})
    with journal(tmp_path / "out", work) as kept:
        for _ in range(2):
            _once(run, kept, None)(Plan.load("quick"), tmp_path / "out" / "quick", 1)
        assert made == ["quick"]
        (tmp_path / "out" / "quick" / "run_0.mcap").write_text("of another machine")
        with pytest.raises(InputError, match=r"quick: has changed since the investigation in .* recorded it"):
            _once(run, kept, None)(Plan.load("quick"), tmp_path / "out" / "quick", 1)
