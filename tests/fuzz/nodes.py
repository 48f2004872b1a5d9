"""Messages on the wire: whatever bytes arrive, no node crashes, and voltages stay finite and within their limits.

The callbacks of plant, controller and conductor are called with the bytes as the middleware would; what recorder
and drag estimator do with them needs no node.
"""

from __future__ import annotations

import contextlib
import math
import os
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import rclpy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions

from gyrowheel_analysis.drag.stream import DragStream
from gyrowheel_analysis.model import Model
from gyrowheel_control.nodes.conductor import ConductorNode
from gyrowheel_control.nodes.controller import ControllerNode
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import BenchNode, prepare_environment
from gyrowheel_core.node.base import Fault
from gyrowheel_core.topics import Topic
from gyrowheel_recording.bags.live import LiveRecording
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.node import PlantNode

from ..domains import next_domain
from .harness import Case, WrongAnswer
from .recordings import PERIOD_NS, mutated_message, one_of_each


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Send what libraries write to standard error nowhere."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


class Listening:
    """Nodes in this process whose messages come from a test.

    Parameters
    ----------
    domain : int
        ROS domain, which nobody else uses.
    """

    def __init__(self, domain: int) -> None:
        prepare_environment()
        arguments = [
            "--ros-args",
            "-p",
            "wait_for_subscribers:=0",
            "-p",
            "autostart:=false",
            "--log-level",
            "fatal",
        ]
        rclpy.init(args=arguments, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self.hears: dict[str, list[tuple[BenchNode, Callable[[Any], None], bool, Topic]]] = {}
        self.sent: list[bytes] = []
        self.nodes: list[BenchNode] = []
        usual = BenchNode.subscription

        def subscription(
            node: BenchNode, topic: Topic, callback: Callable[[Any], None], *, raw: bool = False
        ) -> Any:
            self.hears.setdefault(topic.name, []).append((node, callback, raw, topic))
            return usual(node, topic, callback, raw=raw)

        BenchNode.subscription = subscription  # type: ignore[method-assign, assignment]
        try:
            for kind in (PlantNode, ControllerNode, ConductorNode):
                node = kind()
                node.start()
                self.nodes.append(node)
        finally:
            BenchNode.subscription = usual  # type: ignore[method-assign]

    def give(self, name: str, data: bytes) -> str:
        """Give a message to every node that hears its topic; return what became of it."""
        outcome = "nobody hears it"
        for node, callback, raw, topic in self.hears.get(name, ()):
            message: Any = data
            if not raw:
                try:
                    with _quiet():  # the middleware writes what it thinks of it
                        message = deserialize_message(data, topic.message_class)
                except Exception:  # it drops it
                    outcome = "no message"
                    continue
            callback(message)
            outcome = "taken"
            if node.failure is not None:
                if not isinstance(node.failure, Fault | InputError):
                    raise WrongAnswer(f"{node.NODE_NAME}: {node.failure!r}")
                outcome = f"fault {node.failure.name}" if isinstance(node.failure, Fault) else "refused"
                node.failure, node.stopping = None, False
        return outcome

    def close(self) -> None:
        """End the nodes."""
        for node in self.nodes:
            node.destroy_node()
        rclpy.try_shutdown()


def graph(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Give damaged messages of every topic to nodes that are at work."""
    listening = Listening(next_domain())
    plant = next(node for node in listening.nodes if isinstance(node, PlantNode))
    limits = Bench.load().values()
    highest = max(limits["coil_voltage_limit"], limits["supply_voltage"])
    with contextlib.ExitStack() as stack:
        stack.callback(listening.close)
        heard = sorted(listening.hears)
        while True:
            stamp = rng.choice((0, 10, 1000, 10**6)) * PERIOD_NS
            valid = {topic.name: data for topic, data in one_of_each(stamp).items()}
            valid[topics.CLOCK.name] = wire.CLOCK.pack(stamp)
            valid.setdefault(topics.DIAGNOSTICS.name, _diagnostics())
            valid[topics.JOINT_STATES.name] = _joints(stamp)
            name = rng.choice(heard)
            data = valid[name] if rng.random() < 0.1 else mutated_message(valid[name], rng)

            def use(data: bytes, name: str = name) -> str:
                outcome = listening.give(name, data)
                voltages = plant._guard.voltages
                if not all(math.isfinite(v) and abs(v) <= highest for v in voltages):
                    raise WrongAnswer(f"voltages {voltages} are applied")
                return outcome

            yield Case(name, data, use)


def _joints(stamp_ns: int) -> bytes:
    from rclpy.serialization import serialize_message
    from rclpy.time import Time
    from sensor_msgs.msg import JointState

    message = JointState(name=list(topics.JOINTS), position=[0.01, 0.0, 1.0], velocity=[0.0, 0.0, 300.0])
    message.header.stamp = Time(nanoseconds=stamp_ns).to_msg()
    return bytes(serialize_message(message))


def _diagnostics() -> bytes:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from rclpy.serialization import serialize_message

    status = DiagnosticStatus(name="plant", message="guard", level=DiagnosticStatus.WARN)
    status.values = [KeyValue(key="guard", value="normal")]
    return bytes(serialize_message(DiagnosticArray(status=[status])))


def heard(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Give damaged messages to what recorder and drag estimator do with them."""
    model = Model(Bench.load())
    while True:
        usual = _stream(rng.randrange(40, 200))
        mutants = []
        for _ in range(rng.choice((1, 2, 5))):
            at = rng.randrange(len(usual))
            topic = rng.choice(list(one_of_each()))
            mutants.append((at, topic, mutated_message(one_of_each(at * PERIOD_NS // 2)[topic], rng)))
        at, topic, data = mutants[0]
        others = mutants[1:]

        def use(
            data: bytes, usual: Any = usual, at: int = at, topic: Topic = topic, others: Any = others
        ) -> str:
            messages = list(usual)
            for place, other, content in [*others, (at, topic, data)]:
                messages.insert(place, (other, content))
            _record(messages, folder / "run")
            return _estimate(messages, model)

        yield Case(topic.name, data, use)


def _stream(count: int) -> list[tuple[Topic, bytes]]:
    found: list[tuple[Topic, bytes]] = []
    for k in range(count):
        stamp = k * PERIOD_NS
        if k % 10 == 0:
            found.append((topics.SETPOINT, wire.SETPOINT.pack(stamp, 0, 1, *([0.01] * 5), 0.0)))
        found.append((topics.MEASUREMENT, wire.MEASUREMENT.pack(stamp, k, *([1.0] * 11))))
    return found


def _record(messages: list[tuple[Topic, bytes]], folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    recording = LiveRecording(str(folder))
    try:
        for topic, data in messages:
            if not recording.take(topic, data):
                break
        recording.close()
    finally:
        recording.writer.abort()


def _estimate(messages: list[tuple[Topic, bytes]], model: Model) -> str:
    stream = DragStream(model)
    estimates = []
    for topic, data in messages:
        if topic is topics.MEASUREMENT:
            estimates += stream.take_measurement(data)
        elif topic is topics.SETPOINT:
            estimates += stream.take_setpoint(data)
        elif topic is topics.ENVIRONMENT:
            stream.take_environment(data)
        estimates += stream.estimates()
    malformed = stream.malformed
    estimates += stream.finish()
    for estimate in estimates:
        estimate.serialized()
    return "malformed counted" if malformed else "taken"
