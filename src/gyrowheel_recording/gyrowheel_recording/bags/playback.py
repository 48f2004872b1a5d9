"""Playback of a recording: its messages in the order in which they are due, and the pace. Needs no ROS."""

from __future__ import annotations

import contextlib
import heapq
import math
from collections import deque
from collections.abc import Collection, Iterable, Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol, Self, TypeAlias

import numpy as np
from rosbags.interfaces import ConnectionExtRosbag2, QosDurability
from rosbags.rosbag2 import Reader

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import read_text
from gyrowheel_core.topics import Topic
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_recording.bags.metadata import HEADING, METADATA_FILE, read_metadata
from gyrowheel_recording.bags.read_bag import read_bag
from gyrowheel_recording.bags.selection import bench_in

#: How rosbag2 spells the durability of a latched topic, by the version of its metadata.
_LATCHED: Final = ("transient_local", 1)


#: Messages, each with its time [ns] and topic.
Timed: TypeAlias = Iterator[tuple[int, str, bytes]]


class Described(NamedTuple):
    """What is declared of a topic."""

    type_name: str
    encoding: str
    latched: bool


class Storage(Protocol):
    """The messages of a recording: declarations by topic, times of the first and the last message [ns]."""

    topics: dict[str, Described]
    start_ns: int
    end_ns: int

    def messages(self, names: Collection[str], start_ns: int, end_ns: int) -> Timed:
        """Yield time, topic and bytes of the messages of some topics by time, both ends included."""

    def close(self) -> None:
        """Close the files."""


def open_storage(path: Path, names: Collection[str]) -> Storage:
    """Open a recording that `read_bag` has read, and so checked; `names` are its topics that have messages.

    Compressed files and those of SQLite are unpacked into memory, as far as the limit allows; messages of
    others are read from the disk when they are due. Raises InputError if it cannot be read.
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

    def messages(self, names: Collection[str], start_ns: int, end_ns: int) -> Timed:
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
        pieces = (piece for name in self._names for piece in found[name].pieces)
        self._messages = [message for piece in pieces for message in piece]
        self.start_ns, self.end_ns = (int(self._times[0]), int(self._times[-1])) if len(time) else (0, 0)

    def messages(self, names: Collection[str], start_ns: int, end_ns: int) -> Timed:
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


#: One message: when it is due on the clock of the recording [ns], its topic, its bytes.
Message = tuple[int, Topic, bytes]

_FOREIGN_DEPTH: Final = 100  # of topics that are not of the bench
_LOOK_BACK_NS: Final = wire.SECOND  # setpoints are 5 ms apart; those of other benches may be farther apart


class Tape:
    """A recording opened for playback message by message; a context manager.

    Parameters
    ----------
    directory : str or Path
        A rosbag2 directory of any storage, or one of its files.
    only : collection of str
        Names of the topics to play, with the namespace of the bench or without; empty: all topics of the recording.
    without : collection of str
        Names of topics to leave out.
    start, end : float
        Range to play, in seconds from the first sample (from the first message where there are no samples); the
        end may be infinite.
    setpoint_lead : float
        Time by which setpoints precede their samples [s], as the conductor sends them: a node that needs the
        setpoint of a sample has it by then.

    Attributes
    ----------
    path : Path
        Where the recording is.
    topics : dict of Topic to int
        Topics that are played, and their number of messages in the whole recording.
    start_ns, end_ns : int
        Range to play, as times on the clock of the recording [ns].
    zero_ns : int
        Time from which seconds are counted [ns].

    Raises
    ------
    InputError
        If there is no such recording, it is incomplete or damaged, has no such topic, or nothing in the range.

    Notes
    -----
    A range that begins later starts with what held at its start, each with its own stamp: the messages of latched
    topics and the last setpoint.
    """

    def __init__(
        self,
        directory: str | Path,
        *,
        only: Collection[str] = (),
        without: Collection[str] = (),
        start: float = 0.0,
        end: float = math.inf,
        setpoint_lead: float = 0.5,
    ) -> None:
        self.path = Path(directory)
        if not start < end:
            raise InputError(f"{self.path}: from {start:g} s to {end:g} s: the end must lie behind the start")
        # counts messages, and checks every length and checksum of the files
        counts = {name: data.count for name, data in read_bag(self.path, {}).items() if data.count}
        bench = bench_in(counts, str(self.path))
        known = {topic.within(bench): topic for topic in topics.TOPICS}
        only, without = (
            [name if name in counts else f"{bench}{name}" for name in given] for given in (only, without)
        )
        for name in (*only, *without):
            if name not in counts:
                there = ", ".join(sorted(counts)) or "none at all"
                raise InputError(f"{self.path}: no messages on '{name}'; there are: {there}")
        names = [name for name in sorted(counts) if (not only or name in only) and name not in without]
        if not names:
            raise InputError(f"{self.path}: no topic is left to replay")
        self._stored = open_storage(self.path, counts)
        try:
            for name in names:
                if name not in self._stored.topics:
                    raise InputError(f"{self.path}: {METADATA_FILE} does not name the topic {name}")
            described = {name: self._stored.topics[name] for name in names}
            found = {name: known.get(name) or _foreign(name, own) for name, own in described.items()}
            for name, own in described.items():
                _check_type(self.path, own, found[name])
            self.topics = {found[name]: counts[name] for name in names}
            self._bench = bench
            self._lead_ns = round(setpoint_lead * wire.SECOND)
            self._set_range(start, end)
        except BaseException:
            self.close()
            raise

    @property
    def duration(self) -> float:
        """Length of the range [s]."""
        return (self.end_ns - self.start_ns) / wire.SECOND

    @property
    def start(self) -> float:
        """Start of the range [s]."""
        return self.seconds(self.start_ns)

    def seconds(self, time_ns: int) -> float:
        """Return a time on the clock of the recording [ns] as seconds from its first sample."""
        return (time_ns - self.zero_ns) / wire.SECOND

    def messages(self, *, without: Collection[Topic] = ()) -> Iterator[Message]:
        """Yield the messages of the range in the order in which they are due, without some topics.

        Setpoints are due `setpoint_lead` before their time, but not before the start.

        Raises
        ------
        InputError
            If the recording cannot be read any further.
        """
        chosen = [topic for topic in self.topics if topic not in without]
        setpoints = [topic for topic in chosen if topic == topics.SETPOINT]
        others = [topic for topic in chosen if topic != topics.SETPOINT]
        start, end = self.start_ns, self.end_ns
        yield from self._held(chosen)
        read = self._read(setpoints, start, end)
        ahead = ((max(due - self._lead_ns, start), topic, data) for due, topic, data in read)
        # at equal times the setpoint comes first, because the sample needs it
        yield from heapq.merge(ahead, self._read(others, start, end), key=itemgetter(0))

    def close(self) -> None:
        """Close the files."""
        self._stored.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _set_range(self, start: float, end: float) -> None:
        first, last = self._stored.start_ns, self._stored.end_ns
        sample = next(iter(self._read([topics.MEASUREMENT], first, last)), None)
        self.zero_ns = first if sample is None else sample[0]
        if self.zero_ns + start * wire.SECOND > last:
            raise InputError(f"{self.path}: nothing from {start:g} s on; it lasts {self.seconds(last):.4f} s")
        # messages that came before the first sample belong to the start
        self.start_ns = first if start <= 0.0 else self.zero_ns + round(start * wire.SECOND)
        self.end_ns = last if end == math.inf else min(self.zero_ns + round(end * wire.SECOND), last)

    def _held(self, chosen: Collection[Topic]) -> Iterator[Message]:
        """Yield what held at the start of the range."""
        begin, start = self._stored.start_ns, self.start_ns
        if start <= begin:
            return
        latched = [topic for topic in chosen if topic.latched]
        last: dict[Topic, deque[bytes]] = {topic: deque(maxlen=topic.depth) for topic in latched}
        for _, topic, data in self._read(latched, begin, start - 1):
            last[topic].append(data)
        if topics.SETPOINT in chosen:
            near = self._read([topics.SETPOINT], max(start - _LOOK_BACK_NS, begin), start - 1)
            last[topics.SETPOINT] = deque((data for _, _, data in near), maxlen=1)
        for topic, messages in last.items():
            for data in messages:
                yield start, topic, data

    def _read(self, chosen: Iterable[Topic], start_ns: int, end_ns: int) -> Iterator[Message]:
        """Yield the messages of topics by time, both ends included."""
        by_name = {topic.within(self._bench): topic for topic in chosen}
        for time, name, data in self._stored.messages(by_name.keys(), start_ns, end_ns):
            yield time, by_name[name], data


class Pace:
    """The pace of a replay: how far it may be at an instant of wall-clock time.

    Parameters
    ----------
    rate : float
        Seconds of the recording per second; 0: no limit.
    start_ns : int
        Time of the recording to begin at [ns].
    paused : bool
        Whether it starts paused.
    """

    def __init__(self, rate: float, start_ns: int, *, paused: bool = False) -> None:
        if not (math.isfinite(rate) and rate >= 0.0):
            raise InputError(f"rate: {rate!r} is out of range; allowed: 0 (no limit) or more")
        self.rate = rate
        self.paused = paused
        # time of the recording [ns], and the wall-clock time at which it held [s]
        self._from: tuple[int, float | None] = (start_ns, None)

    def limit(self, now: float) -> float:
        """Return the time of the recording up to which messages are due [ns]; it may be infinite.

        Parameters
        ----------
        now : float
            Monotonic wall-clock time [s].
        """
        position, since = self._from
        if self.paused:
            return position
        if self.rate == 0.0:
            return math.inf
        if since is None:
            self._from = position, now
            return position
        return position + (now - since) * self.rate * wire.SECOND

    def hold(self, position_ns: int) -> None:
        """Pause at a time of the recording [ns]."""
        self.paused = True
        self._from = position_ns, None

    def go(self, position_ns: int) -> None:
        """Continue from a time of the recording [ns] at the next call of `limit`."""
        self.paused = False
        self._from = position_ns, None

    def move(self, position_ns: int) -> None:
        """Move to another time of the recording [ns], paused or not."""
        self._from = position_ns, None


def parse_names(text: str) -> tuple[str, ...]:
    """Return the topic names in a text, separated by commas or spaces."""
    return tuple(text.replace(",", " ").split())


def _foreign(name: str, described: Described) -> Topic:
    """Return a topic that is not of the bench, with its recorded durability."""
    return Topic(name, described.type_name, _FOREIGN_DEPTH, latched=described.latched, fixed=True)


def _check_type(path: Path, described: Described, topic: Topic) -> None:
    if described.type_name != topic.type_name:
        raise InputError(
            f"{path}: {topic.name}: type {described.type_name}; allowed: {topic.type_name}, or leave the topic out"
        )
    if described.encoding != "cdr":
        raise InputError(f"{path}: {topic.name}: encoded as '{described.encoding}'; allowed: cdr")
