"""What the tools of ROS find: launch files, the model of the wheel, layouts, package lists, a colcon workspace."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import re
import runpy
import subprocess
import sys
import tomllib
import types
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gyrowheel_bringup.graph import EXECUTABLES, Graph, find_executable, node_parameters
from gyrowheel_bringup.graph.launch import require_known, typed
from gyrowheel_bringup.viewers import robot_description, rviz_config, share_file
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import PARENT_VARIABLE
from gyrowheel_core.topics import JOINTS
from gyrowheel_core.units import DEG
from gyrowheel_recording.bags.columns import typestore
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.mechanics.kinematics import axis_of_tilt
from gyrowheel_sim.plant.scenario import Scenario

from ..domains import next_domain
from .helpers import SHORT_PLAN, Bystander, wait_for

ROOT = Path(__file__).resolve().parents[2]
SRC = ROOT / "src"
PACKAGES = sorted(path.parent.name for path in SRC.glob("*/package.xml"))
NODES = {
    "gyrowheel_sim": {"plant_node"},
    "gyrowheel_control": {"controller_node", "conductor_node", "joint_commands_node"},
    "gyrowheel_recording": {"bridge_node", "recorder_node", "replay_node"},
    "gyrowheel_analysis": {"drag_estimator_node"},
    "gyrowheel_bringup": {"foxglove_node", "plan_client_node"},
}

# --- launch files; ros2 launch is not on PyPI: its few classes are stood in for


class Stub:
    """Keeps what it was made with."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.args = args
        self.options = options


class Context:
    """The values of launch arguments."""

    def __init__(self, values: dict[str, str], pushed: str = "") -> None:
        self.values = values
        # that of a launch file which includes this one in a namespace
        self.launch_configurations = {"ros_namespace": pushed} if pushed else {}


class Configuration(Stub):
    def perform(self, context: Context) -> str:
        return context.values[self.args[0]]


@pytest.fixture
def stubs(monkeypatch: pytest.MonkeyPatch) -> None:
    classes: dict[str, dict[str, type]] = {
        "launch": {"LaunchContext": Context, "LaunchDescription": Stub},
        "launch.actions": {
            name: type(name, (Stub,), {})
            for name in ("DeclareLaunchArgument", "ExecuteProcess", "OpaqueFunction", "Shutdown")
        },
        "launch.substitutions": {"LaunchConfiguration": Configuration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": type("Node", (Stub,), {})},
        "launch_ros.parameter_descriptions": {"ParameterValue": type("ParameterValue", (Stub,), {})},
    }
    for name, content in classes.items():
        module = types.ModuleType(name)
        for key, value in content.items():
            setattr(module, key, value)
        monkeypatch.setitem(sys.modules, name, module)


def launched(name: str, *, pushed: str = "", **given: str) -> list[Any]:
    """Return the actions of a launch file with these arguments, included in a namespace."""
    description = runpy.run_path(str(SRC / "gyrowheel_bringup" / "launch" / name))[
        "generate_launch_description"
    ]()
    *arguments, opaque = description.args[0]
    values = {argument.args[0]: argument.options["default_value"] for argument in arguments}
    assert all(argument.options["description"] for argument in arguments)
    assert set(given) <= set(values)
    return list(opaque.options["function"](Context(values | given, pushed)))


def parameters_of(action: Any) -> dict[str, Any]:
    """Return the parameters of a node as the node gets them."""
    others = {key: value for given in action.options.get("parameters", []) for key, value in given.items()}
    rules = action.options.get("ros_arguments", [])
    assert set(rules[::2]) <= {"-p"}
    texts = dict(rule.split(":=", 1) for rule in rules[1::2])
    given = others | {key: json.loads(text) for key, text in texts.items()}
    return {key: value.args[0] if isinstance(value, Stub) else value for key, value in given.items()}


@pytest.fixture
def viewers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs of other packages, which only an installed ROS has."""
    for name in ("robot_state_publisher", "rviz2"):
        program = tmp_path / "lib" / name / name
        program.parent.mkdir(parents=True)
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}:{os.environ.get('AMENT_PREFIX_PATH', '')}")


@pytest.mark.graph
@pytest.mark.usefixtures("stubs", "viewers")
@pytest.mark.parametrize("realtime", [True, False])
def test_launch_of_the_bench_starts_what_up_starts(realtime: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(next_domain()))
    plan = Plan.load("quick")
    actions = launched(
        "ground_test.launch.py", plan="quick", record="runs/monday", realtime=str(realtime), rviz="true"
    )
    nodes = {action.options["executable"]: action for action in actions}
    machine = Scenario().identity(Bench.load())
    wanted = node_parameters(plan, record="runs/monday", realtime=realtime, machine=machine)
    for name, (package, executable) in EXECUTABLES.items():
        node = nodes.pop(executable)
        assert (node.options["package"], node.options["name"]) == (package, name)
        assert parameters_of(node) == wanted[name]
        # it ends with the process of the launch
        assert node.options["additional_env"] == {PARENT_VARIABLE: str(os.getpid())}
    assert set(nodes) == {"robot_state_publisher", "rviz2", "plan_client_node"}
    assert parameters_of(nodes["robot_state_publisher"])["robot_description"] == robot_description()
    # in real time nobody publishes a clock
    assert {parameters_of(nodes[name])["use_sim_time"] for name in ("robot_state_publisher", "rviz2")} == {
        not realtime
    }
    assert parameters_of(nodes["plan_client_node"]) == {"plan": "quick"}


def test_a_misspelt_argument_of_a_launch_file_is_refused() -> None:
    require_known(["plan", "ros_namespace", "camera_rate"], ["plan", "record", "namespace"])
    assert typed(SimpleNamespace(argv=["plann:=quick", "--debug"])) == ["plann"]
    assert typed(SimpleNamespace()) == []
    with pytest.raises(InputError, match=r"^plann: no such argument; did you mean plan\?$"):
        require_known(["plann"], ["plan", "record"])


@pytest.mark.graph
@pytest.mark.usefixtures("stubs")
def test_launch_refuses_before_anything_starts(
    domain: int, bystander: Bystander, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    with pytest.raises(InputError, match="no such shipped plan"):
        launched("ground_test.launch.py", plan="quik")
    # a misspelt word must not start the other bench
    with pytest.raises(InputError, match=r"^realtime: 'ture' is not allowed; allowed: true, false$"):
        launched("ground_test.launch.py", realtime="ture")
    with pytest.raises(InputError, match="exists; a recording needs a new directory"):
        launched("ground_test.launch.py", record=str(SRC))
    wide = SHORT_PLAN.replace("[1.0, 0.5]", "[3.5, 0.5]")
    with pytest.raises(InputError, match=r"is beyond the tilt limit of 3\.00 deg"):
        launched("ground_test.launch.py", plan=wide)
    with pytest.raises(
        InputError, match=r"'robot_state_publisher' is not installed.*; allowed: viewable:=false"
    ):
        launched("ground_test.launch.py")
    other = rclpy.create_node("plant", context=bystander.context, use_global_arguments=False)
    refused = rf"ROS domain {domain} has a bench already \(nodes plant\): end it, or choose another namespace"

    def refusal() -> str:
        try:
            launched("ground_test.launch.py", viewable="false")
        except InputError as error:
            return str(error)
        return ""  # it was not heard of yet

    assert re.search(refused, wait_for(refusal))
    with pytest.raises(InputError, match=r"^without: 'camera': no such node; allowed: plant, controller, "):
        launched("ground_test.launch.py", without="camera")
    # one of somebody's own has its name
    mine = launched("ground_test.launch.py", viewable="false", without="plant, recorder")
    assert [action.options["name"] for action in mine] == ["controller", "conductor", "drag_estimator"]
    other.destroy_node()
    assert [
        action.options["executable"] for action in launched("ground_test.launch.py", viewable="false")
    ] == [exe for _, exe in EXECUTABLES.values()]


@pytest.mark.study  # test_graph.py runs the same nodes
@pytest.mark.graph
def test_the_client_of_a_launch_walks_a_plan_and_ends_with_it(domain: int, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(SHORT_PLAN)

    def client(plan: Path | str) -> subprocess.CompletedProcess[str]:
        node = find_executable("gyrowheel_bringup", "plan_client_node")
        return subprocess.run(
            [str(node), "--ros-args", "-p", f"plan:={plan}"],
            env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
            capture_output=True,
            text=True,
            check=False,
        )

    spin = Plan.load(SHORT_PLAN).initial_spin_rate
    without = ["drag_estimator", "recorder"]
    with Graph(domain_id=domain, hold_after_plan=False, initial_spin_rate=spin, without=without):
        said = [client(plan)]
    said.append(client("quick@rig=upside"))
    assert [answer.returncode for answer in said] == [0, 2]
    assert "segment 2 of 4: tilted" in said[0].stderr
    assert "completed" in said[0].stderr.splitlines()[-1]
    assert "segments:" not in said[0].stderr  # the plan itself is not in the log


@pytest.mark.usefixtures("stubs", "viewers")
def test_launch_of_a_replay_has_parameters_that_the_node_takes() -> None:
    from gyrowheel_recording.nodes.replay import ReplayNode

    actions = launched("replay.launch.py", recording="runs/monday", rate="0", estimate="true")
    assert [action.options["executable"] for action in actions] == [
        "replay_node",
        "drag_estimator_node",
        "robot_state_publisher",
    ]
    known = {param.name: param for param in ReplayNode.PARAMETERS}
    found = parameters_of(actions[0])
    assert found["directory"] == "runs/monday"
    for name, value in found.items():
        known[name].check(value)
    # they end with the process of the launch
    assert {actions[k].options["additional_env"][PARENT_VARIABLE] for k in (0, 1)} == {str(os.getpid())}


@pytest.mark.usefixtures("stubs")
def test_launch_of_a_replay_refuses_before_anything_starts() -> None:
    with pytest.raises(InputError, match=r"^rate: 'slow' is not allowed; allowed: a number$"):
        launched("replay.launch.py", recording="runs/monday", rate="slow")
    with pytest.raises(InputError, match=r"^loop: 'ture' is not allowed; allowed: true, false$"):
        launched("replay.launch.py", recording="runs/monday", loop="ture")
    with pytest.raises(
        InputError, match=r"'robot_state_publisher' is not installed.*; allowed: viewable:=false"
    ):
        launched("replay.launch.py", recording="runs/monday")


@pytest.mark.usefixtures("stubs", "viewers")
@pytest.mark.parametrize(
    ("given", "pushed", "wanted"),
    [
        ("", "", ""),
        ("bench2", "", "/bench2"),
        ("", "/lab", "/lab"),
        ("bench2", "/lab", "/lab/bench2"),
        ("/bench2", "/lab", "/bench2"),
        ("", "/", ""),
    ],
)
def test_launch_files_go_along_with_the_namespace_that_they_are_included_in(
    given: str, pushed: str, wanted: str
) -> None:
    actions = launched("replay.launch.py", pushed=pushed, recording="runs/monday", namespace=given)
    assert {action.options["namespace"] for action in actions} == {wanted}
    names = actions[-1].options["remappings"]
    assert (("/tf", f"{wanted}/tf") in names) == bool(wanted)


# --- the model of the wheel

URDF = ET.fromstring(robot_description())


def test_the_model_has_the_joints_of_joint_states_and_one_tree() -> None:
    joints = {joint.get("name"): joint for joint in URDF.findall("joint")}
    links = [link.get("name") for link in URDF.findall("link")]
    assert {"case", "motor", "gimbal", "rotor"} <= set(links)
    moving = {
        name for name, joint in joints.items() if joint.get("type") != "fixed" and joint.find("mimic") is None
    }
    assert moving == set(JOINTS)
    mimics = [element.get("joint") for joint in joints.values() for element in joint.findall("mimic")]
    assert set(mimics) <= set(JOINTS)
    ends = [(joint.find("parent").get("link"), joint.find("child").get("link")) for joint in joints.values()]  # type: ignore[union-attr]
    children = [child for _, child in ends]
    assert len(children) == len(set(children))
    assert set(links) - set(children) == {"case"}  # the one root
    assert {parent for parent, _ in ends} <= set(links)
    used = {m.get("name") for m in URDF.iter("material")}
    assert used == {m.get("name") for m in URDF.findall("material")}


def turn(axis: str, angle: float) -> NDArray[np.float64]:
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    result = np.eye(3)
    result[i, i] = result[j, j] = np.cos(angle)
    result[i, j], result[j, i] = -np.sin(angle), np.sin(angle)
    return result


@given(st.floats(-4 * DEG, 4 * DEG), st.floats(-4 * DEG, 4 * DEG), st.floats(0.0, 6.28))
def test_the_rotor_of_the_model_points_where_the_sensors_say(x: float, y: float, spin: float) -> None:
    values = dict(zip(JOINTS, (x, y, spin), strict=True))
    by_child = {joint.find("child").get("link"): joint for joint in URDF.findall("joint")}  # type: ignore[union-attr]
    chain, link = [], "rotor"
    while link in by_child:
        chain.append(by_child[link])
        link = str(by_child[link].find("parent").get("link"))  # type: ignore[union-attr]
    rotation = np.eye(3)
    for joint in reversed(chain):
        axis = "xyz"[[float(v) for v in joint.find("axis").get("xyz").split()].index(1.0)]  # type: ignore[union-attr]
        rotation = rotation @ turn(axis, values[str(joint.get("name"))])
    off = np.arccos(np.clip(rotation[:, 2] @ axis_of_tilt(x, y), -1.0, 1.0))
    assert off < 0.012 * DEG


# --- layouts


TYPES = {topic.name: topic.type_name for topic in topics.TOPICS}


def is_field(path: str) -> bool:
    topic = max((name for name in TYPES if path.startswith(name)), key=len, default="")
    rest = path[len(topic) + 1 :]
    names = {name for name, _ in typestore().fielddefs[TYPES[topic]][1]} if topic else set()
    return re.sub(r"\[[0-2]\]$", "", rest) in names


def test_layouts_show_what_there_is() -> None:
    layout = json.loads(share_file("config/foxglove_layout.json").read_text())
    paths = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", [])]
    curves = ET.fromstring(share_file("config/plotjuggler_layout.xml").read_bytes()).iter("curve")
    paths += [str(curve.get("name")) for curve in curves]
    assert len(paths) > 20
    assert [path for path in paths if not is_field(path)] == []

    def panels(place: Any) -> Iterator[str]:
        if isinstance(place, str):
            yield place
        else:
            yield from itertools.chain(panels(place["first"]), panels(place["second"]))

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    rviz = yaml.safe_load(rviz_config().read_text())
    assert rviz["Visualization Manager"]["Global Options"]["Fixed Frame"] == "case"


# --- package lists


def test_pip_and_colcon_install_the_same_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """What hatchling puts below the prefix is what setup.py does."""
    setuptools = importlib.import_module("setuptools")
    for package in PACKAGES:
        folder = SRC / package
        if not (folder / "setup.py").exists():
            continue
        table = tomllib.loads((folder / "pyproject.toml").read_text())
        shared = table["tool"]["hatch"]["build"]["targets"]["wheel"]["shared-data"]
        wanted: dict[str, str] = {}
        for source, target in shared.items():
            path = folder / source
            files = sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]
            for file in files:
                wanted[str(file.relative_to(folder))] = target if path.is_dir() else str(Path(target).parent)
        caught: dict[str, Any] = {}
        monkeypatch.setattr(setuptools, "setup", lambda caught=caught, **options: caught.update(options))
        monkeypatch.chdir(folder)
        runpy.run_path(str(folder / "setup.py"))
        found = {file: place for place, files in caught["data_files"] for file in files}
        assert found == wanted, package
        assert caught["version"] == table["project"]["version"]


@pytest.mark.parametrize(("package", "node"), [(p, n) for p, nodes in NODES.items() for n in sorted(nodes)])
def test_every_node_has_its_executable(package: str, node: str) -> None:
    script = SRC / package / "scripts" / node
    assert os.access(script, os.X_OK)
    module = re.search(r"-m gyrowheel_core.start_node (\S+) ", script.read_text())
    assert module is not None
    assert module[1].startswith(f"{package}.")
    assert importlib.util.find_spec(module[1]) is not None
    assert {path.name for path in (SRC / package / "scripts").iterdir()} == NODES[package]


# --- colcon
