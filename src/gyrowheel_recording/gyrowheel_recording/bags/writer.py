"""Writing of recordings: rosbag2 directories as ROS 2 Jazzy writes them."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from gyrowheel_core import topics, wire
from gyrowheel_core.arrays import picked
from gyrowheel_core.errors import InputError
from gyrowheel_core.topics import Topic
from gyrowheel_recording.bags.columns import definition
from gyrowheel_recording.bags.mcap.writer import Block, McapWriter
from gyrowheel_recording.bags.metadata import (
    BagFile,
    bag_metadata,
    metadata_text,
    qos_profiles,
    write_metadata,
)

_LIVE_CHUNK: Final = 1 << 16  # bytes
#: Bench time in one chunk [s]: a killed process loses this and the time between two flushes, a flipped bit this.
_SPAN: Final = 0.1
_TOGETHER: Final = 1 << 17  # samples of a run that are written at once
_RESERVE: Final = 1 << 18  # bytes; steps in which the reserve grows
_RESERVE_FILE: Final = ".reserve"


class RecordingWriter:
    """Writes a recording.

    Parameters
    ----------
    directory : str or Path
        To create; it must not exist, or be empty.
    chunk_size : int
        Bytes that are collected before they go to the disk. What is on the disk survives a killed process, but
        the recording is not complete then.
    chunk_span : float
        Bench time that is collected before it goes to the disk [s].
    max_size : int
        File size at which the next file begins [bytes]; 0: no limit.
    max_duration : float
        Bench time after which the next file begins [s]; 0: no limit.
    reserve : bool
        Whether to reserve disk space so that the recording can be completed on a full disk. The reserve is a hidden
        file of about 256 kB in the directory; it is removed when the recording is complete.
    namespace : str
        Namespace of the topics: empty for the root, else such as ``/bench2``.

    Raises
    ------
    InputError
        If the directory exists and is not empty, or cannot be made.

    Notes
    -----
    As a context manager it completes the recording at the end, and leaves it incomplete (without
    ``metadata.yaml`` and the end of its file) after an exception. Every method raises `InputError` if the
    disk refuses a write; after that only `rescue` and `abort` may be called.
    """

    _mcap: McapWriter  # of the current file
    _chunks_before: int  # of it, at the last `flush_old`

    def __init__(
        self,
        directory: str | Path,
        *,
        chunk_size: int = _LIVE_CHUNK,
        chunk_span: float = _SPAN,
        max_size: int = 0,
        max_duration: float = 0.0,
        reserve: bool = False,
        namespace: str = "",
    ) -> None:
        self.path = Path(directory)
        self.counts: dict[str, int] = {}  # messages written, by topic
        #: Further entries of rosbag2's metadata; may be set until the recording is completed.
        self.custom_data: dict[str, str] = {}
        self._namespace = namespace
        self._chunk_size = chunk_size
        self._chunk_span = round(chunk_span * wire.SECOND)
        self._max_size = max_size
        self._max_duration = round(max_duration * wire.SECOND)
        self._begun: int | None = None  # time of the first message of the current file [ns]
        self._reserved = 0 if reserve else -1  # bytes; -1: no reserve is wanted
        self._topics: dict[str, Topic] = {}
        self._channels: dict[str, int] = {}  # of the current file, by topic
        self._files: list[BagFile] = []  # completed
        self._written: dict[str, int] = {}  # messages in them, by topic
        with _disk_errors(self.path):
            if self.path.exists() and not (self.path.is_dir() and not any(self.path.iterdir())):
                other = "another recorder is writing into it" if being_written(self.path) else "exists"
                raise InputError(f"{self.path}: {other}; a recording needs a new directory")
            self.path.mkdir(parents=True, exist_ok=True)
        self._open()

    def write(self, topic: Topic, data: bytes, stamp_ns: int) -> None:
        """Write one message at its time on the clock of the bench [ns], not negative."""
        if self._begun is None:
            self._begun = stamp_ns
        elif (self._max_duration and stamp_ns - self._begun >= self._max_duration) or (
            self._max_size and self._mcap.size >= self._max_size
        ):
            self.split()
            self._begun = stamp_ns
        channel = self._channels.get(topic.name) or self._add(topic)
        with _disk_errors(self.path):
            self._mcap.append(channel, stamp_ns, data)
        self.counts[topic.name] += 1

    def write_columns(
        self, columns: Iterable[tuple[Topic, npt.NDArray[np.int64], npt.NDArray[Any] | Sequence[bytes]]]
    ) -> None:
        """Write many messages of several topics, merged in the order of time.

        `columns`: topic, times [ns] and serialized messages: an array of the topic's layout, or bytes for
        each. At equal times, messages are in the order of the topics.
        """
        blocks = []
        for topic, times, messages in columns:
            channel = self._channels.get(topic.name) or self._add(topic)
            self.counts[topic.name] += len(times)
            order = np.argsort(times, kind="stable")
            if isinstance(messages, np.ndarray):
                blocks.append(Block(channel, times[order], picked(messages, order)))
                continue
            sizes = np.array([len(message) for message in messages], dtype=np.int64)[order]
            for size in np.unique(sizes):
                some = order[sizes == size]
                data = b"".join(messages[k] for k in some)
                blocks.append(Block(channel, times[some], np.frombuffer(data, f"V{size}")))
        with _disk_errors(self.path):
            self._mcap.append_blocks(blocks)

    def flush(self) -> None:
        """Send collected messages to the disk, and check that the file still exists."""
        with _disk_errors(self.path):
            self._mcap.flush()
        self._check()

    def flush_old(self) -> None:
        """Send to the disk what has waited since the last call, and check that the file still exists.

        Called again and again, it does not cut chunks that become full soon; what comes too slowly for that
        waits for two periods at most.
        """
        if self._mcap.chunks == self._chunks_before:
            with _disk_errors(self.path):
                self._mcap.flush()
        self._chunks_before = self._mcap.chunks
        self._check()

    def split(self) -> None:
        """Complete the current file and go on in a new one of the same recording."""
        self._complete_file()
        self._open()

    def close(self) -> None:
        """Complete the recording."""
        self._drop_reserve()
        if not self._file_complete:
            self._complete_file()
        with _disk_errors(self.path):
            write_metadata(self.path, self._metadata(self._files))

    def rescue(self) -> bool:
        """After a disk error: complete the recording as far as it was written.

        Returns
        -------
        bool
            Whether this succeeded; if not, the recording is left incomplete, as by `abort`.
        """
        self._drop_reserve()
        try:
            if not self._file_complete:
                self._mcap.drop()
                self._check_place()
                self.counts = {name: self._in_files(name) for name in self.counts}
            self.close()
        except InputError:
            self.abort()
            return False
        return True

    def abort(self) -> None:
        """Close the files and leave the recording incomplete."""
        self._drop_reserve()
        self._mcap.abort()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
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
        self._begun = None
        self._chunks_before = 0
        with _disk_errors(self.path):
            self._mcap = McapWriter(
                self.path / self._name, chunk_size=self._chunk_size, chunk_span=self._chunk_span
            )
        self._keep_reserve()

    def _check(self) -> None:
        self._check_place()
        self._keep_reserve()

    def _check_place(self) -> None:
        file = self.path / self._name
        if not self._mcap.is_there(file):
            raise InputError(f"{file}: was moved or deleted while it was recorded")
        with _disk_errors(file):
            self._mcap.require_length()

    def _keep_reserve(self) -> None:
        """Reserve the disk space that completing the recording takes."""
        if self._reserved < 0 or self._mcap.tail_size + _RESERVE // 2 <= self._reserved:
            return
        size = -(-(self._mcap.tail_size + _RESERVE) // _RESERVE) * _RESERVE
        with _disk_errors(self.path), (self.path / _RESERVE_FILE).open("ab", buffering=0) as file:
            os.posix_fallocate(file.fileno(), 0, size)
        self._reserved = size

    def _drop_reserve(self) -> None:
        if self._reserved > 0:
            with contextlib.suppress(OSError):
                (self.path / _RESERVE_FILE).unlink()
            self._reserved = -1

    @property
    def _file_complete(self) -> bool:
        """Whether the current file is complete and the next one could not be created."""
        return bool(self._files) and self._files[-1].name == self._name

    def _in_files(self, name: str) -> int:
        """Return the number of messages of a topic that are on the disk."""
        channel = self._channels.get(name)
        return self._written.get(name, 0) + (0 if channel is None else self._mcap.counts[channel])

    def _add(self, topic: Topic) -> int:
        known = definition(topic.type_name)
        metadata = {
            "offered_qos_profiles": metadata_text(qos_profiles(topic)),
            "topic_type_hash": known.type_hash,
        }
        channel = self._mcap.add_channel(topic.within(self._namespace), topic.type_name, known.text, metadata)
        self._channels[topic.name] = channel
        self._topics[topic.name] = topic
        self.counts.setdefault(topic.name, 0)
        return channel

    def _complete_file(self) -> None:
        mcap = self._mcap
        with _disk_errors(self.path):
            mcap.flush()
            file = BagFile(self._name, mcap.start, mcap.end, sum(mcap.counts.values()))
            mcap.finish(metadata_text(self._metadata([*self._files, file])))
        self._written = {name: self._in_files(name) for name in self.counts}
        self._channels.clear()
        self._files.append(file)

    def _metadata(self, files: Sequence[BagFile]) -> dict[str, Any]:
        """Return rosbag2's description of the recording as it is after `files`."""
        return bag_metadata(
            files,
            [
                (
                    {
                        "name": topic.within(self._namespace),
                        "type": topic.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": qos_profiles(topic),
                        "type_description_hash": definition(topic.type_name).type_hash,
                    },
                    self.counts[topic.name],
                )
                for topic in self._topics.values()
            ],
            self.custom_data,
        )


def being_written(path: Path) -> bool:
    """Whether a process on this machine is writing this recording: a directory or one of its files."""
    files = path.glob("*.mcap") if path.is_dir() else [path]
    for file in files:
        try:
            opened = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe would be waited for
        except OSError:  # the file cannot be read
            continue
        try:
            fcntl.flock(opened, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # the file system has no locks
            continue
        finally:
            os.close(opened)
    return False


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
    stamps: npt.NDArray[np.int64] | None = None,
) -> Path:
    """Write a closed-loop run as the recorder would have written it.

    Parameters
    ----------
    directory : str or Path
        To create; it must not exist, or be empty. Nothing is left in it after an error.
    measurement : ndarray, shape (n, 11)
        Readings, columns as in the Measurement message [SI]; sample k has the sequence k.
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
    stamps : ndarray of int64, shape (n,), optional
        Stamps of the samples [ns]; sample k is at k periods if not given.

    Returns
    -------
    Path
        The directory.

    Raises
    ------
    InputError
        If the directory exists and is not empty, or the disk refuses the recording.
    """
    if stamps is None:
        stamps = np.arange(len(measurement), dtype=np.int64) * round(sample_period * wire.SECOND)
    kept = np.arange(len(measurement)) if arrived is None else np.flatnonzero(arrived)
    estimates = list(drag_estimates)
    first = np.zeros(1, dtype=np.int64)

    path = Path(directory)
    existed = path.exists()
    writer = RecordingWriter(path)
    try:
        with writer:
            writer.write_columns(
                [
                    (topics.BENCH, first, [wire.pack_text(bench)]),
                    (topics.ENVIRONMENT, first, [wire.pack_text(environment)]),
                ]
            )
            times = (
                setpoints["stamp_ns"].astype(np.int64),
                stamps[kept],
                stamps[: len(command)],
                np.array([stamp for stamp, _ in estimates], dtype=np.int64),
            )
            # the messages of hours at once take several times the memory of the run
            for asked, read, answered, estimated in _spans(times):
                targets = {name: setpoints[name][asked] for name in wire.SETPOINT.names}
                readings = dict(zip(wire.MEASUREMENT.fields, measurement[kept[read]].T, strict=True))
                volts = dict(zip(wire.COMMAND.fields, command[answered].T, strict=True))
                writer.write_columns(
                    [
                        _messages(topics.SETPOINT, wire.SETPOINT, times[0][asked], targets),
                        _messages(
                            topics.MEASUREMENT, wire.MEASUREMENT, times[1][read],
                            {"sequence": kept[read], **readings},
                        ),
                        _messages(
                            topics.COMMAND, wire.COMMAND, times[2][answered],
                            {"measurement_sequence": answered, **volts},
                        ),
                        (topics.DRAG_ESTIMATE, times[3][estimated], [estimates[k][1] for k in estimated]),
                    ]
                )  # fmt: skip
    except BaseException:
        for file in path.iterdir():
            file.unlink()
        if not existed:
            path.rmdir()
        raise
    return path


def _spans(columns: Sequence[npt.NDArray[np.int64]]) -> Iterator[tuple[npt.NDArray[np.intp], ...]]:
    """Yield the rows of columns of times in the order of time, those of one span of time after the other."""
    orders = [
        None if np.all(times[1:] >= times[:-1]) else np.argsort(times, kind="stable") for times in columns
    ]
    ordered = [times if order is None else times[order] for times, order in zip(columns, orders, strict=True)]
    edges = np.unique(max(ordered, key=len)[_TOGETHER::_TOGETHER])
    places = [[0, *np.searchsorted(times, edges).tolist(), len(times)] for times in ordered]
    for part in zip(*map(itertools.pairwise, places), strict=True):
        yield tuple(
            np.arange(*own) if order is None else order[slice(*own)]
            for order, own in zip(orders, part, strict=True)
        )


def _messages(
    topic: Topic, layout: wire.Layout, stamps: npt.NDArray[np.int64], fields: Mapping[str, npt.NDArray[Any]]
) -> tuple[Topic, npt.NDArray[np.int64], npt.NDArray[Any]]:
    """Return the topic, the times and the serialized messages of columns of fields, as `write_columns` takes them."""
    messages = layout.array(len(stamps))
    layout.set_stamps(messages, stamps)
    for name, column in fields.items():
        messages[name] = column
    return topic, stamps, messages


@contextlib.contextmanager
def _disk_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{error.filename or path}: cannot be written: {error.strerror or error}") from None
