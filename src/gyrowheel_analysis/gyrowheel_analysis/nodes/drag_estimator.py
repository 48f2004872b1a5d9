"""The node ``drag_estimator``: publishes a drag estimate of each hold while the test runs."""

from __future__ import annotations

from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticStatus
from gyrowheel_msgs.msg import DragEstimate
from rclpy.time import Time
from threadpoolctl import threadpool_limits

from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_analysis.drag.stream import BLOCK, DragStream
from gyrowheel_analysis.model import Model
from gyrowheel_core import topics, wire
from gyrowheel_core.node import PRIORITY, BenchNode, Inbox, NodeStatus, Param, run_node

#: Period at which arrived messages are taken [s, wall-clock time].
TAKE_PERIOD = 0.02


class DragEstimatorNode(BenchNode):
    """Averages the actuation of each hold and compares it with the torques of a model."""

    NODE_NAME = "drag_estimator"
    PARAMETERS = (
        Param("bench", "gyrowheel", "Bench of a new model: shipped name, or path of a file"),
        Param("model", "", "File of the believed model; empty: the bench without effects"),
        Param("wait_for_subscribers", 0, "Subscribers needed to take the first sample", low=0, high=100),
        PRIORITY,
    )

    def configure(self) -> None:
        """Read the model, create the topics."""
        file = self.parameter("model")
        self._model = Model.load(file) if file else Model.new(self.parameter("bench"))
        # the last digit of a sum must not depend on the number of cores
        threadpool_limits(limits=1, user_api="blas")
        # now, not during the test
        DragStream.warm_up(self._model)
        self._active = False
        self._estimates = 0
        self._stream = DragStream(self._model)
        self._publisher = self.publisher(topics.DRAG_ESTIMATE)
        self._inputs: tuple[Inbox, Inbox, Inbox] | None = None

    def activate(self) -> None:
        """Take samples."""
        self.prioritise()
        self.drain()  # messages that arrived while the node was inactive are dropped
        self._active = True
        self._taking = self.wall_timer(TAKE_PERIOD, self._take)

    def deactivate(self) -> None:
        """Publish the estimate of the current hold, and take no more samples."""
        self.destroy_timer(self._taking)
        self.drain()
        self._active = False
        self._publish(self._stream.finish())
        self.deliver(self._publisher)

    def cleanup(self) -> None:
        """Destroy the topics."""
        for inbox in self._inputs or ():
            self.close_inbox(inbox)
        self._inputs = None
        self.destroy_publisher(self._publisher)

    def drain(self) -> None:
        """Process the messages that have arrived; an inactive node drops them."""
        if self._inputs is None:
            return
        environment, setpoints, samples = self._inputs
        full = True
        while full:
            # a plan's environment is delivered before its first setpoint: taken after it, it has certainly arrived
            arrived = list(setpoints.take())
            for raw in environment.take():
                if self._active:
                    self._stream.take_environment(raw)
            for raw in arrived:
                if self._active:
                    self._publish(self._stream.take_setpoint(raw))
            count = 0
            for raw in samples.take(BLOCK):
                if self._active:
                    self._publish(self._stream.take_measurement(raw))
                count += 1
            full = count == BLOCK
            self._publish(self._stream.estimates())

    def diagnose(self) -> NodeStatus:
        """Return counts."""
        values = {
            "samples": self._stream.samples,
            "first_sample": self._stream.first,
            "missing_samples": self._stream.missing,
            "estimates": self._estimates,
            "malformed_messages": self._stream.malformed,
        }
        if self._inputs is None:
            return NodeStatus(f"waiting for subscribers: {self._subscribers_missing()} missing", values)
        if self._stream.missing or self._stream.malformed:
            return NodeStatus("running; samples are missing or malformed", values, DiagnosticStatus.WARN)
        if self._stream.first > 0:
            return NodeStatus(f"running; joined late, at sample {self._stream.first}", values)
        return NodeStatus("running" if self._stream.samples else "waiting for samples", values)

    def _take(self) -> None:
        """Take the messages that have arrived, once there are enough subscribers."""
        if self._inputs is None and self._subscribers_missing() <= 0:
            # only now: a plant that counts its subscribers must not start before anyone receives the estimates
            self._inputs = (
                self.inbox(topics.ENVIRONMENT),
                self.inbox(topics.SETPOINT),
                self.inbox(topics.MEASUREMENT),
            )
        self.drain()

    def _subscribers_missing(self) -> int:
        needed: int = self.parameter("wait_for_subscribers")
        return needed - self._publisher.get_subscription_count()

    def _publish(self, estimates: Iterable[Estimate]) -> None:
        for estimate in estimates:
            message = DragEstimate(**{name: getattr(estimate, name) for name in wire.DRAG_ESTIMATE.names})
            message.header.stamp = Time(nanoseconds=estimate.stamp_ns).to_msg()
            message.header.frame_id = wire.FRAME_ID
            self._publisher.publish(message)
            self._estimates += 1


def main() -> int:
    """Run the node."""
    return run_node(DragEstimatorNode)
