"""The content of a report: a diagnosis with the models, recordings and commands that it rests on."""

from __future__ import annotations

import platform
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.investigation.page import end_sentence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gyrowheel.comparison.api import Comparison
    from gyrowheel.diagnosis.api import Diagnosis
    from gyrowheel.investigation.api import Investigation
    from gyrowheel.models.addition import Addition
    from gyrowheel.models.api import Model
    from gyrowheel.recordings.api import Recording
    from gyrowheel_sim.parameter import Parameter


@dataclass(frozen=True)
class ReportContent:
    """A diagnosis with the models, recordings and commands that it rests on.

    Attributes
    ----------
    diagnosis : Diagnosis
        The diagnosis.
    model : Model
        The model that was diagnosed.
    fitted, unused : tuple of Recording
        Recordings of the fit, and recordings that were only predicted.
    better : Model or None
        The model with the findings, if they were added.
    comparison : Comparison or None
        Comparison of the model with the fitted recordings; None if they have too little steady motion.
    commands : tuple of str
        Commands that repeat the result.
    next_command : str or None
        The next command.
    made : str
        Time of the report, UTC.
    investigation : Investigation or None
        The investigation that ended with the diagnosis, if there was one.
    made_by : str
        Account of the person who made the report; empty where it is not stated.
    """

    diagnosis: Diagnosis
    model: Model
    fitted: tuple[Recording, ...]
    unused: tuple[Recording, ...] = ()
    better: Model | None = None
    comparison: Comparison | None = None
    commands: tuple[str, ...] = ()
    next_command: str | None = None
    made: str = ""
    investigation: Investigation | None = None
    made_by: str = ""

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """All recordings, those for validation last."""
        return (*self.fitted, *self.unused)

    @property
    def latest(self) -> Model:
        """The model with the findings, if they were added, else the model."""
        return self.better or self.model

    @property
    def addition(self) -> Addition | None:
        """The error before and after the findings were added; None if they were not."""
        return None if self.better is None else self.better.added

    @cached_property
    def model_hash(self) -> str:
        """SHA-256 of the model's file; empty if it was not read from one, or the file is gone."""
        import hashlib

        try:
            return hashlib.sha256(Path(self.latest.origin).read_bytes()).hexdigest()
        except OSError:
            return ""

    @property
    def title(self) -> str:
        """The result in a sentence."""
        return self.diagnosis.sentence

    @cached_property
    def _content(self) -> dict[str, Any]:
        def stated(p: Parameter) -> dict[str, Any]:
            return {"value": p.value, "standard_error": p.uncertainty, "unit": p.unit, "source": p.source}

        return {
            "schema": 1,
            "made": self.made,
            "made_by": self.made_by,
            "diagnosis": self.diagnosis.to_dict(),
            "addition": None if self.addition is None else self.addition.to_dict(),
            "model": {
                "file": self.latest.origin,
                "sha256": self.model_hash or None,
                "content": self.latest.to_dict(),
                "bench": {name: stated(p) for name, p in self.latest.stated_bench.parameters.items()},
                "references": dict(self.latest.stated_bench.references),
            },
            "recordings": [
                {
                    "role": "fitted" if recording in self.fitted else "not used to fit",
                    "info": recording.to_dict(),
                    "files": [asdict(own) for own in recording.data.certified()],
                }
                for recording in self.recordings
            ],
            **({} if self.investigation is None else {"investigation": self._steps(self.investigation)}),
            "commands": list(self.commands),
            "next": self.next_command,
            "versions": {"gyrowheel": version("gyrowheel"), "system": platform.system()}
            | self.diagnosis.versions,
        }

    @property
    def ending(self) -> str:
        """How the investigation ended, in a sentence; empty without one."""
        return "" if self.investigation is None else end_sentence(self.investigation)

    @staticmethod
    def _steps(done: Investigation) -> dict[str, Any]:
        """Return the JSON of an investigation without its diagnosis, which is another field."""
        return {name: value for name, value in done.to_dict().items() if name != "diagnosis"}

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the report as a JSON object; ``diagnosis`` is that of ``diagnose --json``."""
        return self._content

    def figure(self) -> Figure:
        """Return the picture of the error before and after as a matplotlib figure.

        Raises
        ------
        InputError
            If the recordings have too little steady motion for a diagnosis.
        """
        if self.addition is None:
            return self.diagnosis.plot()
        from gyrowheel.diagnosis.page import coefficients_line
        from gyrowheel.show.error_fall import error_figure

        subtitle = "; ".join(f"{f.name}: {coefficients_line(f)}" for f in self.diagnosis.effects)
        added = self.addition
        return error_figure(added.residuals, added.error, title=self.title.rstrip("."), subtitle=subtitle)
