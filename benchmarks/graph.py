"""How fast the graph of nodes is in lock-step, and how well it keeps pace with wall-clock time."""

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
from gyrowheel_analysis.recording import info
from gyrowheel_bringup.graph import EXECUTABLES, Graph, GraphError, Progress, find_executable
from gyrowheel_control.plans.plan import SETPOINT_PERIOD
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE, make_executor, prepare_environment
from gyrowheel_core.units import RPM

TURNS, TURN_S = 2, 4.0  # of the bare ping-pong and of the two nodes, one after the other
REALTIME_S = 60.0
WATCHDOG_S = 2.0  # longer than usual, for a computer that does other things meanwhile
SPIN = 3500.0 * RPM
PLAN = """\
schema: 1
name: pace
hold_s: 2.0
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]], repeat: REPEAT}
"""
_SEGMENTS_S = 10.8  # of one repetition of it
_DOMAIN = 61


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure the lock-step and the real-time mode."""
    prepare_environment()
    bare: list[tuple[float, float]] = []
    ours: list[tuple[float, float]] = []
    try:
        for turn in range(TURNS):
            bare.append(ping_pong(TURN_S))
            ours.append(lock_step(TURN_S))
            progress(0.3 * (turn + 1) / TURNS)
        with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as folder:
            ratio = whole_graph(Path(folder) / "lockstep")
            progress(0.4)
            pace = real_time(Path(folder) / "realtime", lambda part: progress(0.4 + 0.6 * part))
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
                "Rounds: the plant's sample and the controller's command, two processes; beside them two processes "
                "that send each other the same number of bytes and do nothing else, rclpy on its EventsExecutor. "
                f"By turns, {TURNS} times {TURN_S:.0f} s, the best second of each; medians of the turns "
                f"{statistics.median(rates):.0f} and {statistics.median(bare_rates):.0f}. With estimator and recorder: "
                "simulated over wall time of the whole graph, five processes, everything recorded.",
            ],
        ),
        pace,
    ]


def ping_pong(seconds: float) -> tuple[float, float]:
    """Return the rounds per second of two bare processes, the best second, and their processor time a round [s]."""
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
    """Return the rounds per second of plant and controller alone, and their processor time a round [s].

    The rate is that of the best second. Setpoints for more than the whole run are there before it begins, so that no
    third process takes part.
    """
    seen: list[tuple[float, int, float]] = []  # time, samples, processor time

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            samples = {v.key: v.value for v in status.values}.get("samples")
            if status.name == "plant" and samples is not None:
                stamp = message.header.stamp
                seen.append((stamp.sec + stamp.nanosec * 1e-9, int(samples), sum(map(_cpu, pids))))

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


def real_time(directory: Path, progress: Callable[[float], None]) -> Report:
    """Run the whole graph by wall-clock time and return what it lost and what it took."""
    marks: list[tuple[float, dict[str, float]]] = []

    def note(p: Progress) -> None:
        marks.append((time.monotonic(), {name: _cpu(pid) for name, pid in graph.pids.items()}))
        progress(min(p.elapsed / p.duration, 1.0))

    title = f"Graph in real time, {REALTIME_S:.0f} s"
    repeat = str(round(REALTIME_S / _SEGMENTS_S))
    parameters = {"plant": {"watchdog": WATCHDOG_S}}
    try:
        with Graph(
            PLAN.replace("REPEAT", repeat),
            record=directory,
            realtime=True,
            parameters=parameters,
            domain_id=_DOMAIN,
        ) as graph:
            result = graph.run(progress=note)
    except GraphError as error:
        # such as the guard that trips because the computer has no time for the loop: that is a result, too
        figure = Figure("lost samples", float("nan"), "samples", bar=Bar("<=", 0.0))
        return Report(title, [figure], notes=[f"The run ended early: {error}."])
    found = info(directory).integrity
    (begin, first), (end, last) = marks[0], marks[-1]
    samples, pace = result.samples, result.pace
    return Report(
        title,
        [
            Figure("lost samples", float(found.missing), "samples", bar=Bar("<=", 0.0)),
            Figure("late commands", 100.0 * pace["late_commands"] / samples, "%"),
            Figure("missing commands", 100.0 * pace["missing_commands"] / samples, "%"),
            Figure("samples with the last command held", 100.0 * pace["held_samples"] / samples, "%"),
            Figure("samples more than a period late", 100.0 * pace["late_samples"] / samples, "%"),
            Figure("longest delay of a sample", pace["worst_delay_ms"], "ms"),
            *(
                Figure(f"processor: {name}", 100.0 * (last[name] - first[name]) / (end - begin), "%")
                for name in graph.pids
            ),
        ],
        notes=[
            f"Five processes and the one that started them, a sample every 0.5 ms, everything recorded: {samples} "
            "samples. Late is a command that came after the next sample; the guard's watch-dog is set to "
            f"{WATCHDOG_S:g} s. Processor: share of one core.",
        ],
    )


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


def _cpu(pid: int) -> float:
    """Return the time of the processor that a process has taken [s]; NaN where the system does not tell."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
