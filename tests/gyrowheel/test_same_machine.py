"""Recordings of one machine: their name, the refusal of a mix, tests that continue with the same one, wrong setups."""

from __future__ import annotations

import json
import os
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel.recordings.api import machine_options, note_machine, noted_machine
from gyrowheel_recording.mislabelled import Fix, correct
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario

from .helpers import DRAG_PLAN, OTHER_PLAN, Shell, write


def test_machine_has_one_name_in_all_its_recordings() -> None:
    bench = Bench.load()
    own = Scenario({"coil_constant": 0.0203}, {"windage": {"w": 1e-3, "n": 1.48}}, noise_seed=1)
    assert own.identity(bench) == replace(own, noise_seed=7).identity(bench)
    others = [
        replace(own, values={"coil_constant": 0.0201}),
        replace(own, effects={}),
        replace(own, effects={"windage": {"w": 1.1e-3, "n": 1.48}}),
    ]
    assert own.identity(bench) not in {other.identity(bench) for other in others}
    # a value that is as the bench states it is no other machine
    same = replace(own, values=dict(own.values) | {"shaft_inertia": bench.value("shaft_inertia")})
    assert same.identity(bench) == own.identity(bench)
    assert replace(own, machine="rig 2").identity(bench) == "rig 2"


def test_the_name_of_a_hidden_machine_reveals_nothing(gyrowheel: Shell, tmp_path: Path) -> None:
    plan = write(tmp_path / "other.yaml", OTHER_PLAN)
    for name in ("a", "b"):
        gyrowheel.good(
            "simulate",
            "--plan",
            plan,
            "--blind",
            tmp_path / f"{name}.json",
            "--seed",
            4,
            "-o",
            tmp_path / name,
        )
    keys = [json.loads((tmp_path / f"{name}.json").read_text()) for name in ("a", "b")]
    assert keys[0]["values"] == keys[1]["values"]
    assert keys[0]["effects"] == keys[1]["effects"]
    names = [gw.Recording.open(tmp_path / name).info.machine for name in ("a", "b")]
    assert names == [key["machine"] for key in keys]
    # drawn apart from what is hidden
    gyrowheel.good("simulate", "--plan", plan, "--blind", tmp_path / "a.json", "-o", tmp_path / "again")
    assert gw.Recording.open(tmp_path / "again").info.machine == names[0]
    note = (tmp_path / ".machines" / names[1]).read_text()
    assert note == f"--blind {tmp_path}/b.json --seed 4\n"


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("machines")
    plans = {"drag": DRAG_PLAN, "other": OTHER_PLAN}
    for name, text in plans.items():
        write(folder / f"{name}.yaml", text)
        for machine in (1, 2):
            gw.simulate(folder / f"{name}.yaml", machine=machine, folder=folder / f"{name}{machine}")
    gw.Model().save(folder / "m.yaml")
    return folder


@pytest.mark.slow
def test_mix_of_machines_is_refused_unless_asked_for(gyrowheel: Shell, machines: Path) -> None:
    one, other, model = machines / "drag1", machines / "other2", machines / "m.yaml"
    gyrowheel.good("torques", one, machines / "other1", "--model", model)
    for command in (
        ("compare", one, other, "--model", model),
        ("diagnose", one, "--validate", other, "--model", model),
        ("rate", one, other, "--model", model),
        ("torques", one, other, "--model", model),
        ("model", "add", "windage", "--fit", one, "--validate", other, "--model", model),
    ):
        refused = gyrowheel(*command)
        assert refused.code == 2, command
        assert refused.err.count("error: ") == 1
        assert f"{other}: is of machine" in refused.err
        assert "--mixed" in refused.err
    gyrowheel.good("torques", one, other, "--model", model, "--mixed")


@pytest.mark.study  # test_investigate.py goes on with what a diagnosis proposes
@pytest.mark.slow
def test_the_next_command_uses_the_same_machine_and_settles_the_tie(gyrowheel: Shell, tmp_path: Path) -> None:
    effect = "gravity_offset:G=0.02"
    gyrowheel.good(
        "simulate", "--plan", "quick", "--effect", effect, "--machine", 3, "-o", tmp_path / "quick"
    )
    gyrowheel.good("model", "new", "--model", tmp_path / "m.yaml")
    said = gyrowheel.good("diagnose", tmp_path / "quick", "--model", tmp_path / "m.yaml").out
    line = next(line for line in said.splitlines() if "gyrowheel up " in line)
    run, diagnose = (shlex.split(part) for part in line.split(" && "))
    assert run[:2] == ["gyrowheel", "up"]
    assert ["--effect", effect, "--machine", "3"] == run[run.index("--effect") : run.index("--machine") + 2]
    # the same samples, without the nodes
    words = ["simulate", *(word.replace("--record", "-o") for word in run[2:])]
    gyrowheel.good(*words)
    settled = gyrowheel.good(*diagnose[1:], "--json", tmp_path / "found.json")
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["verdict"] == "effect", settled.out
    assert [item["name"] for item in found["effects"]] == ["gravity_offset"]


def test_the_machine_note_is_next_to_the_recording_and_is_quoted(machines: Path, tmp_path: Path) -> None:
    given = gw.Recording.open(machines / "drag1").save(tmp_path / "drag1")
    before = {file: file.read_bytes() for file in given.path.iterdir()}
    note_machine(given, machine_options(effect=["windage:w=0.001"], machine=1, bench="my bench.yaml"))
    assert noted_machine([given]) == "--effect windage:w=0.001 --machine 1 --bench 'my bench.yaml'"
    assert {file: file.read_bytes() for file in given.path.iterdir()} == before
    (tmp_path / ".machines" / given.info.machine).write_text("--effect x; rm -rf $HOME\n")
    # whatever stands there, the line to type is one command
    assert noted_machine([given]) == "--effect 'x;' rm -rf '$HOME'"
    assert noted_machine([gw.Recording.open(machines / "other2")]) == ""


@pytest.mark.slow
def test_wrong_setup_ends_with_its_cure_which_works(
    gyrowheel: Shell, machines: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    spoil = Fix(exchange=(("tilt_x", "tilt_y"),), scale={"spin_rate": 9.549296586})
    correct(gw.Recording.open(machines / "drag1").data, spoil, tmp_path / "wrong")
    gyrowheel.good("model", "new", "--model", "m.yaml")
    refused = gyrowheel("diagnose", "wrong", "--model", "m.yaml", "--json", "found.json")
    assert refused.code == 2
    assert "tilt_x and tilt_y are exchanged" in refused.out
    found = json.loads(Path("found.json").read_text())
    assert (found["verdict"], found["effects"]) == ("insufficient_data", [])
    assert [item["kind"] for item in found["setup"]] == ["unit", "exchanged"]
    assert all(item["problem"] and item["cure"] for item in found["setup"])
    # what would fit or write anything refuses, what shows warns
    adding = gyrowheel("model", "add", "windage", "--fit", "wrong", "--model", "m.yaml")
    assert adding.code == 2
    assert "spin_rate is in rpm" in adding.err
    warned = gyrowheel("compare", "wrong", "--model", "m.yaml")
    assert "spin_rate is in rpm" in warned.err
    words = shlex.split(found["setup"][0]["cure"])
    assert words[0] == "gyrowheel"
    gyrowheel.good(*words[1:])
    gyrowheel.good("diagnose", "wrong-corrected", "--model", "m.yaml", "--json", "found.json")
    found = json.loads(Path("found.json").read_text())
    assert found["setup"] == []
    assert found["verdict"] == "nothing_missing"


@pytest.mark.parametrize("kind", ["pipe", "device", "hole", "link", "folder"])
def test_a_note_that_is_no_small_file_is_passed_over(
    kind: str, machines: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody named it: it may be anything, and is neither waited for nor quoted."""
    recording = gw.Recording.open(machines / "drag1")
    note = tmp_path / "note"
    if kind == "pipe":
        os.mkfifo(note)
    elif kind == "device":
        note = Path("/dev/zero")
    elif kind == "hole":
        with note.open("wb") as file:
            file.truncate(6_000_000_000)
    elif kind == "link":
        (tmp_path / "secret").write_text("--seed 4")
        note.symlink_to(tmp_path / "secret")
    else:
        note.mkdir()
    monkeypatch.setattr("gyrowheel.recordings.api._place", lambda recording: note)
    assert noted_machine([recording]) == ""
