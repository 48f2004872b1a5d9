"""A map that is suggested for a table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.show.result import Result
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_recording.mapping.suggestion.result import Suggestion


@dataclass(frozen=True, repr=False)
class TableMap(Result):
    """Outcome of `gyrowheel.suggest_map`: what the columns of a table seem to be, and what is doubtful.

    Attributes
    ----------
    details : gyrowheel_recording.mapping.suggestion.result.Suggestion
        The facts.
    """

    details: Suggestion

    @property
    def content(self) -> dict[str, Any]:
        """The map, as `gyrowheel.read_table` takes it; to be changed where it is wrong."""
        import copy

        return copy.deepcopy(dict(self.details.content))

    @property
    def questions(self) -> tuple[str, ...]:
        """What must be answered before anything is diagnosed."""
        from gyrowheel.show.sentences.setup import problem_and_map

        asked = [f"{own.what} {own.cure}" for own in self.details.problems if own.asks]
        return (*asked, *(problem_and_map(wrong) for wrong in self.details.setups))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the table lacks and what an import does about it."""
        told = [f"{own.what} {own.cure}" for own in self.details.problems if not own.asks]
        return (
            *told,
            *(f"{remark}." for remark in self.details.remarks if not remark.startswith("not in the")),
        )

    @property
    def settled(self) -> bool:
        """Whether there are no questions."""
        return self.details.settled

    def __str__(self) -> str:
        """Return the columns and the questions."""
        columns = ", ".join(f"{own.field}: {own.column} [{own.unit}]" for own in self.details.proposals)
        asked = [f"  ? {text}" for text in self.questions]
        return "\n".join([f"{self.details.table} ({self.details.kind}): {columns}", *asked])

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.tables.page import suggestion_page

        return suggestion_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel import --suggest --json``."""
        d = self.details
        return {
            "schema": 1,
            "table": d.table,
            "kind": d.kind,
            "settled": self.settled,
            "columns": [
                {
                    "field": own.field,
                    "column": own.column,
                    "unit": own.unit,
                    "scale": own.scale,
                    "clock": own.clock,
                    "reason": own.reason,
                }
                for own in d.proposals
            ],
            "questions": list(self.questions),
            "remarks": list(self.remarks),
            "unused": list(d.unused),
            "map": self.content,
        }

    def to_columns(self) -> Mapping[str, Any]:
        """Return the columns that were recognised, one a row."""
        names = ("field", "column", "unit", "scale", "clock", "reason")
        return {name: [getattr(own, name) for own in self.details.proposals] for name in names}

    def plot(self) -> Figure:
        """Return a picture of the signals as the map reads them.

        Raises
        ------
        InputError
            If the table cannot be read by the map.
        """
        from gyrowheel.recordings.picture import recording_figure

        if self.details.recording is None:
            raise InputError(f"{self.details.table}: cannot be read by the suggested map; nothing to draw")
        return recording_figure(self.details.recording, self.questions)

    def save(self, path: str | Path) -> None:
        """Write the map file, with a reason beside every column and the questions on top.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        from gyrowheel_core.files import write_text

        write_text(Path(path), self.details.map_text())
