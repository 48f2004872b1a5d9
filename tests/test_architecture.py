"""The rules of the house: imports run downward, physics and diagnosis stay free of ROS, of plotting and of text."""

from __future__ import annotations

import ast
import functools
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from tools.house import HOUSE, Package

SRC = Path(__file__).resolve().parents[1] / "src"
#: Each package imports only those before it.
LAYERS = ["gyrowheel_msgs", *(package.name for package in HOUSE)]
#: Modules that may import rclpy (and the messages): the nodes and what they share.
ROS_MODULES = {
    "gyrowheel_core": ("node", "topics"),
    "gyrowheel_sim": ("plant.node",),
    "gyrowheel_air": (),
    "gyrowheel_control": ("nodes",),
    "gyrowheel_recording": ("nodes",),
    "gyrowheel_analysis": ("nodes",),
    "gyrowheel_bringup": ("graph",),
    "gyrowheel": (),
}
MODULES = sorted(p for package in LAYERS[1:] for p in (SRC / package / package).rglob("*.py"))


def name_of(path: Path) -> str:
    """Return the name by which a file is imported."""
    parts = path.relative_to(SRC).with_suffix("").parts[1:]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {name_of(path): path for path in MODULES}


def statements(tree: ast.AST, *, at_import: bool, types: bool) -> Iterator[ast.AST]:
    """Yield the nodes of a module; with `at_import` only those that run then, without `types` not those for types."""
    for node in ast.iter_child_nodes(tree):
        yield node
        later = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for_types = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if not ((at_import and later) or (for_types and (at_import or not types))):
            yield from statements(node, at_import=at_import, types=types)


@functools.cache
def imported(path: Path, *, at_import: bool = False, types: bool = True) -> frozenset[str]:
    """Return what a file imports: ``a.b`` of ``from a import b`` where that is a module of ours, else ``a``."""
    names: set[str] = set()
    for node in statements(ast.parse(path.read_text(encoding="utf-8")), at_import=at_import, types=types):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                names.add(full if full in FILES else node.module)
    return frozenset(names)


def package_and_module(path: Path) -> tuple[str, str]:
    parts = path.relative_to(SRC).parts
    return parts[0], ".".join(parts[2:]).removesuffix(".py")


def test_imports_run_downward() -> None:
    wrong = []
    for path in MODULES:
        package, module = package_and_module(path)
        above = LAYERS[LAYERS.index(package) + 1 :]
        wrong += [f"{package}.{module} imports {n}" for n in imported(path) if n.split(".")[0] in above]
    assert wrong == []


def test_compiled_code_is_kept_in_the_checked_cache_alone() -> None:
    """Numba's own cache trusts its files, and fails where the source folder is not writable."""
    own_cache = re.compile(r"numba import .*\bnjit\b|numba\.njit|numba import .*\bjit\b|numba\.jit")
    wrong = [path for path in MODULES if own_cache.search(path.read_text(encoding="utf-8"))]
    assert [package_and_module(path) for path in wrong] == [("gyrowheel_sim", "jit")]


def test_only_nodes_know_ros() -> None:
    wrong = []
    for path in MODULES:
        package, module = package_and_module(path)
        if any(module == own or module.startswith(f"{own}.") for own in ROS_MODULES[package]):
            continue
        roots = {name.split(".")[0] for name in imported(path)}
        if roots & {"rclpy", "gyrowheel_msgs", "std_msgs", "sensor_msgs", "diagnostic_msgs"}:
            wrong.append(f"{package}.{module}")
    assert wrong == []


def test_analysis_plots_nothing_and_sees_no_truth() -> None:
    folder = SRC / "gyrowheel_analysis" / "gyrowheel_analysis"
    for path in folder.rglob("*.py"):
        names = imported(path)
        assert not {n for n in names if n.split(".")[0] in {"matplotlib", "plotly", "rich"}}, path
        # the machine, its secrets and what is outside the library are known to the simulation alone
        assert not {n for n in names if n.startswith(("gyrowheel_sim.plant", "gyrowheel_sim.blind"))}, path


@pytest.mark.parametrize("package", HOUSE, ids=lambda package: package.name)
def test_inside_a_package_imports_run_downward(package: Package) -> None:
    """Also those inside functions: an import that waits is still a way up."""
    wrong = []
    for name, path in FILES.items():
        root, _, part = name.partition(".")
        if root != package.name or not part:  # the package itself may show whatever is in it
            continue
        for other in imported(path):
            there, _, target = other.partition(".")
            if there != root or not target:  # of the package itself its version
                continue
            here, at = package.floor_of(part), package.floor_of(target)
            same_folder = part.partition(".")[0] == target.partition(".")[0]
            if at > here or (at == here and not same_folder):
                wrong.append(f"{name} imports {other}")
    assert wrong == []


@pytest.mark.parametrize("package", HOUSE, ids=lambda package: package.name)
def test_every_part_has_its_place(package: Package) -> None:
    folder = SRC / package.name / package.name
    parts = {p.stem for p in folder.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()}
    named = [part for floor in package.floors for part in floor]
    assert len(named) == len(set(named))
    assert {part for part in named if "." not in part} == parts - {"__init__"}
    assert all(f"{package.name}.{part}" in FILES for part in named)


def test_the_command_line_knows_the_front_door_alone() -> None:
    """Verbs use the API and what presents its results; below, errors, units, user folders and variables."""
    allowed = {f"gyrowheel_core.{name}" for name in ("cache", "errors", "surroundings", "units")}
    for path in (SRC / "gyrowheel" / "gyrowheel").rglob("*.py"):
        if path.parent.name == "cli" or path.stem.endswith("verb"):
            below = {n for n in imported(path) if n.split(".")[0] in LAYERS[:-1]}
            assert below <= allowed, path
            assert not {n for n in imported(path) if n.split(".")[0] in {"matplotlib", "numpy", "rclpy"}}, (
                path
            )


def test_text_and_pictures_do_not_import_the_front_door() -> None:
    """They take facts, and know nothing of who asked for them."""
    rooms = ("page.py", "picture.py")
    for path in (SRC / "gyrowheel" / "gyrowheel").rglob("*.py"):
        if path.name in rooms or path.parent.name in ("show", "sentences"):
            assert not {n for n in imported(path) if n.startswith("gyrowheel.cli")}, path
            assert "gyrowheel" not in imported(path), path


def loaded(libraries: Sequence[str], modules: Sequence[str]) -> list[str]:
    """Return which of some libraries a fresh process has once it has imported some modules."""
    code = (
        f"import sys, {', '.join(modules)}\nprint(*(name for name in {libraries!r} if name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.slow
def test_nodes_start_without_what_they_have_no_use_for() -> None:
    """Libraries that take long to load would be loaded anew at every start of the bench."""
    own = ["gyrowheel_control.nodes.controller", "gyrowheel_control.nodes.conductor"]
    others = ["gyrowheel_sim.plant.node", "gyrowheel_analysis.nodes.drag_estimator"]
    everywhere = ["pint", "scipy.optimize", "scipy.signal", "matplotlib", "pandas"]
    assert loaded(everywhere, own + others) == []
    # the laws of effects are expressions of SymPy, which the plant and the estimator evaluate
    assert loaded(["sympy"], own) == []


def test_libraries_that_read_settings_from_the_current_folder_are_imported_in_one_place() -> None:
    """There it is the rule what they find."""
    places = {"matplotlib": "gyrowheel.show.figure", "numba": "gyrowheel_sim.jit"}
    for name, path in FILES.items():
        roots = {own.split(".")[0] for own in imported(path, at_import=True, types=False)}
        assert {own for own in roots & places.keys() if name != places[own]} == set(), path


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Also not for types, and not inside functions."""
    below = {name: imported(path) & FILES.keys() for name, path in FILES.items()}
    done: set[str] = set()

    def follow(name: str, way: list[str]) -> None:
        assert name not in way, " -> ".join([*way[way.index(name) :], name])
        if name not in done:
            for other in sorted(below[name] - {name}):
                follow(other, [*way, name])
            done.add(name)

    for name in FILES:
        follow(name, [])


def test_imports_in_functions_and_for_types_are_seen(tmp_path: Path) -> None:
    """The reader of imports sees those in functions, those for types, and modules imported by name."""
    file = tmp_path / "module.py"
    file.write_text(
        "from typing import TYPE_CHECKING\nfrom gyrowheel_sim import bench\nimport numpy.linalg\n"
        "if TYPE_CHECKING:\n    from gyrowheel_core import errors\n"
        "def f():\n    from gyrowheel_analysis.diagnosis import selection\n"
    )
    now = {"typing", "gyrowheel_sim.bench", "numpy.linalg"}
    assert imported(file, at_import=True) == now
    assert imported(file) == now | {"gyrowheel_core.errors", "gyrowheel_analysis.diagnosis.selection"}
