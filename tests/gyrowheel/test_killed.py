"""Verbs that are killed while they work, and that change one file at once; ``benchmarks killed`` does more of it."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.killed import Verb, Zygote, killed, verbs, written_at_once, zygote


@pytest.fixture(scope="module")
def origin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Zygote, dict[str, Verb]]]:
    """Give the process that verbs are forked from, and the verbs."""
    folder = tmp_path_factory.mktemp("killed")
    with zygote(folder) as found:
        yield found, verbs(folder, found)


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb", ["simulate", *(pytest.param(own, marks=pytest.mark.study) for own in ("model", "salvage"))]
)
def test_killed_at_random_instants(verb: str, origin: tuple[Zygote, dict[str, Verb]]) -> None:
    """The old one or the new one is there, whole; the next command works, and nothing is left beside."""
    found = killed(origin[1][verb], origin[0], 3, random.Random(2))
    assert found.wrong == []
    assert 1 <= found.instants <= 3 <= found.before + found.after


@pytest.mark.slow
def test_three_writers_of_one_model(origin: tuple[Zygote, dict[str, Verb]], tmp_path: Path) -> None:
    """Each change is in the file, and none is made without being told."""
    assert written_at_once(tmp_path / "wheel.yaml", origin[0], 3) == []
    assert [place.name for place in tmp_path.iterdir()] == ["wheel.yaml"]
