"""Run a test, diagnose, choose the next test: until no question is open, or the bench time is spent.

The machine is known here by its recordings alone: a function runs a plan and writes a recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from gyrowheel.show.sentences.diagnosis import named, purpose, verdict_sentence
from gyrowheel.show.sentences.findings import instrument_open, instrument_sentence
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import disk_errors, json_text, write_text
from gyrowheel_core.quantities import listed, quantity

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.findings import EffectFinding
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_analysis.model import Model
    from gyrowheel_recording.bags import Recording

#: Runs a plan on the bench and records it in a directory; the number distinguishes the runs.
Run = Callable[[Plan, Path, int], None]
#: A plan is run at most this often; further repetitions add little.
MOST_RUNS = 2
#: The plan that shows most effects, where no diagnosis names a test.
BROAD = "survey"


class Listener(Protocol):
    """Receives the course of an investigation."""

    def begin(self, number: int, plans: Sequence[str], why: str) -> None:
        """Receive the beginning of a step."""

    def working(self, title: str) -> AbstractContextManager[Callable[[str], None]]:
        """Show that a calculation is under way; the function yielded takes its next line."""

    def advancing(self, title: str) -> AbstractContextManager[Callable[[float], None]]:
        """Show the progress of a plan; the function yielded takes the fraction done."""

    def learned(self, step: Step) -> None:
        """Receive a finished step."""


@dataclass(frozen=True)
class Step:
    """One step: plans that were run, and the diagnosis of all recordings so far.

    Attributes
    ----------
    number : int
        Number of the step, from 1.
    plans : tuple of str
        The plans; empty where existing recordings were diagnosed.
    why : str
        Purpose of the step.
    recordings : tuple of Path
        The new recordings.
    minutes : float
        Bench time [min].
    diagnosis : gyrowheel_analysis.diagnosis.result.Diagnosis
        Diagnosis of all recordings so far.
    learned : tuple of str
        The diagnosis in a sentence or two.
    before : str or None
        Verdict before this step; None for the first.
    separated : tuple of str
        Explanations that this step ruled out.
    left : float
        Bench time left after it [min].
    """

    number: int
    plans: tuple[str, ...]
    why: str
    recordings: tuple[Path, ...]
    minutes: float
    diagnosis: Diagnosis
    learned: tuple[str, ...]
    before: str | None = None
    separated: tuple[str, ...] = ()
    left: float = 0.0


@dataclass(frozen=True)
class Wanted:
    """A test to run next, and its purpose."""

    plan: str
    why: str


@dataclass(frozen=True)
class Course:
    """An investigation: the steps so far, and how it ended.

    Attributes
    ----------
    model : str
        The model file.
    budget : float
        Bench time that may be spent [min].
    steps : tuple of Step
        The finished steps: ``.plans``, ``.why``, ``.diagnosis``, ``.learned`` and more.
    averages : bool
        Whether the recordings are reduced to averages over revolutions.
    settled : bool
        Whether no question is open.
    reason : str
        Why the investigation ended; empty while it goes on.
    """

    model: str
    budget: float
    steps: tuple[Step, ...] = ()
    averages: bool = False
    settled: bool = False
    reason: str = ""

    @property
    def minutes(self) -> float:
        """Bench time spent [min]."""
        return sum(step.minutes for step in self.steps)

    @property
    def recordings(self) -> tuple[Path, ...]:
        """All recordings of the investigation."""
        return tuple(path for step in self.steps for path in step.recordings)

    def to_json(self) -> dict[str, Any]:
        """Return the investigation as a JSON object."""
        from gyrowheel.show.contract import diagnosis_json

        last = self.steps[-1].diagnosis if self.steps else None
        return {
            "schema": 1,
            "model": self.model,
            "settled": self.settled,
            "reason": self.reason,
            "minutes": self.minutes,
            "budget_minutes": self.budget,
            "averages": self.averages,
            "verdict": None if last is None else last.verdict,
            "named": [] if last is None else [f.name for f in last.effects],
            "steps": [
                {
                    "plans": list(step.plans),
                    "why": step.why,
                    "recordings": [str(path) for path in step.recordings],
                    "minutes": step.minutes,
                    "minutes_left": step.left,
                    "verdict_before": step.before,
                    "verdict": step.diagnosis.verdict,
                    "separated": list(step.separated),
                    "effects": [
                        {"name": f.name, "ties": [tie.name for tie in f.ties]} for f in step.diagnosis.effects
                    ],
                    "learned": list(step.learned),
                }
                for step in self.steps
            ],
            "diagnosis": None if last is None else diagnosis_json(last),
        }


def pursue(
    done: Course,
    model: Model,
    folder: Path,
    run: Run,
    listener: Listener,
    *,
    plans: Sequence[Plan],
    at_hand: Sequence[Path] = (),
    thorough: bool = False,
) -> Iterator[Course]:
    """Run the tests that settle what a model lacks; yield the investigation after each step.

    Parameters
    ----------
    done : Course
        The investigation without steps: model, budget, and whether averages over revolutions alone are used.
    model : Model
        The model.
    folder : Path
        Folder for the recordings and for ``investigation.json``, which is complete after every step.
    run : callable
        Runs a plan on the bench and records it.
    listener : Listener
        Receives the course of the investigation.
    plans, at_hand : sequence of Plan, of Path
        The first plans, and existing recordings; InputError without both, or if the plans exceed the budget.
    thorough : bool
        Whether to continue until every known effect would have shown at its usual size.
    """
    from gyrowheel_recording.bags import Recording

    if not plans and not at_hand:
        raise InputError("no plan and no recording to begin with")
    first = sum(_minutes(plan) for plan in plans)
    if not done.budget >= first:
        raise InputError(f"budget: {done.budget:g} min is too short; the first plans take {first:.1f} min")
    recordings: list[Recording] = [Recording.open(path) for path in at_hand]
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    following = list(plans)
    why = "more to begin with" if plans else "what the recordings at hand say"
    if not at_hand:
        why = "a first look"
    while not done.reason:
        listener.begin(len(done.steps) + 1, [plan.called for plan in following], why)
        made: list[Path] = []
        for plan in following:
            # numbered after the existing recordings: every run has its own noise
            place = len(recordings) + 1
            path = folder / f"{place}-{plan.name}"
            run(plan, path, place)
            made.append(path)
            recordings.append(Recording.open(path))
        step, wanted = _diagnosed(done, recordings, model, following, why, made, thorough, listener)
        done = replace(done, steps=(*done.steps, step))
        if isinstance(wanted, Wanted):
            plan = plan_for(wanted.plan, model.stated_bench)
            left = done.budget - done.minutes
            if _minutes(plan) > left:
                reason = (
                    f"the time is spent: plan {plan.called} ({wanted.why}) takes {_minutes(plan):.1f} min, "
                    f"and {left:.1f} of {done.budget:g} min are left"
                )
                done = replace(done, reason=reason)
            following, why = [plan], wanted.why
        else:
            settled, reason = wanted
            done = replace(done, settled=settled, reason=reason)
        yield done
        write_text(folder / "investigation.json", json_text(done.to_json()))
        listener.learned(step)


def _diagnosed(
    done: Course,
    recordings: Sequence[Recording],
    model: Model,
    plans: Sequence[Plan],
    why: str,
    made: Sequence[Path],
    thorough: bool,
    listener: Listener,
) -> tuple[Step, Wanted | tuple[bool, str]]:
    """Return the step that ran some plans, with the diagnosis of all recordings, and what follows from it."""
    from gyrowheel_analysis.diagnosis.diagnose import diagnose

    before = done.steps[-1].diagnosis if done.steps else None
    with listener.working("diagnosing") as say:
        found = diagnose(recordings, model, averages=done.averages, progress=say)
        wanted = _next(found, recordings, model, done, plans, thorough, say)
        gone = [] if before is None else sorted(_alternatives(before) - _alternatives(found))
        said = learned(found, gone)
        if before is None and not done.averages:
            said += _why_so_soon(found, recordings, model, say)
    took = sum(_minutes(plan) for plan in plans)
    step = Step(
        len(done.steps) + 1,
        tuple(plan.called for plan in plans),
        why,
        tuple(made),
        took,
        found,
        tuple(said),
        before=None if before is None else before.verdict,
        separated=tuple(gone),
        left=max(done.budget - done.minutes - took, 0.0),
    )
    return step, wanted


def _minutes(plan: Plan) -> float:
    return plan.duration / 60.0


def _next(
    found: Diagnosis,
    recordings: Sequence[Recording],
    model: Model,
    done: Course,
    now: Sequence[Plan],
    thorough: bool,
    progress: Callable[[str], None],
) -> Wanted | tuple[bool, str]:
    """Return the test that the open questions call for; else whether all is settled, and why it ends."""
    if found.setup:
        return False, verdict_sentence(found).rstrip(".")
    ran = [name for step in done.steps for name in step.plans] + [plan.called for plan in now]

    def fresh(plan: str) -> bool:
        return ran.count(plan) < MOST_RUNS

    if found.verdict == "ambiguous":
        return _separation(found, fresh)
    if found.verdict == "insufficient_data":
        test = found.next_test
        plan, why = (test.plan, purpose(test)) if test else (BROAD, "shows most known effects")
        if fresh(plan):
            return Wanted(plan, why)
        return False, "further recordings of these plans would not show more"
    if found.verdict == "unknown":
        if BROAD not in ran:
            return Wanted(BROAD, "shows whether the formula holds at other speeds and tilts")
        if not found.free_form:
            return False, "no known effect explains it, at any speed and tilt tried, and no simple formula"
        test = found.next_test  # separates formulas
        if test is not None and fresh(test.plan):
            return Wanted(test.plan, purpose(test))
        if found.free_form[0].ties:
            return False, "no known effect explains it, and the tests do not separate the formulas that do"
        return True, "no known effect explains it, at any speed and tilt tried; the formula describes it"
    if found.verdict == "effect":
        from gyrowheel_analysis.diagnosis.experiment_design import precision_test

        sharper = precision_test(recordings, model, found, averages=done.averages, progress=progress)
        if sharper is not None and fresh(sharper.plan):
            return Wanted(
                sharper.plan,
                f"knows {sharper.effect} to {100.0 * sharper.expected:.0f} % instead of {100.0 * sharper.now:.0f} %",
            )
    if thorough and found.next_test is not None and fresh(found.next_test.plan):
        return Wanted(found.next_test.plan, purpose(found.next_test))
    return True, "nothing is open"


def _separation(found: Diagnosis, fresh: Callable[[str], bool]) -> Wanted | tuple[bool, str]:
    """Return the test that separates a tie; else that the tie is not settled, and the reason."""
    test = found.next_test
    if test is not None and fresh(test.plan):
        return Wanted(test.plan, purpose(test))
    for name, ties in found.ties.items():
        for tie in ties:
            if tie.separating_plan is not None and fresh(tie.separating_plan):
                return Wanted(tie.separating_plan, f"separates {name} from {tie.name}")
    if all(tie.separating_plan is None for ties in found.ties.values() for tie in ties):
        return False, "no test on this bench separates what is left"
    return False, f"the tests that should separate them were run {MOST_RUNS} times and have not"


def _why_so_soon(
    found: Diagnosis, recordings: Sequence[Recording], model: Model, progress: Callable[[str], None]
) -> list[str]:
    """Return why the first recordings settle what averages over revolutions leave open; empty if they do not."""
    if found.verdict != "effect" or len(found.effects) != 1 or found.instruments:
        return []
    from gyrowheel_analysis.diagnosis.diagnose import diagnose
    from gyrowheel_analysis.diagnosis.experiment_design import discriminating_channels

    (finding,) = found.effects
    progress("comparing with averages over revolutions alone")
    plain = diagnose(recordings, model, averages=True)
    if plain.verdict != "ambiguous" or len(plain.effects) != 1:
        return []
    others = [
        n for n in (plain.effects[0].name, *(t.name for t in plain.effects[0].ties)) if n != finding.name
    ]
    if len(others) != len(plain.effects[0].ties):
        return []  # averages name other effects
    rival = others[0]
    first, *_ = discriminating_channels(recordings, model, finding.name, rival)
    return [settled_by([finding.name, *others], first.title, first.delta_chi2, rival)]


def _alternatives(found: Diagnosis) -> set[str]:
    return {name for own, ties in found.ties.items() for name in (own, *(tie.name for tie in ties))}


def learned(found: Diagnosis, ruled_out: Sequence[str]) -> list[str]:
    """Return a diagnosis in a sentence or two, and what it ruled out since the previous one."""
    if found.verdict == "unknown":
        formula = f" Proposed formula: {found.free_form[0].formula}." if found.free_form else ""
        said = [f"Something acts that no known effect explains.{formula}"]
    elif found.verdict == "ambiguous":
        said = [_open(finding) for finding in found.effects]
        said += [instrument_open(finding) for finding in found.instruments]
    elif found.verdict == "effect":
        said = [f"Found: {named(finding)}, {_size(finding)}." for finding in found.effects]
        said += [instrument_sentence(finding) for finding in found.instruments]
    else:
        said = [verdict_sentence(found)]
    if ruled_out and (found.effects or found.instruments):
        said.append(f"{listed(ruled_out, 'and')} {'is' if len(ruled_out) == 1 else 'are'} ruled out.")
    return said


def settled_by(open_names: Sequence[str], channel: str, delta_chi2: float, rival: str) -> str:
    """Return which channel settles at once what averages over revolutions leave open."""
    return (
        f"Averages over revolutions alone would not separate {listed(open_names, 'from')}; {channel} does "
        f"(Δχ² {delta_chi2:.0f} against {rival})."
    )


def _open(finding: EffectFinding) -> str:
    if not finding.ties:
        return f"Found: {named(finding)}, {_size(finding)}."
    others = listed([tie.name for tie in finding.ties], "or")
    return f"Most likely {named(finding)}, but {others} would explain it as well."


def _size(finding: EffectFinding) -> str:
    """Return the first amplitude of a finding with its relative error."""
    name, estimate = next(iter(finding.coefficients.items()))
    text = f"{name} = {quantity(estimate.value, estimate.unit)}"
    if estimate.value and math.isfinite(estimate.standard_error):
        text += f", known to {100.0 * abs(estimate.standard_error / estimate.value):.2g} %"
    return text
