"""Selection of terms: the ranking of candidates, and pairs that explain recordings as well as the term found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrowheel.show.sentences.diagnosis import tie_sentence
from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.diagnosis import selection
from gyrowheel_analysis.diagnosis.explanation import explained
from gyrowheel_analysis.diagnosis.findings import TieReport
from gyrowheel_analysis.diagnosis.selection import Selection
from gyrowheel_analysis.fitting.fit import Point
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.segmentation import planned_windows
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.arrays import one_thread

from .machines import BENCH, hidden_machine, record


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
    pairs = [tie for tie in finding.ties if tie.partner is not None]
    assert [{*tie.terms} for tie in pairs] == ([{*two}] if tied else [])
    for tie in pairs:
        assert -30.0 < tie.delta_chi2 < -16.0


def test_pair_is_said_as_such() -> None:
    tie = TieReport("tilt_delay + windage", "late tilt + drag", -18.6, None, None, None)
    assert tie.names == ("tilt_delay", "windage")
    assert tie_sentence(tie).startswith(
        "could also be both tilt_delay and windage (late tilt + drag): χ² is 18.6 better, about what one more term "
        "must bring. No test"
    )


@pytest.mark.slow
def test_the_error_of_a_parameter_that_the_fit_moved_far_is_ranked_at_the_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As stated, its derivative is nearly that of the parameter itself: the gain there is several times too small."""
    machine, stated = hidden_machine(5, {}), BENCH.parameters["motor_constant"]
    values = {**machine.values, "motor_constant": 1.4 * stated.value}
    recording = record(tmp_path, "run", replace(machine, values=values), "quick")
    vague = {**BENCH.parameters, "motor_constant": replace(stated, uncertainty=0.04 * stated.value)}
    model = replace(Model.new(), stated_bench=replace(BENCH, parameters=vague))
    monkeypatch.setattr(selection, "_EXACT", 0)  # as where many others gain more as stated
    with one_thread():
        problem = prepare([recording], model).problem
        plain = problem.fit(())
        ranked = selection.rank(problem, plain, problem.unknowns.candidates())
        (wrong,) = (term for _, term in ranked if term.name == "motor_constant_error")
        gain = plain.chi2 - problem.fit((wrong,)).chi2
    assert ranked[0][1] == wrong
    assert ranked[0][0] > 0.7 * gain


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameters", "factor"),
    [
        ("rotor_inertia_error", ("rotor_inertia_z",), 0.84),
        ("transverse_inertia_error", ("rotor_inertia_x", "rotor_inertia_y"), 1.15),
        ("motor_resistance_error", ("motor_resistance",), 0.75),
        ("motor_constant_error", ("motor_constant",), 0.5),
        ("coil_gain_error", ("coil_constant",), 0.5),
        pytest.param("rotor_inertia_error", ("rotor_inertia_z",), 0.5, marks=pytest.mark.study),
        pytest.param("motor_constant_error", ("motor_constant",), 1.3, marks=pytest.mark.study),
    ],
)
def test_a_bench_parameter_that_is_far_off_is_named_alone(
    name: str, parameters: tuple[str, ...], factor: float, tmp_path: Path
) -> None:
    """What the noise of a motion needs is another torque on that machine: it must not be taken for that of a filter."""
    machine = hidden_machine(1, {})
    values = {**machine.values, **{own: factor * BENCH.value(own) for own in parameters}}
    recording = record(tmp_path, "run", replace(machine, values=values), "quick")
    with one_thread():
        found = explained(prepare([recording], Model.new()), [recording], None)
    assert [term.name for term in found.best.terms] == [name]
    assert max(found.problem.noise.scales.values()) < 1.5
    assert found.proposal is None
    error = found.best.standard_error(name, "relative_error")
    value = found.best.coefficients[name]["relative_error"]
    assert value == pytest.approx(factor - 1.0, abs=3.0 * error)
    assert error < 0.02
