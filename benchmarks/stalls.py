"""The plant stopped by SIGSTOP in a real-time run: how exactly diagnostics and recording report each stall.

The machine has a hidden effect. The same run without stalls shows whether the verdict is the same.
"""

from __future__ import annotations

import math
import os
import re
import signal
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

import gyrowheel as gw
from benchmarks.results import Bar, Figure, MeasurementError, Report
from gyrowheel.simulation.scenario import scenario
from gyrowheel_bringup.graph import Graph
from gyrowheel_core import topics
from gyrowheel_core.node import prepare_environment
from gyrowheel_recording.bags import Recording, info
from gyrowheel_sim.bench import Bench

COUNT, LENGTH, BETWEEN = 20, 0.3, 1.5  # number of stalls; their length and the time between them [s]
DOMAIN = 84  # unless the environment names one
#: Stamps that differ by more than this number of periods are a stall.
_GAP = 100
PLAN, HIDDEN = "quick", "aero_cross"


class _Ear:
    """Collects the stalls that plant and recorder report."""

    def __init__(self, domain: int) -> None:
        self._context = Context()
        rclpy.init(
            args=[], context=self._context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
        )
        self._node = Node("ear", context=self._context, use_global_arguments=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self.told: list[float] = []
        self.recorded: dict[
            str, float
        ] = {}  # length of each stall by the message of the recorder, which repeats it
        self.offset = float("nan")  # last reported difference of the clock and the newest stamp [s]
        topic = topics.DIAGNOSTICS
        self._node.create_subscription(topic.message_class, topic.relative, self._hear, topic.qos)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._end.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "plant":
                found = re.fullmatch(r"stood_still: ([\d.]+) s at ([\d.]+) s", status.message)
                if found:
                    self.told.append(float(found[1]))
                values = {pair.key: pair.value for pair in status.values}
                if "clock_offset_s" in values:
                    self.offset = float(values["clock_offset_s"])
            elif status.name == "recorder":
                found = re.search(r"stood still ([\d.]+) s at [\d.]+ s", status.message)
                if found:
                    self.recorded[found[0]] = float(found[1])

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Stop the plant repeatedly during a plan, and compare the reports with the recorded stamps."""
    prepare_environment()
    domain = int(os.environ.get("ROS_DOMAIN_ID") or DOMAIN)
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        record, beside = Path(name) / "run", Path(name) / "beside"
        machine = scenario(Bench.load(), PLAN, effects=[HIDDEN], seed=1)
        with Graph(PLAN, scenario=machine, record=beside, realtime=True, domain_id=domain) as graph:
            graph.run(progress=lambda now: progress(0.5 * now.elapsed / now.duration))
        ear = _Ear(domain)
        try:
            with Graph(PLAN, scenario=machine, record=record, realtime=True, domain_id=domain) as graph:
                stopper = threading.Thread(
                    target=_stop_and_go, args=(graph.pids["plant"], progress), daemon=True
                )
                stopper.start()
                graph.run()
                stopper.join()
        finally:
            ear.close()
        return [_report(record, ear), _verdicts(record, beside)]


def _stop_and_go(pid: int, progress: Callable[[float], None]) -> None:
    time.sleep(2.0 * BETWEEN)
    for number in range(COUNT):
        os.kill(pid, signal.SIGSTOP)
        time.sleep(LENGTH)
        os.kill(pid, signal.SIGCONT)
        time.sleep(BETWEEN)
        progress(0.5 + 0.5 * (number + 1) / COUNT)


def _report(record: Path, ear: _Ear) -> Report:
    stamps = Recording.open(record).measurement["stamp_ns"]
    steps = (stamps[1:] - stamps[:-1]) * 1e-9
    period = 5e-4
    gaps = [float(step) - period for step in steps if step > _GAP * period]
    found = [length for _, length in info(record).integrity.stalls if length > _GAP * period]
    loud = [length for length in ear.told if length > _GAP * period]
    recorded = [length for length in ear.recorded.values() if length > _GAP * period]
    if len(gaps) < COUNT:
        raise MeasurementError(f"the recording shows {len(gaps)} stalls of {COUNT}")
    reports = []
    for who, lengths in (("diagnostics", loud), ("the recorder", recorded), ("info", found)):
        worst = max((abs(a - b) for a, b in zip(gaps, lengths, strict=False)), default=float("nan"))
        reports += [
            Figure(f"told by {who}", float(len(lengths)), f"of {len(gaps)}", bar=Bar(">=", float(len(gaps)))),
            Figure(f"error of the length, {who}, worst", 1e3 * worst, "ms", bar=Bar("<=", 5.0)),
        ]
    reports.append(
        Figure("stamps beside the clock after all", 1e3 * abs(ear.offset), "ms", bar=Bar("<=", 2.0))
    )
    return Report(
        "Stalls",
        reports,
        notes=[
            f"SIGSTOP of the plant for {LENGTH:g} s, {COUNT} times, in a real-time run; all that the stamps show count."
        ],
    )


def _verdicts(record: Path, beside: Path) -> Report:
    """Compare the findings in the recordings with and without stalls."""
    found = [gw.diagnose([path], gw.Model()) for path in (record, beside)]
    verdicts = [one.verdict for one in found]
    by_name = [{finding.name: finding.coefficients for finding in one.effects} for one in found]
    same = verdicts[0] == verdicts[1] and by_name[0].keys() == by_name[1].keys()
    apart = 0.0 if same else float("nan")
    for name in by_name[0] if same else ():
        for key, own in by_name[0][name].items():
            other = by_name[1][name][key]
            both = math.hypot(own.standard_error, other.standard_error)
            apart = max(apart, abs(own.value - other.value) / both)
    named = [f"{verdict} ({', '.join(names)})" for verdict, names in zip(verdicts, by_name, strict=True)]
    return Report(
        "Verdict of the run with stalls beside the one without",
        [
            Figure("same verdict and effects", float(same), "of 1", bar=Bar(">=", 1.0)),
            Figure("coefficients apart, largest", apart, "standard errors", bar=Bar("<=", 3.0)),
        ],
        notes=[f"Verdicts: {named[0]}; {named[1]}. Hidden: {HIDDEN}. Both runs in real time."],
    )
