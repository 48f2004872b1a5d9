"""Many cases: what starts from what, what is not computed twice, kills, clusters."""

from __future__ import annotations

import errno
import math
import os
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path

import pytest

from gyrowheel_air.cfd.case import RESULT
from gyrowheel_air.cfd.sweep import companions, sweep
from gyrowheel_air.table import collect_results
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM

from .helpers import Player, levels_of, tiny


def test_a_sweep_plan_starts_each_tilt_at_one_speed_and_continues_from_it():
    first, rest = levels_of([0, 5], [1000, 3400, 4000])
    assert [(s.case.tilt / DEG, round(s.case.spin_rate / RPM), s.first) for s in first] == [
        (0.0, 3400, None),
        (5.0, 3400, None),
    ]
    assert {(round(s.case.tilt / DEG), round(s.case.spin_rate / RPM)) for s in rest} == {
        (t, w) for t in (0, 5) for w in (1000, 4000)
    }
    for step in rest:
        assert step.first is not None
        assert step.first.tilt == step.case.tilt


@pytest.mark.parametrize(
    ("mesh", "other", "laminar"),
    [
        ("low_re", "low_re_fine", "low_re"),
        ("low_re_fine", "low_re", "low_re_fine"),
        ("tiny", "low_re_fine", "low_re"),
    ],
)
def test_companions_vary_one_thing_each(mesh: str, other: str, laminar: str):
    steps = companions(tiny(mesh=mesh), 5 * DEG, 3500 * RPM)
    cases = [step.case for step in steps]
    assert len({case.name for case in cases}) == len(cases)
    assert any(case.tilt == -5 * DEG for case in cases)
    assert any(case.direction == pytest.approx(math.pi / 4) for case in cases)
    assert {(c.mesh, c.model) for c in cases} >= {
        (other, "sst"),
        ("coarse", "paper"),
        (laminar, "laminar"),
    }


def test_a_sweep_computes_nothing_twice(tmp_path: Path, player: Player):
    seen: list[tuple[str, int, int]] = []
    levels = levels_of([0, 5], [2000, 3500])
    first = sweep(levels, tmp_path, tell=lambda case, _, done, total: seen.append((case.name, done, total)))
    assert [item[1:] for item in seen] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert len(player.calls) == 4
    again = sweep(levels, tmp_path, tell=lambda *_: None)
    assert len(player.calls) == 4
    assert (first.reused, again.reused) == (0, 4)
    assert [r.to_json() for r in again.results] == [r.to_json() for r in first.results]
    wider = sweep(levels_of([0, 5], [2000, 3500, 4000]), tmp_path, tell=lambda *_: None)
    assert len(player.calls) == 6
    assert wider.reused == 4
    assert len(collect_results(tmp_path)) == 6


def test_a_failed_case_blocks_only_its_successors(tmp_path: Path, player: Player):
    levels = levels_of([0, 5], [2000, 3500])
    player.fail_in(levels[0][1].case.name)
    outcome = sweep(levels, tmp_path, tell=lambda *_: None)
    assert len(outcome.results) == 2
    assert len(outcome.failed) == 2
    assert any("Maximum number of iterations" in why for why in outcome.failed.values())
    assert any("first guess" in why for why in outcome.failed.values())


def test_half_written_results_are_computed_again(tmp_path: Path, player: Player):
    levels = levels_of([5], [3500])
    sweep(levels, tmp_path, tell=lambda *_: None)
    path = tmp_path / levels[0][0].case.name / RESULT
    path.write_text(path.read_text()[:100])
    assert sweep(levels, tmp_path, tell=lambda *_: None).reused == 0
    assert len(player.calls) == 2


SWEEP = ["cfd", "sweep", "--mesh", "tiny", "--iterations", "40", "--tilts", "0,2,5", "--speeds", "3000,3500"]


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [pytest.param(1, marks=pytest.mark.study), 2])
def test_a_killed_sweep_resumes(tmp_path: Path, player: Player, jobs: int):
    study = tmp_path / "study"
    command = [
        sys.executable,
        "-c",
        "from gyrowheel.cli.app import main; main()",
        *SWEEP,
        "--jobs",
        str(jobs),
    ]
    player.hang_at(3)
    process = subprocess.Popen([*command, "-o", str(study)], stderr=subprocess.PIPE, text=True)
    try:
        done = _wait(lambda: len(player.calls) >= 3 and len(list(study.glob(f"*/{RESULT}"))) >= 2)
        assert done, process.poll()
        hanging = player.calls[2]
        assert _wait(lambda: bool(_running(player)))
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    # no solver outlives its sweep
    assert _wait(lambda: not _running(player))
    before = {path.parent.name for path in study.glob(f"*/{RESULT}")}
    assert hanging not in before
    player.hang_at(None)
    calls = len(player.calls)
    finish = subprocess.run(
        [*command[:3], "cfd", "sweep", "--resume", str(study)], capture_output=True, text=True, check=False
    )
    assert finish.returncode == 0, finish.stderr
    assert f"if this is interrupted: gyrowheel cfd sweep --resume {study}" in finish.stderr
    assert f"6 cases finished, {len(before)} of them earlier; 0 failed" in finish.stdout
    assert sorted(player.calls[calls:]) == sorted({r.case.name for r in collect_results(study)} - before)


#: The command line in a process of its own, in which no semaphore can be made.
_WITHOUT_SEMAPHORES = """
    import _multiprocessing, os, sys

    class Refused:
        SEM_VALUE_MAX = 2**31 - 1
        def __init__(self, *_, **__):
            raise OSError({0}, os.strerror({0}))

    _multiprocessing.SemLock = Refused
    from gyrowheel.cli.app import main
    main()
"""


@pytest.mark.slow
def test_a_sweep_without_semaphores_runs_in_threads(tmp_path: Path, player: Player):
    """Where /dev/shm is missing, full or read-only: the cases are OpenFOAM's work, and threads wait for it."""
    code = textwrap.dedent(_WITHOUT_SEMAPHORES).format(errno.ENOENT)
    study = tmp_path / "study"
    command = [sys.executable, "-c", code, *SWEEP, "--jobs", "2", "-o", str(study)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "6 cases finished, 0 of them earlier; 0 failed" in done.stdout
    assert "Warning" not in done.stderr
    assert sorted(player.calls) == sorted(result.case.name for result in collect_results(study))


def test_two_sweeps_in_one_folder_are_refused(tmp_path: Path, player: Player):
    import fcntl

    with (tmp_path / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another sweep works in this folder"):
            sweep(levels_of([5], [3500]), tmp_path, tell=lambda *_: None)


def test_a_sweep_runs_on_a_dask_cluster(tmp_path: Path, player: Player):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        seen: list[int] = []
        outcome = sweep(
            levels_of([0, 5], [2000, 3500]),
            tmp_path / "study",
            dask=cluster.scheduler_address,
            tell=lambda case, result, done, total: seen.append(done),
        )
    assert seen == [1, 2, 3, 4]
    assert len(outcome.results) == len(player.calls) == 4
    assert sweep(levels_of([0, 5], [2000, 3500]), tmp_path / "study", tell=lambda *_: None).reused == 4


def test_missing_dask_is_reported(tmp_path: Path, player: Player, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "dask.distributed", None)
    with pytest.raises(
        InputError, match=r"dask: needs the package distributed.*pip install 'gyrowheel-sim\[dask\]'"
    ):
        sweep(levels_of([5], [3500]), tmp_path, dask="tcp://127.0.0.1:1", tell=lambda *_: None)


def test_a_sweep_continues_unsettled_cases(tmp_path: Path, player: Player):
    levels = levels_of([0, 5], [2000, 3500])
    sweep(levels, tmp_path, tell=lambda *_: None)
    further = [[replace(step, case=replace(step.case, settle=60)) for step in level] for level in levels]
    outcome = sweep(further, tmp_path, tell=lambda *_: None)
    assert outcome.reused == 0
    assert [result.provenance["iterations"] for result in outcome.results] == [60] * 4
    # 40 + 20; those that start from a neighbour 24 + 20 + 16
    assert len(player.calls) == 4 + 2 * 1 + 2 * 2
    # a look at the same study without it computes nothing
    assert sweep(levels, tmp_path, tell=lambda *_: None).reused == 4


def _wait(condition, seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False


def _running(player: Player) -> list[int]:
    """Return the processes that hang in place of a solver of this player."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
                here = (entry / "cwd").resolve()
            except OSError:
                continue
            if words[:2] == [b"sleep", b"1000"] and here.is_relative_to(player.path.parent):
                found.append(int(entry.name))
    return found
