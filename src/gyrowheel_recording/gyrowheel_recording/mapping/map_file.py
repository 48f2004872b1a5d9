"""The map file: what the columns of a table mean, in which units; and which fields a table may have."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field, create_model, field_validator, model_validator

from gyrowheel_core import wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import read_text
from gyrowheel_core.schema import Name, Number, Section, Text, Whole, check, refuse, shown
from gyrowheel_core.units import DEG, conversion
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_recording.bags import Origin
from gyrowheel_recording.bags.reader import LONGEST, SHORTEST
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import LONGEST_NAME, AirDensityRatio, Environment, Preheat, Rig, TableRate, Yaw


@dataclass(frozen=True)
class Reading:
    """A field of a message.

    SI unit, plausible range, whether a constant is allowed in place of a column, whether it may be missing, and
    another unit that a resistance turns into its own; whether pulses may stand for it.
    """

    unit: str
    low: float
    high: float
    constant: bool = False
    optional: bool = False
    current: bool = False
    pulsed: bool = False


_VOLTAGE = Reading("V", -1000.0, 1000.0)
_COIL = Reading("V", -1000.0, 1000.0, optional=True, current=True)
_SLOW = {"constant": True, "optional": True}
READINGS: Final = {
    "tilt_x": Reading("rad", -0.2, 0.2),
    "tilt_y": Reading("rad", -0.2, 0.2),
    "spin_angle": Reading("rad", -1e9, 1e9, optional=True, pulsed=True),
    "spin_rate": Reading("rad/s", -2000.0, 2000.0, optional=True),
    "coil_voltage_x": _COIL,
    "coil_voltage_y": _COIL,
    "motor_voltage": Reading("V", -1000.0, 1000.0, optional=True),
    "motor_current": Reading("A", -100.0, 100.0, optional=True),
    "coil_temperature": Reading("K", 150.0, 600.0, **_SLOW),
    "air_temperature": Reading("K", 150.0, 400.0, **_SLOW),
    "air_pressure": Reading("Pa", 0.0, 3e5, **_SLOW),
}
COMMANDS: Final = dict.fromkeys(wire.COMMAND.fields, _VOLTAGE)
SETPOINTS: Final = {
    "segment": Reading("", 0, 2**32 - 1),
    "phase": Reading("", 0, 1),
    "tilt_x": READINGS["tilt_x"],
    "tilt_y": READINGS["tilt_y"],
    "tilt_rate_x": Reading("rad/s", -100.0, 100.0),
    "tilt_rate_y": Reading("rad/s", -100.0, 100.0),
    "spin_rate": READINGS["spin_rate"],
    "spin_acceleration": Reading("rad/s^2", -1e4, 1e4),
}
GROUPS: Final = {"columns": READINGS, "command": COMMANDS, "setpoint": SETPOINTS}


SCHEMA: Final = 1
#: Unit of time stamps written as dates, such as 2026-05-04T10:00:00.0005.
TIMESTAMP: Final = "timestamp"
#: Treatment of missing readings: nothing is imported, or they stay missing in the recording.
REFUSE: Final = "refuse"
KEEP: Final = "keep"
#: Unit of a running count of pulses.
COUNT: Final = "count"
#: Most rows over which a reading is held.
MOST_HELD: Final = 1000
#: Most pulses a turn; what has more is read as an angle.
MOST_PULSES: Final = 10_000


class Source(Section):
    """Where the values of a field come from.

    Attributes
    ----------
    column : str
        Name of a column; empty for a constant.
    unit : str
        Unit of the values in the table.
    scale, offset : float
        A value of the table is multiplied by `scale` and increased by `offset` before its unit is converted.
    value : float
        The constant, in the unit.
    clock : str
        Column with the times of its rows, in the unit of the map's time, where it is not that of the map; the values
        are then interpolated.
    resistance : float
        For a voltage whose current was measured: what the current is multiplied by [ohm]; 0 where it is a voltage.
    missing : float
        A number in the table that stands for no reading; NaN if there is no such number.
    uncertainty : float
        Of a constant: how far off it may be (1 sigma), in the unit; 0 where it counts as measured.
    pulses : int
        Of an angle: rising edges a turn of what the column holds; 0 where it holds the angle itself. By the unit they
        are a level (none, or one of any signal), a running ``count``, or the times of the edges.
    level : float
        Of pulses: the level whose crossing is an edge; the middle between high and low where it is not a number.
    edge_angle_deg : float
        Of pulses: the angle at an edge [deg].
    plus, plus_unit : str
        Of the time: a column that is added to it, and its unit; seconds and nanoseconds may stand in two columns.
    wraps : float
        Of the time: the value at which its counter restarts, in its unit; 0 if it does not.
    """

    column: Text = ""
    unit: Text = ""
    scale: Number = 1.0
    offset: Number = 0.0
    value: Number = math.nan
    uncertainty: Annotated[Number, Field(ge=0.0)] = 0.0
    clock: Text = ""
    resistance: Annotated[Number, Field(ge=0.0)] = 0.0
    missing: Number = math.nan
    pulses: Annotated[Whole, Field(ge=0, le=MOST_PULSES)] = 0
    level: Number = math.nan
    edge_angle_deg: Annotated[Number, Field(ge=-360.0, le=360.0)] = 0.0
    plus: Text = ""
    plus_unit: Text = ""
    wraps: Annotated[Number, Field(ge=0.0)] = 0.0

    @model_validator(mode="after")
    def _column_or_value(self) -> Source:
        given = self.model_fields_set
        if ("column" in given) == ("value" in given):
            refuse("either column or value must be given")
        if "value" in given and given & {"scale", "offset", "clock", "resistance", "missing", "pulses"}:
            refuse("scale, offset, clock, resistance, missing and pulses belong to a column, not to a value")
        if "column" in given and "uncertainty" in given:
            refuse("belongs to a value, not to a column", "uncertainty")
        if not self.pulses and given & {"level", "edge_angle_deg"}:
            refuse(
                "level and edge_angle_deg belong to pulses; allowed: with `pulses:`, how many there are a turn"
            )
        if bool(self.plus) != bool(self.plus_unit):
            refuse("plus and plus_unit belong together; allowed: both, or none")
        if self.scale == 0.0:
            refuse("0 is out of range; allowed: any other number", "scale")
        return self


def is_time(unit: str) -> bool:
    """Whether a unit is one of time."""
    try:
        conversion(unit, "s")
    except InputError:
        return False
    return bool(unit)


def _fitting(source: Source, reading: Reading) -> Source:
    """Refuse a source that cannot be that of a field: no column, or a unit of another kind."""
    if reading.unit != "s":
        for name in ("plus", "wraps"):
            if getattr(source, name):
                refuse("is for the time", name)
    elif source.plus:
        try:
            conversion(source.plus_unit, "s")
        except InputError as error:
            refuse(str(error), "plus_unit")
    if not source.column and not reading.constant:
        refuse("a constant is not allowed here; allowed: a column", "value")
    if not reading.unit:
        if source.unit:
            refuse(f"{shown(source.unit)} is not allowed here; allowed: no unit", "unit")
        return source
    if source.pulses:
        if not reading.pulsed:
            refuse("are for the angle of the shaft", "pulses")
        return source
    if not source.unit:
        refuse(f"missing; allowed: such as {reading.unit}", "unit")
    if source.resistance:
        if not reading.current:
            refuse("is for coils whose current was measured", "resistance")
        try:
            conversion(source.unit, "A")
        except InputError as error:
            refuse(str(error), "unit")
        return source
    if not (reading.unit == "s" and source.unit == TIMESTAMP):
        try:
            conversion(source.unit, reading.unit)
        except InputError as error:
            refuse(str(error), "unit")
    return source


def _fit(reading: Reading) -> AfterValidator:
    return AfterValidator(functools.partial(_fitting, reading=reading))


@functools.cache
def _schema_of(group: str) -> type[Section]:
    """Return the schema of a group of sources: one for each field of the message, and no other."""
    fields: dict[str, Any] = {
        name: (Annotated[Source, _fit(reading)] | None, None)
        if reading.optional
        else (Annotated[Source, _fit(reading)], ...)
        for name, reading in GROUPS[group].items()
    }
    return create_model(group, __base__=Section, **fields)


def read_group(group: str, content: Any, origin: str) -> dict[str, Source]:
    """Return the sources of a group of fields, a key of `GROUPS`, from the content of the map file `origin`.

    Raises InputError if a source is missing, unknown or not allowed, or one column stands for two quantities.
    """
    where = f"{origin}: {group}"
    every: dict[str, Source | None] = dict(check(_schema_of(group), content, where, separator="."))
    sources = {name: source for name, source in every.items() if source is not None}
    if group == "columns":
        _require_enough(sources, where)
    owners: dict[str, str] = {}
    for name, source in sources.items():
        # the rates of the setpoints may all be one column of zeros, and one thermometer may stand for coils and air
        if group == "setpoint" or GROUPS[group][name].constant:
            continue
        if source.column in owners:
            raise InputError(
                f"{where}.{name}.column: '{source.column}' is that of {owners[source.column]}, too; "
                "allowed: a column of its own"
            )
        owners[source.column] = name
    return sources


def _require_enough(sources: Mapping[str, Source], where: str) -> None:
    """Refuse a map by which nothing could be analysed."""
    if not sources.keys() & {"spin_angle", "spin_rate"}:
        raise InputError(f"{where}.spin_rate: missing, and spin_angle too; allowed: one of them, better both")
    torques = ("coil_voltage_x", "coil_voltage_y", "motor_voltage", "motor_current")
    if not sources.keys() & set(torques):
        raise InputError(f"{where}: no voltage and no current; allowed: at least one of {', '.join(torques)}")


def _printable(name: str) -> str:
    if not name.isprintable():
        refuse(f"{name!r} is no name; allowed: printable characters")
    return name


class EnvironmentEntry(Section):
    """What held on the rig from a time on."""

    time_s: Annotated[Number, Field(ge=0.0)] = 0.0
    rig: Rig = "upright"
    yaw_deg: Yaw = 0.0
    air_density_ratio: AirDensityRatio = 1.0
    preheat_k: Preheat = 0.0
    table_rate_deg_s: TableRate = 0.0
    machine: Annotated[str, Field(max_length=LONGEST_NAME), AfterValidator(_printable)] = ""

    def in_si(self) -> Environment:
        """Return the same in SI units."""
        return Environment(
            time=self.time_s,
            rig=self.rig,
            yaw=self.yaw_deg * DEG,
            air_density_ratio=self.air_density_ratio,
            preheat=self.preheat_k,
            table_rate=self.table_rate_deg_s * DEG,
            machine=self.machine,
        )


def _ascending(entries: list[EnvironmentEntry]) -> list[EnvironmentEntry]:
    if any(b.time_s <= a.time_s for a, b in itertools.pairwise(entries)):
        refuse("the times must ascend")
    return entries


def _one_character(text: str) -> str:
    if len(text) != 1 or not text.isascii():
        refuse(f"{shown(text)} is not allowed; allowed: one character")
    return text


class CsvSettings(Section):
    """How a CSV file is written."""

    unit_lines: Annotated[Whole, Field(ge=0, le=100)] = 0
    comment: Annotated[str, Field(max_length=8)] = ""
    delimiter: Annotated[str, AfterValidator(_one_character)] = ","
    decimal: Annotated[str, AfterValidator(_one_character)] = "."
    skip_lines: Annotated[Whole, Field(ge=0, le=10_000)] = 0
    encoding: Text = "utf-8"
    missing: list[Text] = Field(default_factory=list)

    @model_validator(mode="after")
    def _differing(self) -> CsvSettings:
        if "delimiter" in self.model_fields_set and self.delimiter == self.decimal:
            refuse(f"'{self.decimal}' is the delimiter, too; allowed: another character", "decimal")
        return self


class ReadingEntry(Section):
    """How far off a reading may be that no instrument took [SI], and by how many pulses a turn an angle is known."""

    uncertainty: Annotated[Number, Field(ge=0.0)]
    pulses: Annotated[Whole, Field(ge=0, le=MOST_PULSES)] = 0


class MapFile(Section):
    """A map file."""

    schema_: Literal[1] = Field(alias="schema")
    bench: Text = "gyrowheel"
    time: Annotated[Source, _fit(Reading("s", -math.inf, math.inf))] | None = None
    rate: Annotated[Number, Field(ge=1.0 / LONGEST, le=1.0 / SHORTEST)] | None = None
    every: Annotated[Number, Field(ge=1.0, le=MOST_HELD)] = 1
    sequence: Annotated[Source, _fit(Reading("", 0, 2**53))] | None = None
    missing: Literal["refuse", "keep"] = REFUSE
    columns: dict[str, Any]
    command: dict[str, Any] | None = None
    setpoint: dict[str, Any] | None = None
    environment: Annotated[list[EnvironmentEntry], AfterValidator(_ascending)] = Field(default_factory=list)
    csv: CsvSettings | None = None
    clocks: dict[Name, Number] = Field(default_factory=dict)
    readings: dict[Name, ReadingEntry] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _time_or_rate(self) -> MapFile:
        if (self.time is None) == (self.rate is None):
            refuse(
                "either time or rate must be given: a column of times, or how many rows there are a second"
            )
        return self

    @field_validator("readings")
    @classmethod
    def _known(cls, given: dict[str, ReadingEntry]) -> dict[str, ReadingEntry]:
        for name in given:
            reading = READINGS.get(name)
            if reading is None or not (reading.constant or reading.pulsed):
                allowed = [own for own, its in READINGS.items() if its.constant or its.pulsed]
                refuse(f"'{name}' is not known; allowed: {', '.join(allowed)}")
        return given


@dataclass(frozen=True)
class ColumnMap:
    """A map file: what the columns of a table mean."""

    origin: str  # the file, for errors
    bench: Bench  # the bench that the table was measured on
    time: Source  # time of the samples; without a column where they are even by their rate
    sequence: Source | None  # numbers of the samples, where some are missing
    keep_missing: bool  # whether a reading that is missing is kept as such; an error if not
    #: Sources of the fields of the messages; the last two may be empty.
    columns: dict[str, Source]
    command: dict[str, Source]
    setpoint: dict[str, Source]
    environment: tuple[Environment, ...]  # what held on the rig; empty where unknown
    csv: CsvSettings | None  # how a CSV file is written; None where it is to be seen
    clocks: dict[str, float]  # what is added to the times of further clocks [s]
    #: Origins of readings that no instrument took, in an exported table.
    readings: dict[str, Origin]
    rate: float = 0.0  # rows a second, where there is no column of times [1/s]
    every: float = 1  # of so many rows one is taken: that in which a held reading is new

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
            time=content.time or Source(value=0.0, unit="s"),
            rate=content.rate or 0.0,
            every=content.every,
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
            dict.fromkeys(
                name for source in sources for name in (source.column, source.clock, source.plus) if name
            )
        )
