"""Sessions of nodes that talk over ROS: the bench running a plan, the replay of a recording, a viewer."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from gyrowheel.models.api import Model
from gyrowheel.simulation.scenario import scenario, simulated_bench
from gyrowheel_bringup.foxglove_process import foxglove
from gyrowheel_bringup.graph import (
    Graph,
    GraphError,
    GraphResult,
    Progress,
    executables,
    find_executable,
    run_executable,
)
from gyrowheel_bringup.graph.plan_client import run_and_record
from gyrowheel_bringup.replay_session import Outcome, play
from gyrowheel_bringup.viewers import foxglove_layout, share_file
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import require_new
from gyrowheel_recording.bags.playback import Tape
from gyrowheel_recording.bags.read_bag import read_bag
from gyrowheel_recording.bags.selection import bench_in
from gyrowheel_recording.nodes.replay import ReplayNode as Playing

__all__ = [
    "Graph",
    "GraphError",
    "GraphResult",
    "Outcome",
    "Playing",
    "Progress",
    "Tape",
    "executables",
    "find_executable",
    "foxglove",
    "foxglove_layout",
    "play",
    "run_and_record",
    "run_executable",
    "share_file",
    "tape",
    "up",
]


def up(
    plan: str | Path | Plan | None = None,
    *,
    effects: Sequence[str] = (),
    truth: Model | None = None,
    model: Model | None = None,
    bench: str | Path | None = None,
    machine: int | None = None,
    seed: int = 0,
    blind: str | Path | None = None,
    record: str | Path | None = None,
    realtime: bool = False,
    without_nodes: Sequence[str] = (),
    domain: int | None = None,
    namespace: str = "",
    logs: bool = False,
    on_trouble: Callable[[str, str], None] | None = None,
) -> Graph:
    """Return the bench as a graph of nodes, which ``with`` starts and ends.

    The nodes are plant, controller, conductor, drag estimator and recorder, a process each.

    Parameters
    ----------
    plan : str, Path or Plan, optional
        Test plan that `Graph.run` walks; without one the bench runs at its reference speed until it is ended.
    effects, truth, bench, machine, seed, blind
        The simulated machine; see `gyrowheel.simulate`.
    model : Model, optional
        The model that the drag estimator believes; by default the bench without effects.
    record : str or Path, optional
        New directory for a recording.
    realtime : bool
        Pace the bench by wall-clock time instead of as fast as possible.
    without_nodes : sequence of str
        Nodes that are not started, because the user's own replace them.
    domain : int, optional
        ROS domain, 0 .. 101; by default that of the environment.
    namespace : str
        Namespace of the nodes, such as ``/bench2``; empty: the root. Benches in different namespaces share a domain.
    logs : bool
        Show the logs of the nodes.
    on_trouble : callable, optional
        Called with a node and its problem.

    Raises
    ------
    InputError
        If a name is unknown, a value out of range, or the directory is not new.
    """
    real, belief = (None if given is None else given.details for given in (truth, model))
    source, loaded = simulated_bench(bench, real, belief)
    chosen = None if plan is None else plan_for(plan, loaded)
    if record is not None:
        require_new(Path(record))
    hidden = scenario(
        loaded,
        "" if chosen is None else chosen.name,
        effects=effects,
        truth=real,
        blind=None if blind is None else Path(blind),
        seed=seed,
        machine=machine,
    )
    return Graph(
        chosen,
        bench=source,
        scenario=hidden,
        model=belief,
        record=record,
        hold_after_plan=chosen is None,
        realtime=realtime,
        without=without_nodes,
        domain_id=domain,
        namespace=namespace,
        show_logs=logs,
        on_trouble=on_trouble,
        initial_spin_rate=loaded.value("spin_rate_reference") if chosen is None else None,
    )


def tape(
    recording: str | Path,
    *,
    only: Sequence[str] = (),
    without: Sequence[str] = (),
    start: float = 0.0,
    end: float = math.inf,
    estimate: bool = False,
) -> Tape:
    """Return a recording opened for `play`, which closes it.

    `only` and `without` are topics to publish (all if empty) and to leave out, `start` and `end` the time span from the
    first sample [s]. With `estimate` the drag estimator runs at the same time, and recorded estimates are left out.
    InputError if the recording cannot be read, or the estimator would get no measurements.
    """
    place, left_out = Path(recording), list(without)
    if estimate:
        recorded = {name: data.count for name, data in read_bag(place, {}).items() if data.count}
        name = topics.DRAG_ESTIMATE.within(bench_in(recorded, str(place)))
        wanted = not only or name in only or topics.DRAG_ESTIMATE.name in only
        if wanted and name in recorded and not {name, topics.DRAG_ESTIMATE.name} & set(left_out):
            left_out.append(name)
    opened = Tape(place, only=only, without=left_out, start=start, end=end)
    if estimate and topics.MEASUREMENT not in opened.topics:
        opened.close()
        raise InputError(f"{place}: estimate needs {topics.MEASUREMENT.name}, which is not replayed")
    return opened
