"""The judge of blind tests: outcomes of a verdict, compared with the hidden effects."""

from __future__ import annotations

from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel.blind_tests.judge import RIGHT, judge
from gyrowheel_core.errors import InputError

from .findings import AMBIGUOUS, UNKNOWN, delay_finding, diagnosis, finding, limit, tie
from .helpers import write

WINDAGE = {"windage": {"w": 1e-3, "n": 1.5}}
INDUCTANCE = {"coil_inductance": {"t_L": 2e-4}}
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
        (diagnosis("ambiguous", finding("aero_cross", tie("windage", None))), WINDAGE, "tied_without_test"),
        # an alternative of an instrument
        (diagnosis("ambiguous", instruments=(delay_finding(tie("coil_inductance")),)), INDUCTANCE, "tied"),
        (
            diagnosis("ambiguous", instruments=(delay_finding(tie("coil_inductance", None)),)),
            INDUCTANCE,
            "tied_without_test",
        ),
        (diagnosis("ambiguous", instruments=(delay_finding(),)), INDUCTANCE, "missed"),
        (diagnosis("effect", finding("aero_cross")), WINDAGE, "misnamed"),
        (diagnosis("effect", finding("aero_cross"), finding("windage")), WINDAGE, "misnamed"),
        (diagnosis("effect", finding("windage")), BOTH, "partial"),
        (diagnosis("effect", finding("windage")), {}, "misnamed"),
        (UNKNOWN, WINDAGE, "unknown"),
        (diagnosis("nothing_missing"), WINDAGE, "missed"),
        (diagnosis("nothing_missing", limits=limit("windage", 2e-3)), WINDAGE, "below_limit"),
        (diagnosis("nothing_missing", limits=limit("aero_cross", 2e-3)), WINDAGE, "missed"),
        (diagnosis("nothing_missing", limits=limit("windage", 2e-3)), BOTH, "missed"),
    ],
)
def test_outcome_of_a_verdict(found, truth, outcome):
    judgement = judge(found, truth)
    assert judgement.outcome == outcome
    assert judgement.right == (outcome in RIGHT)
    assert ("WRONG" in judgement.sentence) == (outcome not in RIGHT)


def test_the_sentence_of_a_tie_names_the_separating_plan():
    assert "plan air_density" in judge(AMBIGUOUS, {"flexure_damping": {"C": 1e-5}}).sentence


def test_one_coefficient_above_its_limit_makes_the_effect_detectable():
    found = diagnosis("nothing_missing", limits=limit("fixed_torque", 1e-3))
    assert judge(found, {"fixed_torque": {"F_x": 9e-4, "F_y": -9e-4}}).right
    assert not judge(found, {"fixed_torque": {"F_x": 9e-4, "F_y": -2e-3}}).right


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"effects": 3}', '{"effects": {"windage": {"w": "x"}}}'])
def test_a_bad_key_file_is_refused(tmp_path: Path, text: str):
    with pytest.raises(InputError, match=r"key\.json"):
        gw.open_key(write(tmp_path / "key.json", text))
