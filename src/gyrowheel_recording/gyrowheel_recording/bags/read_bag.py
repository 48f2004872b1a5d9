"""The messages of any ROS 2 bag, as rows or serialized; compressed files are unpacked into memory."""

from __future__ import annotations

import contextlib
import mmap
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, Final

import zstandard

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import is_file
from gyrowheel_core.limits import largest, require_room
from gyrowheel_recording.bags.mcap.reader import read_mcap
from gyrowheel_recording.bags.mcap.records import MOST_COMPRESSED, Broken, Damaged
from gyrowheel_recording.bags.mcap.topics import TopicData, Wanted
from gyrowheel_recording.bags.metadata import METADATA_FILE, Metadata, read_metadata
from gyrowheel_recording.bags.sqlite import is_database, read_database

_BLOCK = 1 << 20  # bytes


@contextlib.contextmanager
def file_in_memory(name: str) -> Iterator[tuple[BinaryIO, Path]]:
    """Yield an empty file that has no place on the disk, and a path by which this process can open it."""
    number = os.memfd_create(name[:200], os.MFD_CLOEXEC)
    with os.fdopen(number, "w+b", buffering=0) as file:
        yield file, Path(f"/proc/self/fd/{number}")


def unpack(source: BinaryIO, target: BinaryIO, name: Path) -> None:
    """Decompress a file (zstd) into `target`, which after an error has what could be unpacked before.

    Raises
    ------
    InputError
        If it unpacks to more than `limits.largest`, or to more than any recording can; it names `name`.
    zstandard.ZstdError
        If it is damaged.
    """
    limit, written = largest(), 0
    with zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True, closefd=False) as plain:
        while block := plain.read(_BLOCK):
            written += len(block)
            if written > limit:
                require_room(float("inf"), f"{name}: unpacked it")
            if written > MOST_COMPRESSED * max(source.tell(), _BLOCK):
                raise InputError(
                    f"{name}: unpacks to more than {MOST_COMPRESSED} times its size, as no recording does"
                )
            target.write(block)


_MESSAGE_LIMIT: Final = 1 << 28  # bytes of a decompressed message; more counts as damage


def read_bag(path: Path, wanted: Wanted) -> dict[str, TopicData]:
    """Read the messages of some topics of a bag, and count those of the others; return all topics by name.

    Parameters
    ----------
    path : Path
        A rosbag2 directory, or one ``.mcap`` or ``.db3`` file.
    wanted : mapping of str to Want or None
        Names of the topics to read, and how.

    Raises
    ------
    InputError
        If there is no such bag, or it is incomplete or damaged; where `salvage` may mend that, the message names it.
    """
    try:
        return _read(path, wanted)
    except Broken as error:
        raise InputError(f"{error}; gyrowheel salvage {path} -o DIR saves what can be read") from None


def _read(path: Path, wanted: Wanted) -> dict[str, TopicData]:
    if is_file(path):
        if path.suffix == ".mcap":
            return _merge(path, read_mcap(path, wanted))
        if path.suffix != ".db3" and not is_database(path):
            raise InputError(
                f"{path}: not a recording; allowed: a folder of a bag, or its .mcap or .db3 file"
            )
        return _merge(path, read_database(path, wanted))
    if not path.is_dir():
        raise InputError(
            f"{path}: {'is neither a directory nor a file' if path.exists() else 'no such recording'}"
        )
    file = path / METADATA_FILE
    if not file.is_file():
        begun = any(path.glob("*.mcap"))
        if begun:
            raise Broken(f"{path}: no {METADATA_FILE}: the recording was not completed")
        what = "the recording was not completed" if any(path.glob("*.db3")) else "this is no recording"
        raise InputError(f"{path}: no {METADATA_FILE}: {what}")
    metadata = read_metadata(file)
    metadata.require_readable(file)
    read = _read_file if metadata.storage == "mcap" else _read_database
    channels = [topic for name in metadata.files for topic in read(path / name, metadata, wanted)]
    found = sum(topic.count for topic in channels)
    if found != metadata.count:
        kind = Broken if metadata.storage == "mcap" and metadata.compression != "file" else InputError
        raise kind(f"{path}: {METADATA_FILE} counts {metadata.count} messages, but the files hold {found}")
    return _merge(path, channels)


def _read_file(file: Path, metadata: Metadata, wanted: Wanted) -> list[TopicData]:
    """Read one MCAP file of a bag."""
    if metadata.compression == "file":
        with _decompressed(file) as plain:
            try:
                return read_mcap(plain, wanted)
            except InputError as error:
                raise InputError(str(error).replace(str(plain), str(file))) from None
    return read_mcap(file, wanted, _decompress if metadata.compression == "message" else None)


def _read_database(file: Path, metadata: Metadata, wanted: Wanted) -> list[TopicData]:
    """Read one sqlite3 file of a bag."""
    if metadata.compression == "file":
        with file_in_memory(file.stem) as (plain, _):
            _unpack(file, plain)
            if not plain.tell():
                raise InputError(f"{file}: the file is empty")
            with mmap.mmap(plain.fileno(), 0) as mapped, memoryview(mapped) as content:
                return read_database(file, wanted, content=content)
    return read_database(file, wanted, _decompress if metadata.compression == "message" else None)


@contextlib.contextmanager
def _decompressed(file: Path) -> Iterator[Path]:
    """Give a decompressed copy of a file, in memory, that lasts as long as the block."""
    with file_in_memory(file.stem) as (plain, place):
        _unpack(file, plain)
        yield place


def _unpack(file: Path, target: BinaryIO) -> None:
    """Decompress a file."""
    try:
        if file.exists() and not file.is_file():  # a pipe would be waited for
            raise InputError(f"{file}: is no file")
        with file.open("rb") as source:
            unpack(source, target, file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
    except zstandard.ZstdError as error:
        raise InputError(f"{file}: damaged: cannot be decompressed ({one_line(error)})") from None


def _decompress(message: bytes) -> bytes:
    try:
        if zstandard.frame_content_size(message) > _MESSAGE_LIMIT:
            raise Damaged("damaged: a message claims more bytes than it can have")
        return zstandard.ZstdDecompressor().decompress(message, max_output_size=_MESSAGE_LIMIT)
    except (zstandard.ZstdError, MemoryError) as error:
        raise Damaged(f"damaged: a message cannot be decompressed ({error})") from None


def _merge(path: Path, channels: Iterable[TopicData]) -> dict[str, TopicData]:
    """Join the channels of each topic."""
    merged: dict[str, TopicData] = {}
    for channel in channels:
        topic = merged.setdefault(channel.name, channel)
        if topic is channel:
            continue
        if topic.type_name != channel.type_name or topic.definition != channel.definition:
            raise InputError(f"{path}: {topic.name} has messages of several types")
        topic.count += channel.count
        topic.unchecked += channel.unchecked
        topic.times += channel.times
        topic.pieces += channel.pieces
    return merged
