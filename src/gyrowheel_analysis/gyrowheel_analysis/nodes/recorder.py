"""The node ``recorder``: writes what the nodes of the bench say to each other into a recording.

Messages are taken and written as bytes. Times in a recording are those of the bench: a measurement, command
or setpoint stands at its own stamp, anything else at the stamp of the latest measurement.
"""

from __future__ import annotations

from typing import Final

from diagnostic_msgs.msg import DiagnosticStatus
from gyrowheel_msgs.srv import SplitRecording, StartRecording, StopRecording

from gyrowheel_analysis.recording import RecordingWriter
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import BenchNode, Diagnosis, Inbox, Param, run_node
from gyrowheel_core.topics import Topic

SERVICES: Final = "/gyrowheel/recorder"
#: Time between two instants at which everything goes to the disk [s, wall clock]; a killed recorder loses no more.
FLUSH_PERIOD: Final = 0.1
#: Time between two instants at which what has come is written [s, wall clock].
TAKE_PERIOD: Final = 0.02


class SampleCount:
    """Counts the samples that do not arrive, by their sequence numbers.

    Attributes
    ----------
    samples, missing : int
        Samples that came, and those before or between them that did not.
    """

    def __init__(self) -> None:
        self.samples = self.missing = 0
        self._next: int | None = None

    def add(self, sequence: int) -> bool:
        """Take note of a sample; return False if it is the first one of another run."""
        if sequence == 0 and self._next is not None:
            return False
        if self._next is None or sequence >= self._next:
            self.missing += 0 if self._next is None else sequence - self._next
            self._next = sequence + 1
        else:  # out of order: it was taken for missing
            self.missing -= 1
        self.samples += 1
        return True


class Session:
    """One recording on its way.

    Parameters
    ----------
    directory : str
        To create.
    max_size : int
        Size from which a file is completed and the next one begun [bytes]; 0: no limit.
    max_duration : float
        The same by time of the bench [s].

    Attributes
    ----------
    writer : RecordingWriter
        What writes it.
    count : SampleCount
        The samples that came.
    """

    def __init__(self, directory: str, *, max_size: int = 0, max_duration: float = 0.0) -> None:
        self.writer = RecordingWriter(directory, max_size=max_size, max_duration=max_duration, reserve=True)
        self.count = SampleCount()
        self._now: int | None = None  # stamp of the latest measurement [ns]
        self._early: list[tuple[Topic, bytes]] = []  # came before the first measurement

    def take(self, topic: Topic, data: bytes) -> bool:
        """Write one message; return False where it is the first sample of another run.

        Raises
        ------
        InputError
            If the disk does not take it.
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
            If the disk does not take it.
        """
        self._write_early(0)
        self._state_loss()
        self.writer.close()

    def give_up(self) -> str:
        """After an error of the disk, complete what was written; return in one line what has become of it."""
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
        """Return in one line what was recorded, and what was lost."""
        lost = f"{self.count.missing} missing" if self.count.missing else "none missing"
        return f"{self.writer.path}: {self.messages} messages, {self.count.samples} samples, {lost}"

    def _state_loss(self) -> None:
        """State in the metadata what was counted on the way."""
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


class RecorderNode(BenchNode):
    """Records the topics of the bench, but for the truth."""

    NODE_NAME = "recorder"
    PARAMETERS = (
        Param(
            "directory", "", "Directory to create and record into at once; empty: wait for the service start"
        ),
        Param("record_clock", False, "Record /clock too"),
        Param(
            "max_bag_size",
            0,
            "Size from which a file is completed and the next one begun [bytes]; 0: no limit",
            low=0,
        ),
        Param(
            "max_bag_duration",
            0.0,
            "Time of the bench after which a file is completed and the next one begun [s]; 0: no limit",
            low=0.0,
        ),
    )
    #: What was on its way when the others ended still arrives.
    LINGER = 0.5

    def configure(self) -> None:
        """Offer the services."""
        left_out = {topics.TRUTH.name} | (set() if self.parameter("record_clock") else {topics.CLOCK.name})
        self._recorded = [topic for topic in topics.TOPICS if topic.name not in left_out]
        self._session: Session | None = None
        self._open: list[Inbox] = []
        self._report = "waiting for the service start"
        self._offers = [
            self.create_service(kind, f"{SERVICES}/{name}", handle)
            for kind, name, handle in (
                (StartRecording, "start", self._on_start),
                (StopRecording, "stop", self._on_stop),
                (SplitRecording, "split", self._on_split),
            )
        ]

    def activate(self) -> None:
        """Begin to record if a directory was given."""
        self._flushing = self.wall_timer(FLUSH_PERIOD, self._flush)
        self._taking = self.wall_timer(TAKE_PERIOD, self.drain)
        if self.parameter("directory"):
            self._begin(self.parameter("directory"))

    def deactivate(self) -> None:
        """Complete the recording."""
        self.destroy_timer(self._flushing)
        self.destroy_timer(self._taking)
        self._write_waiting()
        self._end()

    def cleanup(self) -> None:
        """Withdraw the services."""
        for service in self._offers:
            self.destroy_service(service)

    def diagnose(self) -> Diagnosis:
        """Return what is being recorded."""
        session = self._session
        if session is None:
            return Diagnosis(self._report)
        values = {
            "directory": session.writer.path,
            "messages": session.messages,
            "samples": session.count.samples,
            "missing_samples": session.count.missing,
        }
        if session.count.missing:
            return Diagnosis("recording; samples are missing", values, DiagnosticStatus.WARN)
        return Diagnosis("recording", values)

    def _begin(self, directory: str) -> None:
        """Begin a recording; InputError if the directory exists or cannot be made."""
        self._session = Session(
            directory,
            max_size=self.parameter("max_bag_size"),
            max_duration=self.parameter("max_bag_duration"),
        )
        # Only now: a plant that counts its subscribers must not begin before there is something to write to.
        self._open = [self.inbox(topic) for topic in self._recorded]
        self.get_logger().info(f"recording into {directory}")

    def _end(self) -> None:
        """Complete the recording, if there is one; InputError if the disk does not take it."""
        session, self._session = self._session, None
        for inbox in self._open:
            self.close_inbox(inbox)
        self._open = []
        if session is None:
            return
        try:
            session.close()
        except InputError as error:
            raise InputError(f"{error}; {session.give_up()}") from None
        self._report = session.report()
        if session.count.missing:
            self.get_logger().warning(self._report)
        else:
            self.get_logger().info(self._report)

    def drain(self) -> None:
        """Write what has come; where the disk does not take it, give up."""
        try:
            self._write_waiting()
        except InputError as error:
            self._fail(error)

    def _write_waiting(self) -> None:
        """Write what has come and was not taken yet; InputError if the disk does not take it."""
        for inbox in self._open:
            for data in inbox.take():
                if self._session is None or not self._take(self._session, inbox.topic, data):
                    return

    def _take(self, session: Session, topic: Topic, data: bytes) -> bool:
        """Write one message; return False, and end the recording, where it is the first one of another run."""
        if session.take(topic, data):
            return True
        self.get_logger().warning("the plant was started again: the recording of its last run ends")
        self._end()
        return False

    def _flush(self) -> None:
        """Leave nothing in memory for long, however slowly messages come."""
        if self._session is not None:
            try:
                self._session.writer.flush()
            except InputError as error:
                self._fail(error)

    def _fail(self, error: InputError) -> None:
        """Give up: what was written stays."""
        text = str(error)
        if self._session is not None:
            session, self._session = self._session, None
            text = f"{text}; {session.give_up()}"
        self.fault("recording_failed", text)

    def _on_start(
        self, request: StartRecording.Request, response: StartRecording.Response
    ) -> StartRecording.Response:
        if self.state != "active":
            response.message = "the recorder is not active"
        elif self._session is not None:
            response.message = f"already recording into {self._session.writer.path}"
        elif not request.directory:
            response.message = "no directory is given"
        else:
            try:
                self._begin(request.directory)
                response.success, response.message = True, f"recording into {request.directory}"
            except InputError as error:
                response.message = str(error)
        return response

    def _on_stop(
        self, request: StopRecording.Request, response: StopRecording.Response
    ) -> StopRecording.Response:
        session = self._session
        if session is None:
            response.message = "not recording"
            return response
        try:
            self._write_waiting()
            self._end()
            response.success, response.message = True, self._report
            response.messages = session.messages
        except InputError as error:
            response.message = str(error)
            self._fail(error)
        return response

    def _on_split(
        self, request: SplitRecording.Request, response: SplitRecording.Response
    ) -> SplitRecording.Response:
        if self._session is None:
            response.message = "not recording"
            return response
        try:
            self._session.writer.split()
            response.success, response.message = True, "goes on in a new file"
        except InputError as error:
            response.message = str(error)
            self._fail(error)
        return response


def main() -> int:
    """Run the node."""
    return run_node(RecorderNode)
