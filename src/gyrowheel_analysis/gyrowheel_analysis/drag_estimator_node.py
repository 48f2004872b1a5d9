"""The node ``drag_estimator``: drag estimates hold by hold, while the test runs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from gyrowheel_msgs.msg import DragEstimate
from rclpy.subscription import Subscription
from rclpy.time import Time

from gyrowheel_analysis.drag_estimator import DragEstimator, Estimate
from gyrowheel_analysis.model import Model
from gyrowheel_sim import topics, wire
from gyrowheel_sim.node import BenchNode, Diagnosis, Param, run_node

#: Samples that are handed over together: estimates come seldom, and a block costs little more than a sample.
BLOCK = 100
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
    )

    def configure(self) -> None:
        """Read the model, create the topics."""
        file = self.parameter("model")
        self._model = Model.load(file) if file else Model.new(self.parameter("bench"))
        # Compiled code is loaded at its first call, which takes seconds: now rather than in the test.
        DragEstimator(self._model).add_block(
            np.zeros(1, np.int64), np.ones((1, len(wire.MEASUREMENT.fields)))
        )
        self._active = False
        self._estimates = 0
        self._begin()
        self._publisher = self.publisher(topics.DRAG_ESTIMATE)
        self._inputs: tuple[Subscription, ...] = ()

    def activate(self) -> None:
        """Take samples."""
        self._active = True
        if (
            not self._inputs
        ):  # only now: a plant that counts its subscribers must not begin before they are heard
            self._inputs = (
                self.subscription(topics.MEASUREMENT, self._on_measurement, raw=True),
                self.subscription(topics.SETPOINT, self._on_setpoint, raw=True),
            )

    def deactivate(self) -> None:
        """Publish the estimate of the hold under way, and take no more samples."""
        self._active = False
        self._end()
        self.deliver(self._publisher)

    def cleanup(self) -> None:
        """Give up the topics."""
        for subscription in self._inputs:
            self.destroy_subscription(subscription)
        self._inputs = ()
        self.destroy_publisher(self._publisher)

    def diagnose(self) -> Diagnosis:
        """Return counts."""
        values = {
            "samples": self._samples,
            "first_sample": self._first,
            "missing_samples": self._missing,
            "estimates": self._estimates,
            "malformed_messages": self._malformed,
        }
        if self._missing or self._malformed:
            return Diagnosis("running; samples are missing or malformed", values, DiagnosticStatus.WARN)
        if self._first > 0:
            return Diagnosis(f"running; joined late, at sample {self._first}", values)
        return Diagnosis("running" if self._samples else "waiting for samples", values)

    def _begin(self) -> None:
        """Begin with the first sample of a run."""
        self._estimator = DragEstimator(self._model)
        self._block: list[bytes] = []
        self._samples = self._missing = self._malformed = 0
        self._first = self._sequence = -1  # numbers of the first and the last sample
        self._sample_ns = self._setpoint_ns = -1  # stamps of the last ones

    def _end(self) -> None:
        """Publish what is left of a run, and be ready for the next one."""
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
        self._block.append(raw)
        if len(self._block) == BLOCK:
            self._hand_over()

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

    def _hand_over(self) -> None:
        """Give the samples of the block to the estimator."""
        if not self._block:
            return
        rows = np.frombuffer(b"".join(self._block), wire.MEASUREMENT.dtype)
        self._samples += len(rows)
        self._block = []
        first, last = int(rows["sequence"][0]), int(rows["sequence"][-1])
        if self._first < 0:
            self._first, self._sequence = first, first - 1
        # those that come later than their successors are rare, and were counted as missing
        self._missing += max(last - self._sequence - len(rows), 0)
        self._sequence = last
        values = np.stack([rows[name] for name in wire.MEASUREMENT.fields], axis=1)
        self._publish(self._estimator.add_block(wire.MEASUREMENT.stamps(rows), values))

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
