"""Events in recordings: found, dated, and made part of the fit, so that no effect is invented to explain them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gyrowheel_analysis.criteria import (
    DRIFT_HIDES,
    DRIFT_SCALE_BOUNDS,
    EVENT_GAIN,
    EVENT_LACK,
    EVENT_SAME,
    PREDICTING_GAIN,
    SAME_SIZE,
)
from gyrowheel_analysis.diagnosis.dated_changes import DatedEvent, DriftShape, MissingLaw
from gyrowheel_analysis.diagnosis.event_dating import Found, all_of, periods_about
from gyrowheel_analysis.diagnosis.event_scan import PHASES, chance
from gyrowheel_analysis.diagnosis.event_search import find, search_events
from gyrowheel_analysis.diagnosis.evidence import Array
from gyrowheel_analysis.diagnosis.motion_laws import MotionLaw, rows_of
from gyrowheel_analysis.diagnosis.proof import lack_of_fit, predictive_cost, sizes_elsewhere
from gyrowheel_analysis.diagnosis.selection import Progress, Selection, select
from gyrowheel_analysis.diagnosis.unknown import Proposal, search
from gyrowheel_analysis.fitting.events import (
    BEFORE,
    HAPPENS,
    QUANTITIES,
    STAYS,
    TEMPERATURES,
    Event,
    event_columns,
    per_kelvin,
    temperature,
    unit_rows,
)
from gyrowheel_analysis.fitting.fit import Fit, Term
from gyrowheel_analysis.fitting.preparation import Prepared
from gyrowheel_analysis.fitting.problem import Problem, Stayed
from gyrowheel_recording.bags import Recording, parted

_ROUNDS = 3  # of selecting effects given events and searching events given effects
_HOPELESS = 5.0  # times the accepted lack of fit, after which events are given up


@dataclass(frozen=True)
class Outcome:
    """The explanation of recordings: effects given the events, and a free form if there is one.

    `problem` has the events, their contribution subtracted from the measured rows; they are in order of recording and
    time. `laws` are functions of the motion that looked like events.
    """

    problem: Problem
    selection: Selection
    proposal: Proposal | None
    events: list[Found]
    laws: tuple[MotionLaw, ...] = ()

    @property
    def fit(self) -> Fit:
        """The fit with the free form, or with the effects."""
        return self.proposal.fit if self.proposal else self.selection.best

    @property
    def evidence(self) -> float:
        """Minus twice the log likelihood, with the price of the events."""
        return self.problem.evidence(self.fit) + EVENT_GAIN * len(self.events)


def explain(
    problem: Problem,
    selection: Selection,
    recordings: Sequence[Recording],
    progress: Progress | None = None,
    among: Sequence[Term] | None = None,
) -> Outcome:
    """Search for events, and for effects or a free form given these events.

    Events are accepted if they, with the effects found given them, make the recordings likelier than effects and a free
    form do without events, and leave little unexplained. `problem` and `selection` are without events; `among` are the
    free forms that are compared, by default all.
    """
    found, laws = search_events(problem, selection.best, recordings)
    # what looks like an event may be a law
    further = bool(found or laws)
    proposal = search(problem, selection, among=among, further=further, progress=progress)
    without = Outcome(problem, selection, proposal, [], tuple(laws))
    if not found:
        return without
    if without.proposal is not None:
        with_events = problem.with_events(all_of(found))
        gain = problem.evidence(selection.best) - with_events.evidence(selection.best)
        if without.proposal.gain > gain - EVENT_GAIN * len(found):
            found = find(problem, without.fit, recordings)
    best = without
    for _ in range(_ROUNDS):
        if not found:
            return without
        if progress:
            progress(f"{len(found)} event{'s' * (len(found) > 1)}: looking again for missing effects")
        best = _given(problem, found, among, None if best is without else best.selection.best)
        if _lacks(best, _HOPELESS):
            return without  # no further round explains that much
        again, laws = search_events(problem, best.fit, recordings)
        if _same(found, again):
            break
        found = again
    if best.evidence > without.evidence or _lacks(best):
        return without
    # so that the shown residual is free of events
    cleared = best.problem.without_events(best.fit)
    selection = select(cleared, best.selection.best)
    return Outcome(
        cleared,
        selection,
        search(cleared, selection, among=among),
        sorted(best.events, key=lambda f: (f.event.recording, f.event.time)),
        tuple(laws),
    )


def _lacks(outcome: Outcome, times: float = 1.0) -> bool:
    """Whether so much stays unexplained that events are not believed: in chi-squared, or in the largest of drifts."""
    largest = max(outcome.problem.noise.scales.values(), default=1.0)
    return (
        largest >= DRIFT_HIDES * DRIFT_SCALE_BOUNDS[1]
        or lack_of_fit(outcome.problem, outcome.fit) > times * EVENT_LACK
    )


def _given(problem: Problem, found: list[Found], among: Sequence[Term] | None, start: Fit | None) -> Outcome:
    """Return effects and free form, given events; the selection begins with the terms of `start`, by default none."""
    with_events = problem.with_events(all_of(found)).with_drift_estimated()
    selection = select(with_events, start)
    return Outcome(with_events, selection, search(with_events, selection, among=among), found)


def accepted(problem: Problem, fit: Fit, recordings: Sequence[Recording]) -> list[Found]:
    """Return the events that effects and free forms do not explain better (`explain`)."""
    if not find(problem, fit, recordings):
        return []
    return explain(problem, select(problem), recordings).events


def beside_events(problem: Problem, terms: Sequence[Term], found: Sequence[Found]) -> Problem:
    """Return a problem with events, whose contribution, given some terms, is subtracted from its measured rows."""
    if not found:
        return problem
    with_events = problem.with_events(all_of(found)).with_drift_estimated()
    return with_events.without_events(with_events.fit(terms))


def without_warming(
    validation: Prepared | None, problem: Problem, fit: Fit, found: Sequence[Found]
) -> Prepared | None:
    """Return recordings for validation without the drifts that follow a temperature in those fitted, by their sizes."""
    shapes = {
        (event.quantity, event.kind): (
            size,
            temperature(problem.balances[event.recording].windows, event.kind),
        )
        for _, event, size, _ in _sizes(problem, fit, found)
        if event.kind in TEMPERATURES
    }
    if validation is None or not shapes:
        return validation
    other = validation.problem
    for (quantity, kind), (size, kelvin) in shapes.items():
        balances = []
        for b in other.balances:
            course = per_kelvin(kelvin) * (temperature(b.windows, kind) - kelvin.mean())
            gone = size * unit_rows(b, QUANTITIES[quantity]) * np.tile(course, len(b.rows))
            balances.append(b.with_measured(b.measured - gone))
        other = replace(other, prediction=other.prediction.with_measured(balances))
    return replace(validation, problem=other)


def as_continued(
    validation: Prepared | None, problem: Problem, fit: Fit, found: Sequence[Found]
) -> Prepared | None:
    """Return recordings for validation as the events of the fitted ones leave the machine.

    A drift that follows a temperature goes on there. A change that stayed may be still there, and what swings may do so
    there, too: they are where that makes the recording likelier by more than chance does, and else they are not
    expected.
    """
    validation = without_warming(validation, problem, fit, found)
    if validation is None:
        return None
    other = _with_staying(validation, problem, fit, [own for own in found if own.event.kind in STAYS])
    swings = [own for own in found if own.event.kind == "swing"]
    other = _with_swings(other, problem, fit, swings, validation.names)
    return validation if other is validation.problem else replace(validation, problem=other)


def _with_staying(validation: Prepared, problem: Problem, fit: Fit, staying: Sequence[Found]) -> Problem:
    """Return the problem of other recordings without the changes that are still there."""
    if not staying:
        return validation.problem
    plain = validation.problem.with_scales(problem.noise.scales)
    able = [(own, place) for own in staying for place in range(len(plain.balances))]
    chosen: list[tuple[Found, int]] = []
    best, cost = plain, predictive_cost(plain, fit)
    while able:
        tried = [(_with_stayed(plain, problem, fit, [*chosen, one], validation.names), one) for one in able]
        costs = [predictive_cost(other, fit) for other, _ in tried]
        least = int(np.argmin(costs))
        if costs[least] > cost - PREDICTING_GAIN:
            break
        (best, one), cost = tried[least], costs[least]
        chosen.append(one)
        able.remove(one)
    return best if chosen else validation.problem


def _with_swings(
    other: Problem, problem: Problem, fit: Fit, swings: Sequence[Found], names: Sequence[str]
) -> Problem:
    """Return the problem of other recordings, named so, without the swings that go on there.

    Of what swings only the period is known, and that about: phase and size are those that the recording shows.
    """
    for own in swings:
        for place, name in enumerate(names):
            other = _with_swing(other.with_scales(problem.noise.scales), fit, own, place, name)
    return other


def _with_swing(other: Problem, fit: Fit, own: Found, place: int, name: str) -> Problem:
    """Return the problem of other recordings without a swing in one of them, itself if none shows there."""
    windows = other.balances[place].windows
    best: tuple[float, Array, Array, Array] | None = None
    for period in periods_about(own.event.end, windows).tolist():
        # two phases, a quarter of a period apart, make any other
        parts = [
            replace(event, recording=place, time=start, end=period)
            for event in own.events
            for start in (0.0, 0.25 * period)
        ]
        columns = event_columns(other.balances, parts)
        sizes, covariance, gain = sizes_elsewhere(other, fit, columns)
        if best is None or gain > best[0]:
            best = gain, columns, sizes, covariance
    if best is None or best[0] < EVENT_GAIN + chance("swing", len(own.events) * PHASES):
        return other
    return _without_rows(other, *best[1:], [(event, name) for event in own.events])


def _with_stayed(
    other: Problem, problem: Problem, fit: Fit, stayed: Sequence[tuple[Found, int]], names: Sequence[str]
) -> Problem:
    """Return the problem of other recordings, named so, without changes that stayed, by their sizes in those fitted.

    Each is given with the number of a recording.
    """
    sizes, covariance = problem.event_sizes(fit)
    columns = np.zeros((len(other.measured), len(sizes)))
    edges = np.cumsum([0, *(len(b) for b in other.balances)])
    for own, place in stayed:
        balance = other.balances[place]
        for event in own.events:
            rows = unit_rows(balance, QUANTITIES[event.quantity])
            columns[edges[place] : edges[place + 1], problem.events.index(event)] += rows
    same = [(event, names[place]) for own, place in stayed for event in own.events]
    return _without_rows(other, columns, sizes, covariance, same)


def _without_rows(
    other: Problem, columns: Array, sizes: Array, covariance: Array, same: Sequence[tuple[Event, str]]
) -> Problem:
    """Return a problem without events that are there, too: `columns` (N, events) of these sizes and covariance.

    `same` has each event of the fitted recordings with the name of a recording in which it is there.
    """
    scale = np.sqrt(np.diag(covariance))
    values, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    rows, spread = columns @ sizes, columns @ (scale[:, None] * axes * np.sqrt(np.maximum(values, 0.0)))
    if other.stayed is not None:
        same, rows = [*other.stayed.events, *same], other.stayed.rows + rows
        spread = np.hstack([other.stayed.spread, spread])
    balances = [
        b.with_measured(b.measured - own)
        for b, own in zip(other.balances, other.prediction.split(columns @ sizes), strict=True)
    ]
    return replace(
        other, prediction=other.prediction.with_measured(balances), stayed=Stayed(tuple(same), rows, spread)
    )


def unused_events(validation: Prepared | None, fit: Fit, recordings: Sequence[Recording]) -> list[DatedEvent]:
    """Return the events in recordings on which nothing was fitted, given a fit to others; their rows are unchanged.

    The list is empty without such recordings, and where much stays unexplained next to the events.
    """
    if validation is None:
        return []
    own = validation.problem.fit(fit.terms)
    found = find(validation.problem, own, recordings)
    with_events = validation.problem.with_events(all_of(found))
    if found and lack_of_fit(with_events, with_events.fit(fit.terms)) > EVENT_LACK:
        return []
    return with_sizes(with_events, own, found, [str(recording.path) for recording in recordings])


def as_events(dated: Sequence[DatedEvent], names: Sequence[str]) -> list[Event]:
    """Return the events in the recordings `names`, with those that stayed there, by the numbers of these recordings."""
    own = [d for d in dated if d.recording in names]
    return [
        *(
            Event(names.index(d.recording), d.channel, d.kind, d.time, math.inf if d.end is None else d.end)
            for d in own
        ),
        *(
            Event(k, d.channel, "step", BEFORE)
            for d in own
            for k, name in enumerate(names)
            if Path(name).name in d.still_in
        ),
    ]


def _same(left: Sequence[Found], right: Sequence[Found]) -> bool:
    """Whether two searches found the same events."""
    if len(left) != len(right):
        return False
    a, b = (sorted((f.event for f in found), key=lambda e: (e.recording, e.time)) for found in (left, right))
    return all(
        (x.recording, x.quantity, x.kind) == (y.recording, y.quantity, y.kind)
        and abs(x.time - y.time) < EVENT_SAME
        for x, y in zip(a, b, strict=True)
    )


def with_sizes(
    problem: Problem,
    fit: Fit,
    found: Sequence[Found],
    names: Sequence[str],
    validation: Prepared | None = None,
) -> list[DatedEvent]:
    """Return the events at a time, with their sizes given a fit, and where in other recordings they stayed.

    A change that is there from the start of a recording is that which began in another one, if it has the size of all
    changes of the quantity there together.
    """
    stayed = validation.problem.stayed if validation is not None else None

    def dated(own: Found, event: Event, size: float, error: float) -> DatedEvent:
        return DatedEvent(
            recording=names[event.recording],
            time=event.time,
            time_error=own.errors[0],
            end=None if event.kind == "step" else event.end,
            end_error=None if event.kind == "step" else own.errors[1],
            kind=event.kind,
            channel=event.quantity,
            size=size,
            standard_error=error,
            unit=QUANTITIES[event.quantity].unit,
            gain=own.gain,
            ties=own.ties,
            still_in=tuple(name for same, name in stayed.events if same == event) if stayed else (),
        )

    every = [dated(*own) for own in _sizes(problem, fit, found) if own[1].kind in HAPPENS]
    result, alone = [own for own in every if not own.before], []
    for change in (own for own in every if own.before):
        for recording in dict.fromkeys(own.recording for own in result if own.recording != change.recording):
            began = [
                k
                for k, own in enumerate(result)
                if own.recording == recording and own.channel == change.channel and own.kind in STAYS
            ]
            errors = math.hypot(change.standard_error, *(result[k].standard_error for k in began))
            if began and abs(sum(result[k].size for k in began) - change.size) < SAME_SIZE * errors:
                still = (Path(change.recording).name, *change.still_in)
                for k in began:
                    result[k] = replace(result[k], still_in=(*result[k].still_in, *still))
                break
        else:
            alone.append(change)
    return result + alone


#: Changes that a turning of the rig makes: the torque of gravity on a centre of gravity off the pivot, along the spin
#: axis, in proportion to the tilt, and with it that of one off to a side.
_OF_ATTITUDE = "torque_along_tilt"
_WITH_ATTITUDE = ("torque_x", "torque_y")
ATTITUDE = "attitude"


def by_attitude(
    events: Sequence[DatedEvent], recordings: Sequence[Recording]
) -> tuple[list[DatedEvent], list[DatedEvent]]:
    """Return the events, and those of them that a turning of the rig explains as well.

    It may where a recording does not state how the rig stood. Constant torques that change at the same time go with it;
    one that changes alone is an event with the tie.
    """
    unstated = {str(recording.path) for recording in recordings if not recording.environment}
    turns = {
        (event.recording, event.time)
        for event in events
        if event.channel == _OF_ATTITUDE and event.recording in unstated
    }
    kept, turned = [], []
    for event in events:
        if event.recording not in unstated or event.channel not in (_OF_ATTITUDE, *_WITH_ATTITUDE):
            kept.append(event)
        elif (event.recording, event.time) in turns:
            turned.append(event)
        else:
            kept.append(replace(event, ties=(*event.ties, ATTITUDE)))
    return kept, turned


def drift_shapes(
    problem: Problem,
    fit: Fit,
    found: Sequence[Found],
    names: Sequence[str],
    validation: Prepared | None = None,
) -> list[DriftShape]:
    """Return the shapes of drifts, with their sizes given a fit, and where else something swings."""
    stayed = validation.problem.stayed if validation is not None else None
    result = []
    for own, event, size, error in _sizes(problem, fit, found):
        if event.kind in HAPPENS:
            continue
        span = 0.0
        if event.kind in TEMPERATURES:
            span = float(np.ptp(temperature(problem.balances[event.recording].windows, event.kind)))
        time = event.end if event.kind == "swing" else event.time
        result.append(
            DriftShape(
                recording=names[event.recording],
                kind=event.kind,
                channel=event.quantity,
                size=size,
                standard_error=error,
                unit=QUANTITIES[event.quantity].unit,
                time=time,
                time_error=own.errors[1] if event.kind == "swing" else 0.0,
                temperature_change=span,
                gain=own.gain,
                also_in=tuple(name for same, name in stayed.events if same == event) if stayed else (),
            )
        )
    return result


def missing_laws(
    problem: Problem, fit: Fit, laws: Sequence[MotionLaw], names: Sequence[str]
) -> list[MissingLaw]:
    """Return the laws that look like events, each once, where a fit leaves at least half of what each explains."""
    stated = problem.with_scales(dict.fromkeys(problem.noise.scales, 1.0))
    basis = stated.basis(fit)
    left = np.concatenate([stated.noise.whiten(fit.residual), -fit.pull])
    left -= basis @ (basis.T @ left)
    result: dict[tuple[int, str, tuple[str, ...]], MissingLaw] = {}
    for law in laws:
        rows = rows_of(problem, [law])
        assert rows is not None  # there is a law
        columns = np.zeros((len(left), rows.shape[1]))
        columns[: len(rows)] = stated.noise.whiten(rows)
        columns -= basis @ (basis.T @ columns)
        gain = float(left @ columns @ np.linalg.lstsq(columns, left, rcond=1e-8)[0])
        if gain > 0.5 * law.score:
            key = law.recording, law.variable, law.quantities
            result.setdefault(key, MissingLaw(names[law.recording], law.variable, law.quantities, law.score))
    return list(result.values())


def _sizes(problem: Problem, fit: Fit, found: Sequence[Found]) -> Iterator[tuple[Found, Event, float, float]]:
    """Yield every single event with its size and the standard error."""
    if not found:
        return
    sizes, covariance = problem.event_sizes(fit)
    for own in found:
        for event in own.events:
            k = problem.events.index(event)
            yield own, event, float(sizes[k]), math.sqrt(float(covariance[k, k]))


def parts_between(events: Sequence[DatedEvent]) -> Iterator[str]:
    """Yield the parts of recordings before, between and after their events, as `Recording.open` takes them."""
    for recording in dict.fromkeys(event.recording for event in events):
        place, (begin, until) = parted(recording)
        edges = [begin]
        for event in events:
            if event.recording == recording and not event.before:
                edges += [event.time, event.time if event.end is None else event.end]
        edges.append(until)
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            limits = [f"from={first:.1f}"] if math.isfinite(first) else []
            limits += [f"until={last:.1f}"] if math.isfinite(last) else []
            if first < last:  # events may overlap
                yield f"{place}@{','.join(limits)}" if limits else str(place)
