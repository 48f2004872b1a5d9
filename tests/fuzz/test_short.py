"""A few inputs of every kind, and the harness itself."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from gyrowheel_core.errors import InputError

from . import harness
from .damage import mutated, mutated_text, mutated_words
from .harness import Case, Hang, Tally, WrongAnswer, run, smallest
from .kinds import KINDS
from .texts import MODEL

#: How many of each kind; some seconds in all.
_COUNTS = {
    "recording": 15,
    "chunks": 200,
    "message": 20,
    "contents": 4,
    "compare": 3,
    "text": 8,
    "formula": 30,
    "typed": 30,
    "csv": 20,
    "parquet": 20,
    "format": 15,
}


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a slow and busy machine have its time."""
    monkeypatch.setattr(harness, "PATIENCE", 100.0)
    monkeypatch.setattr(harness, "WAIT", 600.0)


@pytest.mark.slow
@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.study] * (kind == "compare")) for kind in _COUNTS]
)
def test_a_few_of_every_kind(kind: str, tmp_path: Path) -> None:
    tally = run(KINDS[kind], seed=7, folder=tmp_path, count=_COUNTS[kind])
    assert list(map(str, tally.failures)) == []
    assert tally.count == _COUNTS[kind]
    refused = sum(count for what, count in tally.outcomes.items() if "refused" in what)
    assert refused > 0  # the damage must have been such as matters
    assert refused < tally.count  # and some of it none


@pytest.mark.graph
@pytest.mark.slow
@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize("kind", ["graph", "heard"])
def test_a_few_messages(kind: str, tmp_path: Path) -> None:
    """No bytes that arrive end a node but by a fault of a name."""
    tally = run(KINDS[kind], seed=7, folder=tmp_path, count=150 if kind == "graph" else 20)
    assert list(map(str, tally.failures)) == []
    assert tally.outcomes["taken"] > 0


def test_every_kind_has_its_share() -> None:
    assert {*_COUNTS, "graph", "heard", "diagnose"} == set(KINDS)  # a diagnosis takes too long


# ---- the harness


def test_what_goes_wrong_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each kind of failure is one, and an error of one line is none."""

    def works(_: bytes) -> str:
        while True:
            np.zeros(10).sum()

    def waits(_: bytes) -> str:
        time.sleep(600.0)
        return "waited"

    def grows(_: bytes) -> str:
        return str(len(bytearray(1 << 29)))

    def raises(error: BaseException) -> str:
        raise error

    broken = InputError("file")
    broken.args = ("two\nlines",)
    tally = Tally()
    uses: list[tuple[Callable[[bytes], str], dict[str, float]]] = [
        (works, {"PATIENCE": 0.05}),
        (waits, {"PATIENCE": 0.05, "WAIT": 0.1}),
        (grows, {"MEMORY": 1 << 28}),
        (lambda _: raises(KeyError("x")), {}),
        (lambda _: raises(WrongAnswer("other samples")), {}),
        (lambda _: raises(broken), {}),
        (lambda _: raises(InputError("file: bad")), {}),
        (lambda _: "exact", {}),
    ]
    for use, limits in uses:
        with monkeypatch.context() as patch:
            for name, limit in limits.items():
                patch.setattr(harness, name, limit)
            tally.take(Case("a", b"", use))
    found = [failure.what for failure in tally.failures]
    assert found == ["hang", "memory", "traceback", "wrong", "wrong"]  # both hangs say the same
    assert tally.outcomes == {"failed": 6, "refused": 1, "exact": 1}
    assert not issubclass(Hang, Exception)  # no reader can catch it by mistake


def test_what_was_tried_before_an_interruption_counts(tmp_path: Path) -> None:
    def interrupted(rng: random.Random, folder: Path) -> Iterator[Case]:
        def ends(_: bytes) -> str:
            raise KeyboardInterrupt

        yield Case("first", b"", lambda _: "read")
        yield Case("second", b"", ends)

    tally = run(interrupted, 1, tmp_path / "folder")
    assert tally.interrupted
    assert dict(tally.outcomes) == {"read": 1}


def test_the_smallest_input_is_found() -> None:
    """Of a long input what matters remains."""

    def use(data: bytes) -> str:
        if b"\x07" in data and data.startswith(b"a"):
            raise KeyError("x")
        return "exact"

    tally = Tally()
    tally.take(Case("a", b"a" + bytes(500) + b"\x07" + bytes(500), use))
    assert smallest(tally.failures[0]) == b"a\x07"


def test_damage_is_damage() -> None:
    rng = random.Random(3)
    data = rng.randbytes(4000)
    changed = [mutated(data, rng) for _ in range(100)]
    assert sum(other != data for other in changed) > 90
    assert len({len(other) for other in changed}) > 20
    assert sum(mutated_text(MODEL, rng) != MODEL for _ in range(100)) > 90
    line = "stator_pull: torque = -k*r^2*z; k [N*m/rad]"
    assert sum(mutated_words(line, rng) != line for _ in range(100)) > 80
