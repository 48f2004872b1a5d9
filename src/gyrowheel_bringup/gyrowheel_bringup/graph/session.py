"""A session of the graph, as a context manager: starts the nodes, runs plans, ends the nodes."""

from __future__ import annotations

import contextlib
import shutil
import signal
import tempfile
import threading
import time
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Self

from gyrowheel_analysis.model import Model
from gyrowheel_bringup.graph.link import Link
from gyrowheel_bringup.graph.nodes import EXECUTABLES, node_parameters
from gyrowheel_bringup.graph.processes import Processes, share_core
from gyrowheel_bringup.graph.results import GraphError, GraphResult, Progress, counted
from gyrowheel_bringup.graph.shared_memory import remove_dead, remove_left
from gyrowheel_control.loops.supervision import plan_tilt_limit, tilt_limit
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import namespaces
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import prepare_environment
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario

_LISTEN = 4.0  # time to listen for nodes of another graph [s]
_PACE = (
    "late_commands", "missing_commands", "held_samples", "late_samples", "displaced_samples",
    "worst_delay_ms", "behind_s",
)  # fmt: skip


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
    namespace : str
        Namespace of the nodes, such as ``/bench2``; empty: the root. Benches in different namespaces share a domain.
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
        namespace: str = "",
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
        self._bench_source = str(bench if str(bench) in Bench.shipped() else Path(bench).absolute())
        self._initial_spin_rate = initial_spin_rate
        self._hold = hold_after_plan
        self._remap = {name: dict(names) for name, names in (remap or {}).items()}
        self._realtime = realtime
        self._domain_id = domain_id
        self._namespace = namespaces.checked(namespace)
        self._names = [name for name in EXECUTABLES if name not in without]
        self._show_logs = show_logs
        self._start_timeout = start_timeout
        self._stall_timeout = stall_timeout
        self._on_trouble = on_trouble
        self._processes: Processes | None = None
        self._link: Link | None = None
        self._pids: dict[str, int] = {}
        self._cleanup = contextlib.ExitStack()

    # ---- life

    def __enter__(self) -> Self:
        """Start the nodes and wait until they are active."""
        try:
            self._start()
        except BaseException:
            with contextlib.suppress(GraphError, InputError):  # the first error is the cause
                self.close()
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
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
        processes, link = self._processes, self._link
        if processes is None or link is None or not processes.children:
            self._cleanup.close()
            return
        with _uninterrupted():
            left: set[str] = set()
            try:
                if not link.strangers:  # which would answer too
                    if self._realtime:
                        link.wind_down()
                    link.settle(recorded=self._record is not None)
                processes.stop()
                error = processes.failure()
            finally:
                left = processes.clear()
                self._cleanup.close()
                remove_left(left)
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
        link = self._started()
        link.require_active(recorded=self._record is not None and "recorder" in self._names)
        begin = time.monotonic()
        known = len(link.estimates)
        result = link.run(chosen, progress, stall_timeout=self._stall_timeout)
        wall = time.monotonic() - begin
        counts: dict[str, int] = {}
        samples = 0
        if not self._hold:
            if self._record is not None and "plant" not in self._names:
                link.await_samples(round(chosen.duration / self._bench.sample_period))
            self.close()
            if self._record is not None:
                exactly = not self._realtime and "plant" in self._names
                counts, samples = counted(self._record, chosen, self._bench.sample_period, exactly=exactly)
        self._check_publishers(link)
        return GraphResult(
            plan=chosen.name,
            segments=result.segments,
            simulated_seconds=result.duration,
            wall_seconds=wall,
            recording=self._record,
            samples=samples,
            counts=counts,
            pids=self.pids,
            pace=self._pace(link),
            estimates=tuple(link.estimates[known:]),
        )

    def wait(self) -> None:
        """Let the graph run until a node ends.

        Raises
        ------
        GraphError, InputError
            The reason why it ended.
        """
        link = self._started()
        while True:
            link.spin()

    # ---- starting

    def _start(self) -> None:
        prepare_environment()
        remove_dead()
        work = Path(tempfile.mkdtemp(prefix="gyrowheel-"))
        self._cleanup.callback(shutil.rmtree, work, ignore_errors=True)
        domain, namespace = self._domain_id, self._namespace
        self._processes = processes = Processes(
            work, domain_id=domain, namespace=namespace, show_logs=self._show_logs
        )
        self._link = link = Link(
            self._names,
            processes,
            domain_id=domain,
            namespace=namespace,
            renamed=bool(self._remap),
            on_trouble=self._on_trouble,
        )
        self._cleanup.callback(link.close)
        parameters = self._node_parameters(work)
        self._pids = processes.start({name: parameters[name] for name in self._names}, self._remap)
        self._wait_until_active(link)

    def _started(self) -> Link:
        """Return the node of this process; InputError if the graph was not started."""
        if self._link is None:
            raise InputError("graph: not started; it is a context manager: with Graph(...) as graph")
        return self._link

    def _machine(self) -> str:
        """Return the name of the machine, which reveals nothing about it."""
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
        if self._initial_spin_rate is not None:
            result["plant"]["initial_spin_rate"] = float(self._initial_spin_rate)
        for name, values in self._parameters.items():
            result[name] |= values
        return result

    def _wait_until_active(self, link: Link) -> None:
        began = time.monotonic()
        deadline = began + self._start_timeout
        while True:
            waiting = [name for name in self._names if name not in link.active]
            # nodes of another graph show in their status, once a second, and in their names, which may come sooner:
            # listen for a while before the namespace counts as free
            if not waiting and time.monotonic() - began > _LISTEN:
                link.starting = False
                link.await_names()
                if found := link.others():
                    raise GraphError(
                        "strangers", f"{found}: end those nodes, or choose another domain or namespace"
                    )
                share_core(self._pids, link.domain + zlib.crc32(self._namespace.encode()))
                return
            link.spin()
            link.look_for_strangers()
            if link.strangers:
                name = min(link.strangers)
                where = f", namespace {self._namespace}" if self._namespace else ""
                raise GraphError(
                    "domain_in_use",
                    f"the ROS domain has another node '{name}' (process {link.strangers[name]}{where}): "
                    "end that graph, or choose another domain or namespace",
                )
            if time.monotonic() > deadline:
                raise GraphError(
                    "start_timeout", f"not active after {self._start_timeout:g} s ({link.states(waiting)})"
                )

    # ---- judging

    def _check_publishers(self, link: Link) -> None:
        """Raise if foreign nodes have published on the topics of the bench.

        The nodes watch the topics that they read; here only their findings are judged.
        """
        if found := link.others():
            kept = "" if self._record is None else f"; the recording {self._record} is kept"
            raise GraphError("strangers", f"{found}; what the bench did is not the plan alone{kept}")

    def _checked(self, plan: Plan | str | Path) -> Plan:
        result = plan_for(plan, self._bench)
        wanted = float(str(self._parameters.get("conductor", {}).get("tilt_limit", 0.0)))
        plan_tilt_limit(result, self._bench, tilt_limit(self._bench, wanted, "parameter tilt_limit"))
        return result

    def _pace(self, link: Link) -> dict[str, float]:
        if not self._realtime:
            return {}
        values = link.values.get("plant", {})
        return {name: float(values[name]) for name in _PACE if name in values}


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Block every signal except SIGKILL; only the main thread gets signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {n: signal.signal(n, signal.SIG_IGN) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
