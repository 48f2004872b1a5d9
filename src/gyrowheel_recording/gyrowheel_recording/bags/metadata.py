"""``metadata.yaml``, which makes a directory a recording, for rosbag2: files and their identity, topics, publishers."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePath
from typing import Any, Final, Literal

import yaml

from gyrowheel_core import topics
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import read_errors, read_text, write_text
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


#: Entry of the metadata's ``custom_data``.
ENTRY: Final = "gyrowheel.publishers"
_SHARED: Final = frozenset(topic.name for topic in topics.TOPICS if topic.shared)
_MOST: Final = 1000  # publishers that are read
_LONGEST_ENTRY: Final = 300  # text of an entry [characters]


@dataclass(frozen=True)
class Publisher:
    """A publisher of a topic."""

    topic: str
    gid: str  # its global identifier in the middleware, in hexadecimal digits; empty where it was never seen
    node: str  # full name of its node; empty where unknown
    messages: int | None = None  # how many of the recorded messages are its own; None where that is not known


@dataclass
class _Series:
    """Messages that one publisher has counted through."""

    last: int
    count: int = 0
    gid: str = ""


class Division:
    """Divides the messages of a topic among its publishers, of which `look` returns pairs of GID and node.

    The middleware does not report who sent a message, but every publisher numbers its own: a message that continues
    the numbers of a publisher belongs to it. `unknown` is set once two publishers have reached the same number, or
    some messages were not added.
    """

    def __init__(self, topic: str, look: Callable[[], Sequence[tuple[str, str]]]) -> None:
        self._topic, self._look = topic, look
        self.unknown = False
        self._series: list[_Series] = []

    def add(self, number: int) -> None:
        """Count a message by the number that its publisher gave it."""
        fitting = [series for series in self._series if number == series.last + 1]
        if len(fitting) > 1:  # from here on they could be exchanged
            self.unknown = True
        series = fitting[0] if fitting else self._find(number)
        series.last = number
        series.count += 1

    def result(self) -> list[Publisher]:
        """Return the publishers; counts are left out where it is not known whose they are."""
        known = dict(self._look())
        nameless = [series for series in self._series if not series.gid]
        free = self._free(known)
        if len(nameless) == len(free) == 1:
            nameless[0].gid, nameless = free[0], []
        if self.unknown or nameless:
            unseen = max(len(nameless) - len(free), 0)  # came and went between two looks
            nodes = [*known.items(), *[("", "")] * unseen]
            return [Publisher(self._topic, gid, node) for gid, node in nodes]
        counts = {series.gid: series.count for series in self._series}
        return [Publisher(self._topic, gid, node, counts.get(gid, 0)) for gid, node in known.items()]

    def _find(self, number: int) -> _Series:
        """Return the series of a message that continues none: a new one, or one with a gap."""
        known = [gid for gid, _ in self._look()]
        before = [series for series in self._series if series.last < number]
        if before and len(self._series) >= len(known):  # messages in between were lost
            return max(before, key=lambda series: series.last)
        free = self._free(known)
        self._series.append(_Series(number, gid=free[0] if len(free) == 1 else ""))
        return self._series[-1]

    def _free(self, known: Sequence[str] | Mapping[str, str]) -> list[str]:
        taken = {series.gid for series in self._series}
        return [gid for gid in known if gid not in taken]


class Source:
    """Tells the samples of the run that is recorded from those of other publishers.

    A run is known by its first sample, or by a publisher that replaces the one before. Its publisher numbers
    messages and samples alike, so that both numbers advance together; samples of another publisher do not fit. As
    long as no other publisher was seen, every sample belongs to the run. `look` returns pairs of GID and node of
    all publishers that the topic has had, `present` the GIDs of those that are there now.
    """

    def __init__(
        self, look: Callable[[], Sequence[tuple[str, str]]], present: Callable[[], Collection[str]]
    ) -> None:
        self._look, self._present = look, present
        self._last: tuple[int, int] | None = None  # number and sequence of its last sample
        self._gid = ""  # of its publisher; empty where there were several from the beginning
        self._count = 0
        self._unknown = False  # whose some of the messages are

    def of(self, number: int | None, sequence: int) -> Literal["own", "repeated", "other", "again"]:
        """Return whose a sample is: the run's own, a repetition, of another publisher, or the first of another run.

        `number` is the number that its publisher gave the message; None where it is not known: then every sample is
        the run's own.
        """
        if number is None:
            self._unknown = True
            return "own"
        if self._last is None:
            known = self._look()
            self._gid = known[0][0] if len(known) == 1 else ""
        elif (number, sequence) == (self._last[0] + 1, self._last[1]):  # for a node that has come since
            self._last = number, sequence
            return "repeated"
        elif number != self._last[0] + 1 and self._is_replaced():
            return "again"
        elif not self._goes_on(number, sequence):
            if len(self._look()) > 1:
                return "again" if sequence == 0 and not self._gid and len(self._present()) < 2 else "other"
            if sequence == 0:
                return "again"
        elif sequence == 0:
            return "again"
        self._last = number, sequence
        self._count += 1
        return "own"

    def result(self, topic: str) -> list[Publisher]:
        """Return the publishers; all messages in the recording are those of the run's own."""
        known = dict(self._look())
        told = not self._unknown and (self._gid in known or len(known) == 1)
        own = self._gid if self._gid in known else next(iter(known), "")
        counts = {gid: self._count if gid == own else 0 for gid in known}
        return [Publisher(topic, gid, node, counts[gid] if told else None) for gid, node in known.items()]

    def _is_replaced(self) -> bool:
        """Whether the publisher of the run is gone and another one there, whose first samples may have been lost."""
        return bool(self._gid) and len(self._look()) > 1 and self._gid not in self._present()

    def _goes_on(self, number: int, sequence: int) -> bool:
        """Whether a sample follows the last one by its numbers, be it that some between them were lost."""
        assert self._last is not None
        later = number - self._last[0]
        return later == 1 or (later > 1 and sequence - self._last[1] == later)


def to_text(publishers: Sequence[Publisher]) -> str:
    """Return publishers as the metadata keeps them."""
    return json.dumps([asdict(publisher) for publisher in publishers[:_MOST]])


def from_text(text: str, where: str) -> tuple[Publisher, ...]:
    """Return the publishers that metadata states.

    Raises
    ------
    InputError
        If the text is not what `to_text` writes.
    """
    try:
        content = json.loads(text)
        if not isinstance(content, list) or len(content) > _MOST:
            raise TypeError
        found = tuple(Publisher(**entry) for entry in content)
    except (ValueError, TypeError, RecursionError):
        raise InputError(f"{where}: {ENTRY}: not a list of publishers") from None
    for publisher in found:
        texts = (publisher.topic, publisher.gid, publisher.node)
        count = publisher.messages
        if not all(isinstance(t, str) and len(t) <= _LONGEST_ENTRY and t.isprintable() for t in texts):
            raise InputError(f"{where}: {ENTRY}: not the name of a publisher")
        if count is not None and (not isinstance(count, int) or isinstance(count, bool) or count < 0):
            raise InputError(f"{where}: {ENTRY}: messages: {count!r}; allowed: a number from 0 on")
    return found


def surplus(publishers: Sequence[Publisher]) -> dict[str, list[Publisher]]:
    """Return the publishers of each topic that has several, where the bench has one."""
    by_topic: dict[str, list[Publisher]] = {}
    for publisher in publishers:
        if publisher.topic not in _SHARED:
            by_topic.setdefault(publisher.topic, []).append(publisher)
    return {topic: several for topic, several in by_topic.items() if len(several) > 1}


#: Endings of the files that a recording is made of; others in its folder are not read.
_ENDINGS = (".yaml", ".mcap", ".db3", ".zstd")
_LOGS = ("-wal", "-journal")  # next to a database that was not closed, which is read with them


@dataclass(frozen=True)
class FileState:
    """A file of a recording at one instant; any change of the file changes it."""

    path: Path  # absolute
    name: str  # in the folder of the recording
    size: int  # bytes
    #: Device, inode, and the times of the last change of its content and of its inode [ns].
    state: tuple[int, int, int, int]


@dataclass(frozen=True)
class HashedFile:
    """A file of a recording with the SHA-256 of its content."""

    name: str
    size: int  # bytes
    sha256: str


def files_of(recording: Path) -> tuple[FileState, ...]:
    """Return the files of which a recording is made, as they are now; those that are not there are left out."""
    place = recording.absolute()
    with read_errors(recording):
        if place.is_dir():
            names = [own.name for own in os.scandir(place) if own.name.endswith((*_ENDINGS, *_LOGS))]
        else:
            names, place = [place.name, *(f"{place.name}{end}" for end in _LOGS)], place.parent
        return tuple(_state(place, name) for name in sorted(names) if (place / name).is_file())


def same(before: Sequence[FileState], recording: Path) -> bool:
    """Return whether the files of a recording are still in the states that they were in before."""
    return set(before) <= set(files_of(recording))


def _state(folder: Path, name: str) -> FileState:
    path = folder / name
    found = path.stat()
    # SQLite sets the owner of a log that it opens, which changes the inode
    changed = found.st_mtime_ns if name.endswith(_LOGS) else found.st_ctime_ns
    return FileState(path, name, found.st_size, (found.st_dev, found.st_ino, found.st_mtime_ns, changed))


def hashed(files: Sequence[FileState]) -> tuple[HashedFile, ...]:
    """Return files with their hashes.

    Raises
    ------
    InputError
        If a file cannot be read, or is not in that state, before or after it was hashed.
    """
    found = []
    for own in files:
        with read_errors(own.path), own.path.open("rb") as stream:
            opened = os.fstat(stream.fileno())
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            now = _state(own.path.parent, own.path.name)
        if now != own or (opened.st_dev, opened.st_ino) != own.state[:2]:
            raise InputError(f"{own.path}: was changed while it was read")
        found.append(HashedFile(own.name, own.size, digest))
    return tuple(found)
