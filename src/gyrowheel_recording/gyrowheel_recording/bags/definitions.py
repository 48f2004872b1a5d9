"""Message definitions: the text and type hash that a recording carries for each of its topics."""

from __future__ import annotations

import functools
import os
import sys
from dataclasses import dataclass
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from gyrowheel_core.errors import InputError

_PACKAGE = "gyrowheel_msgs"
_SEPARATOR = "=" * 80


@dataclass(frozen=True)
class Definition:
    """Definition of one message type."""

    text: str  # its ``.msg`` file, followed by those of the types it contains (schema encoding ``ros2msg``)
    type_hash: str  # its ROS 2 type hash, ``RIHS01_...``


@functools.cache
def definition(type_name: str) -> Definition:
    """Return the definition of a message type of ROS 2 Jazzy or of gyrowheel_msgs.

    Raises
    ------
    InputError
        If the type is unknown, or gyrowheel_msgs is not installed.
    """
    store = typestore()
    if type_name not in store.fielddefs:
        files = "" if _message_files() else f" ({_PACKAGE} is not installed)"
        raise InputError(f"message type '{type_name}': unknown{files}")
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    own = _message_files().get(type_name)
    if own is not None:  # the file has comments with the units; the types it contains come from the store
        _, separator, rest = text.partition(f"{_SEPARATOR}\n")
        text = own.read_text(encoding="utf-8") + separator + rest
    return Definition(text, store.hash_rihs01(type_name))


def typestore() -> Typestore:
    """Return a new store of the types of ROS 2 Jazzy and, where it is installed, of gyrowheel_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, file in _message_files().items():
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), name))
    return store


@functools.cache
def _message_files() -> dict[str, Path]:
    """Return the installed ``.msg`` files of gyrowheel_msgs by type name.

    Both colcon and pip install them in ``share`` of a prefix. They need not be compiled.
    """
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    for prefix in prefixes:
        files = sorted(Path(prefix, "share", _PACKAGE, "msg").glob("*.msg"))
        if files:
            return {f"{_PACKAGE}/msg/{file.stem}": file for file in files}
    return {}
