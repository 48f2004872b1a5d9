"""Bags of ROS 1 and ROS 2, by rosbags: every number of every message by topic and field."""

from __future__ import annotations

import functools
import operator
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_analysis.tables.grid import Column, Grid, require_table
from gyrowheel_core.errors import InputError, one_line

_MOST: Final = 32  # elements of an array that become columns
_STAMP: Final = "stamp"


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read the topics as ``/topic.field.field``, and their stamps as ``/topic.stamp`` (see `formats.read_grid`)."""
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    times: dict[str, list[int]] = defaultdict(list)
    values: dict[str, list[Any]] = defaultdict(list)
    parts: dict[str, list[tuple[str, Callable[[Any], Any]]]] = {}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            wanted = [
                c
                for c in reader.connections
                if c.msgcount != 0 and (names is None or any(n.startswith(f"{c.topic}.") for n in names))
            ]
            if not wanted:
                there = ", ".join(sorted({c.topic for c in reader.connections})) or "none"
                raise InputError(f"{path}: has no such topic; there are: {there}")
            require_table(float(sum(c.msgcount for c in wanted)), str(path))
            for connection, logged, raw in reader.messages(connections=wanted):
                topic = connection.topic
                if topic not in parts:
                    first = reader.deserialize(raw, connection.msgtype)
                    parts[topic] = [own for own in _fields(first, topic) if names is None or own[0] in names]
                    message = first
                    if names is None:
                        require_table(float(connection.msgcount * max(len(parts[topic]), 1)), str(path))
                    if not parts[topic] and names is None:
                        continue
                elif not parts[topic] and names is None:
                    continue
                else:
                    message = reader.deserialize(raw, connection.msgtype)
                stamp = getattr(getattr(message, "header", None), "stamp", None)
                own = 0 if stamp is None else stamp.sec * 1_000_000_000 + stamp.nanosec
                times[topic].append(own or logged)
                for name, pick in parts[topic]:
                    values[name].append(pick(message))
    except InputError:
        raise
    except AnyReaderError as error:
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    except Exception as error:  # damaged bags fail in many ways
        raise InputError(f"{path}: cannot be read: {one_line(error)}") from None
    columns: list[Column] = []
    begin = min((min(stamps) for stamps in times.values() if stamps), default=0)
    for topic, stamps in times.items():
        clock = f"{topic}.{_STAMP}"
        columns.append(Column(clock, (np.array(stamps, dtype=np.int64) - begin) * 1e-9, "s", clock))
        columns += [Column(name, np.asarray(values[name]), "", clock) for name, _ in parts[topic]]
    return Grid.of(str(path), columns)


def _fields(message: Any, name: str) -> list[tuple[str, Callable[[Any], Any]]]:
    """Return the numbers in a message: their names, and how they are taken out of another one like it."""
    found: list[tuple[str, Callable[[Any], Any]]] = []
    for own in (field.name for field in fields(message)):  # constants are none
        if own == "__msgtype__" or (own == "header" and name.count(".") == 0):
            continue
        value, where = getattr(message, own), f"{name}.{own}"
        if isinstance(value, bool | int | float | np.number):
            found.append((where, operator.attrgetter(own)))
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and 0 < value.size <= _MOST:
            found += [(f"{where}.{k}", functools.partial(_element, own, k)) for k in range(value.size)]
        elif hasattr(value, "__dataclass_fields__"):
            found += [(inner, functools.partial(_within, own, take)) for inner, take in _fields(value, where)]
    return found


def _within(name: str, take: Callable[[Any], Any], message: Any) -> Any:
    return take(getattr(message, name))


def _element(name: str, k: int, message: Any) -> Any:
    """Return an element of an array in a message, NaN where it is shorter than the first one was."""
    flat = getattr(message, name).ravel()
    return flat[k] if k < len(flat) else np.nan
