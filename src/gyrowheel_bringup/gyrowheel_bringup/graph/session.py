"""A session of the graph, as a context manager: starts the nodes, runs plans, ends the nodes."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from gyrowheel_msgs.action import RunPlan
from gyrowheel_msgs.msg import DragEstimate
from gyrowheel_msgs.srv import StopRecording
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyrowheel_analysis.drag import Estimate
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.recording import info
from gyrowheel_bringup.graph.children import Child, remove_left, uninterrupted
from gyrowheel_bringup.graph.cores import share_core
from gyrowheel_bringup.graph.nodes import EXECUTABLES, find_executable, node_parameters
from gyrowheel_bringup.graph.results import GraphError, GraphResult, Progress
from gyrowheel_bringup.graph.strangers import Strangers
from gyrowheel_control.loops.limits import plan_tilt_limit, tilt_limit
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE, ExitCode, make_executor, prepare_environment
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario

_STOP_TIMEOUT = 20.0  # time for a node to end by itself [s]
_SETTLE_TIMEOUT = 30.0  # time for a node to take what was sent to it [s]
_FINISH_TIMEOUT = 120.0  # time for the recorder to complete its files [s]
_CLOCK_PERIOD_NS = 10_000_000  # plans end at whole multiples of this
_LISTEN = 4.0  # time to listen for nodes of another graph [s]
_EXPLAIN = 3.0  # time for a node to end, or to report why a plan was aborted [s]
_WIND_DOWN = 60.0  # time for the guard to stop the motor [s]
_LAST = 0.1  # time to take what has arrived [s]
_PACE = ("late_commands", "missing_commands", "held_samples", "late_samples", "worst_delay_ms", "behind_s")


class Graph:
    """The nodes of the bench, each in its own process; a context manager.

    Parameters
    ----------
    plan : Plan, str or Path, optional
        The test plan that `run` executes: a plan, a shipped name, a path or the text of a plan file. The bench
        starts at its initial spin rate and in its first environment.
    bench : str or Path
        Name of a shipped bench, or path of a bench file.
    scenario : Scenario, str or Path, optional
        The true simulated machine, or a file of it; by default the machine of the bench file.
    model : Model, str or Path, optional
        The model that the drag estimator believes, or its file; by default the bench without effects.
    record : str or Path, optional
        Directory to record into; must not exist. By default nothing is recorded.
    initial_spin_rate : float, optional
        Spin rate at the start [rad/s]; by default that of the plan, 0 without a plan.
    hold_after_plan : bool
        Whether the bench keeps running after a plan, until the graph is closed. If not (the default), the
        end of the plan ends the graph and completes the recording.
    realtime : bool
        Whether the bench runs in wall-clock time instead of lock-step.
    domain_id : int, optional
        ROS domain, 0 .. 101; by default that of the environment.
    parameters : mapping, optional
        Further node parameters: {node: {parameter: value}}.
    remap : mapping, optional
        Other names of topics and services for single nodes: {node: {name: other name}}.
    without : collection of str
        Nodes not to start (`EXECUTABLES`).
    show_logs : bool
        Whether the nodes' own logs go to stderr.
    start_timeout : float
        Longest time for the nodes to become active [s]; it includes compilation where nothing is cached yet.
    stall_timeout : float
        Longest time of a plan without any progress [s].
    on_trouble : callable, optional
        Called with the name of a node and one line when the node reports a warning or an error on ``/diagnostics``;
        once for each kind.

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
        model: Model | str | Path | None = None,
        record: str | Path | None = None,
        initial_spin_rate: float | None = None,
        hold_after_plan: bool = False,
        realtime: bool = False,
        domain_id: int | None = None,
        parameters: Mapping[str, Mapping[str, object]] | None = None,
        remap: Mapping[str, Mapping[str, str]] | None = None,
        without: Collection[str] = (),
        show_logs: bool = False,
        start_timeout: float = 300.0,
        stall_timeout: float = 60.0,
        on_trouble: Callable[[str, str], None] | None = None,
    ) -> None:
        if domain_id is not None and not 0 <= domain_id <= 101:
            raise InputError(f"domain_id: {domain_id} is out of range; allowed: 0 .. 101")
        for name in (*without, *(parameters or {}), *(remap or {})):
            if name not in EXECUTABLES:
                raise InputError(f"node '{name}': no such node; allowed: {', '.join(EXECUTABLES)}")
        self._bench = Bench.load(bench)
        self._parameters = {name: dict(values) for name, values in (parameters or {}).items()}
        self._plan = None if plan is None else self._checked(plan)
        self._record = None if record is None else Path(record).absolute()
        if self._record is not None and self._record.exists():
            raise InputError(f"{record}: exists already; a recording needs a new directory")
        self._scenario = scenario
        self._model = model
        self._estimates: list[Estimate] = []
        self._bench_source = str(bench if str(bench) in Bench.shipped() else Path(bench).absolute())
        self._initial_spin_rate = initial_spin_rate
        self._hold = hold_after_plan
        self._remap = {name: dict(names) for name, names in (remap or {}).items()}
        self._realtime = realtime
        self._domain_id = domain_id
        self._names = [name for name in EXECUTABLES if name not in without]
        self._show_logs = show_logs
        self._start_timeout = start_timeout
        self._stall_timeout = stall_timeout
        self._on_trouble = on_trouble
        self._children: dict[str, Child] = {}
        self._pids: dict[str, int] = {}
        self._diagnoses: dict[str, str] = {}
        self._values: dict[str, dict[str, str]] = {}  # values of the last diagnosis of an active node
        self._troubles: set[tuple[str, str]] = set()
        self._alarm: GraphError | None = None  # guards that have tripped
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
            with contextlib.suppress(GraphError, InputError):  # the first error tells the cause
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
        """End the nodes, the recorder last, once everything has reached it; a second call does nothing.

        Raises
        ------
        GraphError, InputError
            If a node did not end well.
        """
        with uninterrupted():
            try:
                if self._children:
                    if not self._strangers:  # which would answer too
                        self._wind_down()
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
                killed = [child for child in self._children.values() if (child.process.returncode or 0) < 0]
                self._children.clear()
                self._cleanup.close()
                remove_left({name for child in killed for name in child.memory})
        if error is not None:
            raise error

    # ---- running

    def run(
        self, plan: Plan | str | Path | None = None, *, progress: Callable[[Progress], None] | None = None
    ) -> GraphResult:
        """Execute a plan to its end.

        Parameters
        ----------
        plan : Plan, str or Path, optional
            A plan other than that of the graph; only in a graph that holds after a plan.
        progress : callable, optional
            Called at each change of segment and each simulated second.

        Raises
        ------
        InputError
            If the plan is not allowed, or a node refuses its input.
        GraphError
            If a node fails, the plan is refused or aborted, or there is no progress.
        """
        chosen = self._plan if plan is None else self._checked(plan)
        if chosen is None:
            raise InputError("plan: the graph was started without one; give one to run")
        begin = time.monotonic()
        known = len(self._estimates)
        result = self._walk(chosen, progress)
        wall = time.monotonic() - begin
        counts: dict[str, int] = {}
        samples = 0
        if not self._hold:
            self.close()
            if self._record is not None:
                counts, samples = self._check_recording(chosen)
        self._check_publishers()
        return GraphResult(
            plan=chosen.name,
            segments=result.segments,
            simulated_seconds=result.duration,
            wall_seconds=wall,
            recording=self._record,
            samples=samples,
            counts=counts,
            pids=self.pids,
            pace=self._pace(),
            estimates=tuple(self._estimates[known:]),
        )

    def wait(self) -> None:
        """Let the graph run until a node ends.

        Raises
        ------
        GraphError, InputError
            The reason why it ended.
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
            renamed = [f"{old}:={new}" for old, new in self._remap.get(name, {}).items()]
            log = work / f"{name}.log"
            with log.open("wb") as output:
                process = subprocess.Popen(
                    [
                        str(find_executable(*EXECUTABLES[name])),
                        "--ros-args",
                        "--params-file",
                        str(file),
                        *(argument for rename in renamed for argument in ("-r", rename)),
                    ],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=output,
                    env=environment,
                    start_new_session=True,  # a Ctrl-C of the terminal is for this process alone
                )
            self._children[name] = Child(name, process, log)
            self._pids[name] = process.pid
        self._wait_until_active()

    def _connect(self) -> None:
        """Create the node of this process."""
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
        # of nodes with other names of topics it is not known which they publish
        self._others = Strangers(self._node, () if self._remap else self._names)
        topic = topics.DIAGNOSTICS
        self._node.create_subscription(DiagnosticArray, topic.name, self._on_diagnostics, topic.qos)
        if "drag_estimator" in self._names:
            topic = topics.DRAG_ESTIMATE
            self._node.create_subscription(DragEstimate, topic.name, self._on_estimate, topic.qos, raw=True)
        self._changes = {
            name: self._node.create_client(ChangeState, f"/{name}/change_state")
            for name in ("plant", "drag_estimator")
        }
        self._stop_recording = self._node.create_client(StopRecording, "/gyrowheel/recorder/stop")
        self._plans = ActionClient(self._node, RunPlan, "/gyrowheel/run_plan")
        self._cleanup.callback(self._plans.destroy)

    def _machine(self) -> str:
        """Return the name of the machine, of which nothing of it can be read."""
        known = self._scenario if isinstance(self._scenario, Scenario) else Scenario()
        if self._scenario is not None and not isinstance(self._scenario, Scenario):
            known = Scenario.load(self._scenario, self._bench)
        return known.identity(self._bench)

    def _node_parameters(self, work: Path) -> dict[str, dict[str, object]]:
        scenario = "" if self._scenario is None else str(self._scenario)
        if isinstance(self._scenario, Scenario):
            scenario = str(work / "scenario.json")
            self._scenario.save(scenario)
        model = "" if self._model is None else str(self._model)
        if isinstance(self._model, Model):
            model = str(work / "model.yaml")
            replace(self._model, bench_source=self._bench_source).save(model)
        result = node_parameters(
            self._plan,
            bench=self._bench_source,
            scenario=scenario,
            model=model,
            record="" if self._record is None else str(self._record),
            hold_after_plan=self._hold,
            realtime=self._realtime,
            nodes=self._names,
            machine=self._machine(),
        )
        if "drag_estimator" in self._names:
            result["drag_estimator"]["wait_for_subscribers"] = 1 + int(
                "recorder" in self._names and self._record is not None
            )  # this process reads the estimates too
        if "controller" not in self._names:
            result["conductor"]["controller"] = "none"
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
            # nodes of another graph show in their diagnoses, once a second, and in their names, which may come sooner:
            # listen for a while before the domain counts as free
            if not waiting and time.monotonic() - began > _LISTEN:
                self._starting = False
                share_core(self._pids, self._node.context.get_domain_id())
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
        """Note nodes of the bench on this domain that are not ours."""
        seen = self._node.get_node_names()
        for name in self._names:  # one that was left out is somebody's own
            if seen.count(name) > 1:
                self._strangers.setdefault(name, "unknown")

    # ---- talking

    def _walk(self, plan: Plan, progress: Callable[[Progress], None] | None) -> RunPlan.Result:
        """Send the plan to the conductor and wait for the result."""
        last = time.monotonic()
        raised: list[BaseException] = []
        walking = True

        def report(message: Any) -> None:
            nonlocal last
            last = time.monotonic()
            f = message.feedback
            if progress is None or not walking:
                return
            try:
                progress(Progress(f.segment, f.segments, f.label, f.elapsed, f.duration))
            except BaseException as error:  # the executor would end the process for it
                raised.append(error)

        def wait(future: Any) -> Any:
            while not future.done():
                self._spin()
                if raised:
                    raise raised[0]
                if time.monotonic() - last > self._stall_timeout:
                    states = "; ".join(f"{name}: {text}" for name, text in sorted(self._diagnoses.items()))
                    raise GraphError("stalled", f"no progress for {self._stall_timeout:g} s ({states})")
            return future.result()

        try:
            while not self._plans.server_is_ready():
                self._spin()
            goal = wait(
                self._plans.send_goal_async(RunPlan.Goal(plan=plan.to_yaml()), feedback_callback=report)
            )
            if not goal.accepted:
                raise GraphError(
                    "plan_refused", "the conductor refused the plan: it is executing another one"
                )
            answer = wait(goal.get_result_async())
            if not answer.result.success:
                self._explain(plan, answer.result.message)
            return answer.result
        finally:
            walking = False

    def _explain(self, plan: Plan, message: str) -> NoReturn:
        """Raise the error why a plan was aborted: that of a node, if there is one."""
        end = time.monotonic() + _EXPLAIN
        while "aborted" in message and "clock_jump" not in message and time.monotonic() < end:
            self._spin()
        named = re.match(r"aborted: (\w+): ", message)
        fault = named[1] if named and named[1] not in EXECUTABLES else "plan_aborted"
        raise GraphError(fault, f"plan {plan.name}: {message}", node="conductor")

    def _spin(self, seconds: float = 0.05) -> None:
        """Serve this process's node for a moment; raise if a node has ended."""
        end = time.monotonic() + seconds
        while (rest := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=rest)
        self._show()
        self._others.look()
        ended = [c for c in self._children.values() if c.process.poll() is not None and not c.expected]
        if ended:
            raise self._failure(ended)
        if self._alarm is not None:
            raise self._alarm

    def _show(self) -> None:
        if self._show_logs:
            for child in self._children.values():
                child.show_log()

    def _call(self, name: str, client: Any, request: Any, *, timeout: float) -> Any:
        """Call a service of a node; return None if the node has ended or does not answer in time."""
        if name not in self._children or not client.service_is_ready():
            return None
        future = client.call_async(request)
        end = time.monotonic() + timeout
        while not future.done():
            self._executor.spin_once(timeout_sec=0.05)
            if self._children[name].process.poll() is not None or time.monotonic() > end:
                return None
        return future.result()

    def _on_estimate(self, data: bytes) -> None:
        # what is no estimate comes from a stranger, who is told as such
        with contextlib.suppress(ValueError):
            self._estimates.append(Estimate.from_bytes(data))

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
            self._children[status.name].note_memory()
            if values["state"] == "active":
                self._active.add(status.name)
                self._values[status.name] = values
                self._others.note(values)
                self._note_trouble(status)
                if status.level == DiagnosticStatus.ERROR and "guard" in values and self._alarm is None:
                    self._alarm = GraphError(
                        values["guard"], f"{status.name}: {status.message}", node=status.name
                    )

    def _note_trouble(self, status: DiagnosticStatus) -> None:
        """Pass on the warnings and errors of a node, each kind once."""
        if status.level == DiagnosticStatus.OK or self._on_trouble is None:
            return
        trouble = (status.name, status.message.partition(":")[0])
        if trouble not in self._troubles:
            self._troubles.add(trouble)
            self._on_trouble(status.name, status.message)

    # ---- ending

    def _wind_down(self) -> None:
        """In real time with a broken loop, let the guard of the plant stop the motor, and record it."""
        broken = self._alarm or any(c.process.poll() is not None for c in self._children.values())
        if not self._realtime or not broken or "plant" not in self._active:
            return
        end = time.monotonic() + _WIND_DOWN
        self._values.pop("plant", None)  # up to a second old
        plant = self._children["plant"].process
        while plant.poll() is None and time.monotonic() < end:
            # before the first command nothing is lost, and the motor keeps turning
            values = self._values.get("plant", {})
            if values.get("outputs") == "off" or values.get("guard") in ("waiting", "stopped"):
                return
            self._executor.spin_once(timeout_sec=0.05)

    def _settle(self) -> None:
        """End the flow of messages, so that every node has received what was sent to it.

        A node answers a service after it has taken all earlier messages: the plant stops, the estimator publishes its
        last estimate, then the recorder completes its files.
        """
        deactivate = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
        for name in ("plant", "drag_estimator"):
            self._call(name, self._changes[name], deactivate, timeout=_SETTLE_TIMEOUT)
        # the last estimates were delivered before the answer, but wait to be taken
        end = time.monotonic() + _LAST
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.01)
        if self._record is not None:
            self._call("recorder", self._stop_recording, StopRecording.Request(), timeout=_FINISH_TIMEOUT)

    def _stop(self) -> None:
        """Ask the nodes to end, wait for them, and kill those that do not."""
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

    def _failure(self, children: Collection[Child]) -> Exception:
        """Return the error why nodes ended; a fault that a node names takes precedence."""
        ranks = (ExitCode.BAD_INPUT, ExitCode.FAULT)
        first = min(children, key=lambda c: (*ranks, c.process.returncode).index(c.process.returncode))
        # how a single node ended is told by the message
        heads = [f"{c.name}: {c.ending}\n" if len(children) > 1 else "" for c in children]
        report = "\n".join(head + c.last_words for head, c in zip(heads, children, strict=True))
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
        if self._realtime or "plant" not in self._names:
            samples, missing = found.integrity.samples, found.integrity.missing
            needed = round(plan.duration / self._bench.sample_period)
            if missing:
                raise GraphError(
                    "samples_lost", f"{self._record}: {missing} of {samples + missing} samples are missing"
                )
            if samples < needed:
                raise GraphError(
                    "samples_lost",
                    f"{self._record}: {samples} samples recorded, but the plan takes {needed}: those of its end are "
                    "missing",
                )
            return dict(found.topics), samples
        end_ns = round(plan.duration * 1e9)
        end_ns += -end_ns % _CLOCK_PERIOD_NS
        published = end_ns // round(self._bench.sample_period * 1e9) + 1
        if found.integrity.samples != published:
            raise GraphError(
                "samples_lost",
                f"{self._record}: {found.integrity.samples} samples recorded of {published} published",
            )
        return dict(found.topics), found.integrity.samples

    def _check_publishers(self) -> None:
        """Raise if nodes that are not of this graph have published what the bench lives by.

        The nodes watch the topics that they read all along; here only what was found is judged.
        """
        if found := self._others.text():
            kept = "" if self._record is None else f"; the recording {self._record} is kept"
            raise GraphError("strangers", f"{found}; what the bench did is not the plan alone{kept}")

    def _checked(self, plan: Plan | str | Path) -> Plan:
        result = plan if isinstance(plan, Plan) else Plan.load(plan)
        result.check(self._bench)
        wanted = float(str(self._parameters.get("conductor", {}).get("tilt_limit", 0.0)))
        plan_tilt_limit(result, self._bench, tilt_limit(self._bench, wanted, "parameter tilt_limit"))
        return result

    def _pace(self) -> dict[str, float]:
        if not self._realtime:
            return {}
        values = self._values.get("plant", {})
        return {name: float(values[name]) for name in _PACE if name in values}
