"""Session of the workbench: opened recordings, the models in sequence, and the running job.

All browsers share one session: two pages show the same, and closing a page ends nothing.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from gyrowheel.catalogue.api import own_effect
from gyrowheel.comparison.api import Comparison, compare
from gyrowheel.diagnosis.api import Diagnosis, diagnose
from gyrowheel.diagnosis.looks import follow
from gyrowheel.drag_comparison.api import drag
from gyrowheel.models.api import Model, effects_to_add
from gyrowheel.recordings.api import Recording
from gyrowheel.workbench import tables
from gyrowheel.workbench.benches import LiveBenches, Running, SimulatedBench
from gyrowheel.workbench.coefficients import Estimates
from gyrowheel.workbench.derived import Channels
from gyrowheel.workbench.jobs import Jobs, Work
from gyrowheel.workbench.library import ROLES, USES, Library, Opened, Range, Role, Use, with_range
from gyrowheel.workbench.report import report_page
from gyrowheel.workbench.setpoints import Allowed, Setpoint
from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError, nearest
from gyrowheel_core.files import disk_errors, new_folder, read_beginning
from gyrowheel_core.locks import changing
from gyrowheel_sim.effects import Effect

#: Why a test cannot be run from here.
NO_BENCH = (
    "these recordings are not of a simulated bench; run the plan on your bench, and open its recording here"
)
#: The machine of the demonstration.
_DEMONSTRATION = SimulatedBench(effect=("aero_cross",), machine=6)
_LONGEST_NAME = 100  # bytes of the name of a model file
_HEAD, _MOST_FILES = 4096, 100  # bytes that tell a model file, and how many files are looked at
_PATIENCE = 30.0  # s in which an ended job must reach its next line


@dataclass(frozen=True)
class Step:
    """A model, and the results found with it."""

    model: Model
    comparison: Comparison | None = None  # with the fitted recordings
    #: Of the opened recordings, measured and predicted, by the key of the recording.
    holds: Mapping[str, tuple[Estimate, ...]] = field(default_factory=dict)
    diagnosis: Diagnosis | None = None
    estimates: Estimates | None = None  # of all parameters, once asked for
    #: Ranges of opened recordings with a use of their own, by the key of the recording: those of the results.
    ranges: Mapping[str, tuple[Range, ...]] = field(default_factory=dict)

    def only(self, model: Model) -> Step:
        """Return a model with the same ranges, and no results."""
        return Step(model, ranges=self.ranges)


@contextlib.contextmanager
def _removed_at_failure(file: Path) -> Iterator[None]:
    try:
        yield
    except BaseException:
        file.unlink(missing_ok=True)
        raise


class Session(Jobs):
    """State of the workbench, with the first model and its file; every method may be called from any thread."""

    def __init__(self, library: Library, model: Model, file: Path | None = None) -> None:
        super().__init__()
        self.library = library
        self.file = file
        self.facts = 0
        self.opened: dict[str, Opened] = {}
        self.steps: list[Step] = [Step(model)]
        self.undone: list[Step] = []  # the latest last
        self.saved = ""
        self.kept = model  # in its file
        self.report: str | None = None  # on the latest diagnosis, once written
        self.table: tables.Draft | None = None
        self.derived = Channels()
        self.others: dict[str, Comparison] = {}  # of the models of files, by their names
        self.closed = False
        self.live = LiveBenches(self.changed)
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        self._looks = 0
        self._own_files: set[Path] = set() if file is None else {file.resolve()}

    # --- looking

    @property
    def step(self) -> Step:
        """The latest model, and the results found with it."""
        return self.steps[-1]

    @property
    def previous(self) -> Step | None:
        """The latest step with another model on the same ranges; None without one."""
        now = self.step
        earlier = (own for own in reversed(self.steps) if own.model is not now.model)
        return next((own for own in earlier if own.ranges == now.ranges), None)

    def used(self, use: Use) -> list[Recording]:
        """Return the opened recordings of a use, and the parts of recordings."""
        return [recording for _, recording in self.keyed(use)]

    def keyed(self, use: Use) -> list[tuple[str, Recording]]:
        """Return what `used` does, each with the key of its recording."""
        ranges = self.step.ranges
        return [
            (own.key, part)
            for own in list(self.opened.values())
            for part in own.of_use(use, ranges.get(own.key, ()))
        ]

    def derive(self, text: str) -> None:
        """Show a derived channel with the signals, and as a variable of the residual."""
        with self.lock:
            self.derived.add(text)
            self.facts += 1
        self.changed()

    def underive(self, text: str) -> None:
        """Remove a derived channel."""
        with self.lock:
            self.derived.remove(text)
            self.facts += 1
        self.changed()

    # --- work

    def open(self, key: str, role: Role) -> None:
        """Open a recording, or change its use."""
        if role not in ROLES:
            raise InputError(f"role: {role!r} is not allowed; allowed: {', '.join(ROLES)}")
        entry = self.library.find(key)

        def work(at: Work) -> None:
            own = self.opened.get(key)
            if own is None:
                own = Opened.of(key, Recording.open(entry.path), role)
            self._take(replace(own, role=role), at)

        self._begin(f"opening {entry.name}", f"open {key}", work)

    def close(self, key: str) -> None:
        """Close a recording."""
        with self.lock:
            self.require_idle()
            if self.opened.pop(key, None) is not None:
                self._restart(key)
        self.changed()

    def use(self, key: str, begin: float, end: float, use: Use) -> None:
        """Set the use of a range of an open recording [s from its start]; results of other ranges are left behind."""
        own = self.opened.get(key)
        if own is None:
            raise InputError(f"recording {key!r}: is not open")
        if use not in USES:
            raise InputError(f"use: {use!r} is not allowed; allowed: {', '.join(USES)}")
        length = own.recording.duration
        first, last = round(begin, 3), round(end, 3)  # which a command can repeat
        if not (first < last and first < length and last > 0.0):
            raise InputError(
                f"range: {begin:g} to {end:g} s is not allowed; allowed: a later end than start, within 0 .. "
                f"{length:.3f} s"
            )
        new = Range(first if first > 0.0 else -math.inf, last if last < length else math.inf, use)
        self._set_ranges(own, with_range(own.uses(self.step.ranges.get(key, ())), new))

    def use_all(self, key: str) -> None:
        """Use all of an open recording again."""
        own = self.opened.get(key)
        if own is None:
            raise InputError(f"recording {key!r}: is not open")
        self._set_ranges(own, ())

    def _set_ranges(self, own: Opened, ranges: Sequence[Range]) -> None:
        others = {key: old for key, old in self.step.ranges.items() if key != own.key}
        kept = tuple(each for each in ranges if each.use != own.role)
        with self.lock:
            self.require_idle()
            now = others | ({own.key: kept} if kept else {})
            if now == self.step.ranges:
                return
            self._go([*self.steps, Step(self.step.model, ranges=now)])
            self.trouble, self.saved = None, ""
        self.changed()

    def compare(self) -> None:
        """Compare the model with the opened recordings, and predict their holds."""
        self._data_of_one_machine()
        self._begin("comparing", "missing", self._compare)

    def diagnose(self) -> None:
        """Compare the model with the opened recordings, and diagnose it."""
        self._data_of_one_machine()
        self._begin("diagnosing", "missing", self._diagnose)

    def follow(self, key: str) -> None:
        """Diagnose a recording while it is written, again with every hold, until it ends."""
        entry = self.library.find(key)
        if any(own.role == ROLES[0] for place, own in self.opened.items() if place != key):
            raise InputError("recordings: one that is being written is diagnosed alone; close those to fit")

        def work(at: Work) -> None:
            model, unused = self.step.model, self.used(ROLES[1])
            for look in follow(entry.path, model, validate=unused, progress=at.say):
                own = Opened.of(key, look.recording, ROLES[0]).with_description()
                at.change(lambda own=own: self._put(own))  # type: ignore[misc]
                found = compare([look.recording], model, progress=at.say)
                step = replace(self.step, comparison=found, diagnosis=look.diagnosis)
                step = replace(step, holds=self._holds(model, at))
                at.change(lambda step=step: self._keep([*self.steps[:-1], step]))  # type: ignore[misc]
                at.say(f"look {look.number}; the next one with the next hold")

        self._begin(f"diagnosing {entry.name} as it is written", f"open {key}", work)

    def model_files(self) -> list[str]:
        """Return the names of the other model files next to that of the model, or to the recordings."""
        try:
            files = sorted(own for own in self._folder.glob("*.yaml") if own != self.file and own.is_file())
            heads = [(own.name, read_beginning(own, _HEAD)) for own in files[:_MOST_FILES]]
        except (OSError, InputError):
            return []
        return [name for name, head in heads if re.search(rb"^bench:", head, re.MULTILINE)]

    def other(self, name: str) -> None:
        """Compare the model of another file with the fitted recordings, to be drawn over the results of the model."""
        fitted, _ = self._data_of_one_machine()
        if name not in (known := self.model_files()):
            raise InputError(f"model: {name[:60]!r} is no model file here; {nearest(name, known)}")

        def work(at: Work) -> None:
            found = compare(fitted, Model.load(self._folder / name), progress=at.say)
            at.change(lambda: self._take_other(name, found))

        self._begin(f"comparing {name}", "residual", work)

    def missing(self) -> list[str | Effect]:
        """Return all that the diagnosis found; empty where it cannot decide or finds nothing."""
        try:
            return [] if self.step.diagnosis is None else list(effects_to_add(self.step.diagnosis))
        except InputError:
            return []

    def estimate(self) -> None:
        """Estimate all parameters of the model, with what the diagnosis found, from recordings and stated values."""
        fitted, _ = self._data_of_one_machine()
        missing = self.missing()

        def work(at: Work) -> None:
            model = self.step.model
            if missing:
                model = model.add(missing, fit=fitted, progress=at.say)
            at.say("estimating all parameters")
            fit = model.fit(fitted, progress=at.say)
            added = tuple(name for name in model.effects if name not in self.step.model.effects)
            at.change(lambda: self._take_estimates(Estimates(fit, added)))

        self._begin("estimating", "coefficients", work)

    def profile(self, name: str) -> None:
        """Compute the profile of an estimated parameter."""
        own = self.step.estimates
        if own is None:
            raise InputError("parameters: nothing is estimated yet")
        own.fit.free(name)

        def work(at: Work) -> None:
            found = own.profiled(name, at.advancing("fitting all others"))
            at.change(lambda: self._take_estimates(replace(own, profiles={**own.profiles, name: found})))

        self._begin(f"profile of {name}", "coefficients", work)

    def _take_estimates(self, own: Estimates) -> None:
        self.steps = [*self.steps[:-1], replace(self.step, estimates=own)]
        self.facts += 1

    def _take_other(self, name: str, found: Comparison) -> None:
        self.others[name] = found
        self.facts += 1

    def add(self, what: str, *, formula: bool = False) -> None:
        """Add an effect of the library, or a user-defined formula, to the model and fit it."""
        self._add([self.own(what) if formula else what], "formula" if formula else "missing")

    def add_all(self) -> None:
        """Add all that the diagnosis found to the model and fit it."""
        if self.step.diagnosis is None:
            raise InputError("diagnosis: nothing is diagnosed yet")
        self._add(effects_to_add(self.step.diagnosis), "missing")

    def _add(self, items: Sequence[str | Effect], place: str) -> None:
        fitted, unused = self._data_of_one_machine()

        def work(at: Work) -> None:
            model = self.step.model.add(items, fit=fitted, validate=unused, progress=at.say)
            found = compare(fitted, model, progress=at.say)
            step = replace(self.step.only(model), comparison=found, holds=self._holds(model, at))
            at.change(lambda: self._go([*self.steps, step]))

        names = [item if isinstance(item, str) else item.name for item in items]
        self._begin(f"adding {' and '.join(names)}", place, work)

    def remove(self, name: str) -> None:
        """Remove an effect from the model; the other coefficients keep their values."""
        with self.lock:
            self.require_idle()
            self._go([*self.steps, self.step.only(self.step.model.remove(name))])
            self.trouble, self.saved = None, ""
        self.changed()

    def tests(self) -> list[str]:
        """Return the plans that the diagnosis names: the next test, and those that separate ties."""
        found = self.step.diagnosis
        if found is None:
            return []
        named = [] if found.next_test is None else [found.next_test.plan]
        ties = [tie.separating_plan for effect in found.effects for tie in effect.ties]
        ties += [tie.separating_plan for form in found.free_form for tie in form.ties]
        return list(dict.fromkeys([*named, *(plan for plan in ties if plan is not None)]))

    def test(self, plan: str, bench_key: str = "") -> None:
        """Run a test that the diagnosis names, open its recording, and diagnose again.

        `bench_key` is that of a running bench; empty: the simulated machine of the recordings.
        """
        fitted, _ = self._data()
        if plan not in self.tests():
            raise InputError(
                f"plan: {plan[:60]!r} is not what the diagnosis asks for; {nearest(plan, self.tests())}"
            )
        if bench_key:
            self._walk(plan, bench_key, "test")
            return
        bench = SimulatedBench.of(fitted)
        if bench is None:
            raise InputError(f"plan: {NO_BENCH}")

        def work(at: Work) -> None:
            self._record(bench, plan, "fitted", at)
            self._diagnose(at)

        self._begin(f"testing: {plan}", "test", work)

    def walk(self, plan: str, bench_key: str) -> None:
        """Run a shipped plan on a running bench, open its recording, and diagnose it."""
        if plan not in Plan.shipped():
            raise InputError(f"plan: {plan[:60]!r} is not known; {nearest(plan, Plan.shipped())}")
        self._walk(plan, bench_key, "live")

    def allowed(self, bench_key: str) -> Allowed:
        """Return the range of the setpoints of a running bench; that of the model's bench until it describes itself."""
        return self._running(bench_key).allowed or Allowed.of(self.step.model.bench)

    def setpoint(self, bench_key: str, asked: Setpoint, *, sure: bool) -> str:
        """Have a running bench go to a setpoint and hold it, if `sure`; return what happens, in a sentence."""
        running, now = self._running(bench_key), self.live.setpoint_of(bench_key)
        text = self.allowed(bench_key).plan(now, asked)
        seconds = Plan.load(text).duration

        def work(at: Work) -> None:
            self.live.walk(bench_key, text, None, at.advancing("on the way"), lambda: at.ended)

        if sure:
            self._begin(f"{running.title} to {asked.words()}", "setpoint", work)
        return (
            f"The {running.title} moves from {now.words()} to {asked.words()} in {seconds:.1f} s, and holds that. "
            "Nothing is recorded. End, in the first line of the page, stops it where it is."
        )

    def _running(self, bench_key: str) -> Running:
        running = self.live.runs.get(bench_key)
        if running is None:
            raise InputError(f"bench: {bench_key[:60]!r} does not run")
        return running

    def _walk(self, plan: str, bench_key: str, place: str) -> None:
        running = self._running(bench_key)
        self._begin(
            f"testing: {plan} on the {running.title}",
            place,
            lambda at: self._record_live(bench_key, plan, at),
        )

    def demonstrate(self) -> None:
        """Record two tests on a simulated machine with an effect that the model lacks, and open both."""

        def work(at: Work) -> None:
            for plan, role in (("quick", ROLES[0]), ("check", ROLES[1])):
                self._record(_DEMONSTRATION, plan, role, at)

        self._begin("making the demonstration", "recordings", work)

    def _record(self, bench: SimulatedBench, plan: str, role: Role, at: Work) -> None:
        folder = self._new_folder(plan)
        number = int(folder.name.rpartition("-")[2])
        bench.record(plan, folder, self.step.model, number, at.advancing(f"plan {plan} on the bench"))
        self._join(folder, role, at)

    def _record_live(self, key: str, plan: str, at: Work) -> None:
        folder = self._new_folder(plan)
        advance = at.advancing(f"plan {plan} on the bench")
        if self.live.walk(key, plan, folder, advance, lambda: at.ended):
            self._join(folder, ROLES[0], at)
            self._diagnose(at)

    def _join(self, folder: Path, role: Role, at: Work) -> None:
        at.say(f"opening {folder.name}")
        self._take(Opened.of(self.library.take(folder), Recording.open(folder), role), at)

    def _take(self, own: Opened, at: Work) -> None:
        """Open a recording: first its signals, then its summary."""
        at.change(lambda: self._put(own))
        if not own.described:
            at.say("summarising it")
            whole = own.with_description()
            at.change(lambda: self.opened.update({own.key: whole}))

    def _new_folder(self, name: str) -> Path:
        return new_folder(self.library.first, "".join(c if c.isalnum() else "-" for c in name), 1)

    # --- a table of another program

    def place_for(self, name: str) -> Path:
        """Return the file for a table from a browser."""
        with self.lock:
            self.require_idle()
            with disk_errors(Path(tempfile.gettempdir())):
                if self._scratch is None or not os.path.isdir(self._scratch.name):
                    self._scratch = tempfile.TemporaryDirectory(
                        prefix="gyrowheel-", ignore_cleanup_errors=True
                    )
                self._looks += 1
                folder = Path(self._scratch.name) / str(self._looks)
                folder.mkdir()
            return folder / tables.file_name(name)

    def look(self, file: Path) -> None:
        """Read a table and suggest a map for it; its file is removed with the draft."""
        number = self._looks

        def work(at: Work) -> None:
            self._drop()
            with _removed_at_failure(file):
                draft = tables.looked(number, file, self.step.model)
                at.change(lambda: setattr(self, "table", draft))

        with _removed_at_failure(file):
            self._begin(f"looking at {file.name}", "table", work)

    def map_table(self, given: Mapping[str, str], *, take: bool = False) -> None:
        """Correct the map of the table by a form and read it; with `take` make a recording of it and open that."""
        draft = self.table
        if draft is None:
            raise InputError("table: missing; choose a file")
        content = tables.corrected(draft, given)

        def read(at: Work) -> None:
            self._looks += 1
            again = tables.tried(draft, self._looks, content, self.step.model)
            at.change(lambda: setattr(self, "table", again))

        def import_it(at: Work) -> None:
            folder = self._new_folder(draft.name.partition(".")[0])
            tables.made(draft, content, folder)
            self._drop()
            self._join(folder, ROLES[0], at)

        title = f"making a recording of {draft.name}" if take else f"reading {draft.name}"
        self._begin(title, "table", import_it if take else read)

    def drop_table(self) -> None:
        """Remove the table."""
        with self.lock:
            self.require_idle()
            self._drop()
        self.changed()

    def _drop(self) -> None:
        """Remove the draft and its file."""
        draft, self.table = self.table, None
        if draft is not None:
            draft.file.unlink(missing_ok=True)

    def own(self, formula: str) -> Effect:
        """Return the effect that a formula declares."""
        return own_effect(formula, taken=self.step.model.effects, where="formula")

    def write_report(self) -> None:
        """Write the report on the diagnosis, with the commands that repeat it."""
        step = self.step
        if step.diagnosis is None:
            raise InputError("report: nothing is diagnosed yet")
        found, data, kept, file = step.diagnosis, self._data(), self.kept, self.file

        def work(at: Work) -> None:
            at.say("reading the files of the recordings, drawing")
            text = report_page(found, step.comparison, step.model, data, kept, file)
            at.change(lambda: setattr(self, "report", text))

        self._begin("writing the report", "missing", work)

    def undo(self) -> None:
        """Return to the model before its last change."""
        with self.lock:
            self.require_idle()
            last = self.step
            self._keep(self.steps[:-1] if len(self.steps) > 1 else [last.only(last.model.undo())])
            self.undone.append(last)
            self.trouble, self.saved = None, ""
        self.changed()

    def redo(self) -> None:
        """Return to the model before the last undo."""
        with self.lock:
            self.require_idle()
            if not self.undone:
                raise InputError("model: nothing to redo")
            self._keep([*self.steps, self.undone.pop()])
            self.trouble, self.saved = None, ""
        self.changed()

    def save(self, name: str) -> Path:
        """Write the model into the folder of its file, or of the recordings, as soon as no other process changes it.

        InputError for any name but that of a model file, or a file that exists and was neither opened nor saved here.
        """
        folder = self._folder
        letters = all(c.isalnum() or c in "._-" for c in name) and len(name.encode()) <= _LONGEST_NAME
        if not name.endswith(".yaml") or not letters or not name[0].isalnum():
            raise InputError(
                f"name: {name[:_LONGEST_NAME]!r} is not allowed; allowed: letters, digits, _ and -, then .yaml, "
                f"{_LONGEST_NAME} bytes at most, a letter or digit first"
            )
        path, model = folder / name, self.step.model

        def require_free() -> None:
            # a link that leads nowhere is there, too
            if os.path.lexists(path) and path.resolve() not in self._own_files:
                raise InputError(f"name: {path} exists; choose another one")

        def saved() -> None:
            self.file, self.saved, self.kept = path, str(path), model
            self.report = None  # its commands name another file
            self._own_files.add(path.resolve())

        def work(at: Work) -> None:
            with changing(path, waiting=lambda text: at.say(f"{text}; end this to save under another name")):
                at.change(require_free)  # nothing is written once the user has ended it
                model.save(path)
                at.change(saved)

        require_free()
        self._begin(f"saving {name}", "save", work)
        return path

    def shut(self) -> None:
        """End the session: its job, and the watchers."""
        self.closed = True
        self.end()
        with contextlib.suppress(TimeoutError):  # it ends with the program
            self.wait(_PATIENCE)
        if self._scratch is not None:
            self._scratch.cleanup()

    # --- within

    @property
    def _folder(self) -> Path:
        """The folder of model files."""
        return self.library.first if self.file is None else self.file.parent

    def _data(self) -> tuple[Sequence[Recording], Sequence[Recording]]:
        fitted = self.used("fitted")
        if not fitted:
            raise InputError("recordings: none is open to fit; open one on the left")
        return fitted, self.used("not used to fit")

    def _data_of_one_machine(self) -> tuple[Sequence[Recording], Sequence[Recording]]:
        """Return the recordings, which must not state different machines: the page has no way to mix them."""
        fitted, unused = self._data()
        stated = [own for own in (*fitted, *unused) if own.data.machine]
        for own in stated[1:]:
            if own.data.machine != stated[0].data.machine:
                raise InputError(
                    f"recordings: {own.name} is of machine {own.data.machine}, {stated[0].name} of machine "
                    f"{stated[0].data.machine}; close those of one machine on the left"
                )
        return fitted, unused

    def _begin(self, title: str, place: str, work: Callable[[Work], None]) -> None:
        with self.lock:
            self.require_idle()
            self.saved = ""
        self.begin(title, place, work)

    def _compare(self, at: Work) -> None:
        fitted, _ = self._data()
        model = self.step.model
        step = replace(self.step.only(model), comparison=compare(fitted, model, progress=at.say))
        at.change(lambda: self._keep([*self.steps[:-1], step]))
        holds = self._holds(model, at)
        at.change(lambda: self._keep([*self.steps[:-1], replace(step, holds=holds)]))

    def _diagnose(self, at: Work) -> None:
        try:
            self._compare(at)
        except InputError:  # the diagnosis gives the reason
            at.change(lambda: self._keep([*self.steps[:-1], self.step.only(self.step.model)]))
        fitted, unused = self._data()
        found = diagnose(fitted, self.step.model, validate=unused, progress=at.say)
        at.change(lambda: self._keep([*self.steps[:-1], replace(self.step, diagnosis=found)]))

    def _holds(self, model: Model, at: Work) -> dict[str, tuple[Estimate, ...]]:
        """Return the holds of all opened recordings as the model predicts them."""
        found = {}
        for own in list(self.opened.values()):
            at.say(f"predicting the holds of {own.recording.name}")
            with contextlib.suppress(InputError):  # no hold
                (found[own.key],) = drag(own.recording, model, signals=False).holds
        return found

    def _put(self, own: Opened) -> None:
        """Open a recording; the results, which belong to other recordings, are removed. The model stays."""
        self.opened[own.key] = own
        self._restart()

    def _restart(self, closed: str = "") -> None:
        """Keep model and ranges alone: results belong to the recordings that they were found with."""
        self.undone, self.others = [], {}
        ranges = {key: own for key, own in self.step.ranges.items() if key != closed}
        self._keep([Step(self.step.model, ranges=ranges)])

    def _go(self, steps: Sequence[Step]) -> None:
        """Keep steps with a new model at their end: what was undone before does not follow from it."""
        self.undone = []
        self._keep(steps)

    def _keep(self, steps: Sequence[Step]) -> None:
        self.steps, self.report = list(steps), None
        self.facts += 1
