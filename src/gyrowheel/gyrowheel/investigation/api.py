"""An investigation on a simulated machine, or on a user's bench."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.diagnosis.api import Diagnosis
from gyrowheel.investigation.page import end_sentence, investigation_page
from gyrowheel.investigation.procedure import Course, Listener, Run, Step, pursue
from gyrowheel.recordings.inputs import Recordings, opened
from gyrowheel.show.result import Result
from gyrowheel.simulation.code_identity import code_identity
from gyrowheel.simulation.scenario import scenario
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.cache import digest
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import json_text, new_folder, read_text
from gyrowheel_core.journal import Journal, Work, begun, journal
from gyrowheel_recording.bags.metadata import files_of, hashed

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel.models.api import Model
    from gyrowheel_sim.effects import Effect
    from gyrowheel_sim.plant.scenario import Scenario

KIND = "investigation"
_KEY = "key"  # in the journal: a digest of the key file


@dataclass(frozen=True, repr=False, kw_only=True)
class Investigation(Result, Course):
    """Outcome of `gyrowheel.investigate`: the fields of `gyrowheel.investigation.procedure.Course`, and these.

    Attributes
    ----------
    folder : Path
        Folder of the recordings.
    interrupted : bool
        Whether Ctrl-C ended it.
    keep : object
        Holds a temporary folder, which exists as long as this object.
    """

    folder: Path
    interrupted: bool = False
    keep: object = None

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The last diagnosis, of all recordings together; None if it was interrupted before the first."""
        return Diagnosis.of(self.steps[-1].diagnosis) if self.steps else None

    def headline(self) -> str:
        """Return how it ended."""
        return end_sentence(self)

    def page(self) -> Iterable[RenderableType]:
        """Return how it ended, the table of the steps and the last diagnosis."""
        return investigation_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel investigate --json``; SI units."""
        return self.to_json()

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the steps as columns, a row for each."""
        return {
            "plans": [", ".join(step.plans) for step in self.steps],
            "why": [step.why for step in self.steps],
            "minutes": [step.minutes for step in self.steps],
            "verdict": [step.diagnosis.verdict for step in self.steps],
            "named": [", ".join(f.name for f in step.diagnosis.effects) for step in self.steps],
        }

    def plot(self) -> Figure:
        """Return the picture of the last diagnosis as a matplotlib figure."""
        return super().plot() if self.diagnosis is None else self.diagnosis.plot()


def investigate(
    model: Model,
    recordings: Recordings = (),
    *,
    plans: Sequence[str | Path | Plan] | None = None,
    budget: float = 15.0,
    thorough: bool = False,
    averages: bool = False,
    effects: Mapping[str, Mapping[str, float]] | Sequence[str | Effect] = (),
    machine: int | None = None,
    seed: int = 0,
    blind: str | Path | None = None,
    nodes: bool = False,
    run: Run | None = None,
    folder: str | Path | None = None,
    resume: bool = False,
    listener: Listener | None = None,
    progress: Callable[[str], None] | None = None,
) -> Investigation:
    """Find the effects that a model lacks: run a test, diagnose, run the next test, until the verdict is settled.

    The diagnosis names the next test. The model is not changed.

    Parameters
    ----------
    model : Model
        The model.
    recordings : Recording, path or list, optional
        Existing recordings to start from.
    plans : sequence, optional
        First plans; ``quick`` if there are no recordings.
    budget : float
        Bench time that may be spent [min].
    thorough : bool
        Continue until every known effect would have shown at a usual size.
    averages : bool
        Use averages over whole revolutions only, for example where filters suppress faster signals.
    effects, machine, seed, blind
        The simulated machine; see `gyrowheel.simulate`.
    nodes : bool
        Run the plans in the graph of ROS nodes instead of simulating them at once.
    run : callable, optional
        Runs a plan on a user's bench and records it: takes plan, directory to create and number of the run.
    folder : str or Path, optional
        New directory for all recordings; by default a temporary one that is removed with the result.
    resume : bool
        Resume the investigation in `folder`: its recordings are diagnosed again, with the same result. Settings and
        code must be the same.
    listener : Listener, optional
        Receives the course of the investigation.
    progress : callable, optional
        Called with lines of text, if there is no listener.

    Returns
    -------
    Investigation
        Also after Ctrl-C, with the finished steps.

    Raises
    ------
    InputError
        If a name is unknown or a value out of range, there is nothing to start from or to resume, or the first plans
        exceed the budget.
    """
    if resume and folder is None:
        raise InputError("resume: needs the folder of the investigation")
    bench = model.stated_bench
    at_hand = [recording.path for recording in opened(recordings)]
    named = plans if plans is not None else [] if at_hand else ["quick"]
    first = [plan_for(plan, bench) for plan in named]
    key = None if blind is None else Path(blind)

    def hidden(plan: Plan, number: int) -> Scenario:
        name = f"{plan.name} {number}"  # every run has its own noise
        return scenario(bench, name, effects=effects, blind=key, seed=seed, machine=machine)

    if first and effects:
        hidden(first[0], 1)  # refuses bad effects before any file is written
    receiver = listener or _Quiet(progress or (lambda text: None))
    if run is None:
        run = _in_nodes(receiver, model, hidden) if nodes else _at_once(receiver, model, hidden)
    scratch = None if folder is not None else tempfile.TemporaryDirectory(prefix="gyrowheel-")
    place = Path(scratch.name if scratch is not None else folder or "")
    done = Course(model.origin, budget, averages=averages)
    work = _work(
        model,
        at_hand,
        named,
        effects,
        budget=budget,
        thorough=thorough,
        averages=averages,
        machine=machine,
        seed=seed,
        blind=None if key is None else str(key.absolute()),
        nodes=nodes,
    )
    interrupted = False
    try:
        with journal(place, work, resume=resume) as kept:
            once = _once(run, kept, key)
            steps = pursue(
                done, model.details, place, once, receiver, plans=first, at_hand=at_hand, thorough=thorough
            )
            for done in steps:  # noqa: B007, the last one is the result
                pass
    except KeyboardInterrupt:
        interrupted = True
    return Investigation.of(done, folder=place, interrupted=interrupted, keep=scratch)


def settings_of(folder: str | Path) -> dict[str, Any]:
    """Return the arguments of `investigate` of the investigation in a folder; ``model`` is a path."""
    found = begun(Path(folder), KIND).settings
    found["blind"] = None if found["blind"] is None else _near(found["blind"])
    for name in ("recordings", "plans"):
        found[name] = [_near(path) for path in found[name]]
    return found | {"model": _near(found["model"])}


def _work(
    model: Model,
    at_hand: Sequence[Path],
    plans: Sequence[str | Path | Plan],
    effects: Mapping[str, Mapping[str, float]] | Sequence[str | Effect],
    **settings: object,
) -> Work:
    """Return the settings that determine the results of an investigation."""
    items = (
        effects.items()
        if isinstance(effects, Mapping)
        else [effects]
        if isinstance(effects, str)
        else effects
    )
    believed = model.details.to_mapping()
    loaded = [plan if isinstance(plan, Plan) else Plan.load(plan) for plan in plans]
    return Work(
        kind=KIND,
        settings={
            "model": str(Path(model.origin).absolute()),
            "recordings": [str(path.absolute()) for path in at_hand],
            "plans": [plan.to_yaml() if isinstance(plan, Plan) else _whole(str(plan)) for plan in plans],
            "effects": [item if isinstance(item, str) else repr(item) for item in items],
            **settings,
        },
        contents={
            "model": digest(json_text(believed | {"history": []}), model.stated_bench.describe()),
            "plans": digest(*(plan.to_yaml() for plan in loaded)),
            "recordings": digest(*(_digest_of(path) for path in at_hand)),
        },
        versions=code_identity(),
    )


def _whole(plan: str) -> str:
    """Return the absolute path of a plan file; names of shipped plans unchanged."""
    return str(Path(plan).absolute()) if "\n" not in plan and Path(plan).is_file() else plan


def _near(path: str) -> str:
    """Return a path relative to the working directory if it is below it."""
    try:
        return str(Path(path).relative_to(Path.cwd()))
    except ValueError:
        return path


def _digest_of(recording: Path) -> str:
    """Return a digest of the files of a recording."""
    return digest(*(f"{own.name} {own.sha256}" for own in hashed(files_of(recording))))


def _once(run: Run, kept: Journal, key: Path | None) -> Run:
    """Return a function that runs a plan unless the journal has it; an incomplete recording is renamed."""
    finished = kept.finished()
    if key is not None and finished and finished.get(_KEY) != _key_digest(key):
        raise InputError(
            f"blind: {key} is not the key file with which the investigation in {kept.folder} began"
        )

    def go(plan: Plan, directory: Path, number: int) -> None:
        before = finished.get(directory.name)
        if before is not None and directory.is_dir():
            if before.get("recording") != _digest_of(directory):
                raise InputError(
                    f"{directory}: has changed since the investigation in {kept.folder} recorded it"
                )
            return
        if directory.exists():
            directory.rename(new_folder(directory.parent, f"{directory.name}-interrupted", 1))
        run(plan, directory, number)
        if key is not None:
            kept.finish(_KEY, _key_digest(key))
        kept.finish(directory.name, {"plan": plan.called, "recording": _digest_of(directory)})

    return go


def _key_digest(key: Path) -> str | None:
    return digest(read_text(key)) if key.exists() else None


class _Quiet:
    """A listener that reports lines of text."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say

    def begin(self, number: int, plans: Sequence[str], why: str) -> None:
        self._say(f"step {number}: {' and '.join(plans)}: {why}" if plans else f"step {number}: {why}")

    @contextlib.contextmanager
    def working(self, title: str) -> Iterator[Callable[[str], None]]:
        yield self._say

    @contextlib.contextmanager
    def advancing(self, title: str) -> Iterator[Callable[[float], None]]:
        self._say(title)
        yield lambda part: None

    def learned(self, step: Step) -> None:
        for sentence in step.learned:
            self._say(sentence)


def _at_once(listener: Listener, model: Model, hidden: Callable[[Plan, int], Scenario]) -> Run:
    """Return a function that simulates a plan; drag estimates in its recording use the model under test."""

    def run(plan: Plan, directory: Path, number: int) -> None:
        from gyrowheel.simulation.api import record_simulation

        with listener.advancing(f"plan {plan.name}") as advance:
            record_simulation(
                directory,
                model.stated_bench,
                hidden(plan, number),
                plan,
                model=model.details,
                progress=advance,
            )

    return run


def _in_nodes(listener: Listener, model: Model, hidden: Callable[[Plan, int], Scenario]) -> Run:
    """Return a function that runs a plan in the graph of nodes; its drag estimator uses the model under test."""

    def run(plan: Plan, directory: Path, number: int) -> None:
        from gyrowheel_bringup.graph import Graph

        with (
            Graph(
                plan,
                bench=model.bench_source,
                scenario=hidden(plan, number),
                model=model.details,
                record=directory,
            ) as graph,
            listener.advancing(f"plan {plan.name}") as advance,
        ):
            graph.run(progress=lambda p: advance(min(p.elapsed / p.duration, 1.0)))
            advance(1.0)

    return run
