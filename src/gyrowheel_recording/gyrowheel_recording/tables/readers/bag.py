"""Bags of ROS 1 and ROS 2: every number of every message by topic and field."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.typesys.store import Typestore

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, largest_unpacked, require_room
from gyrowheel_recording.bags.columns import checked_store
from gyrowheel_recording.bags.mcap.topics import TopicData
from gyrowheel_recording.bags.read_bag import read_bag
from gyrowheel_recording.tables.grid import BYTES_A_VALUE, Column, Grid, require_table
from gyrowheel_recording.tables.readers import library_errors, short_message
from gyrowheel_recording.tables.readers.ros1 import MAGIC, Bag

_OBJECT: Final = 200  # bytes of a message within another, of one byte
_MOST_DEFINED: Final = (
    4_000_000  # characters of all definitions that are read; the parser takes a minute for them
)
#: Messages within a message (without its lists), and those of them that are empty.
_MOST_OBJECTS, _MOST_EMPTY = 100_000, 1000
_DEEPEST: Final = 50
_NOTHING: Final = "structure_needs_at_least_one_member"  # the field of an empty type, which is not looked at
_BYTES: Final = ("uint8", "int8", "byte", "char")
_NO_DIGEST: Final = ("", "*")


class Decoders:
    """Decoders of the messages of a bag, serialized as by ROS 1 or ROS 2."""

    def __init__(self, where: str, *, ros1: bool) -> None:
        self._where, self._ros1 = where, ros1
        self._left = _MOST_DEFINED
        self._known: dict[tuple[str, str, str], Callable[[bytes], Any]] = {}

    def of(self, topic: TopicData, digest: str = "") -> Callable[[bytes], Any]:
        """Return what makes objects of the messages of a topic, whose definition has a checksum or none.

        Raises InputError if their type cannot be read; so does what is returned, if a message cannot.
        """
        key = topic.type_name, topic.definition, digest
        if key not in self._known:
            self._known[key] = self._new(topic, digest)
        return self._known[key]

    def _new(self, topic: TopicData, digest: str) -> Callable[[bytes], Any]:
        where, kind = f"{self._where}: {topic.name}", topic.type_name
        self._left -= len(topic.definition)
        if self._left < 0:
            raise InputError(f"{self._where}: definitions of types of more than {_MOST_DEFINED} characters")
        store = checked_store(topic, where)
        what = f"{where}: the definition of {kind}"
        size = _size(store, kind, what)
        if size.objects > _MOST_OBJECTS or size.empty > _MOST_EMPTY:
            raise InputError(
                f"{what} has {size.objects:.3g} messages within it, {size.empty:.3g} of them empty"
            )
        take = store.deserialize_ros1 if self._ros1 else store.deserialize_cdr
        try:
            store.get_msgdef(kind)
            own = store.generate_msgdef(kind)[1] if digest not in _NO_DIGEST else digest
        except Exception:  # rosbags makes code of it, for which names or sizes may not do
            raise InputError(f"{what} cannot be read") from None
        if own != digest:
            raise InputError(f"{what} is damaged: its checksum is {own}, not {digest[:40]}")

        def decode(message: bytes) -> Any:
            if size.lists:
                require_room(_OBJECT * float(len(message)), f"{where}: a message")
            return take(message, kind)

        return decode

    def has_lists_of_bytes(self, topic: TopicData) -> bool:
        """Whether messages of a topic have lists of bytes, as pictures and clouds of points do."""
        try:
            store = checked_store(topic, self._where)
        except InputError:
            return False
        lists = [
            field[1][0] for _, field in store.fielddefs[topic.type_name][1] if field[0] == Nodetype.SEQUENCE
        ]
        return any(own[0] == Nodetype.BASE and own[1][0] in _BYTES for own in lists)


class _Size(NamedTuple):
    """What a message takes at least: bytes, objects, those of them without a byte; and whether it has lists of some."""

    size: int = 0
    objects: float = 0.0
    empty: float = 0.0
    lists: bool = False

    def __add__(self, other: _Size) -> _Size:  # type: ignore[override]
        return _Size(
            self.size + other.size,
            self.objects + other.objects,
            self.empty + other.empty,
            self.lists or other.lists,
        )


def _size(store: Typestore, kind: str, what: str) -> _Size:
    """Return what a message of a type takes at least.

    Raises
    ------
    InputError
        If the type contains itself, or lists of empty messages: their length has no limit.
    """
    known: dict[str, _Size] = {}

    def of_type(name: str, depth: int) -> _Size:
        if name in known:
            return known[name]
        if name not in store.fielddefs:
            raise InputError(f"{what} lacks that of {name}")
        if depth > _DEEPEST:
            raise InputError(f"{what} contains itself, or types more than {_DEEPEST} deep")
        stored = [field for own, field in store.fielddefs[name][1] if own != _NOTHING]
        own = sum((of_field(field, depth + 1) for field in stored), _Size(objects=1.0))
        known[name] = own if own.size else own._replace(empty=own.objects)
        return known[name]

    def of_field(field: FieldDesc, depth: int) -> _Size:
        if field[0] == Nodetype.BASE:
            return _Size(1)
        if field[0] == Nodetype.NAME:
            return of_type(field[1], depth)
        element, count = field[1]
        own = of_field(element, depth)
        several = own.lists or element[0] == Nodetype.NAME or element[1][0] == "string"
        if field[0] == Nodetype.ARRAY:
            return _Size(own.size * count, own.objects * count, own.empty * count, several)
        if not own.size or own.empty:
            raise InputError(f"{what} has lists of messages without anything in them")
        return _Size(4, 0.0, 0.0, several)

    return of_type(kind, 0)


_MOST: Final = 32  # elements of an array that become columns
_STAMP: Final = "stamp"
_BLOCK: Final = 4096  # values that are numbers of Python before they are an array

#: A topic, what makes objects of its messages, and each of them with its time [ns].
Message = tuple[TopicData, Callable[[bytes], Any], int, bytes]


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read the topics as ``/topic.field.field``, and their stamps as ``/topic.stamp`` (see `formats.read_grid`).

    Elements of an array are ``/topic.field.0`` and on; where a message names them, as those of joints, by their
    names.
    """
    topics: dict[str, _Topic] = {}
    remarks: list[str] = []
    with library_errors(path):
        take = _ros1 if is_file(path) and _begins(path) else _ros2
        kept, most = 0, largest_unpacked() / BYTES_A_VALUE
        for topic, decode, logged, message in take(path, names, remarks):
            own = topics.setdefault(topic.name, _Topic(topic.name, names))
            if own.seen and not own.parts and names is None:
                continue
            try:
                decoded = decode(message)
            except InputError:
                raise
            except Exception as error:  # rosbags passes on any error of its generated code
                where = f"{path}: {topic.name}: message {own.count}"
                raise InputError(f"{where} cannot be decoded ({short_message(error)})") from None
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
        if (
            _bytes_of(path) > largest_unpacked() // 2
        ):  # pictures and the like would not leave room for anything else
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


def _bytes_of(path: Path) -> int:
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
    """The messages of a topic, as far as they were read."""

    def __init__(self, name: str, wanted: Sequence[str] | None) -> None:
        self._name, self._wanted = name, wanted
        self.count = 0  # how many
        self.times, self._logged = _Values(0), _Values(0)  # their stamps [ns]
        #: How the numbers in them are taken out, by their names.
        self.parts: dict[str, Callable[[Any], Any]] = {}
        self.values: dict[str, _Values] = {}  # the numbers; NaN in messages that do not have one
        self.seen: set[tuple[str, ...]] = set()  # lists of names in them that were met

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
    """Return the stamp of a message [ns], in its header or without one; 0 if there is no stamp."""
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
    for own in (field.name for field in fields(message)):  # without constants
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
