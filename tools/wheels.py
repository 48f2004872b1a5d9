"""Build the packages as wheels and try them as people install them: ``make wheels``, ``make oldest``.

Both need ``uv`` and PyPI. ``make wheels`` installs the wheels into an empty environment, with the newest versions of
what they need or the lowest that they state, and runs the bench there. ``make oldest`` runs the fast tests on the
lowest versions. Everything is written to ``build``.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Sequence
from pathlib import Path

from tools.lock import ROOT, needed_to_run, needed_to_test

BUILD = ROOT / "build"
#: What is tried: the version, a simulation, its diagnosis, the graph of nodes, and all of it together.
_TRIED = (
    "--version",
    "simulate --plan quick -o simulated --effect aero_cross --machine 6",
    "model new --model wheel.yaml",
    "diagnose simulated --model wheel.yaml",
    "up --plan check --record recorded",
    "report recorded --model wheel.yaml -o report.html",
    "demo --seed 8",
)


def run(command: Sequence[str | Path], folder: Path = ROOT) -> None:
    """Run a command in a folder; CalledProcessError if it fails."""
    subprocess.run(list(map(str, command)), cwd=folder, check=True)


def uv(*words: str | Path) -> None:
    """Run uv, that of this environment."""
    run([sys.executable, "-m", "uv", "--quiet", "--no-config", *words])


def built(python: str) -> Path:
    """Build the wheels for a Python, have twine check what they state, and return their folder."""
    folder = BUILD / "wheels"
    shutil.rmtree(folder, ignore_errors=True)
    for project in sorted((ROOT / "src").glob("*/pyproject.toml")):
        uv("build", "--wheel", "--python", python, "--out-dir", folder, project.parent)
    uv("tool", "run", "twine", "check", "--strict", *sorted(folder.glob("*.whl")))
    return folder


def environment(place: Path, wheels: Path, python: str, *, lowest: bool, tests: bool = False) -> Path:
    """Make an environment with the wheels; return its Python.

    Parameters
    ----------
    place : Path
        Its folder.
    wheels : Path
        Folder of the wheels.
    python : str
        Name or path of the Python that it is for.
    lowest : bool
        Whether with the lowest versions that the packages state, of all that they can use, else with the newest.
    tests : bool
        Whether with what the fast tests need.
    """
    uv("venv", "--clear", "--python", python, place)
    own = place / "bin" / "python"
    install = "pip", "install", "--python", own
    if lowest:
        wanted = BUILD / "lowest.in"
        wanted.write_text("\n".join(needed_to_run()), encoding="utf-8")
        versions = BUILD / "lowest.txt"
        uv(
            "pip",
            "compile",
            "--resolution",
            "lowest-direct",
            "--python",
            own,
            wanted,
            "--output-file",
            versions,
        )
        uv(*install, "--requirements", versions)
        if tests:
            uv(*install, "--constraints", versions, *needed_to_test())
        uv(*install, "--no-deps", *sorted(wheels.glob("*.whl")))
    else:
        uv(*install, *sorted(wheels.glob("*.whl")), *(needed_to_test() if tests else ()))
    return own


def tried(python: Path) -> None:
    """Run the bench in an environment, and have the workbench there answer."""
    program = python.parent / "gyrowheel"
    with tempfile.TemporaryDirectory(prefix="gyrowheel-wheels-") as folder:
        for words in _TRIED:
            print(f"$ gyrowheel {words}", flush=True)
            run([program, *words.split()], Path(folder))
        words = "workbench . --model wheel.yaml --port 0"
        print(f"$ gyrowheel {words}", flush=True)
        with subprocess.Popen(
            [program, *words.split()], cwd=folder, stdout=subprocess.PIPE, text=True
        ) as server:
            try:
                assert server.stdout is not None
                page = next((line for line in server.stdout if line.startswith("page: ")), "")
                for name in ("", "state", "found", "help"):
                    with urllib.request.urlopen(page.removeprefix("page: ").strip() + name) as answer:
                        print(f"{answer.url}: {answer.status}, {len(answer.read())} bytes", flush=True)
            finally:
                server.terminate()


def main(words: Sequence[str] | None = None) -> int:
    """Build the wheels, and try them in an empty environment or, with ``--tests``, run the fast tests there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--python", default=sys.executable, help="the Python that they are for")
    parser.add_argument("--lowest", action="store_true", help="with the lowest versions that they state")
    parser.add_argument("--tests", nargs=argparse.REMAINDER, help="run the fast tests; arguments of pytest")
    asked = parser.parse_args(words)
    try:
        wheels = built(asked.python)
        tests = asked.tests is not None
        name = "oldest" if asked.lowest else "newest"
        python = environment(BUILD / name, wheels, asked.python, lowest=asked.lowest, tests=tests)
        if tests:
            run([python, "-m", "pytest", "-m", "not slow and not graph", *asked.tests])
        else:
            tried(python)
    except subprocess.CalledProcessError as error:
        return error.returncode
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
