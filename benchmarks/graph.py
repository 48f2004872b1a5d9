"""Speed of the graph of nodes in lock-step."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from benchmarks.results import Bar, Figure, MeasurementError, Report
from benchmarks.timing import processor_time
from gyrowheel_bringup.graph import EXECUTABLES, Graph, GraphError, find_executable
from gyrowheel_control.plans.plan import SETPOINT_PERIOD
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE, make_executor, prepare_environment
from gyrowheel_core.units import RPM

TURNS, TURN_S = 2, 4.0  # of the bare ping-pong and of the two nodes, one after the other
SPIN = 3500.0 * RPM
PLAN = """\
schema: 1
name: pace
hold_s: 2.0
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]], repeat: REPEAT}
"""
_DOMAIN = 61


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure the lock-step."""
    prepare_environment()
    bare: list[tuple[float, float]] = []
    ours: list[tuple[float, float]] = []
    try:
        for turn in range(TURNS):
            bare.append(ping_pong(TURN_S))
            ours.append(lock_step(TURN_S))
            progress(0.8 * (turn + 1) / TURNS)
        with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as folder:
            ratio = whole_graph(Path(folder) / "lockstep")
            progress(1.0)
    except (GraphError, InputError) as error:
        raise MeasurementError(str(error)) from None
    rates, bare_rates = ([rate for rate, _ in runs] for runs in (ours, bare))
    costs, bare_costs = (min(cost for _, cost in runs) * 1e6 for runs in (ours, bare))
    return [
        Report(
            "Graph in lock-step",
            [
                Figure(
                    "plant and controller",
                    max(rates),
                    "rounds/s",
                    "bare ping-pong",
                    max(bare_rates),
                    Bar(">=", 0.6, "ratio"),
                ),
                Figure("processor time of both", costs, "µs/round", "bare ping-pong", bare_costs),
                Figure("with estimator and recorder", ratio, "s/s", bar=Bar(">=", 1.0)),
            ],
            notes=[
                "Rounds: the plant's sample and the controller's command, two processes; bare: two processes "
                "that exchange the same number of bytes and do nothing else, rclpy on its EventsExecutor. "
                f"Alternating, {TURNS} times {TURN_S:.0f} s, the best second of each; medians of the turns "
                f"{statistics.median(rates):.0f} and {statistics.median(bare_rates):.0f}. With estimator and recorder: "
                "simulated over wall time of the whole graph, five processes, everything recorded.",
            ],
        ),
    ]


def ping_pong(seconds: float) -> tuple[float, float]:
    """Return the rounds per second of two minimal processes, best second, and their processor time per round [s]."""
    script = Path(__file__).with_name("ping_pong.py")
    with _process([sys.executable, str(script), "pong"]):
        text = subprocess.run(
            [sys.executable, str(script), "ping", f"{seconds}"],
            env=_environment(),
            capture_output=True,
            text=True,
            timeout=60.0 + seconds,
        )
    if text.returncode:
        raise MeasurementError(f"ping-pong: {' '.join(text.stderr.split())[-300:]}")
    *rates, cost = map(float, text.stdout.split())
    return max(rates), 2.0 * cost  # both do the same


def lock_step(seconds: float) -> tuple[float, float]:
    """Return the rounds per second of plant and controller alone, and their processor time per round [s].

    The rate is that of the best second. Setpoints for more than the whole run are queued before it begins, so that no
    third process is involved.
    """
    seen: list[tuple[float, int, float]] = []  # time, samples, processor time

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            samples = {v.key: v.value for v in status.values}.get("samples")
            if status.name == "plant" and samples is not None:
                stamp = message.header.stamp
                seen.append((stamp.sec + stamp.nanosec * 1e-9, int(samples), sum(map(processor_time, pids))))

    pids: list[int] = []
    with _bystander() as (node, executor):
        node.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS.name, on_diagnostics, topics.DIAGNOSTICS.qos
        )
        setpoints = node.create_publisher(
            topics.SETPOINT.message_class, topics.SETPOINT.name, topics.SETPOINT.qos
        )
        plant = ["--ros-args", "-p", f"initial_spin_rate:={SPIN}", "-p", "wait_for_subscribers:=1"]
        with (
            _process([str(find_executable(*EXECUTABLES["controller"]))]) as first,
            _process([str(find_executable(*EXECUTABLES["plant"])), *plant]) as second,
        ):
            pids += [first, second]
            end = time.monotonic() + 60.0
            while not setpoints.get_subscription_count() or not seen:
                executor.spin_once(timeout_sec=0.05)
                if time.monotonic() > end:
                    raise MeasurementError("plant and controller do not start")
            period = round(SETPOINT_PERIOD * 1e9)
            for k in range(
                round(10 * (seconds + 3.0) / SETPOINT_PERIOD)
            ):  # ten times real time is out of reach
                setpoints.publish(wire.SETPOINT.pack(k * period, 0, 1, 0.0, 0.0, 0.0, 0.0, SPIN, 0.0))
            until = time.monotonic() + seconds + 2.0
            while time.monotonic() < until:
                executor.spin_once(timeout_sec=0.05)
    rates = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in itertools.pairwise(seen) if b[0] - a[0] > 0.5]
    if not rates or max(rates) <= 0.0:
        raise MeasurementError("plant and controller do not answer each other")
    moving = [entry for entry in seen if entry[1] > 1]
    cost = (moving[-1][2] - moving[0][2]) / max(moving[-1][1] - moving[0][1], 1)
    return max(rates), cost


def whole_graph(directory: Path) -> float:
    """Return the simulated time over the wall time of a plan in the whole graph, recorded."""
    with Graph(PLAN.replace("REPEAT", "2"), record=directory, domain_id=_DOMAIN) as graph:
        return graph.run().ratio


@contextlib.contextmanager
def _process(command: list[str]) -> Iterator[int]:
    process = subprocess.Popen(
        command,
        env=_environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield process.pid
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextlib.contextmanager
def _bystander() -> Iterator[tuple[Node, Any]]:
    context = Context()
    rclpy.init(args=[], context=context, domain_id=_DOMAIN, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("benchmark", context=context, use_global_arguments=False, enable_rosout=False)
    executor = make_executor(context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()


def _environment() -> Mapping[str, str]:
    return {**os.environ, "ROS_DOMAIN_ID": str(_DOMAIN), PARENT_VARIABLE: str(os.getpid())}
