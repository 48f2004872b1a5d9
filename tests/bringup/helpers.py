"""What the tests with real nodes share."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import time
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyrowheel_bringup.graph import EXECUTABLES, find_executable
from gyrowheel_core import topics
from gyrowheel_core.node import PARENT_VARIABLE, RepeatedRequest, make_executor, prepare_environment

#: A plan of about 3 s with ramps, holds and a cone, in environments that are not the ambient one.
SHORT_PLAN = """\
schema: 1
name: short
hold_s: 0.4
segments:
  - {label: level, spin_rpm: 2000, tilt_deg: [0, 0], rig: inverted, air_density_ratio: 0.7, preheat_k: 5}
  - {label: tilted, tilt_deg: [1.0, 0.5], hold_s: 0.8}
  - {label: faster, spin_rpm: 2100, tilt_deg: [1.0, -0.5], rig: upright, yaw_deg: 90, preheat_k: 20}
  - {label: cone, cone_radius_deg: 1.0, cone_period_s: 0.6}
"""
#: A plan that outlasts every test.
LONG_PLAN = """\
schema: 1
name: long
segments:
  - {label: level, spin_rpm: 2000, tilt_deg: [0, 0], hold_s: 2000}
"""


def odd_bench(folder: Path) -> Path:
    """Write the file of a bench that is sampled every 0.3 ms, of which 10 ms of the clock are no multiple."""
    text = resources.files("gyrowheel_sim").joinpath("config/bench.yaml").read_text(encoding="utf-8")
    usual, file = "sample_period: {value: 5.0e-4", folder / "odd.yaml"
    assert text.count(usual) == 1
    file.write_text(text.replace(usual, usual.replace("5.0", "3.0")), encoding="utf-8")
    return file


def alive(pid: int) -> bool:
    """Return whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


#: How long something may take that happens at once on an idle machine [s].
PATIENCE = 240.0


def wait_for(condition: Callable[[], Any]) -> Any:
    """Return the first true value of `condition`; fail after `PATIENCE`."""
    end = time.monotonic() + PATIENCE
    while not (value := condition()):
        assert time.monotonic() < end, "timed out"
        time.sleep(0.02)
    return value


def end_process(process: subprocess.Popen[Any]) -> None:
    """End a node's process if it still runs, in the usual way.

    One that is killed may hold a lock on shared memory, and Fast DDS crashes whoever closes a node while it replaces
    that memory, a second later.
    """
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
    try:
        process.wait(20.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        time.sleep(2.0)


class Bystander:
    """A node in the test's own process that talks to the node under test."""

    def __init__(self, domain: int) -> None:
        prepare_environment()
        self.context = Context()
        options = SignalHandlerOptions.NO
        rclpy.init(args=[], context=self.context, domain_id=domain, signal_handler_options=options)
        self.node = Node("bystander", context=self.context, use_global_arguments=False)
        self.executor = make_executor(self.context)
        self.executor.add_node(self.node)
        self.diagnoses: dict[str, Any] = {}
        self.listen(topics.DIAGNOSTICS, self._on_diagnostics)

    def listen(self, topic: topics.Topic, callback: Callable[[Any], None], *, raw: bool = False) -> None:
        self.node.create_subscription(topic.message_class, topic.name, callback, topic.qos, raw=raw)

    def publisher(self, topic: topics.Topic) -> Any:
        return self.node.create_publisher(topic.message_class, topic.name, topic.qos)

    def spin_until(self, condition: Callable[[], Any], *, publish: Callable[[], None] | None = None) -> Any:
        """Return the first true value of `condition`; fail after `PATIENCE`.

        Meanwhile call `publish` every 5 ms or later: who publishes faster than it takes drowns in what comes back.
        """
        due, end = 0.0, time.monotonic() + PATIENCE
        while not (value := condition()):
            now = time.monotonic()
            assert now < end, f"timed out; last diagnoses: {self.diagnoses}"
            if publish is not None and now >= due:
                due = now + 0.005
                publish()
            self.executor.spin_once(timeout_sec=0.02)
        return value

    def call(self, client: Any, request: Any) -> Any:
        """Return the answer of a service, which is asked again: a node does not answer whom it does not know yet."""
        self.spin_until(client.service_is_ready)
        return self.spin_until(RepeatedRequest(lambda: client.call_async(request)).answer)

    def said(self, name: str) -> str:
        """Return the message of the last diagnosis of a node; empty if there was none."""
        status = self.diagnoses.get(name)
        return "" if status is None else str(status.message)

    def values(self, name: str) -> dict[str, str]:
        """Return the values of the last diagnosis of a node; empty if there was none."""
        status = self.diagnoses.get(name)
        return {} if status is None else {pair.key: pair.value for pair in status.values}

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self.diagnoses[status.name] = status


class NodeProcess:
    """One node in a process of its own."""

    def __init__(self, name: str, domain: int, log: Path, *, renamed: str = "", **parameters: object) -> None:
        arguments = [f"{key}:={value}" for key, value in parameters.items()]
        rules = ["-r", f"__node:={renamed}"] if renamed else []
        self._log = log
        with log.open("wb") as output:
            self.process = subprocess.Popen(
                [
                    str(find_executable(*EXECUTABLES[name])),
                    "--ros-args",
                    *rules,
                    *itertools.chain.from_iterable(("-p", text) for text in arguments),
                ],
                stdout=output,
                stderr=output,
                env=os.environ | {"ROS_DOMAIN_ID": str(domain), PARENT_VARIABLE: str(os.getpid())},
                start_new_session=True,
            )

    @property
    def output(self) -> str:
        return self._log.read_text()

    def ended(self) -> bool:
        return self.process.poll() is not None

    def end(self) -> None:
        """End the process if it still runs."""
        end_process(self.process)

    def interrupt(self) -> int:
        """Send Ctrl-C, which may well come twice; return the exit code."""
        self.process.send_signal(signal.SIGINT)
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE)
