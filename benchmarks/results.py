"""Results of a benchmark: figures and their limits, as a table and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from gyrowheel.show.layout import figures_table, heading, sentences

_INDENT = (0, 0, 0, 2)


class MeasurementError(RuntimeError):
    """A subject cannot be measured; the message says why."""


@dataclass(frozen=True)
class Bar:
    """Limit of a figure.

    Attributes
    ----------
    sense : str
        Required relation of the figure to the limit: ``">="``, ``"<="``, ``">"`` or ``"<"``.
    limit : float
        The limit, in the unit of the figure.
    of : str
        ``"value"``, or ``"ratio"`` for the value over the peer's.
    """

    sense: Literal[">=", "<=", ">", "<"]
    limit: float
    of: Literal["value", "ratio"] = "value"

    def holds(self, number: float) -> bool:
        """Whether a number is on the right side of the limit; one that is not finite never is."""
        if not math.isfinite(number):
            return False
        return {
            ">=": number >= self.limit,
            "<=": number <= self.limit,
            ">": number > self.limit,
            "<": number < self.limit,
        }[self.sense]

    def __str__(self) -> str:
        """Return the text in the table and in the file."""
        return f"{'ratio ' if self.of == 'ratio' else ''}{self.sense} {self.limit:g}"


@dataclass(frozen=True)
class Figure:
    """One measured figure, alone or with that of a peer.

    Attributes
    ----------
    name : str
        Measured quantity, under the title of its report.
    value : float
        The figure.
    unit : str
        Its unit.
    peer : str, optional
        Program with which it is compared.
    peer_value : float, optional
        The peer's figure, in the same unit.
    bar : Bar, optional
        Limit of the figure.
    """

    name: str
    value: float
    unit: str
    peer: str | None = None
    peer_value: float | None = None
    bar: Bar | None = None

    def __post_init__(self) -> None:
        """Refuse a peer without a figure, and a bar for a missing ratio."""
        if (self.peer is None) != (self.peer_value is None):
            raise ValueError(f"{self.name}: a peer needs both a name and a figure")
        if self.bar is not None and self.bar.of == "ratio" and self.peer is None:
            raise ValueError(f"{self.name}: a bar for the ratio needs a peer")

    @property
    def ratio(self) -> float | None:
        """The figure divided by that of the peer."""
        if self.peer_value is None:
            return None
        return self.value / self.peer_value if self.peer_value else math.nan

    @property
    def holds(self) -> bool | None:
        """Whether the bar holds; None without one."""
        if self.bar is None:
            return None
        number = self.ratio if self.bar.of == "ratio" else self.value
        return number is not None and self.bar.holds(number)

    def to_json(self, title: str) -> dict[str, Any]:
        """Return the entry of the file, named after its report; a number that is not finite becomes null."""
        return {
            "name": f"{title}: {self.name}",
            "value": _finite(self.value),
            "unit": self.unit,
            "peer": self.peer,
            "peer_value": _finite(self.peer_value),
            "ratio": _finite(self.ratio),
            "bar": None if self.bar is None else str(self.bar),
            "holds": self.holds,
        }


@dataclass(frozen=True)
class Report:
    """Result of the benchmark of one subject.

    Attributes
    ----------
    title : str
        Heading, the prefix of the names of the figures in the file.
    figures : sequence of Figure
        The figures.
    notes : sequence of str
        Method: what was run, from which state, how often.
    details : sequence
        Tables that are shown under the figures and are not written to the file.
    """

    title: str
    figures: Sequence[Figure]
    notes: Sequence[str] = ()
    details: Sequence[RenderableType] = field(default=())


def to_json(reports: Sequence[Report]) -> str:
    """Return the text of ``bench.json``: one entry per figure."""
    entries = [figure.to_json(report.title) for report in reports for figure in report.figures]
    return json.dumps(entries, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def shown(report: Report) -> Iterator[RenderableType]:
    """Yield the printed form of a report."""
    yield heading(report.title)
    peers = any(f.peer is not None for f in report.figures)
    table = figures_table("", "", *(("peer", "", "ratio") if peers else ()), "bar", "holds")
    for column in (0, 2) if peers else (0,):
        table.columns[column].justify = "left"
    before = None
    for f in report.figures:
        # one figure with several peers is written once
        same, before = before == (f.name, f.value), (f.name, f.value)
        cells: list[str | Text] = ["" if same else f.name, "" if same else f"{number(f.value)} {f.unit}"]
        if peers:
            cells += [f.peer or "", *("" if x is None else number(x) for x in (f.peer_value, f.ratio))]
        table.add_row(*cells, "" if f.bar is None else str(f.bar), _verdict(f.holds))
    yield Padding(table, _INDENT)
    for detail in report.details:
        yield Text("")
        yield Padding(detail, _INDENT)
    if report.notes:
        yield Text("")
        yield from sentences(report.notes)


def number(value: float) -> str:
    """Return a number with three digits: plain if that is short, else with a power of ten."""
    if not math.isfinite(value):
        return "not known"
    if value == 0.0:
        return "0"
    if 1e-2 <= abs(value) < 1e5:
        return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
    return f"{value:.2e}"


def _verdict(holds: bool | None) -> Text:
    if holds is None:
        return Text("")
    return Text("yes", style="green") if holds else Text("NO", style="bold red")


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
