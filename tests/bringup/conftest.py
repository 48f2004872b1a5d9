"""A ROS domain for each test, and processes that never outlive it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ..domains import next_domain
from .helpers import Bystander, NodeProcess


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
