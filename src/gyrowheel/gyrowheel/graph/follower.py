"""Diagnosis of a running bench, in a separate process of the lowest priority, so that no node waits for it."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from types import TracebackType

import psutil
import typer

from gyrowheel.cli.console import notes

_NICEST = 19


class Follower:
    """Runs ``gyrowheel diagnose --follow`` next to the bench; a context manager that ends with its last page.

    Parameters
    ----------
    recording : Path
        Directory of the recording in progress.
    model : Path
        Model file.
    early : bool
        Whether it ends once an effect is settled.
    quiet : bool
        Whether its page goes to stderr, because stdout has something else.
    """

    def __init__(self, recording: Path, model: Path, *, early: bool, quiet: bool) -> None:
        self._recording, self._model, self._early, self._quiet = recording, model, early, quiet

    def __enter__(self) -> Follower:
        """Start it."""
        command = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()", "diagnose", "--follow"]
        command += [str(self._recording), "--model", str(self._model)]
        self._process = subprocess.Popen(
            [*command, *(["--until", "settled"] if self._early else [])],
            stdin=subprocess.DEVNULL,
            stdout=sys.stderr.fileno() if self._quiet else None,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C ends the bench, and so the recording, which it then looks at as a whole
        )
        psutil.Process(self._process.pid).nice(_NICEST)
        self._lines = threading.Thread(target=self._show, daemon=True)
        self._lines.start()
        return self

    @property
    def ended(self) -> bool:
        """Whether it has ended: an effect is settled."""
        return self._process.poll() == 0

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for its last page; end it where the bench failed, or at another Ctrl-C."""
        try:
            if error is not None and not isinstance(error, KeyboardInterrupt):
                self._process.terminate()
            code = self._process.wait()
        except KeyboardInterrupt:
            self._process.terminate()
            self._process.wait()
            raise
        self._lines.join()
        if error is None and code:
            raise typer.Exit(code)

    def _show(self) -> None:
        """Show its looks above the progress of the plan."""
        assert self._process.stderr is not None
        for line in self._process.stderr:
            notes().print(line.rstrip("\n"), soft_wrap=True, highlight=False, markup=False)
