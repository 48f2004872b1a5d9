"""Readings of a running bench from messages of other types, by the map with which a bag of them is imported."""

from __future__ import annotations

import itertools
import math
import statistics
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from gyrowheel_core import wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import conversion
from gyrowheel_recording.mapping.map_file import READINGS, ColumnMap, Reading, Source
from gyrowheel_recording.tables.readers.messages import Pick, frame_of, numbers_in, stamp_of, wanted_fields

_STAMP: Final = ".stamp"
_FIRST: Final = 20  # samples whose times give the period; none is released before
_LOST: Final = 1.75  # periods between two samples from which on others were between them
_BRIDGED: Final = 4.5  # periods of another topic; over a longer gap only what changes slowly is known
_OTHER_CLOCK: Final = 60.0  # seconds between the clocks of two topics from which on they are moved together
_TURNED: Final = (
    0.9 * math.pi
)  # between two samples, beyond which an angle does not show how far it was [rad]
_TURN: Final = 2.0 * math.pi


class Sample(NamedTuple):
    """A sample: its time from the first one [ns], its number, and the readings in the order of `READINGS` [SI]."""

    stamp: int
    number: int
    readings: tuple[float, ...]


@dataclass(frozen=True)
class _Scale:
    """Conversion of a number in a message to SI units, and what is plausible."""

    reading: Reading
    factor: float
    offset: float
    nothing: float  # a number that stands for no reading

    @classmethod
    def of(cls, name: str, source: Source) -> _Scale:
        reading = READINGS[name]
        if source.resistance:
            offset, factor = (source.resistance * own for own in conversion(source.unit, "A"))
        else:
            offset, factor = conversion(source.unit, reading.unit)
        return cls(reading, factor * source.scale, factor * source.offset + offset, source.missing)

    def __call__(self, number: float) -> float:
        """Return the reading; NaN where there is none."""
        return math.nan if number == self.nothing else self.factor * number + self.offset


@dataclass
class _Feed:
    """The messages of one topic: which readings they have, and the last of these by time."""

    topic: str
    names: dict[str, str] = field(default_factory=dict)  # column of each reading
    late: int = 0  # what is added to its stamps [ns]
    frame: str | None = None  # of its messages, where the map names none
    offset: int | None = None  # arrival of the first message after its stamp [ns]
    picks: dict[str, dict[str, Pick]] = field(default_factory=dict)  # of the numbers, by frame and column
    times: dict[str, deque[int]] = field(default_factory=dict)  # of the numbers of each reading
    values: dict[str, deque[float]] = field(default_factory=dict)


def topic_of(column: str) -> str:
    """Return the topic of a column that a bag has: ``/joint_states.position.rotor``, ``/imu@frame.field``.

    Raises InputError if it is no such column.
    """
    at = min((k for k in map(column.find, ".@") if k >= 0), default=-1)
    if at < 2 or not column.startswith("/"):
        raise InputError(f"'{column}' is no field of a topic; allowed: such as /joint_states.position.rotor")
    return column[:at]


class LiveReadings:
    """Makes samples of the bench from messages of any types, which come topic by topic.

    The messages of one topic, that of the map's time, are the samples. Readings of other topics are interpolated to
    their times, and temperatures and pressures are the last ones; a reading that does not come in time is missing.
    """

    def __init__(self, column_map: ColumnMap, *, patience: float) -> None:
        """Take a map; `patience`: how long to wait for the messages of other topics [s].

        Raises
        ------
        InputError
            If something in the map cannot be done with messages that are still to come.
        """
        self._map = column_map
        self._patience = round(patience * wire.SECOND)
        where = column_map.origin
        for what, given in (
            ("rate", column_map.rate),
            ("every", column_map.every > 1),
            ("time.plus", column_map.time.plus),
            ("command", column_map.command),
            ("setpoint", column_map.setpoint),
        ):
            if given:
                raise InputError(f"{where}: {what}: is not possible live; allowed: without")
        if not column_map.time.column.endswith(_STAMP):
            raise InputError(
                f"{where}: time.column: '{column_map.time.column}' is not possible live; "
                "allowed: the stamps of a topic, such as /joint_states.stamp"
            )
        self.base = topic_of(column_map.time.column)
        self.feeds = {self.base: _Feed(self.base)}
        self._scales: dict[str, _Scale] = {}
        self._constants = dict.fromkeys(READINGS, math.nan)
        for name, source in column_map.columns.items():
            self._add(name, source, f"{where}: columns.{name}")
        if column_map.sequence is not None:
            topic = topic_of(column_map.sequence.column)
            if topic != self.base:
                raise InputError(
                    f"{where}: sequence.column: is of {topic}; allowed: of {self.base}, as the time"
                )
            self.feeds[topic].names["sequence"] = column_map.sequence.column
        for clock, seconds in column_map.clocks.items():
            if (feed := self.feeds.get(topic_of(clock))) is not None:
                feed.late = round(seconds * wire.SECOND)
        self._waiting: deque[tuple[int, dict[str, float]]] = deque()  # samples, oldest first
        self._zero: int | None = None  # stamp of the first sample [ns]
        self._last = (0, -1)  # stamp and number of the last sample that was released
        self._period = 0.0  # of the samples [ns]; 0 until it is known
        #: Samples that were released; readings that came too late or not at all; readings out of range; messages
        #: whose stamps did not ascend, and samples that were lost before this.
        self.samples = self.missing_readings = self.out_of_range = self.not_ascending = self.lost = 0
        self.why = ""  # the first reading that was out of range

    def _add(self, name: str, source: Source, where: str) -> None:
        if source.pulses:
            raise InputError(f"{where}.pulses: is not possible live; allowed: an angle")
        if not source.column:
            offset, factor = conversion(source.unit, READINGS[name].unit)
            self._constants[name] = factor * source.value + offset
            return
        try:
            topic = topic_of(source.column)
            if source.clock and topic_of(source.clock) != topic:
                raise InputError(f"'{source.clock}' is another topic's; allowed: {topic}{_STAMP}")
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        feed = self.feeds.setdefault(topic, _Feed(topic))
        feed.names[name] = source.column
        self._scales[name] = _Scale.of(name, source)
        if topic != self.base:
            feed.times[name], feed.values[name] = deque(maxlen=10_000), deque(maxlen=10_000)

    def take(self, topic: str, message: Any, arrival: int) -> None:
        """Take a message of a topic that arrived at a time [ns].

        Raises
        ------
        InputError
            If it lacks a field that the map names, or comes from another frame than those before it.
        """
        feed = self.feeds[topic]
        frame = frame_of(message)
        picks = feed.picks.get(frame)
        if picks is None:
            picks = feed.picks[frame] = self._picks(feed, frame, message)
        if not picks and feed.names:
            return  # of a frame that is not wanted
        stamp = stamp_of(message) or arrival
        if feed.offset is None:
            feed.offset = arrival - stamp
        numbers = {name: float(pick(message)) for name, pick in picks.items()}
        if topic == self.base:
            self._begin(stamp, numbers)
        for name, times in feed.times.items():
            if name in numbers and (not times or stamp > times[-1]):
                times.append(stamp + feed.late)
                feed.values[name].append(self._read(name, numbers[name]))

    def _picks(self, feed: _Feed, frame: str, message: Any) -> dict[str, Pick]:
        """Return how the numbers that are wanted are taken out of the messages of a frame."""
        columns = list(feed.names.values())
        plain = [column for column in columns if column.startswith(f"{feed.topic}.")]
        if plain:
            if feed.frame not in (None, frame):
                raise InputError(
                    f"{feed.topic}: its messages are of several frames; allowed: "
                    f"{feed.topic}@{feed.frame}, {feed.topic}@{frame}"
                )
            feed.frame = frame
        wanted = wanted_fields(feed.topic, frame, columns) or frozenset()
        there = numbers_in(message)
        if lacking := [place for place in wanted if place not in there]:
            raise InputError(
                f"{feed.topic}: its messages have no field {', '.join(sorted(lacking))}; there are: {', '.join(there)}"
            )
        heads = (feed.topic, f"{feed.topic}@{frame}")
        return {
            name: there[column.removeprefix(head)]
            for name, column in feed.names.items()
            for head in heads
            if column.startswith(f"{head}.") and column.removeprefix(head) in there
        }

    def _begin(self, stamp: int, numbers: Mapping[str, float]) -> None:
        """Take a sample that waits for the readings of other topics."""
        stamp += self.feeds[self.base].late
        if self._waiting and stamp <= self._waiting[-1][0]:
            self.not_ascending += 1
            return
        read = {name: self._read(name, value) for name, value in numbers.items() if name != "sequence"}
        if "sequence" in numbers:
            read["sequence"] = numbers["sequence"]
        self._waiting.append((stamp, read))

    def _read(self, name: str, number: float) -> float:
        """Return a reading in SI units; NaN where it is none, or out of range."""
        scale = self._scales[name]
        value = scale(number)
        if scale.reading.low <= value <= scale.reading.high:
            return value
        if math.isfinite(value):
            self.out_of_range += 1
            self.why = self.why or (
                f"{name}: {value:.6g} {scale.reading.unit}; allowed: {scale.reading.low:g} .. {scale.reading.high:g}"
            )
        return math.nan

    def take_samples(self) -> Iterator[Sample]:
        """Yield the samples whose readings are complete, or for which nobody waits any longer."""
        if not self._period:
            if len(self._waiting) < _FIRST:
                return
            stamps = [stamp for stamp, _ in self._waiting]
            self._period = float(statistics.median(b - a for a, b in itertools.pairwise(stamps)))
        while self._waiting:
            stamp, read = self._waiting[0]
            late = self._waiting[-1][0] - stamp > self._patience
            if not late and not all(self._has_come(feed, stamp) for feed in self.feeds.values()):
                return
            self._waiting.popleft()
            if self._zero is not None and stamp <= self._last[0]:
                self.not_ascending += 1
                continue
            yield self._released(stamp, read)

    def _has_come(self, feed: _Feed, stamp: int) -> bool:
        shift = self._shift(feed)
        return all(
            times and times[-1] + shift >= stamp
            for name, times in feed.times.items()
            if not READINGS[name].constant
        )

    def _shift(self, feed: _Feed) -> int:
        """Return what is added to the stamps of a topic whose clock is another one [ns]."""
        base = self.feeds[self.base].offset
        if feed.offset is None or base is None:
            return 0
        apart = feed.offset - base
        return apart if abs(apart) > _OTHER_CLOCK * wire.SECOND else 0

    def _released(self, stamp: int, read: dict[str, float]) -> Sample:
        values = {**self._constants, **read}
        for feed in self.feeds.values():
            shift = self._shift(feed)
            for name, times in feed.times.items():
                values[name] = self._at(name, times, feed.values[name], stamp - shift)
        rate = values["spin_rate"]
        if math.isfinite(rate) and abs(rate) * self._period / wire.SECOND > _TURNED:
            values["spin_angle"] = math.nan
        angle = math.fmod(values["spin_angle"], _TURN)
        values["spin_angle"] = angle + _TURN if angle < 0.0 else angle
        self.missing_readings += sum(math.isnan(values[name]) for name in self._scales)
        number = self._number(stamp, read)
        self._zero = stamp if self._zero is None else self._zero
        self._last = stamp, number
        self.samples += 1
        return Sample(stamp - self._zero, number, tuple(values[name] for name in READINGS))

    def _number(self, stamp: int, read: Mapping[str, float]) -> int:
        """Return the number of a sample: that of its message, or by the time since the one before."""
        before, number = self._last
        if self._zero is None:
            return round(read.get("sequence", 0.0))
        if "sequence" in read:
            ahead = round(read["sequence"]) - number
        else:
            periods = (stamp - before) / self._period
            ahead = round(periods) if periods > _LOST else 1
        ahead = max(ahead, 1)
        self.lost += ahead - 1
        return number + ahead

    def _at(self, name: str, times: deque[int], values: deque[float], stamp: int) -> float:
        """Return a reading of another topic at the time of a sample, and drop those that are no longer needed."""
        while len(times) > 1 and times[1] <= stamp:
            times.popleft()
            values.popleft()
        if not times or times[0] > stamp:
            return math.nan
        if READINGS[name].constant or times[0] == stamp:
            return values[0]
        if len(times) < 2:
            return math.nan
        gap = times[1] - times[0]
        if gap > _BRIDGED * self._period and gap > _BRIDGED * _period(times):
            return math.nan
        part = (stamp - times[0]) / gap
        step = values[1] - values[0]
        if name == "spin_angle":  # it wraps at every turn
            step = math.remainder(step, _TURN)
        return values[0] + part * step


def _period(times: deque[int]) -> float:
    """Return the usual time between the last messages of a topic [ns]."""
    last = [times[k] for k in range(max(len(times) - 9, 0), len(times))]
    return float(statistics.median(b - a for a, b in itertools.pairwise(last))) if len(last) > 1 else 0.0
