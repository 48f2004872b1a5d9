"""Files for viewers: the model of the wheel, and layouts of RViz, PlotJuggler and Foxglove."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Final

from gyrowheel_core.errors import InputError

_PACKAGE: Final = "gyrowheel_bringup"


def share_file(name: str) -> Path:
    """Return a file of the package's share folder as installed, else that of the source tree.

    Raises
    ------
    InputError
        If it does not exist.
    """
    prefixes = [sys.prefix, *filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))]
    folders = [Path(prefix) / "share" / _PACKAGE for prefix in prefixes]
    folders.append(Path(__file__).resolve().parents[1])
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    raise InputError(f"{name}: not installed; it belongs to the package {_PACKAGE}")


def robot_description() -> str:
    """Return the URDF of the wheel."""
    return share_file("urdf/gyrowheel.urdf").read_text(encoding="utf-8")


def rviz_config() -> Path:
    """Return the file with the settings of RViz."""
    return share_file("config/gyrowheel.rviz")
