"""The rules of the house: imports run downward, physics and diagnosis stay free of ROS, of plotting and of text."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SRC = Path(__file__).resolve().parents[1] / "src"
#: Each package imports only those before it.
LAYERS = [
    "gyrowheel_msgs",
    "gyrowheel_core",
    "gyrowheel_sim",
    "gyrowheel_control",
    "gyrowheel_analysis",
    "gyrowheel_bringup",
    "gyrowheel",
]
#: Modules that may import rclpy (and the messages): the nodes and what they share.
ROS_MODULES = {
    "gyrowheel_core": ("node", "topics"),
    "gyrowheel_sim": ("plant.node",),
    "gyrowheel_control": ("nodes",),
    "gyrowheel_analysis": ("nodes",),
    "gyrowheel_bringup": ("graph",),
    "gyrowheel": (),
}
MODULES = sorted(p for package in LAYERS[1:] for p in (SRC / package / package).rglob("*.py"))


def imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module)
    return names


def package_and_module(path: Path) -> tuple[str, str]:
    parts = path.relative_to(SRC).parts
    return parts[0], ".".join(parts[2:]).removesuffix(".py")


@pytest.mark.parametrize("path", MODULES, ids=lambda p: ".".join(package_and_module(p)))
def test_imports_run_downward(path: Path) -> None:
    package, _ = package_and_module(path)
    above = LAYERS[LAYERS.index(package) + 1 :]
    assert not {name for name in imported(path) if name.split(".")[0] in above}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: ".".join(package_and_module(p)))
def test_only_nodes_know_ros(path: Path) -> None:
    package, module = package_and_module(path)
    if any(module == own or module.startswith(f"{own}.") for own in ROS_MODULES[package]):
        return
    roots = {name.split(".")[0] for name in imported(path)}
    assert not roots & {"rclpy", "gyrowheel_msgs", "std_msgs", "sensor_msgs", "diagnostic_msgs"}


def test_analysis_plots_nothing_and_sees_no_truth() -> None:
    folder = SRC / "gyrowheel_analysis" / "gyrowheel_analysis"
    for path in folder.rglob("*.py"):
        names = imported(path)
        assert not {n for n in names if n.split(".")[0] in {"matplotlib", "plotly", "rich"}}, path
        # the truth of a simulated machine is known to these modules alone
        assert not {
            n for n in names if n.startswith(("gyrowheel_sim.plant.scenario", "gyrowheel_sim.blind"))
        }, path
