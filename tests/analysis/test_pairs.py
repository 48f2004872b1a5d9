"""Two effects together that explain recordings as well as the one that was found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrowheel.show.sentences.diagnosis import tie_sentence
from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.diagnosis.findings import TieReport
from gyrowheel_analysis.diagnosis.selection import Selection
from gyrowheel_analysis.fitting.fit import Point
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.segmentation import planned_windows
from gyrowheel_control.plans.plan import Plan

from .machines import BENCH


@pytest.fixture(scope="module")
def plain() -> Problem:
    return Problem.of([Balance(planned_windows(Plan.load("quick"), BENCH), BENCH)], BENCH)


@pytest.mark.parametrize(("size", "tied"), [(1.0, True), (0.5, False)])
def test_two_effects_in_the_place_of_one_are_an_alternative(plain: Problem, size: float, tied: bool) -> None:
    """Torques across the tilt that grow with its size and with the square of the speed resemble one with the speed.

    That leaves 22 in chi-squared, less than a further effect must bring: the two are as likely. Of half the size they
    are not.
    """
    hidden = {"aero_cross": {"c": 8e-4 * size, "n": 1.98}, "flexure_hysteresis": {"h": 6e-4 * size}}
    two = tuple(plain.unknowns.term(name) for name in hidden)
    (balance,) = plain.balances
    rows = plain.predict(Point(two, np.zeros(plain.count), hidden))
    problem = replace(plain, prediction=plain.prediction.with_measured([balance.with_measured(rows)]))
    one = plain.unknowns.term("flexure_damping")
    chosen = Selection(problem, problem.fit(()), problem.fit((one,)), (one, *two), 1.0)
    (finding,) = chosen.findings
    pairs = [tie for tie in finding.ties if tie.beside is not None]
    assert [{*tie.terms} for tie in pairs] == ([{*two}] if tied else [])
    for tie in pairs:
        assert -30.0 < tie.delta_chi2 < -16.0


def test_pair_is_said_as_such() -> None:
    tie = TieReport("tilt_delay + windage", "late tilt + drag", -18.6, None, None, None)
    assert tie.names == ("tilt_delay", "windage")
    assert tie_sentence(tie).startswith(
        "could also be both late tilt + drag (tilt_delay + windage): χ² is 18.6 better, about what one more term must "
        "bring. No test"
    )
