"""The messages of a recording of any storage in the order of time, for playback."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from rosbags.interfaces import ConnectionExtRosbag2, QosDurability
from rosbags.rosbag2 import Reader

from gyrowheel_core import topics
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import read_text
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_recording.bags.bags import read_bag
from gyrowheel_recording.bags.metadata import HEADING, METADATA_FILE, read_metadata

#: How rosbag2 spells the durability of a latched topic, by the version of its metadata.
_LATCHED: Final = ("transient_local", 1)


class Described(NamedTuple):
    """What is declared of a topic."""

    type_name: str
    encoding: str
    latched: bool


class Stored(Protocol):
    """The messages of a recording.

    Attributes
    ----------
    topics : dict of str to Described
        What is declared of each topic, by name.
    start_ns, end_ns : int
        Times of the first and the last message [ns].
    """

    topics: dict[str, Described]
    start_ns: int
    end_ns: int

    def messages(
        self, names: Collection[str], start_ns: int, end_ns: int
    ) -> Iterator[tuple[int, str, bytes]]:
        """Yield time, topic and bytes of the messages of some topics by time, both ends included."""

    def close(self) -> None:
        """Close the files."""


def stored(path: Path, names: Collection[str]) -> Stored:
    """Open a recording that `read_bag` has read, and so checked.

    What is compressed, as a whole or message by message, and what SQLite keeps is unpacked into the memory, as far as
    the limit allows; messages of others are read from the disk when they are due.

    Parameters
    ----------
    path : Path
        The recording.
    names : collection of str
        Names of the topics that have messages.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    if path.is_file():
        return _Streamed(path) if path.suffix == ".mcap" else _Loaded(path, names)
    metadata = read_metadata(path / METADATA_FILE)
    is_plain = metadata.storage == "mcap" and metadata.compression in ("none", "storage")
    return _Streamed(path) if is_plain else _Loaded(path, names)


class _Streamed:
    """Messages that are read from the disk when they are asked for."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._reader = Reader(path)
            self._reader.open()
            self.topics = {c.topic: _described(c) for c in self._reader.connections}
            self.start_ns, self.end_ns = int(self._reader.start_time), int(self._reader.end_time) - 1
        except Exception as error:  # on damaged files rosbags passes on whatever its parsers raise
            raise InputError(f"{path}: cannot be read: {one_line(error)}") from None

    def messages(
        self, names: Collection[str], start_ns: int, end_ns: int
    ) -> Iterator[tuple[int, str, bytes]]:
        connections = [c for c in self._reader.connections if c.topic in names]
        if not connections:  # rosbags would take an empty list for all topics
            return
        try:
            for connection, time, data in self._reader.messages(connections, start_ns, end_ns + 1):
                yield time, connection.topic, bytes(data)
        except Exception as error:  # on damaged files rosbags passes on whatever its parsers raise
            raise InputError(f"{self._path}: cannot be read: {one_line(error)}") from None

    def close(self) -> None:
        if self._reader.is_open:
            self._reader.close()


class _Loaded:
    """Messages in memory."""

    def __init__(self, path: Path, names: Collection[str]) -> None:
        found = read_bag(path, dict.fromkeys(names))
        latched = _stated_as_latched(path)
        self.topics = {
            name: Described(topic.type_name, topic.message_encoding, name in latched)
            for name, topic in found.items()
        }
        self._names = sorted(names, key=_rank)
        times = [np.concatenate(found[name].times) for name in self._names]
        owners = np.repeat(np.arange(len(times)), [len(part) for part in times])
        time = np.concatenate(times) if times else np.zeros(0, dtype=np.int64)
        # at equal times in the order of the topics, and of the file
        order = np.argsort(time, kind="stable")
        self._times, self._owners, self._places = time[order], owners[order], order
        self._messages = [
            message for name in self._names for piece in found[name].pieces for message in piece
        ]
        self.start_ns, self.end_ns = (int(self._times[0]), int(self._times[-1])) if len(time) else (0, 0)

    def messages(
        self, names: Collection[str], start_ns: int, end_ns: int
    ) -> Iterator[tuple[int, str, bytes]]:
        first = int(np.searchsorted(self._times, start_ns, side="left"))
        last = int(np.searchsorted(self._times, end_ns, side="right"))
        for k in range(first, last):
            name = self._names[self._owners[k]]
            if name in names:
                yield int(self._times[k]), name, bytes(self._messages[self._places[k]])

    def close(self) -> None:
        self._messages.clear()


def _described(connection: Any) -> Described:
    extension = connection.ext
    assert isinstance(extension, ConnectionExtRosbag2)
    latched = any(p.durability is QosDurability.TRANSIENT_LOCAL for p in extension.offered_qos_profiles)
    return Described(connection.msgtype, extension.serialization_format, latched)


def _rank(name: str) -> tuple[bool, int, str]:
    """Return where a topic comes among messages of the same time: descriptions, then the bench, then others."""
    known = [number for number, topic in enumerate(topics.TOPICS) if name.endswith(topic.name)]
    is_latched = bool(known) and topics.TOPICS[known[0]].latched
    return not is_latched, known[0] if known else len(topics.TOPICS), name


def _stated_as_latched(path: Path) -> set[str]:
    """Return the topics whose last messages ``metadata.yaml`` states to be delivered to readers that come later."""
    file = path / METADATA_FILE
    if not file.is_file():
        return set()
    found = set()
    with contextlib.suppress(InputError, KeyError, TypeError, AttributeError):
        for entry in read_yaml(read_text(file), str(file))[HEADING]["topics_with_message_count"]:
            described = entry["topic_metadata"]
            profiles = described.get("offered_qos_profiles") or []
            if isinstance(profiles, str):  # up to version 8
                profiles = read_yaml(profiles, str(file))
            if any(profile.get("durability") in _LATCHED for profile in profiles):
                found.add(str(described["name"]))
    return found
