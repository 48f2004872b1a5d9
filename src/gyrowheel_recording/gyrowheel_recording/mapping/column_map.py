"""What the columns of a table mean: which of them holds which reading, and in which unit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrowheel_core.files import read_text
from gyrowheel_core.schema import check
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_recording.bags import Origin
from gyrowheel_recording.mapping.map_file import KEEP, CsvSettings, MapFile, Source, read_group
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment


@dataclass(frozen=True)
class ColumnMap:
    """A map file: what the columns of a table mean.

    Attributes
    ----------
    origin : str
        The file, for errors.
    bench : Bench
        The bench that the table was measured on.
    time : Source
        Time of the samples.
    sequence : Source or None
        Numbers of the samples, where some are missing.
    keep_missing : bool
        Whether a reading that is missing is kept as such; an error if not.
    columns, command, setpoint : dict of str to Source
        Sources of the fields of the messages; the last two may be empty.
    environment : tuple of Environment
        What held on the rig; empty where unknown.
    csv : CsvSettings or None
        How a CSV file is written; None where it is to be seen.
    clocks : dict of str to float
        What is added to the times of further clocks [s].
    readings : dict of str to Origin
        What an exported table says of readings that no instrument of their own took.
    """

    origin: str
    bench: Bench
    time: Source
    sequence: Source | None
    keep_missing: bool
    columns: dict[str, Source]
    command: dict[str, Source]
    setpoint: dict[str, Source]
    environment: tuple[Environment, ...]
    csv: CsvSettings | None
    clocks: dict[str, float]
    readings: dict[str, Origin]

    @classmethod
    def load(cls, file: str | Path) -> ColumnMap:
        """Read a map file.

        Raises
        ------
        InputError
            If it cannot be read, or a field of it is missing, unknown or not allowed.
        """
        path = Path(file)
        return cls.from_mapping(read_yaml(read_text(path), str(path)), str(path))

    @classmethod
    def from_mapping(cls, raw: Any, origin: str) -> ColumnMap:
        """Read the content of a map file (see `load`)."""
        content = check(MapFile, raw, origin, kind="map file")
        return cls(
            origin=origin,
            bench=Bench.load(content.bench),
            time=content.time,
            sequence=content.sequence,
            keep_missing=content.missing == KEEP,
            columns=read_group("columns", content.columns, origin),
            command={} if content.command is None else read_group("command", content.command, origin),
            setpoint={} if content.setpoint is None else read_group("setpoint", content.setpoint, origin),
            environment=tuple(entry.in_si() for entry in content.environment),
            csv=content.csv,
            clocks=content.clocks,
            readings={name: Origin(own.uncertainty, own.pulses) for name, own in content.readings.items()},
        )

    @property
    def sources(self) -> list[Source]:
        """All sources, the clocks first."""
        found = [self.time, *([self.sequence] if self.sequence else [])]
        for group in (self.columns, self.command, self.setpoint):
            found += group.values()
        return found

    @property
    def names(self) -> list[str]:
        """Names of the columns that are needed, each once."""
        sources = self.sources
        return list(
            dict.fromkeys(name for source in sources for name in (source.column, source.clock) if name)
        )
