"""Coefficients and bench parameters of a batch over time and machine, with control limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.batches.api import ENDINGS, Batch, read_rows
from gyrowheel.show.result import Result, columns_of
from gyrowheel_analysis import trend as facts
from gyrowheel_analysis.criteria import SPREAD_FEWEST, TREND_FEWEST
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


@dataclass(frozen=True, repr=False)
class Trend(Result, facts.Trend):
    """Outcome of `gyrowheel.trend`; the fields are those of `gyrowheel_analysis.trend.Trend`."""

    def headline(self) -> str:
        """Return what left its control limits first, or that nothing did."""
        from gyrowheel.trends.page import summary

        return summary(self)

    def page(self) -> Iterable[RenderableType]:
        """Return what left its limits, when and by how much, all other quantities, and what machines share."""
        from gyrowheel.trends.page import trend_page

        return trend_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel trend --json``; SI units."""
        courses = []
        for course in self.courses:
            low, high = course.limits
            left = course.departure
            courses.append(
                {
                    "name": course.name,
                    "over": course.over,
                    "centre": course.centre,
                    "values": [
                        dict(zip(_VALUES, own, strict=True))
                        for own in zip(
                            course.time.tolist(), course.machines, course.recordings, course.value.tolist(),
                            course.standard_error.tolist(), low.tolist(), high.tolist(), strict=True,
                        )
                    ],
                    "departure": left
                    and {
                        "kind": left.kind,
                        "time": float(course.time[left.first]),
                        "machine": course.machines[left.first],
                        "recording": course.recordings[left.first],
                        "size": left.size,
                        "standard_error": left.standard_error,
                        "chance": left.chance,
                    },
                }
            )  # fmt: skip
        shared = [asdict(own) for own in self.shared]
        return {"schema": 1, "courses": courses, "too_few": list(self.few), "shared": shared}

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return all values of all quantities with their limits, a row for each; SI units."""
        rows = []
        for course in self.courses:
            low, high = course.limits
            rows += [
                (course.name, course.over, *own)
                for own in zip(
                    course.time.tolist(), course.machines, course.recordings, course.value.tolist(),
                    course.standard_error.tolist(), low.tolist(), high.tolist(), strict=True,
                )
            ]  # fmt: skip
        return columns_of(" ".join(("name", "over", *_VALUES)), rows)

    def plot(self) -> Figure:
        """Return the courses of up to six quantities with their limits; those that left them first.

        Raises
        ------
        InputError
            If no quantity has enough dated recordings for control limits.
        """
        from gyrowheel.trends.picture import figure_of_trend

        if not self.courses:
            raise InputError(
                f"picture: no control limits; they take {TREND_FEWEST} dated machines or recordings"
            )
        return figure_of_trend(self)


_VALUES = ("time", "machine", "recording", "value", "standard_error", "low", "high")


def trend(results: str | Path | Batch) -> Trend:
    """Follow the coefficients and bench parameters of many recordings over time and machine.

    Parameters
    ----------
    results : str, Path or Batch
        Table that `gyrowheel.batch` wrote, or its result.

    Raises
    ------
    InputError
        If the table cannot be read, or no quantity has enough machines or dated recordings.
    """
    if isinstance(results, Batch):
        rows, name = list(results.rows), "the batch"
    else:
        table = Path(results)
        if table.suffix not in ENDINGS:
            raise InputError(f"{table}: must end in {' or '.join(ENDINGS)}")
        if not table.exists():
            raise InputError(f"{table}: no such file")
        rows, name = read_rows(table), str(table)
    found = Trend.of(facts.trend(rows))
    if not found.courses and all(own.spread is None for own in found.shared):
        raise InputError(
            f"{name}: {len(rows)} recordings; allowed: a quantity of at least {SPREAD_FEWEST} machines, or of "
            f"at least {TREND_FEWEST} recordings in addition to the first of each machine"
        )
    return found
