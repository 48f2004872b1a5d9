"""Efforts and states of the joints as standard messages: what ros2_control needs of the bench."""

from __future__ import annotations

import math
import os
import subprocess
import threading
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState

from gyrowheel_bringup.graph import Graph, Progress, find_executable
from gyrowheel_bringup.viewers import robot_description
from gyrowheel_control.loops.controller import Controller
from gyrowheel_control.nodes.joint_commands import Efforts, efforts_of
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording, info
from gyrowheel_sim.bench import Bench

from .helpers import SHORT_PLAN, Bystander, NodeProcess, wait_for
from .test_exchange import Lifecycles

BENCH = Bench.load()
#: Every sample goes through a controller in Python.
BRIEF = """\
schema: 1
name: brief
hold_s: 0.3
segments:
  - {label: level, spin_rpm: 2000, tilt_deg: [0, 0]}
  - {label: tilted, tilt_deg: [0.5, 0.2], hold_s: 0.5}
"""


def test_efforts_are_torques_or_voltages() -> None:
    v = BENCH.value
    torque = Efforts(BENCH, "torque").voltages((0.02, -0.01, 0.03), 300.0)
    assert torque[:2] == pytest.approx((0.02 / v("coil_constant"), -0.01 / v("coil_constant")))
    # the motor has to overcome the voltage that it induces
    current = (torque[2] - v("motor_constant") * 300.0) / v("motor_resistance")
    assert v("motor_constant") * current == pytest.approx(0.03)
    assert Efforts(BENCH, "voltage").voltages((1.0, 2.0, 3.0), 300.0) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("names", "values", "why"),
    [
        (["tilt_x", "tilt_y"], [1.0, 2.0], "name: no joint spin; needed: tilt_x, tilt_y, spin"),
        (["tilt_x", "tilt_y", "spin"], [1.0, 2.0], "effort: 2 values for 3 joints"),
        (["tilt_x", "tilt_y", "spin"], [], "effort: 0 values for 3 joints"),
        (["tilt_x", "tilt_y", "spin"], [1.0, math.nan, 2.0], "effort: tilt_y: nan; allowed: finite"),
        (["tilt_x", "tilt_y", "spin", "spin"], [1.0, 1.0, 1.0, 2.0], "name: a joint is named twice"),
    ],
)
def test_efforts_that_say_too_little_are_refused(names: list[str], values: list[float], why: str) -> None:
    with pytest.raises(InputError, match=why):
        efforts_of(names, values)


def test_joints_may_come_in_any_order_with_others_beside() -> None:
    assert efforts_of(["spin", "arm", "tilt_y", "tilt_x"], [3.0, math.nan, 2.0, 1.0]) == (1.0, 2.0, 3.0)


def test_the_model_tells_ros2_control_how_to_drive_the_bench() -> None:
    model = ET.fromstring(robot_description())
    (tag,) = model.findall("ros2_control")
    assert tag.get("type") == "system"
    assert tag.findtext("hardware/plugin") == "joint_state_topic_hardware_interface/JointStateTopicSystem"
    given = {param.get("name"): param.text for param in tag.findall("hardware/param")}
    assert given["joint_commands_topic"] == topics.JOINT_COMMANDS.relative
    assert given["joint_states_topic"] == topics.JOINT_STATES.relative
    assert float(str(given["trigger_joint_command_threshold"])) < 0.0  # every command is sent
    assert tuple(joint.get("name") for joint in tag.findall("joint")) == topics.JOINTS
    for joint in tag.findall("joint"):
        assert [c.get("name") for c in joint.findall("command_interface")] == ["effort"]
        assert {s.get("name") for s in joint.findall("state_interface")} == {"position", "velocity", "effort"}
    # limits that ros2_control would enforce are not below what the bench can do
    limits = {joint.get("name"): joint.find("limit") for joint in model.findall("joint")}
    largest = BENCH.value("coil_constant") * BENCH.value("coil_voltage_limit")
    assert all(float(limits[name].get("effort", 0)) >= largest - 1e-9 for name in topics.JOINTS)  # type: ignore[union-attr]


class Manager(Bystander):
    """A controller that knows standard messages alone, sent and received as the hardware interface does."""

    def __init__(self, domain: int, rate: float) -> None:
        super().__init__(domain)
        # at a lower rate everything comes later, and the damper of the nutation must be gentler
        gains = replace(BENCH.gains, nutation_damping=BENCH.gains.nutation_damping * min(rate / 2000.0, 1.0))
        self.law = Controller(BENCH.with_values({"sample_period": 1.0 / rate}), gains)
        self.setpoints: dict[int, list[float]] = {}
        self.waiting: list[Any] = []
        self.stamps: list[int] = []
        self.out = self.node.create_publisher(JointState, topics.JOINT_COMMANDS.relative, QoSProfile(depth=1))
        self.node.create_subscription(
            JointState, topics.JOINT_STATES.relative, self._on_states, qos_profile_sensor_data
        )
        self.listen(topics.SETPOINT, self._on_setpoint, raw=True)
        # announced after the joint states: who knows this reader knows that one, too
        self.listen(topics.MEASUREMENT, lambda _: None, raw=True)
        self.end = threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self.end.is_set():
            self.executor.spin_once(timeout_sec=0.02)

    def _on_setpoint(self, raw: bytes) -> None:
        stamp, _, _, *asked = wire.SETPOINT.unpack(raw)
        self.setpoints[stamp // 5_000_000] = asked
        self._answer()

    def _on_states(self, message: Any) -> None:
        self.waiting.append(message)
        self._answer()

    def _answer(self) -> None:
        while self.waiting:
            message = self.waiting[0]
            stamp = message.header.stamp.sec * wire.SECOND + message.header.stamp.nanosec
            asked = self.setpoints.get(stamp // 5_000_000)
            if asked is None:
                if not self.setpoints or min(self.setpoints) <= stamp // 5_000_000:
                    return
                del self.waiting[0]  # in real time states come before the first setpoint
                continue
            del self.waiting[0]
            self.stamps.append(stamp)
            readings = [*message.position, message.velocity[2], *[0.0] * 7]
            coil_x, coil_y, motor = self.law.update(readings, asked, stamp % 5_000_000 * 1e-9)
            v = BENCH.value
            current = (motor - v("motor_constant") * message.velocity[2]) / v("motor_resistance")
            torques = (
                v("coil_constant") * coil_x,
                v("coil_constant") * coil_y,
                v("motor_constant") * current,
            )
            self.out.publish(JointState(name=topics.JOINTS, effort=torques))


@pytest.mark.graph
@pytest.mark.parametrize("realtime", [False, pytest.param(True, marks=pytest.mark.study)])
def test_a_controller_of_standard_messages_holds_the_bench_through_a_plan(
    realtime: bool, domain: int, tmp_path: Path
) -> None:
    # a rclpy node cannot unpack so many states in real time: it closes the loop at a rate usual for ros2_control
    rate = 500.0 if realtime else 2000.0
    # a guard that is slow to act: the computer of a test may be
    patient = {"watchdog": 20.0, "oldest_command": 5.0} if realtime else {}
    adapter = subprocess.Popen(
        [str(find_executable("gyrowheel_control", "joint_commands_node"))],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
    )
    manager = Manager(domain, rate)
    manager.thread.start()
    try:
        with Graph(
            BRIEF,
            record=tmp_path / "run",
            domain_id=domain,
            without=["controller"],
            realtime=realtime,
            parameters={"plant": {"joint_state_rate": rate, "wait_for_subscribers": 4, **patient}},
        ) as graph:
            # a message that says too little is refused, and told
            wait_for(lambda: manager.out.get_subscription_count() == 1)
            manager.out.publish(JointState(name=["spin"], effort=[1.0]))
            wait_for(lambda: manager.values("joint_commands").get("refused_messages") == "1")
            assert graph.run().segments == 2
    finally:
        manager.end.set()
        manager.thread.join()
        adapter.terminate()
        code = adapter.wait(20.0)
    assert code == 0
    found = info(tmp_path / "run")
    assert found.integrity.complete
    if realtime:
        # the states come at the rate asked for; a sensor's quality of service may lose some of them
        assert np.median(np.diff(manager.stamps)) == pytest.approx(1e9 / rate, rel=0.01)
    else:
        assert manager.stamps == list(range(0, len(manager.stamps) * 500_000, 500_000))
        assert found.topics[topics.COMMAND.name] >= found.integrity.samples - 1
    recording = Recording.open(tmp_path / "run")
    # it is the law of the bench by way of torques: the wheel goes where the plan has it
    asked, had = recording.setpoint[-1], recording.measurement[-1]
    assert abs(had["spin_rate"] - asked["spin_rate"]) < 3.0
    assert np.hypot(had["tilt_x"] - asked["tilt_x"], had["tilt_y"] - asked["tilt_y"]) < math.radians(0.3)
    said = manager.diagnoses["joint_commands"].hardware_id
    assert said == "gyrowheel"
    manager.close()


@pytest.mark.study  # an exchange of controllers is in test_exchange.py
@pytest.mark.graph
def test_efforts_take_the_place_of_the_benchs_controller_and_give_it_back_during_a_plan(
    domain: int, bystander: Bystander, start_node: Callable[..., NodeProcess], tmp_path: Path
) -> None:
    """One is deactivated, the other activated: the plan goes on, nothing trips, and nobody counts as a stranger."""
    lifecycles = Lifecycles(bystander, "controller", "joint_commands")
    start_node("controller")
    adapter = subprocess.Popen(
        [
            str(find_executable("gyrowheel_control", "joint_commands_node")),
            *("--ros-args", "-p", "autostart:=false"),
        ],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
    )
    efforts = bystander.node.create_publisher(JointState, topics.JOINT_COMMANDS.relative, QoSProfile(depth=1))
    exchanged = False

    def coasts() -> bool:
        """Send one more message without torque, which makes one step; return whether there were enough."""
        time.sleep(0.02)
        efforts.publish(JointState(name=topics.JOINTS, effort=[0.0, 0.0, 0.0]))
        return int(bystander.values("joint_commands").get("commands", 0)) >= 10

    def progress(now: Progress) -> None:
        nonlocal exchanged
        if now.segment == 1 and not exchanged:
            exchanged = True
            assert lifecycles.change("controller", "deactivate")
            assert lifecycles.change("joint_commands", "activate")
            bystander.spin_until(coasts)
            assert lifecycles.change("joint_commands", "deactivate")
            assert lifecycles.change("controller", "activate")

    # in lock-step the time stands while nobody answers, and these are how long it may
    patient = {"command_timeout": 100.0, "exchange_time": 200.0}
    try:
        with Graph(
            SHORT_PLAN,
            record=tmp_path / "run",
            domain_id=domain,
            without=["controller"],
            parameters={"plant": {"wait_for_subscribers": 4, **patient}},
        ) as graph:
            assert lifecycles.change("joint_commands", "configure")
            assert graph.run(progress=progress).segments == 4
    finally:
        adapter.terminate()
        adapter.wait(20.0)
    assert exchanged
    found = info(tmp_path / "run")
    assert found.integrity.complete
    by_node = {p.node for p in found.publishers if p.topic == topics.COMMAND.name}
    assert by_node == {"/controller", "/joint_commands"}
    recording = Recording.open(tmp_path / "run")
    assert abs(recording.measurement[-1]["spin_rate"] - recording.setpoint[-1]["spin_rate"]) < 5.0
