"""A change in the middle of a recording that a later recording of the machine may still show."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gyrowheel.show.sentences.findings import event_sentence
from gyrowheel.show.sentences.proof import proof_sentence
from gyrowheel_analysis.diagnosis.dated_changes import DatedEvent
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.event_dating import Found, all_of
from gyrowheel_analysis.diagnosis.events import as_continued, parts_between, with_sizes
from gyrowheel_analysis.diagnosis.proof import prove
from gyrowheel_analysis.fitting.events import Event
from gyrowheel_analysis.fitting.preparation import Prepared, prepare
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.residuals.error_table import errors_of
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import Recording

from .machines import BENCH, hidden_machine, record

PLAN = """
schema: 1
name: grid
title: Two speeds
description: A grid of holds.
hold_s: 1.6
segments:
  - {label: grid, spin_rpm: [3000, 2000], tilt_deg: [[0, 0], [3, 0], [-1.5, 0], [0, 2]]}
"""
SIZE = 1.0e-3  # N m
CHANGE = Found((Event(0, "torque_x", "step", 12.0),), (0.1,), 100.0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    folder, machine = tmp_path_factory.mktemp("stayed"), hidden_machine(14, {})
    return [record(folder, f"run{seed}", machine, Plan.load(PLAN), noise_seed=seed) for seed in (1, 2)]


def pulled(recording: Recording, since: float, size: float = SIZE) -> Recording:
    """Return a recording whose coils hold a further torque from some time on."""
    measurement = recording.measurement.copy()
    measurement["coil_voltage_x"] -= (recording.time > since) * size / BENCH.value("coil_constant")
    return replace(recording, measurement=measurement)


@pytest.fixture(scope="module")
def fitted(recorded: list[Recording]) -> Prepared:
    """Return the recording in which the torque appears, with this event."""
    found = prepare([pulled(recorded[0], 12.0)], Model.new(), harmonics=False)
    return replace(found, problem=found.problem.with_events(all_of([CHANGE])))


@pytest.mark.parametrize(
    ("since", "size", "still", "proven"),
    [
        (0.0, SIZE, True, True),  # recorded after it
        (1e9, SIZE, False, True),  # recorded before it, or it was undone
        (0.0, 3.0 * SIZE, True, False),  # more has changed than what is known
    ],
)
def test_change_that_stayed_is_part_of_the_prediction_where_it_is_still_there(
    recorded: list[Recording], fitted: Prepared, since: float, size: float, still: bool, proven: bool
) -> None:
    later = prepare([pulled(recorded[1], since, size)], Model.new(), harmonics=False)
    fit = fitted.problem.fit(())
    validation = as_continued(later, fitted.problem, fit, [CHANGE])
    assert validation is not None
    both = replace(fitted, validation=validation)
    proof = prove(both, fit, fit, errors_of(fit, fit, both).table)
    assert proof.proven is proven
    (event,) = with_sizes(fitted.problem, fit, [CHANGE], ["first"], validation)
    assert event.still_in == (("run2",) if still else ())
    assert event_sentence(event).endswith("stayed, and is still there in run2." if still else "stayed.")
    given = "given that what changed at 12.0 s is still there (otherwise χ²/N "
    assert (given in proof_sentence(proof)) is still
    if still:
        assert proof.otherwise > proof.chi2_per_n + 0.5
    if proven:
        assert proof.chi2_per_n < 1.5


def test_burst_is_over_in_a_later_recording(recorded: list[Recording], fitted: Prepared) -> None:
    later = prepare([pulled(recorded[1], 0.0)], Model.new(), harmonics=False)
    burst = Found((Event(0, "torque_x", "burst", 12.0, 16.0),), (0.1, 0.1), 100.0)
    problem = fitted.problem.with_events(all_of([burst]))
    assert as_continued(later, problem, problem.fit(()), [burst]) is later


@pytest.fixture(scope="module")
def longer(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    folder, machine = tmp_path_factory.mktemp("longer"), hidden_machine(14, {})
    return [record(folder, f"run{seed}", machine, "quick", noise_seed=seed) for seed in (1, 2, 3, 4)]


@pytest.mark.slow
@pytest.mark.parametrize("size", [SIZE, 2.0 * SIZE])
@pytest.mark.parametrize("later_first", [False, True])
def test_change_that_stayed_is_one_event_of_recordings_that_are_fitted_together(
    longer: list[Recording], later_first: bool, size: float
) -> None:
    """A second change before the second recording is another one."""
    first, second = pulled(longer[0], 25.0), pulled(longer[1], -1.0, size)
    found = diagnose([second, first] if later_first else [first, second], Model.new())
    assert found.verdict == "nothing_missing"
    assert not found.laws
    event, *others = found.events
    assert event.recording == str(first.path)
    assert event.time == pytest.approx(25.0, abs=0.5)
    assert event.still_in == ((second.path.name,) if size == SIZE else ())
    assert [(other.recording, other.time) for other in others] == (
        [] if size == SIZE else [(str(second.path), 0.0)]
    )


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.5 * SIZE, SIZE])
def test_change_stays_in_two_of_four_recordings(longer: list[Recording], size: float) -> None:
    first = pulled(longer[0], 18.0, size)
    later = [pulled(own, -1.0, size) for own in longer[1:3]]
    found = diagnose([longer[3], first, *later], Model.new())
    assert found.verdict == "nothing_missing"
    assert not found.laws
    (event,) = found.events
    assert event.recording == str(first.path)
    assert sorted(event.still_in) == ["run2", "run3"]


@pytest.mark.slow
def test_second_change_of_the_same_quantity_stays_with_the_first(longer: list[Recording]) -> None:
    """At the start of the second recording both are there."""
    first = pulled(pulled(longer[0], 18.0), 30.0)
    found = diagnose([first, pulled(longer[1], -1.0, 2.0 * SIZE)], Model.new())
    assert [round(event.time) for event in found.events] == [18, 30]
    assert [event.still_in for event in found.events] == [("run2",)] * 2


def test_parts_of_recordings_leave_out_a_change_before_the_start() -> None:
    change = DatedEvent("second", 0.0, 0.0, None, None, "step", "torque_x", 1e-3, 1e-5, "N*m", 30.0)
    assert list(parts_between([change])) == ["second"]
    assert event_sentence(change).startswith(
        "From the start there was a torque of 1.000 ± 0.010 mN·m about case x"
    )
