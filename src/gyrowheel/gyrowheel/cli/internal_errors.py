"""Internal errors: an unforeseen exception becomes one line, and a report without data of the user."""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Iterator
from importlib.machinery import PathFinder
from importlib.metadata import PackageNotFoundError, distributions, version
from pathlib import Path
from types import TracebackType

from gyrowheel_core.cache import user_folder
from gyrowheel_core.errors import one_line, printable

#: Errors of the machine, not of the program: no descriptors, memory or room left, a broken disk.
_OF_THE_MACHINE = {
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EIO,
    errno.EROFS,
}
#: Errors of a path that the user gave.
_OF_A_PATH = {errno.EACCES, errno.EPERM, errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EISDIR}
_PACKAGES = (
    "gyrowheel", "gyrowheel_core", "gyrowheel_sim", "gyrowheel_control", "gyrowheel_analysis", "gyrowheel_bringup",
    "gyrowheel_msgs", "numpy", "scipy", "numba", "sympy", "pydantic", "rosbags", "pyarrow", "matplotlib", "typer",
)  # fmt: skip
_LONGEST = 300  # characters of what an exception says
_PREFIX = "gyrowheel-defect-"
_KEPT = 10  # reports: more tell nothing new


def machine_error(error: BaseException) -> str | None:
    """Return the message for an error of the machine or of a path; None for any other exception."""
    for cause in _causes(error):
        if isinstance(cause, MemoryError):
            return f"not enough memory{f': {one_line(cause)}' if str(cause) else ''}"
        if isinstance(cause, OSError) and (
            cause.errno in _OF_THE_MACHINE
            or (cause is error and cause.errno in _OF_A_PATH and cause.filename)
        ):
            return printable(
                f"{cause.strerror or one_line(cause)}{f': {cause.filename}' if cause.filename else ''}"
            )
    return None


def foreign_package(error: BaseException) -> str | None:
    """Return the message where ``PYTHONPATH`` puts other versions of packages before those that are installed."""
    folders = [own for own in os.environ.get("PYTHONPATH", "").split(os.pathsep) if own]
    if not folders:
        return None
    installed = [own for own in sys.path if own not in folders]
    for name in _PACKAGES:
        found = PathFinder.find_spec(name, folders)
        if found is not None and PathFinder.find_spec(name, installed) is not None:
            other, own = (_version(name, places) for places in (folders, installed))
            if other != own:
                said = one_line(error)[:_LONGEST]
                return printable(
                    f"PYTHONPATH: {found.origin} ({other or 'no version'}) takes the place of {name} {own}: {said}"
                )
    return None


def _version(name: str, places: list[str]) -> str:
    return next((own.version for own in distributions(name=name, path=places)), "")


def internal_error(error: BaseException) -> str:
    """Return the line about an error of the program itself; details go into a file, whose name ends the line."""
    said = printable(one_line(error))
    said = said if len(said) <= _LONGEST else f"{said[:_LONGEST]}..."
    kind = type(error).__name__
    line = f"internal error in gyrowheel: {kind if said == kind else f'{kind}: {said}'}"
    place = _kept(_report(error))
    return f"{line}; details in {place}" if place else f"{line}; no file could be written for its details"


def _report(error: BaseException) -> str:
    """Return the origin of an exception without arguments, values and messages, which may be data of the user."""
    lines = [
        "An internal error in gyrowheel. This report contains no data, file names or arguments of the user.",
        "",
    ]
    for cause in reversed(list(_causes(error))):
        lines.append(f"{type(cause).__module__}.{type(cause).__qualname__}")
        lines += [f"  {place}" for place in _places(cause.__traceback__)]
    lines += ["", f"python {platform.python_version()}, {platform.system()} {platform.machine()}"]
    for name in _PACKAGES:
        try:
            lines.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return "\n".join(lines) + "\n"


def _causes(error: BaseException) -> Iterator[BaseException]:
    """Yield an exception and its causes, the last one first."""
    seen: set[int] = set()
    current: BaseException | None = error
    while current is not None and id(current) not in seen:
        seen.add(id(current))
        yield current
        current = current.__cause__ or current.__context__


def _places(at: TracebackType | None) -> Iterator[str]:
    """Yield the frames of a traceback by module and line; modules of other packages are not named."""
    for frame, line in traceback.walk_tb(at):
        module = str(frame.f_globals.get("__name__", "?"))
        known = module == "__main__" or module.partition(".")[0] in {*_PACKAGES, *sys.stdlib_module_names}
        yield f"{module}:{line} in {frame.f_code.co_name}" if known else f"(another package):{line}"


def _kept(report: str) -> Path | None:
    """Write a report into the user's folder for the state of programs, else that for temporary files."""
    for folder in (user_folder("state") / "gyrowheel", None):  # None: where temporary files are
        try:
            if folder is not None:
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                _remove_old(folder)
            number, place = tempfile.mkstemp(dir=folder, prefix=_PREFIX, suffix=".txt")
            with os.fdopen(number, "w", encoding="utf-8") as file:
                file.write(report)
        except OSError:
            continue
        return Path(place)
    return None


def _remove_old(folder: Path) -> None:
    """Remove the oldest reports, so that one more is as many as are kept."""
    with contextlib.suppress(OSError):
        reports = sorted(folder.glob(f"{_PREFIX}*.txt"), key=lambda own: own.stat().st_mtime)
        for own in reports[: max(len(reports) - _KEPT + 1, 0)]:
            own.unlink()
