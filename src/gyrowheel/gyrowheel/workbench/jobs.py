"""Jobs of the workbench: one at a time, in threads; their progress, and how they are ended."""

from __future__ import annotations

import contextlib
import ctypes
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from gyrowheel_core.errors import InputError, one_line


@dataclass(frozen=True)
class Job:
    """The running job: title, latest line, fraction done if known, and when it began [s, monotonic clock]."""

    title: str
    line: str = ""
    part: float | None = None
    began: float = field(default_factory=time.monotonic)


@dataclass(frozen=True)
class Trouble:
    """An error in a sentence, and the part of the page that caused it."""

    place: str
    sentence: str


class Ended(Exception):
    """The job was ended by the user."""


class Jobs:
    """Runs one job at a time and tells its watchers of every change; every method may be called from any thread.

    A calculation cannot be stopped in the middle: an ended job runs unseen to its next line, and changes nothing more.
    """

    def __init__(self) -> None:
        self.version = 0
        self.job: Job | None = None
        self.trouble: Trouble | None = None
        self.lock = threading.RLock()
        self._work: Work | None = None
        self._threads: list[threading.Thread] = []
        self._watchers: set[Callable[[], None]] = set()

    def watch(self, watcher: Callable[[], None]) -> Callable[[], None]:
        """Have a function called at every change; return the function that ends this."""
        self._watchers.add(watcher)
        return lambda: self._watchers.discard(watcher)

    def changed(self) -> None:
        """Tell all watchers of a change."""
        with self.lock:
            self.version += 1
        for watcher in list(self._watchers):
            watcher()

    def begin(self, title: str, place: str, run: Callable[[Work], None]) -> None:
        """Start a job; errors are shown in a part of the page.

        Raises
        ------
        InputError
            If another job is running.
        """
        with self.lock:
            self.require_idle()
            self.job, self.trouble = Job(title), None
            self._work = work = Work(self, place)
            self._threads = [each for each in self._threads if each.is_alive()]
            thread = threading.Thread(target=self._run, args=(work, run), daemon=True)
            self._threads.append(thread)
            thread.start()
        self.changed()

    def require_idle(self) -> None:
        """Raise InputError if a job is running."""
        if self.job is not None:
            raise InputError(f"busy: {self.job.title}; end it first")

    def show(self, line: str, part: float | None) -> None:
        """Show the latest line of the job, and the fraction done."""
        if self.job is not None:
            self.job = replace(self.job, line=line, part=part)

    def end(self) -> None:
        """End the job at once; its finished changes stay."""
        with self.lock:
            if self._work is not None:
                self._finish(self._work, Trouble(self._work.place, "ended"))
        self.changed()

    def wait(self, seconds: float) -> None:
        """Wait until every job has stopped, also those that were ended; TimeoutError if one does not stop."""
        until = time.monotonic() + seconds
        for thread in list(self._threads):
            thread.join(max(until - time.monotonic(), 0.0))
            if thread.is_alive():
                raise TimeoutError(f"the work goes on after {seconds:g} s")

    def _run(self, work: Work, run: Callable[[Work], None]) -> None:
        trouble = None
        try:
            run(work)
        except Ended:  # which is shown already
            pass
        except InputError as error:
            trouble = Trouble(work.place, str(error))
        except Exception as error:  # an internal error: the page shows it and continues
            trouble = Trouble(work.place, f"{type(error).__name__}: {one_line(error)}")
        with self.lock:
            self._finish(work, trouble)
        self.changed()
        give_back_memory()

    def _finish(self, work: Work, trouble: Trouble | None) -> None:
        if not work.ended:
            work.ended, self._work, self.job, self.trouble = True, None, None, trouble


class Work:
    """What a job reports to; every method raises `Ended` once the user has ended the job."""

    def __init__(self, jobs: Jobs, place: str) -> None:
        self._jobs = jobs
        self.place = place
        self.ended = False

    def say(self, line: str) -> None:
        """Show the next line, and give the memory of the previous step back."""
        give_back_memory()
        self.change(lambda: self._jobs.show(line, None))

    def advancing(self, line: str) -> Callable[[float], None]:
        """Return a function that shows the fraction done, in steps of a hundredth."""
        shown = -1

        def advance(part: float) -> None:
            nonlocal shown
            if int(100 * part) != shown:
                shown = int(100 * part)
                self.change(lambda: self._jobs.show(line, part))

        return advance

    def change(self, what: Callable[[], None]) -> None:
        """Call a function that changes the session."""
        with self._jobs.lock:
            if self.ended:
                raise Ended
            what()
        self._jobs.changed()


def give_back_memory() -> None:
    """Return freed memory to the operating system, where the C library can: it keeps the most that was ever used."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
