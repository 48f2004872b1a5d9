"""Control limits over many recordings: a drift, a step and an outlier are found and dated, nothing else is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gyrowheel_analysis.criteria import TREND_FEWEST
from gyrowheel_analysis.trend import trend

DAY = 86400.0
BEGIN = 1.7e9
SEEDS = range(20)


def table(
    seed: int,
    kind: str = "none",
    *,
    machines: int = 60,
    each: int = 1,
    spread: float = 1.0,
    size: float = 4.0,
) -> list[dict[str, Any]]:
    """Return rows of ten quantities, of one of which something changes by some deviations; a recording a day."""
    rng = np.random.default_rng(seed)
    own = rng.normal(0.0, spread, (10, machines))
    rows = []
    count = machines * each
    for k in range(count):
        row: dict[str, Any] = {
            "recording": f"r{k}", "machine": f"m{k % machines}", "start": BEGIN + DAY * k, "verdict": "effect",
        }  # fmt: skip
        for j in range(10):
            error = float(rng.uniform(0.2, 0.5))
            value = 5.0 + own[j, k % machines] + rng.normal(0.0, error)
            if j == 7:
                value += size * {"drift": k / (count - 1), "step": k >= 0.6 * count, "outlier": k == 20}.get(
                    kind, 0.0
                )
            row |= {f"e{j}.c": value, f"e{j}.c.error": error}
        rows.append(row)
    return rows


@pytest.mark.slow
def test_machines_that_differ_by_chance_raise_no_alarm() -> None:
    """Of a hundred tables one may; machines that differ only by their errors count like those that differ by more."""
    alarms = [bool(trend(table(seed, spread=spread)).departed) for seed in SEEDS for spread in (0.0, 1.0)]
    assert sum(alarms) <= 1


@pytest.mark.parametrize(("kind", "size"), [("drift", 5.0), ("step", 4.0), ("outlier", 11.0)])
def test_a_change_of_one_quantity_is_found_and_dated(kind: str, size: float) -> None:
    right = 0
    for seed in SEEDS:
        found = trend(table(seed, kind, size=size)).departed
        assert {course.name for course in found} <= {"e7.c"}
        if not found or (left := found[0].departure) is None:
            continue
        where = {"drift": range(15, 60), "step": range(34, 39), "outlier": (20,)}[kind]
        right += (
            left.kind == kind and left.first in where and abs(left.size - size) < 5.0 * left.standard_error
        )
    assert right >= 18


def test_a_step_of_one_day_is_found_in_repeated_recordings_of_few_machines() -> None:
    """Machines that differ by far more take turns: what is the same in all of them counts."""
    for seed in range(5):
        rows = table(seed, "step", machines=4, each=12, spread=5.0, size=1.0)
        (course,) = trend(rows).departed
        assert (course.name, course.over) == ("e7.c", "recordings")
        assert course.departure is not None
        assert course.departure.kind == "step"
        assert abs(course.departure.first - 29) <= 2
        assert not trend(table(seed, machines=4, each=12, spread=5.0)).departed


def diagnosed(
    seed: int,
    *,
    count: int = 60,
    machines: int = 60,
    named: bool = True,
    another: bool = False,
    step: float = 0.0,
) -> list[dict[str, Any]]:
    """Return rows as `batch` writes them, of parameters two stated uncertainties away from their stated values.

    The machines take turns and differ by 0.5. Another plan from the middle on has smaller errors, less of which repeat.
    """
    rng = np.random.default_rng(seed)
    later = another & (np.arange(count) >= count / 2)
    error = np.where(later, 0.3, 1.2 if another else 0.4)
    noise = error * np.where(later, 0.6, 0.2)
    prior, of = 1.0, np.arange(count) % machines
    rows: list[dict[str, Any]] = [
        {"recording": f"r{k}", "machine": f"m{of[k]}" if named else "", "start": BEGIN + DAY * k}
        for k in range(count)
    ]
    for j in range(10):
        own, constants = rng.normal(0.0, 0.5, machines), rng.normal(0.0, 1.0, machines)
        data = 2.0 + own[of] + constants[of] * np.sqrt(error**2 - noise**2) + rng.normal(0.0, noise)
        data += step * (j == 7) * (np.arange(count) >= 0.6 * count)
        variance = 1.0 / (error**-2 + prior**-2)
        for k, row in enumerate(rows):
            row |= {
                f"e{j}": variance[k] * data[k] / error[k] ** 2, f"e{j}.error": variance[k] ** 0.5,
                f"e{j}.data": data[k], f"e{j}.data_error": error[k], f"e{j}.data_scatter": noise[k],
            }  # fmt: skip
    return rows


@pytest.mark.parametrize("another", [False, True])
@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("machines", [1, 4, pytest.param(30, marks=pytest.mark.study), 60])
def test_priors_other_plans_and_repeated_recordings_raise_no_alarm(
    machines: int, named: bool, another: bool
) -> None:
    """Of twenty tables one may. Unnamed recordings may be of one machine or of many."""
    alarms = [
        bool(trend(diagnosed(seed, machines=machines, named=named, another=another)).departed)
        for seed in SEEDS
    ]
    assert sum(alarms) <= 1


def test_a_step_between_the_recordings_of_two_machines_is_not_one_of_recordings() -> None:
    """The machines are recorded one after the other; what they differ by is subtracted."""
    for seed in SEEDS:
        rows = diagnosed(seed, machines=6)
        for k, row in enumerate(rows):
            row["start"] = BEGIN + DAY * (k // 6 + 10 * (k % 6))
        assert not trend(rows).departed


def test_what_repeats_in_a_machine_is_not_in_the_limits_of_its_recordings() -> None:
    """The step is as large as the whole error of one value, and five times as large as what is new in it."""
    right = 0
    for seed in SEEDS:
        found = [(c.name, c.over, c.departure) for c in trend(diagnosed(seed, machines=4, step=0.4)).departed]
        right += [own[:2] for own in found] == [("e7", "recordings")] and all(
            left is not None and left.kind == "step" and abs(left.first - 36) <= 2 for *_, left in found
        )
    assert right >= 18


def test_a_recording_that_names_no_machine_is_one() -> None:
    rows = diagnosed(1, machines=1, named=False)
    course = trend(rows).courses[0]
    assert (course.over, len(course.value), set(course.machines)) == ("machines", 60, {""})
    assert course.standard_error == pytest.approx(np.full(60, 0.4))
    named = trend(diagnosed(1, machines=1)).courses[0]
    assert (named.over, named.machines[:1]) == ("recordings", ("m0",))
    assert named.standard_error == pytest.approx(np.full(60, 0.08))


def test_the_versions_that_diagnosed_a_table_are_counted() -> None:
    rows = table(3)
    assert trend(rows).versions == 1
    assert trend([row | {"version": str(k % 2)} for k, row in enumerate(rows)]).versions == 2


def test_the_order_of_rows_does_not_matter() -> None:
    rows = table(1, "drift")
    one, other = trend(rows), trend(rows[::-1])
    for left, right in zip(one.courses, other.courses, strict=True):
        assert (left.name, left.departure) == (right.name, right.departure)
        assert np.array_equal(left.value, right.value)


def test_what_is_missing_or_not_dated_is_left_out() -> None:
    rows = table(2)
    for k, row in enumerate(rows):
        if k >= TREND_FEWEST - 1:
            del row["e0.c"], row["e0.c.error"]
        if k % 2:
            row["e1.c"] = None
    rows[5] |= {"start": None, "e2.c": 1e9}
    rows[6] |= {"e3.c": float("nan")}
    rows[7] |= {"e3.c.error": 0.0}
    found = trend(rows)
    assert found.few == ("e0.c",)
    lengths = {course.name: len(course.value) for course in found.courses}
    assert (lengths["e1.c"], lengths["e2.c"], lengths["e3.c"], lengths["e4.c"]) == (30, 59, 57, 59)
    assert not found.departed


def test_equal_values_are_within_their_limits() -> None:
    rows = [
        {"recording": f"r{k}", "machine": "", "start": BEGIN, "R": 2.5, "R.error": 0.1} for k in range(20)
    ]
    (course,) = trend(rows).courses
    assert course.departure is None
    low, high = course.limits
    assert (low <= 2.5).all()
    assert (high >= 2.5).all()
    assert not trend(rows[: TREND_FEWEST - 1]).courses
    assert not trend([]).courses
