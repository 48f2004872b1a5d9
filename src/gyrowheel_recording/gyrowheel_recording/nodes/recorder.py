"""The node ``recorder``: records the topics of the bench.

`LiveRecording` writes the messages as the bytes that arrive.
"""

from __future__ import annotations

from typing import Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from gyrowheel_msgs.srv import SplitRecording, StartRecording, StopRecording
from rclpy.serialization import deserialize_message

from gyrowheel_core import namespaces, topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PRIORITY, BenchNode, Inbox, NodeStatus, Param, run_node
from gyrowheel_core.topics import Topic
from gyrowheel_recording.bags.live import LiveRecording

SERVICES: Final = "gyrowheel/recorder"
#: Key of the diagnosis where the recording that was asked for has ended.
ENDED: Final = "recording_ended"
#: Period at which goes to the disk what waits since the last time [s, wall-clock time]; a killed recorder loses what
#: came in two periods, and of samples that come as fast as they should what is in one chunk.
FLUSH_PERIOD: Final = 0.1
#: Period at which arrived messages are written [s, wall-clock time].
TAKE_PERIOD: Final = 0.02
#: Messages of a topic that may wait until then: of one that is published as fast as the middleware can.
ROOM: Final = 5_000
#: A stall of this length is reported at once: another one may come before the next diagnosis [s].
TOLD_AT_ONCE: Final = 0.02


def already_recording(directory: str) -> str:
    """Return what a recorder answers that is asked to start while it records into a directory."""
    return f"already recording into {directory}"


class RecorderNode(BenchNode):
    """Records the topics of the bench, except the truth."""

    NODE_NAME = "recorder"
    PARAMETERS = (
        Param(
            "directory", "", "Directory to create and record into at once; empty: wait for the service start"
        ),
        Param("record_clock", False, "Record the clock too"),
        Param("max_bag_size", 0, "File size at which the next file begins [bytes]; 0: no limit", low=0),
        Param(
            "max_bag_duration", 0.0, "Bench time after which the next file begins [s]; 0: no limit", low=0.0
        ),
        PRIORITY,
    )
    #: Messages in transit when the other nodes end still arrive.
    LINGER = 0.5

    def configure(self) -> None:
        """Offer the services."""
        # efforts of the joints become commands, of which each is recorded; those who send efforts keep one alone
        left_out = {topics.TRUTH.name, topics.JOINT_COMMANDS.name}
        left_out |= set() if self.parameter("record_clock") else {topics.CLOCK.name}
        self._recorded = [topic for topic in topics.TOPICS if topic.name not in left_out]
        self._recording: LiveRecording | None = None
        self._begun = False  # whether the directory of the parameter was recorded into
        self._open: list[Inbox] = []
        self._report = "waiting for the service start"
        self._cut = False  # whether a recording ended because the plant was started again
        self._stalls = 0  # as they were last looked at
        self._offers = [
            self.create_service(kind, f"{SERVICES}/{name}", handle)
            for kind, name, handle in (
                (StartRecording, "start", self._on_start),
                (StopRecording, "stop", self._on_stop),
                (SplitRecording, "split", self._on_split),
            )
        ]

    def activate(self) -> None:
        """Start recording if a directory was given; activated again, wait for the service start."""
        self.prioritise()
        self._flushing = self.wall_timer(FLUSH_PERIOD, self._flush)
        self._taking = self.wall_timer(TAKE_PERIOD, self.drain)
        if self.parameter("directory") and not self._begun:
            self._begin(self.parameter("directory"))
            self._begun = True

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

    def diagnose(self) -> NodeStatus:
        """Return what is being recorded."""
        recording = self._recording
        if recording is None:
            ended = {ENDED: self._report} if self._begun else {}
            if not self._cut:
                return NodeStatus(self._report, ended)
            text = f"not recording: the plant was started again, which ended {self._report}"
            return NodeStatus(text, ended, DiagnosticStatus.WARN)
        values = {
            "directory": recording.writer.path,
            "messages": recording.messages,
            "samples": recording.count.samples,
            "missing_samples": recording.count.missing,
            "surplus_samples": recording.count.surplus,
            "surplus_commands": recording.surplus_commands,
            "stalls": recording.stalls.number,
        }
        if recording.count.missing:
            return NodeStatus("recording; samples are missing", values, DiagnosticStatus.WARN)
        if recording.count.surplus or recording.surplus_commands:
            text = "recording; samples or commands came more than once"
            return NodeStatus(text, values, DiagnosticStatus.WARN)
        if recording.stalls.number:
            text = f"recording; the bench {recording.stalls.last}"
            return NodeStatus(text, values | {"last_stall": recording.stalls.last}, DiagnosticStatus.WARN)
        return NodeStatus("recording", values)

    def _begin(self, directory: str) -> None:
        """Start a recording; InputError if the directory exists or cannot be created."""
        self._recording = LiveRecording(
            directory,
            max_size=self.parameter("max_bag_size"),
            max_duration=self.parameter("max_bag_duration"),
            look=self.watch.publishers,
            present=self._present,
            namespace=self.namespace,
        )
        self._cut, self._stalls = False, 0
        # only now: a plant that counts its subscribers must not start before the recording exists
        self._open = [self.inbox(topic, room=ROOM) for topic in self._recorded]
        self.get_logger().info(f"recording into {directory}")
        self.announce()

    def _present(self, topic: Topic) -> set[str]:
        """Return the GIDs of the publishers that a topic has now."""
        return {bytes(own.endpoint_gid).hex() for own in self.get_publishers_info_by_topic(topic.relative)}

    def _end(self) -> None:
        """Complete the recording, if there is one; InputError if the disk refuses it."""
        recording, self._recording = self._recording, None
        for inbox in self._open:
            self.close_inbox(inbox)
        self._open = []
        if recording is None:
            return
        try:
            recording.close()
        except InputError as error:
            raise InputError(f"{error}; {recording.give_up()}") from None
        self._report = recording.report()
        if recording.count.missing:
            self.get_logger().warning(self._report)
        else:
            self.get_logger().info(self._report)

    def drain(self) -> None:
        """Write the messages that have arrived; give up if the disk refuses them."""
        try:
            self._write_waiting()
        except InputError as error:
            self._fail(error)

    def _write_waiting(self) -> None:
        """Write the messages that wait; InputError if the disk refuses them."""
        for inbox in self._open:
            for data in inbox.take():
                if self._recording is None or not self._take(self._recording, inbox, data):
                    return

    def _take(self, recording: LiveRecording, inbox: Inbox, data: bytes) -> bool:
        """Write one message; if it is the first of another run, end the recording and return False."""
        if inbox.topic is topics.DIAGNOSTICS and self._is_of_another(data):
            return True
        if recording.take(inbox.topic, data, inbox.number):
            if recording.stalls.number != self._stalls:
                self._stalls = recording.stalls.number
                self._tell_stall(recording.stalls.last)
            return True
        self.get_logger().warning("the plant was started again: the recording of its last run ends")
        self._end()
        self._cut = True
        self.announce()
        return False

    def _tell_stall(self, said: str) -> None:
        """Report a long stall at once: ``stood still 0.295 s at 41.2 s``."""
        if float(said.split()[2]) >= TOLD_AT_ONCE and self.state == "active":
            self.announce()

    def _is_of_another(self, data: bytes) -> bool:
        """Return whether a message on /diagnostics is of a bench in another namespace alone."""
        statuses = deserialize_message(data, DiagnosticArray).status
        mine = self.namespace
        return bool(statuses) and all(namespaces.is_of_another(s.hardware_id, mine) for s in statuses)

    def _flush(self) -> None:
        """Send to the disk what has waited for a period: messages that fill no chunk in it."""
        if self._recording is not None:
            try:
                self._recording.writer.flush_old()
            except InputError as error:
                self._fail(error)

    def _fail(self, error: InputError) -> None:
        """Give up; what was written remains."""
        text = str(error)
        if self._recording is not None:
            recording, self._recording = self._recording, None
            text = f"{text}; {recording.give_up()}"
        self.fault("recording_failed", text)

    def _on_start(
        self, request: StartRecording.Request, response: StartRecording.Response
    ) -> StartRecording.Response:
        if self.state != "active":
            response.message = "the recorder is not active"
        elif self._recording is not None:
            response.message = already_recording(str(self._recording.writer.path))
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
        recording = self._recording
        if recording is None:
            response.message = "not recording"
            return response
        try:
            self._write_waiting()
            self._end()
            response.success, response.message = True, self._report
            response.messages = recording.messages
        except InputError as error:
            response.message = str(error)
            self._fail(error)
        return response

    def _on_split(
        self, request: SplitRecording.Request, response: SplitRecording.Response
    ) -> SplitRecording.Response:
        if self._recording is None:
            response.message = "not recording"
            return response
        try:
            self._recording.writer.split()
            response.success, response.message = True, "goes on in a new file"
        except InputError as error:
            response.message = str(error)
            self._fail(error)
        return response


def main() -> int:
    """Run the node."""
    return run_node(RecorderNode)
