"""The session of the workbench and its pages."""

from __future__ import annotations

import http.client
import json
import os
import re
import shutil
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest
import yaml

import gyrowheel as gw
from gyrowheel.diagnosis.api import Diagnosis
from gyrowheel.recordings.api import note_machine
from gyrowheel.simulation.api import record_simulation
from gyrowheel.workbench import pictures, tables, views
from gyrowheel.workbench.benches import SimulatedBench
from gyrowheel.workbench.library import ROLES, Library, Opened
from gyrowheel.workbench.report import before
from gyrowheel.workbench.server import Server
from gyrowheel.workbench.session import Session, Step
from gyrowheel_analysis.diagnosis.findings import TieReport
from gyrowheel_analysis.diagnosis.proof_result import Proof
from gyrowheel_analysis.reduction.instrument_readings import ReadingFinding
from gyrowheel_analysis.reduction.windows import Coverage
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.mislabelled import Fix, WrongSetup
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import effect_to_mapping
from gyrowheel_sim.plant.scenario import Scenario

from .conftest import Wheel
from .findings import UNKNOWN, diagnosis, finding
from .helpers import SHORT_PLAN, ask, write
from .lab_tables import lab_table


def test_only_recordings_of_the_chosen_folders_can_be_named(wheel: Wheel, tmp_path: Path) -> None:
    folder = tmp_path / "chosen"
    shutil.copytree(wheel.recording, folder / "deep" / "drag")
    (folder / "link").symlink_to(wheel.other)
    library = Library([folder])
    assert [entry.key for entry in library.entries()] == ["0/deep/drag"]
    for key in ("0/../drag", str(wheel.other), "0/link", "0/deep/drag/../drag", "1/deep/drag", ""):
        with pytest.raises(gw.InputError, match="not in the chosen folders"):
            library.find(key)
    with pytest.raises(gw.InputError, match="no such folder"):
        Library([tmp_path / "none"])


def noted(folder: Path, when: float) -> None:
    """Make what looks like a recording of five seconds, changed at a time."""
    folder.mkdir(parents=True)
    text = "rosbag2_bagfile_information:\n  version: 9\n  duration:\n    nanoseconds: 5000000000\n"
    os.utime(write(folder / "metadata.yaml", text), (when, when))


def test_the_latest_recordings_are_listed_and_the_others_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for k in range(4):
        noted(tmp_path / f"day{k}" / "run", 1000.0 + k)
    monkeypatch.setattr(views, "MOST_LISTED", 2)
    part = views.state(Session(Library([tmp_path]), gw.Model()))["parts"]["recordings"]
    places = [part.find(f"in day{k}, ") for k in range(4)]  # folders of one name are told apart
    assert places[:2] == [-1, -1]
    assert -1 < places[3] < places[2]
    assert "5.0 s, " in part
    assert "2 older ones are not listed" in part


def test_a_recording_with_invalid_bytes_in_its_name_opens(wheel: Wheel, tmp_path: Path) -> None:
    shutil.copytree(wheel.recording, os.fsdecode(os.fsencode(tmp_path) + b"/Me\xdf"))
    with Server(Session(Library([tmp_path]), gw.Model()), port=0) as server:
        assert "<b>Me\\xdf</b>" in json.loads(ask(server, "/state")[1])["parts"]["recordings"]
        assert ask(server, "/do/open", {"key": "0/Me\\xdf", "role": "fitted"})[0] == 200
        server.session.wait(240.0)
        assert server.session.trouble is None
        status, body = ask(server, "/state")
        assert status == 200
        assert [own["key"] for own in json.loads(body)["signals"]] == ["0/Me\\xdf"]


def test_long_names_of_tables_are_shortened() -> None:
    name = tables.file_name("測" * 200 + ".csv")
    assert name.startswith("測")
    assert name.endswith(".csv")
    assert len(name.encode()) <= 120


@pytest.mark.slow
def test_ranges_are_fitted_predicted_or_left_out(compared: Session, wheel: Wheel) -> None:
    """Results belong to the ranges that they were found with, and come back with them."""
    whole, length = compared.step, gw.Recording.open(wheel.recording).duration
    compared.use("0/drag", 12.0, length + 1.0, "not used to fit")
    compared.use("0/drag", -1.0, 0.5, "left out")
    compared.use("0/drag", 0.8, 1.0, "left out")
    compared.use("0/drag", 0.5, 0.9, "left out")
    compared.use("0/drag", 0.9, 1.0, "fitted")
    path = str(wheel.recording.resolve())
    assert [str(own.path) for own in compared.used("fitted")] == [f"{path}@from=0.9,until=12"]
    assert [str(own.path) for own in compared.used("not used to fit")] == [f"{path}@from=12"]
    state = views.state(compared)
    assert [(own["from"], own["until"], own["use"]) for own in state["signals"][0]["uses"]] == [
        (0.0, 0.9, "left out"), (0.9, 12.0, "fitted"), (12.0, pytest.approx(length), "not used to fit"),
    ]  # fmt: skip
    assert "0 … 0.9 s left out; 0.9 … 12 s fit" in state["parts"]["recordings"]
    assert "not compared" in state["parts"]["verdict"]
    assert pictures.found(compared)["windows"] is None
    compared.compare()
    compared.wait(240.0)
    assert compared.trouble is None
    shown = pictures.found(compared)["windows"]
    assert set(shown["recording"]) == {"0/drag"}
    assert min(shown["start"]) > 0.899  # within a sample
    assert max(shown["start"]) < 12.0
    for begin, end, use, words in (
        (5.0, 4.0, "fitted", "range: 5 to 4 s is not allowed"),
        (length + 1.0, length + 2.0, "fitted", "range"),
        (np.nan, 4.0, "fitted", "range"),
        (1.0, 4.0, "root", "use: 'root' is not allowed"),
    ):
        with pytest.raises(gw.InputError, match=words):
            compared.use("0/drag", begin, end, use)  # type: ignore[arg-type]
    while compared.step.ranges:
        compared.undo()
    assert compared.step is whole
    compared.redo()
    assert compared.step.ranges
    compared.use_all("0/drag")
    assert [own.path for own in compared.used("fitted")] == [wheel.recording.resolve()]
    while compared.step is not whole:
        compared.undo()


def test_a_test_runs_on_the_machine_of_the_recordings_and_is_opened(
    wheel: Wheel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(wheel.recording, tmp_path / "drag")
    session = Session(Library([tmp_path / "drag"]), gw.Model.load(wheel.model))
    session.open("0/.", "fitted")
    session.wait(240.0)
    plan = "check@hold_s=0.5"
    with pytest.raises(gw.InputError, match="not what the diagnosis asks for"):
        session.test(plan)
    diagnosed: list[int] = []
    monkeypatch.setattr(session, "tests", lambda: [plan])
    monkeypatch.setattr(session, "_diagnose", lambda at: diagnosed.append(len(session.used("fitted"))))
    with pytest.raises(gw.InputError, match="not of a simulated bench"):
        session.test(plan)
    note_machine(session.used("fitted")[0], ["--effect", "windage", "--machine", "3", "--seed", "5"])
    session.test(plan)
    session.wait(240.0)
    assert session.trouble is None
    assert diagnosed == [2]  # after it was joined
    made = session.opened["1/."].recording
    assert made.path == tmp_path / "check-hold-s-0-5-1"
    bench = SimulatedBench.of([made])
    assert bench == SimulatedBench(effect=("windage",), machine=3, seed=5)
    # ended in the middle: nothing is left of it
    ended, record = threading.Event(), SimulatedBench.record

    def later(*arguments: Any) -> Any:
        assert ended.wait(240.0)
        return record(*arguments)

    monkeypatch.setattr(SimulatedBench, "record", later)
    session.test(plan)
    session.end()
    assert session.job is None
    ended.set()
    session.wait(240.0)
    assert not (tmp_path / "check-hold-s-0-5-2").exists()
    assert len(session.opened) == 2


@pytest.mark.slow
def test_a_table_is_mapped_corrected_and_becomes_a_recording(wheel: Wheel, tmp_path: Path) -> None:
    shutil.copytree(wheel.recording, tmp_path / "drag")
    samples = gw.Recording.open(wheel.recording).measurement[:20_000]
    table = lab_table(tmp_path / "lab 3.csv", samples)
    with Server(Session(Library([tmp_path]), gw.Model.load(wheel.model)), port=0) as server:
        session = server.session

        def send(body: bytes, name: str, **headers: str) -> tuple[int, bytes]:
            connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=240.0)
            sent = {"Host": f"127.0.0.1:{server.port}", "Content-Type": "application/octet-stream", **headers}
            connection.request("POST", f"/table?name={quote(name)}", body, sent)
            answer = connection.getresponse()
            return answer.status, answer.read()

        assert send(b"x", "a.csv", Origin="http://bench.example")[0] == 403
        assert send(b"x", "a.csv", **{"Content-Type": "text/plain"})[0] == 415
        assert send(b"x", "..")[0] == 422
        assert ask(server, "/do/map_table", {})[0] == 422  # no table
        assert send(b"no table", "../../a.csv")[0] == 200
        session.wait(240.0)
        assert session.trouble is not None
        assert session.trouble.place == "table"
        assert "gyrowheel-" not in session.trouble.sentence  # where it is kept is nobody's business
        assert send(table.read_bytes(), table.name)[0] == 200
        session.wait(240.0)
        assert session.trouble is None
        part = json.loads(ask(server, "/state")[1])["parts"]["table"]
        assert "tilt_y" in part
        assert "Questions to answer" in part
        # what is no map is said; a corrected one is read, and the laws of the wheel agree
        given = {"tilt_y.column": "Tilt Y [rad]", "tilt_y.unit": "deg", "tilt_y.scale": "one"}
        status, body = ask(server, "/do/map_table", given)
        assert status == 422
        assert "scale: 'one' is no number" in json.loads(body)["error"]
        column = (
            next(row["column"] for row in session.table.rows() if row["field"] == "tilt_y")
            if session.table
            else ""
        )
        given = {"tilt_y.column": column, "tilt_y.unit": "deg", "tilt_y.scale": ""}
        ask(server, "/do/map_table", given)
        session.wait(240.0)
        assert session.trouble is None
        assert session.table is not None
        assert session.table.questions == ()
        assert ask(server, "/preview.png")[1].startswith(b"\x89PNG")
        ask(server, "/do/map_table", given | {"take": "1"})
        session.wait(240.0)
        assert session.trouble is None
        assert session.table is None
        (own,) = session.opened.values()
        assert own.recording.path == tmp_path / "lab-3-1"
        assert own.role == "fitted"
        assert np.allclose(own.recording.measurement["tilt_y"], samples["tilt_y"][::2], atol=1e-6)


def test_a_model_is_saved_again_under_its_new_name_and_over_no_other(wheel: Wheel, tmp_path: Path) -> None:
    file = write(tmp_path / "wheel.yaml", wheel.model.read_text(encoding="utf-8"))
    other = write(tmp_path / "other.yaml", "mine")
    session = Session(Library([wheel.recording.parent]), gw.Model.load(file), file)

    def part() -> str:
        return str(views.state(session)["parts"]["bar"])

    def needed(own: Session) -> list[str]:
        return before(own.step.model, own.kept, own.file)

    assert "not saved yet" not in part()
    assert needed(session) == []
    session.steps.append(replace(session.step, model=gw.Model()))
    assert "not saved yet" in part()
    (line,) = needed(session)  # the commands of a report do not find this model
    assert line.startswith("# first save the model")
    for _ in range(2):
        assert session.save("better.yaml") == tmp_path / "better.yaml"
        session.wait(240.0)
    assert 'value="better.yaml"' in part()
    assert "not saved yet" not in part()
    assert needed(session) == []
    (tmp_path / "outside.yaml").symlink_to(tmp_path / "none")
    for taken in ("other.yaml", "outside.yaml"):
        with pytest.raises(gw.InputError, match="exists"):
            session.save(taken)
    for name in ("-rf.yaml", "_.yaml", ".yaml", "a/b.yaml", "a\x1b.yaml", "a.yml"):
        with pytest.raises(gw.InputError, match="is not allowed; allowed: letters, digits"):
            session.save(name)
    assert other.read_text(encoding="utf-8") == "mine"
    fresh = Session(Library([wheel.recording.parent]), gw.Model())
    assert needed(fresh) == ["gyrowheel model new --model wheel.yaml"]


def test_too_little_steady_motion_is_a_verdict_and_no_error(tmp_path: Path) -> None:
    record_simulation(tmp_path / "short", Bench.load(), Scenario.nominal(), Plan.load(SHORT_PLAN))
    session = Session(Library([tmp_path]), gw.Model())
    session.open("0/short", "fitted")
    session.wait(240.0)
    session.diagnose()
    session.wait(240.0)
    assert session.trouble is None
    part = views.state(session)["parts"]["verdict"]
    assert 'data-verdict="insufficient_data"' in part
    assert "steady motion" in part


def test_undone_steps_return_until_the_model_changes_otherwise(wheel: Wheel) -> None:
    session = Session(Library([wheel.recording.parent]), gw.Model())
    one, two = Step(gw.Model()), Step(gw.Model())
    session.steps += [one, two]
    session.undo()
    session.undo()
    assert len(session.steps) == 1
    session.redo()
    assert session.step is one
    session.redo()
    assert session.step is two
    session.undo()
    session._go([*session.steps, Step(gw.Model())])
    with pytest.raises(gw.InputError, match="nothing to redo"):
        session.redo()


def test_all_findings_are_added_at_once_and_removed_one_by_one(
    compared: Session, wheel: Wheel, tmp_path: Path
) -> None:
    content = yaml.safe_load(wheel.model.read_text(encoding="utf-8"))
    size = {"value": 1e-4, "standard_error": 1e-6}
    content["effects"] = {"windage": {"w": size, "n": size | {"value": 1.5}}, "bearing_viscous": {"b": size}}
    file = write(tmp_path / "wheel.yaml", yaml.safe_dump(content))
    compared.steps = [Step(gw.Model.load(file))]
    assert 'data-do="remove" data-what="windage"' in views.state(compared)["parts"]["model"]
    compared.remove("windage")
    assert list(compared.step.model.effects) == ["bearing_viscous"]
    compared.undo()
    assert set(compared.step.model.effects) == {"windage", "bearing_viscous"}
    added: list[Any] = []
    compared._add = lambda items, place: added.append(items)  # type: ignore[method-assign]
    found = Diagnosis.of(diagnosis("effect", finding("windage"), finding("bearing_viscous")))
    compared.steps = [replace(compared.step, diagnosis=found)]
    parts = views.state(compared)["parts"]
    assert ">Add all 2<" in parts["verdict"]
    assert ">Add all 2<" in parts["missing"]
    compared.add_all()
    assert added == [["windage", "bearing_viscous"]]


def test_the_page_speaks_of_its_own_buttons_and_of_no_options_of_the_shell(compared: Session) -> None:
    for name in ("one", "two"):
        own: Any = SimpleNamespace(name=name, data=SimpleNamespace(machine=name))
        compared.opened[name] = Opened(name, own, ROLES[0], {}, {})
    with pytest.raises(gw.InputError, match=r"one is of machine one.*close those of one machine on the left"):
        compared.diagnose()
    for name in ("one", "two"):
        del compared.opened[name]
    untried = Proof("drag", None, "not_tried", left_out="speed")
    found = Diagnosis.of(replace(diagnosis("effect", finding("windage")), proof=untried))
    compared.steps = [replace(compared.step, diagnosis=found)]
    for part in views.state(compared)["parts"].values():
        assert not re.search(r"(?<=[\s(])--[a-z]", re.sub(r"<pre.*?</pre>", "", part, flags=re.DOTALL))


def test_the_page_shows_every_part_of_a_diagnosis(wheel: Wheel) -> None:
    session = Session(Library([wheel.recording.parent]), gw.Model())

    def part(details: Any) -> str:
        session.steps = [replace(session.step, diagnosis=Diagnosis.of(details))]
        return str(views.state(session)["parts"]["missing"])

    nothing: dict[str, Any] = {"error": None, "nuisance": {}, "limits": (), "where": ()}
    wrong = WrongSetup("sign", ("tilt_y",), Fix(scale={"tilt_y": -1.0}), recording="runs/mine")
    shown = part(diagnosis("insufficient_data", setup=(wrong,), **nothing))
    assert "the sign of tilt_y is turned" in shown
    assert "gyrowheel correct runs/mine" in shown
    clock = ReadingFinding("clock_rate", "clock", "rate_error", 2e-5, 1e-6, 0.0, "1", 400.0, "drag")
    half = Coverage(60.0, 30.0, {"of a kind": 10.0})
    own = replace(finding("windage"), name="stiffness_error", effect_title="", effect_sentence="")
    has = finding("aero_cross")
    has = replace(has, in_model=has.coefficients)
    shown = part(diagnosis("effect", own, has, readings=(clock,), coverage=half))
    assert "ppm fast against the count of the samples" in shown
    assert "30 of 40 s of steady motion take part" in shown
    assert "/help/effect/aero_cross" in shown
    assert "/help/effect/stiffness_error" not in shown  # there is no such page
    assert ">Fit again aero_cross<" in shown
    assert ">Add stiffness_error<" in shown
    (form,) = UNKNOWN.free_form
    shown = part(replace(UNKNOWN, free_form=(replace(form, name="form", simple="rotor_torque = a*z^2"),)))
    assert 'data-text="form: rotor_torque = a*z^2"' in shown
    assert "Add the simple law" in shown
    other = TieReport("lobes", "", 3.0, "cone", 40.0, 0.5, form=replace(form, name="lobes"))
    shown = part(replace(UNKNOWN, free_form=(replace(form, name="form", ties=(other,)),)))
    assert "could also be lobes" in shown
    assert 'data-text="lobes: rotor_torque = a*z^2">Add lobes<' in shown


def test_script_in_the_titles_of_a_model_is_text(wheel: Wheel, tmp_path: Path) -> None:
    evil = "<img src=x onerror=alert(1)></script><script>alert(2)</script>"
    declaration = effect_to_mapping(gw.own_effect("mine: torque = -k*Omega*z"))
    content = yaml.safe_load(wheel.model.read_text(encoding="utf-8"))
    content["effects"] = {
        "mine": {
            "declaration": declaration | {"title": evil, "sentence": evil, "source": evil},
            "k": {"value": 1e-6, "standard_error": 1e-7},
        }
    }
    file = write(tmp_path / "wheel.yaml", yaml.safe_dump(content))
    with Server(Session(Library([tmp_path]), gw.Model.load(file), file), port=0) as server:
        for text in (
            json.loads(ask(server, "/state")[1])["parts"]["model"],
            ask(server, "/help/effect/mine")[1].decode(),
        ):
            assert "&lt;img src=x" in text
            assert "<img" not in text
            assert "<script" not in text


def test_an_empty_workbench_offers_the_demonstration(tmp_path: Path) -> None:
    with Server(Session(Library([tmp_path]), gw.Model()), port=0) as server:
        parts = json.loads(ask(server, "/state")[1])["parts"]
    assert 'data-do="demonstrate"' in parts["recordings"]
    assert 'data-do="demonstrate"' in parts["verdict"]


def test_signals_appear_before_the_summary_of_a_recording(
    wheel: Wheel, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(Library([wheel.recording.parent]), gw.Model())
    drawn, ended = threading.Event(), threading.Event()
    describe = Opened.with_description

    def slowly(own: Opened) -> Opened:
        drawn.set()
        assert ended.wait(240.0)
        return describe(own)

    monkeypatch.setattr(Opened, "with_description", slowly)
    session.open("0/drag", "fitted")
    assert drawn.wait(240.0)
    assert [each["key"] for each in views.state(session)["signals"]] == ["0/drag"]
    assert "holds" not in views.state(session)["parts"]["recordings"]
    session.end()
    ended.set()
    session.wait(240.0)
    assert "holds" not in views.state(session)["parts"]["recordings"]
    session.open("0/drag", "not used to fit")  # asked for again, it is summed up
    session.wait(240.0)
    assert "holds" in views.state(session)["parts"]["recordings"]
