"""The simulated bench on which the workbench runs a test: the machine that the recordings at hand were made on."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrowheel.models.api import Model
from gyrowheel.recordings.api import Recording
from gyrowheel.recordings.provenance import machine_options, note_machine, noted_machine
from gyrowheel.simulation.api import simulate
from gyrowheel_core.errors import InputError


class _Words(argparse.ArgumentParser):
    """Reads the options of a machine; what it cannot read is no machine."""

    def error(self, message: str) -> Any:
        raise InputError(f"machine: {message}")


def _reader() -> _Words:
    reader = _Words(add_help=False, allow_abbrev=False)
    reader.add_argument("--effect", action="append")
    for name, kind in (("truth", Path), ("blind", Path), ("machine", int), ("bench", str)):
        reader.add_argument(f"--{name}", type=kind)
    reader.add_argument("--seed", type=int, default=0)
    return reader


@dataclass(frozen=True)
class SimulatedBench:
    """A machine by the options of the command line that it was asked for with.

    Attributes
    ----------
    effect : tuple of str
        Effects that it has.
    truth, blind : Path or None
        Model file of what it is, or key file.
    machine : int or None
        Seed of its parameters.
    bench : str or None
        Name or file of the bench.
    seed : int
        Seed of the noise.
    """

    effect: tuple[str, ...] = ()
    truth: Path | None = None
    blind: Path | None = None
    machine: int | None = None
    bench: str | None = None
    seed: int = 0

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> SimulatedBench | None:
        """Return the machine of some recordings; None if nothing of it is noted beside them: it is a real one.

        Raises
        ------
        InputError
            If the note cannot be read.
        """
        note = noted_machine(recordings)
        if not note:
            return None
        read = vars(_reader().parse_args(shlex.split(note)))
        return cls(**read | {"effect": tuple(read["effect"] or ())})

    def record(
        self, plan: str, folder: Path, model: Model, number: int, progress: Callable[[float], None]
    ) -> Recording:
        """Run a plan on the machine.

        Parameters
        ----------
        plan : str
            The plan.
        folder : Path
            New folder for the recording, which appears when it is complete.
        model : Model
            What the analyst believes.
        number : int
            Tells runs of one plan apart: each has noise of its own.
        progress : callable
            Called with the fraction done.
        """
        made = simulate(
            plan,
            effects=self.effect,
            truth=None if self.truth is None else Model.load(self.truth),
            model=model,
            bench=self.bench,
            machine=self.machine,
            seed=self.seed + number,
            blind=self.blind,
            folder=folder,
            progress=progress,
        )
        note_machine(
            made,
            machine_options(
                effect=self.effect,
                truth=self.truth,
                blind=self.blind,
                machine=self.machine,
                seed=self.seed,
                bench=self.bench,
            ),
        )
        return made
