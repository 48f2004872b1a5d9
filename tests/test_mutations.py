"""Damaged recordings and YAML files: never a traceback, a hang or a silent wrong answer.

A few of each here; ``python -m benchmarks mutations`` tries two thousand of each.
"""

from __future__ import annotations

import random

import numpy as np
import pytest

from benchmarks import mutations
from benchmarks.mutations import Hang, Tally, WrongAnswer
from gyrowheel_core.errors import InputError


@pytest.mark.slow
def test_damaged_recordings() -> None:
    tally = mutations.recordings(220, seed=11)
    assert tally.failures == []
    # the damage must have been such as matters
    assert tally.outcomes["refused"] > 100
    assert tally.outcomes["salvage saved in part"] + tally.outcomes["salvage saved whole"] > 30
    assert tally.longest < mutations.PATIENCE


@pytest.mark.slow
def test_damaged_yaml_files() -> None:
    tally = mutations.yaml_files(220, seed=12)
    assert tally.failures == []
    assert tally.outcomes["refused"] > 100
    assert tally.outcomes["accepted"] > 10
    assert tally.longest < mutations.PATIENCE


def test_what_goes_wrong_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tally itself: each kind of failure is one, and an error of one line is none."""
    monkeypatch.setattr(mutations, "PATIENCE", 0.05)

    def hangs() -> str:
        while True:
            np.zeros(10).sum()

    def raises(error: BaseException) -> str:
        raise error

    tally = Tally()
    tally.take("a", hangs)
    tally.take("b", lambda: raises(KeyError("x")))
    tally.take("c", lambda: raises(WrongAnswer("other samples")))
    tally.take("d", lambda: raises(InputError("two\nlines")))
    tally.take("e", lambda: raises(InputError("file: bad")))
    tally.take("f", lambda: "exactly")
    assert [failure.split(":")[0] for failure in tally.failures] == ["hang", "traceback", "wrong", "wrong"]
    assert tally.outcomes == {"failed": 3, "refused": 2, "exactly": 1}
    assert issubclass(Hang, BaseException)
    assert not issubclass(Hang, Exception)


def test_damage_is_damage() -> None:
    rng = random.Random(3)
    data = rng.randbytes(4000)
    changed = [mutations.mutated(data, rng) for _ in range(100)]
    assert sum(other != data for other in changed) > 90
    assert len({len(other) for other in changed}) > 20
    assert sum(mutations.mutated_text(mutations.MODEL, rng) != mutations.MODEL for _ in range(100)) > 90
