"""The node ``foxglove``: shows the topics of the running bench in the viewer Foxglove.

Messages are passed on as bytes, at the time of the bench. The server listens on this computer only.
Needs the package foxglove-sdk, which the extra ``foxglove`` installs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from gyrowheel_analysis.recording.definitions import definition
from gyrowheel_bringup.viewers import robot_description
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.node import BenchNode, Diagnosis, Param, run_node
from gyrowheel_core.topics import Topic

HOST: Final = "127.0.0.1"
PORT: Final = 8765
_DESCRIPTION: Final = Topic("/robot_description", "std_msgs/msg/String", 1, latched=True)
_BACKLOG: Final = 20_000  # messages kept for a slow viewer: a few seconds


class FoxgloveNode(BenchNode):
    """Shows the topics of the bench in the viewer Foxglove."""

    NODE_NAME = "foxglove"
    PARAMETERS = (
        Param(
            "port",
            PORT,
            "Port on this computer that Foxglove connects to; 0: any free one",
            low=0,
            high=65535,
        ),
    )

    def configure(self) -> None:
        """Open the server and its channels."""
        try:
            import foxglove
        except ImportError:
            raise InputError(
                "foxglove-sdk is not installed; it comes with: pip install 'gyrowheel-bringup[foxglove]'"
            ) from None
        self._sink = foxglove.Context()
        port = self.parameter("port")
        try:
            self._server = foxglove.start_server(
                name="gyrowheel", host=HOST, port=port, context=self._sink, message_backlog_size=_BACKLOG
            )
        except Exception as error:  # the library has no class for a port that is in use
            reason = one_line(error)
            raise InputError(f"parameter port: {port} cannot be opened on {HOST}: {reason}") from None
        self.address = f"ws://{HOST}:{self._server.port}"
        self._now = 0  # time of the bench [ns]
        self._passed = 0
        shown = [topic for topic in topics.TOPICS if topic not in (topics.TRUTH, topics.CLOCK)]
        self._channels = {topic: self._channel(foxglove, topic) for topic in (*shown, _DESCRIPTION)}
        self._inputs = [self.subscription(topic, self._passer(topic), raw=True) for topic in shown]
        self._urdf = wire.pack_text(robot_description())
        # repeated for viewers that connect later
        self._describing = self.wall_timer(2.0, self._describe)
        self.get_logger().info(f"open {self.address} in Foxglove")

    def cleanup(self) -> None:
        """Close the server and give up the topics."""
        self.destroy_timer(self._describing)
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._server.stop()
        self._channels = {}

    def diagnose(self) -> Diagnosis:
        """Return the address and counts."""
        values = {"address": self.address, "messages": self._passed}
        return Diagnosis("showing" if self._passed else "waiting for messages", values)

    def _channel(self, foxglove: Any, topic: Topic) -> Any:
        known = definition(topic.type_name)
        return foxglove.Channel(
            topic.name,
            schema=foxglove.Schema(name=topic.type_name, encoding="ros2msg", data=known.text.encode()),
            message_encoding="cdr",
            context=self._sink,
        )

    def _passer(self, topic: Topic) -> Callable[[bytes], None]:
        channel = self._channels[topic]
        timed = topic is topics.MEASUREMENT

        def take(data: bytes) -> None:
            if timed:
                try:
                    self._now = wire.stamp(data)
                except ValueError:  # from a node that is not of this bench
                    return
            self._passed += 1
            channel.log(data, log_time=self._now)

        return take

    def _describe(self) -> None:
        self._channels[_DESCRIPTION].log(self._urdf, log_time=self._now)


def main() -> int:
    """Run the node."""
    return run_node(FoxgloveNode)
