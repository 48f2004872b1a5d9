"""Outcome of an investigation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.diagnosis.result import Diagnosis
from gyrowheel.show.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel.investigation.procedure import Investigation as Details
    from gyrowheel.investigation.procedure import Step


@dataclass(frozen=True, repr=False)
class Investigation(Result):
    """Outcome of `gyrowheel.investigate`.

    Attributes
    ----------
    details : gyrowheel.investigation.Investigation
        The investigation, step by step.
    folder : Path
        Folder of the recordings.
    interrupted : bool
        Whether Ctrl-C ended it.
    keep : object
        Holds a temporary folder, which exists as long as this object.
    """

    details: Details
    folder: Path
    interrupted: bool = False
    keep: object = None

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps: ``.plans``, ``.why``, ``.diagnosis``, ``.learned`` and more."""
        return tuple(self.details.steps)

    @property
    def settled(self) -> bool:
        """Whether no question is open."""
        return self.details.settled

    @property
    def reason(self) -> str:
        """Why the investigation ended."""
        return self.details.reason

    @property
    def minutes(self) -> float:
        """Bench time spent [min]."""
        return self.details.minutes

    @property
    def recordings(self) -> tuple[Path, ...]:
        """All recordings."""
        return tuple(self.details.recordings)

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The last diagnosis, of all recordings together; None if it was interrupted before the first."""
        return Diagnosis(self.details.steps[-1].diagnosis) if self.details.steps else None

    def __str__(self) -> str:
        """Return how it ended, and the result of each step."""
        from gyrowheel.investigation.sentences import end_sentence

        lines = [end_sentence(self.details)]
        for step in self.steps:
            lines.append(f"  {step.number}. {' and '.join(step.plans) or 'recordings at hand'}: {step.why}")
            lines += [f"     {sentence}" for sentence in step.learned]
        return "\n".join(lines)

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from rich.panel import Panel
        from rich.text import Text

        from gyrowheel.diagnosis.page import error_section, findings
        from gyrowheel.investigation.sentences import end_sentence
        from gyrowheel.show.layout import words_table

        colour = "green" if self.settled else "yellow"
        yield Panel(Text(end_sentence(self.details), style="bold"), border_style=colour, expand=False)
        table = words_table("plan", "why", "verdict", "learned")
        for step in self.steps:
            verdict = step.diagnosis.verdict.replace("_", " ")
            table.add_row(" and ".join(step.plans), step.why, verdict, Text("\n".join(step.learned)))
        yield table
        if self.details.steps:
            last = self.details.steps[-1].diagnosis
            yield from findings(last)
            yield from error_section(last)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel investigate --json``; SI units."""
        return self.details.to_json()

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the steps as columns, a row for each."""
        return {
            "plans": [", ".join(step.plans) for step in self.steps],
            "why": [step.why for step in self.steps],
            "minutes": [step.minutes for step in self.steps],
            "verdict": [step.diagnosis.verdict for step in self.steps],
            "named": [", ".join(f.name for f in step.diagnosis.effects) for step in self.steps],
        }

    def plot(self) -> Figure:
        """Return the picture of the last diagnosis as a matplotlib figure."""
        if self.diagnosis is None:
            return super().plot()
        return self.diagnosis.plot()
