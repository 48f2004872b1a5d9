"""The whole loop: hide an effect, record, compare, diagnose, add, validate, and only then open the key."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gyrowheel as gw
from gyrowheel.blind_tests.judge import RIGHT, Judgement, judge
from gyrowheel.cli.console import Tour, advancing, working
from gyrowheel.simulation.scenario import noise_seed, scenario
from gyrowheel_core.files import disk_errors, new_folder
from gyrowheel_core.quantities import seconds

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel_sim.bench import Bench
    from gyrowheel_sim.effects import EffectValues
    from gyrowheel_sim.plant.scenario import Scenario

PLAN, VALIDATION_PLAN = "quick", "check"
#: Size of the hidden effect in detection limits, and the seeds that are tried until one reaches it.
_CLEAR, _TRIALS, _NEXT_SEED = 2.0, 50, 1000


@dataclass(frozen=True)
class Files:
    """Paths of the results, in the order in which they are written."""

    recording: Path
    validation_recording: Path
    model: Path
    report: Path
    report_picture: Path
    key: Path

    @classmethod
    def of(cls, folder: Path) -> Files:
        """Return the paths of the results in a folder."""
        names = (PLAN, VALIDATION_PLAN, "model.yaml", "report.html", "report.png", "key.json")
        return cls(*(folder / name for name in names))

    def all(self) -> dict[str, Path]:
        """Return all paths by name."""
        return vars(self)


@dataclass(frozen=True)
class Outcome:
    """Outcome of the demonstration."""

    diagnosis: gw.Diagnosis
    addition: gw.Addition | None
    truth: EffectValues
    judgement: Judgement
    files: Files
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return the outcome as a JSON object."""
        table = self.diagnosis.error if self.addition is None else self.addition.error
        return {
            "schema": 1,
            "verdict": self.diagnosis.verdict,
            "named": [finding.name for finding in self.diagnosis.effects],
            "hidden": self.truth,
            "outcome": self.judgement.outcome if self.judgement.outcome in RIGHT else "wrong",
            "right": self.judgement.right,
            "error": None if table is None else table.to_json(),
            "paths": {name: str(path) for name, path in self.files.all().items()},
            "seconds": self.seconds,
        }

    def page(self) -> Iterator[RenderableType]:
        """Yield a table of the files, and the duration."""
        from gyrowheel.show.layout import words_table

        table = words_table("", "")
        for name, path in self.files.all().items():
            table.add_row(name.replace("_", " "), str(path))
        yield from ("", table, f"\n{seconds(self.seconds)} in all")


def demonstrate(seed: int, folder: Path, tour: Tour) -> Outcome:
    """Run the demonstration, with all results in a new folder.

    The seed is that of the hidden machine, its effect, and the noise of both recordings. InputError if the folder
    cannot be written, GraphError if a node fails.
    """
    begin = time.monotonic()
    files = Files.of(folder)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    _record(seed, files, tour)
    found = _diagnose(files, tour)
    better = _add(found, files, tour)
    better = _validate(found, better, seed, files, tour)
    _report(found, better, files, tour)
    truth, judgement = _open_key(found, files, tour)
    added = None if better is None else better.added
    return Outcome(found, added, truth, judgement, files, time.monotonic() - begin)


def _record(seed: int, files: Files, tour: Tour) -> None:
    """Draw the hidden machine and record the first plan."""
    tour.step("A machine with a hidden effect")
    tour.say(
        "A simulated wheel is drawn at random: its parameters differ from those of the bench file, and one "
        "effect is hidden in it, which the model lacks and the test can show. Only "
        f"{files.key.name} says what was drawn; it is not read before the end."
    )
    machine = _machine(seed, PLAN, files.key)
    tour.step(f"The bench runs plan {PLAN}, and is recorded")
    gw.Model().save(files.model)
    _run_graph(PLAN, machine, files.recording, files.model, tour)


def _machine(seed: int, plan: str, key: Path) -> Scenario:
    from gyrowheel_sim.bench import Bench

    bench = Bench.load()
    # one seed gives noise and key; an effect that the first plan cannot show would demonstrate nothing
    drawn = seed if key.exists() else _detectable_seed(bench, seed)
    hidden = scenario(bench, plan, blind=key, kinds=("single",), seed=drawn)
    return replace(hidden, noise_seed=noise_seed(seed, plan))


def _detectable_seed(bench: Bench, seed: int) -> int:
    """Return the first of this seed and its successors whose effect the first plan can show."""
    from gyrowheel.campaigns.hidden import Yardstick
    from gyrowheel_control.plans.plan import Plan
    from gyrowheel_sim.blind import draw

    yardstick = Yardstick(bench, Plan.load(PLAN))
    for other in range(seed, seed + _TRIALS * _NEXT_SEED, _NEXT_SEED):
        ((name, values),) = draw(bench, other, kinds=("single",)).effects.items()
        if yardstick.size(name, values, 1.0, {}) >= _CLEAR:
            return other
    return seed


def _run_graph(plan: str, machine: Scenario, recording: Path, model: Path, tour: Tour) -> None:
    from gyrowheel_bringup.graph import Graph

    # the drag estimator believes the model under test
    with Graph(plan, scenario=machine, model=model, record=recording) as graph:
        pids = "   ".join(f"{name} {pid}" for name, pid in graph.pids.items())
        tour.say(f"five processes over ROS 2: {pids}", style="dim")
        with advancing(f"plan {plan}") as advance:
            result = graph.run(progress=lambda p: advance(min(p.elapsed / p.duration, 1.0)))
            advance(1.0)
    tour.say(
        f"{result.simulated_seconds:.1f} s of bench time in {result.wall_seconds:.1f} s "
        f"({result.ratio:.1f} times real time); {result.samples} samples recorded, none missing"
    )


def _diagnose(files: Files, tour: Tour) -> gw.Diagnosis:
    """Compare the model with the first recording, and diagnose it."""
    from gyrowheel.comparison.page import channel_table, failures
    from gyrowheel.diagnosis.page import detection_limits, findings

    model = gw.Model.load(files.model)
    tour.step("Model against recording: where does it fail?")
    with working("comparing") as say:
        compared = gw.compare(files.recording, model, progress=say)
    tour.show([channel_table(compared)])
    tour.show(failures(compared.where, compared.dependence, failing=compared.fails))
    tour.step("What is missing?")
    with working("diagnosing") as say:
        found = gw.diagnose(files.recording, model, progress=say)
    tour.show([*findings(found), *detection_limits(found.limits)])
    return found


def _add(found: gw.Diagnosis, files: Files, tour: Tour) -> gw.Model | None:
    """Return the model with the findings; None without findings."""
    from gyrowheel.show.error_table import fall

    names = [finding.name for finding in found.effects]
    tour.step(f"Add {' and '.join(names)} to the model" if names else "Nothing to add to the model")
    if not names:
        tour.say("The model is unchanged: the bench as its file describes it.")
        return None
    with working("fitting") as say:
        better = gw.Model.load(files.model).add(names, fit=files.recording, progress=say)
    assert better.added is not None
    error = better.added.error
    better.save(files.model)
    tour.say(fall(error.before, error.after, error.noise_floor, "the fitted recording"))
    return better


def _validate(
    found: gw.Diagnosis, better: gw.Model | None, seed: int, files: Files, tour: Tour
) -> gw.Model | None:
    """Record once more and predict; return the better model with the errors on the new recording."""
    from gyrowheel.comparison.page import channel_table
    from gyrowheel.show.error_table import error_table
    from gyrowheel.show.sentences.proof import proof_line

    tour.step(f"Test on unseen data: the same machine, plan {VALIDATION_PLAN}, new noise, nothing fitted")
    machine = _machine(seed, VALIDATION_PLAN, files.key)
    _run_graph(VALIDATION_PLAN, machine, files.validation_recording, files.model, tour)
    if better is None:
        with working("comparing") as say:
            compared = gw.compare(files.validation_recording, gw.Model.load(files.model), progress=say)
        tour.show([channel_table(compared)])
        return None
    with working("predicting") as say:
        # the same fit again, from the model before it, so that the history includes the validation
        names = [finding.name for finding in found.effects]
        before = gw.Model.load(files.model).undo()
        proven = before.add(names, fit=files.recording, validate=files.validation_recording, progress=say)
    assert proven.added is not None
    proven.save(files.model)
    added = proven.added
    tour.show([error_table(added.error), proof_line(added.proof, added.error)])
    return proven


def _report(found: gw.Diagnosis, better: gw.Model | None, files: Files, tour: Tour) -> None:
    from gyrowheel.diagnosis.page import adding, diagnosing
    from gyrowheel.show.figure import write_figure

    tour.step("Report")
    latest = gw.Model.load(files.model)
    commands = ["gyrowheel model new --model wheel.yaml", diagnosing([files.recording], Path("wheel.yaml"))]
    if better is not None:
        names = [finding.name for finding in found.effects]
        commands.append(adding(names, [files.recording], [files.validation_recording], Path("wheel.yaml")))
    with working("writing") as say:
        report = gw.Report.around(
            found,
            gw.Model(latest.bench_source),
            [gw.Recording.open(files.recording)],
            [gw.Recording.open(files.validation_recording)],
            better=None if better is None else gw.Model.of(latest.details, better.added),
            commands=commands,
            progress=say,
        )
        report.save(files.report)
        if found.error is not None:
            write_figure(report.figure(), files.report_picture)
    tour.say(f"report: {files.report}   picture: {files.report_picture.name}")


def _open_key(found: gw.Diagnosis, files: Files, tour: Tour) -> tuple[EffectValues, Judgement]:
    from rich.panel import Panel
    from rich.text import Text

    from gyrowheel.blind_tests.page import truth_table

    tour.step("Only now: the key")
    truth = dict(gw.open_key(files.key).hidden.effects)
    judgement = judge(found, truth)
    colour = "green" if judgement.right else "red"
    panel = Panel(Text(judgement.sentence, style="bold"), border_style=colour, expand=False)
    tour.show([truth_table(truth, found), Text(), panel])
    return truth, judgement


def folder_for(seed: int, parent: Path) -> Path:
    """Return a folder for the results of a seed that does not exist yet."""
    first = parent / f"demo-{seed}"
    return new_folder(parent, first.name, 2) if first.exists() else first
