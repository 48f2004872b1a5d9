"""When a verdict counts as right."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrowheel.blind_tests.judge import hidden_effects, judge
from gyrowheel_core.errors import InputError

from .findings import AMBIGUOUS, UNKNOWN, diagnosis, finding, limit, tie
from .helpers import write

WINDAGE = {"windage": {"w": 1e-3, "n": 1.5}}
BOTH = {"windage": {"w": 1e-3, "n": 1.5}, "aero_cross": {"c": 5e-3, "n": 1.98}}


@pytest.mark.parametrize(
    ("found", "truth", "outcome"),
    [
        (diagnosis("effect", finding("windage")), WINDAGE, "exact"),
        (diagnosis("effect", finding("aero_cross"), finding("windage")), BOTH, "exact"),
        (diagnosis("nothing_missing"), {}, "exact"),
        (AMBIGUOUS, {"aero_cross": {"c": 5e-3}}, "exact"),
        (AMBIGUOUS, {"flexure_damping": {"C": 1e-5}}, "tied"),
        (diagnosis("ambiguous", finding("aero_cross", tie("windage")), finding("windage")), BOTH, "exact"),
        (
            diagnosis("ambiguous", finding("aero_cross"), finding("bearing_viscous", tie("windage"))),
            BOTH,
            "tied",
        ),
        # a tie without a test that separates it leads nowhere
        (diagnosis("ambiguous", finding("aero_cross", tie("windage", None))), WINDAGE, "wrong"),
        (diagnosis("effect", finding("aero_cross")), WINDAGE, "wrong"),
        (diagnosis("effect", finding("aero_cross"), finding("windage")), WINDAGE, "wrong"),
        (diagnosis("effect", finding("windage")), BOTH, "wrong"),
        (diagnosis("effect", finding("windage")), {}, "wrong"),
        (UNKNOWN, WINDAGE, "wrong"),
        (diagnosis("nothing_missing"), WINDAGE, "wrong"),
        (diagnosis("nothing_missing", limits=limit("windage", 2e-3)), WINDAGE, "below_limit"),
        (diagnosis("nothing_missing", limits=limit("aero_cross", 2e-3)), WINDAGE, "wrong"),
        (diagnosis("nothing_missing", limits=limit("windage", 2e-3)), BOTH, "wrong"),
    ],
)
def test_judge(found, truth, outcome):
    judgement = judge(found, truth)
    assert judgement.outcome == outcome
    assert judgement.right == (outcome != "wrong")
    assert ("WRONG" in judgement.sentence) == (outcome == "wrong")


def test_the_tie_names_its_test():
    assert "plan air_density" in judge(AMBIGUOUS, {"flexure_damping": {"C": 1e-5}}).sentence


def test_one_coefficient_above_its_limit_is_above():
    found = diagnosis("nothing_missing", limits=limit("fixed_torque", 1e-3))
    assert judge(found, {"fixed_torque": {"F_x": 9e-4, "F_y": -9e-4}}).right
    assert not judge(found, {"fixed_torque": {"F_x": 9e-4, "F_y": -2e-3}}).right


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"effects": 3}', '{"effects": {"windage": {"w": "x"}}}'])
def test_a_bad_key_file_is_refused(tmp_path: Path, text: str):
    with pytest.raises(InputError, match=r"key\.json"):
        hidden_effects(write(tmp_path / "key.json", text))
