"""Writing of recordings: rosbag2 directories as ROS 2 Jazzy writes them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import yaml

from gyrowheel_analysis.recording.definitions import definition
from gyrowheel_analysis.recording.mcap_writer import Block, McapWriter
from gyrowheel_sim import topics, wire
from gyrowheel_sim.errors import InputError
from gyrowheel_sim.topics import Topic

#: Name of the file that makes a directory a recording; it is written last.
METADATA_FILE: Final = "metadata.yaml"
_VERSION: Final = 9  # of rosbag2's metadata in Jazzy
_FOREVER: Final = {"sec": 9223372036, "nsec": 854775807}
_LIVE_CHUNK: Final = 1 << 16  # bytes; what is lost when the process is killed
_COLUMN_CHUNK: Final = 1 << 20


@dataclass(frozen=True)
class _File:
    """A completed file of a recording."""

    name: str
    start: int
    end: int
    count: int


class RecordingWriter:
    """Writes a recording.

    Parameters
    ----------
    directory : str or Path
        To create; it must not exist, or be empty.
    chunk_size : int
        How many bytes are collected before they go to the disk. What has gone there survives a killed
        process, though not as a complete recording.

    Attributes
    ----------
    path : Path
        The directory.
    counts : dict of str to int
        Messages written, by topic.

    Raises
    ------
    InputError
        If the directory exists and is not empty, or cannot be made.

    Notes
    -----
    As a context manager it completes the recording at the end, and leaves it incomplete (without
    ``metadata.yaml`` and the end of its file) after an exception. Every method raises `InputError` where the
    disk does not take what is written; then `abort` is all that is left to do.
    """

    def __init__(self, directory: str | Path, *, chunk_size: int = _LIVE_CHUNK) -> None:
        self.path = Path(directory)
        self.counts: dict[str, int] = {}
        self._chunk_size = chunk_size
        self._topics: dict[str, Topic] = {}
        self._channels: dict[str, int] = {}  # of the current file, by topic
        self._files: list[_File] = []  # completed
        if self.path.exists() and not (self.path.is_dir() and not any(self.path.iterdir())):
            raise InputError(f"{self.path}: exists; a recording needs a new directory")
        with _disk_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
        self._open()

    def write(self, topic: Topic, data: bytes, stamp_ns: int) -> None:
        """Write one message.

        Parameters
        ----------
        topic : Topic
            Its topic.
        data : bytes
            The serialized message.
        stamp_ns : int
            Time of the message on the clock of the bench [ns]; not negative.
        """
        channel = self._channels.get(topic.name) or self._add(topic)
        with _disk_errors(self.path):
            self._mcap.append(channel, stamp_ns, data)
        self.counts[topic.name] += 1

    def write_columns(
        self, columns: Iterable[tuple[Topic, npt.NDArray[np.int64], npt.NDArray[Any] | Sequence[bytes]]]
    ) -> None:
        """Write many messages of several topics, merged in the order of time.

        Parameters
        ----------
        columns : iterable of (Topic, ndarray of int64, ndarray or sequence of bytes)
            Topic, times [ns] and serialized messages: an array of the topic's layout, or bytes for each.
            Topics that come first stand first among messages of the same time.
        """
        blocks = []
        for topic, times, messages in columns:
            channel = self._channels.get(topic.name) or self._add(topic)
            self.counts[topic.name] += len(times)
            order = np.argsort(times, kind="stable")
            if isinstance(messages, np.ndarray):
                # as plain bytes: indexing a structured array would fill its padding with whatever memory holds
                whole = messages.view(f"V{messages.dtype.itemsize}")
                blocks.append(Block(channel, times[order], whole[order].view(messages.dtype)))
                continue
            sizes = np.array([len(message) for message in messages], dtype=np.int64)[order]
            for size in np.unique(sizes):
                some = order[sizes == size]
                data = b"".join(messages[k] for k in some)
                blocks.append(Block(channel, times[some], np.frombuffer(data, f"V{size}")))
        with _disk_errors(self.path):
            self._mcap.append_blocks(blocks)

    def flush(self) -> None:
        """Send to the disk what has been collected."""
        with _disk_errors(self.path):
            self._mcap.flush()

    def split(self) -> None:
        """Complete the current file and go on in a new one of the same recording."""
        self._complete_file()
        self._open()

    def close(self) -> None:
        """Complete the recording."""
        self._complete_file()
        text = _yaml({"rosbag2_bagfile_information": self._metadata(self._files)})
        temporary = self.path / f".{METADATA_FILE}"
        with _disk_errors(self.path):
            temporary.write_text(text, encoding="utf-8")
            temporary.replace(self.path / METADATA_FILE)

    def abort(self) -> None:
        """Close the files and leave the recording incomplete."""
        self._mcap.abort()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self.abort()
            return
        try:
            self.close()
        except BaseException:
            self.abort()
            raise

    def _open(self) -> None:
        self._channels.clear()
        self._name = f"{self.path.absolute().name}_{len(self._files)}.mcap"
        with _disk_errors(self.path):
            self._mcap = McapWriter(self.path / self._name, chunk_size=self._chunk_size)

    def _add(self, topic: Topic) -> int:
        known = definition(topic.type_name)
        metadata = {"offered_qos_profiles": _yaml(_qos(topic)), "topic_type_hash": known.type_hash}
        channel = self._mcap.add_channel(topic.name, topic.type_name, known.text, metadata)
        self._channels[topic.name] = channel
        self._topics[topic.name] = topic
        self.counts.setdefault(topic.name, 0)
        return channel

    def _complete_file(self) -> None:
        mcap = self._mcap
        with _disk_errors(self.path):
            mcap.flush()
            file = _File(self._name, mcap.start, mcap.end, sum(mcap.counts.values()))
            mcap.finish(_yaml(self._metadata([*self._files, file])))
        self._files.append(file)

    def _metadata(self, files: Sequence[_File]) -> dict[str, Any]:
        """Return rosbag2's description of the recording as it is after `files`."""
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
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": _qos(topic),
                        "type_description_hash": definition(topic.type_name).type_hash,
                    },
                    "message_count": self.counts[topic.name],
                }
                for topic in self._topics.values()
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
            "custom_data": None,
            "ros_distro": "jazzy",
        }


def write_run(
    directory: str | Path,
    measurement: npt.NDArray[np.float64],
    command: npt.NDArray[np.float64],
    setpoints: npt.NDArray[Any],
    environment: str,
    bench: str,
    *,
    sample_period: float,
    drag_estimates: Iterable[tuple[int, bytes]] = (),
    arrived: npt.NDArray[np.bool_] | None = None,
) -> Path:
    """Write what a closed-loop run gave, as the recorder would have written it.

    Parameters
    ----------
    directory : str or Path
        To create; it must not exist, or be empty. Nothing is left in it after an error.
    measurement : ndarray, shape (n, 11)
        Readings, columns as in the Measurement message [SI]; sample k has the sequence k, at k periods.
    command : ndarray, shape (m, 3)
        Commands [V]; row k answers sample k; m <= n.
    setpoints : structured ndarray
        Setpoints: ``stamp_ns`` and the fields of the Setpoint message.
    environment, bench : str
        Texts of the topics ``/gyrowheel/environment`` and ``/gyrowheel/bench``.
    sample_period : float
        Time between two samples [s].
    drag_estimates : iterable of (int, bytes)
        Time [ns] and serialized message of each DragEstimate.
    arrived : ndarray of bool, shape (n,), optional
        Which samples reach the recording; all of them if not given.

    Returns
    -------
    Path
        The directory.

    Raises
    ------
    InputError
        If the directory exists and is not empty, or the disk does not take the recording.
    """
    stamps = np.arange(len(measurement), dtype=np.int64) * round(sample_period * wire.SECOND)
    # filled from the start: picking messages out would copy the fields and not what is between them
    kept = np.arange(len(measurement)) if arrived is None else np.flatnonzero(arrived)
    readings = _messages(wire.MEASUREMENT, stamps[kept])
    readings["sequence"] = kept
    for name, column in zip(wire.MEASUREMENT.fields, measurement[kept].T, strict=True):
        readings[name] = column
    commands = _messages(wire.COMMAND, stamps[: len(command)])
    commands["measurement_sequence"] = np.arange(len(commands))
    for name, column in zip(wire.COMMAND.fields, command.T, strict=True):
        commands[name] = column
    targets = _messages(wire.SETPOINT, setpoints["stamp_ns"])
    for name in (*wire.SETPOINT.integers, *wire.SETPOINT.fields):
        targets[name] = setpoints[name]
    estimates = list(drag_estimates)
    first = np.zeros(1, dtype=np.int64)

    path = Path(directory)
    existed = path.exists()
    writer = RecordingWriter(path, chunk_size=_COLUMN_CHUNK)
    try:
        with writer:
            writer.write_columns(
                [
                    (topics.BENCH, first, [wire.pack_text(bench)]),
                    (topics.ENVIRONMENT, first, [wire.pack_text(environment)]),
                    (topics.SETPOINT, setpoints["stamp_ns"].astype(np.int64), targets),
                    (topics.MEASUREMENT, stamps[kept], readings),
                    (topics.COMMAND, stamps[: len(command)], commands),
                    (
                        topics.DRAG_ESTIMATE,
                        np.array([stamp for stamp, _ in estimates], dtype=np.int64),
                        [data for _, data in estimates],
                    ),
                ]
            )
    except BaseException:
        for file in path.iterdir():
            file.unlink()
        if not existed:
            path.rmdir()
        raise
    return path


def _messages(layout: wire.Layout, stamps: npt.NDArray[np.int64]) -> npt.NDArray[Any]:
    messages = layout.array(len(stamps))
    layout.set_stamps(messages, stamps)
    return messages


def _qos(topic: Topic) -> list[dict[str, Any]]:
    """Return the quality of service of a topic as rosbag2 writes it."""
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


def _yaml(value: Any) -> str:
    return yaml.safe_dump(value, sort_keys=False)


@contextlib.contextmanager
def _disk_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{error.filename or path}: cannot be written: {error.strerror or error}") from None
