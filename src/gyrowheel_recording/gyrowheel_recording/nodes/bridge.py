"""The node ``bridge``: publishes the samples of a bench whose own topics have other types.

It takes the map with which a bag of these topics is imported. So a bench that publishes ``sensor_msgs/JointState`` or
types of its own is recorded, watched and diagnosed like the simulated one.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PRIORITY, BenchNode, NodeStatus, Param, run_node
from gyrowheel_recording.derived import described
from gyrowheel_recording.mapping.exchange import assumed
from gyrowheel_recording.mapping.live import LiveReadings
from gyrowheel_recording.mapping.map_file import ColumnMap
from gyrowheel_sim.environment import to_json

_LOOK = 0.2  # period of looking for topics [s]
_DEPTH = 5_000  # messages that wait while the node is busy


class BridgeNode(BenchNode):
    """Publishes the samples of a bench from topics of other types, by a column map."""

    NODE_NAME = "bridge"
    PARAMETERS = (
        Param("map", "", "Map file with which a bag of the topics is imported"),
        Param(
            "patience",
            0.5,
            "How long a sample waits for the readings of other topics [s]",
            low=0.001,
            high=60.0,
        ),
        PRIORITY,
    )
    #: Messages in transit still arrive.
    LINGER = 0.2

    def configure(self) -> None:
        """Read the map."""
        if not self.parameter("map"):
            raise InputError(
                "parameter map: missing; give the map file with which a bag of the topics is imported"
            )
        self._map = ColumnMap.load(self.parameter("map"))
        self._readings = LiveReadings(self._map, patience=self.parameter("patience"))
        self._inputs: dict[str, Subscription] = {}
        self._measurements = self.publisher(topics.MEASUREMENT)
        self._bench = self.publisher(topics.BENCH)
        self._environment = self.publisher(topics.ENVIRONMENT) if self._map.environment else None

    def activate(self) -> None:
        """Publish the bench, and look for the topics."""
        self.prioritise()
        text = described(self._map.bench.describe(), assumed(self._map))
        self._bench.publish(wire.pack_text(text))
        if self._environment is not None:
            self._environment.publish(wire.pack_text(to_json(self._map.environment)))
        self._looking = self.wall_timer(_LOOK, self._look)

    def deactivate(self) -> None:
        """Take no more messages; every sample published reaches its subscribers."""
        self.destroy_timer(self._looking)
        for subscription in self._inputs.values():
            self.destroy_subscription(subscription)
        self._inputs.clear()
        self.deliver(self._measurements)

    def cleanup(self) -> None:
        """Destroy the topics."""
        for publisher in (self._measurements, self._bench, self._environment):
            if publisher is not None:
                self.destroy_publisher(publisher)

    def diagnose(self) -> NodeStatus:
        """Return counts, and the topics that are missing."""
        found = self._readings
        values = {
            "samples": found.samples,
            "missing_samples": found.lost,
            "missing_readings": found.missing_readings,
            "out_of_range": found.out_of_range,
            "not_ascending": found.not_ascending,
        }
        if missing := [name for name in found.feeds if name not in self._inputs]:
            return NodeStatus(f"waiting for {', '.join(missing)}", values, DiagnosticStatus.WARN)
        if found.why:
            return NodeStatus(f"out_of_range: {found.why}", values, DiagnosticStatus.WARN)
        return NodeStatus("running" if found.samples else f"waiting for messages of {found.base}", values)

    def _look(self) -> None:
        """Subscribe to topics of the map that have publishers by now."""
        for name in self._readings.feeds:
            if name in self._inputs:
                continue
            offers = self.get_publishers_info_by_topic(name)
            kinds = sorted({offer.topic_type for offer in offers})
            if len(kinds) > 1:
                self.fault("type_conflict", f"{name}: publishers of {', '.join(kinds)}; allowed: of one type")
                return
            if not kinds:
                continue
            # a reader that asks for more than one of the publishers offers does not get its messages
            reliable = all(own.qos_profile.reliability == ReliabilityPolicy.RELIABLE for own in offers)
            qos = QoSProfile(
                depth=_DEPTH,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            )
            package, _, rest = kinds[0].partition("/")
            try:
                kind = getattr(import_module(f"{package}.msg"), rest.rpartition("/")[2])
                self._inputs[name] = self.create_subscription(kind, name, partial(self._take, name), qos)
            except (ImportError, AttributeError):
                self.fault("type_unknown", f"{name}: {kinds[0]} is not installed in the Python of this node")
                return
        if len(self._inputs) == len(self._readings.feeds):
            self._looking.cancel()

    def _take(self, topic: str, message: Any) -> None:
        try:
            self._readings.take(topic, message, self.get_clock().now().nanoseconds)
        except InputError as error:
            self.fault("field_unknown", str(error))
            return
        for sample in self._readings.take_samples():
            self._measurements.publish(wire.MEASUREMENT.pack(sample.stamp, sample.number, *sample.readings))


def main() -> int:
    """Run the node."""
    return run_node(BridgeNode)
