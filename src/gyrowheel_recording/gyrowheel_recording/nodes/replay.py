"""The node ``replay``: publishes a recording, at any pace, with ``/clock``.

Messages are published as the bytes that were recorded, ordered by time. No message is lost at any pace: before a
topic has more messages in transit than its subscribers keep, the node waits until they have taken them all. The
middleware acknowledges what it has delivered, and a node of the bench that answers a service has taken everything
that came before. So a slow subscriber slows the replay down. Nobody is waited for on ``/clock`` and on topics that
keep only a few messages, such as ``/joint_states``: there only the newest message counts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.srv import GetState
from rclpy.client import Client
from rclpy.publisher import Publisher
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import BenchNode, NodeStatus, Param, run_node
from gyrowheel_core.topics import Topic
from gyrowheel_recording.bags.playback import Message, Pace, Tape, parse_names
from gyrowheel_recording.bags.reader import PAUSE

SERVICES: Final = "gyrowheel/replay"
#: Messages of a topic after which the node waits for the subscribers: a tenth of the depth of the high-rate topics.
#: On other topics it is half of the depth; where the depth is below `_KEPT`, the node does not wait.
WINDOW: Final = 5_000
_KEPT: Final = 50
_PATIENCE: Final = 10.0  # with a subscriber that does not answer [s]
_TICK: Final = 0.001  # [s]
_TURN: Final = 0.005  # of publishing before other callbacks have their turn [s]
_CLOCK_PERIOD_NS: Final = 10_000_000
_JOINT_STATE_PERIOD_NS: Final = wire.SECOND // 60
#: If one of these has another publisher, a bench is running, and recorded messages would mix with its own.
_OF_A_BENCH: Final = (topics.MEASUREMENT, topics.COMMAND, topics.SETPOINT)


class ReplayNode(BenchNode):
    """Publishes a recording."""

    NODE_NAME = "replay"
    PARAMETERS = (
        Param("directory", "", "Recording: a rosbag2 directory or one of its files"),
        Param(
            "rate",
            1.0,
            "Recorded seconds per second; 0: as fast as the subscribers take",
            low=0.0,
            high=1e6,
            live=True,
        ),
        Param("start", 0.0, "Start [s from the first sample]", low=0.0, high=1e9),
        Param("end", 0.0, "End [s from the first sample]; 0: that of the recording", low=0.0, high=1e9),
        Param("loop", False, "Start again at the end", live=True),
        Param("paused", False, "Start paused; the services step and pause continue"),
        Param("step", 0.0, "Length of one step [s]; 0: to the next sample", low=0.0, high=3600.0, live=True),
        Param("topics", "", "Topics to publish, separated by commas; empty: all"),
        Param("without", "", "Topics to leave out, separated by commas"),
        Param("clock", True, "Publish /clock, every 10 ms of the recording"),
        Param("joint_states", True, "Publish /joint_states from the samples where the recording has none"),
        Param("setpoint_lead", 0.5, "Time by which setpoints precede their samples [s]", low=0.0, high=10.0),
        Param(
            "wait", 3.5, "How long to look for other nodes before the first message [s]", low=0.0, high=60.0
        ),
        Param("wait_for_subscribers", 0, "Subscribers of the samples to wait for", low=0, high=100),
        Param("stay", False, "Stay when the end is reached, instead of ending the process"),
    )

    def configure(self) -> None:
        """Check the recording and create its topics."""
        if not self.parameter("directory"):
            raise InputError("parameter directory: missing; give the recording to replay")
        self._tape = self.open_tape()
        self._outlets: dict[Topic, Publisher] = {}
        self.left_out: dict[Topic, str] = {}  # with the reason
        for topic in self._tape.topics:
            if topic == topics.CLOCK and self.parameter("clock"):
                self.left_out[topic] = "made again"
                continue
            try:
                _ = topic.message_class
            except (ImportError, AttributeError):
                self.left_out[topic] = f"{topic.type_name} is not installed"
                self.get_logger().warning(f"{topic.name} is left out: {topic.type_name} is not installed")
                continue
            self._outlets[topic] = self.publisher(topic)
        if not self._outlets:
            raise InputError(f"{self._tape.path}: no topic is left to replay")
        self._clock_outlet = self.publisher(topics.CLOCK) if self.parameter("clock") else None
        missing = topics.MEASUREMENT in self._outlets and topics.JOINT_STATES not in self._tape.topics
        self._joint_outlet = (
            self.publisher(topics.JOINT_STATES) if missing and self.parameter("joint_states") else None
        )
        self._offers = (
            self.create_service(SetBool, f"{SERVICES}/pause", self._on_pause),
            self.create_service(Trigger, f"{SERVICES}/step", self._on_step),
        )
        self._state_clients: dict[str, Client] = {}  # by the node's full name
        self._pace = Pace(self.parameter("rate"), self._tape.start_ns, paused=self.parameter("paused"))
        self._steps = 0  # requested and not yet made
        self.rounds = 0
        self.started = False
        self.counts = {topic.name: 0 for topic in self._outlets}
        self.finished = False
        self._rewind()

    def activate(self) -> None:
        """Start once the subscribers are found, or continue where the node was deactivated."""
        self._since = time.monotonic()
        if not self._pace.paused:
            self._pace.go(self._position)
        self._pump_timer = self.wall_timer(_TICK, self._pump)

    def deactivate(self) -> None:
        """Pause; everything published reaches its subscribers."""
        self.destroy_timer(self._pump_timer)
        self.deliver(*self._outlets.values())

    def cleanup(self) -> None:
        """Close the recording and give up the topics."""
        self._tape.close()
        for publisher in (*self._outlets.values(), self._clock_outlet, self._joint_outlet):
            if publisher is not None:
                self.destroy_publisher(publisher)
        for service in self._offers:
            self.destroy_service(service)
        for client in self._state_clients.values():
            self.destroy_client(client)

    def diagnose(self) -> NodeStatus:
        """Return where the replay is."""
        values: dict[str, object] = {
            "recording": self._tape.path,
            "position": f"{self.position:.4f}",
            "end": f"{self._tape.seconds(self._tape.end_ns):.4f}",
            "rounds": self.rounds,
            "messages": sum(self.counts.values()),
            "left_out": ", ".join(f"{topic.name}: {why}" for topic, why in self.left_out.items()),
        }
        if not self.started:
            return NodeStatus("waiting for readers", values)
        if self.finished:
            return NodeStatus("at the end", values)
        if self._slow:
            return NodeStatus("waiting for a slow reader", values, DiagnosticStatus.WARN)
        return NodeStatus("paused" if self._pace.paused else "running", values)

    def tune(self) -> None:
        """Continue at another rate."""
        self._pace.rate = self.parameter("rate")
        if not self._pace.paused:
            self._pace.go(self._position)

    # ---- for a program that shows the replay

    def open_tape(self) -> Tape:
        """Open the recording that the parameters name."""
        end = self.parameter("end")
        return Tape(
            self.parameter("directory"),
            only=parse_names(self.parameter("topics")),
            without=parse_names(self.parameter("without")),
            start=self.parameter("start"),
            end=end if end > 0.0 else math.inf,
            setpoint_lead=self.parameter("setpoint_lead"),
        )

    def on_finished(self) -> None:
        """React to the end: everything was published and taken."""
        if not self.parameter("stay"):
            self.stop()

    @property
    def position(self) -> float:
        """Current time of the recording [s from the first sample]."""
        return self._tape.seconds(self._position)

    @property
    def paused(self) -> bool:
        """Whether the replay is paused."""
        return self._pace.paused

    def pause(self, still: bool) -> None:
        """Pause, or continue."""
        if still:
            self._pace.hold(self._position)
        else:
            self._steps = 0
            self._pace.go(self._position)

    def step(self) -> None:
        """Pause, and go one step further."""
        self._pace.hold(self._position)
        self._steps += 1

    # ---- publishing

    def _rewind(self) -> None:
        """Go to the start of the range."""
        self._messages: Iterator[Message] = self._tape.messages(without=self.left_out)
        self._next = next(self._messages, None)
        self._position = self._clock_due = self._joints_due = self._tape.start_ns
        self._pace.move(self._position)
        self._room = self._room_of_readers()
        self._awaited: list[tuple[str, Any]] | None = None  # answers of readers
        self._asked = math.inf  # when they were asked
        self._slow = False

    def _pump(self) -> None:
        """Publish what is due."""
        if self.finished or not (self.started or self._may_start()):
            return
        if self._asked < math.inf and not self._readers_have_all():
            return
        if self._next is None:
            self._pass_end()
            return
        if self._steps:
            self._make_step()
            return
        if self._pace.paused:
            return
        now = time.monotonic()
        limit, turn = self._pace.limit(now), now + _TURN
        count = 0
        while self._next is not None and self._next[0] <= limit:
            if not self._room[self._give_next()]:
                self._ask_readers()
                return
            count += 1
            if count % 64 == 0 and time.monotonic() > turn:
                return
        if self._next is None:
            self._tick_to(self._tape.end_ns)
            self._ask_readers()
        else:
            self._tick_to(min(limit, self._next[0]))

    def _give_next(self) -> Topic:
        assert self._next is not None
        due, topic, data = self._next
        self._tick_to(due)
        self._outlets[topic].publish(data)
        self.counts[topic.name] += 1
        self._room[topic] -= 1
        if self._joint_outlet is not None and topic == topics.MEASUREMENT and due >= self._joints_due:
            self._joints_due = max(self._joints_due + _JOINT_STATE_PERIOD_NS, due - _JOINT_STATE_PERIOD_NS)
            self._publish_joints(self._joint_outlet, data)
        self._next = next(self._messages, None)
        return topic

    def _tick_to(self, now_ns: float) -> None:
        """Advance to a time of the recording; /clock is published before the messages of the same time.

        Where that is a pause ahead, as fast as readers can take it, /clock goes on behind the pause.
        """
        if now_ns - self._clock_due > PAUSE * wire.SECOND:
            self._clock_due += int(now_ns - self._clock_due) // _CLOCK_PERIOD_NS * _CLOCK_PERIOD_NS
        while self._clock_outlet is not None and self._clock_due <= now_ns:
            self._clock_outlet.publish(wire.CLOCK.pack(self._clock_due))
            self._clock_due += _CLOCK_PERIOD_NS
        self._position = max(self._position, int(now_ns))

    @staticmethod
    def _publish_joints(publisher: Publisher, data: bytes) -> None:
        try:
            stamp, _, *values = wire.MEASUREMENT.unpack(data)
        except ValueError:  # of another frame: published, but not parsed
            return
        message = JointState(name=topics.JOINTS, position=values[:3])
        message.header.stamp = Time(nanoseconds=stamp).to_msg()
        publisher.publish(message)

    def _make_step(self) -> None:
        self._steps -= 1
        length = round(self.parameter("step") * wire.SECOND)
        to = self._position + length
        if not length:
            wanted = topics.MEASUREMENT if topics.MEASUREMENT in self._outlets else None
            while self._next is not None and self._give_next() != wanted and wanted is not None:
                pass
            to = self._position
        while self._next is not None and self._next[0] <= to:
            self._give_next()
        end = self._next is None
        self._tick_to(self._tape.end_ns if end else to)
        if self._clock_outlet is not None:  # the current time, between two ticks
            self._clock_outlet.publish(wire.CLOCK.pack(self._position))
        self._pace.hold(self._position)
        if end or min(self._room.values()) <= 0:
            self._ask_readers()

    def _pass_end(self) -> None:
        """Start again, or finish."""
        self.rounds += 1
        if self.parameter("loop"):
            self._rewind()
            return
        self.finished = True
        self.on_finished()

    # ---- subscribers

    def _may_start(self) -> bool:
        """Return whether the subscribers are there; drop topics that others publish."""
        need = self.parameter("wait_for_subscribers")
        if time.monotonic() - self._since < self.parameter("wait"):
            return False
        measurements = self._outlets.get(topics.MEASUREMENT)
        if measurements is not None and measurements.get_subscription_count() < need:
            return False
        if not self._readers_are_active():
            return False
        taken = {topic: self._others(topic) for topic in (*self._outlets, *_OF_A_BENCH)}
        taken.pop(topics.DIAGNOSTICS, None)
        for topic, names in taken.items():
            if not names:
                continue
            if topic in _OF_A_BENCH:
                self.fault(
                    "bench_is_running",
                    f"{topic.within(self.namespace)} is published by {', '.join(names)}: end that bench, or use "
                    "another ROS domain or namespace",
                )
                return False
            self.left_out[topic] = f"published by {', '.join(names)}"
            self.get_logger().info(f"{topic.name} is left out: {self.left_out[topic]}")
            self.destroy_publisher(self._outlets.pop(topic))
            del self.counts[topic.name]
        self.started = True
        self._rewind()
        return True

    def _readers_are_active(self) -> bool:
        """Return whether the subscribing nodes of the bench are active, or the time to wait for them is over."""
        if time.monotonic() - self._since > self.parameter("wait") + _PATIENCE:
            return True
        if self._awaited is not None:
            if not all(answer.done() for _, answer in self._awaited):
                return False
            labels = [answer.result().current_state.label for _, answer in self._awaited]
            self._awaited = None
            if all(label == "active" for label in labels):
                return True
        self._awaited = self._states_asked()
        return False

    def _others(self, topic: Topic) -> list[str]:
        """Return the other nodes that publish a topic."""
        found = self.get_publishers_info_by_topic(topic.relative)
        return sorted({name for info in found if (name := _full_name(info)) != _own_name(self)})

    def _ask_readers(self) -> None:
        self._asked = time.monotonic()
        self._awaited = None

    def _readers_have_all(self) -> bool:
        """Return whether everything published was taken, or the time to wait for it is over."""
        late = time.monotonic() - self._asked > _PATIENCE
        if self._awaited is None:
            if not self.deliver(*self._outlets.values(), timeout=0.0) and not late:
                return False
            self._awaited = self._states_asked()
        waiting = [name for name, answer in self._awaited if not answer.done()]
        if waiting and not late:
            self._slow = time.monotonic() - self._asked > 1.0
            return False
        if late:
            what = f"{', '.join(waiting)} does not answer" if waiting else "a reader does not acknowledge"
            self.get_logger().warning(f"{what}: the replay goes on, messages may be lost")
        for name, answer in self._awaited:
            if not answer.done():
                self._state_clients[name].remove_pending_request(answer)
        if self._slow and not self._pace.paused:  # the time of the wait is not made up
            self._pace.go(self._position)
        self._asked, self._awaited, self._slow = math.inf, None, False
        self._room = self._room_of_readers()
        return True

    def _room_of_readers(self) -> dict[Topic, int]:
        """Return how many messages of each topic may be published before the node waits for subscribers."""
        return {
            topic: min(topic.depth // 2, WINDOW)
            if topic.depth >= _KEPT and outlet.get_subscription_count()
            else WINDOW
            for topic, outlet in self._outlets.items()
        }

    def _states_asked(self) -> list[tuple[str, Any]]:
        """Ask the lifecycle nodes that subscribe for their states; return each with its coming answer."""
        names = {
            _full_name(info)
            for topic in self._outlets
            for info in self.get_subscriptions_info_by_topic(topic.relative)
        }
        for name in names - self._state_clients.keys() - {_own_name(self)}:
            self._state_clients[name] = self.create_client(GetState, f"{name}/get_state")
        clients = {name: self._state_clients[name] for name in sorted(names & self._state_clients.keys())}
        ready = {name: client for name, client in clients.items() if client.service_is_ready()}
        return [(name, client.call_async(GetState.Request())) for name, client in ready.items()]

    # ---- services

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.pause(bool(request.data))
        response.success = True
        response.message = f"{'paused' if request.data else 'going on'} at {self.position:.4f} s"
        return response

    def _on_step(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self.state != "active" or self.finished:
            response.message = "at the end" if self.finished else "not active"
            return response
        self.step()
        response.success, response.message = True, f"from {self.position:.4f} s"
        return response


def _full_name(info: Any) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def _own_name(node: BenchNode) -> str:
    return str(node.get_fully_qualified_name())


def main() -> int:
    """Run the node."""
    return run_node(ReplayNode)
