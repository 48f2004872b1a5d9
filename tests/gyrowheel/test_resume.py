"""Campaigns that were interrupted or killed go on where they were."""

from __future__ import annotations

import inspect
import json
import math
import os
import random
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest

import gyrowheel as gw
from gyrowheel.campaigns.cases import Case
from gyrowheel.campaigns.judge import EventJudged, Interval, Judged
from gyrowheel.cli.app import app
from gyrowheel.cli.console import run
from gyrowheel_core.errors import InputError
from gyrowheel_core.journal import FINISHED

from .helpers import DRAG_PLAN, OTHER_PLAN, Shell, write
from .killing import until_done


def made_up(keep: object, case: Case, *_: object) -> Judged:
    """Return a case that nobody has run: what it says depends on its number alone."""
    rng = random.Random(case.index)
    sizes = {"windage": rng.choice([math.nan, rng.uniform(0.1, 9.0)])}
    interval = Interval("windage.w", rng.gauss(1e-3, 1e-4), rng.choice([1e-4, math.inf]), 1e-3)
    truth = {"windage": {"w": rng.random() / 3.0}}
    return Judged(
        case.index,
        case.kind,
        truth,
        sizes,
        True,
        "effect",
        ["windage"],
        [("bearing_viscous", None), ("eddy_drag", "survey")],
        "exact" if case.index % 3 else "tied",
        intervals=[interval],
        validation=None if case.index % 2 else rng.random(),
        seconds=rng.random(),
        error="inf",
        event=EventJudged("step", 3.0, rng.random(), math.inf, False),
    )


def campaign(folder: Path | None, **options: Any) -> gw.CampaignResult:
    settings: dict[str, Any] = {"cases": 12, "seed": 5, "validation_plan": OTHER_PLAN, "jobs": 1} | options
    return gw.campaign(DRAG_PLAN, folder=folder, **settings)


def test_a_killed_campaign_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    begun = tmp_path / "begun"
    here: list[int] = []  # what this process has begun

    def slowly(keep: str | None, case: Case, scratch: str | None) -> Judged:
        if len(here) == 5:  # so that no process is quick enough to run them all
            time.sleep(600.0)
        here.append(case.index)
        with begun.open("a") as file:
            file.write(f"{case.index}\n")
        assert scratch is not None
        (Path(scratch) / f"{os.getpid()}").write_text("half a recording")
        time.sleep(0.01)
        return made_up(None, case)

    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", slowly)
    folder, kills, known = tmp_path / "out", 0, set[str]()
    for _ in until_done(
        lambda: campaign(folder, resume=(folder / "settings.json").exists()),
        begun,
        folder / FINISHED,
        seed=1,
        longest=0.05,
    ):
        kills += 1
        files = {path.name: path for path in folder.glob(f"{FINISHED}/[!.]*")}
        for path in files.values():
            json.loads(path.read_text(), parse_constant=pytest.fail)
        assert known <= files.keys()
        known = {*files}
    assert kills >= 2  # a process runs five of the twelve cases at most
    # one case at most was begun in vain for each kill, and none that was finished was begun again
    assert 12 <= len(begun.read_text().split()) <= 12 + kills
    once_more = campaign(folder, resume=True)
    assert len(begun.read_text().split()) <= 12 + kills
    assert sorted(path.name for path in folder.glob("[!.]*")) == [FINISHED, "settings.json"]
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", made_up)
    straight = campaign(None)
    assert repr(once_more.cases) == repr(straight.cases)
    assert json.dumps(once_more.to_dict()) == json.dumps(straight.to_dict())
    assert once_more.title == straight.title


def test_damaged_and_foreign_cases_are_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", made_up)
    straight = campaign(tmp_path / "a", cases=5)
    campaign(tmp_path / "b", cases=5, seed=6)
    cases = sorted((tmp_path / "a" / FINISHED).iterdir())
    cases[0].write_text(cases[0].read_text()[:-40])
    shutil.copy(tmp_path / "b" / FINISHED / cases[1].name, cases[1])
    cases[2].unlink()
    cases[3].write_text(cases[3].read_text().replace('"outcome"', '"income"'))
    ran: list[int] = []

    def told(keep: object, case: Case, *_: object) -> Judged:
        ran.append(case.index)
        return made_up(None, case)

    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", told)
    again = campaign(tmp_path / "a", cases=5, resume=True)
    assert ran == [0, 1, 2, 3]
    assert repr(again.cases) == repr(straight.cases)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a campaign of made-up cases."""
    folder = tmp_path_factory.mktemp("first") / "out"
    settings = ["--plan", "check", "--cases", "9", "--seed", "3", "--kinds", "none", "--jobs", "1"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gyrowheel.campaigns.api.run_case", made_up)
        assert run(app, ["campaign", *settings, "-o", str(folder)]) == 0
    return folder


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--seed", "4"], "seed: 4 is not that of the campaign in {}, 3"),
        (["--seed", "0"], "seed: 0 is not that of the campaign in {}, 3"),
        (["--cases", "10"], "cases: 10 is not that of the campaign in {}, 9"),
        (["--kinds", "single"], 'kinds: ["single"] is not that of the campaign in {}, ["none"]'),
        (["--lost", "0.01"], "lost: 0.01 is not that of the campaign in {}, 0.0"),
        (["--reality"], "reality: true is not that of the campaign in {}, false"),
        (["--plan", "quick"], "plan: is another one than that of the campaign in {}"),
        (["-o", "other"], "-o: with --resume the folder is {}"),
    ],
)
def test_other_settings_are_refused(gyrowheel: Shell, first: Path, options: list[str], words: str):
    result = gyrowheel("campaign", "--resume", first, *options)
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith(f"error: {words.format(first)}"), result.err


def test_what_does_not_change_the_results_may_change(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The rest need not be repeated, and settings that were refused have changed nothing."""
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", made_up)
    folder = tmp_path / "out"
    settings = ["--plan", "check", "--cases", 9, "--seed", 3, "--kinds", "none", "--jobs", 1]
    first = gyrowheel.good("campaign", *settings, "-o", folder)
    assert gyrowheel("campaign", "--resume", folder, "--seed", 4).code == 2
    again = gyrowheel.good("campaign", "--resume", folder, "--seed", 3, "--jobs", 2)
    assert again.out == first.out
    assert "9 cases, 9 of them finished before" in again.err


def test_resume_refuses_other_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from gyrowheel.simulation import code_identity

    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", made_up)
    campaign(tmp_path / "out")
    for name in ("numpy", "gyrowheel"):
        other = code_identity.code_identity() | {name: "1.2.3"}
        with monkeypatch.context() as patch:
            patch.setattr("gyrowheel.campaigns.api.code_identity", lambda other=other: other)
            with pytest.raises(InputError, match=rf"{name}: .* this is 1\.2\.3"):
                campaign(tmp_path / "out", resume=True)
    campaign(tmp_path / "out", resume=True)


def test_one_changed_line_changes_the_code_identity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from gyrowheel.simulation import code_identity

    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "wheel_effects" / "below").mkdir(parents=True)
    (tmp_path / "wheel_effects" / "__init__.py").touch()
    part = write(tmp_path / "wheel_effects" / "below" / "air.py", "SIGN = 1\n")
    before = code_identity.files_of.__wrapped__("wheel_effects")
    write(part, "SIGN = -1\n")
    assert code_identity.files_of.__wrapped__("wheel_effects") != before
    write(part, "SIGN = 1\n")
    assert code_identity.files_of.__wrapped__("wheel_effects") == before


def test_resume_refuses_a_folder_without_a_campaign(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", made_up)
    campaign(tmp_path / "out")
    for verb, folder, words in (
        ("campaign", "nowhere", "nowhere: there is no campaign to go on with"),
        ("investigate", tmp_path / "out", "holds a campaign, not an investigation"),
        ("cfd sweep", tmp_path / "out", "holds a campaign, not a sweep"),
    ):
        result = gyrowheel(*verb.split(), "--resume", folder)
        assert (result.code, result.out) == (2, "")
        assert words in result.err
    with pytest.raises(InputError, match="a campaign needs a new directory"):
        campaign(tmp_path / "out")
    with pytest.raises(InputError, match="needs the folder"):
        campaign(None, resume=True)


def test_cases_that_another_campaign_kept_are_not_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", made_up)
    (tmp_path / "kept" / "case-0003").mkdir(parents=True)
    with pytest.raises(InputError, match=r"keep: .*case-0003 exists, of another campaign; name a new folder"):
        campaign(None, keep=tmp_path / "kept")
    campaign(None, keep=tmp_path / "kept", only=[1])


def test_two_campaigns_in_one_folder_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", made_up)
    folder = tmp_path / "out"

    def second(done: Sequence[Judged], _: int) -> None:
        if len(done) == 1:
            with pytest.raises(InputError, match="another campaign works in this folder"):
                campaign(folder, resume=True)

    assert len(campaign(folder, progress=second).cases) == 12


def test_two_campaigns_that_keep_cases_in_one_folder_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", made_up)
    kept = tmp_path / "kept"

    def second(done: Sequence[Judged], _: int) -> None:
        if len(done) == 1:
            with pytest.raises(InputError, match="kept: another campaign works in this folder"):
                campaign(None, keep=kept)

    assert len(campaign(None, keep=kept, progress=second).cases) == 12
    assert not list(kept.iterdir())
    assert len(campaign(tmp_path / "both", keep=tmp_path / "both").cases) == 12


def quick(case: Case) -> Judged:
    """Return a case without anything in it, in which nothing was found."""
    seconds = 0.1 * case.index
    return Judged(case.index, case.kind, {}, {}, True, "nothing_missing", [], [], "exact", seconds=seconds)


#: `gyrowheel` with cases that end at once, as many as the file `allowed` says; the workers get this by its text.
FAST = f"""
import os, sys, time
from pathlib import Path
from gyrowheel.batches import workers
from gyrowheel.campaigns.cases import Case
from gyrowheel.campaigns.judge import Judged
from gyrowheel_core.processes import end_with

{inspect.getsource(quick)}

def one(call, case, scratch, campaign):
    end_with(campaign)
    (Path(scratch) / str(case.index)).write_text("half a recording")
    while case.index >= int(Path("allowed").read_text()):
        time.sleep(0.02)
    return quick(case)

workers._one = one
from gyrowheel.cli.app import main
sys.argv[0] = "gyrowheel"
main()
"""


@pytest.mark.study  # kills and interruptions are tested one by one above and below
@pytest.mark.slow
def test_ctrl_c_and_kills_end_the_workers_and_the_printed_command_resumes(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    write(tmp_path / "plan.yaml", DRAG_PLAN)
    (tmp_path / "scratch").mkdir()
    write(tmp_path / "allowed", "5")
    fast = write(tmp_path / "fast.py", FAST)

    def start(*arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, str(fast), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            env=os.environ | {"TMPDIR": str(tmp_path / "scratch")},
            start_new_session=True,
        )

    def until(process: subprocess.Popen[str], words: str) -> None:
        assert process.stderr is not None
        while words not in (line := process.stderr.readline()):
            assert line, "ended before that"

    first = start(
        *["campaign", "--plan", "plan.yaml", "--cases", "30", "--kinds", "none", "--jobs", "2"],
        *["--json", "out.json"],
    )
    try:
        until(first, "3 of 30 cases")
        os.killpg(first.pid, signal.SIGINT)  # as the terminal does: to the workers, too
        out, err = first.communicate(timeout=240)
    finally:
        first.kill()
        first.wait()
    assert first.returncode == 130, err
    assert "Traceback" not in err
    assert err.splitlines()[-1] == "interrupted"
    (command,) = (line.removeprefix("to go on: ") for line in err.splitlines() if line.startswith("to go on"))
    assert command == "gyrowheel campaign --resume out/campaign-1 --jobs 2 --json out.json"
    assert "of 30 cases were finished" in out
    assert 3 <= json.loads((tmp_path / "out.json").read_text())["cases"] < 30
    assert not (tmp_path / "out" / "campaign-1" / "scratch").exists()

    write(tmp_path / "allowed", "9")
    second = start(*shlex.split(command)[1:])
    try:
        until(second, "of them finished before")
        until(second, " of 30 cases")
        until(second, " of 30 cases")
        children = psutil.Process(second.pid).children(recursive=True)
    finally:
        second.kill()
        second.wait(240.0)
    assert len(children) >= 2
    _, alive = psutil.wait_procs(children, timeout=240.0)
    assert not alive

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", lambda keep, case, *_: quick(case))
    shown = gyrowheel.good("campaign", "--resume", "out/campaign-1", "--jobs", 1, "--json", "out.json")
    assert "30 blind cases of plan drag, seed 0" in shown.out
    done = json.loads((tmp_path / "out.json").read_text())
    assert (done["cases"], done["none"]) == (30, {"n": 30, "false_alarms": 0})
    assert done["median_seconds"] == pytest.approx(1.45)
    assert not (tmp_path / "out" / "campaign-1" / "scratch").exists()
    assert not [path for path in (tmp_path / "scratch").iterdir() if path.name.startswith("ca")]


@pytest.mark.slow
def test_finished_cases_survive_an_interruption(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(keep: object, case: Case, *_: object) -> Judged:
        if case.index == 3:
            raise KeyboardInterrupt
        return made_up(None, case)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", interrupted)
    result = gyrowheel("campaign", "--plan", "check", "--jobs", 1, "--cases", 9, "--json", "out.json")
    assert result.code == 130
    assert "interrupted: 3 of 9 cases were finished" in result.out
    assert json.loads((tmp_path / "out.json").read_text())["cases"] == 3
    assert "to go on: gyrowheel campaign --resume out/campaign-1 --jobs 1 --json out.json" in result.err
    # before the first case, and where the disk is full, there is nothing to report, but it can go on
    monkeypatch.setattr(
        "gyrowheel.campaigns.api.run_case", lambda *_: interrupted(None, replace_index(_[1], 3))
    )
    result = gyrowheel("campaign", "--plan", "check", "--jobs", 1, "--cases", 9)
    assert (result.code, result.out) == (130, "")
    assert "to go on: gyrowheel campaign --resume out/campaign-2 --jobs 1" in result.err
    monkeypatch.setattr("gyrowheel.campaigns.api.run_case", made_up)
    for number in (1, 2):
        gyrowheel.good(
            "campaign", "--resume", f"out/campaign-{number}", "--jobs", 1, "--json", f"{number}.json"
        )
    first, second = (json.loads((tmp_path / f"{number}.json").read_text()) for number in (1, 2))
    assert first == second
    assert first["cases"] == 9


def replace_index(case: Case, index: int) -> Case:
    return replace(case, index=index)
