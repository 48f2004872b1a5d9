"""Starts the nodes of the bench as processes of their own, runs a test plan in them and ends them again.

>>> with Graph("quick", record="run1") as graph:          # doctest: +SKIP
...     result = graph.run(progress=lambda p: print(f"{p.elapsed:.0f} of {p.duration:.0f} s"))
>>> result.recording, result.samples                      # doctest: +SKIP
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from gyrowheel_msgs.action import RunPlan
from gyrowheel_msgs.srv import StopRecording
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyrowheel_analysis.recording import info
from gyrowheel_control.plans import Plan
from gyrowheel_sim import topics
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import to_json
from gyrowheel_sim.errors import InputError
from gyrowheel_sim.node import PARENT_VARIABLE, ExitCode, make_executor, prepare_environment
from gyrowheel_sim.scenario import Scenario

#: Package and executable of each node, by the node's name.
EXECUTABLES: Mapping[str, tuple[str, str]] = {
    "plant": ("gyrowheel_sim", "plant_node"),
    "controller": ("gyrowheel_control", "controller_node"),
    "conductor": ("gyrowheel_control", "conductor_node"),
    "recorder": ("gyrowheel_analysis", "recorder_node"),
    "drag_estimator": ("gyrowheel_analysis", "drag_estimator_node"),
}
_STOP_TIMEOUT = 20.0  # for a node to end by itself [s]
_SETTLE_TIMEOUT = 30.0  # for a node to take what was sent to it [s]
_FINISH_TIMEOUT = 120.0  # for the recorder to complete its files [s]
_CLOCK_PERIOD_NS = 10_000_000  # plans end at whole multiples of it
_LISTEN = 2.0  # for what nodes of another graph say [s]


class GraphError(RuntimeError):
    """A node failed, or the graph does not get on.

    Attributes
    ----------
    node : str
        The node that failed; empty if it was none of them alone.
    fault : str
        Name of what happened: the fault that the node itself named, ``node_died``, ``start_timeout``,
        ``stalled``, ``samples_lost``, ``plan_refused`` or ``plan_aborted``.
    report : str
        Exit code and last words of every node that ended otherwise than it should, in several lines.
    """

    def __init__(self, fault: str, message: str, *, node: str = "", report: str = "") -> None:
        super().__init__(message)
        self.fault = fault
        self.node = node
        self.report = report


@dataclass(frozen=True)
class Progress:
    """How far a plan is.

    Attributes
    ----------
    segment, segments : int
        The current segment, counted from 0, and how many there are.
    label : str
        Label of the current segment.
    elapsed, duration : float
        Simulated time since the start of the plan, and its length [s].
    """

    segment: int
    segments: int
    label: str
    elapsed: float
    duration: float


@dataclass(frozen=True)
class GraphResult:
    """What a run of a plan gave.

    Attributes
    ----------
    plan : str
        Name of the plan.
    segments : int
        Segments completed.
    simulated_seconds, wall_seconds : float
        Simulated time that the plan took, and real time from its acceptance to its end [s].
    recording : Path or None
        Directory of the recording.
    samples : int
        Samples recorded; 0 without a recording.
    counts : dict of str to int
        Messages recorded, by topic; empty without a recording, and while it goes on.
    pids : dict of str to int
        Process ids of the nodes.
    """

    plan: str
    segments: int
    simulated_seconds: float
    wall_seconds: float
    recording: Path | None
    samples: int
    counts: Mapping[str, int]
    pids: Mapping[str, int]

    @property
    def ratio(self) -> float:
        """Simulated seconds per second of real time."""
        return self.simulated_seconds / self.wall_seconds


@dataclass
class _Child:
    """A node's process."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path
    expected: bool = False  # whether it was told to end
    shown: int = 0  # bytes of its log that were shown

    def show_log(self) -> None:
        """Copy to stderr what it has written since the last time."""
        with contextlib.suppress(OSError), self.log.open("rb") as log:
            log.seek(self.shown)
            new = log.read()
            self.shown += len(new)
            sys.stderr.write(new.decode("utf-8", errors="replace"))

    @property
    def last_words(self) -> str:
        """The end of what it wrote to stderr."""
        with contextlib.suppress(OSError):
            return self.log.read_text(encoding="utf-8", errors="replace")[-4000:].strip()
        return ""

    @property
    def ended_well(self) -> bool:
        """Whether it ended as it should; before a node handles signals, SIGINT is what ends it."""
        code = self.process.returncode
        return code == 0 or (self.expected and code == -signal.SIGINT)

    @property
    def ending(self) -> str:
        """How it ended, in words."""
        code = self.process.returncode
        if code is not None and code < 0:
            return f"killed by {signal.Signals(-code).name}"
        return f"exit code {code}"


class Graph:
    """The nodes of the bench, each in a process of its own; use it as a context manager.

    Parameters
    ----------
    plan : Plan, str or Path, optional
        The test plan that `run` walks: a plan, a shipped name, a path or the text of a plan file. The bench
        starts at its initial spin rate and in its first environment.
    bench : str or Path
        Name of a shipped bench, or path of a bench file.
    scenario : Scenario, str or Path, optional
        What the simulated machine really is, or a file of that; the machine of the bench file if not given.
    record : str or Path, optional
        Directory to record into; must not exist. No recording if not given.
    initial_spin_rate : float, optional
        Spin rate at the start [rad/s]; that of the plan if not given, 0 without a plan.
    hold_after_plan : bool
        Whether the bench goes on running after a plan, until the graph is closed. If not (the default), the
        end of the plan ends the graph and completes the recording.
    domain_id : int, optional
        ROS domain, 0 .. 101; that of the environment if not given.
    parameters : mapping, optional
        Further node parameters: {node: {parameter: value}}.
    without : collection of str
        Nodes not to start (`EXECUTABLES`).
    show_logs : bool
        Whether the nodes' own logs go to stderr.
    start_timeout : float
        How long the nodes may take to become active [s]; much of it is compiling where nothing is cached yet.
    stall_timeout : float
        How long a plan may go on without any progress [s].

    Raises
    ------
    InputError
        If the plan, the bench or a parameter is not allowed.
    """

    def __init__(
        self,
        plan: Plan | str | Path | None = None,
        *,
        bench: str | Path = "gyrowheel",
        scenario: Scenario | str | Path | None = None,
        record: str | Path | None = None,
        initial_spin_rate: float | None = None,
        hold_after_plan: bool = False,
        domain_id: int | None = None,
        parameters: Mapping[str, Mapping[str, object]] | None = None,
        without: Collection[str] = (),
        show_logs: bool = False,
        start_timeout: float = 300.0,
        stall_timeout: float = 60.0,
    ) -> None:
        if domain_id is not None and not 0 <= domain_id <= 101:
            raise InputError(f"domain_id: {domain_id} is out of range; allowed: 0 .. 101")
        for name in (*without, *(parameters or {})):
            if name not in EXECUTABLES:
                raise InputError(f"node '{name}': no such node; allowed: {', '.join(EXECUTABLES)}")
        self._bench = Bench.load(bench)
        self._plan = None if plan is None else self._checked(plan)
        self._record = None if record is None else Path(record).absolute()
        if self._record is not None and self._record.exists():
            raise InputError(f"{record}: exists already; a recording needs a new directory")
        self._scenario = scenario
        self._bench_source = str(bench if str(bench) in Bench.shipped() else Path(bench).absolute())
        self._initial_spin_rate = initial_spin_rate
        self._hold = hold_after_plan
        self._domain_id = domain_id
        self._parameters = {name: dict(values) for name, values in (parameters or {}).items()}
        self._names = [name for name in EXECUTABLES if name not in without]
        self._show_logs = show_logs
        self._start_timeout = start_timeout
        self._stall_timeout = stall_timeout
        self._children: dict[str, _Child] = {}
        self._pids: dict[str, int] = {}
        self._diagnoses: dict[str, str] = {}
        self._active: set[str] = set()
        self._starting = True
        self._strangers: dict[str, str] = {}  # nodes of the same name that are not of this graph
        self._cleanup = contextlib.ExitStack()

    # ---- life

    def __enter__(self) -> Self:
        """Start the nodes and wait until they are active."""
        try:
            self._start()
        except BaseException:
            with contextlib.suppress(GraphError, InputError):  # the first error is the one that tells
                self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the nodes."""
        try:
            self.close()
        except (GraphError, InputError):
            if error is None:
                raise

    @property
    def pids(self) -> dict[str, int]:
        """Process id of each node."""
        return dict(self._pids)

    def close(self) -> None:
        """End the nodes, the recording after everything has reached it; does nothing a second time.

        Raises
        ------
        GraphError, InputError
            If a node did not end as it should.
        """
        with _uninterrupted():
            try:
                if self._children:
                    if not self._strangers:  # who would answer, too
                        self._settle()
                    self._stop()
                failed = [child for child in self._children.values() if not child.ended_well]
                error = self._failure(failed) if failed else None
            finally:
                for child in self._children.values():
                    if child.process.poll() is None:
                        child.process.kill()
                        child.process.wait()
                self._show()
                self._children.clear()
                self._cleanup.close()
        if error is not None:
            raise error

    # ---- running

    def run(
        self, plan: Plan | str | Path | None = None, *, progress: Callable[[Progress], None] | None = None
    ) -> GraphResult:
        """Walk a plan to its end.

        Parameters
        ----------
        plan : Plan, str or Path, optional
            Another plan than that of the graph; only in a graph that holds after a plan.
        progress : callable, optional
            Called at each change of segment and each simulated second.

        Raises
        ------
        InputError
            If the plan is not allowed, or a node says that its input is not.
        GraphError
            If a node fails, the plan is refused or aborted, or nothing goes on any more.
        """
        chosen = self._plan if plan is None else self._checked(plan)
        if chosen is None:
            raise InputError("plan: the graph was started without one; give one to run")
        begin = time.monotonic()
        result = self._walk(chosen, progress)
        wall = time.monotonic() - begin
        counts: dict[str, int] = {}
        samples = 0
        if not self._hold:
            self.close()
            if self._record is not None:
                counts, samples = self._check_recording(chosen)
        return GraphResult(
            plan=chosen.name,
            segments=result.segments,
            simulated_seconds=result.duration,
            wall_seconds=wall,
            recording=self._record,
            samples=samples,
            counts=counts,
            pids=self.pids,
        )

    def wait(self) -> None:
        """Let the graph run until a node ends.

        Raises
        ------
        GraphError, InputError
            Why it ended.
        """
        while True:
            self._spin()

    # ---- starting

    def _start(self) -> None:
        prepare_environment()
        work = Path(tempfile.mkdtemp(prefix="gyrowheel-"))
        self._cleanup.callback(shutil.rmtree, work, ignore_errors=True)
        self._connect()
        parameters = self._node_parameters(work)
        environment = os.environ | {PARENT_VARIABLE: str(os.getpid()), "ROS_LOG_DIR": str(work / "log")}
        if self._domain_id is not None:
            environment["ROS_DOMAIN_ID"] = str(self._domain_id)
        for name in self._names:
            file = work / f"{name}.yaml"
            content = {f"/{name}": {"ros__parameters": parameters[name]}}
            file.write_text(yaml.safe_dump(content), encoding="utf-8")
            log = work / f"{name}.log"
            with log.open("wb") as output:
                process = subprocess.Popen(
                    [str(find_executable(*EXECUTABLES[name])), "--ros-args", "--params-file", str(file)],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=output,
                    env=environment,
                    start_new_session=True,  # a Ctrl-C of the terminal is for this process alone
                )
            self._children[name] = _Child(name, process, log)
            self._pids[name] = process.pid
        self._wait_until_active()

    def _connect(self) -> None:
        """Create the node through which this process takes part."""
        context = Context()
        rclpy.init(
            args=["--ros-args", "--disable-external-lib-logs"],
            context=context,
            domain_id=self._domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._cleanup.callback(context.try_shutdown)
        self._node = Node(
            f"graph_{os.getpid()}", context=context, use_global_arguments=False, enable_rosout=False
        )
        self._cleanup.callback(self._node.destroy_node)
        self._executor = make_executor(context)
        self._cleanup.callback(self._executor.shutdown)
        self._executor.add_node(self._node)
        topic = topics.DIAGNOSTICS
        self._node.create_subscription(DiagnosticArray, topic.name, self._on_diagnostics, topic.qos)
        self._changes = {
            name: self._node.create_client(ChangeState, f"/{name}/change_state")
            for name in ("plant", "drag_estimator")
        }
        self._stop_recording = self._node.create_client(StopRecording, "/gyrowheel/recorder/stop")
        self._plans = ActionClient(self._node, RunPlan, "/gyrowheel/run_plan")
        self._cleanup.callback(self._plans.destroy)

    def _node_parameters(self, work: Path) -> dict[str, dict[str, object]]:
        scenario = "" if self._scenario is None else str(self._scenario)
        if isinstance(self._scenario, Scenario):
            scenario = str(work / "scenario.json")
            self._scenario.save(scenario)
        result = node_parameters(
            self._plan,
            bench=self._bench_source,
            scenario=scenario,
            record="" if self._record is None else str(self._record),
            hold_after_plan=self._hold,
            nodes=self._names,
        )
        if self._initial_spin_rate is not None:
            result["plant"]["initial_spin_rate"] = float(self._initial_spin_rate)
        for name, values in self._parameters.items():
            result[name] |= values
        return result

    def _wait_until_active(self) -> None:
        began = time.monotonic()
        deadline = began + self._start_timeout
        while True:
            waiting = [name for name in self._names if name not in self._active]
            # nodes of another graph are known by what they say once a second, and by their names, which may be seen
            # sooner: listen for a while before the domain counts as free
            if not waiting and time.monotonic() - began > _LISTEN:
                self._starting = False
                return
            self._spin()
            self._look_for_strangers()
            if self._strangers:
                name = min(self._strangers)
                raise GraphError(
                    "domain_in_use",
                    f"the ROS domain has another node '{name}' (process {self._strangers[name]}): "
                    "end that graph, or choose another domain",
                )
            if time.monotonic() > deadline:
                states = "; ".join(f"{name}: {self._diagnoses.get(name, 'silent')}" for name in waiting)
                raise GraphError("start_timeout", f"not active after {self._start_timeout:g} s ({states})")

    def _look_for_strangers(self) -> None:
        """Note nodes of the bench on this domain beyond our own."""
        seen = self._node.get_node_names()
        for name in EXECUTABLES:
            if seen.count(name) > (name in self._names):
                self._strangers.setdefault(name, "unknown")

    # ---- talking

    def _walk(self, plan: Plan, progress: Callable[[Progress], None] | None) -> RunPlan.Result:
        """Send the plan to the conductor and wait for the result."""
        last = time.monotonic()

        def report(message: Any) -> None:
            nonlocal last
            last = time.monotonic()
            f = message.feedback
            if progress is not None:
                progress(Progress(f.segment, f.segments, f.label, f.elapsed, f.duration))

        def wait(future: Any) -> Any:
            while not future.done():
                self._spin()
                if time.monotonic() - last > self._stall_timeout:
                    states = "; ".join(f"{name}: {text}" for name, text in sorted(self._diagnoses.items()))
                    raise GraphError("stalled", f"no progress for {self._stall_timeout:g} s ({states})")
            return future.result()

        while not self._plans.server_is_ready():
            self._spin()
        goal = wait(self._plans.send_goal_async(RunPlan.Goal(plan=plan.to_yaml()), feedback_callback=report))
        if not goal.accepted:
            raise GraphError("plan_refused", "the conductor refused the plan: it walks another one")
        answer = wait(goal.get_result_async())
        if not answer.result.success:
            raise GraphError("plan_aborted", f"plan {plan.name}: {answer.result.message}")
        return answer.result

    def _spin(self, seconds: float = 0.05) -> None:
        """Take part in the graph for a moment; raise if a node has ended."""
        end = time.monotonic() + seconds
        while (rest := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=rest)
        self._show()
        ended = [c for c in self._children.values() if c.process.poll() is not None and not c.expected]
        if ended:
            raise self._failure(ended)

    def _show(self) -> None:
        if self._show_logs:
            for child in self._children.values():
                child.show_log()

    def _call(self, name: str, client: Any, request: Any, *, timeout: float) -> Any:
        """Call a service of a node; return None if the node has ended or no answer comes in time."""
        if name not in self._children or not client.service_is_ready():
            return None
        future = client.call_async(request)
        end = time.monotonic() + timeout
        while not future.done():
            self._executor.spin_once(timeout_sec=0.05)
            if self._children[name].process.poll() is not None or time.monotonic() > end:
                return None
        return future.result()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name not in self._names:
                continue
            values = {pair.key: pair.value for pair in status.values}
            if values.get("pid") != str(self._pids.get(status.name)):
                if self._starting:  # later ones are refused by their own graph
                    self._strangers[status.name] = values.get("pid", "unknown")
                continue
            self._diagnoses[status.name] = status.message
            if values["state"] == "active":
                self._active.add(status.name)

    # ---- ending

    def _settle(self) -> None:
        """Bring the flow of messages to its end, so that every node has what was sent to it.

        A node answers a service after it has taken what came before: the plant stops, the estimator gives its last
        estimate, then the recorder completes its files.
        """
        deactivate = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
        for name in ("plant", "drag_estimator"):
            self._call(name, self._changes[name], deactivate, timeout=_SETTLE_TIMEOUT)
        if self._record is not None:
            self._call("recorder", self._stop_recording, StopRecording.Request(), timeout=_FINISH_TIMEOUT)

    def _stop(self) -> None:
        """Tell the nodes to end, and wait until they have; kill those that do not."""
        for child in self._children.values():
            if child.process.poll() is None:
                child.expected = True
                child.process.send_signal(signal.SIGINT)
        end = time.monotonic() + _STOP_TIMEOUT
        for child in self._children.values():
            try:
                child.process.wait(max(end - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()

    def _failure(self, children: Collection[_Child]) -> Exception:
        """Return the error that tells why nodes ended; a fault that a node names comes first."""
        ranks = (ExitCode.BAD_INPUT, ExitCode.FAULT)
        first = min(children, key=lambda c: (*ranks, c.process.returncode).index(c.process.returncode))
        report = "\n".join(f"{c.name}: {c.ending}\n{c.last_words}" for c in children)
        line = first.last_words.rpartition("\n")[2].removeprefix(f"{first.name}: ")
        if first.process.returncode == ExitCode.BAD_INPUT:
            return InputError(line or f"{first.name}: {first.ending}")
        if first.process.returncode == ExitCode.FAULT:
            return GraphError(line.partition(":")[0], f"{first.name}: {line}", node=first.name, report=report)
        return GraphError("node_died", f"{first.name}: {first.ending}", node=first.name, report=report)

    def _check_recording(self, plan: Plan) -> tuple[dict[str, int], int]:
        """Return the counts of the completed recording; raise if it lacks a sample of the plan."""
        assert self._record is not None
        found = info(self._record)
        end_ns = round(plan.duration * 1e9)
        end_ns += -end_ns % _CLOCK_PERIOD_NS
        published = end_ns // round(self._bench.sample_period * 1e9) + 1
        if found.integrity.samples != published:
            raise GraphError(
                "samples_lost",
                f"{self._record}: {found.integrity.samples} samples recorded of {published} published",
            )
        return dict(found.topics), found.integrity.samples

    def _checked(self, plan: Plan | str | Path) -> Plan:
        result = plan if isinstance(plan, Plan) else Plan.load(plan)
        result.check(self._bench)
        return result


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let nothing but SIGKILL come in between; only the main thread gets signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {n: signal.signal(n, signal.SIG_IGN) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def node_parameters(
    plan: Plan | None,
    *,
    bench: str = "gyrowheel",
    scenario: str = "",
    record: str = "",
    hold_after_plan: bool = True,
    nodes: Collection[str] = tuple(EXECUTABLES),
) -> dict[str, dict[str, object]]:
    """Return the parameters with which nodes run a plan together: {node: {parameter: value}}.

    Every node waits until those that it has to reach listen, so that no sample is lost.

    Parameters
    ----------
    plan : Plan or None
        The bench starts at its spin rate and in its first environment; at rest and upright without a plan.
    bench : str
        Name of a shipped bench, or path of a bench file.
    scenario, record : str
        Scenario file, and directory to record into; empty: none.
    hold_after_plan : bool
        Whether the bench goes on running after the plan.
    nodes : collection of str
        The nodes that take part.
    """
    events = [] if plan is None else [event for event in plan.environment() if event.time == 0.0]
    recorders = int("recorder" in nodes and bool(record))
    estimators = int("drag_estimator" in nodes)
    return {
        "plant": {
            "bench": bench,
            "scenario_file": scenario and str(Path(scenario).absolute()),
            "environment": to_json(events) if events else "",
            "initial_spin_rate": 0.0 if plan is None else float(plan.initial_spin_rate),
            "wait_for_subscribers": 1 + recorders + estimators,
        },
        "controller": {"bench": bench, "wait_for_subscribers": 1 + recorders},
        "conductor": {
            "bench": bench,
            "hold_after_plan": hold_after_plan,
            "wait_for_subscribers": 1 + recorders + estimators,
        },
        "recorder": {"directory": record},
        "drag_estimator": {"bench": bench},
    }


def find_executable(package: str, executable: str) -> Path:
    """Return the path of a node's executable.

    Looked for in the environment of this Python first, then in the prefixes of ``AMENT_PREFIX_PATH``.

    Raises
    ------
    InputError
        If there is none.
    """
    prefixes = [sys.prefix, *filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))]
    folders = [Path(prefix) / "lib" / package for prefix in prefixes]
    for folder in folders:
        path = folder / executable
        if path.is_file() and os.access(path, os.X_OK):
            return path
    there = sorted({path.name for folder in folders if folder.is_dir() for path in folder.iterdir()})
    if there:
        raise InputError(f"package {package} has no executable '{executable}'; it has: {', '.join(there)}")
    raise InputError(f"package '{package}' is not installed, or has no executables")


def run_executable(package: str, executable: str, arguments: Collection[str] = ()) -> NoReturn:
    """Replace this process by a node's executable, as ``ros2 run`` does.

    Raises
    ------
    InputError
        If there is no such executable.
    """
    path = find_executable(package, executable)
    prepare_environment()
    os.execv(path, [str(path), *arguments])
