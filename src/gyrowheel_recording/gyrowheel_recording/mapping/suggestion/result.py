"""Result of a look at a table: the proposed meaning of each column, all doubts, and the map."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import yaml

from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mapping.map_file import SCHEMA
from gyrowheel_recording.mislabelled.fixes import WrongSetup


@dataclass(frozen=True)
class Proposal:
    """Proposed meaning of one column."""

    field: str  # a reading, ``time`` or ``sequence``
    column: str
    unit: str
    scale: float  # what its values are multiplied by before the unit counts
    reason: str
    stated: bool  # whether the file states the unit
    clock: str = ""  # column with the times of its rows, where that is not the map's
    #: Range of its values, in the unit.
    lowest: float = math.nan
    highest: float = math.nan
    pulses: int = 0  # of an angle: pulses a turn by which it is known; 0 where the column holds it itself


@dataclass(frozen=True)
class Problem:
    """A doubt about a table, or a gap in it."""

    what: str
    cure: str
    asks: bool = True  # whether nothing may be concluded before it is answered


@dataclass(frozen=True)
class Suggestion:
    """A map for a table."""

    table: str
    kind: str  # its format
    proposals: tuple[Proposal, ...]  # what its columns seem to be
    problems: tuple[Problem, ...]  # all that is doubtful or missing
    setups: tuple[WrongSetup, ...] = ()  # violations of the laws of the wheel by the map
    unused: tuple[str, ...] = ()  # columns that the map leaves out
    remarks: tuple[str, ...] = ()  # what an import by the map does
    content: Mapping[str, Any] = field(default_factory=dict)  # the map file
    recording: Recording | None = None  # what the map makes of the table, if it can be imported

    @property
    def settled(self) -> bool:
        """Whether nothing is left to be answered."""
        return not self.setups and not any(problem.asks for problem in self.problems)

    def map_text(self) -> str:
        """Return the map file, with a reason for every column."""
        reasons = {own.field: own.reason for own in self.proposals}
        lines = [f"# Suggested for {self.table}; the reason stands behind every column."]
        lines += [f"# ? {problem.what} {problem.cure}" for problem in self.problems if problem.asks]
        rest = {
            key: value for key, value in self.content.items() if key not in ("time", "sequence", "columns")
        }
        lines.append(yaml.safe_dump({"schema": SCHEMA}, sort_keys=False).strip())
        for key in ("time", "sequence"):
            if key in self.content:
                lines.append(f"{key}: {_flow(self.content[key])}  # {reasons.get(key, '')}".rstrip(" #"))
        lines.append("columns:")
        for name, source in self.content.get("columns", {}).items():
            why = reasons.get(name) or reasons.get(name.replace("voltage", "current"), "")
            lines.append(f"  {name}: {_flow(source)}  # {why}".rstrip(" #"))
        rest.pop("schema", None)
        if rest:
            lines.append(yaml.safe_dump(rest, sort_keys=False, allow_unicode=True).strip())
        return "\n".join(lines) + "\n"


def _flow(source: Any) -> str:
    return yaml.safe_dump(
        source, sort_keys=False, default_flow_style=True, width=10_000, allow_unicode=True
    ).strip()
