"""Write requirements.lock: one version, with hashes, of every package for building, running and testing ours.

The requirements are read from their pyproject.toml files. ``make lock`` calls this, in an environment with ``uv``.
"""

import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "requirements.lock"
HEADER = """\
# Written by `make lock` from the pyproject.toml files, for Python 3.11 on Linux; do not edit.
# Holds all that `make` installs: what the packages need to run, what builds them, what checks them.
# The hashes are those of the files on PyPI; pip refuses any other file, from whatever index or cache it comes.
"""


def _projects() -> list[dict[str, Any]]:
    return [tomllib.loads(path.read_text()) for path in sorted((ROOT / "src").glob("*/pyproject.toml"))]


def _groups() -> dict[str, list[str]]:
    groups: dict[str, list[str]] = tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"]
    return groups


def _without_own(wanted: Iterable[str]) -> list[str]:
    return sorted({name for name in wanted if not name.startswith("gyrowheel-")})


def needed_to_run() -> list[str]:
    """Return what the packages need to run, extras included, without our packages."""
    projects = [package["project"] for package in _projects()]
    lists = [own["dependencies"] for own in projects]
    for own in projects:
        lists += [names for extra, names in own.get("optional-dependencies", {}).items() if extra != "test"]
    return _without_own(name for names in lists for name in names)


def needed_to_test() -> list[str]:
    """Return what the fast tests need besides."""
    return _without_own(_groups()["test"])


def requirements() -> list[str]:
    """Return the requirements of all pyproject.toml files, without our packages."""
    builds = [package["build-system"]["requires"] for package in _projects()]
    return _without_own(name for names in (needed_to_run(), *builds, *_groups().values()) for name in names)


def main() -> int:
    """Resolve the requirements to the newest compatible versions; replace the lock file if they exist."""
    options = "--quiet --no-config --no-header --no-annotate --no-emit-index-url --no-emit-find-links --generate-hashes"
    target = "--python-version 3.11 --python-platform x86_64-manylinux_2_28"
    resolved = subprocess.run(
        [sys.executable, "-m", "uv", "pip", "compile", *options.split(), *target.split(), "-"],
        input="\n".join(requirements()),
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if resolved.returncode == 0:
        LOCK.write_text(HEADER + resolved.stdout)
    return resolved.returncode


if __name__ == "__main__":
    raise SystemExit(main())
