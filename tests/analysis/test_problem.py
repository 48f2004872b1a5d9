"""A fit problem: what is evaluated does not change it, and another noise makes another problem."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.criteria import FEWEST_WINDOWS
from gyrowheel_analysis.diagnosis import experiment_design
from gyrowheel_analysis.diagnosis.free_forms import forms
from gyrowheel_analysis.diagnosis.selection import rank
from gyrowheel_analysis.fitting.fit import Term
from gyrowheel_analysis.fitting.preparation import TooFewWindowsError, prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.segmentation import planned_windows
from gyrowheel_analysis.residuals.error_table import errors_of
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import cache
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
    problem.term_jacobian(form, null)
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


def test_other_unknowns_have_the_columns_of_their_own_candidates(recording: Recording) -> None:
    """A map is tried next to laws with a memory, too, and its model may have none."""
    problem = prepare([recording], Model(BENCH)).problem
    remembering = problem.with_memory()
    plain = problem.prediction.candidate_columns
    assert remembering.prediction.candidate_columns.shape[1] > plain.shape[1]
    again = remembering.for_unknowns(problem.unknowns).prediction.candidate_columns
    np.testing.assert_array_equal(again, plain)


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


def test_the_same_fit_is_made_once(recording: Recording) -> None:
    problem = prepare([recording], Model(BENCH)).problem
    null, term = problem.fit(()), problem.unknowns.term("aero_cross")
    assert problem.fit(()) is null
    found = problem.fit([term], null)
    assert problem.fit([term], null) is found
    # from another start, or by another noise, it is another fit
    assert problem.fit([term]) is not found
    louder = problem.with_scales({name: 3.0 * scale for name, scale in problem.noise.scales.items()})
    assert louder.fit([term], null) is not found


def test_terms_are_ranked_by_their_gain_at_the_fit(recording: Recording) -> None:
    problem = prepare([recording], Model(BENCH)).problem
    fit = problem.fit(())
    ranked = rank(problem, fit, problem.unknowns.candidates())
    assert [gain for gain, _ in ranked] == sorted((gain for gain, _ in ranked), reverse=True)
    assert ranked[0][1].name == "aero_cross"
    # the gain of the best by the definition: with its derivatives among the unknowns
    white = np.concatenate([problem.noise.whiten(fit.residual), -fit.pull])
    unknowns = [np.vstack([problem.noise.whiten(fit.jacobian), np.eye(problem.count)])]
    left = []
    for own in ([], [problem.term_jacobian(ranked[0][1], fit, ["c"])]):
        columns = [np.vstack([problem.noise.whiten(c), np.zeros((problem.count, c.shape[1]))]) for c in own]
        design = np.hstack([*unknowns, *columns])
        design /= np.linalg.norm(design, axis=0)
        step, *_ = np.linalg.lstsq(design, white, rcond=1e-12)
        left.append(float(np.sum((white - design @ step) ** 2)))
    assert ranked[0][0] == pytest.approx(left[0] - left[1], rel=1e-6)


def test_a_plan_that_is_kept_gives_the_same_test(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "cache"))
    problem = prepare([recording], Model(BENCH)).problem
    fit, found = problem.fit(()), []
    for _ in range(2):
        experiment_design._planned.cache_clear()
        other = experiment_design.planned(problem, "paper_speed")
        assert other is not None
        at = other[0].predict(fit)
        found.append(b"".join(a.tobytes() for a in (at, other[0].base, other[0].jacobian(fit))))
    experiment_design._planned.cache_clear()
    cache._folder.cache_clear()
    assert found[0] == found[1]
    assert len([entry for entry in (tmp_path / "cache").iterdir() if entry.name.startswith("plan_")]) == 1


def test_too_few_windows_are_refused_with_the_reason(tmp_path: Path) -> None:
    text = "schema: 1\nname: few\nhold_s: 1.0\nsegments:\n  - {spin_rpm: [1500], tilt_deg: [[0, 0]]}\n"
    few = record(tmp_path, "few", hidden_machine(1, {}), Plan.load(text))
    with pytest.raises(
        TooFewWindowsError, match=f"few: . steady windows; at least {FEWEST_WINDOWS}"
    ) as error:
        prepare([few], Model(BENCH))
    assert error.value.windows < FEWEST_WINDOWS
    assert error.value.coverage.recorded > 0.0


@pytest.mark.slow
def test_torque_of_motion_below_the_noise_is_that_of_the_early_reading_that_was_found(tmp_path: Path) -> None:
    """A loop that damps well leaves a tilt twice a revolution in which the noise hides what an early reading turns."""
    early = {"tilt_delay": {"d": -4.5e-4}}
    machine = hidden_machine(5, early)
    loud = {**machine.values, "tilt_noise": 1.4 * BENCH.value("tilt_noise")}
    gains = replace(BENCH.gains, nutation_damping=0.2)
    recording = record(tmp_path, "run", replace(machine, values=loud), "cone", gains=gains)
    prepared = prepare([recording], Model(BENCH))
    problem = prepared.problem
    fit = problem.fit([problem.unknowns.term("tilt_delay")])
    point = problem.unknowns.stated(early)
    truth = np.concatenate(
        [
            b.cleared(problem.unknowns.values(point), problem.unknowns.effects(point)).measured
            for b in problem.balances
        ]
    )

    def missed(problem: Problem) -> float:
        """By how much the measured rows miss those of the true reading [chi-squared]."""
        white = problem.noise.whiten(problem.measured - truth)
        return float(white @ white)

    assert missed(problem) > 50.0
    assert missed(prepared.reweighed(fit).problem) < 0.1 * missed(problem)


@pytest.mark.slow
def test_an_instrument_is_ranked_by_its_gain_next_to_another_one_that_was_found(tmp_path: Path) -> None:
    """Late tilts and early voltages turn the same torques: what is left next to one delay is small."""
    hidden = {"tilt_delay": {"d": 4.8e-4}, "coil_voltage_delay": {"d": -2.0e-4}}
    problem = prepare([record(tmp_path, "run", hidden_machine(21, hidden), "quick")], Model(BENCH)).problem
    late, early = (problem.unknowns.term(name) for name in hidden)
    fit = problem.fit([late])
    gains = {term: gain for gain, term in rank(problem, fit, [early, problem.unknowns.term("aero_cross")])}
    gained = fit.chi2 - problem.fit([late, early], fit).chi2
    assert gained > 40.0
    assert gains[early] == pytest.approx(gained, rel=0.2)
