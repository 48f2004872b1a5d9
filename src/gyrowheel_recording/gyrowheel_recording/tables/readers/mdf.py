"""MDF files of version 3 and 4, by asammdf: each group of channels has a clock of its own."""

from __future__ import annotations

import ast
import contextlib
import io
import operator
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables.grid import Column, Grid, require_table
from gyrowheel_recording.tables.readers import library, library_errors

_LONGEST: Final = 1000
_VARIABLES: Final = ("X", "X1", "x", "x1")
_CONSTANTS: Final = {"INF": np.inf, "NaN": np.nan}
_FUNCTIONS: Final = {
    name: getattr(np, f"arc{name[1:]}" if name in ("asin", "acos", "atan") else name)
    for name in (
        "abs", "sqrt", "exp", "expm1", "log", "log10", "log1p", "sin", "cos", "tan", "arcsin", "arccos", "arctan",
        "arctan2", "asin", "acos", "atan", "sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh",
    )
}  # fmt: skip
_OPERATIONS: Final[dict[type, Callable[..., Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}


def evaluate(formula: str, values: Any, where: str) -> NDArray[np.float64]:
    """Return the values of a formula for those of its variable, ``X`` or ``X1``.

    Raises
    ------
    InputError
        If it consists of anything but numbers, the variable, known functions and signs of arithmetic.
    """
    variable = np.asarray(values, dtype=np.float64)
    try:
        if len(formula) > _LONGEST:
            raise ValueError
        tree = ast.parse(formula.strip(), mode="eval")
        with np.errstate(all="ignore"):
            result = np.asarray(_value(tree.body, variable), dtype=np.float64)
        return np.array(np.broadcast_to(result, variable.shape))
    except (ValueError, TypeError, KeyError, SyntaxError, RecursionError, OverflowError):
        raise InputError(
            f"{where}: its values are by the formula {formula[:80]!r}, which is not read"
        ) from None


def _value(node: ast.expr, variable: NDArray[np.float64]) -> Any:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return np.float64(node.value)
    if isinstance(node, ast.Name) and node.id in _VARIABLES:
        return variable
    if isinstance(node, ast.Name) and node.id in _CONSTANTS:
        return np.float64(_CONSTANTS[node.id])
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATIONS:
        return _OPERATIONS[type(node.op)](_value(node.operand, variable))
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATIONS:
        return _OPERATIONS[type(node.op)](_value(node.left, variable), _value(node.right, variable))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _FUNCTIONS[node.func.id](*(_value(own, variable) for own in node.args))
    raise ValueError


_WIDEST: Final = 64  # bits of a number; what is wider is a text or an array
_UNFINISHED: Final = b"UnFinMF"
_OF_PACKED: Final = (".bz2", ".gzip", ".mf4z", ".zip")
_MAY_BE_INVALID: Final = 3  # flags of a channel
_OF_ANY_LENGTH: Final = 1  # type of the channels of version 4 whose values are elsewhere in the file: texts


@dataclass(frozen=True)
class _Wanted:
    """A channel that is read: its group and number, what it is called, and its clock."""

    group: int
    number: int
    name: str
    clock: str


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read the channels by their names, and the clock of each group as ``time`` (see `formats.read_grid`)."""
    asammdf = library("asammdf", "mdf", path)
    columns: list[Column] = []
    remarks: list[str] = []
    with library_errors(path), _opened(asammdf, path) as file:
        others = _not_over_time(file)
        wanted = [own for own in _wanted(file, names) if own.group not in others]
        remarks += [
            f"{', '.join(what)}: over {axis}, not over time: left out" for axis, what in others.values()
        ]
        _require_room(file, wanted, path)
        clocks: set[str] = set()
        for own in wanted:
            if own.clock not in clocks:
                clocks.add(own.clock)
                times = _times(file, own, path)
                columns.append(Column(own.clock, times, "s", own.clock))
            if own.number < 0:
                continue
            group = file.groups[own.group]
            channel = group.channels[own.number]
            _require_within(group, channel, f"{path}: {own.name}")
            try:
                formula, unit = _formula(channel, f"{path}: {own.name}")
            except InputError as error:
                if names is not None:
                    raise
                remarks.append(f"{str(error).removeprefix(f'{path}: ')}: left out")
                continue
            # samples that the logger marks as invalid stay, or the others would lose their times
            samples, invalid = file.get(
                group=own.group, index=own.number, samples_only=True, ignore_invalidation_bits=True
            )
            values = np.asarray(samples)
            _require_all(values, group, f"{path}: {own.name}")
            if values.ndim != 1 or values.dtype.kind not in "biuf":
                continue
            if formula:
                values = evaluate(formula, values, f"{path}: {own.name}")
            if invalid is not None and np.any(invalid):
                values = np.where(np.asarray(invalid, dtype=bool), np.nan, values.astype(np.float64))
            columns.append(Column(own.name, values, unit, own.clock))
    return Grid.of(str(path), columns, remarks)


def _source(path: Path) -> str | io.BytesIO:
    """Return what asammdf reads: the file, or its content where asammdf would copy, change or remove the file."""
    with path.open("rb") as file:
        if file.read(len(_UNFINISHED)) != _UNFINISHED and path.suffix.lower() not in _OF_PACKED:
            return str(path)
        file.seek(0)
        return io.BytesIO(file.read())


@contextlib.contextmanager
def _opened(asammdf: Any, path: Path) -> Iterator[Any]:
    """Open a file so that asammdf reads it by what checks its sizes: its faster way does not, and crashes."""
    with contextlib.closing(asammdf.MDF(_source(path), process_bus_logging=False)) as file:
        own = file._mdf
        before, own._from_filelike = own._from_filelike, True
        try:
            yield file
        finally:
            own._from_filelike = before


def _require_within(group: Any, channel: Any, where: str) -> None:
    """Refuse a channel that is not within the records of its group: asammdf would write beyond its memory."""
    record = group.channel_group.samples_byte_nr
    if hasattr(channel, "byte_offset"):  # version 4
        end = 8 * channel.byte_offset + channel.bit_offset + channel.bit_count
    else:
        end = 8 * getattr(channel, "additional_byte_offset", 0) + channel.start_offset + channel.bit_count
    if end > 8 * record:
        raise InputError(f"{where}: damaged: it is not within the {record} bytes of a record")
    size = getattr(group.channel_group, "invalidation_bytes_nr", 0)
    if size and channel.flags & _MAY_BE_INVALID and channel.pos_invalidation_bit >= 8 * size:
        raise InputError(f"{where}: damaged: its mark of validity is not within a record")


def _wanted(file: Any, names: Sequence[str] | None) -> Iterator[_Wanted]:
    """Yield the channels of numbers that are wanted, in the order of the file; among them a clock that is."""
    every = [channel.name for group in file.groups for channel in group.channels]
    repeated: set[str] = {name for name, count in Counter(every).items() if count > 1}
    several = len(file.groups) > 1
    for g, group in enumerate(file.groups):
        if not group.channel_group.cycles_nr:
            continue
        clock = f"time {g + 1}" if several else "time"
        if names is None or clock in names:
            yield _Wanted(g, -1, clock, clock)
        for k, channel in enumerate(group.channels):
            name = f"{channel.name} {g + 1}" if channel.name in repeated else channel.name
            if (
                k != file.masters_db.get(g)
                and (names is None or name in names)
                and channel.bit_count <= _WIDEST
                and not group.channel_dependencies[k]
                and not (hasattr(channel, "component_addr") and channel.channel_type == _OF_ANY_LENGTH)
            ):
                yield _Wanted(g, k, name, clock)


#: What the master of a group is, by its type of synchronization; a time without one.
_AXES: Final = {2: "an angle", 3: "a distance", 4: "an index"}
#: Seconds in the unit of a clock, where its loggers wrote another one than seconds.
_SECONDS: Final = {
    "ms": 1e-3,
    "us": 1e-6,
    "\u00b5s": 1e-6,
    "\u03bcs": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
}


def _not_over_time(file: Any) -> dict[int, tuple[str, list[str]]]:
    """Return the groups whose values are over something else than time: what it is, and their channels."""
    found = {}
    for g, group in enumerate(file.groups):
        number = file.masters_db.get(g)
        axis = "" if number is None else _AXES.get(getattr(group.channels[number], "sync_type", 1), "")
        if axis and group.channel_group.cycles_nr:
            found[g] = axis, [own.name for k, own in enumerate(group.channels) if k != number]
    return found


def _require_room(file: Any, wanted: Sequence[_Wanted], path: Path) -> None:
    """Refuse more values than the memory may hold."""
    used = {own.group for own in wanted}
    cycles = {g: float(group.channel_group.cycles_nr) for g, group in enumerate(file.groups)}
    require_table(sum(cycles[own.group] for own in wanted) + sum(cycles[g] for g in used), str(path))


def _times(file: Any, own: _Wanted, path: Path) -> Any:
    """Return the times of a group."""
    number = file.masters_db.get(own.group)
    where, formula, factor = f"{path}: {own.clock}", "", 1.0
    if number is not None:
        group = file.groups[own.group]
        _require_within(group, group.channels[number], where)
        formula, unit = _formula(group.channels[number], where)
        factor = _SECONDS.get(unit.strip(), 1.0)
    times = np.asarray(file.get_master(own.group), dtype=np.float64)
    _require_all(times, file.groups[own.group], where)
    return factor * (evaluate(formula, times, where) if formula else times)


def _require_all(values: Any, group: Any, where: str) -> None:
    """Refuse a group that has fewer records than it states, or more."""
    stated = group.channel_group.cycles_nr
    if len(values) != stated:
        raise InputError(f"{where}: damaged: it has {len(values)} values, where {stated} are stated")


def _formula(channel: Any, where: str) -> tuple[str, str]:
    """Take the formula of a channel's values from it, and return it, or none, and their unit.

    asammdf runs a formula as a program where all else fails, so it must not see one.
    """
    own: Any = channel.conversion
    waiting: list[Any] = [own]
    while waiting:
        conversion = waiting.pop()
        within = (getattr(conversion, "referenced_blocks", None) or {}).values()
        waiting += [other for other in within if hasattr(other, "convert")]
        text: Any = getattr(conversion, "formula", "")
        if text and conversion is not own:
            raise InputError(f"{where}: its values are by a formula within a table, which is not read")
    text = getattr(own, "formula", "")
    text = text.decode("latin-1") if isinstance(text, bytes) else text
    if text:
        evaluate(str(text), np.zeros(0), where)  # raises the error of a bad formula
        channel.conversion = None
    return str(text), str(getattr(own, "unit", "") or channel.unit or "")
