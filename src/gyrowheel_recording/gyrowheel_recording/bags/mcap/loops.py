"""The loops of reading, compiled: what numpy would go over several times is done in one pass.

They judge nothing: where something is not as in nearly every chunk and message, they return False, and the caller
does it in the way that knows all cases. Nothing checks the bounds of an array here, so the callers vouch for what
is said of the arguments below, and the loops check each number from a file before they use it. Loading them takes a
second where numba is not loaded yet, and compiling them some, once for each version of them.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from gyrowheel_core.wire import SECOND
from gyrowheel_recording.bags.mcap import MESSAGE_HEAD_DTYPE, MESSAGE_OVERHEAD, RECORD_HEAD, Op
from gyrowheel_sim.jit import njit

#: A memory as its bytes, and as the overlapping words of eight bytes that begin at each of them.
Words: TypeAlias = tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint64]]

_HEAD: Final = MESSAGE_HEAD_DTYPE.itemsize
_RECORD_HEAD: Final = RECORD_HEAD.size
_MESSAGE: Final = Op.MESSAGE
_CHANNELS: Final = 1 << 16
_LONGEST: Final = np.uint64(1 << 62)  # a length up to which numbers with a sign and without are the same


@njit(cache=True, nogil=True)
def walk(
    heads: npt.NDArray[Any],
    entries: npt.NDArray[Any],
    spans: npt.NDArray[np.int64],
    index: npt.NDArray[np.int64],
    found: npt.NDArray[Any],
    places: npt.NDArray[np.int64],
) -> bool:
    """Find the messages of chunks that have nothing else, all of them in the index, in order.

    Parameters
    ----------
    heads, entries : structured ndarray
        Heads of messages, and entries, that would begin at each byte of the records, and of the memory with the index.
    spans : ndarray of int64, shape (n, 2)
        Begin and end of the records of each chunk; all within the records.
    index : ndarray of int64, shape (m, 4)
        Chunk, channel, and begin and end of the entries [bytes] of each index record; whole entries, all within the
        memory with the index. Ascending by chunk.
    found, places : ndarray, shape (k,)
        Take heads and places of the k messages of the index.

    Returns
    -------
    bool
        Whether the chunks are like that; if not, what was taken means nothing.
    """
    record_of = np.full(_CHANNELS, -1, np.int64)  # the index record of each channel in this chunk, -1: none
    next_entry = index[:, 2].copy()  # where the entry is that has not been met yet, of each index record
    count = record = 0
    for chunk in range(len(spans)):
        begin, end = spans[chunk]
        first = record
        while record < len(index) and index[record, 0] == chunk:
            channel = index[record, 1]
            if record_of[channel] >= 0:
                return False
            record_of[channel] = record
            record += 1
        at = begin
        while at < end:
            if end - at < _HEAD or count == len(found):
                return False
            head = heads[at]
            own = record_of[head["channel"]]
            if head["opcode"] != _MESSAGE or head["length"] > _LONGEST or own < 0:
                return False
            size = np.int64(head["length"])
            if size < MESSAGE_OVERHEAD or size > end - at - _RECORD_HEAD or next_entry[own] == index[own, 3]:
                return False
            entry = entries[next_entry[own]]
            # no time is negative; as one, it would be the same bytes as a time of the head that is another
            if (
                entry["place"] != at - begin
                or entry["time"] < 0
                or np.uint64(entry["time"]) != head["log_time"]
            ):
                return False
            next_entry[own] += entries.itemsize
            found[count] = head
            places[count] = at
            count += 1
            at += _RECORD_HEAD + size
        for k in range(first, record):
            if next_entry[k] != index[k, 3]:
                return False
            record_of[index[k, 1]] = -1
    return record == len(index) and count == len(found)


@njit(cache=True, nogil=True)
def copied(
    records: Words,
    stamps: npt.NDArray[Any],
    begins: npt.NDArray[np.int64],
    constants: npt.NDArray[np.uint64],
    runs: npt.NDArray[np.int64],
    stamp_at: int,
    rows: Words,
) -> bool:
    """Copy messages of one layout into rows.

    Parameters
    ----------
    records, rows : Words
        Memory of the messages, and of the rows.
    stamps : structured ndarray
        ``sec`` and ``nanosec`` of a message that would begin at each byte of the records.
    begins : ndarray of int64, shape (n,)
        Where the messages begin, n > 0. Each has the size of the layout, and lies within the records.
    constants : ndarray of uint64, shape (m, 3)
        Places of words in a message, which bits of the word must be as they are stated, and those bits.
    runs : ndarray of int64, shape (k, 3)
        What is copied: place in the message, in the row, bytes.
    stamp_at : int
        Place of the stamp in a row [ns].

    Returns
    -------
    bool
        Whether all have the constant bytes and a valid stamp; if not, the rows mean nothing.
    """
    source, source_words = records
    target, target_words = rows
    size = len(target) // len(begins)
    for k in range(len(begins)):
        begin, row = begins[k], k * size
        for c in range(len(constants)):
            if source_words[begin + np.int64(constants[c, 0])] & constants[c, 1] != constants[c, 2]:
                return False
        stamp = stamps[begin]
        within = np.int64(stamp["nanosec"])
        if within >= SECOND:
            return False
        target_words[row + stamp_at] = np.uint64(np.int64(stamp["sec"]) * SECOND + within)
        for r in range(len(runs)):
            here, there = begin + runs[r, 0], row + runs[r, 1]
            end = here + runs[r, 2]
            while here + 8 <= end:
                target_words[there] = source_words[here]
                here += 8
                there += 8
            while here < end:
                target[there] = source[here]
                here += 1
                there += 1
    return True
