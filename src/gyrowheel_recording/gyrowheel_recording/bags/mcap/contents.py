"""What the chunks and messages of a batch hold, checked: the part of reading that needs nothing of other batches."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrowheel_recording.bags.mcap.batches import Batch
from gyrowheel_recording.bags.mcap.checksum import joined_with
from gyrowheel_recording.bags.mcap.format import (
    CHANNEL,
    MESSAGE,
    MESSAGE_HEAD_DTYPE,
    MESSAGE_OVERHEAD,
    RECORD_HEAD,
    SCHEMA,
)
from gyrowheel_recording.bags.mcap.records import (
    Chunk,
    Damaged,
    Found,
    Indexed,
    find,
    heads_at,
    open_chunk,
    plain_chunks,
)


@dataclass(frozen=True)
class Share:
    """Messages of one channel.

    Attributes
    ----------
    channel : int
        The channel.
    records : memoryview
        Holds them.
    begins, sizes : ndarray of int64, shape (n,)
        Begins and lengths of their contents there.
    times : ndarray of uint64
        Log times of the messages of all channels [ns].
    own : ndarray of int64, shape (n,)
        Which of them are theirs.
    checked : bool or None
        Whether a checksum covers them; None if that of the whole data would.
    """

    channel: int
    records: memoryview
    begins: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    times: npt.NDArray[np.uint64]
    own: npt.NDArray[np.int64]
    checked: bool | None


@dataclass(frozen=True)
class Contents:
    """What a batch holds.

    Attributes
    ----------
    declarations : list of (int, memoryview)
        Opcode and contents of the schemas and channels.
    shares : list of Share
        The messages.
    checksum : int
        Of the bytes of the batch.
    """

    declarations: list[tuple[int, memoryview]]
    shares: list[Share]
    checksum: int


def contents(batch: Batch, *, compiled: bool = False) -> Contents:
    """Return what a batch holds; `compiled` as `find` takes it.

    Raises
    ------
    Damaged
        If something contradicts what the file states of it.
    """
    data = batch.data
    declarations = [(opcode, data[a:b]) for opcode, a, b in batch.others if opcode in (SCHEMA, CHANNEL)]
    places = [begin - RECORD_HEAD.size for opcode, begin, _ in batch.others if opcode == MESSAGE]
    shares: list[Share] = []
    if places:
        at = np.array(places)
        shares += _shares(Found(data, at, heads_at(data, at, "the file"), []), None)
    plain = plain_chunks(data, np.array(batch.chunks)) if batch.chunks else None
    for found, checked in _found(batch, None if plain is None else plain[0], compiled):
        declarations += found.others
        shares += _shares(found, checked)
    known = () if plain is None else zip(*plain[0].T.tolist(), plain[1], strict=True)
    return Contents(declarations, shares, joined_with(data, known))


def _found(batch: Batch, plain: npt.NDArray[np.int64] | None, compiled: bool) -> Iterator[tuple[Found, bool]]:
    """Yield what the chunks hold, where all of them are `plain` all at once, and whether checksums cover it."""
    if not batch.chunks:
        return
    index = np.array(batch.index, dtype=np.int64).reshape(-1, 3)
    if plain is not None:
        with contextlib.suppress(Damaged):  # reading them one by one tells which of them it is
            found = find(Indexed(batch.data, plain, batch.data, index), "", compiled=compiled)
            yield found, True
            return
    opened = [open_chunk(batch.data[a:b], _name(batch, a)) for a, b in batch.chunks]
    for checked, group in itertools.groupby(range(len(opened)), key=lambda k: opened[k].checked):
        for found in _together(batch, opened, list(group), index, compiled):
            yield found, checked


def _together(
    batch: Batch, opened: Sequence[Chunk], group: Sequence[int], index: npt.NDArray[np.int64], compiled: bool
) -> Iterator[Found]:
    """Yield what chunks that follow one another hold: small chunks are faster together than one by one."""
    parts = [opened[k].records for k in group]
    records = parts[0] if len(parts) == 1 else memoryview(b"".join(parts))
    sizes = np.array([len(part) for part in parts], dtype=np.int64)
    stops = np.cumsum(sizes)
    spans = np.stack([stops - sizes, stops], axis=1)
    own = index[(index[:, 0] >= group[0]) & (index[:, 0] <= group[-1])] - np.array([group[0], 0, 0])
    where = _name(batch, batch.chunks[group[0]][0]) if len(group) == 1 else ""
    try:
        found = find(Indexed(records, spans, batch.data, own), where, compiled=compiled)
    except Damaged:
        if len(group) == 1:
            raise
    else:
        yield found
        return
    for k in group:
        yield from _together(batch, opened, [k], index, compiled)


def _name(batch: Batch, begin: int) -> str:
    return f"the chunk at byte {batch.place + begin - RECORD_HEAD.size}"


def _shares(found: Found, checked: bool | None) -> Iterator[Share]:
    """Yield the messages by their channels."""
    channels = np.ascontiguousarray(found.heads["channel"])
    lengths = found.heads["length"].astype(np.int64) - MESSAGE_OVERHEAD
    begins = found.places + MESSAGE_HEAD_DTYPE.itemsize
    for channel in np.flatnonzero(np.bincount(channels)).tolist():
        own = np.flatnonzero(channels == channel)
        yield Share(channel, found.records, begins[own], lengths[own], found.heads["log_time"], own, checked)
