"""A replay session: the node ``replay`` in this process with its progress shown, and optionally a drag estimator.

`gyrowheel_recording.bags.playback` orders the messages; the node publishes them; this runs the node.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_bringup.graph import EXECUTABLES
from gyrowheel_bringup.graph.nodes import write_parameters
from gyrowheel_bringup.graph.processes import node_process
from gyrowheel_bringup.graph.shared_memory import remove_dead
from gyrowheel_core import namespaces, topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import ExitCode, prepare_environment, run_node
from gyrowheel_recording.bags.playback import Tape
from gyrowheel_recording.nodes.replay import ReplayNode

_LOOK: Final = 0.1  # period at which keys and the estimator are checked [s]
_ESTIMATOR: Final = "drag_estimator"


@dataclass
class Outcome:
    """Outcome of a replay."""

    code: int = 0  # exit code of the node; 0 if it ended well
    complete: bool = False  # whether it reached the end
    stopped: bool = False  # whether the user stopped it with a key
    counts: dict[str, int] = field(default_factory=dict)  # messages published, by topic
    rounds: int = 0  # number of times the end was reached
    wall: float = 0.0  # wall-clock time from the first message to the last [s]
    left_out: dict[str, str] = field(default_factory=dict)  # recorded topics that were not published, and why
    #: Drag estimates made during the replay; empty without the estimator.
    estimates: list[Estimate] = field(default_factory=list)


def play(
    tape: Tape,
    parameters: Mapping[str, object],
    *,
    show: Callable[[ReplayNode], None],
    estimator: Mapping[str, object] | None = None,
    namespace: str = "",
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
        Parameters of a drag estimator that runs during the replay; by default none runs.
    namespace : str
        Namespace of the nodes and of what they publish, such as ``/bench2``; empty: the root.
    logs : bool
        Whether the logs of the nodes go to stderr.

    Raises
    ------
    InputError
        If the estimator refuses its input, or its executable is not installed.
    """
    outcome = Outcome()
    moved = namespaces.checked(namespace)
    rules = ["-r", f"__ns:={moved}"] if moved else []
    prepare_environment()
    remove_dead()
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="gyrowheel-")))
        companion = None
        if estimator is not None:
            companion = stack.enter_context(_companion(folder, estimator, rules, logs=logs))
        keys = stack.enter_context(_keys())
        stack.enter_context(_signals_kept())

        class Shown(ReplayNode):
            """Publishes a recording."""

            def open_tape(self) -> Tape:
                return tape

            def activate(self) -> None:
                super().activate()
                self._begun: float | None = None
                self._looking = self.wall_timer(_LOOK, self._look)
                if companion is not None:
                    self._listening = self.subscription(
                        topics.DRAG_ESTIMATE,
                        lambda data: outcome.estimates.append(Estimate.from_bytes(data)),
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
                else:  # it publishes the last estimate when it ends
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
        write_parameters(file, {"directory": str(tape.path), **parameters})
        level = "info" if logs else "warn"
        outcome.code = run_node(
            Shown, ["--ros-args", "--params-file", str(file), *rules, "--log-level", level]
        )
        if companion is not None:
            _check(companion, folder)
    return outcome


@contextlib.contextmanager
def _companion(
    folder: Path, parameters: Mapping[str, object], rules: Sequence[str], *, logs: bool
) -> Iterator[Any]:
    """Run the drag estimator as a process that ends with the block."""
    file = folder / f"{_ESTIMATOR}.yaml"
    write_parameters(file, parameters)
    with (folder / f"{_ESTIMATOR}.log").open("wb") as log:
        output = None if logs else log
        arguments = ["--params-file", str(file), *rules]
        with node_process(EXECUTABLES[_ESTIMATOR], arguments, stdout=output, stderr=output) as process:
            yield process


def _check(process: Any, folder: Path) -> None:
    """Raise the error that ended the estimator, if it was bad input."""
    if process.poll() == ExitCode.BAD_INPUT:
        words = (folder / f"{_ESTIMATOR}.log").read_text(encoding="utf-8", errors="replace").strip()
        raise InputError(
            words.rpartition("\n")[2].removeprefix(f"{_ESTIMATOR}: ") or f"{_ESTIMATOR}: bad input"
        )


@contextlib.contextmanager
def _keys() -> Iterator[Callable[[], str]]:
    """Yield a function that returns the keys pressed since its last call; without a terminal it returns none."""
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
    """Restore the signal handlers that `run_node` replaces."""
    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
