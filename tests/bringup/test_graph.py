"""The whole graph: five processes that run a plan together."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrowheel_bringup.graph import EXECUTABLES, Graph, GraphError, find_executable
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Integrity, Recording
from gyrowheel_sim.bench import Bench

from ..domains import next_domain
from .conftest import Session, everything
from .helpers import SHORT_PLAN, Bystander, alive, odd_bench, wait_for

pytestmark = pytest.mark.graph


def test_five_processes_run_the_plan_and_end(session: Session):
    result = session.result
    assert set(result.pids) == set(EXECUTABLES)
    assert len({session.starter, *result.pids.values()}) == 6
    assert not any(alive(pid) for pid in result.pids.values())
    assert result.segments == len(session.plan.segments)
    assert result.simulated_seconds == pytest.approx(session.plan.duration)
    assert {p.label for p in session.progress} == {"level", "tilted", "faster", "cone"}
    assert [p.elapsed for p in session.progress] == sorted(p.elapsed for p in session.progress)


@pytest.mark.study  # of speed alone
@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="no control of the cores")
def test_the_nodes_of_the_loop_share_a_core_and_leave_the_others_alone():
    allowed = os.sched_getaffinity(0)
    with Graph(domain_id=next_domain(), without=("conductor", "recorder")) as graph:
        cores = {name: os.sched_getaffinity(pid) for name, pid in graph.pids.items()}
    if len(allowed) == 1:
        assert set(map(frozenset, cores.values())) == {frozenset(allowed)}
        return
    assert cores["plant"] == cores["controller"]
    assert len(cores["plant"]) == 1
    assert cores["drag_estimator"] == allowed - cores["plant"]
    assert os.sched_getaffinity(0) == allowed


def test_every_sample_is_recorded_once_and_answered(session: Session):
    n = session.result.samples
    assert n == round(session.plan.duration / 0.0005) + 1
    measurement, command = session.recording.measurement, session.recording.command
    assert session.recording.integrity() == Integrity(samples=n)
    assert np.array_equal(measurement["sequence"], np.arange(n))
    assert np.array_equal(measurement["stamp_ns"], np.arange(n) * 500_000)
    # the plant waits for the answer to the last one, which no setpoint covers
    assert np.array_equal(command["measurement_sequence"], np.arange(n - 1))
    assert np.array_equal(session.recording.setpoint["stamp_ns"], session.plan.setpoints()["stamp_ns"])


def test_graph_gives_the_samples_of_the_simulation_bit_for_bit(session: Session):
    run = simulate(Bench.load(), everything(), session.plan)
    n = len(run.measurement)
    command = np.stack([session.recording.command[name] for name in wire.COMMAND.fields], axis=1)
    assert np.array_equal(session.recording.readings.array[:n], run.measurement)
    assert np.array_equal(command[:n], run.command)


@pytest.mark.study  # test_plant_node.py has the same without a graph
def test_a_bench_whose_period_is_no_part_of_the_clocks_is_recorded_whole(tmp_path: Path):
    with Graph(
        SHORT_PLAN,
        bench=odd_bench(tmp_path),
        record=tmp_path / "run",
        domain_id=next_domain(),
        without=["drag_estimator"],
    ) as graph:
        result = graph.run()
    end = -(-round(Plan.load(SHORT_PLAN).duration * 1e9) // 10_000_000) * 10_000_000  # [ns], when a plan ends
    stamps = Recording.open(tmp_path / "run").measurement["stamp_ns"]
    assert np.array_equal(stamps, np.arange(result.samples) * 300_000)
    assert stamps[-2] < end <= stamps[-1]


def test_steady_holds_are_estimated(session: Session):
    estimates = session.recording.drag_estimate
    settled = estimates[estimates["settled"]]
    assert settled["segment"].tolist() == [1]  # the other holds are too short
    assert settled["tilt_x"] == pytest.approx(np.radians(1.0), abs=1e-3)
    assert np.isfinite(settled["simulated_torque"]).all()


StartGraph = Callable[[str], tuple[subprocess.Popen[str], list[int]]]


@pytest.fixture
def start_graph(tmp_path: Path) -> Iterator[StartGraph]:
    """Return a function that runs code which starts a graph and prints the process ids of its nodes."""
    started: list[subprocess.Popen[str]] = []

    def start(code: str) -> tuple[subprocess.Popen[str], list[int]]:
        with (tmp_path / "log").open("wb") as errors:
            starter = subprocess.Popen(
                [sys.executable, "-c", f"from gyrowheel_bringup.graph import Graph\n{code}"],
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                start_new_session=True,
            )
        started.append(starter)
        assert starter.stdout is not None
        # the middleware may report something before it
        lines = (line.split() for line in starter.stdout)
        pids = next(([int(own) for own in line] for line in lines if all(map(str.isdigit, line))), [])
        assert pids, (tmp_path / "log").read_text()
        assert all(alive(pid) for pid in pids)
        return starter, pids

    yield start
    for starter in started:
        starter.kill()
        starter.wait()


def test_a_used_domain_is_refused_and_nodes_end_after_a_killed_starter(domain: int, start_graph: StartGraph):
    without = sorted(set(EXECUTABLES) - {"conductor"})
    code = f"""if True:
        with Graph(domain_id={domain}, without={without}) as graph:
            print(*graph.pids.values(), flush=True)
            graph.wait()
    """
    starter, pids = start_graph(code)
    with pytest.raises(GraphError, match="the ROS domain has another node"):
        Graph(domain_id=domain, without=without).__enter__()
    assert all(alive(pid) for pid in pids)
    starter.kill()
    starter.wait()
    wait_for(lambda: not any(alive(pid) for pid in pids))


@pytest.mark.study  # a computer with other work is late; the order by itself is in the test of the conductor
def test_in_real_time_the_end_of_a_plan_is_held_without_a_gap(domain: int, bystander: Bystander):
    told: list[tuple[str, str]] = []

    def answered() -> int:
        return int(bystander.values("controller").get("commands", 0))

    with Graph(
        SHORT_PLAN,
        domain_id=domain,
        hold_after_plan=True,
        realtime=True,
        without=["recorder", "drag_estimator"],
        # a machine that is busy elsewhere is another matter
        parameters={"conductor": {"lead": 10.0}, "plant": {"watchdog": 20.0, "oldest_command": 5.0}},
        on_trouble=lambda *said: told.append(said),
    ) as graph:
        graph.run()
        at_the_end = answered()
        bystander.spin_until(lambda: answered() > at_the_end + 2000)
    assert not [text for _, text in told if text.startswith("setpoint_lost")]


def test_bad_input_is_refused_before_anything_starts(tmp_path: Path):
    with pytest.raises(InputError, match=r"tilt 80\.00 deg is beyond the bench"):
        Graph(SHORT_PLAN.replace("[1.0, 0.5]", "[80.0, 0.5]"))
    with pytest.raises(InputError, match="exists already"):
        Graph(record=tmp_path)
    with pytest.raises(InputError, match="no such node"):
        Graph(without=["camera"])


def test_a_bad_parameter_is_told_by_the_node(tmp_path: Path):
    options: dict[str, Any] = {"without": set(EXECUTABLES) - {"conductor"}, "domain_id": next_domain()}
    with pytest.raises(InputError, match=r"parameter lead: 99\.0 is not allowed"):
        Graph(parameters={"conductor": {"lead": 99.0}}, **options).__enter__()


def test_executables_are_found_or_explained():
    assert os.access(find_executable("gyrowheel_sim", "plant_node"), os.X_OK)
    with pytest.raises(InputError, match="no executable 'plan'; it has: plant_node"):
        find_executable("gyrowheel_sim", "plan")
    with pytest.raises(InputError, match="package 'nowhere' is not installed"):
        find_executable("nowhere", "plant_node")
