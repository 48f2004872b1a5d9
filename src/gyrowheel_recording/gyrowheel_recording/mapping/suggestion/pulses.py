"""Which column of a table holds pulses of the shaft, and how many there are a turn."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.units import conversion
from gyrowheel_recording.mapping.column_names import TIME, meaning_of
from gyrowheel_recording.mapping.map_file import COUNT, MOST_PULSES, TIMESTAMP
from gyrowheel_recording.mapping.pulses import edges_of_count, edges_of_level, levels
from gyrowheel_recording.mapping.suggestion import SOME, Problem, Proposal, in_si, usual_size, wraps
from gyrowheel_recording.tables import Column, Grid
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

_NAMES: Final = frozenset(
    ["hall", "index", "idx", "pulse", "pulses", "puls", "impuls", "impulse", "trigger", "trig", "marker", "mark",
     "keyphasor", "once", "z", "zero", "opto", "prox", "tach", "tacho", "nullimpuls"]
)  # fmt: skip
_FEWEST: Final = 8  # edges
_AT_LEVELS: Final = 0.9  # part of the samples of pulses that are at one of two levels
_NEAR: Final = 0.1  # part of the height that is at a level
_SWING: Final = 0.2  # least height of pulses, over the level
_WHOLE: Final = 0.05  # part by which the pulses a turn may differ from a whole number
#: Counts a turn of usual encoders, by which part the speed may be off, and over how many turns it is compared.
_COUNTS: Final = sorted(
    {2.0**k for k in range(6, 25)}
    | {m * 10.0**k for k in range(1, 6) for m in (1.0, 1.2, 1.8, 2.0, 2.4, 2.5, 3.6, 4.0, 5.0, 7.2, 8.0)}
    | {4.0 * 360.0, 4.0 * 2500.0, 4.0 * 1250.0}
)
_NEAR_TURN, _NEAR_RANGE = 0.01, 0.03
_NEAR_SPEED: Final = 0.1  # part by which the rate of an angle may differ from the speed
_FEWEST_TURNS: Final = 3.0


def has_levels(column: Column) -> bool:
    """Whether a column is at one of two levels nearly always, and changes between them."""
    if not column.numeric:
        return False
    values = np.asarray(column.values, dtype=np.float64)
    values = values[np.isfinite(values)]
    if len(values) < 2 * _FEWEST:
        return False
    low, high = levels(values)
    # the last digit of a speed that hardly changes goes to and fro, too
    if not high - low > _SWING * max(abs(low), abs(high)):
        return False
    part = (values - low) / (high - low)
    at = float(np.mean((np.abs(part) < _NEAR) | (np.abs(part - 1.0) < _NEAR)))
    return at > _AT_LEVELS and len(edges_of_level(np.arange(float(len(values))), values)) >= _FEWEST


def pulsed_angle(
    grid: Grid, found: Mapping[str, Proposal], taken: Collection[str], problems: list[Problem]
) -> Proposal | None:
    """Return the column by whose pulses the angle is known, if any; doubts are added to `problems`.

    `found` are the other columns, `taken` the names of columns that have another meaning.
    """
    turning = _turning(grid, found)
    best: Proposal | None = None
    for name, column in grid.columns.items():
        if name in taken or not column.numeric:
            continue
        named = bool(_NAMES & set(re.findall(r"[a-z]+", name.lower())))
        counts = named and _counts(column)
        if not (counts or has_levels(column)):
            continue
        pulses = _pulses(column, turning, counts=counts)
        if not (named or pulses):
            continue
        number = round(pulses)
        whole = 1 <= number <= MOST_PULSES and abs(pulses - number) < _WHOLE * number
        if not named and not whole:
            continue
        values = np.asarray(column.values, dtype=np.float64)
        why = f"{number} pulse{'s' * (number > 1)} a turn by the speed" if whole else "it holds pulses"
        said = f"named '{name}'; {why}" if named else why
        own = Proposal(
            "spin_angle", name, COUNT if counts else "", 1.0, said, whole, "",
            float(np.nanmin(values)), float(np.nanmax(values)), number if whole else 1,
        )  # fmt: skip
        # one pulse per turn gives the phase of the rotor; of others the one with the most
        if best is None or (own.stated, own.pulses == 1, own.pulses) > (
            best.stated,
            best.pulses == 1,
            best.pulses,
        ):
            best = own
    if best is not None:
        _told(best, problems)
    return best


def counted_angle(
    own: Proposal, grid: Grid, found: Mapping[str, Proposal], problems: list[Problem]
) -> Proposal:
    """Return the angle of a counter with its counts per turn, where they do not show at a wrap.

    A counter may run on, or wrap after several turns; the speed shows how many counts one turn has. If it does not,
    that is added to `problems`.
    """
    column = grid.columns[own.column]
    values = np.asarray(column.values, dtype=np.float64)
    known = np.isfinite(values)
    counts = values[known]
    stated = meaning_of(column.name, column.unit).unit
    if stated not in ("", COUNT) or len(counts) < 2 or np.any(counts != np.round(counts)):
        return own
    anew = wraps(counts)
    if anew and own.unit != "turn":  # degrees
        return own
    steps, span = np.diff(counts), float(np.ptp(counts))
    on = np.abs(steps) <= 0.5 * span if anew else np.ones(len(steps), dtype=bool)
    turning = _turning(grid, found)
    a_turn = 0.0
    if turning is not None and len(turning[0]) == len(values):
        turned = float(np.diff(turning[1][known])[on].sum())
        a_turn = abs(float(steps[on].sum())) / turned if turned > _FEWEST_TURNS else 0.0
    likely = [
        count for count in _COUNTS if abs(count - a_turn) < (_NEAR_RANGE if anew else _NEAR_TURN) * count
    ]
    likely.sort(key=lambda count: abs(count - a_turn))
    if anew:  # of one that counts several turns, so many of them are its range, of which the last step may be missing
        step = float(np.abs(steps[on]).max(initial=1.0))
        likely = [
            count
            for count in likely
            if (several := math.ceil((span + 1.0) / count)) > 1 and several * count - span - 1.0 <= 1.5 * step
        ]
    if not likely:
        if not anew:
            problems.append(_uncounted(own, a_turn))
        return own
    number = likely[0]
    return replace(
        own, unit="turn", scale=1.0 / number, reason=f"{own.reason}; by the speed {number:g} counts a turn"
    )


def running_angle(own: Proposal, grid: Grid, found: Mapping[str, Proposal], bench: Bench) -> Proposal:
    """Return an angle that runs on, and states no unit, in the first one in which its mean rate is that of a wheel.

    That is the rate of the speed where there is one, else a usual one.
    """
    values = np.asarray(grid.columns[own.column].values, dtype=np.float64)
    seconds = _seconds(grid, found)
    if own.stated or own.unit != "rad" or seconds is None or len(seconds) != len(values):
        return own
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(seconds))
    if len(known) < 2 or wraps(values[known]):
        return own
    low, high = usual_size("spin_rate", bench)
    turning = _turning(grid, found)
    first, last = known[[0, -1]]
    if turning is not None:
        rate = 2.0 * math.pi * float(np.diff(turning[1][[first, last]])[0] / (seconds[last] - seconds[first]))
        low, high = (1.0 - _NEAR_SPEED) * rate, (1.0 + _NEAR_SPEED) * rate
    mean = abs(float(values[last] - values[first])) / float(seconds[last] - seconds[first])
    for unit in ("rad", "turn", "deg"):
        if low <= mean * conversion(unit, "rad")[1] <= high:
            return replace(own, unit=unit, reason=f"{own.reason}; in {unit} its rate is usual")
    return own


def _uncounted(own: Proposal, a_turn: float) -> Problem:
    seen = f"; by the speed they are {a_turn:.6g}" if a_turn else ""
    return Problem(
        f"spin_angle: '{own.column}' counts on, and how many counts there are a turn is not to be seen{seen}.",
        "Set `unit: turn` in the map, and `scale:` to one over the counts a turn.",
    )


def _told(own: Proposal, problems: list[Problem]) -> None:
    if not own.stated:
        problems.append(
            Problem(
                f"spin_angle: '{own.column}' holds pulses, and how many there are a turn is not to be seen.",
                "Set `pulses:` to the edges a turn.",
            )
        )
        return
    if own.pulses == 1:
        cure = "`edge_angle_deg:` in the map is the angle at the pulse; 0 if not given."
    else:
        cure = (
            f"Which of the {own.pulses} is which is not known: what happens a multiple of {own.pulses} times a turn is "
            "compared, and averages. A pulse once a turn shows all."
        )
    problems.append(
        Problem(
            f"spin_angle: known by the pulses in '{own.column}', and summed up from the speed between them.",
            cure,
            asks=False,
        )
    )


def _turning(grid: Grid, found: Mapping[str, Proposal]) -> tuple[Array, Array] | None:
    """Return times [s] and turns by the speed; None without a speed on the map's clock."""
    speed, seconds = found.get("spin_rate"), _seconds(grid, found)
    if speed is None or seconds is None or speed.clock:
        return None
    rate = np.abs(in_si(speed, grid, "rad/s"))
    if len(rate) != len(seconds):
        return None
    known = np.isfinite(rate) & np.isfinite(seconds)
    if known.sum() < 2:
        return None
    rate = np.interp(np.arange(len(rate)), np.flatnonzero(known), rate[known])
    turns = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(seconds))]) / (
        2.0 * math.pi
    )
    return seconds, turns


def _seconds(grid: Grid, found: Mapping[str, Proposal]) -> Array | None:
    """Return the times of the map's clock [s]; None without one."""
    time = found.get(TIME)
    if time is None:
        return None
    times = grid.columns[time.column].values
    if time.unit == TIMESTAMP:
        return np.asarray((times - times[0]).astype("timedelta64[ns]").astype(np.float64) * 1e-9)
    return in_si(time, grid, "s")


def _pulses(column: Column, turning: tuple[Array, Array] | None, *, counts: bool) -> float:
    """Return the pulses per turn; 0 where the speed does not show it."""
    if turning is None or len(turning[0]) != len(column.values):
        return 0.0
    values = np.asarray(column.values, dtype=np.float64)
    seconds, turns = turning
    edges = edges_of_count(seconds, values) if counts else edges_of_level(seconds, values)
    if len(edges) < _FEWEST:
        return 0.0
    steps = np.diff(np.interp(edges.times, seconds, turns))
    # the mean, since each is known to whole samples alone; without those over missed edges
    usual = steps[np.abs(steps / max(float(np.median(steps)), 1e-12) - 1.0) < 0.5]
    return 1.0 / float(np.mean(usual)) if len(usual) else 0.0


def _counts(column: Column) -> bool:
    """Whether a column counts on, by one now and then."""
    values = np.asarray(column.values[: 10 * SOME], dtype=np.float64)
    steps = np.diff(values[np.isfinite(values)])
    if len(steps) < _FEWEST:
        return False
    on = (steps == 0.0) | (steps == 1.0)
    return (
        float(np.mean(on)) > 0.99
        and int(np.count_nonzero(steps == 1.0)) >= _FEWEST
        and float(np.mean(steps)) < 0.5
    )
