"""A recording in progress: each message is written at its time on the clock of the bench. Needs no ROS.

A measurement, command or setpoint is written at its own stamp, anything else at the stamp of the latest measurement.
"""

from __future__ import annotations

from gyrowheel_analysis.recording.writer import RecordingWriter
from gyrowheel_core import topics, wire
from gyrowheel_core.topics import Topic


class SampleCount:
    """Counts samples that arrive and that are missing, by their sequence numbers.

    Attributes
    ----------
    samples, missing : int
        Samples that arrived, and samples between them that did not.
    """

    def __init__(self) -> None:
        self.samples = self.missing = 0
        self._next: int | None = None

    def add(self, sequence: int) -> bool:
        """Count a sample; return False if it is the first one of another run."""
        if sequence == 0 and self._next is not None:
            return False
        if self._next is None or sequence >= self._next:
            self.missing += 0 if self._next is None else sequence - self._next
            self._next = sequence + 1
        else:  # out of order: it was counted as missing
            self.missing -= 1
        self.samples += 1
        return True


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

    Attributes
    ----------
    writer : RecordingWriter
        The writer.
    count : SampleCount
        Counts of the samples.
    """

    def __init__(self, directory: str, *, max_size: int = 0, max_duration: float = 0.0) -> None:
        self.writer = RecordingWriter(directory, max_size=max_size, max_duration=max_duration, reserve=True)
        self.count = SampleCount()
        self._now: int | None = None  # stamp of the latest measurement [ns]
        self._early: list[tuple[Topic, bytes]] = []  # came before the first measurement

    def take(self, topic: Topic, data: bytes) -> bool:
        """Write one message; return False if it is the first sample of another run.

        Raises
        ------
        InputError
            If the disk refuses it.
        """
        try:
            stamp = None if topic.layout is None else wire.stamp(data)
        except ValueError:  # from a node that is not of this bench
            stamp = None
        if stamp is None:
            self._take_unstamped(topic, data)
            return True
        if topic is topics.MEASUREMENT:
            if not self._count(data):
                return False
            self._now = stamp
            if self._early:
                self._write_early(stamp)
        self.writer.write(topic, data, stamp)
        return True

    def close(self) -> None:
        """Complete the recording.

        Raises
        ------
        InputError
            If the disk refuses it.
        """
        self._write_early(0)
        self._state_loss()
        self.writer.close()

    def give_up(self) -> str:
        """After a disk error, complete what was written; return one line about the outcome."""
        self._state_loss()
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
        return f"{self.writer.path}: {self.messages} messages, {self.count.samples} samples, {lost}"

    def _state_loss(self) -> None:
        """State the counts in the metadata."""
        self.writer.custom_data |= {
            "gyrowheel.samples": str(self.count.samples),
            "gyrowheel.missing_samples": str(self.count.missing),
        }

    def _count(self, data: bytes) -> bool:
        try:
            return self.count.add(wire.MEASUREMENT.unpack(data)[1])
        except ValueError:  # of another frame: recorded, but not counted
            return True

    def _take_unstamped(self, topic: Topic, data: bytes) -> None:
        if self._now is None:
            self._early.append((topic, data))
        else:
            self.writer.write(topic, data, self._now)

    def _write_early(self, stamp_ns: int) -> None:
        for topic, data in self._early:
            self.writer.write(topic, data, stamp_ns)
        self._early.clear()
