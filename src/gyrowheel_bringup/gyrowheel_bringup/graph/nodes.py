"""The nodes of the graph: executables, parameters with which they work together, and parameter files."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NoReturn

import yaml

from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import prepare_environment
from gyrowheel_sim.environment import to_json

#: Package and executable of each node, by the node's name.
EXECUTABLES: Mapping[str, tuple[str, str]] = {
    "plant": ("gyrowheel_sim", "plant_node"),
    "controller": ("gyrowheel_control", "controller_node"),
    "conductor": ("gyrowheel_control", "conductor_node"),
    "recorder": ("gyrowheel_recording", "recorder_node"),
    "drag_estimator": ("gyrowheel_analysis", "drag_estimator_node"),
}
#: Module of each node, which its executable runs.
MODULES: Mapping[str, str] = {
    "plant": "gyrowheel_sim.plant.node",
    "controller": "gyrowheel_control.nodes.controller",
    "conductor": "gyrowheel_control.nodes.conductor",
    "recorder": "gyrowheel_recording.nodes.recorder",
    "drag_estimator": "gyrowheel_analysis.nodes.drag_estimator",
}
#: What they share, imported by their launcher.
SHARED_MODULE = "gyrowheel_bringup.preload"

#: Priority of the nodes of the loop in real time, where the system allows it.
REALTIME_PRIORITY = 10
#: Priority of those that only listen, above that of other work on the computer: one that falls behind requests its
#: messages again and again, and the loop spends its time on sending them.
LISTENER_PRIORITY = 5
#: Time by which the setpoints precede their samples [s].
LOCKSTEP_LEAD, REALTIME_LEAD = 0.5, 1.0


def node_parameters(
    plan: Plan | None,
    *,
    bench: str = "gyrowheel",
    scenario: str = "",
    model: str = "",
    record: str = "",
    hold_after_plan: bool = True,
    realtime: bool = False,
    nodes: Collection[str] = tuple(EXECUTABLES),
    machine: str = "",
) -> dict[str, dict[str, object]]:
    """Return the parameters with which the nodes run a plan together: {node: {parameter: value}}.

    Every node waits for its subscribers, so that no sample is lost.

    Parameters
    ----------
    plan : Plan or None
        The bench starts at the plan's initial spin rate and environment; without a plan at rest and upright.
    bench : str
        Name of a shipped bench, or path of a bench file.
    scenario, record : str
        Scenario file of the true machine, and directory to record into; empty: none.
    model : str
        File of the model that the drag estimator believes; empty: the bench without effects.
    hold_after_plan : bool
        Whether the bench keeps running after the plan; in real time the loop stays closed until the plant stops.
    realtime : bool
        Whether the plant runs in wall-clock time instead of lock-step.
    nodes : collection of str
        The nodes that take part.
    machine : str
        Name of the machine in its recordings; empty: unknown.
    """
    events = [] if plan is None else [event for event in plan.environment() if event.time == 0.0]
    priority, of_listeners = (REALTIME_PRIORITY, LISTENER_PRIORITY) if realtime else (0, 0)
    recorders = int("recorder" in nodes and bool(record))
    estimators = int("drag_estimator" in nodes)
    return {
        "plant": {
            "bench": bench,
            "clock": "realtime" if realtime else "lockstep",
            "priority": priority,
            "scenario_file": scenario and str(Path(scenario).absolute()),
            "environment": to_json(events) if events else "",
            "initial_spin_rate": 0.0 if plan is None else float(plan.initial_spin_rate),
            "wait_for_subscribers": 1 + recorders + estimators,
        },
        "controller": {"bench": bench, "wait_for_subscribers": 1 + recorders, "priority": priority},
        "conductor": {
            "bench": bench,
            "machine": machine,
            "hold_after_plan": hold_after_plan or realtime,
            "lead": REALTIME_LEAD if realtime else LOCKSTEP_LEAD,
            "priority": priority,
            "wait_for_subscribers": 1 + recorders + estimators,
            # a user-defined controller has no limit to be set
            **({} if "controller" in nodes else {"controller": "none"}),
        },
        "recorder": {"directory": record, "priority": of_listeners},
        "drag_estimator": {
            "bench": bench,
            "model": model and str(Path(model).absolute()),
            "wait_for_subscribers": recorders,
            "priority": of_listeners,
        },
    }


class _Dumper(yaml.SafeDumper):
    """Writes every text in quotes: without them ROS reads 3e32 as a number, this library as a text."""


_Dumper.add_representer(
    str, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"')
)


def write_parameters(file: Path, parameters: Mapping[str, object], node: str = "/**") -> None:
    """Write parameters into a file for ``--params-file``.

    `parameters`: values by name; each has the type in the node that it has here. `node`: full name of the
    node that they are for.
    """
    content = {node: {"ros__parameters": dict(parameters)}}
    file.write_text(yaml.dump(content, Dumper=_Dumper), encoding="utf-8")


def text_rule(name: str, text: str) -> str:
    """Return the argument of ``-p`` for a parameter that is a text, whatever it looks like."""
    return f"{name}:={json.dumps(text, ensure_ascii=False)}"


#: Arguments of a launch file that do without a viewer's package.
_INSTEAD = {"robot_state_publisher": "viewable:=false", "rviz2": "rviz:=false"}


def find_executable(package: str, executable: str) -> Path:
    """Return the path of a node's executable.

    Searches the environment of this Python first, then the prefixes of ``AMENT_PREFIX_PATH``.

    Raises
    ------
    InputError
        If there is none.
    """
    for prefix in _prefixes():
        path = prefix / "lib" / package / executable
        if _is_executable(path):
            return path
    there = executables().get(package)
    if there:
        raise InputError(f"package {package} has no executable '{executable}'; it has: {', '.join(there)}")
    instead = f"; allowed: {_INSTEAD[package]}" if package in _INSTEAD else ""
    raise InputError(f"package '{package}' is not installed, or has no executables{instead}")


def executables() -> dict[str, list[str]]:
    """Return the executables of every package that `find_executable` finds, by package."""
    found: dict[str, set[str]] = {}
    for prefix in _prefixes():
        for marker in (prefix / "share" / "ament_index" / "resource_index" / "packages").glob("*"):
            for path in (prefix / "lib" / marker.name).glob("*"):
                if _is_executable(path):
                    found.setdefault(marker.name, set()).add(path.name)
    return {package: sorted(found[package]) for package in sorted(found)}


def _prefixes() -> list[Path]:
    """Return where packages may be installed: this Python's environment, then those of ``AMENT_PREFIX_PATH``."""
    others = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    return [Path(prefix) for prefix in (sys.prefix, *others)]


def _is_executable(path: Path) -> bool:
    return path.is_file() and os.access(path, os.X_OK)


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
