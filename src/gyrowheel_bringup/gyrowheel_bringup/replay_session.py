"""A replay in this process, shown while it goes on, with the drag estimator beside it where it is wanted."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from gyrowheel_analysis.nodes.replay import ReplayNode
from gyrowheel_analysis.recording.playback import Tape
from gyrowheel_bringup.graph import EXECUTABLES, find_executable
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE, ExitCode, prepare_environment, run_node

_LOOK: Final = 0.1  # time between two looks at keys and companions [s]
_ESTIMATOR: Final = "drag_estimator"


@dataclass
class Outcome:
    """What a replay gave.

    Attributes
    ----------
    code : int
        Exit code of the node; 0 where it ended as it should.
    complete : bool
        Whether it came to the end.
    stopped : bool
        Whether the user ended it by a key.
    counts : dict of str to int
        Messages given back, by topic.
    rounds : int
        How often the end was reached.
    wall : float
        Seconds from the first message to the last.
    left_out : dict of str to str
        Topics that were not given back although the recording has them, and why.
    estimates : list of dict
        Fields of the drag estimates made on the way; empty without the estimator.
    """

    code: int = 0
    complete: bool = False
    stopped: bool = False
    counts: dict[str, int] = field(default_factory=dict)
    rounds: int = 0
    wall: float = 0.0
    left_out: dict[str, str] = field(default_factory=dict)
    estimates: list[dict[str, Any]] = field(default_factory=list)


def play(
    tape: Tape,
    parameters: Mapping[str, object],
    *,
    show: Callable[[ReplayNode], None],
    estimator: Mapping[str, object] | None = None,
    logs: bool = False,
) -> Outcome:
    """Replay a recording until its end, a key or a signal.

    Parameters
    ----------
    tape : Tape
        The recording; it is closed at the end.
    parameters : mapping
        Further parameters of the node `replay`.
    show : callable
        Called ten times a second with the node.
    estimator : mapping, optional
        Parameters of a drag estimator to run beside it; none runs if not given.
    logs : bool
        Whether what the nodes log goes to stderr.

    Raises
    ------
    InputError
        If the estimator says that its input is not allowed, or the executable of it is not installed.
    """
    outcome = Outcome()
    prepare_environment()
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="gyrowheel-")))
        companion = None
        if estimator is not None:
            companion = stack.enter_context(_companion(folder, estimator, logs=logs))
        keys = stack.enter_context(_keys())
        stack.enter_context(_signals_kept())

        class Shown(ReplayNode):
            """Gives a recording back to the graph."""

            def open_tape(self) -> Tape:
                return tape

            def activate(self) -> None:
                super().activate()
                self._begun: float | None = None
                self._looking = self.wall_timer(_LOOK, self._look)
                if companion is not None:
                    self._listening = self.subscription(
                        topics.DRAG_ESTIMATE,
                        lambda data: outcome.estimates.append(_fields(data)),
                        raw=True,
                    )

            def deactivate(self) -> None:
                self.destroy_timer(self._looking)
                super().deactivate()
                self._note()

            def on_finished(self) -> None:
                outcome.complete = True
                self._note()
                if companion is None:
                    self.stop()
                else:  # its end gives the last estimate
                    companion.send_signal(signal.SIGINT)

            def _look(self) -> None:
                if self._begun is None and any(self.counts.values()):
                    self._begun = time.monotonic()
                show(self)
                for key in keys():
                    self._obey(key)
                code = None if companion is None else companion.poll()
                if code is None:
                    return
                if not outcome.complete:
                    self.fault(f"{_ESTIMATOR}_ended", f"exit code {code}")
                self.stop()

            def _obey(self, key: str) -> None:
                if key == " ":
                    self.pause(not self.paused)
                elif key in ("s", "\n"):
                    self.step()
                elif key == "q":
                    outcome.stopped = True
                    self.stop()

            def _note(self) -> None:
                if self._begun is not None and not outcome.wall:
                    outcome.wall = time.monotonic() - self._begun
                outcome.counts, outcome.rounds = dict(self.counts), self.rounds
                outcome.left_out = {topic.name: why for topic, why in self.left_out.items()}

        file = folder / "replay.yaml"
        content = {"/replay": {"ros__parameters": {"directory": str(tape.path), **parameters}}}
        file.write_text(yaml.safe_dump(content), encoding="utf-8")
        level = "info" if logs else "warn"
        outcome.code = run_node(Shown, ["--ros-args", "--params-file", str(file), "--log-level", level])
        if companion is not None:
            _check(companion, folder)
    return outcome


@contextlib.contextmanager
def _companion(folder: Path, parameters: Mapping[str, object], *, logs: bool) -> Iterator[Any]:
    """Run the drag estimator as a process; it ends with the block."""
    file = folder / f"{_ESTIMATOR}.yaml"
    content = {f"/{_ESTIMATOR}": {"ros__parameters": dict(parameters)}}
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    with (folder / f"{_ESTIMATOR}.log").open("wb") as log:
        process = subprocess.Popen(
            [str(find_executable(*EXECUTABLES[_ESTIMATOR])), "--ros-args", "--params-file", str(file)],
            stdin=subprocess.DEVNULL,
            stdout=None if logs else log,
            stderr=None if logs else log,
            env=os.environ | {PARENT_VARIABLE: str(os.getpid())},
            start_new_session=True,  # a Ctrl-C of the terminal is for this process alone
        )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _check(process: Any, folder: Path) -> None:
    """Raise what the estimator ended with, if that is bad input."""
    if process.poll() == ExitCode.BAD_INPUT:
        words = (folder / f"{_ESTIMATOR}.log").read_text(encoding="utf-8", errors="replace").strip()
        raise InputError(
            words.rpartition("\n")[2].removeprefix(f"{_ESTIMATOR}: ") or f"{_ESTIMATOR}: bad input"
        )


def _fields(data: bytes) -> dict[str, Any]:
    """Return the fields of a serialized DragEstimate, SI units."""
    layout = wire.DRAG_ESTIMATE
    row = layout.array(1)
    if len(data) == row.nbytes:
        row = np.frombuffer(data, layout.dtype)
    fields = {name: row[name][0].tolist() for name in (*layout.integers, *layout.fields)}
    return {"stamp": int(layout.stamps(row)[0]) / wire.SECOND, **fields}


@contextlib.contextmanager
def _keys() -> Iterator[Callable[[], str]]:
    """Give a function that returns the keys pressed since its last call; always none without a terminal."""
    if not sys.stdin or not sys.stdin.isatty():
        yield lambda: ""
        return
    import termios
    import tty

    number = sys.stdin.fileno()
    before = termios.tcgetattr(number)

    def pressed() -> str:
        text = b""
        while select.select([number], [], [], 0.0)[0]:
            new = os.read(number, 64)
            if not new:
                break
            text += new
        return text.decode(errors="replace")

    tty.setcbreak(number)
    try:
        yield pressed
    finally:
        termios.tcsetattr(number, termios.TCSADRAIN, before)


@contextlib.contextmanager
def _signals_kept() -> Iterator[None]:
    """Put the handlers of signals back that `run_node` replaces."""
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
