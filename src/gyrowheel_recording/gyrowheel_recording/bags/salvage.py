"""Salvage: a complete recording from a broken MCAP file, or a directory of them, with an account of the losses.

Each file is read twice. The first pass examines every record, and every chunk by its checksum (`mcap.survey`). The
second writes the intact chunks, uncompressed, into a new file with a new index and summary.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt
import zstandard

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, new_directory, read_errors, require_new, require_room
from gyrowheel_core.wire import SECOND
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_recording.bags.mcap import RECORD_HEAD, Op
from gyrowheel_recording.bags.mcap.records import Damaged, Fields, Found, find_messages
from gyrowheel_recording.bags.mcap.survey import LOOSE, Gap, Survey, load_piece, take_survey
from gyrowheel_recording.bags.mcap.writer import McapWriter
from gyrowheel_recording.bags.metadata import (
    ENTRY,
    METADATA_FILE,
    BagFile,
    Metadata,
    bag_metadata,
    metadata_text,
    read_metadata,
    write_metadata,
)
from gyrowheel_recording.bags.read_bag import file_in_memory, read_bag, unpack
from gyrowheel_recording.bags.reader import Integrity, Recording
from gyrowheel_recording.bags.writer import being_written

Fraction = Callable[[float], None]

#: Times in one chunk of what is written [ns]: what one damaged place in it can cost.
_LONGEST: Final = np.uint64(250_000_000)


@dataclass(frozen=True)
class Loss:
    """A stretch of a file that could not be saved."""

    file: str  # name of the file
    reason: str  # what is wrong
    #: Where it begins, and how long it is [bytes].
    byte: int
    size: int
    messages: int | None = None  # messages in it; None where no index counts them
    #: Times of its messages from the first one of the recording [s]; None where they are not stated.
    start: float | None = None
    end: float | None = None


@dataclass(frozen=True)
class Salvaged:
    """Account of a salvage: what was saved, and what was not."""

    #: The broken recording, and the complete one made of it.
    source: str
    target: str
    files: tuple[str, ...]  # names of the files that were read
    complete: bool  # whether nothing at all was missing
    messages: dict[str, int]  # messages saved, by topic
    unchecked: int  # saved messages that no checksum covers
    #: Messages that were recorded and not saved; None where the number recorded is not known.
    missing: int | None
    duration: float  # from the first to the last message saved [s]
    #: Time from the last message saved to the last one recorded [s]; None where this is not known.
    lost_at_end: float | None
    broken_off: bool  # whether a file lacks its end
    losses: tuple[Loss, ...]  # what could not be saved
    #: Samples that are missing by their sequence numbers; None where there are no measurements.
    integrity: Integrity | None
    notes: tuple[str, ...]  # further remarks


def salvage(
    source: str | Path,
    target: str | Path,
    *,
    every_file: bool = False,
    unfinished: bool = False,
    progress: Fraction | None = None,
) -> Salvaged:
    """Make a complete recording of the readable part of a broken one.

    Parameters
    ----------
    source : str or Path
        An MCAP file, or a directory with such files; it is not touched.
    target : str or Path
        Directory to create; it must not exist, or be empty. It appears when it is complete.
    every_file : bool
        Whether to take files too that ``metadata.yaml`` does not name, which are left out otherwise. Where nothing
        names the files, all are taken but copies of one another.
    unfinished : bool
        Whether to take what is written so far of a recording in progress, which is refused otherwise.
    progress : callable, optional
        Called with the fraction done.

    Raises
    ------
    InputError
        If nothing can be saved, the recording is still being written, or the disk refuses the new one.
    """
    source, target = Path(source), Path(target)
    files, stated, left_out = _sources(source, every_file)
    if not unfinished and being_written(source):
        raise InputError(f"{source}: is being recorded; stop the recorder first")
    require_new(target)
    if source.is_dir() and source.resolve() in target.resolve().parents:
        raise InputError(f"{target}: lies in {source}, which is not to be touched")
    with new_directory(target) as place:
        try:
            place.mkdir()
            return _Job(source, place, progress or (lambda _: None)).run(files, stated, left_out, str(target))
        except OSError as error:
            raise InputError(
                f"{error.filename or target}: cannot be written: {error.strerror or error}"
            ) from None


def _sources(source: Path, every_file: bool) -> tuple[list[Path], Metadata | None, list[str]]:
    """Return the files in order, the content of ``metadata.yaml``, and why others are left out.

    The content is None where it cannot be read.
    """
    if is_file(source):
        if _is_other(source):
            raise InputError(f"{source}: only MCAP files can be salvaged")
        return [source], None, []
    if not source.is_dir():
        raise InputError(f"{source}: no such file or directory")
    found = {file.name: file for file in source.iterdir() if re.search(r"\.mcap(\.zstd)?$", file.name)}
    if not found:
        what = "only MCAP files can be salvaged" if any(map(_is_other, source.iterdir())) else "no MCAP file"
        raise InputError(f"{source}: {what}")
    for file in found.values():  # a pipe would be waited for
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise InputError(f"{file}: is no file")
    stated = None
    with contextlib.suppress(InputError):
        stated = read_metadata(source / METADATA_FILE)
    order, left_out = _chosen(found, stated.files if stated else (), every_file)
    return [found[name] for name in order], stated, left_out


def _chosen(
    found: Mapping[str, Path], stated: Sequence[str], every_file: bool
) -> tuple[list[str], list[str]]:
    """Return the names of the files to read in order, and why others are left out."""
    natural = sorted(found, key=lambda name: [int(p) if p.isdigit() else p for p in re.split(r"(\d+)", name)])
    order = [name for name in dict.fromkeys(stated) if name in found]
    others = [name for name in natural if name not in order]
    if every_file:
        return [*order, *others], []
    if order:
        why = f"left out: {METADATA_FILE} does not name it, and every file was not asked for"
        return order, [f"{name}: {why}" for name in others]
    first: dict[str, str] = {}
    left_out = []
    for name in others:
        original = first.setdefault(_content(found[name]), name)
        if original == name:
            order.append(name)
        else:
            left_out.append(f"{name}: left out: a copy of {original}")
    return order, left_out


def _content(file: Path) -> str:
    """Return the checksum of a file."""
    with read_errors(file), file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _is_other(file: Path) -> bool:
    return ".db3" in file.suffixes


class _Job:
    """One salvage."""

    def __init__(self, source: Path, target: Path, progress: Fraction) -> None:
        self._source = source
        self._target = target
        self._progress = progress
        self._losses: list[tuple[str, Gap]] = []
        self._notes: list[str] = []
        self._files: list[BagFile] = []
        self._topics: dict[str, tuple[dict[str, Any], int]] = {}
        self._unchecked = 0

    def run(
        self, files: Sequence[Path], stated: Metadata | None, left_out: Sequence[str], name: str
    ) -> Salvaged:
        """Salvage the files into the target, and return the account."""
        present = {file.name for file in files}
        absent = [file for file in stated.files if file not in present] if stated else []
        self._notes += [f"the file {file} is not there" for file in absent]
        whole, count, ends = self._copy(files)
        saved = sum(file.count for file in self._files)
        if not saved:
            raise InputError(f"{self._source}: holds no message that can be saved")
        self._write_metadata(stated)
        integrity = self._verify()
        start = min(file.start for file in self._files if file.count)
        end = max(file.end for file in self._files if file.count)
        if stated is not None:
            count = stated.count
            ends += [] if stated.end is None else [stated.end]
        missing = None if count is None else max(count - saved, 0)
        lost_at_end = self._lost_at_end(ends, end)
        if not whole and not ends:
            missing, lost_at_end = None, lost_at_end or None
        losses = self._dated_losses(start)
        duplicates = integrity is not None and integrity.duplicates > 0
        return Salvaged(
            source=str(self._source),
            target=name,
            files=tuple(file.name for file in files),
            complete=whole and not (losses or missing or self._notes or duplicates),
            messages={topic: count for topic, (_, count) in sorted(self._topics.items())},
            unchecked=self._unchecked,
            missing=missing,
            duration=(end - start) / SECOND,
            lost_at_end=lost_at_end,
            broken_off=not whole,
            losses=losses,
            integrity=integrity,
            notes=(*self._notes, *left_out),
        )

    def _copy(self, files: Sequence[Path]) -> tuple[bool, int | None, list[int]]:
        """Copy what is intact; return whether all files have their ends, and the number and last times they state.

        The number of messages is None where a file does not state it.
        """
        whole, counts, ends = True, [], []
        part = 0.5 / len(files)
        for number, file in enumerate(files):
            begin = 2.0 * part * number
            with _opened(file) as (stream, unpacked):
                survey = take_survey(stream, str(file), self._part(begin, part))
                if not unpacked:
                    survey.notes.append("it cannot be decompressed to its end")
                    survey.ended = False
                self._write(file.name, survey, stream, self._part(begin + part, part))
            whole &= survey.ended
            counts.append(survey.count)
            ends += [] if survey.end is None else [survey.end]
            self._losses += [(file.name, gap) for gap in survey.gaps]
            self._notes += [f"{file.name}: {note}" for note in survey.notes]
            if not survey.ended:
                self._notes.append(
                    f"{file.name}: has no end: it was not completed, or is cut off; what was recorded after its last"
                    " whole chunk is not in it"
                )
        known = [count for count in counts if count is not None]
        return whole, sum(known) if len(known) == len(counts) else None, ends

    def _write_metadata(self, stated: Metadata | None) -> None:
        custom = {
            "gyrowheel.salvaged_from": self._source.absolute().name,
            "gyrowheel.unchecked_messages": str(self._unchecked),
        }
        if stated and ENTRY in stated.custom:
            custom[ENTRY] = stated.custom[ENTRY]
        metadata = bag_metadata(self._files, list(self._topics.values()), custom)
        if stated and stated.compression == "message":  # the messages are copied as they are
            metadata["compression_format"] = stated.compression_format
            metadata["compression_mode"] = stated.compression.upper()
        write_metadata(self._target, metadata)

    def _lost_at_end(self, ends: Sequence[int], end: int) -> float | None:
        """Return the time from the last message saved to the last one recorded [s]; None if it is not known."""
        last = [*ends, *(gap.end for _, gap in self._losses if gap.end is not None)]
        return max(max(last) - end, 0) / SECOND if last else None

    def _dated_losses(self, start: int) -> tuple[Loss, ...]:
        """Return the losses, with times from the first message; `start` is the time of the first one saved [ns]."""
        origin = min([start, *(gap.start for _, gap in self._losses if gap.start is not None)])

        def seconds(time: int | None) -> float | None:
            return None if time is None else (time - origin) / SECOND

        return tuple(
            Loss(file, gap.reason, gap.byte, gap.size, gap.messages, seconds(gap.start), seconds(gap.end))
            for file, gap in self._losses
        )

    def _part(self, begin: float, size: float) -> Fraction:
        return lambda part: self._progress(begin + size * part)

    def _verify(self) -> Integrity | None:
        """Read the result back; return which samples are missing."""
        try:
            return Recording.open(self._target).integrity()
        except InputError as error:
            text = str(error).replace(str(self._target), str(self._target.name))
        read_bag(self._target, {})
        if "no messages on" not in text:
            self._notes.append(text)
        return None

    def _write(self, source: str, survey: Survey, stream: BinaryIO, progress: Fraction) -> None:
        """Write the intact pieces of one file into a new file."""
        schemas, channels = _usable(survey.declared)
        name = f"{self._target.name}_{len(self._files)}.mcap"
        writer = McapWriter(self._target / name, chunk_size=LOOSE)
        grown = 0  # bytes, by unpacking
        try:
            writer.adopt(schemas, channels)
            for number, piece in enumerate(survey.pieces):
                records, found, checked = load_piece(stream, piece)
                checked |= survey.data_checked
                known = np.isin(found.heads["channel"], np.array(list(channels), dtype=np.int64))
                if not known.all():
                    lost = "messages of a channel whose declaration is lost"
                    survey.gaps.append(Gap(lost, piece.byte, 0, int(np.count_nonzero(~known))))
                    records, found = _only(records, found, known)
                grown += len(records) - piece.size
                require_room(grown, f"{self._source}: what {source} is unpacked to beyond its size")
                for part, messages in _divided(records, found):
                    writer.append_chunk(part, _new_index(messages))
                self._unchecked += 0 if checked else len(found.places)
                progress((number + 1) / len(survey.pieces))
            count = sum(writer.counts.values())
            if not count:
                writer.abort()
                (self._target / name).unlink()
                return
            file = BagFile(name, writer.start, writer.end, count)
            topics = {c: _topic(schemas, contents) for c, contents in channels.items()}
            for channel, described in topics.items():
                key = described["name"]
                before = self._topics[key][1] if key in self._topics else 0
                self._topics[key] = described, before + writer.counts[channel]
            writer.finish(metadata_text(bag_metadata([file], list(self._topics.values()), {})))
        except BaseException:
            writer.abort()
            raise
        unsure = sorted({opcode for opcode, _ in survey.unsure.keys() - survey.sure.keys()})
        if unsure and not survey.data_checked:
            survey.notes.append("declarations of its topics are covered by no checksum")
        self._files.append(file)


def _only(records: memoryview, found: Found, keep: npt.NDArray[np.bool_]) -> tuple[memoryview, Found]:
    """Return the messages to keep, and nothing else."""
    stops = found.places + RECORD_HEAD.size + found.heads["length"].astype(np.int64)
    parts = [
        bytes(records[a:b]) for a, b in zip(found.places[keep].tolist(), stops[keep].tolist(), strict=True)
    ]
    kept = memoryview(b"".join(parts))
    return kept, find_messages([(kept, [])], "")


def _divided(records: memoryview, found: Found) -> Iterator[tuple[memoryview, Found]]:
    """Yield the messages of a chunk as they are, in parts where they span more than `_LONGEST`."""
    if not len(found.places):
        return
    times = found.heads["log_time"].astype(np.uint64)
    slot = (times - times.min()) // _LONGEST
    # a message that was late stays with its neighbours
    cuts = np.flatnonzero(np.diff(np.maximum.accumulate(slot).astype(np.int64))) + 1
    for first, last in zip([0, *cuts], [*cuts, len(times)], strict=True):
        begin = int(found.places[first]) if first else 0
        end = int(found.places[last]) if last < len(times) else len(records)
        places = found.places[first:last] - begin
        yield records[begin:end], Found(records[begin:end], places, found.heads[first:last], [])


def _new_index(found: Found) -> dict[int, npt.NDArray[np.uint64]]:
    pairs = np.stack([found.heads["log_time"], found.places.astype(np.uint64)], axis=1)
    channels = found.heads["channel"]
    return {channel: pairs[channels == channel] for channel in np.unique(channels).tolist()}


def _usable(declared: Mapping[tuple[int, int], bytes]) -> tuple[dict[int, bytes], dict[int, bytes]]:
    """Return the schemas, and the channels that can be parsed, by number."""
    schemas, channels = {}, {}
    for (opcode, number), contents in declared.items():
        if opcode == Op.SCHEMA:
            schemas[number] = contents
    for (opcode, number), contents in declared.items():
        if opcode == Op.CHANNEL:
            with contextlib.suppress(Damaged, UnicodeDecodeError):
                _topic(schemas, contents)
                channels[number] = contents
    return schemas, channels


def _topic(schemas: Mapping[int, bytes], contents: bytes) -> dict[str, Any]:
    """Return rosbag2's ``topic_metadata`` of a channel."""
    fields = Fields(memoryview(contents))
    _, schema, name, encoding = fields.number("<H"), fields.number("<H"), fields.text(), fields.text()
    entries = Fields(fields.data(fields.number("<I")))
    metadata: dict[str, str] = {}
    while entries.left:
        key = entries.text()
        metadata[key] = entries.text()
    type_name = ""
    if schema in schemas:
        of_schema = Fields(memoryview(schemas[schema]))
        of_schema.number("<H")
        type_name = of_schema.text()
    return {
        "name": name,
        "type": type_name,
        "serialization_format": encoding,
        "offered_qos_profiles": _qos(metadata.get("offered_qos_profiles", "")),
        "type_description_hash": metadata.get("topic_type_hash", ""),
    }


@functools.lru_cache(maxsize=64)
def _qos(text: str) -> list[Any]:
    try:
        qos = read_yaml(text, "")
    except InputError:
        return []
    return qos if isinstance(qos, list) else []


@contextlib.contextmanager
def _opened(file: Path) -> Iterator[tuple[BinaryIO, bool]]:
    """Open a file, decompressed as far as possible; give also whether all of it was decompressed."""
    try:
        with file.open("rb", buffering=1 << 20) as stream:
            if file.suffix != ".zstd":
                yield stream, True
                return
            with file_in_memory(file.stem) as (plain, _):
                whole = True
                try:
                    unpack(stream, plain, file)
                except zstandard.ZstdError:
                    whole = False
                plain.seek(0)
                yield plain, whole
    except IsADirectoryError:
        raise InputError(f"{file}: is a directory") from None
