"""What is on the workbench: opened recordings, the models one after another, and the work that is under way.

There is one desk, whatever browser looks at it: two pages show the same, and closing a page ends nothing.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gyrowheel.analysis import compare, diagnose
from gyrowheel.catalogue import own_effect
from gyrowheel.model import Model
from gyrowheel.recording import Recording
from gyrowheel.workbench.decimation import Envelope
from gyrowheel.workbench.shelf import Shelf
from gyrowheel_core.errors import InputError, one_line

if TYPE_CHECKING:
    from gyrowheel.results.comparison import Comparison
    from gyrowheel.results.diagnosis import Diagnosis
    from gyrowheel_sim.effects import Effect

#: What a recording is used for.
Role = Literal["fitted", "not used to fit"]
ROLES: tuple[Role, ...] = ("fitted", "not used to fit")


@dataclass(frozen=True)
class Opened:
    """A recording on the desk: what it is used for, and its signals ready to be drawn."""

    key: str
    recording: Recording
    role: Role
    signals: dict[str, Envelope]


@dataclass(frozen=True)
class Step:
    """A model, and what was found with it."""

    model: Model
    comparison: Comparison | None = None
    diagnosis: Diagnosis | None = None


@dataclass(frozen=True)
class Job:
    """What is under way: its title, its last line, and when it began."""

    title: str
    line: str = ""
    began: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class Trouble:
    """An error in a sentence, and the part of the page that caused it."""

    place: str
    sentence: str


class Ended(Exception):
    """The work was ended by the user."""


class Desk:
    """The state of the workbench; every method may be called from any thread.

    Parameters
    ----------
    shelf : Shelf
        The recordings that can be opened.
    model : Model
        The model to begin with.
    file : Path or None
        The file that it was read from.
    """

    def __init__(self, shelf: Shelf, model: Model, file: Path | None = None) -> None:
        self.shelf = shelf
        self.file = file
        self.version = 0
        self.opened: dict[str, Opened] = {}
        self.steps: list[Step] = [Step(model)]
        self.job: Job | None = None
        self.trouble: Trouble | None = None
        self.saved = ""
        self.closed = False
        self._ending = threading.Event()
        self._lock = threading.RLock()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="workbench")
        self._watchers: set[Callable[[], None]] = set()
        self._future: Future[None] | None = None

    # --- looking

    @property
    def step(self) -> Step:
        """The model as it is now, and what was found with it."""
        return self.steps[-1]

    def used(self, role: Role) -> list[Recording]:
        """Return the opened recordings of a role."""
        return [own.recording for own in list(self.opened.values()) if own.role == role]

    def watch(self, watcher: Callable[[], None]) -> Callable[[], None]:
        """Have a function called at every change; return what ends that."""
        self._watchers.add(watcher)
        return lambda: self._watchers.discard(watcher)

    # --- work

    def open(self, key: str, role: Role) -> None:
        """Open a recording, or change what it is used for."""
        if role not in ROLES:
            raise InputError(f"role: {role!r} is not allowed; allowed: {', '.join(ROLES)}")
        entry = self.shelf.find(key)

        def work(say: Callable[[str], None]) -> None:
            own = self.opened.get(key)
            if own is None:
                recording = Recording.open(entry.path)
                say("looking for spikes")
                samples = recording.measurement
                names = [name for name in samples.dtype.names or () if name not in ("stamp_ns", "sequence")]
                own = Opened(key, recording, role, {name: Envelope(samples[name]) for name in names})
            with self._lock:
                self.opened[key] = replace(own, role=role)
                self._forget_results()

        self._begin(f"opening {entry.name}", "recordings", work)

    def close(self, key: str) -> None:
        """Take a recording off the desk."""
        with self._lock:
            self._require_idle()
            if self.opened.pop(key, None) is not None:
                self._forget_results()
        self._changed()

    def diagnose(self) -> None:
        """Compare the model with the opened recordings, and find what it lacks."""
        fitted, unused = self._data()

        def work(say: Callable[[str], None]) -> None:
            model = self.step.model
            found = compare(fitted, model, progress=say)
            self._now(replace(self.step, comparison=found, diagnosis=None))
            self._now(replace(self.step, diagnosis=diagnose(fitted, model, validate=unused, progress=say)))

        self._begin("diagnosing", "missing", work)

    def add(self, what: str, *, formula: bool = False) -> None:
        """Add an effect of the library, or one of the user's own, to the model and fit it."""
        fitted, unused = self._data()
        item: str | Effect = self.own(what) if formula else what

        def work(say: Callable[[str], None]) -> None:
            model = self.step.model.add(item, fit=fitted, validate=unused, progress=say)
            found = compare(fitted, model, progress=say)
            with self._lock:
                self.steps.append(Step(model, found))

        name = item if isinstance(item, str) else item.name
        self._begin(f"adding {name}", "formula" if formula else "missing", work)

    def own(self, formula: str) -> Effect:
        """Return the effect that a formula declares.

        Raises
        ------
        InputError
            If it cannot be read, or its units do not agree.
        """
        return own_effect(formula, taken=self.step.model.effects, where="formula")

    def undo(self) -> None:
        """Return to the model before its last change."""
        with self._lock:
            self._require_idle()
            if len(self.steps) > 1:
                self.steps.pop()
            else:
                self.steps = [Step(self.step.model.undo())]
            self.trouble, self.saved = None, ""
        self._changed()

    def save(self, name: str) -> Path:
        """Write the model into the folder of its file, or of the recordings.

        Raises
        ------
        InputError
            If the name is none of a model file, or the file is there and is not the one that was opened.
        """
        folder = self.shelf.first if self.file is None else self.file.parent
        if not name.endswith(".yaml") or not all(c.isalnum() or c in "._-" for c in name) or name[0] == ".":
            raise InputError(f"name: {name!r} is not allowed; allowed: letters, digits, _ and -, then .yaml")
        path = folder / name
        if path.exists() and (self.file is None or path.resolve() != self.file.resolve()):
            raise InputError(f"name: {path} exists; choose another one")
        with self._lock:
            self._require_idle()
            self.step.model.save(path)
            self.saved = str(path)
        self._changed()
        return path

    def end(self) -> None:
        """End the work that is under way, at its next line."""
        self._ending.set()

    def wait(self, seconds: float) -> None:
        """Wait until nothing is under way."""
        if self._future is not None:
            self._future.result(seconds)

    def shut(self) -> None:
        """End everything: the work at its next line, and what waits for changes."""
        self.closed = True
        self.end()
        self._changed()
        self._worker.shutdown(wait=True, cancel_futures=True)

    # --- within

    def _data(self) -> tuple[Sequence[Recording], Sequence[Recording]]:
        fitted = self.used("fitted")
        if not fitted:
            raise InputError("recordings: none is open to fit; open one on the left")
        return fitted, self.used("not used to fit")

    def _begin(self, title: str, place: str, work: Callable[[Callable[[str], None]], None]) -> None:
        with self._lock:
            self._require_idle()
            self._ending.clear()
            self.job, self.trouble, self.saved = Job(title), None, ""
        self._changed()
        self._future = self._worker.submit(self._run, place, work)

    def _run(self, place: str, work: Callable[[Callable[[str], None]], None]) -> None:
        trouble = None
        try:
            self._say("")
            work(self._say)
        except Ended:
            trouble = Trouble(place, "ended")
        except InputError as error:
            trouble = Trouble(place, str(error))
        except Exception as error:  # a defect of ours: the page says so and goes on
            trouble = Trouble(place, f"{type(error).__name__}: {one_line(error)}")
        with self._lock:
            self.job, self.trouble = None, trouble
        self._changed()

    def _say(self, line: str) -> None:
        if self._ending.is_set():
            raise Ended
        with self._lock:
            if self.job is not None:
                self.job = replace(self.job, line=line)
        self._changed()

    def _now(self, step: Step) -> None:
        with self._lock:
            self.steps[-1] = step
        self._changed()

    def _forget_results(self) -> None:
        """Keep the model; what was found belongs to other recordings."""
        self.steps = [Step(self.step.model)]

    def _require_idle(self) -> None:
        if self.job is not None:
            raise InputError(f"busy: {self.job.title}; end it first")

    def _changed(self) -> None:
        with self._lock:
            self.version += 1
        for watcher in list(self._watchers):
            watcher()
