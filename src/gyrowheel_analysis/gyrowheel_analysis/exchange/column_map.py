"""The map file: which column of a table holds which reading, and in which unit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from gyrowheel_analysis.exchange.fields import GROUPS, Field
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, conversion
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment

SCHEMA: Final = 1
#: Unit of time stamps written as dates, such as 2026-05-04T10:00:00.0005.
TIMESTAMP: Final = "timestamp"
#: What is done with readings that are missing: nothing is imported, or they stay missing in the recording.
REFUSE: Final = "refuse"
KEEP: Final = "keep"
_CSV: Final[dict[str, Any]] = {"delimiter": ",", "decimal": ".", "skip_lines": 0, "encoding": "utf-8"}


@dataclass(frozen=True)
class Source:
    """Where the values of a field come from.

    Attributes
    ----------
    column : str
        Name of a column; empty for a constant.
    unit : str
        Unit of what stands there.
    scale, offset : float
        What stands there is multiplied by and then increased by, before the unit counts.
    value : float
        The constant, in the unit.
    """

    column: str = ""
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    value: float = math.nan


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
    csv : dict
        How a CSV file is written: delimiter, decimal, skip_lines, encoding.
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
    csv: dict[str, Any]

    @classmethod
    def load(cls, file: str | Path) -> ColumnMap:
        """Read a map file.

        Raises
        ------
        InputError
            If it cannot be read, or a field of it is missing, unknown or not allowed.
        """
        path = Path(file)
        try:
            raw = read_yaml(path.read_text(encoding="utf-8"), str(path))
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is no text"
            raise InputError(f"{path}: cannot be read: {reason}") from None
        return cls.from_mapping(raw, str(path))

    @classmethod
    def from_mapping(cls, raw: Any, origin: str) -> ColumnMap:
        """Read the content of a map file (see `load`)."""
        allowed = ("schema", "bench", "time", "sequence", "missing", *GROUPS, "environment", "csv")
        content = _mapping(raw, origin, allowed, needed=("schema", "time", "columns"))
        if content["schema"] != SCHEMA:
            raise InputError(f"{origin}: schema: {content['schema']!r} is not known; allowed: {SCHEMA}")
        groups: dict[str, dict[str, Source]] = {}
        for group, fields in GROUPS.items():
            where = f"{origin}: {group}"
            if group not in content:
                groups[group] = {}
                continue
            entries = _mapping(content[group], where, tuple(fields), needed=tuple(fields))
            groups[group] = {
                name: _source(entries[name], f"{where}.{name}", field) for name, field in fields.items()
            }
            if group != "setpoint":  # whose rates may all be one column of zeros
                _refuse_shared(groups[group], fields, where)
        sequence = content.get("sequence")
        missing = content.get("missing", REFUSE)
        if missing not in (REFUSE, KEEP):
            raise InputError(f"{origin}: missing: {_shown(missing)}; allowed: {REFUSE}, {KEEP}")
        return cls(
            origin=origin,
            bench=Bench.load(_text(content.get("bench", "gyrowheel"), f"{origin}: bench")),
            time=_source(content["time"], f"{origin}: time", Field("s", -math.inf, math.inf)),
            sequence=None
            if sequence is None
            else _source(sequence, f"{origin}: sequence", Field("", 0, 2**53)),
            keep_missing=missing == KEEP,
            environment=_environment(content.get("environment", []), f"{origin}: environment"),
            csv=_csv_settings(content.get("csv", {}), f"{origin}: csv"),
            **groups,
        )

    @property
    def names(self) -> list[str]:
        """Names of the columns that are needed, each once."""
        sources = [self.time, *([self.sequence] if self.sequence else [])]
        for group in (self.columns, self.command, self.setpoint):
            sources += group.values()
        return list(dict.fromkeys(source.column for source in sources if source.column))


def _mapping(raw: Any, where: str, allowed: Sequence[str], *, needed: Sequence[str] = ()) -> dict[str, Any]:
    if not isinstance(raw, Mapping):
        raise InputError(f"{where}: {_shown(raw)} is not a mapping; allowed: {', '.join(allowed)}")
    for key in raw:
        if key not in allowed:
            raise InputError(f"{where}: {_shown(key)}: no such field; allowed: {', '.join(allowed)}")
    for key in needed:
        if key not in raw:
            raise InputError(f"{where}.{key}: missing" if ": " in where else f"{where}: {key}: missing")
    return dict(raw)


def _source(raw: Any, where: str, field: Field) -> Source:
    units = ("unit",) if field.unit else ()
    entry = _mapping(raw, where, ("column", "scale", "offset", "value", *units))
    if ("column" in entry) == ("value" in entry):
        raise InputError(f"{where}: either column or value must be given")
    if "value" in entry and not field.constant:
        raise InputError(f"{where}.value: a constant is not allowed here; allowed: a column")
    unit = ""
    if field.unit:
        if "unit" not in entry:
            raise InputError(f"{where}.unit: missing; allowed: such as {field.unit}")
        unit = _unit(entry["unit"], f"{where}.unit", field.unit)
    numbers = {
        key: _number(entry[key], f"{where}.{key}") for key in ("scale", "offset", "value") if key in entry
    }
    if "value" in numbers and len(numbers) > 1:
        raise InputError(f"{where}: scale and offset belong to a column, not to a value")
    if numbers.get("scale") == 0.0:
        raise InputError(f"{where}.scale: 0 is out of range; allowed: any other number")
    column = _text(entry["column"], f"{where}.column") if "column" in entry else ""
    return Source(column=column, unit=unit, **numbers)


def _refuse_shared(sources: Mapping[str, Source], fields: Mapping[str, Field], where: str) -> None:
    """Refuse a column that is said to hold two quantities; one thermometer may stand for coils and air."""
    owners: dict[str, str] = {}
    for name, source in sources.items():
        if fields[name].constant:
            continue
        if source.column in owners:
            raise InputError(
                f"{where}.{name}.column: '{source.column}' is that of {owners[source.column]}, too; "
                "allowed: a column of its own"
            )
        owners[source.column] = name


def _unit(raw: Any, where: str, si: str) -> str:
    text = _text(raw, where)
    if si == "s" and text == TIMESTAMP:
        return text
    try:
        conversion(text, si)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return text


def _environment(raw: Any, where: str) -> tuple[Environment, ...]:
    if not isinstance(raw, list):
        raise InputError(f"{where}: {_shown(raw)} is not a list of environments")
    fields = ("time_s", "rig", "yaw_deg", "air_density_ratio", "preheat_k", "table_rate_deg_s")
    factors = {"time_s": 1.0, "yaw_deg": DEG, "preheat_k": 1.0, "table_rate_deg_s": DEG}
    events = []
    for k, item in enumerate(raw):
        entry = _mapping(item, f"{where}[{k}]", fields)
        values: dict[str, Any] = {}
        for key, value in entry.items():
            if key == "rig":
                values[key] = _text(value, f"{where}[{k}].rig")
                continue
            name = key.removesuffix("_s").removesuffix("_deg").removesuffix("_k")
            values[name] = _number(value, f"{where}[{k}].{key}") * factors.get(key, 1.0)
        try:
            events.append(Environment(**values))
        except InputError as error:
            raise InputError(f"{where}[{k}]: {error}") from None
    if any(b.time <= a.time for a, b in itertools.pairwise(events)):
        raise InputError(f"{where}: the times must ascend")
    return tuple(events)


def _csv_settings(raw: Any, where: str) -> dict[str, Any]:
    entry = _CSV | _mapping(raw, where, tuple(_CSV))
    for key in ("delimiter", "decimal"):
        if not isinstance(entry[key], str) or len(entry[key]) != 1 or not entry[key].isascii():
            raise InputError(f"{where}.{key}: {_shown(entry[key])}; allowed: one character")
    if entry["delimiter"] == entry["decimal"]:
        raise InputError(f"{where}.decimal: '{entry['decimal']}' is the delimiter too; allowed: another one")
    lines = entry["skip_lines"]
    if type(lines) is not int or not 0 <= lines <= 10_000:
        raise InputError(f"{where}.skip_lines: {_shown(lines)}; allowed: 0 .. 10000")
    _text(entry["encoding"], f"{where}.encoding")
    return entry


def _number(raw: Any, where: str) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float) or not abs(raw) <= 1e300:
        raise InputError(f"{where}: {_shown(raw)} is not allowed; allowed: a finite number")
    return float(raw)


def _text(raw: Any, where: str) -> str:
    if not isinstance(raw, str) or not raw:
        raise InputError(f"{where}: {_shown(raw)} is not allowed; allowed: a text")
    return raw


def _shown(raw: Any) -> str:
    text = repr(raw)
    return text if len(text) <= 60 else f"{text[:57]}..."
