"""A diagnosis as a page to send."""

from __future__ import annotations

import contextlib
import hashlib
import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.comparison.api import compare
from gyrowheel.diagnosis.api import diagnose
from gyrowheel.diagnosis.next_command import diagnosing, following
from gyrowheel.models.api import Model
from gyrowheel.recordings.api import Recording
from gyrowheel.recordings.inputs import Recordings, Say, opened_apart
from gyrowheel.recordings.provenance import noted_machine
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import write_bytes, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gyrowheel.comparison.api import Comparison
    from gyrowheel.diagnosis.api import Diagnosis
    from gyrowheel.investigation.api import Investigation
    from gyrowheel.models.addition import Addition
    from gyrowheel_sim.parameter import Parameter

#: Kinds of reports by the ending of their file.
FORMATS = {"html": ".html", "md": ".md", "pdf": ".pdf"}
_BLOCK = 1 << 20


@dataclass(frozen=True)
class Report:
    """The result of a diagnosis in words, tables and pictures, with all that it rests on.

    Attributes
    ----------
    diagnosis : Diagnosis
        What was found.
    model : Model
        The model that was diagnosed.
    fitted, unused : tuple of Recording
        Recordings on which the diagnosis was fitted, and those that it only predicted.
    better : Model or None
        The model with what was found, where it was added.
    comparison : Comparison or None
        Where the model fails; None where there is too little to compare.
    commands : tuple of str
        What to type to have the same result again.
    next_command : str or None
        What to type next.
    made : str
        When the report was made, UTC.
    investigation : Investigation or None
        The investigation that came to the diagnosis, where it is one's.
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

    @classmethod
    def of(
        cls,
        recordings: Recordings,
        model: Model,
        *,
        validate: Recordings = (),
        averages: bool = False,
        mixed: bool = False,
        progress: Say | None = None,
    ) -> Report:
        """Diagnose recordings and return the report.

        Parameters
        ----------
        recordings, model, validate, averages, mixed, progress
            As `gyrowheel.diagnose` takes them.

        Raises
        ------
        InputError
            If a recording cannot be read, is given twice, or is of another machine.
        """
        fitted, unused = opened_apart(recordings, validate)
        found = diagnose(fitted, model, validate=unused, averages=averages, mixed=mixed, progress=progress)
        paths, held = [r.path for r in fitted], [r.path for r in unused]
        file = Path(model.origin)
        return cls.around(
            found,
            model,
            fitted,
            unused,
            commands=[diagnosing(paths, file, held, averages=averages)],
            next_command=following(
                found,
                paths,
                held,
                file,
                model.bench_source,
                averages=averages,
                machine=noted_machine(fitted),
            ),
            mixed=mixed,
            progress=progress,
        )

    @classmethod
    def around(
        cls,
        diagnosis: Diagnosis,
        model: Model,
        fitted: Sequence[Recording],
        unused: Sequence[Recording] = (),
        *,
        better: Model | None = None,
        comparison: Comparison | None = None,
        commands: Sequence[str] = (),
        next_command: str | None = None,
        mixed: bool = False,
        progress: Say | None = None,
        investigation: Investigation | None = None,
    ) -> Report:
        """Return the report on a diagnosis that was made before.

        Parameters
        ----------
        diagnosis : Diagnosis
            The diagnosis, of `model` by `fitted`.
        model : Model
            The model that was diagnosed.
        fitted, unused : sequence of Recording
            Its recordings: those fitted, and those for validation.
        better : Model, optional
            The model that came of adding the findings.
        comparison : Comparison, optional
            Where `model` fails on `fitted`; found here if not given.
        commands, next_command
            What to type for the same result, and next.
        mixed, progress
            As `gyrowheel.compare` takes them.
        investigation : Investigation, optional
            The investigation that came to the diagnosis.
        """
        if comparison is None and not diagnosis.setup:
            # too little steady motion: the diagnosis says so
            with contextlib.suppress(InputError):
                comparison = compare(fitted, model, mixed=mixed, progress=progress)
        now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
        return cls(
            diagnosis,
            model,
            tuple(fitted),
            tuple(unused),
            better,
            comparison,
            tuple(commands),
            next_command,
            now,
            investigation,
        )

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """All recordings, those for validation last."""
        return (*self.fitted, *self.unused)

    @property
    def latest(self) -> Model:
        """The model as it is in the end."""
        return self.better or self.model

    @property
    def addition(self) -> Addition | None:
        """The error before and after what was found was added, where that has been done."""
        return None if self.better is None else self.better.added

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
            "diagnosis": self.diagnosis.to_dict(),
            "addition": None if self.addition is None else self.addition.to_dict(),
            "model": {
                "file": self.latest.origin,
                "content": self.latest.to_dict(),
                "bench": {name: stated(p) for name, p in self.latest.stated_bench.parameters.items()},
                "references": dict(self.latest.stated_bench.references),
            },
            "recordings": [
                {
                    "role": "fitted" if recording in self.fitted else "not used to fit",
                    "info": recording.to_dict(),
                    "files": list(_hashes(recording.path)),
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
        from gyrowheel.investigation.page import end_sentence

        return "" if self.investigation is None else end_sentence(self.investigation)

    @staticmethod
    def _steps(done: Investigation) -> dict[str, Any]:
        """Return an investigation as its own JSON has it, without the diagnosis, which stands beside it."""
        return {name: value for name, value in done.to_dict().items() if name != "diagnosis"}

    def to_dict(self) -> dict[str, Any]:
        """Return all that the report shows as a JSON object; ``diagnosis`` is that of ``diagnose --json``."""
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

        subtitle = "   ".join(f"{f.name}: {coefficients_line(f)}" for f in self.diagnosis.effects)
        added = self.addition
        return error_figure(added.residuals, added.error, title=self.title.rstrip("."), subtitle=subtitle)

    def html(self) -> str:
        """Return the report as one page of HTML that needs no network; its one script draws signals."""
        from gyrowheel.report.page import html_page

        return html_page(self)

    def markdown(self) -> str:
        """Return the report as Markdown, without pictures."""
        from gyrowheel.report.page import markdown_page

        return markdown_page(self)

    def pdf(self) -> bytes:
        """Return `html` as PDF, printed by Chromium; InputError if none is installed."""
        from gyrowheel.report.printing import pdf

        return pdf(self.html())

    def save(self, path: str | Path) -> None:
        """Write the report, atomically: a failure leaves the old file.

        Parameters
        ----------
        path : str or Path
            The file; its ending says the kind: ``.html``, ``.md``, or ``.pdf`` where Chromium is installed.

        Raises
        ------
        InputError
            If the ending is another one, Chromium is missing, or the file cannot be written.
        """
        file = Path(path)
        if file.suffix not in FORMATS.values():
            raise InputError(
                f"{path}: the ending '{file.suffix}' is not known; allowed: {', '.join(FORMATS.values())}"
            )
        if file.suffix == FORMATS["pdf"]:
            write_bytes(file, self.pdf())
        else:
            write_text(file, self.html() if file.suffix == FORMATS["html"] else self.markdown())

    def __repr__(self) -> str:
        """Return the result in a sentence."""
        return f"<Report: {self.title}>"


def _hashes(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the files of a recording with their sizes [bytes] and hashes."""
    from gyrowheel_recording.bags import parted

    place, _ = parted(path)
    files = [place] if place.is_file() else sorted(p for p in place.rglob("*") if p.is_file())
    for file in files:
        digest = hashlib.sha256()
        with file.open("rb") as stream:
            while block := stream.read(_BLOCK):
                digest.update(block)
        name = file.name if file == place else str(file.relative_to(place))
        yield {"name": name, "size": file.stat().st_size, "sha256": digest.hexdigest()}
