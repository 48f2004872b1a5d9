"""Bags of ROS 1 and ROS 2: every number of every message by topic and field."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file
from gyrowheel_core.limits import largest
from gyrowheel_recording.bags.bags import read_bag
from gyrowheel_recording.bags.mcap.topics import TopicData
from gyrowheel_recording.tables.grid import BYTES_A_VALUE, Column, Grid, require_table
from gyrowheel_recording.tables.readers.damage import refused, said
from gyrowheel_recording.tables.readers.messages import Decoders
from gyrowheel_recording.tables.readers.ros1 import MAGIC, Bag

_MOST: Final = 32  # elements of an array that become columns
_STAMP: Final = "stamp"
_BLOCK: Final = 4096  # values that are numbers of Python before they are an array

#: A topic, what makes objects of its messages, and each of them with its time [ns].
Message = tuple[TopicData, Callable[[bytes], Any], int, bytes]


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read the topics as ``/topic.field.field``, and their stamps as ``/topic.stamp`` (see `formats.read_grid`).

    Elements of an array are ``/topic.field.0`` and on; where a message names them, as those of joints, by their names.
    """
    topics: dict[str, _Topic] = {}
    remarks: list[str] = []
    with refused(path):
        take = _ros1 if is_file(path) and _begins(path) else _ros2
        kept, most = 0, largest() / BYTES_A_VALUE
        for topic, decode, logged, message in take(path, names, remarks):
            own = topics.setdefault(topic.name, _Topic(topic.name, names))
            if own.seen and not own.parts and names is None:
                continue
            try:
                decoded = decode(message)
            except InputError:
                raise
            except Exception as error:  # on bad data rosbags passes on whatever its generated code raises
                where = f"{path}: {topic.name}: message {own.count}"
                raise InputError(f"{where} cannot be decoded ({said(error)})") from None
            kept += own.add(decoded, logged)
            if kept > most:
                require_table(kept, str(path))
        columns = _columns(topics, names)
    if not columns and remarks:
        raise InputError(f"{path}: has no columns of numbers: {'; '.join(remarks)}")
    return Grid.of(str(path), columns, remarks)


def _begins(path: Path) -> bool:
    """Whether a file is a bag of ROS 1 by its first bytes."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def _ros1(path: Path, names: Sequence[str] | None, remarks: list[str]) -> Iterator[Message]:
    """Yield the messages of a bag of ROS 1 on topics that are wanted."""
    bag, decoders = Bag(path), Decoders(str(path), ros1=True)
    wanted: dict[str, bool] = {}
    for connection, logged, message in bag.messages():
        topic = connection.topic
        if topic.name not in wanted:
            wanted[topic.name] = names is None or any(name.startswith(f"{topic.name}.") for name in names)
        if not wanted[topic.name]:
            continue
        try:
            decode = decoders.of(topic, connection.digest)
        except InputError as error:
            if names is not None:
                raise
            wanted[topic.name] = False
            remarks.append(_left_out(error, path))
            continue
        yield topic, decode, logged, bytes(message)
    if not any(wanted.values()) and not remarks:
        raise _nothing(path, bag.topics)


def _ros2(path: Path, names: Sequence[str] | None, remarks: list[str]) -> Iterator[Message]:
    """Yield the messages of a bag of ROS 2 on topics that are wanted, topic by topic."""
    decoders = Decoders(str(path), ros1=False)
    if names is None:
        there = read_bag(path, {})
        wanted = [topic.name for topic in there.values() if topic.count]
        if _size(path) > largest() // 2:  # pictures and the like would not leave room for anything else
            for name in [name for name in wanted if decoders.has_lists_of_bytes(there[name])]:
                wanted.remove(name)
                remarks.append(f"{name} is left out: it has lists of bytes, and the bag is large")
    else:
        wanted = [name[:k] for name in names for k, sign in enumerate(name) if sign == "."]
    topics = read_bag(path, dict.fromkeys(wanted))
    if not any(topics[name].count for name in wanted if name in topics):
        raise _nothing(path, sorted(topics))
    for name, topic in topics.items():
        if name not in wanted or not topic.count:
            continue
        try:
            if topic.message_encoding != "cdr":
                raise InputError(
                    f"{path}: {name}: messages of encoding {topic.message_encoding!r}; allowed: cdr"
                )
            decode = decoders.of(topic)
        except InputError as error:
            if names is not None:
                raise
            remarks.append(_left_out(error, path))
            continue
        times = np.concatenate(topic.times).tolist()
        messages = [message for piece in topic.pieces for message in piece]
        topic.pieces, topic.times = [], []
        for logged, message in zip(times, messages, strict=True):
            yield topic, decode, logged, message


def _nothing(path: Path, topics: Sequence[str]) -> InputError:
    return InputError(f"{path}: has no such topic; there are: {', '.join(topics) or 'none'}")


def _left_out(error: InputError, path: Path) -> str:
    return f"{str(error).removeprefix(f'{path}: ')}: left out"


def _size(path: Path) -> int:
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if is_file(file))


def _columns(topics: dict[str, _Topic], names: Sequence[str] | None) -> list[Column]:
    columns: list[Column] = []
    with_times = {
        topic: own for topic, own in topics.items() if own.count and (names is not None or own.parts)
    }
    times = {topic: own.times.array() for topic, own in with_times.items()}
    begin = min((int(own.min()) for own in times.values()), default=0)
    for topic, own in with_times.items():
        clock = f"{topic}.{_STAMP}"
        order = own.order()
        columns.append(Column(clock, ((times[topic] - begin) * 1e-9)[order], "s", clock))
        columns += [Column(name, values.array()[order], "", clock) for name, values in own.values.items()]
    return columns


class _Values:
    """Numbers that are appended one by one."""

    def __init__(self, missing: int) -> None:
        self._done = [np.full(missing, np.nan)] if missing else []
        self._rest: list[Any] = []

    def append(self, value: Any) -> None:
        """Append one."""
        self._rest.append(value)
        if len(self._rest) >= _BLOCK:
            self._done.append(np.asarray(self._rest))
            self._rest = []

    def array(self) -> Any:
        """Return all of them."""
        if self._rest:
            self._done.append(np.asarray(self._rest))
            self._rest = []
        return np.concatenate(self._done) if self._done else np.zeros(0)


class _Topic:
    """The messages of a topic, as far as they were read.

    Attributes
    ----------
    count : int
        How many.
    times : _Values
        Their stamps [ns].
    parts : dict of str to callable
        How the numbers in them are taken out, by their names.
    values : dict of str to _Values
        The numbers; NaN in messages that do not have one.
    seen : set
        Lists of names in them that were met.
    """

    def __init__(self, name: str, wanted: Sequence[str] | None) -> None:
        self._name, self._wanted = name, wanted
        self.count = 0
        self.times, self._logged = _Values(0), _Values(0)
        self.parts: dict[str, Callable[[Any], Any]] = {}
        self.values: dict[str, _Values] = {}
        self.seen: set[tuple[str, ...]] = set()

    def add(self, message: Any, logged: int) -> int:
        """Add a message that was logged at a time [ns]; return how many numbers that are."""
        before = len(self.parts)
        labels = _labels(message)
        if labels not in self.seen:
            self.seen.add(labels)
            for name, pick in _fields(message, self._name):
                if name not in self.parts and (self._wanted is None or name in self._wanted):
                    self.parts[name] = pick
                    self.values[name] = _Values(self.count)
        self.times.append(_stamp(message) or logged)
        self._logged.append(logged)
        for name, pick in self.parts.items():
            self.values[name].append(pick(message))
        self.count += 1
        return 2 + len(self.parts) + (len(self.parts) - before) * self.count

    def order(self) -> Any:
        """Return what puts the messages in the order in which they were logged."""
        return np.argsort(self._logged.array(), kind="stable")


def _stamp(message: Any) -> int:
    """Return the stamp in a message [ns], in its header or beside it; 0 where there is none."""
    for holder in (getattr(message, "header", None), message):
        stamp = getattr(holder, _STAMP, None)
        if stamp is not None and hasattr(stamp, "sec") and hasattr(stamp, "nanosec"):
            return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return 0


def _labels(message: Any) -> tuple[str, ...]:
    """Return the names that a message gives to the elements of its arrays, as those of joints; none if it has none."""
    names = getattr(message, "name", None)
    if not isinstance(names, list) or not all(isinstance(own, str) and own for own in names):
        return ()
    return tuple(names) if len(set(names)) == len(names) else ()


def _fields(message: Any, name: str) -> list[tuple[str, Callable[[Any], Any]]]:
    """Return the numbers in a message: their names, and how they are taken out of another one like it."""
    found: list[tuple[str, Callable[[Any], Any]]] = []
    labels = _labels(message)
    for own in (field.name for field in fields(message)):  # constants are none
        if own == "__msgtype__" or (own == "header" and name.count(".") == 0):
            continue
        value, where = getattr(message, own), f"{name}.{own}"
        if isinstance(value, bool | int | float | np.number):
            found.append((where, operator.attrgetter(own)))
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and 0 < value.size <= _MOST:
            if labels and len(labels) == value.size:
                found += [(f"{where}.{label}", functools.partial(_labelled, own, label)) for label in labels]
            else:
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


def _labelled(name: str, label: str, message: Any) -> Any:
    """Return the element of an array that a message calls so, NaN where it has none."""
    flat, labels = getattr(message, name).ravel(), message.name
    return flat[labels.index(label)] if label in labels and len(flat) == len(labels) else np.nan
