"""The search for events: found one by one, fitted together, and none where a law of the motion serves as well."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrowheel_analysis.criteria import (
    EVENT_GAIN,
    EVENT_NEAR,
    EVENT_SAME,
    EVENT_SEARCH,
    EVENT_SIMPLER,
    EVENT_TIE,
    MOTION_LAWS,
    SAME_SIZE,
)
from gyrowheel_analysis.diagnosis.event_dating import Found, all_of, gain_of, swing_in, with_times
from gyrowheel_analysis.diagnosis.event_scan import PHASES, Candidate, best_at, chance, places, price, scan
from gyrowheel_analysis.diagnosis.evidence import Evidence
from gyrowheel_analysis.diagnosis.motion_laws import (
    MotionLaw,
    gain_of_law,
    law_instead,
    law_of_shape,
    rows_of,
)
from gyrowheel_analysis.fitting.events import BEFORE, HAPPENS, STAYS, TOGETHER, Event
from gyrowheel_analysis.fitting.fit import Fit
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_recording.bags import Recording

_MOST = 6
_AXES = frozenset(("_x", "_y"))  # as names of quantities end
_ROUNDS = 3  # of fitting every event next to the others


def find(problem: Problem, fit: Fit, recordings: Sequence[Recording]) -> list[Found]:
    """Return the events that recordings show in addition to a fit, the strongest first."""
    return search_events(problem, fit, recordings)[0]


def search_events(
    problem: Problem, fit: Fit, recordings: Sequence[Recording]
) -> tuple[list[Found], list[MotionLaw]]:
    """Return the events that recordings show in addition to a fit, and laws of the motion that look like events."""
    found: list[Found] = []
    laws: list[MotionLaw] = []
    of_recordings = places(problem)
    while sum(not f.event.before for f in found) < _MOST:
        evidence = Evidence(problem.with_events(all_of(found)), fit, rows_of(problem, laws))
        candidates = scan(evidence, of_recordings)
        best = _simplest(candidates)
        if best.score < EVENT_GAIN:
            break
        dated = _dated_best(evidence, candidates, best, recordings[best.first.recording])
        if any(_alike(dated.events, f.events) for f in found):
            break
        if best.first.kind in (*HAPPENS, "swing"):
            score = dated.gain - price(dated.event.kind, of_recordings)
            law = law_instead(evidence, dated.events, score)
        else:
            law = law_of_shape(problem, dated.event, best.score)
        if law is not None:
            if any(_same_law(law, own) for own in laws):
                break  # it is set apart already, and explains nothing
            laws.append(law)
            if len(laws) > MOTION_LAWS:
                break
            continue
        found.append(replace(dated, ties=_ties(candidates, best, dated)))
        if dated.event.kind in STAYS:
            found += _stayed(problem, fit, found, laws, price("step", of_recordings))
        elif dated.event.kind == "swing":
            evidence = Evidence(problem.with_events(all_of(found)), fit, rows_of(problem, laws))
            found += _swings_elsewhere(evidence, dated, found)
    found = fitted_together(problem, fit, found, laws, recordings)
    return _with_offsets(found, _needed(problem, fit, found, laws))


def _needed(problem: Problem, fit: Fit, found: Sequence[Found], laws: Sequence[MotionLaw]) -> list[MotionLaw]:
    """Return the laws that explain something next to the events that were found after them."""
    result = list(laws)
    for law in laws if found else ():
        others = [own for own in result if own is not law]
        evidence = Evidence(problem.with_events(all_of(found)), fit, rows_of(problem, others))
        if gain_of_law(evidence, law) < EVENT_GAIN:
            result = others
    return result


def _same_law(one: MotionLaw, other: MotionLaw) -> bool:
    known = (one.recording, one.variable, one.quantities, one.lag)
    return known == (other.recording, other.variable, other.quantities, other.lag) and np.array_equal(
        one.course, other.course
    )


def _stayed(
    problem: Problem, fit: Fit, found: Sequence[Found], laws: Sequence[MotionLaw], chance: float
) -> list[Found]:
    """Return the last change that was found as it is there from the start of other recordings.

    `chance` is the gain of a step by chance.
    """
    last, known = found[-1], _before(found)
    able = [
        tuple(Event(k, event.quantity, "step", BEFORE) for event in last.events)
        for k in range(len(problem.balances))
        if k != last.event.recording and not known.issuperset((k, event.quantity) for event in last.events)
    ]
    result: list[Found] = []
    while able:
        evidence = Evidence(problem.with_events(all_of([*found, *result])), fit, rows_of(problem, laws))
        gains = [gain_of(evidence, [events]) for events in able]
        best = int(np.argmax(gains))
        if gains[best] < EVENT_GAIN + chance:
            break
        result.append(Found(able.pop(best), (0.0,), gains[best]))
    return result


def _swings_elsewhere(evidence: Evidence, swing: Found, known: Sequence[Found]) -> list[Found]:
    """Return a swing as the other recordings show it: about the same period, and any phase and size."""
    result = []
    for recording in range(len(evidence.problem.balances)):
        there = swing_in(evidence, swing.events, recording)
        if there.gain > EVENT_GAIN + chance("swing", PHASES) and not any(
            own.event.kind == "swing" and _same_swing(own, there) for own in known
        ):
            result.append(there)
    return result


def _same_swing(one: Found, other: Found) -> bool:
    """Whether two swings are of one recording, with a common quantity and about the same period."""
    if one.event.recording != other.event.recording or not {e.quantity for e in one.events} & {
        e.quantity for e in other.events
    }:
        return False
    errors = math.hypot(one.errors[1], other.errors[1])
    return abs(one.event.end - other.event.end) < max(SAME_SIZE * errors, 0.05 * one.event.end)


def _before(found: Sequence[Found]) -> set[tuple[int, str]]:
    """Return recordings and quantities of changes before the start."""
    return {(event.recording, event.quantity) for f in found for event in f.events if event.before}


def _with_offsets(found: Sequence[Found], laws: Sequence[MotionLaw]) -> tuple[list[Found], list[MotionLaw]]:
    """Return events and laws; an offset of what changed in another recording is an event before the start."""
    events, others, known = list(found), [], _before(found)
    for law in laws:
        changed = {
            e.quantity
            for f in found
            if f.event.recording != law.recording
            for e in f.events
            if e.kind in STAYS
        }
        if law.variable != "offset" or not changed.intersection(law.quantities):
            others.append(law)
            continue
        new = [name for name in law.quantities if (law.recording, name) not in known]
        if new:
            there = tuple(Event(law.recording, name, "step", BEFORE) for name in new)
            events.append(Found(there, (0.0,), law.score))
    return events, others


def fitted_together(
    problem: Problem,
    fit: Fit,
    found: Sequence[Found],
    laws: Sequence[MotionLaw],
    recordings: Sequence[Recording],
) -> list[Found]:
    """Return events that were found one by one, each with the best times next to all others.

    Changes at one instant become one event; those that the others make dispensable are dropped.
    """
    own = list(found)
    of_recordings, law_rows = places(problem), rows_of(problem, laws)
    for _ in range(_ROUNDS):
        count, own = len(own), _merged(own)
        if count == len(own) == 1:
            return own
        before = list(own)
        k = 0
        while k < len(own):
            if own[k].event.before:
                k += 1
                continue
            others = own[:k] + own[k + 1 :]
            evidence = Evidence(problem.with_events(all_of(others)), fit, law_rows)
            candidate = best_at(evidence, own[k].events, of_recordings)
            again = _fewer(evidence, with_times(evidence, candidate, recordings[candidate.first.recording]))
            if again.gain - price(again.event.kind, of_recordings) < EVENT_GAIN:
                own = others
                continue
            own[k] = replace(again, ties=own[k].ties)
            k += 1
        if len(before) == len(own) and all(
            _alike(a.events, b.events) for a, b in zip(before, own, strict=True)
        ):
            break
    return own


def _merged(found: Sequence[Found]) -> list[Found]:
    """Return events with those of one instant as one, at the times of the one that gains most."""
    result: list[Found] = []
    for own in sorted(found, key=lambda f: -f.gain):
        for k, other in enumerate(result):
            quantities = {e.quantity for e in (*other.events, *own.events)}
            names = next((pair for pair in TOGETHER if quantities <= set(pair)), None)
            if names is not None and _at_once(other, own):
                events = tuple(replace(other.event, quantity=name) for name in names if name in quantities)
                result[k] = replace(other, events=events)
                break
        else:
            result.append(own)
    return result


def _at_once(left: Found, right: Found) -> bool:
    """Whether two events are of one kind in one recording and have the same edges, as far as these are known."""
    a, b = left.event, right.event
    if (a.recording, a.kind) != (b.recording, b.kind):
        return False
    known = [
        max(EVENT_SAME, EVENT_SEARCH * math.hypot(x, y))
        for x, y in zip(left.errors, right.errors, strict=True)
    ]
    return all(abs(x - y) <= most for x, y, most in zip(a.edges, b.edges, known, strict=True))


def _dated_best(
    evidence: Evidence, candidates: Sequence[Candidate], best: Candidate, recording: Recording
) -> Found:
    """Return the best candidate as an event with its times, on as few axes as serve."""
    dated = with_times(evidence, best, recording)
    if best.first.kind == "trend" and (steps := [c for c in candidates if _may_be(c, best)]):
        # a step within a window looks like a short trend
        step = with_times(evidence, steps[0], recording)
        dated = step if step.gain > dated.gain - EVENT_SIMPLER else dated
    return _fewer(evidence, dated)


def _may_be(candidate: Candidate, trend: Candidate) -> bool:
    """Whether a candidate is a step that may explain a trend."""
    e, t = candidate.first, trend.first
    return (e.kind, e.recording, candidate.quantities) == ("step", t.recording, trend.quantities) and (
        t.time - EVENT_NEAR < e.time < t.end + EVENT_NEAR
    )


def _fewer(evidence: Evidence, dated: Found) -> Found:
    """Return the event of one axis alone in place of both, where it explains as much."""
    alone = [replace(dated, events=(event,), gain=gain_of(evidence, [(event,)])) for event in dated.events]
    best = max(alone, key=lambda own: own.gain)
    return best if best.gain > dated.gain - EVENT_SIMPLER else dated


def _alike(left: Sequence[Event], right: Sequence[Event]) -> bool:
    """Whether two events are the same change of the same quantities."""
    if [(e.recording, e.quantity, e.kind) for e in left] != [
        (e.recording, e.quantity, e.kind) for e in right
    ]:
        return False
    return all(abs(a - b) < EVENT_SAME for a, b in zip(left[0].edges, right[0].edges, strict=True))


def _ties(candidates: Sequence[Candidate], best: Candidate, dated: Found) -> tuple[str, ...]:
    """Return other quantities whose change at the same time gains nearly as much, of both axes those that changed."""
    first, axes = best.first, {event.quantity[-2:] for event in dated.events} & _AXES
    near = [
        name
        for c in candidates
        if c.gain > best.gain - EVENT_TIE
        and c.quantities != best.quantities
        and (c.first.recording, c.first.kind) == (first.recording, first.kind)
        and all(abs(a - b) < EVENT_NEAR for a, b in zip(c.first.edges, first.edges, strict=True))
        for name in c.quantities
        if not axes or name[-2:] not in _AXES - axes
    ]
    return tuple(dict.fromkeys(near))


def _simplest(candidates: Sequence[Candidate]) -> Candidate:
    """Return the best candidate, or one of a simpler quantity that is nearly as good."""
    serving = [c for c in candidates if c.score >= candidates[0].score - EVENT_SIMPLER]
    order = {quantities: k for k, quantities in enumerate(TOGETHER)}
    return min(serving, key=lambda c: (order.get(c.quantities, len(order)), -c.score))
