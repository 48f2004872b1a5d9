"""The whole loop at once: hide an effect, record, compare, diagnose, add, validate, and only then open the key."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from gyrowheel.blind_tests.judge import Judgement, hidden_effects, judge
from gyrowheel_core.files import disk_errors

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel_analysis.add import Added
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_sim.bench import Bench

PLAN, VALIDATION_PLAN = "quick", "check"
#: Detection limits that the hidden effect has at least, and the seeds that are tried until one has.
_CLEAR, _TRIALS, _NEXT_SEED = 2.0, 50, 1000


class Stage(Protocol):
    """The display of the demonstration."""

    def step(self, text: str) -> None:
        """Begin the next step."""

    def show(self, parts: Iterable[RenderableType]) -> None:
        """Show a result of the current step."""

    def advancing(self, title: str) -> AbstractContextManager[Callable[[float], None]]:
        """Show the progress of an operation."""

    def working(self, title: str) -> AbstractContextManager[Callable[[str], None]]:
        """Show that an operation is under way."""


@dataclass(frozen=True)
class Place:
    """Paths of the results."""

    folder: Path

    @property
    def recording(self) -> Path:
        """The recording that the diagnosis sees."""
        return self.folder / PLAN

    @property
    def validation(self) -> Path:
        """The recording that is only predicted."""
        return self.folder / VALIDATION_PLAN

    @property
    def model(self) -> Path:
        """The model file."""
        return self.folder / "model.yaml"

    @property
    def picture(self) -> Path:
        """The report picture."""
        return self.folder / "report.png"

    @property
    def report(self) -> Path:
        """The report."""
        return self.folder / "report.html"

    @property
    def key(self) -> Path:
        """The key file."""
        return self.folder / "key.json"

    def all(self) -> dict[str, Path]:
        """Return all paths by name, in the order in which they are written."""
        return {
            "recording": self.recording,
            "validation recording": self.validation,
            "model": self.model,
            "report": self.report,
            "report picture": self.picture,
            "key": self.key,
        }


@dataclass(frozen=True)
class Outcome:
    """Outcome of the demonstration."""

    diagnosis: Diagnosis
    added: Added | None
    truth: dict[str, dict[str, float]]
    judgement: Judgement
    place: Place
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return the outcome as a JSON object."""
        table = self.added.error if self.added is not None else self.diagnosis.error
        return {
            "schema": 1,
            "verdict": self.diagnosis.verdict,
            "named": [finding.name for finding in self.diagnosis.effects],
            "hidden": self.truth,
            "outcome": self.judgement.outcome,
            "right": self.judgement.right,
            "error": None if table is None else table.to_json(),
            "paths": {name.replace(" ", "_"): str(path) for name, path in self.place.all().items()},
            "seconds": self.seconds,
        }


def demonstrate(seed: int, folder: Path, stage: Stage) -> Outcome:
    """Run the demonstration.

    Parameters
    ----------
    seed : int
        Seed of the hidden machine, its effect, and the noise of both recordings.
    folder : Path
        New folder for all results.
    stage : Stage
        Display of the demonstration.

    Raises
    ------
    InputError
        If the folder cannot be written.
    GraphError
        If a node fails.
    """
    begin = time.monotonic()
    place = Place(folder)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    _hide_and_record(seed, place, stage)
    _compare(place, stage)
    diagnosis = _diagnose(place, stage)
    added = _add(diagnosis, place, stage)
    added = _validate(diagnosis, added, seed, place, stage)
    _report(diagnosis, added, place, stage)
    truth, judgement = _open_key(diagnosis, place, stage)
    return Outcome(diagnosis, added, truth, judgement, place, time.monotonic() - begin)


def _hide_and_record(seed: int, place: Place, stage: Stage) -> None:
    from rich.text import Text

    from gyrowheel_analysis.model import Model

    stage.step("A machine with a hidden effect")
    stage.show(
        [
            Text(
                "A simulated wheel is drawn at random: its parameters differ from those of the bench file, and one "
                "effect is hidden in it, which the model lacks and the test can show. Only "
                f"{place.key.name} says what was drawn; it is not read before the end."
            )
        ]
    )
    scenario = _machine(seed, PLAN, place.key)
    stage.step(f"The bench runs plan {PLAN}, and is recorded")
    Model.new().save(place.model)
    _run_graph(PLAN, scenario, place.recording, place.model, stage)


def _machine(seed: int, plan: str, key: Path) -> Any:
    from gyrowheel.simulation.scenario import noise_seed, scenario
    from gyrowheel_sim.bench import Bench

    bench = Bench.load()
    # one seed gives noise and key; an effect that the first plan cannot show would demonstrate nothing
    drawn = seed if key.exists() else _detectable_seed(bench, seed)
    hidden = scenario(bench, plan, blind=key, kinds=("single",), seed=drawn)
    return replace(hidden, noise_seed=noise_seed(seed, plan))


def _detectable_seed(bench: Bench, seed: int) -> int:
    """Return the first seed, of this one and others that follow from it, whose effect the first plan can show."""
    from gyrowheel.campaigns.hidden import Yardstick
    from gyrowheel_control.plans.plan import Plan
    from gyrowheel_sim.blind import draw

    yardstick = Yardstick(bench, Plan.load(PLAN))
    for other in range(seed, seed + _TRIALS * _NEXT_SEED, _NEXT_SEED):
        ((name, values),) = draw(bench, other, kinds=("single",)).effects.items()
        if yardstick.size(name, values, 1.0, {}) >= _CLEAR:
            return other
    return seed


def _run_graph(plan: str, scenario: Any, recording: Path, model: Path, stage: Stage) -> None:
    from rich.text import Text

    from gyrowheel_bringup.graph import Graph

    # the drag estimator believes the model under test
    with Graph(plan, scenario=scenario, model=model, record=recording) as graph:
        pids = "   ".join(f"{name} {pid}" for name, pid in graph.pids.items())
        stage.show([Text(f"five processes over ROS 2: {pids}", style="dim")])
        with stage.advancing(f"plan {plan}") as advance:
            result = graph.run(progress=lambda p: advance(min(p.elapsed / p.duration, 1.0)))
            advance(1.0)
    stage.show(
        [
            Text(
                f"{result.simulated_seconds:.1f} s of bench time in {result.wall_seconds:.1f} s "
                f"({result.ratio:.1f} times real time); {result.samples} samples recorded, none missing"
            )
        ]
    )


def _compare(place: Place, stage: Stage) -> None:
    from gyrowheel.comparison.page import channel_table, failures
    from gyrowheel_analysis.compare import compare
    from gyrowheel_analysis.model import Model
    from gyrowheel_recording.bags import Recording

    stage.step("Model against recording: where does it fail?")
    with stage.working("comparing") as say:
        found = compare([Recording.open(place.recording)], Model.load(place.model), progress=say)
    stage.show([channel_table(found)])
    stage.show(failures(found.where, found.dependence, failing=found.fails))


def _diagnose(place: Place, stage: Stage) -> Diagnosis:
    from gyrowheel.diagnosis.page import detection_limits, findings
    from gyrowheel_analysis.diagnosis.diagnose import diagnose
    from gyrowheel_analysis.model import Model
    from gyrowheel_recording.bags import Recording

    stage.step("What is missing?")
    with stage.working("diagnosing") as say:
        found = diagnose([Recording.open(place.recording)], Model.load(place.model), progress=say)
    stage.show([*findings(found), *detection_limits(found.limits)])
    return found


def _add(diagnosis: Diagnosis, place: Place, stage: Stage) -> Added | None:
    from rich.text import Text

    from gyrowheel.show.error_table import fall
    from gyrowheel_analysis.add import add_effect
    from gyrowheel_analysis.model import Model
    from gyrowheel_recording.bags import Recording

    names = [finding.name for finding in diagnosis.effects]
    stage.step(f"Add {' and '.join(names)} to the model" if names else "Nothing to add to the model")
    if not names:
        stage.show([Text("The model is unchanged: the bench as its file describes it.")])
        return None
    with stage.working("fitting") as say:
        added = add_effect(Model.load(place.model), names, [Recording.open(place.recording)], progress=say)
    added.model.save(place.model)
    stage.show(
        [Text(fall(added.error.before, added.error.after, added.error.noise_floor, "the fitted recording"))]
    )
    return added


def _validate(
    diagnosis: Diagnosis, added: Added | None, seed: int, place: Place, stage: Stage
) -> Added | None:
    """Record once more and predict; return what was added with the errors on the new recording."""
    from gyrowheel.comparison.page import channel_table
    from gyrowheel.show.error_table import error_table
    from gyrowheel.show.sentences.proof import proof_line
    from gyrowheel_analysis.add import add_effect
    from gyrowheel_analysis.compare import compare
    from gyrowheel_analysis.model import Model
    from gyrowheel_recording.bags import Recording

    stage.step(f"Proof: the same machine, plan {VALIDATION_PLAN}, new noise, nothing fitted")
    scenario = _machine(seed, VALIDATION_PLAN, place.key)
    _run_graph(VALIDATION_PLAN, scenario, place.validation, place.model, stage)
    unused = Recording.open(place.validation)
    model = Model.load(place.model)
    if added is None:
        with stage.working("comparing") as say:
            found = compare([unused], model, progress=say)
        stage.show([channel_table(found)])
        return None
    names = [finding.name for finding in diagnosis.effects]
    with stage.working("predicting") as say:
        # the same fit again, from the model before it, so that the history includes the validation
        proven = add_effect(model.undone(), names, [Recording.open(place.recording)], [unused], progress=say)
    proven.model.save(place.model)
    stage.show([error_table(proven.error), proof_line(proven.proof, proven.error)])
    return proven


def _report(diagnosis: Diagnosis, added: Added | None, place: Place, stage: Stage) -> None:
    from rich.text import Text

    from gyrowheel.diagnosis.api import Diagnosis as Found
    from gyrowheel.diagnosis.next_command import adding, diagnosing
    from gyrowheel.models.addition import Addition
    from gyrowheel.models.api import Model
    from gyrowheel.recordings.api import Recording
    from gyrowheel.report.api import Report
    from gyrowheel.show.figure import write_figure

    stage.step("Report")
    latest = Model.load(place.model)
    fresh = Model(latest.bench_source)
    commands = ["gyrowheel model new --model wheel.yaml", diagnosing([place.recording], Path("wheel.yaml"))]
    if added is not None:
        names = [finding.name for finding in diagnosis.effects]
        commands.append(adding(names, [place.recording], [place.validation], Path("wheel.yaml")))
    with stage.working("writing") as say:
        report = Report.around(
            Found.of(diagnosis),
            fresh,
            [Recording.open(place.recording)],
            [Recording.open(place.validation)],
            better=None if added is None else Model.of(latest.details, Addition.of(added)),
            commands=commands,
            progress=say,
        )
        report.save(place.report)
        if diagnosis.error is not None:
            write_figure(report.figure(), place.picture)
    stage.show([Text(f"report: {place.report}   picture: {place.picture.name}")])


def _open_key(
    diagnosis: Diagnosis, place: Place, stage: Stage
) -> tuple[dict[str, dict[str, float]], Judgement]:
    from rich.panel import Panel
    from rich.text import Text

    from gyrowheel.blind_tests.truth import truth_table

    stage.step("Only now: the key")
    truth = hidden_effects(place.key)
    judgement = judge(diagnosis, truth)
    colour = "green" if judgement.right else "red"
    stage.show(
        [
            truth_table(truth, diagnosis),
            Text(),
            Panel(Text(judgement.sentence, style="bold"), border_style=colour, expand=False),
        ]
    )
    return truth, judgement


def new_folder(seed: int, parent: Path) -> Path:
    """Return a folder for the results of a seed that does not exist yet."""
    first = parent / f"demo-{seed}"
    if not first.exists():
        return first
    number = 2
    while (folder := parent / f"demo-{seed}-{number}").exists():
        number += 1
    return folder
