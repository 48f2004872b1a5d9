"""Playback of a recording: its messages in the order in which they are due, and the pace. Needs no ROS.

Messages of any storage are yielded as the bytes that were recorded (`stored`). The node ``replay`` (`nodes.replay`)
publishes them.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Collection, Iterable, Iterator
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.topics import Topic
from gyrowheel_recording.bags.bags import read_bag
from gyrowheel_recording.bags.metadata import METADATA_FILE
from gyrowheel_recording.bags.namespace import bench_in
from gyrowheel_recording.bags.stored import Described, stored

#: One message: when it is due on the clock of the recording [ns], its topic, its bytes.
Message = tuple[int, Topic, bytes]

_DEPTH: Final = 100  # of topics that are not of the bench
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
        self._stored = stored(self.path, counts)
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
        """Yield the messages of the range in the order in which they are due.

        Setpoints are due `setpoint_lead` before their time, but not before the start.

        Parameters
        ----------
        without : collection of Topic
            Further topics to leave out.

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
        ahead = (
            (max(due - self._lead_ns, start), topic, data)
            for due, topic, data in self._read(setpoints, start, end)
        )
        # at equal times the setpoint comes first, because the sample needs it
        yield from heapq.merge(ahead, self._read(others, start, end), key=itemgetter(0))

    def close(self) -> None:
        """Close the files."""
        self._stored.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
            near = deque(
                self._read([topics.SETPOINT], max(start - _LOOK_BACK_NS, begin), start - 1), maxlen=1
            )
            last[topics.SETPOINT] = deque(data for _, _, data in near)
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

    Attributes
    ----------
    paused : bool
        Whether it is paused.
    """

    def __init__(self, rate: float, start_ns: int, *, paused: bool = False) -> None:
        if not (math.isfinite(rate) and rate >= 0.0):
            raise InputError(f"rate: {rate!r} is out of range; allowed: 0 (no limit) or more")
        self.rate = rate
        self.paused = paused
        # time of the recording [ns], and the wall-clock time at which it held [s]
        self._from: tuple[int, float | None] = (
            start_ns,
            None,
        )

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
    return Topic(name, described.type_name, _DEPTH, latched=described.latched, fixed=True)


def _check_type(path: Path, described: Described, topic: Topic) -> None:
    if described.type_name != topic.type_name:
        raise InputError(
            f"{path}: {topic.name}: type {described.type_name}; allowed: {topic.type_name}, or leave the topic out"
        )
    if described.encoding != "cdr":
        raise InputError(f"{path}: {topic.name}: encoded as '{described.encoding}'; allowed: cdr")
