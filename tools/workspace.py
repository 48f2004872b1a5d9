"""Build and test the packages as a colcon workspace, next to the environment of ``make``: ``make workspace``.

ROS comes from the environment; colcon writes to ``.venv/.workspace``.
"""

from __future__ import annotations

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Collection
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = tuple(sorted(path.parent.name for path in (ROOT / "src").glob("*/package.xml")))
#: Tests that ``colcon test`` runs: neither slow nor with nodes.
USUAL = ("-m", "not slow and not graph")


def environment() -> dict[str, str]:
    """Return the environment of a shell that has sourced only the ROS of this Python."""
    mixed = ("PYTHONPATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH")
    kept = {name: value for name, value in os.environ.items() if name not in mixed}
    return kept | {
        "AMENT_PREFIX_PATH": sys.prefix,
        "CMAKE_PREFIX_PATH": sys.prefix,
        "CMAKE_BUILD_PARALLEL_LEVEL": "2",
        "PATH": f"{sys.prefix}/bin:{kept['PATH']}",
        "PYTHONWARNINGS": "ignore",
    }


def colcon(verb: str, folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run a colcon verb on the packages; it writes to `folder`.

    Parameters
    ----------
    verb : str
        ``build`` or ``test``.
    folder : Path
        Parent of ``build``, ``install`` and ``log``.
    *options : str
        Further options.
    """
    command = [
        f"{sys.prefix}/bin/colcon", "--log-base", str(folder / "log"), verb, "--executor", "sequential",
        "--base-paths", str(ROOT / "src"), "--build-base", str(folder / "build"),
        "--install-base", str(folder / "install"), *options,
    ]  # fmt: skip
    return subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, check=False)


def build(folder: Path, *, skip: Collection[str] = ()) -> subprocess.CompletedProcess[str]:
    """Build all packages but those to skip, which come from the environment."""
    options = ["--packages-ignore", *skip] if skip else []
    include = ROOT / "src" / "gyrowheel_msgs" / "cmake" / "ros_wheels.cmake"
    defines = [f"-DCMAKE_PROJECT_TOP_LEVEL_INCLUDES={include}", f"-DPython3_EXECUTABLE={sys.executable}"]
    return colcon("build", folder, *options, "--cmake-args", *defines)


def run_tests(
    folder: Path,
    *,
    packages: Collection[str] = PACKAGES,
    skip: Collection[str] = (),
    options: Collection[str] = USUAL,
) -> dict[str, tuple[int, int]]:
    """Run the tests of packages that were built; return how many ran and how many of them failed, by package.

    Parameters
    ----------
    folder : Path
        As given to `build`.
    packages : collection of str
        Packages to test.
    skip : collection of str
        As given to `build`.
    options : collection of str
        Options of pytest.
    """
    chosen = ["--packages-ignore", *skip] if skip else []
    given = [f" {option}" if option.startswith("-") else option for option in options]
    colcon("test", folder, *chosen, "--packages-select", *packages, "--pytest-args", *given)
    return {package: _counts(folder / "build" / package) for package in packages}


def _counts(built: Path) -> tuple[int, int]:
    files = [built / "pytest.xml", *built.glob("test_results/**/*.xunit.xml")]
    ran = failed = 0
    for file in filter(Path.exists, files):
        for suite in ET.parse(file).getroot().iter("testsuite"):
            found = {name: int(suite.get(name, 0)) for name in ("tests", "skipped", "failures", "errors")}
            ran += found["tests"] - found["skipped"]
            failed += found["failures"] + found["errors"]
    return ran, failed


def main() -> int:
    """Build and test all packages; arguments go to pytest."""
    folder = Path(sys.prefix) / ".workspace"
    built = build(folder)
    if built.returncode:
        print(built.stdout + built.stderr)
        return built.returncode
    print(built.stdout.strip().splitlines()[-1])
    results = run_tests(folder, options=(*USUAL, *sys.argv[1:]))
    for package, (ran, failed) in results.items():
        print(f"{package:20} {ran:5} tests, {failed} failed")
    bad = [package for package, (ran, failed) in results.items() if failed or not ran]
    for package in bad:
        print(*sorted(folder.glob(f"log/latest_test/{package}/stdout.log")), sep="\n")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
