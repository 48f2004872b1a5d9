"""What a process takes from its surroundings: environment variables, and nothing from the current folder.

Python, numba, matplotlib and Fast DDS read modules and settings from the folder in which a program is started, whoever
put them there. A process of the bench does not: see `begin` and `ignored_here`.
"""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from gyrowheel_core import cache
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import LARGEST_VARIABLE

_SAFE: Final = "PYTHONSAFEPATH"
_RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_PROFILES: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
_MIDDLEWARE: Final = "RMW_IMPLEMENTATION"
_NO_XML: Final = "SKIP_DEFAULT_XML_FILE"
_KEYSTORE: Final = "ROS_SECURITY_KEYSTORE"
_LAST_DOMAIN: Final = 232  # larger ones have no ports
_RANGES: Final = (
    "LOCALHOST",
    "SUBNET",
    "SYSTEM_DEFAULT",
)  # with OFF the nodes of the bench do not find each other
_exists: Final = os.path.exists


@dataclass(frozen=True)
class Variable:
    """An environment variable that changes what the bench does."""

    name: str
    about: str
    #: Values that work, in words; empty where every value does, or where its reader refuses others.
    allowed: str = ""
    works: Callable[[str], bool] = lambda value: True
    ros: bool = False  # whether only the nodes and what talks to them read it


def _whole(text: str, low: int, high: int) -> bool:
    return text.isascii() and text.isdigit() and low <= int(text[:9]) <= high


def _installed(name: str) -> bool:
    """Return whether a middleware is installed: as its own libraries look for it."""
    others = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    places = (
        Path(prefix, "share/ament_index/resource_index/rmw_typesupport") for prefix in (sys.prefix, *others)
    )
    return "/" not in name and any((place / name).is_file() for place in places)


def _secured(value: str) -> bool:
    return value != "true" or Path(os.environ.get(_KEYSTORE) or os.devnull).is_dir()


VARIABLES: Final = (
    Variable(
        cache.VARIABLE, "Folder for compiled code and computed results; removed at any time without harm"
    ),
    Variable(
        LARGEST_VARIABLE,
        "Limit of unpacked files and of messages in memory [GB]; 4 if not set, or the size of an MCAP file",
    ),
    Variable("XDG_CACHE_HOME", "Folder that has the cache folder `gyrowheel`; `~/.cache` if not set"),
    Variable(
        "XDG_STATE_HOME",
        "Folder of reports of internal errors, in `gyrowheel`; `~/.local/state` if not set",
    ),
    Variable("TMPDIR", "Folder for temporary files"),
    Variable("NO_COLOR", "No colours in the terminal, if set"),
    Variable("COLUMNS", "Width of the output [characters]"),
    Variable(
        "NUMBA_NUM_THREADS",
        "Threads of compiled code; no result depends on it",
        "a whole number, 1 .. 100000",
        lambda value: _whole(value, 1, 100_000),
    ),
    Variable(
        "OPENBLAS_NUM_THREADS",
        "Threads of linear algebra; 1 if not set, as matrices are small; no result depends on it",
    ),
    Variable("PYTHONPATH", "Folders with Python packages, before those of the environment of the bench"),
    Variable("PYTHONWARNINGS", "Warnings of libraries; `error` is passed over"),
    Variable("AMENT_PREFIX_PATH", "Folders with further ROS packages, after the environment of the bench"),
    Variable(
        "ROS_DOMAIN_ID",
        "ROS domain",
        f"0 .. {_LAST_DOMAIN}",
        lambda value: _whole(value, 0, _LAST_DOMAIN),
        ros=True,
    ),
    Variable(
        _RANGE,
        "How far nodes are seen; this computer if not set",
        ", ".join(_RANGES),
        lambda value: value in _RANGES,
        ros=True,
    ),
    Variable("ROS_STATIC_PEERS", "Further computers whose nodes are seen", ros=True),
    Variable(
        _MIDDLEWARE,
        "Middleware; rmw_fastrtps_cpp if not set",
        "one that is installed, such as rmw_fastrtps_cpp",
        _installed,
        ros=True,
    ),
    Variable(
        _PROFILES,
        "Settings of Fast DDS in place of those of the bench, which keep to this computer",
        "a file that exists",
        lambda value: Path(value).is_file(),
        ros=True,
    ),
    Variable("CYCLONEDDS_URI", "Settings of Cyclone DDS, where it is the middleware", ros=True),
    Variable(
        "ROS_SECURITY_ENABLE",
        f"Encrypted topics, if `true`: by the keys in {_KEYSTORE}",
        f"true where {_KEYSTORE} names a folder, false",
        _secured,
        ros=True,
    ),
    Variable("ROS_LOG_DIR", "Folder for the logs of nodes that are started one by one", ros=True),
)


def begin() -> None:
    """Begin a process of the bench: nothing is read from the current folder, and no warning of a library ends it.

    Child processes inherit it.

    Raises
    ------
    InputError
        If a variable has a value with which nothing works.
    """
    os.environ[_SAFE] = "1"  # a Python that is started with -m has the current folder first in its path
    os.environ.setdefault(
        "OPENBLAS_NUM_THREADS", "1"
    )  # to share small matrices costs more than to compute them
    os.environ["MPLBACKEND"] = "agg"  # pictures are files: no name of a window system is looked up
    if any(own[0] == "error" for own in warnings.filters):
        os.environ.pop("PYTHONWARNINGS", None)
        warnings.simplefilter("ignore")
    _require(own for own in VARIABLES if not own.ros)


@contextlib.contextmanager
def ignored_here(name: str) -> Iterator[bool]:
    """Have a library that is imported in the block not find its settings of this name in the current folder.

    In other people's processes, where Python itself imports from that folder, it finds them as usual.

    Yields
    ------
    bool
        Whether they are ignored.
    """
    if not (sys.flags.safe_path or os.environ.get(_SAFE)):
        yield False
        return
    os.path.exists = lambda path: path != name and _exists(path)
    try:
        yield True
    finally:
        os.path.exists = _exists


def require_ros() -> None:
    """Refuse a variable with which ROS does not work; before rclpy is imported, which would end the process.

    Raises
    ------
    InputError
        It names the variable, its value, and what is allowed.
    """
    _require(own for own in VARIABLES if own.ros)


def _require(variables: Iterable[Variable]) -> None:
    for own in variables:
        value = os.environ.get(own.name, "")
        if value and not own.works(value):
            raise InputError(f"{own.name}: {value[:40]!r} is not allowed; allowed: {own.allowed}")


def prepare_environment() -> None:
    """Set what the middleware reads from the environment, unless the user has set it; before `rclpy.init`.

    Discovery stays on this computer. Fast DDS does so with the settings of ``config/fastdds.xml``; by the range
    ``LOCALHOST`` its ROS layer would add sockets on the other interfaces. Fast DDS does not look for settings in
    the current folder.

    Raises
    ------
    InputError
        As `require_ros`.
    """
    require_ros()
    os.environ.setdefault(_NO_XML, "1")
    ours = os.environ.setdefault(_RANGE, "LOCALHOST") == "LOCALHOST"
    if ours and _PROFILES not in os.environ and "fastrtps" in os.environ.get(_MIDDLEWARE, "fastrtps"):
        os.environ[_PROFILES] = str(resources.files("gyrowheel_core").joinpath("config/fastdds.xml"))
        os.environ[_RANGE] = "SYSTEM_DEFAULT"  # as in the file
