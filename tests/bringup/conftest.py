"""A ROS domain for each test, processes that never outlive it, and one run of the graph."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from gyrowheel_bringup.graph import Graph, GraphResult, Progress
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import registry
from gyrowheel_sim.plant.scenario import Scenario

from ..domains import next_domain
from ..shared import made_once
from .helpers import SHORT_PLAN, Bystander, NodeProcess, alive


@pytest.fixture
def domain() -> int:
    return next_domain()


@pytest.fixture
def bystander(domain: int) -> Iterator[Bystander]:
    result = Bystander(domain)
    yield result
    result.close()


@pytest.fixture
def start_node(domain: int, tmp_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Return a function that starts a node by its name, with parameters."""
    started: list[NodeProcess] = []

    def start(name: str, *, renamed: str = "", **parameters: object) -> NodeProcess:
        log = tmp_path / f"{name}{len(started)}.log"
        started.append(NodeProcess(name, domain, log, renamed=renamed, **parameters))
        return started[-1]

    yield start
    for node in started:
        node.end()


def everything() -> Scenario:
    """Return a machine with every effect at its usual size."""
    effects = {name: {c.name: c.usual[0] for c in effect.coefficients} for name, effect in registry().items()}
    return Scenario.nominal(effects, noise_seed=5)


class Session(NamedTuple):
    starter: int
    result: GraphResult
    progress: list[Progress]
    recording: Recording
    plan: Plan


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """One run of the short plan, recorded."""
    plan = Plan.load(SHORT_PLAN)

    def run(folder: Path) -> tuple[Path, int, GraphResult, list[Progress]]:
        progress: list[Progress] = []
        directory = folder / "recording"
        with Graph(plan, scenario=everything(), record=directory, domain_id=next_domain()) as graph:
            assert all(alive(pid) for pid in graph.pids.values())
            result = graph.run(progress=progress.append)
        return directory, os.getpid(), result, progress

    directory, starter, result, progress = made_once(tmp_path_factory, "graph", run)
    return Session(starter, result, progress, Recording.open(directory), plan)
