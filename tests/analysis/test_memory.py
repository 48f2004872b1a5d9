"""Laws with a memory in the analysis: the motion between windows, the states along it, and their fit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.balance.history import History, course_of
from gyrowheel_analysis.balance.motion import NODES
from gyrowheel_analysis.channels import DRIFTS
from gyrowheel_analysis.criteria import ACCEPTED_GAIN
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.experiment_design import detection_limits
from gyrowheel_analysis.fitting.fit import ERRORS, Term, Unknowns
from gyrowheel_analysis.fitting.preparation import prepare, samples_of
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.samples import Array, Samples
from gyrowheel_analysis.reduction.segmentation import planned_windows, reduce
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect, physical, registry, remembering
from gyrowheel_sim.effects.user_defined_line import typed_effect
from gyrowheel_sim.plant.scenario import Scenario

from .machines import hidden_machine, record

BENCH = Bench.load()
PHASES = np.arange(12) * (2.0 * math.pi / 12)
LAG = typed_effect("lag: -k*s; d(s)/dt = (z - s)/tau; s(0) = z; tau = 3 +- 2 [s]; k = 0.02 [N*m/rad]")
CABLE = typed_effect(
    "cable: -F*s; d(s)/dt = (z_rate - s*abs(z_rate))/b; b = 0.03 +- 0.01 [rad]; F = 0.001 [N*m]"
)
RUN_IN = typed_effect(
    "run_in: shaft_torque = -f*q; d(q)/dt = -q*r/w; q(0) = 1; q [1]; w = 30 +- 15 [s]; f = 0.001 [N*m]"
)


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Samples:
    return samples_of(record(tmp_path_factory.mktemp("run"), "run", hidden_machine(4, {}), "check"))


@pytest.fixture(scope="module")
def windows(samples: Samples) -> Windows:
    return reduce(samples, BENCH)


def test_the_course_follows_the_rotor_within_and_between_windows(samples: Samples, windows: Windows) -> None:
    course = course_of(windows, BENCH, samples)
    time = course.start + course.step * np.arange(len(course.points))
    read = np.column_stack([np.interp(time, samples.time, samples.readings[n]) for n in ("tilt_x", "tilt_y")])
    off = np.abs(np.tan(read) - course.points[:, :2])
    inside = np.zeros(len(time), dtype=bool)
    for start, length in zip(windows.start, windows.duration, strict=True):
        inside |= (time > start) & (time < start + length)
    assert 0.3 < inside.mean() < 0.95
    assert np.sqrt(np.mean(off[inside] ** 2)) < 3.0e-5  # the noise of a reading is 2e-5
    assert off.max() < 0.004  # between them it is averaged over a revolution, in which a ramp moves on
    assert np.sqrt(np.mean(off[~inside] ** 2)) < 5.0e-4
    # a rate that counts every movement must sum up to the tilt
    summed = np.cumsum(course.points[:, 2:4].astype(float), axis=0) * course.step
    assert np.abs(summed - (course.points[:, :2] - course.points[0, :2])).max() < 0.003


def test_motion_below_the_noise_has_its_true_size(samples: Samples, windows: Windows) -> None:
    """The noise of the readings, differentiated, would wind a friction round; the rotor does move a little."""
    course = course_of(windows, BENCH, samples)
    upright = np.flatnonzero(np.abs(windows.mean_tilt) < 1e-3)
    assert len(upright)
    for row in upright:
        own = slice(
            course.place(windows.start[row]), course.place(windows.start[row] + windows.duration[row])
        )
        # 3.2e-3 in the simulation of a hold at 3500 rpm, 1.1e-3 at 1500 rpm; the noise is 0.06
        expected = 3.2e-3 * (windows.mean_spin[row] / 366.5) ** 1.25
        assert np.abs(course.points[own, 2] + 1j * course.points[own, 3]).mean() == pytest.approx(
            expected, rel=0.25
        )


def test_states_follow_their_rate_along_the_course(samples: Samples, windows: Windows) -> None:
    """Against the exact answer of a first-order lag, point by point."""
    history = History(windows, BENCH, samples)
    found = history.states(LAG, LAG.defaults(), NODES, PHASES)["s"].mean(axis=2)
    course = history.course
    tilt = course.points[:, 0] + 1j * course.points[:, 1].astype(float)
    s, along = complex(tilt[0]), []
    left = math.exp(-course.step / 3.0)
    for before, after in itertools.pairwise(tilt):
        along.append(s)
        s = left * s + (1.0 - left) * 0.5 * (before + after)
    time = windows.middle[:, None] + 0.5 * windows.duration[:, None] * NODES
    wanted = np.interp(time, course.start + course.step * np.arange(len(along)), np.array(along))
    assert np.abs(wanted).max() > 0.02
    assert np.abs(found - wanted).max() < 2.0e-4


def test_states_that_follow_swift_motion_are_integrated_at_every_sample(
    samples: Samples, windows: Windows
) -> None:
    """Also where the same law was slow before: only a slow state may be integrated in longer steps."""
    history = History(windows, BENCH, samples)
    course = history.course
    points = course.points.astype(float)
    tilt, rate = points[:, 0] + 1j * points[:, 1], points[:, 2] + 1j * points[:, 3]
    history.states(LAG, LAG.defaults(), NODES, PHASES)

    def wanted(start: complex, rates: Callable[[complex, int], complex]) -> Array:
        s, along = start, []
        for k in range(len(points)):
            along.append(s)
            if k + 1 < len(points):
                first = rates(s, k)
                s = s + 0.5 * course.step * (first + rates(s + course.step * first, k + 1))
        time = windows.middle[:, None] + 0.5 * windows.duration[:, None] * NODES
        return np.interp(time, course.start + course.step * np.arange(len(along)), np.array(along))

    swift = LAG.defaults() | {"tau": 0.004}
    found = history.states(LAG, swift, NODES, PHASES)["s"].mean(axis=2)
    assert np.abs(found - wanted(complex(tilt[0]), lambda s, k: (tilt[k] - s) / 0.004)).max() < 5.0e-4
    found = history.states(CABLE, CABLE.defaults(), NODES, PHASES)["s"].mean(axis=2)
    exact = wanted(0.0, lambda s, k: (rate[k] - s * abs(rate[k])) / 0.03)
    assert np.abs(found - exact).max() < 4.0e-3  # 0.009 off at one in eight samples


def test_a_plan_that_was_never_run_has_a_history_too() -> None:
    windows = planned_windows(Plan.load("quick"), BENCH)
    found = History(windows, BENCH).states(LAG, LAG.defaults(), NODES, PHASES)["s"]
    assert found.shape == (len(windows), len(NODES), len(PHASES))
    assert 0.01 < np.abs(found).max() < 0.07


@pytest.mark.parametrize("missing", [(4.0, 9.0), (0.0, 3.0)])
def test_a_state_goes_on_through_a_pause(samples: Samples, missing: tuple[float, float]) -> None:
    kept = (samples.time < missing[0]) | (samples.time > missing[1])
    assert samples.sequence is not None
    fewer = replace(
        samples, time=samples.time[kept], readings=samples.readings[kept], sequence=samples.sequence[kept],
        commanded=None,
    )  # fmt: skip
    windows = reduce(fewer, BENCH)
    found = History(windows, BENCH, fewer).states(LAG, LAG.defaults(), NODES, PHASES)["s"]
    assert np.isfinite(found).all()
    # long after the pause nothing is left of what happened in it
    whole = reduce(samples, BENCH)
    before = History(whole, BENCH, samples).states(LAG, LAG.defaults(), NODES, PHASES)["s"]
    assert np.abs(found[-1] - before[-1]).max() < 5.0e-4


def test_the_derivative_by_an_amplitude_is_the_state(samples: Samples, windows: Windows) -> None:
    balance = Balance(windows, BENCH, history=History(windows, BENCH, samples))
    values = BENCH.values()
    at = balance.instants(values, [])
    quick = balance.changed(at, values, LAG, None, LAG.defaults())
    whole = balance.predicted(values, [ActiveEffect(LAG, LAG.defaults())])
    assert quick is not None
    assert np.abs(quick - whole).max() < 1.0e-3 * np.abs(whole - balance.rows_at(at, values)).max()
    state = balance.motion.remembered(LAG, LAG.defaults())["s"].mean(axis=(1, 2))
    added = (whole - balance.rows_at(at, values))[balance.row("tilt_x")]
    assert added == pytest.approx(LAG.defaults()["k"] * state.real, abs=2.0e-6)


@pytest.fixture(scope="module")
def remembered(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """Return recordings of a machine with two laws that were typed; they are compiled for it."""
    folder: Path = tmp_path_factory.mktemp("memory")
    machine = hidden_machine(6, {})
    effects = (CABLE, RUN_IN)
    machine = Scenario(
        machine.values,
        {e.name: e.defaults() for e in effects},
        machine.noise_seed,
        {e.name: e for e in effects},
    )
    return {plan: record(folder, plan, machine, plan) for plan in ("quick", "check")}


@pytest.mark.slow
def test_typed_laws_with_a_memory_are_fitted_and_hold_on_unused_data(
    remembered: dict[str, Recording], tmp_path: Path
) -> None:
    """Hidden in the compiled plant, found lacking, fitted, written, read again, and judged on another recording."""
    ready = prepare([remembered["quick"]], Model.new(), validate=[remembered["check"]])
    terms = [Term(effect.name, effect) for effect in (CABLE, RUN_IN)]
    without, found = ready.problem.fit(()), ready.problem.fit(terms)
    assert without.chi2 - found.chi2 > 300.0
    for effect in (CABLE, RUN_IN):
        for name, true in effect.defaults().items():
            error = max(
                found.standard_error(effect.name, name), 0.01 * true
            )  # of what the rotor moves below the noise the size alone is known
            assert abs(found.coefficients[effect.name][name] - true) < 4.0 * error, name
    model = replace(
        Model.new(),
        effects={e.name: found.coefficients[e.name] for e in (CABLE, RUN_IN)},
        effect_errors={
            e.name: {c.name: found.standard_error(e.name, c.name) for c in e.coefficients}
            for e in (CABLE, RUN_IN)
        },
        declared={e.name: e for e in (CABLE, RUN_IN)},
    )
    model.save(tmp_path / "model.yaml")
    again = Model.load(tmp_path / "model.yaml")
    assert again.declared["cable"].states == CABLE.states
    unused = prepare([remembered["check"]], again).problem
    bare = prepare([remembered["check"]], Model.new()).problem
    for problem, good in ((unused, True), (bare, False)):
        fit = problem.fit(())
        white = problem.noise.whiten(fit.residual)
        assert (float(white @ white) / len(white) < 1.44) == good


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "state"),
    [
        pytest.param(
            "drawn: i*F*s; d(s)/dt = (z_rate - s*abs(z_rate))/b; b = 0.02 +- 0.01 [rad]; F = 4e-4 [N*m]",
            "z_rate",
            id="a torque across the motion",
            marks=pytest.mark.study,  # as long as ten others
        ),
        pytest.param(
            "warm: shaft_torque = -f*m; d(m)/dt = (r^2 - m)/tau; m(0) = 0; m [1]; tau = 6 +- 3 [s]; f = 0.002 [N*m]",
            "Omega",
            id="a torque on the spin that lags",
            marks=pytest.mark.study,
        ),
        pytest.param(
            "bent: (1 + 0.8*i)*F*s; d(s)/dt = (abs(z)/z_ref - s)/tau; tau = 7 +- 3 [s]; F = 1e-3 [N*m]",
            "z",
            id="a torque in a fixed direction that lags behind the tilt",
        ),
    ],
)
def test_an_unknown_law_with_a_memory_is_proposed_with_its_state_and_predicts_unused_data(
    line: str, state: str, tmp_path: Path
) -> None:
    """No effect of the library has it, and no event or larger drift stands for it."""
    law = typed_effect(line)
    machine = hidden_machine(8, {})
    machine = Scenario(machine.values, {law.name: law.defaults()}, machine.noise_seed, {law.name: law})
    run, unused = (record(tmp_path, plan, machine, plan) for plan in ("quick", "check"))
    found = diagnose([run], Model.new(), validate=[unused])
    assert found.verdict == "unknown"
    assert not found.events
    (form,) = found.free_form
    proposed = typed_effect(form.formula, name="proposed")
    (own,) = proposed.states
    names = {symbol.name for symbol in own.rate.free_symbols}
    assert state in names
    assert found.proof is not None
    assert found.proof.proven
    assert found.error is not None
    assert found.error.validation_before is not None
    assert found.error.validation_after is not None
    assert found.error.validation_before.chi2_per_n > 1.5
    assert found.error.validation_after.chi2_per_n < 1.44  # 1.2 noise floors


def test_what_holds_move_unseen_relaxes_a_friction_and_is_no_damping(tmp_path: Path) -> None:
    """Without that motion the friction is a sixth too small, and a damping gains more than 100 next to it."""
    true = {"F": 0.002, "b": 0.02}
    machine = hidden_machine(1, {"cable_friction": true})
    problem = prepare(
        [record(tmp_path, "run", machine, "quick")], Model.new(), drift_scales=dict.fromkeys(DRIFTS, 1.0)
    ).problem
    cable = Term("cable_friction", registry()["cable_friction"])
    damping = Term("external_damping", registry()["external_damping"])
    found = problem.fit([cable])
    assert found.coefficients["cable_friction"] == pytest.approx(true, rel=0.025)
    assert found.chi2 - problem.fit([cable, damping], found).chi2 < ACCEPTED_GAIN


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "size", "time", "plan", "tied"),
    [
        pytest.param(331, 0.001, 3.0, "quick", set(), id="a look-alike suffices"),
        pytest.param(330, 0.0015, 3.0, "quick", set(), id="two look-alikes suffice", marks=pytest.mark.study),
        pytest.param(318, 0.0003, 4.0, "survey", {"coil_heating"}, id="tied", marks=pytest.mark.study),
    ],
)
def test_a_law_with_a_memory_is_compared_with_the_effects_that_it_resembles(
    seed: int, size: float, time: float, plan: str, tied: set[str], tmp_path: Path
) -> None:
    """Its time is a twentieth of the usual one: a fit from there would end in another minimum."""
    machine = hidden_machine(seed, {"magnet_warming": {"a": size, "tau": time}})
    found = diagnose([record(tmp_path, "run", machine, plan)], Model.new())
    assert [effect.name for effect in found.effects] == ["magnet_warming"]
    assert {tie.name for tie in found.effects[0].ties} == tied
    a = found.effects[0].coefficients["a"]
    assert abs(a.value - size) < 3.0 * a.standard_error


@pytest.mark.study  # test_discovery.py finds it of another size
@pytest.mark.slow
def test_the_remanence_of_coils_is_no_damping(tmp_path: Path) -> None:
    """In a cone, what lags behind the voltages lies across the tilt, as the torque of a damping does."""
    machine = hidden_machine(141, {"coil_remanence": {"k": 2.0e-4, "tau": 5.0}})
    found = diagnose([record(tmp_path, "run", machine, "quick")], Model.new())
    assert [effect.name for effect in found.effects] == ["coil_remanence"]
    for name, true in (("k", 2.0e-4), ("tau", 5.0)):
        own = found.effects[0].coefficients[name]
        assert abs(own.value - true) < 3.0 * own.standard_error, name


def test_recordings_without_coil_voltages_have_a_history_too(samples: Samples, windows: Windows) -> None:
    readings = samples.readings.copy()
    for name in ("coil_voltage_x", "coil_voltage_y"):
        readings[name][:] = math.nan
    absent = frozenset({"coil_voltage_x", "coil_voltage_y"})
    course = course_of(windows, BENCH, replace(samples, readings=readings, absent=absent, commanded=None))
    assert np.isfinite(course.points).all()


def test_a_law_with_a_memory_has_a_detection_limit(samples: Samples, windows: Windows) -> None:
    """It is that along the whole motion."""
    problem = Problem.of([Balance(windows, BENCH, history=History(windows, BENCH, samples))], BENCH)
    fit = problem.fit(())
    limits = {own.effect: own.value for own in detection_limits(problem, fit, 1.0)}
    basis = problem.basis(fit)
    for name, effect in remembering().items():
        own = problem.term_jacobian(Term(name, effect), fit, Term(name, effect).amplitudes)
        column = np.vstack([problem.noise.whiten(own), np.zeros((len(fit.pull), 1))])
        column = column - basis @ (basis.T @ column)
        assert limits[name] == pytest.approx(math.sqrt(ACCEPTED_GAIN) / np.linalg.norm(column), rel=1e-9), (
            name
        )


def test_effects_with_a_memory_are_tried_only_where_something_is_left(
    samples: Samples, windows: Windows
) -> None:
    """With nothing hidden no law of them is evaluated, so that they cost nothing."""
    problem = Problem.of([Balance(windows, BENCH, history=History(windows, BENCH, samples))], BENCH)
    names = set(remembering())
    assert names
    assert not names & set(physical())
    assert not names & {term.name for term in problem.unknowns.candidates()}
    more = problem.with_memory()
    assert names <= {term.name for term in more.unknowns.candidates()}
    assert not names & {term.name for term in problem.unknowns.candidates()}
    plain, wider = (own.prediction.candidate_columns.shape[1] for own in (problem, more))
    amplitudes = sum(len(effect.amplitudes) for effect in remembering().values())
    assert wider == plain + amplitudes
    assert problem.prediction.candidate_columns.shape[1] == plain


def test_an_effect_of_the_model_with_a_memory_may_be_wrong_in_it() -> None:
    known = {"cable_friction": remembering()["cable_friction"].defaults()}
    assert [t.name for t in Unknowns(BENCH, known).candidates() if t.effect and t.effect.states] == [
        "cable_friction"
    ]


@pytest.mark.parametrize("effect", remembering().values(), ids=remembering())
def test_each_shipped_memory_names_its_look_alikes_and_the_test_that_separates_them(effect: Effect) -> None:
    assert effect.look_alikes
    assert all(name in registry() or name in ERRORS for name in effect.look_alikes)
    assert all(len(text.split()) > 3 for text in effect.look_alikes.values())
    assert all(c.source for c in effect.coefficients)
