"""The node ``drag_estimator``: drag estimates hold by hold, while the test runs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from gyrowheel_msgs.msg import DragEstimate
from rclpy.time import Time

from gyrowheel_analysis.drag import DragEstimator, Estimate
from gyrowheel_analysis.model import Model
from gyrowheel_core import topics, wire
from gyrowheel_core.node import BenchNode, Diagnosis, Inbox, Param, run_node
from gyrowheel_core.readings import READINGS, Readings

#: Samples that are handed over together: estimates come seldom, and a block costs little more than a sample.
BLOCK = 100
#: Samples that wait at most for the setpoint that comes after them: where there are that many, none is coming.
PATIENCE = 2000
#: Time between two instants at which what has come is taken [s, wall clock].
TAKE_PERIOD = 0.02
_ARRAYS = (
    "dc_voltage",
    "dc_voltage_std",
    "voltage_increment",
    "measured_torque",
    "measured_torque_std",
    "simulated_torque",
    "residual",
)


class DragEstimatorNode(BenchNode):
    """Averages the actuation of each hold and compares it with the torques of a model."""

    NODE_NAME = "drag_estimator"
    PARAMETERS = (
        Param("bench", "gyrowheel", "Bench of a new model: shipped name, or path of a file"),
        Param("model", "", "Model file; empty: a new model of the bench, without effects"),
        Param("wait_for_subscribers", 0, "Subscribers needed to take the first sample", low=0, high=100),
    )

    def configure(self) -> None:
        """Read the model, create the topics."""
        file = self.parameter("model")
        self._model = Model.load(file) if file else Model.new(self.parameter("bench"))
        # Compiled code is loaded at its first call, which takes seconds: now rather than in the test.
        DragEstimator(self._model).add_block(np.zeros(1, np.int64), Readings(np.ones((1, len(READINGS)))))
        self._active = False
        self._estimates = 0
        self._begin()
        self._publisher = self.publisher(topics.DRAG_ESTIMATE)
        self._inputs: tuple[Inbox, Inbox] | None = None

    def activate(self) -> None:
        """Take samples."""
        self.drain()  # what came while the node was inactive is left out
        self._active = True
        self._taking = self.wall_timer(TAKE_PERIOD, self._take)

    def deactivate(self) -> None:
        """Publish the estimate of the hold under way, and take no more samples."""
        self.destroy_timer(self._taking)
        self.drain()
        self._active = False
        self._end()
        self.deliver(self._publisher)

    def cleanup(self) -> None:
        """Give up the topics."""
        for inbox in self._inputs or ():
            self.close_inbox(inbox)
        self._inputs = None
        self.destroy_publisher(self._publisher)

    def drain(self) -> None:
        """Work on what has come; an inactive node leaves it out."""
        if self._inputs is None:
            return
        setpoints, samples = self._inputs
        full = True
        while full:
            for raw in setpoints.take():
                self._on_setpoint(raw)
            count = 0
            for raw in samples.take(BLOCK):
                self._on_measurement(raw)
                count += 1
            full = count == BLOCK
            self._hand_over_known()

    def diagnose(self) -> Diagnosis:
        """Return counts."""
        values = {
            "samples": self._samples,
            "first_sample": self._first,
            "missing_samples": self._missing,
            "estimates": self._estimates,
            "malformed_messages": self._malformed,
        }
        if self._inputs is None:
            return Diagnosis(f"waiting for subscribers: {self._subscribers_missing()} missing", values)
        if self._missing or self._malformed:
            return Diagnosis("running; samples are missing or malformed", values, DiagnosticStatus.WARN)
        if self._first > 0:
            return Diagnosis(f"running; joined late, at sample {self._first}", values)
        return Diagnosis("running" if self._samples else "waiting for samples", values)

    def _take(self) -> None:
        """Take what has come, as soon as enough subscribers listen."""
        if self._inputs is None and self._subscribers_missing() <= 0:
            # only now: a plant that counts its subscribers must not begin before somebody hears the estimates
            self._inputs = (self.inbox(topics.SETPOINT), self.inbox(topics.MEASUREMENT))
        self.drain()

    def _subscribers_missing(self) -> int:
        needed: int = self.parameter("wait_for_subscribers")
        return needed - self._publisher.get_subscription_count()

    def _begin(self) -> None:
        """Begin with the first sample of a run."""
        self._estimator = DragEstimator(self._model)
        self._waiting: list[bytes] = []  # samples that were not handed over
        self._samples = self._missing = self._malformed = 0
        self._first = self._sequence = -1  # numbers of the first and the last sample
        self._sample_ns = self._setpoint_ns = -1  # stamps of the last ones

    def _end(self) -> None:
        """Publish what is left of a run, and be ready for the next one."""
        while self._waiting:
            self._hand_over()
        self._publish(self._estimator.finish())
        self._begin()

    def _on_measurement(self, raw: bytes) -> None:
        if not self._active:
            return
        try:
            stamp = wire.stamp(raw)
        except ValueError:
            stamp = -1
        if stamp < 0 or len(raw) != wire.MEASUREMENT.size:
            self._malformed += 1
            return
        if stamp <= self._sample_ns:  # the plant was started again
            self._end()
        self._sample_ns = stamp
        self._waiting.append(raw)

    def _on_setpoint(self, raw: bytes) -> None:
        if not self._active:
            return
        try:
            stamp, segment, phase, *values = wire.SETPOINT.unpack(raw)
        except ValueError:
            self._malformed += 1
            return
        if stamp <= self._setpoint_ns:
            self._end()
        self._setpoint_ns = stamp
        self._estimator.setpoint(stamp, segment, phase, values)

    def _hand_over_known(self) -> None:
        """Give full blocks to the estimator, once all their setpoints are known.

        So it says the same however the messages of the two topics come between each other.
        """
        while len(self._waiting) >= BLOCK and (
            len(self._waiting) >= PATIENCE or wire.stamp(self._waiting[BLOCK - 1]) < self._setpoint_ns
        ):
            self._hand_over()

    def _hand_over(self) -> None:
        """Give a block of samples, or all there are if they are fewer, to the estimator."""
        block, self._waiting = self._waiting[:BLOCK], self._waiting[BLOCK:]
        rows = np.frombuffer(b"".join(block), wire.MEASUREMENT.dtype)
        self._samples += len(rows)
        first, last = int(rows["sequence"][0]), int(rows["sequence"][-1])
        if self._first < 0:
            self._first, self._sequence = first, first - 1
        # those that come later than their successors are rare, and were counted as missing
        self._missing += max(last - self._sequence - len(rows), 0)
        self._sequence = last
        readings = Readings(np.stack([rows[name] for name in READINGS], axis=1))
        self._publish(self._estimator.add_block(wire.MEASUREMENT.stamps(rows), readings))

    def _publish(self, estimates: Iterable[Estimate]) -> None:
        for estimate in estimates:
            message = DragEstimate(
                segment=estimate.segment,
                settled=estimate.settled,
                duration=estimate.duration,
                tilt_x=estimate.tilt_x,
                tilt_y=estimate.tilt_y,
                spin_rate=estimate.spin_rate,
                **{name: getattr(estimate, name) for name in _ARRAYS},
            )
            message.header.stamp = Time(nanoseconds=estimate.stamp_ns).to_msg()
            message.header.frame_id = wire.FRAME_ID
            self._publisher.publish(message)
            self._estimates += 1


def main() -> int:
    """Run the node."""
    return run_node(DragEstimatorNode)
