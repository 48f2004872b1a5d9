"""Bags of ROS 1 and ROS 2: every number of every message by topic and field."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.interfaces import Nodetype

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, largest_unpacked
from gyrowheel_recording.bags.columns import checked_store
from gyrowheel_recording.bags.mcap.topics import TopicData
from gyrowheel_recording.bags.read_bag import read_bag
from gyrowheel_recording.tables.grid import BYTES_A_VALUE, Grid, require_table
from gyrowheel_recording.tables.readers import library_errors, short_message
from gyrowheel_recording.tables.readers.messages import (
    TopicColumns,
    columns_of,
    frame_of,
    stamp_of,
    wanted_fields,
)
from gyrowheel_recording.tables.readers.ros1 import MAGIC, Bag

_BYTES: Final = ("uint8", "int8", "byte", "char")
_NO_DIGEST: Final = ("", "*")


class Decoders:
    """Decoders of the messages of a bag, serialized as by ROS 1 or ROS 2."""

    def __init__(self, where: str, *, ros1: bool) -> None:
        self._where, self._ros1 = where, ros1
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
        store = checked_store(topic, where)
        what = f"{where}: the definition of {kind}"
        take = store.deserialize_ros1 if self._ros1 else store.deserialize_cdr
        try:
            store.get_msgdef(kind)
            own = store.generate_msgdef(kind)[1] if digest not in _NO_DIGEST else digest
        except Exception:  # rosbags makes code of it, for which names or sizes may not do
            raise InputError(f"{what} cannot be read") from None
        if own != digest:
            raise InputError(f"{what} is damaged: its checksum is {own}, not {digest[:40]}")

        def decode(message: bytes) -> Any:
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


_MOST_FRAMES: Final = 16  # of a topic

#: A topic, what makes objects of its messages, and each of them with its time [ns].
Message = tuple[TopicData, Callable[[bytes], Any], int, bytes]


def read(path: Path, names: Sequence[str] | None) -> Grid:
    """Read the topics as ``/topic.field.field``, and their stamps as ``/topic.stamp`` (see `formats.read_grid`).

    Elements of an array are ``/topic.field.0`` and on; where a message names them, as those of joints, by their
    names. Of messages of several frames on one topic, each frame is ``/topic@frame``.
    """
    topics: dict[str, dict[str, TopicColumns]] = {}
    failed: set[str] = set()
    last: dict[tuple[str, str], bytes] = {}  # messages, by topic and frame
    twice: dict[str, int] = {}
    remarks: list[str] = []
    with library_errors(path):
        take = _ros1 if is_file(path) and _begins(path) else _ros2
        kept, most = 0, largest_unpacked() / BYTES_A_VALUE
        for topic, decode, logged, message in take(path, names, remarks):
            if topic.name in failed:
                continue
            frames = topics.setdefault(topic.name, {})
            count = sum(own.count for own in frames.values())
            if names is None and count and all(own.seen and not own.parts for own in frames.values()):
                continue
            try:
                decoded = decode(message)
            except InputError:
                raise
            except Exception as error:  # rosbags passes on any error of its generated code
                what = f"{topic.name}: message {count} cannot be decoded ({short_message(error)})"
                if names is not None:
                    raise InputError(f"{path}: {what}") from None
                remarks.append(f"{what}: left out")
                failed.add(topic.name)
                continue
            frame = frame_of(decoded)
            if stamp_of(decoded) and last.get((topic.name, frame)) == message:
                twice[topic.name] = twice.get(topic.name, 0) + 1
                continue
            last[topic.name, frame] = message
            if frame not in frames and len(frames) >= _MOST_FRAMES:
                frame = next(iter(frames))
            own = frames.get(frame)
            if own is None:
                own = frames[frame] = TopicColumns(wanted_fields(topic.name, frame, names))
            kept += own.add(decoded, logged)
            if kept > most:
                require_table(kept, str(path))
        remarks += [f"{name}: {count} messages are there twice: taken once" for name, count in twice.items()]
        columns = columns_of(
            {name: own for name, own in topics.items() if name not in failed}, names, remarks
        )
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
            wanted[topic.name] = names is None or any(
                name.startswith((f"{topic.name}.", f"{topic.name}@")) for name in names
            )
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
        wanted = [name[:k] for name in names for k, sign in enumerate(name) if sign in ".@"]
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
