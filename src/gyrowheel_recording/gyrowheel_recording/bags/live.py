"""A recording in progress: each message is written at its time on the clock of the bench. Needs no ROS.

A measurement, command or setpoint is written at its own stamp, anything else at the stamp of the latest measurement.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Sequence
from typing import Literal

from gyrowheel_core import topics, wire
from gyrowheel_core.topics import Topic
from gyrowheel_recording.bags.columns import STALL
from gyrowheel_recording.bags.metadata import ENTRY, Division, Publisher, Source, to_text
from gyrowheel_recording.bags.writer import RecordingWriter

_REMEMBERED = 10_000  # numbers of samples that may still come out of order


class SampleCount:
    """Counts samples that arrive and that are missing, by their sequence numbers.

    Attributes
    ----------
    samples, missing, surplus : int
        Different samples that arrived, samples between them that did not, and further messages: with the number of one
        that had arrived, or of another publisher.
    """

    def __init__(self) -> None:
        self.samples = self.missing = self.surplus = 0
        self._next: int | None = None
        self._gaps: set[int] = set()  # numbers that are missing, at least the latest _REMEMBERED

    def add(self, sequence: int) -> bool:
        """Count a sample; return False if it is the first one of another run."""
        if sequence == 0 and self._next is not None:
            return False
        if self._next is None or sequence >= self._next:
            if self._next is not None and sequence > self._next:
                self.missing += sequence - self._next
                self._gaps |= set(range(max(self._next, sequence - _REMEMBERED), sequence))
                if len(self._gaps) > 2 * _REMEMBERED:
                    self._gaps = {number for number in self._gaps if number >= sequence - _REMEMBERED}
            self._next = sequence + 1
        elif sequence in self._gaps:  # out of order
            self._gaps.remove(sequence)
            self.missing -= 1
        else:
            self.surplus += 1
            return True
        self.samples += 1
        return True


class StallCount:
    """Finds the times at which the bench stood still: no sample is missing, and the stamps go on much later."""

    def __init__(self) -> None:
        self.number = 0  # how many there were
        self.last = ""  # the last one, in words; empty without one
        self._first: tuple[int, int] | None = None  # stamp and sequence number of the first sample
        self._before = (0, 0)  # of the last one
        self._period = 0  # shortest step of the stamps so far [ns]

    def add(self, stamp: int, sequence: int) -> None:
        """Look at a sample; its stamp is in ns."""
        if self._first is None:
            self._first = stamp, sequence
        elif sequence == self._before[1] + 1 and (step := stamp - self._before[0]) > 0:
            if self._period and step > STALL * self._period:
                self.number += 1
                at = (self._before[0] - self._first[0]) * 1e-9
                self.last = f"stood still {(step - self._period) * 1e-9:.3f} s at {at:.1f} s"
            else:
                self._period = min(self._period or step, step)
        self._before = stamp, sequence


class LiveRecording:
    """A recording in progress.

    Parameters
    ----------
    directory : str
        To create.
    max_size : int
        File size at which the next file begins [bytes]; 0: no limit.
    max_duration : float
        Bench time after which the next file begins [s]; 0: no limit.
    look : callable, optional
        Returns the publishers that a topic has had: pairs of GID and node. By default they are not known.
    present : callable, optional
        Returns the GIDs of those publishers of a topic that are there now; by default all that it has had.
    namespace : str
        Namespace in which the bench runs: empty for the root, else such as ``/bench2``.
    """

    def __init__(
        self,
        directory: str,
        *,
        max_size: int = 0,
        max_duration: float = 0.0,
        look: Callable[[Topic], Sequence[tuple[str, str]]] | None = None,
        present: Callable[[Topic], Collection[str]] | None = None,
        namespace: str = "",
    ) -> None:
        self.writer = RecordingWriter(
            directory, max_size=max_size, max_duration=max_duration, reserve=True, namespace=namespace
        )
        self._namespace = namespace
        self.count = SampleCount()  # counts of the samples
        self.surplus_commands = 0  # commands for a sample that had been answered
        self._answered = -1  # sample that the last command answered
        self._look = look
        self._source: Source | None = None
        if look is not None:
            had = functools.partial(look, topics.MEASUREMENT)
            self._source = Source(
                had,
                functools.partial(present, topics.MEASUREMENT) if present else lambda: [g for g, _ in had()],
            )
        self._divisions: dict[Topic, Division] = {}
        self.stalls = StallCount()  # where the bench stood still
        self._now: int | None = None  # stamp of the latest measurement [ns]
        self._early: list[tuple[Topic, bytes]] = []  # came before the first measurement

    def take(self, topic: Topic, data: bytes, number: int | None = None) -> bool:
        """Write one message; return False if it is the first sample of another run, which is not written.

        A recording is of one run: a sample of another publisher is left out and counted as surplus. `number`
        is the number that its publisher gave the message, where known. Raises InputError if the disk refuses
        it.
        """
        try:
            stamp = None if topic.layout is None else wire.stamp(data)
        except ValueError:  # from a node that is not of this bench
            stamp = None
        if topic is topics.MEASUREMENT and stamp is not None:
            whose = self._whose(data, number)
            if whose != "own":
                self.count.surplus += whose == "other"
                return whose != "again"
        if topic is not topics.MEASUREMENT:
            self._divide(topic, number)
        if stamp is None:
            self._take_unstamped(topic, data)
            return True
        if topic is topics.COMMAND:
            self._count_command(data)
        if topic is topics.MEASUREMENT:
            self._now = stamp
            if self._early:
                self._write_early(stamp)
        self.writer.write(topic, data, stamp)
        return True

    def close(self) -> None:
        """Complete the recording; raises InputError if the disk refuses it."""
        self._write_early(0)
        self._state()
        self.writer.close()

    def give_up(self) -> str:
        """After a disk error, complete what was written; return one line about the outcome."""
        self._state()
        path, written = self.writer.path, self.messages
        if self.writer.rescue():
            return f"{path} is complete up to there, {self.messages} of {written} messages"
        return f"what was written is not complete: gyrowheel salvage {path} -o DIR brings it back"

    @property
    def messages(self) -> int:
        """Messages written."""
        return sum(self.writer.counts.values())

    def report(self) -> str:
        """Return one line about what was recorded and what was lost."""
        lost = f"{self.count.missing} missing" if self.count.missing else "none missing"
        surplus = {"samples": self.count.surplus, "commands": self.surplus_commands}
        more = "".join(f", {count} surplus {what}" for what, count in surplus.items() if count)
        return f"{self.writer.path}: {self.messages} messages, {self.count.samples} samples, {lost}{more}"

    def publishers(self) -> list[Publisher]:
        """Return who published what, as far as it is known."""
        found: list[Publisher] = []
        if self._source is not None and self.count.samples:
            found += self._source.result(topics.MEASUREMENT.within(self._namespace))
        for division in self._divisions.values():
            found += division.result()
        return found

    def _state(self) -> None:
        """State in the metadata what was counted, and who published it."""
        self.writer.custom_data |= {
            "gyrowheel.samples": str(self.count.samples),
            "gyrowheel.missing_samples": str(self.count.missing),
            "gyrowheel.surplus_samples": str(self.count.surplus),
            "gyrowheel.surplus_commands": str(self.surplus_commands),
            "gyrowheel.stalls": str(self.stalls.number),
        }
        if self._look is not None:
            self.writer.custom_data[ENTRY] = to_text(self.publishers())

    def _divide(self, topic: Topic, number: int | None) -> None:
        """Count the message for its publisher."""
        division = self._divisions.get(topic)
        if division is None:
            if self._look is None:
                return
            look = self._look
            division = self._divisions[topic] = Division(topic.within(self._namespace), lambda: look(topic))
        if number is None or topic.shared:
            division.unknown = True
        else:
            division.add(number)

    def _count_command(self, data: bytes) -> None:
        try:
            answered = wire.COMMAND.unpack(data)[1]
        except ValueError:  # of another frame
            return
        self.surplus_commands += answered <= self._answered
        self._answered = max(answered, self._answered)

    def _whose(self, data: bytes, number: int | None) -> Literal["own", "repeated", "other", "again"]:
        """Count a sample if it is the run's own; return whose it is."""
        try:
            stamp, sequence, *_ = wire.MEASUREMENT.unpack(data)
        except ValueError:  # of another frame: recorded, but not counted
            return "own"
        if self._source is not None:
            whose = self._source.of(number, sequence)
            if whose != "own":
                return whose
        self.stalls.add(stamp, sequence)
        return "own" if self.count.add(sequence) else "again"

    def _take_unstamped(self, topic: Topic, data: bytes) -> None:
        if self._now is None:
            self._early.append((topic, data))
        else:
            self.writer.write(topic, data, self._now)

    def _write_early(self, stamp_ns: int) -> None:
        for topic, data in self._early:
            self.writer.write(topic, data, stamp_ns)
        self._early.clear()
