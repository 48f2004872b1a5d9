"""The loops of reading, compiled: what numpy would go over several times is done in one pass.

They judge nothing: where something is not as it is in nearly every chunk and message, they say so, and the caller does
it in the way that knows all cases. Importing this takes half a second, which only a large file is worth.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from gyrowheel_analysis.recording.mcap.format import (
    MESSAGE,
    MESSAGE_HEAD_DTYPE,
    MESSAGE_OVERHEAD,
    RECORD_HEAD,
)
from gyrowheel_core.wire import SECOND
from gyrowheel_sim.jit import njit

_HEAD = MESSAGE_HEAD_DTYPE.itemsize
_RECORD_HEAD = RECORD_HEAD.size
_CHANNELS = 1 << 16

Words: TypeAlias = tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint64]]


@njit(cache=True, nogil=True)
def walk(
    heads: npt.NDArray[Any],
    entries: npt.NDArray[Any],
    spans: npt.NDArray[np.int64],
    parts: npt.NDArray[np.int64],
    found: npt.NDArray[Any],
    places: npt.NDArray[np.int64],
) -> bool:
    """Find the messages of chunks that hold nothing else, all of them in the index, in order.

    Parameters
    ----------
    heads, entries : structured ndarray
        A head of a message at every byte of the records, an entry at every byte of the index.
    spans : ndarray of int64, shape (n, 2)
        Begin and end of the records of each chunk.
    parts : ndarray of int64, shape (m, 4)
        Chunk, channel, and begin and end of the entries of each index record, ascending by chunk.
    found : structured ndarray, shape (k,)
        Takes the heads of the messages, of which the index has k.
    places : ndarray of int64, shape (k,)
        Takes where they are.

    Returns
    -------
    bool
        Whether the chunks are like that; if not, what was taken means nothing.
    """
    own = np.full(_CHANNELS, -1, np.int64)  # the part that is of a channel
    nearest = parts[:, 2].copy()  # the next entry of each part
    count = part = 0
    for chunk in range(len(spans)):
        at, end = spans[chunk]
        begin, first = at, part
        while part < len(parts) and parts[part, 0] == chunk:
            if own[parts[part, 1]] >= 0:
                return False
            own[parts[part, 1]] = part
            part += 1
        while at < end:
            if end - at < _HEAD or count == len(found):
                return False
            head = heads[at]
            size = np.int64(head.length)
            of = own[head.channel]
            if head.opcode != MESSAGE or size < MESSAGE_OVERHEAD or size > end - at - _RECORD_HEAD or of < 0:
                return False
            entry = nearest[of]
            if (
                entry == parts[of, 3]
                or entries[entry].place != at - begin
                or entries[entry].time != np.int64(head.log_time)
            ):
                return False
            nearest[of] += entries.itemsize
            found[count] = head
            places[count] = at
            count += 1
            at += _RECORD_HEAD + size
        for k in range(first, part):
            if nearest[k] != parts[k, 3]:
                return False
            own[parts[k, 1]] = -1
    return part == len(parts) and count == len(found)


@njit(cache=True, nogil=True)
def copied(
    records: Words,
    stamps: npt.NDArray[Any],
    begins: npt.NDArray[np.int64],
    constants: npt.NDArray[np.int64],
    runs: npt.NDArray[np.int64],
    times: npt.NDArray[np.int64],
    rows: Words,
) -> bool:
    """Copy messages of one layout into rows.

    Parameters
    ----------
    records, rows : (ndarray of uint8, ndarray of uint64)
        The bytes that hold the messages and the rows, and the eight bytes from each of them on.
    stamps : structured ndarray
        ``sec`` and ``nanosec`` of a message that would begin at each byte.
    begins : ndarray of int64, shape (n,)
        Where the messages begin.
    constants : ndarray of int64, shape (m, 2)
        Places in a message and the bytes that must be there.
    runs : ndarray of int64, shape (k, 3)
        What is copied: place in the message, in the row, bytes.
    times : ndarray of int64, shape (n,)
        Stamps of the rows [ns].

    Returns
    -------
    bool
        Whether all have the constant bytes and a valid stamp; if not, the rows mean nothing.
    """
    source, source_words = records
    target, target_words = rows
    size = len(target) // max(len(begins), 1)
    for k in range(len(begins)):
        begin, row = begins[k], k * size
        for c in range(len(constants)):
            if source[begin + constants[c, 0]] != constants[c, 1]:
                return False
        within = np.int64(stamps[begin].nanosec)
        if within >= SECOND:
            return False
        times[k] = np.int64(stamps[begin].sec) * SECOND + within
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
