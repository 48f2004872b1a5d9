"""Uncertainty of coefficients: its parts, and the interval that undetected effects widen."""

from __future__ import annotations

import math

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_analysis.diagnosis import uncertainty
from gyrowheel_analysis.diagnosis.estimates import ErrorParts
from gyrowheel_analysis.diagnosis.uncertainty import error_parts
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_core.arrays import one_thread

Array = np.ndarray


@pytest.fixture(scope="module")
def braked() -> tuple[Problem, Fit]:
    """Fit eddy-current drag, which the viscous friction of the bearing resembles."""
    recording = gw.simulate("quick", effects={"eddy_drag": {"e": 5.4e-6}}, machine=126, seed=126)
    with one_thread():
        problem = prepare([recording.data], Model.new()).problem
        return problem, problem.fit([problem.unknowns.term("eddy_drag")])


def test_noise_and_bench_make_the_standard_error(braked: tuple[Problem, Fit]) -> None:
    problem, fit = braked
    parts = error_parts(problem, fit)["eddy_drag", "e"]
    assert math.hypot(parts.noise, parts.bench) == pytest.approx(fit.standard_error("eddy_drag", "e"))
    assert 0.0 < parts.noise < parts.bench
    low, high = parts.interval
    assert high - low == pytest.approx(2 * 1.96 * math.hypot(parts.noise, parts.bench, parts.undetected))


def test_the_interval_holds_with_and_without_undetected_effects() -> None:
    parts = ErrorParts(noise=0.3, bench=0.4, undetected=0.5, value=10.0, middle=12.0)
    low, high = parts.interval
    assert low == pytest.approx(10.0 - 1.96 * 0.5)
    assert high == pytest.approx(12.0 + 1.96 * math.sqrt(0.5))


def test_a_look_alike_that_would_not_show_widens_the_interval_to_the_truth(
    braked: tuple[Problem, Fit],
) -> None:
    problem, fit = braked
    parts = error_parts(problem, fit)["eddy_drag", "e"]
    assert parts.undetected > 3.0 * parts.bench
    assert parts.interval[0] < 5.4e-6 < parts.interval[1]


def test_marginalisation_equals_a_covariance_of_the_rows(braked: tuple[Problem, Fit]) -> None:
    """Effects of normal size about zero add their columns' covariance to that of the noise."""
    problem, fit = braked
    inverse, _ = problem.unknowns.prior(fit.terms)
    design, hidden = problem.noise.whiten(fit.jacobian), problem.noise.whiten(_columns(problem, fit))
    precision = np.linalg.inv(np.eye(len(hidden)) + hidden @ hidden.T)
    size = np.linalg.norm(np.vstack([design, np.diag(inverse)]), axis=0)
    scaled = design / size
    covariance = np.linalg.inv(scaled.T @ precision @ scaled + np.diag((inverse / size) ** 2))
    moved = covariance @ (
        scaled.T @ precision @ problem.noise.whiten(fit.residual) - fit.pull * inverse / size
    )
    parts = error_parts(problem, fit)["eddy_drag", "e"]
    assert parts.deviation == pytest.approx(math.sqrt(covariance[-1, -1]) / size[-1], rel=1e-5)
    assert parts.middle - fit.coefficients["eddy_drag"]["e"] == pytest.approx(moved[-1] / size[-1], rel=1e-4)


def _columns(problem: Problem, fit: Fit) -> Array:
    """Return the rows of every effect but the fitted one and those of instruments, at a tenth of the usual size."""
    unknowns = problem.unknowns
    columns = []
    for term in unknowns.candidates():
        if term.effect is not None and term not in fit.terms and not unknowns.same_as(term):
            own = problem.term_jacobian(term, unknowns.stated(), term.amplitudes)
            columns.append(own * [0.1 * c.usual[1] for c in term.effect.amplitudes])
    return np.hstack(columns)


def test_without_undetected_effects_the_interval_is_that_of_the_standard_error(
    braked: tuple[Problem, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, fit = braked
    monkeypatch.setattr(uncertainty, "UNDETECTED_SIZE", 0.0)
    parts = error_parts(problem, fit)["eddy_drag", "e"]
    assert parts.deviation == pytest.approx(fit.standard_error("eddy_drag", "e"), rel=1e-6)
    assert parts.middle == pytest.approx(fit.coefficients["eddy_drag"]["e"], rel=1e-4)


@pytest.mark.parametrize(
    ("exponent", "conflict"), [(1.60, True), pytest.param(1.48, False, marks=pytest.mark.study)]
)
@pytest.mark.slow
def test_a_prior_that_is_wrong_is_reported_in_the_verdict(exponent: float, conflict: bool) -> None:
    recording = gw.simulate("quick", effects={"windage": {"w": 0.006, "n": exponent}}, machine=6, seed=6)
    found = gw.diagnose(recording, gw.Model())
    assert ("The prior of n disagrees with the data by" in found.to_dict()["summary"]) == conflict
    content = found.to_dict()["effects"][0]["coefficients"]["n"]
    assert set(content["parts"]) == {"noise", "bench", "undetected"}
    assert conflict or content["interval"][0] < exponent < content["interval"][1]
