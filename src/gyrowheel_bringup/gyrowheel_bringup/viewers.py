"""Files for viewers: the model of the wheel, and layouts of RViz, PlotJuggler and Foxglove."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Final

from gyrowheel_core import namespaces, topics
from gyrowheel_core.errors import InputError
from gyrowheel_core.topics import Topic

_PACKAGE: Final = "gyrowheel_bringup"
ROBOT_DESCRIPTION: Final = Topic("/robot_description", "std_msgs/msg/String", 1, latched=True)


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


def foxglove_layout(namespace: str = "") -> str:
    """Return the layout of Foxglove for a bench in a namespace, such as ``/bench2``; empty: the root."""
    namespace = namespaces.checked(namespace)
    text = share_file("config/foxglove_layout.json").read_text(encoding="utf-8")
    for topic in (*topics.TOPICS, ROBOT_DESCRIPTION):
        text = text.replace(f'"{topic.name}', f'"{topic.within(namespace)}')
    return text


def viewer_names(namespace: str) -> list[tuple[str, str]]:
    """Return the remappings of viewers in a namespace: pairs of what they ask for and the name there.

    They ask for some topics by absolute names; frames keep their names, on topics of each bench's own.
    """
    names = ("/clock", "/tf", "/tf_static", ROBOT_DESCRIPTION.name)
    return [(name, f"{namespace}{name}") for name in names] if namespace else []


def rviz_config() -> Path:
    """Return the file with the settings of RViz."""
    return share_file("config/gyrowheel.rviz")
