"""``metadata.yaml``, which makes a directory a recording: rosbag2's description of its files and topics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any, Final

import yaml

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import read_text, write_text
from gyrowheel_core.topics import Topic
from gyrowheel_core.yaml_text import read_yaml

#: Name of the file; it is written last.
METADATA_FILE: Final = "metadata.yaml"
#: The one key of the file.
HEADING: Final = "rosbag2_bagfile_information"
_VERSION: Final = 9  # of rosbag2's metadata in Jazzy
_FOREVER: Final = {"sec": 9223372036, "nsec": 854775807}
_COMPRESSIONS: Final = ("none", "file", "message", "storage")
_STORAGES: Final = ("mcap", "sqlite3")


@dataclass(frozen=True)
class Metadata:
    """Content of ``metadata.yaml``."""

    files: list[str]  # their names, in order
    count: int  # messages in all of them
    end: int | None  # largest log time [ns]; None where it is not stated
    storage: str  # ``mcap`` or ``sqlite3``
    #: What is compressed: ``none``, ``file``, ``message`` or, by the storage itself, ``storage``.
    compression: str
    compression_format: str  # format of the compression; empty where nothing is compressed
    custom: dict[str, str] = field(default_factory=dict)  # further entries

    def require_readable(self, file: Path) -> None:
        """Refuse metadata that cannot be followed; the error names `file`.

        Raises InputError if a file is named twice, or the storage or the compression is not known.
        """
        if len(set(self.files)) != len(self.files):
            raise InputError(f"{file}: relative_file_paths: a file is named twice")
        if self.storage not in _STORAGES:
            allowed = ", ".join(_STORAGES)
            raise InputError(f"{file}: storage_identifier: {self.storage[:60]!r}; allowed: {allowed}")
        if self.compression not in _COMPRESSIONS:
            allowed = ", ".join(_COMPRESSIONS)
            raise InputError(f"{file}: compression_mode: {self.compression!r}; allowed: {allowed}")
        if self.compression in ("file", "message") and self.compression_format != "zstd":
            raise InputError(f"{file}: compression_format: {self.compression_format!r}; only zstd is known")


def read_metadata(file: Path) -> Metadata:
    """Read ``metadata.yaml``.

    Raises InputError if it cannot be read, or is not the metadata of a recording.
    """
    try:
        content = read_yaml(read_text(file), str(file))[HEADING]
        return Metadata(
            files=[PurePath(name).name for name in content["relative_file_paths"]],
            count=int(content["message_count"]),
            end=_end(content),
            storage=str(content["storage_identifier"]),
            compression=str(content.get("compression_mode") or "none").lower(),
            compression_format=str(content.get("compression_format") or ""),
            custom={str(key): str(value) for key, value in dict(content.get("custom_data") or {}).items()},
        )
    except InputError:
        raise
    except KeyError as error:
        raise InputError(f"{file}: {error.args[0]}: missing") from None
    except (TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"{file}: not the metadata of a recording ({one_line(error)})") from None


def _end(content: Mapping[str, Any]) -> int | None:
    """Return the largest log time [ns]; None if it is not stated."""
    try:
        start = int(content["starting_time"]["nanoseconds_since_epoch"])
        return start + int(content["duration"]["nanoseconds"])
    except (TypeError, ValueError, KeyError, OverflowError):
        return None


@dataclass(frozen=True)
class BagFile:
    """A completed file of a recording."""

    name: str
    #: Smallest and largest log time in it [ns].
    start: int
    end: int
    count: int


def bag_metadata(
    files: Sequence[BagFile], topics: Sequence[tuple[dict[str, Any], int]], custom_data: Mapping[str, str]
) -> dict[str, Any]:
    """Return the contents of ``metadata.yaml``; `topics` has rosbag2's metadata and message count of each."""
    filled = [file for file in files if file.count]
    start = min((file.start for file in filled), default=0)
    end = max((file.end for file in filled), default=0)
    return {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(file.count for file in files),
        "topics_with_message_count": [
            {"topic_metadata": topic, "message_count": count} for topic, count in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start},
                "duration": {"nanoseconds": file.end - file.start},
                "message_count": file.count,
            }
            for file in files
        ],
        "custom_data": dict(custom_data) or None,
        "ros_distro": "jazzy",
    }


def metadata_text(content: Any) -> str:
    """Return the metadata, or a part of it, as YAML; MCAP files carry the same text."""
    return yaml.safe_dump(content, sort_keys=False)


def write_metadata(directory: Path, metadata: dict[str, Any]) -> None:
    """Write ``metadata.yaml``, whole or not at all; raises InputError if the disk refuses it."""
    write_text(directory / METADATA_FILE, metadata_text({HEADING: metadata}))


def qos_profiles(topic: Topic) -> list[dict[str, Any]]:
    """Return the quality of service of a topic as rosbag2 states it."""
    return [
        {
            "history": "keep_last",
            "depth": topic.depth,
            "reliability": "reliable",
            "durability": "transient_local" if topic.latched else "volatile",
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }
    ]
