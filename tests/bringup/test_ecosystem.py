"""What the tools of ROS find: launch files, the model of the wheel, layouts, package lists, a colcon workspace."""

from __future__ import annotations

import base64
import importlib.util
import itertools
import json
import os
import re
import runpy
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tomllib
import types
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gyrowheel.simulation import record_simulation
from gyrowheel_analysis.recording.definitions import typestore
from gyrowheel_bringup.graph import EXECUTABLES, node_parameters
from gyrowheel_bringup.viewers import robot_description, rviz_config, share_file
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.mechanics.kinematics import axis_of_tilt
from gyrowheel_sim.plant.node import JOINTS
from gyrowheel_sim.plant.scenario import Scenario

from ..domains import next_domain
from .helpers import SHORT_PLAN

ROOT = Path(__file__).resolve().parents[2]
SRC = ROOT / "src"
PACKAGES = sorted(path.parent.name for path in SRC.glob("*/package.xml"))
NODES = {
    "gyrowheel_sim": {"plant_node"},
    "gyrowheel_control": {"controller_node", "conductor_node"},
    "gyrowheel_analysis": {"drag_estimator_node", "recorder_node", "replay_node"},
    "gyrowheel_bringup": {"foxglove_node"},
}

# --- launch files; ros2 launch is not on PyPI: its few classes are stood in for


class Stub:
    """Keeps what it was made with."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.args = args
        self.options = options


class Context:
    """The values of launch arguments."""

    def __init__(self, values: dict[str, str]) -> None:
        self.values = values


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


def launched(name: str, **given: str) -> list[Any]:
    """Return the actions of a launch file with these arguments."""
    description = runpy.run_path(str(SRC / "gyrowheel_bringup" / "launch" / name))[
        "generate_launch_description"
    ]()
    *arguments, opaque = description.args[0]
    values = {argument.args[0]: argument.options["default_value"] for argument in arguments}
    assert all(argument.options["description"] for argument in arguments)
    assert set(given) <= set(values)
    return list(opaque.options["function"](Context(values | given)))


def parameters_of(action: Any) -> dict[str, Any]:
    """Return the parameters of a node as the node gets them."""
    (given,) = action.options.get("parameters", [{}])
    return {key: value.args[0] if isinstance(value, Stub) else value for key, value in given.items()}


@pytest.mark.usefixtures("stubs")
def test_launch_of_the_bench_starts_what_up_starts() -> None:
    plan = Plan.load("quick")
    actions = launched(
        "ground_test.launch.py", plan="quick", record="runs/monday", realtime="true", rviz="true"
    )
    nodes = {action.options["executable"]: action for action in actions if "executable" in action.options}
    wanted = node_parameters(plan, record="runs/monday", realtime=True)
    for name, (package, executable) in EXECUTABLES.items():
        node = nodes.pop(executable)
        assert (node.options["package"], node.options["name"]) == (package, name)
        assert parameters_of(node) == wanted[name]
    assert set(nodes) == {"robot_state_publisher", "rviz2"}
    assert parameters_of(nodes["robot_state_publisher"])["robot_description"] == robot_description()
    (goal,) = [action for action in actions if "cmd" in action.options]
    assert goal.options["cmd"][:3] == ["ros2", "action", "send_goal"]
    assert Plan.load(yaml.safe_load(goal.options["cmd"][-1])["plan"]).segments == plan.segments

    bare = launched("ground_test.launch.py", viewable="false")
    assert [action.options["executable"] for action in bare] == [exe for _, exe in EXECUTABLES.values()]
    with pytest.raises(InputError, match="no such shipped plan"):
        launched("ground_test.launch.py", plan="quik")


@pytest.mark.usefixtures("stubs")
def test_launch_of_a_replay_has_parameters_that_the_node_takes() -> None:
    from gyrowheel_analysis.nodes.replay import ReplayNode

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


@pytest.mark.parametrize("package", PACKAGES)
def test_package_lists_agree(package: str) -> None:
    folder = SRC / package
    tree = ET.parse(folder / "package.xml").getroot()
    version = tree.findtext("version")
    assert tree.findtext("name") == package
    assert tomllib.loads((folder / "pyproject.toml").read_text())["project"]["version"] == version
    log = (folder / "CHANGELOG.rst").read_text()
    assert f"Changelog for package {package}" in log
    assert re.search(rf"^(Forthcoming|{re.escape(str(version))} .*)\n-+\n\* ", log, re.MULTILINE)
    needed = {element.text for kind in ("depend", "exec_depend") for element in tree.iter(kind)}
    imported = set()
    for path in (folder / package).rglob("*.py"):
        found = re.findall(r"^\s*(?:from|import) (\w+)", path.read_text(), re.MULTILINE)
        imported |= {
            name
            for name in found
            if name.startswith("gyrowheel_") or name.endswith(("_msgs", "_srvs", "_interfaces"))
        }
    assert imported - {package} <= needed


@pytest.mark.parametrize(("package", "node"), [(p, n) for p, nodes in NODES.items() for n in sorted(nodes)])
def test_every_node_has_its_executable(package: str, node: str) -> None:
    script = SRC / package / "scripts" / node
    assert os.access(script, os.X_OK)
    module = re.search(r"from (\S+) import main", script.read_text())
    assert module is not None
    assert module[1].startswith(f"{package}.")
    assert importlib.util.find_spec(module[1]) is not None
    assert {path.name for path in (SRC / package / "scripts").iterdir()} == NODES[package]


# --- live viewing


def frames(connection: socket.socket) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and payload of what a WebSocket server sends."""
    data = b""

    def need(count: int) -> None:
        nonlocal data
        while len(data) < count:
            new = connection.recv(65536)
            assert new, "the server has closed the connection"
            data += new

    while True:
        need(10)
        size, head = data[1] & 127, 2
        if size >= 126:
            form, head = (">H", 4) if size == 126 else (">Q", 10)
            (size,) = struct.unpack_from(form, data, 2)
        need(head + size)
        yield data[0] & 15, data[head : head + size]
        data = data[head + size :]


def send(connection: socket.socket, content: Any) -> None:
    data, mask = json.dumps(content).encode(), os.urandom(4)
    size = bytes([0x80 | len(data)]) if len(data) < 126 else bytes([0xFE]) + struct.pack(">H", len(data))
    connection.sendall(b"\x81" + size + mask + bytes(c ^ mask[i % 4] for i, c in enumerate(data)))


@pytest.mark.graph
@pytest.mark.timeout(180)
def test_foxglove_is_shown_a_replay(tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    from gyrowheel_bringup.foxglove_process import foxglove
    from gyrowheel_bringup.graph import find_executable

    plan = Plan.load(SHORT_PLAN)
    record_simulation(tmp_path / "run", Bench.load(), Scenario.nominal(), plan)
    domain = str(next_domain())
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", domain)
        with foxglove(0) as address:
            port = int(address.rpartition(":")[2])
            assert address == f"ws://127.0.0.1:{port}"
            with pytest.raises(InputError, match=f"parameter port: {port} cannot be opened"), foxglove(port):
                pass
            connection = socket.create_connection(("127.0.0.1", port), timeout=60.0)
            key = base64.b64encode(os.urandom(16)).decode()
            connection.sendall(
                f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n"
                f"Sec-WebSocket-Key: {key}\r\n\r\n".encode()
            )
            answer = b""
            while not answer.endswith(b"\r\n\r\n"):
                answer += connection.recv(1)
            assert answer.startswith(b"HTTP/1.1 101")
            replay = subprocess.Popen(
                [
                    str(find_executable("gyrowheel_analysis", "replay_node")),
                    "--ros-args", "-p", f"directory:={tmp_path / 'run'}", "-p", "wait_for_subscribers:=1",
                ],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )  # fmt: skip
            try:
                channels: dict[int, str] = {}
                heard: dict[str, list[tuple[int, bytes]]] = {}
                for opcode, data in frames(connection):
                    if opcode == 1 and (content := json.loads(data))["op"] == "advertise":
                        channels |= {c["id"]: c["topic"] for c in content["channels"]}
                        assert {c["encoding"] for c in content["channels"]} == {"cdr"}
                        asked = [{"id": number, "channelId": number} for number in channels]
                        send(connection, {"op": "subscribe", "subscriptions": asked})
                    elif opcode == 2 and data[0] == 1:
                        number, time = struct.unpack_from("<IQ", data, 1)
                        heard.setdefault(channels[number], []).append((time, data[13:]))
                    if len(heard.get(topics.MEASUREMENT.name, ())) > 500 and "/robot_description" in heard:
                        break
            finally:
                replay.send_signal(signal.SIGINT)
                replay.wait(30.0)
                connection.close()
    assert topics.TRUTH.name not in channels.values()
    samples = heard[topics.MEASUREMENT.name]
    numbers = [wire.MEASUREMENT.unpack(data)[1] for _, data in samples]
    assert numbers == list(range(numbers[0], numbers[0] + len(samples)))
    assert all(time == wire.stamp(data) for time, data in samples)
    assert wire.unpack_text(heard["/robot_description"][0][1]) == robot_description()


# --- colcon


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_colcon_builds_all_packages_and_their_nodes_run(tmp_path: Path) -> None:
    """The same tree, built against the ROS of this environment; the nodes run from the install space."""
    colcon = shutil.which(os.environ.get("COLCON", "colcon"))
    if colcon is None:
        pytest.skip("colcon is not installed (pip install colcon-common-extensions)")
    shutil.copytree(
        SRC, tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
    )
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "COLCON")}
    for name in ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH"):
        environment.pop(name, None)
    environment |= {
        "AMENT_PREFIX_PATH": sys.prefix,
        "CMAKE_PREFIX_PATH": sys.prefix,
        "CMAKE_BUILD_PARALLEL_LEVEL": "2",
        "PATH": f"{sys.prefix}/bin:{environment['PATH']}",
    }
    include = tmp_path / "src" / "gyrowheel_msgs" / "cmake" / "ros_wheels.cmake"
    built = subprocess.run(
        [
            colcon, "build", "--executor", "sequential", "--cmake-args",
            f"-DCMAKE_PROJECT_TOP_LEVEL_INCLUDES={include}", f"-DPython3_EXECUTABLE={sys.executable}",
        ],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert built.returncode == 0, built.stdout[-2000:] + built.stderr[-4000:]
    assert f"{len(PACKAGES)} packages finished" in built.stdout

    checks = [
        "from ament_index_python.packages import get_packages_with_prefixes as g",
        "print({n: p for n, p in g().items() if n.startswith('gyrowheel')})",
        "import gyrowheel_sim, gyrowheel_msgs.msg as m; print(gyrowheel_sim.__file__); print(m.__file__)",
    ]
    # nothing of the packages installed in this environment may help: it is looked at after the workspace
    script = f". install/setup.sh && exec '{sys.executable}' -c \"{'; '.join(checks)}\""
    said = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert said.returncode == 0, said.stderr
    index, *files = said.stdout.strip().splitlines()
    assert {package: f"{tmp_path}/install/{package}" for package in PACKAGES} == eval(index)
    assert all(file.startswith(str(tmp_path / "install")) for file in files)
    for package, nodes in NODES.items():
        for node in sorted(nodes):
            script = f". install/setup.sh && exec install/{package}/lib/{package}/{node} --help"
            said = subprocess.run(
                ["bash", "-c", script],
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
            )
            assert said.returncode == 0, said.stderr
            assert "set parameters by --ros-args" in said.stdout
    # and the whole bench walks a plan with the nodes of the workspace
    (tmp_path / "plan.yaml").write_text(SHORT_PLAN)
    code = "import sys; from gyrowheel.cli import main; sys.argv[0] = 'gyrowheel'; main()"
    script = f". install/setup.sh && exec '{sys.executable}' -c \"{code}\" up --plan plan.yaml --record run"
    said = subprocess.run(
        ["bash", "-c", script],
        cwd=tmp_path,
        env=environment | {"ROS_DOMAIN_ID": str(next_domain())},
        capture_output=True,
        text=True,
        check=False,
    )
    assert said.returncode == 0, said.stderr
    assert "none missing" in said.stdout
