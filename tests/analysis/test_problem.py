"""A fit problem: what is evaluated does not change it, and another noise makes another problem."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.criteria import FEWEST_WINDOWS
from gyrowheel_analysis.diagnosis.unknown import forms
from gyrowheel_analysis.fitting.fit import Term
from gyrowheel_analysis.fitting.preparation import TooFewWindowsError, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.segmentation import planned_windows
from gyrowheel_analysis.residuals.error_table import errors_of
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import Recording

from .machines import BENCH, hidden_machine, record

SHORT = """
schema: 1
name: short
hold_s: 1.0
segments:
  - {spin_rpm: [1500, 2500], tilt_deg: [[0, 0], [3, 0], [0, 3], [-2, -2]]}
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    machine = hidden_machine(6, {"aero_cross": {"c": 0.0055, "n": 1.98}})
    return record(tmp_path_factory.mktemp("problem"), "run", machine, Plan.load(SHORT))


def state(problem: Problem) -> list[Any]:
    """Return all that must stay."""
    return [
        set(problem.unknowns.library),
        problem.measured.copy(),
        problem.base.copy(),
        problem.base_jacobian.copy(),
        problem.noise.deviation(),
        dict(problem.noise.scales),
    ]


def same(one: list[Any], other: list[Any]) -> bool:
    return all(
        np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in zip(one, other, strict=True)
    )


def test_evaluation_has_no_side_effects(recording: Recording) -> None:
    prepared = prepare([recording], Model(BENCH), validate=[recording])
    problem, validation = prepared.problem, prepared.validation
    assert validation is not None
    before, other = state(problem), state(validation.problem)
    form = next(t for t in forms() if t.name not in problem.unknowns.library)
    null = problem.fit(())
    problem.term_jacobian(form, null, problem.predict(null))
    fit = problem.refined(problem.fit([problem.unknowns.term("aero_cross"), form]))
    problem.evidence(fit)
    problem.fit_within()
    errors = errors_of(null, fit, prepared)
    assert errors.table.validation_after is not None
    assert same(state(problem), before)
    assert same(state(validation.problem), other)
    # the prediction of a foreign form needs its declaration, and says so by what it predicts
    assert form.name in {active.effect.name for active in problem.unknowns.effects(fit)}
    assert not np.array_equal(problem.predict(fit), problem.predict(replace(fit.point, terms=fit.terms[:1])))


def test_changing_the_noise_returns_another_problem(recording: Recording) -> None:
    prepared = prepare([recording], Model(BENCH), validate=[recording])
    problem = prepared.problem
    before = state(problem)
    fit = problem.fit(())
    assert prepared.reweighed(fit) is prepared
    # a rotor a quarter off has another noise twice a revolution
    error = Term("rotor_inertia_error")
    far = problem.fit([error])
    far = replace(far, coefficients={error.name: {"relative_error": -0.25}})
    reweighed = prepared.reweighed(far)
    assert reweighed is not prepared
    assert reweighed.problem is not problem
    assert reweighed.validation is not prepared.validation
    assert same(state(problem), before)
    assert not np.array_equal(reweighed.problem.noise.deviation(), problem.noise.deviation())
    # what is predicted stays
    assert np.array_equal(reweighed.problem.predict(fit), problem.predict(fit))


def test_two_forms_of_one_name_are_not_confused() -> None:
    problem = Problem.of([Balance(planned_windows(Plan.load("quick"), BENCH), BENCH)], BENCH)
    rows = []
    for kind in ("spin_power_1", "axial_power_1"):
        effect = next(t.effect for t in forms() if t.name == kind)
        assert effect is not None
        term = Term("form", replace(effect, name="form"))
        stated = problem.unknowns.stated({"form": {"a": 1e-3, "q": 1.0}})
        rows.append(problem.predict(replace(stated, terms=(term,))))
    assert not np.array_equal(rows[0], rows[1])


def test_too_few_windows_are_refused_with_the_reason(tmp_path: Path) -> None:
    text = "schema: 1\nname: few\nhold_s: 1.0\nsegments:\n  - {spin_rpm: [1500], tilt_deg: [[0, 0]]}\n"
    few = record(tmp_path, "few", hidden_machine(1, {}), Plan.load(text))
    with pytest.raises(
        TooFewWindowsError, match=f"few: . steady windows; at least {FEWEST_WINDOWS}"
    ) as error:
        prepare([few], Model(BENCH))
    assert error.value.windows < FEWEST_WINDOWS
    assert error.value.coverage.recorded > 0.0
