"""One list of dependencies: what is imported, what package.xml tells rosdep, what pyproject.toml tells pip."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from gyrowheel_bringup.graph.nodes import EXECUTABLES, MODULES, SHARED_MODULE, find_executable
from tools import lock

ROOT = Path(__file__).resolve().parents[2]
SRC = ROOT / "src"
PACKAGES = sorted(path.parent.name for path in SRC.glob("*/package.xml"))

#: Key of rosdep (rosdep/python.yaml of rosdistro), by the module, where it is not ``python3-MODULE``.
KEYS = {"mpl_toolkits": "python3-matplotlib", "pydantic_core": "python3-pydantic"}
WITH_KEY = {
    "h5py", "jinja2", "joblib", "markupsafe", "matplotlib",
    "numba", "numpy", "psutil", "pydantic", "rich", "scipy", "sympy", "tornado", "typer", "yaml",
}  # fmt: skip
#: Without a key, or with one that calls pip, which Ubuntu 24.04 refuses outside of a virtual environment.
BY_PIP = {"dask": "distributed", "foxglove": "foxglove-sdk"} | {
    name: name
    for name in (
        "bokeh",
        "isal",
        "lz4",
        "pandas",
        "pint",
        "pyarrow",
        "pythonfmu",
        "rosbags",
        "threadpoolctl",
        "zstandard",
    )
}
#: Packages of ROS that are no modules: started by name, or tools of a launch file.
STARTED = {"gyrowheel_bringup": {"robot_state_publisher", "ros2launch", "rviz2"}}
#: What a package asks for where it is wanted, by name or for a package below it: ``pip install gyrowheel[foxglove]``.
EXTRA_NAMES = {"gyrowheel": {"foxglove-sdk", "pythonfmu"}, "gyrowheel_recording": {"asammdf", "npTDMS"}}
#: What PyPI calls a module, where that is another name.
PYPI = {
    "yaml": "PyYAML",
    "mpl_toolkits": "matplotlib",
    "pydantic_core": "pydantic",
} | BY_PIP
MESSAGE = re.compile(r"(\w+)/(?:msg|srv|action)/\w+")


def imported(package: str) -> set[str]:
    """Return the modules that a package imports anywhere, also within functions, without those of Python itself."""
    found: set[str] = set()
    for path in (SRC / package).rglob("*.py"):
        if path.name == "setup.py" or "build" in path.relative_to(SRC / package).parts:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(str(node.module).partition(".")[0])
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                # a topic names its type, and imports its package when it is used
                found |= {match[1] for match in [MESSAGE.fullmatch(node.value)] if match}
    return found - set(sys.stdlib_module_names) - {package}


def depends(package: str) -> dict[str, str | None]:
    """Return what a package.xml needs at run time: the lowest version by the name, None where any will do."""
    tree = ET.parse(SRC / package / "package.xml").getroot()
    return {
        str(element.text): element.get("version_gte")
        for kind in ("depend", "exec_depend")
        for element in tree.iter(kind)
    }


def by_pip(package: str) -> set[str]:
    """Return what a package.xml names as coming by pip."""
    found = re.search(r"<!-- By pip, .*?: (.*)\. -->", (SRC / package / "package.xml").read_text(), re.DOTALL)
    return (
        set()
        if found is None
        else set(re.findall(r"[\w-]+(?=[,;]|$)", re.sub(r"where \w+ \w+ wanted:", "", found[1])))
    )


def pip_bounds(package: str) -> dict[str, str]:
    """Return the lowest version of what a pyproject.toml needs from PyPI, also where it is wanted, by the name."""
    project = tomllib.loads((SRC / package / "pyproject.toml").read_text())["project"]
    extras = {
        name: content for name, content in project.get("optional-dependencies", {}).items() if name != "test"
    }
    lists = [project["dependencies"], *extras.values()]
    bounds = dict(entry.split(">=") for entries in lists for entry in entries)
    return {name: low for name, low in bounds.items() if not name.startswith(("gyrowheel-", "ros-jazzy-"))}


PYTHON_PACKAGES = [package for package in PACKAGES if package != "gyrowheel_msgs"]


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_every_import_has_its_depend_or_is_named_as_by_pip(package: str) -> None:
    needed, modules = depends(package), imported(package)
    keys = {KEYS.get(name, f"python3-{name}") for name in modules & (WITH_KEY | set(KEYS))}
    of_ros = modules - WITH_KEY - set(KEYS) - set(BY_PIP)
    assert of_ros | keys | STARTED.get(package, set()) == set(needed)
    assert {BY_PIP[name] for name in modules & set(BY_PIP)} | EXTRA_NAMES.get(package, set()) == by_pip(
        package
    )


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_pip_is_told_the_same(package: str) -> None:
    """Also the versions: package.xml has that of pyproject.toml where a distribution's may be too old."""
    bounds = pip_bounds(package)
    third = {name for name in imported(package) if name in WITH_KEY or name in PYPI}
    assert {PYPI.get(name, name) for name in third} | EXTRA_NAMES.get(package, set()) == set(bounds)
    for key, version in depends(package).items():
        if version is not None:
            assert bounds[key.removeprefix("python3-")] == version


def test_a_lowest_version_is_the_same_wherever_it_is_stated() -> None:
    stated: dict[str, set[str]] = {}
    for entry in lock.requirements():
        name, _, low = entry.partition(">=")
        stated.setdefault(name.lower().replace("_", "-"), set()).update({low} - {""})
    assert [name for name, low in stated.items() if len(low) > 1] == []


def test_every_package_states_the_same_python_and_who_made_it() -> None:
    projects = [tomllib.loads((SRC / name / "pyproject.toml").read_text())["project"] for name in PACKAGES]
    for key in ("requires-python", "authors", "urls"):
        assert all(own[key] == projects[0][key] for own in projects), key
    lowest = projects[0]["requires-python"].removeprefix(">=")
    assert f"Python {lowest} or " in (ROOT / "README.md").read_text()
    assert f"for Python {lowest} on Linux" in lock.HEADER
    for own in projects:
        assert f"Programming Language :: Python :: {lowest}" in own["classifiers"]


def test_the_page_installs_by_pip_what_rosdep_does_not() -> None:
    page = (ROOT / "docs" / "with_ros.md").read_text()
    found = re.search(r"pip install --upgrade (.*?)\n```", page, re.DOTALL)
    assert found is not None
    names = {re.split(r"[<>=]", word.strip("'"))[0] for word in re.sub(r"\\\n|#.*", " ", found[1]).split()}
    too_old = {
        key.removeprefix("python3-")
        for package in PACKAGES
        for key, version in depends(package).items()
        if version
    }
    optional = {"distributed", "pandas", "pythonfmu"}
    assert names - {"numpy"} == (set(BY_PIP.values()) - optional) | too_old


@pytest.mark.parametrize("package", PACKAGES)
def test_versions_and_changelogs_agree(package: str) -> None:
    folder = SRC / package
    tree = ET.parse(folder / "package.xml").getroot()
    version = tree.findtext("version")
    assert tree.findtext("name") == package
    assert tomllib.loads((folder / "pyproject.toml").read_text())["project"]["version"] == version
    log = (folder / "CHANGELOG.rst").read_text()
    assert f"Changelog for package {package}" in log
    assert re.search(rf"^(Forthcoming|{re.escape(str(version))} .*)\n-+\n\* ", log, re.MULTILINE)


@pytest.mark.slow
def test_the_launcher_runs_the_modules_of_the_executables_and_imports_no_ros() -> None:
    for name, module in MODULES.items():
        assert f"gyrowheel_core.start_node {module} " in find_executable(*EXECUTABLES[name]).read_text()
    look = f"import sys, {SHARED_MODULE}; sys.exit('rclpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-P", "-c", look], check=False).returncode == 0
