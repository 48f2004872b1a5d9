"""Test, diagnose, test again: until nothing is open, or the time on the bench is spent.

Nothing of the machine is known here but its recordings: whoever runs a plan is a function that takes a plan and
gives a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from gyrowheel_control.plans.fitting import plan_for
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import disk_errors, json_text, write_text

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_analysis.model import Model
    from gyrowheel_recording.bags import Recording

#: Runs a plan on the bench, records it in a directory; the number distinguishes the runs.
Run = Callable[[Plan, Path, int], None]
#: A plan is run at most this often; repeating it further adds little.
MOST_RUNS = 2
#: What shows most where nothing says which test to run.
BROAD = "survey"


class Listener(Protocol):
    """Receives what an investigation does."""

    def begin(self, number: int, plans: Sequence[str], why: str) -> None:
        """Take notice that a step begins."""

    def working(self, title: str) -> AbstractContextManager[Callable[[str], None]]:
        """Show that something is being done, and what."""

    def advancing(self, title: str) -> AbstractContextManager[Callable[[float], None]]:
        """Show how far a plan is."""

    def learned(self, step: Step) -> None:
        """Take notice of what a step has brought."""


@dataclass(frozen=True)
class Step:
    """One step: plans that were run, and the diagnosis of all recordings up to then.

    Attributes
    ----------
    number : int
        From 1.
    plans : list of str
        What was run; empty where recordings at hand were diagnosed.
    why : str
        What for.
    recordings : list of Path
        What was recorded.
    minutes : float
        Time on the bench.
    diagnosis : Diagnosis
        What all recordings so far say.
    learned : list of str
        The same in a sentence or two.
    before : str or None
        The verdict before this step; None for the first.
    separated : list of str
        What could have been before this step and cannot any more.
    left : float
        Time on the bench that is left after it [min].
    """

    number: int
    plans: list[str]
    why: str
    recordings: list[Path]
    minutes: float
    diagnosis: Diagnosis
    learned: list[str]
    before: str | None = None
    separated: list[str] = field(default_factory=list)
    left: float = 0.0


@dataclass(frozen=True)
class Wanted:
    """A test that would show more."""

    plan: str
    why: str


@dataclass
class Investigation:
    """An investigation as far as it has come.

    Attributes
    ----------
    model : str
        The model file.
    budget : float
        Time on the bench that may be spent [min].
    steps : list of Step
        What was done.
    averages : bool
        Whether the recordings are reduced to averages over revolutions alone.
    settled : bool
        Whether nothing is open any more.
    reason : str
        Why it ended; empty while it goes on.
    """

    model: str
    budget: float
    steps: list[Step] = field(default_factory=list)
    averages: bool = False
    settled: bool = False
    reason: str = ""

    @property
    def minutes(self) -> float:
        """Time on the bench that was spent [min]."""
        return sum(step.minutes for step in self.steps)

    @property
    def recordings(self) -> list[Path]:
        """Everything recorded."""
        return [path for step in self.steps for path in step.recordings]

    def to_json(self) -> dict[str, Any]:
        """Return the investigation as a JSON object."""
        from gyrowheel.show.contract import diagnosis_json

        return {
            "schema": 1,
            "model": self.model,
            "settled": self.settled,
            "reason": self.reason,
            "minutes": self.minutes,
            "budget_minutes": self.budget,
            "averages": self.averages,
            "verdict": self.steps[-1].diagnosis.verdict if self.steps else None,
            "named": [f.name for f in self.steps[-1].diagnosis.effects] if self.steps else [],
            "steps": [
                {
                    "plans": step.plans,
                    "why": step.why,
                    "recordings": [str(path) for path in step.recordings],
                    "minutes": step.minutes,
                    "minutes_left": step.left,
                    "verdict_before": step.before,
                    "verdict": step.diagnosis.verdict,
                    "separated": step.separated,
                    "effects": [
                        {"name": f.name, "ties": [tie.name for tie in f.ties]} for f in step.diagnosis.effects
                    ],
                    "learned": step.learned,
                }
                for step in self.steps
            ],
            "diagnosis": diagnosis_json(self.steps[-1].diagnosis) if self.steps else None,
        }


def pursue(
    done: Investigation,
    model: Model,
    folder: Path,
    run: Run,
    listener: Listener,
    *,
    plans: Sequence[Plan],
    at_hand: Sequence[Path] = (),
    thorough: bool = False,
) -> None:
    """Find out what a model lacks, running the tests that it takes.

    Parameters
    ----------
    done : Investigation
        Filled step by step: what was finished is in it whatever happens.
    model : Model
        The model.
    folder : Path
        Folder for the recordings and for ``investigation.json``, which is complete after every step; made if need be.
    run : callable
        Runs a plan on the bench and records it.
    listener : Listener
        Receives what happens.
    plans : sequence of Plan
        What is run first.
    at_hand : sequence of Path
        Recordings that there are already.
    thorough : bool
        Whether to go on until every known effect would have shown at its usual size.

    Notes
    -----
    `Investigation.averages` says whether to look at averages alone, as where filters hide what happens within a
    revolution.

    Raises
    ------
    InputError
        If there is nothing to begin with, or the first plans take more time than there is.
    """
    from gyrowheel.investigation.sentences import learned
    from gyrowheel_analysis.diagnosis.diagnose import diagnose
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
    why = (
        "a first look"
        if not at_hand
        else "more to begin with"
        if plans
        else "what the recordings at hand say"
    )
    while True:
        number = len(done.steps) + 1
        listener.begin(number, [plan.called for plan in following], why)
        made: list[Path] = []
        for plan in following:
            # counted on from the recordings at hand: a run of its own has noise of its own
            place = len(recordings) + 1
            path = folder / f"{place}-{plan.name}"
            run(plan, path, place)
            made.append(path)
            recordings.append(Recording.open(path))
        before = done.steps[-1].diagnosis if done.steps else None
        with listener.working("diagnosing") as say:
            found = diagnose(recordings, model, averages=done.averages, progress=say)
            wanted = _next(found, recordings, model, done, following, thorough, say)
            gone = [] if before is None else _ruled_out(found, before)
            said = learned(found, gone)
            if before is None and not done.averages:
                said += _why_so_soon(found, recordings, model, say)
        took = sum(_minutes(plan) for plan in following)
        done.steps.append(
            Step(
                number,
                [plan.called for plan in following],
                why,
                made,
                took,
                found,
                said,
                before=None if before is None else before.verdict,
                separated=gone,
                left=max(done.budget - done.minutes - took, 0.0),
            )
        )
        if isinstance(wanted, Wanted):
            plan = plan_for(wanted.plan, model.stated_bench)
            left = done.budget - done.minutes
            if _minutes(plan) > left:
                done.reason = (
                    f"the time is spent: plan {plan.called} ({wanted.why}) takes {_minutes(plan):.1f} min, "
                    f"and {left:.1f} of {done.budget:g} min are left"
                )
        else:
            done.settled, done.reason = wanted
        write_text(folder / "investigation.json", json_text(done.to_json()))
        listener.learned(done.steps[-1])
        if done.reason:
            return
        assert isinstance(wanted, Wanted)  # else there is a reason
        following, why = [plan], wanted.why


def _minutes(plan: Plan) -> float:
    return plan.duration / 60.0


def _next(
    found: Diagnosis,
    recordings: Sequence[Recording],
    model: Model,
    done: Investigation,
    now: Sequence[Plan],
    thorough: bool,
    progress: Callable[[str], None],
) -> Wanted | tuple[bool, str]:
    """Return the test that what is open asks for; else whether all is settled, and why it ends."""
    from gyrowheel.show.sentences.diagnosis import purpose, verdict_sentence

    if found.setup:
        return False, verdict_sentence(found).rstrip(".")
    ran = [name for step in done.steps for name in step.plans] + [plan.called for plan in now]

    def fresh(plan: str) -> bool:
        return ran.count(plan) < MOST_RUNS

    if found.verdict == "ambiguous":
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
        return True, "no known effect explains it, at any speed and tilt tried; the formula describes it"
    if found.verdict == "effect":
        from gyrowheel_analysis.diagnosis.precision import precision_test

        sharper = precision_test(recordings, model, found, averages=done.averages, progress=progress)
        if sharper is not None and fresh(sharper.plan):
            return Wanted(
                sharper.plan,
                f"knows {sharper.effect} to {100.0 * sharper.expected:.0f} % instead of {100.0 * sharper.now:.0f} %",
            )
    if thorough and found.next_test is not None and fresh(found.next_test.plan):
        return Wanted(found.next_test.plan, purpose(found.next_test))
    return True, "nothing is open"


def _ruled_out(found: Diagnosis, before: Diagnosis) -> list[str]:
    return sorted(_alternatives(before) - _alternatives(found))


def _why_so_soon(
    found: Diagnosis, recordings: Sequence[Recording], model: Model, progress: Callable[[str], None]
) -> list[str]:
    """Return why the first recordings settle what averages over revolutions leave open; nothing where they do not."""
    if found.verdict != "effect" or len(found.effects) != 1 or found.instruments:
        return []
    from gyrowheel.investigation.sentences import settled_by
    from gyrowheel_analysis.diagnosis.diagnose import diagnose
    from gyrowheel_analysis.diagnosis.discrimination import discriminating_channels

    (finding,) = found.effects
    progress("comparing with averages over revolutions alone")
    plain = diagnose(recordings, model, averages=True)
    if plain.verdict != "ambiguous" or len(plain.effects) != 1:
        return []
    others = [
        n for n in (plain.effects[0].name, *(t.name for t in plain.effects[0].ties)) if n != finding.name
    ]
    if len(others) != len(plain.effects[0].ties):
        return []  # averages lead elsewhere
    rival = others[0]
    first, *_ = discriminating_channels(recordings, model, finding.name, rival)
    return [settled_by([finding.name, *others], first.title, first.delta_chi2, rival)]


def _alternatives(found: Diagnosis) -> set[str]:
    return {name for own, ties in found.ties.items() for name in (own, *(tie.name for tie in ties))}
