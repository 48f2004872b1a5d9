"""Nothing is offered that makes the prediction of unused data worse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel.show.sentences.proof import left_sentences
from gyrowheel_analysis.diagnosis.proof_result import ChannelCheck, Proof
from gyrowheel_analysis.diagnosis.support import _excess
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.units import RPM

PLAN = """
schema: 1
name: grid
title: Three speeds
description: A grid of holds.
hold_s: 1.6
segments:
  - label: grid
    spin_rpm: [3000, 1500, 3800]
    tilt_deg: [[0, 0], [3, 0], [-1.5, 0], [0, 2]]
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Return two recordings of a machine with windage, and one without."""
    folder = tmp_path_factory.mktemp("support")
    paths = []
    for name, effects, seed in (
        ("windy", {"windage": {"w": 0.0025}}, 1),
        ("again", {"windage": {"w": 0.0025}}, 2),
        ("still", {}, 3),
    ):
        paths.append(folder / name)
        gw.simulate(Plan.load(PLAN), effects=effects, seed=seed).save(paths[-1])
    return paths[0], paths[1], paths[2]


@pytest.mark.slow
def test_effect_that_predicts_other_recordings_worse_is_not_offered(
    recorded: tuple[Path, Path, Path],
) -> None:
    windy, _, still = recorded
    found = gw.diagnose(windy, gw.Model(), validate=still, mixed=True)
    assert "windage" in found.rejected
    assert [f.name for f in found.effects] == []
    assert found.verdict == "unknown"
    assert found.to_dict()["rejected"] == list(found.rejected)
    assert "Not offered: windage" in str(found)


@pytest.mark.slow
def test_effect_that_other_recordings_confirm_is_offered(recorded: tuple[Path, Path, Path]) -> None:
    windy, again, _ = recorded
    found = gw.diagnose(windy, gw.Model(), validate=again)
    assert found.rejected == ()
    assert [f.name for f in found.effects] == ["windage"]


@pytest.mark.parametrize(
    ("spin", "missing", "refused"),
    [
        (160.0, False, True),  # worse by more than chance explains
        (110.0, False, False),  # within chance
        (160.0, True, False),  # in a channel in which much more is missing, its noise is that misfit
    ],
)
def test_term_that_spoils_one_channel_is_refused_while_the_total_falls(
    spin: float, missing: bool, refused: bool
) -> None:
    """Chi-squared of 100 rows each; the tilt falls from 900 to 100 with the term, the spin rises."""
    more = 400.0 if missing else 0.0
    with_term, without = (
        {"tilt_x": (100.0, 100), "spin": (spin + more, 100)},
        {"tilt_x": (900.0, 100), "spin": (100.0 + more, 100)},
    )
    assert (_excess(with_term, without, missing=missing) > 1.0) == refused
    # a form must predict by itself, whatever else is missing
    assert (_excess(with_term, without) > 1.0) == (spin > 120.0)


def test_what_is_left_is_stated_by_channel_with_the_speed_of_the_worst() -> None:
    proof = Proof("monday", False, "channel", causes=("spin",), speed=2000.0 * RPM)
    proof = replace(
        proof,
        channels=(ChannelCheck("spin", 1.0, 1.4, 12.25, 1.5), ChannelCheck("tilt_x", 1.0, 1.4, 1.1, 1.5)),
    )
    assert left_sentences(proof) == ["Left: 3.50 noise floors in spin, largest at 2000 rpm."]
    assert left_sentences(proof, ("lobes",))[0].startswith("Not offered: lobes makes the prediction")
    assert left_sentences(None) == []
