"""Identity of the code that results depend on: of the project, of libraries, and of plug-ins."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import platform
from importlib.metadata import PackageNotFoundError, entry_points, version
from pathlib import Path

_PACKAGES = (
    "gyrowheel_core",
    "gyrowheel_sim",
    "gyrowheel_air",
    "gyrowheel_control",
    "gyrowheel_recording",
    "gyrowheel_analysis",
    "gyrowheel",
)
_LIBRARIES = ("numpy", "scipy", "numba", "sympy")
_SOURCES = (".py", ".yaml", ".json")


@functools.cache
def code_identity() -> dict[str, str]:
    """Return the versions of everything that a result depends on, by name.

    Packages of the project, and packages with further effects, are identified by the content of their files: code may
    change without a new version number.
    """
    from gyrowheel_sim.effects.registry import (
        ENTRY_POINT_GROUP,  # with the effects of the library, which take long
    )

    found = {"python": platform.python_version()}
    found |= {name: _version(name) for name in _LIBRARIES}
    found["gyrowheel"] = files_of(*_PACKAGES)
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda p: p.name):
        top = point.module.partition(".")[0]
        found[f"effects of {point.name}"] = (
            f"{point.dist.version if point.dist else ''} (files {_digest(top)})"
        )
    return found


@functools.cache
def files_of(*packages: str) -> str:
    """Return the version of the project, and a digest of the files of some of its packages or folders."""
    return f"{_version('gyrowheel')} (files {_digest(*packages)})"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


def _digest(*packages: str) -> str:
    """Return a short digest of the files of packages."""
    sha = hashlib.sha256()
    for package in packages:
        for path in _files(package):
            sha.update(f"{package}/{path.name}\0".encode())
            sha.update(path.read_bytes())
    return sha.hexdigest()[:12]


def _files(package: str) -> list[Path]:
    spec = importlib.util.find_spec(package)
    places = [] if spec is None else spec.submodule_search_locations or [spec.origin or ""]
    found: list[Path] = []
    for place in map(Path, places):
        found += [place] if place.is_file() else sorted(p for p in place.rglob("*") if p.suffix in _SOURCES)
    return found
