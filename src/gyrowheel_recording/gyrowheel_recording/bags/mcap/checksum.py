"""The checksum of MCAP files, CRC-32: of data, and of joined parts from those of the parts.

Parts can so be computed at the same time.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Final

try:
    from isal.isal_zlib import crc32
except ImportError:  # no build for this machine: the same numbers, three times slower
    from zlib import crc32

__all__ = ["crc32", "joined", "joined_with"]

_POLYNOMIAL: Final = 0xEDB88320  # of CRC-32, the highest power in the lowest bit
_ONE: Final = 1 << 31
#: Bytes of a part from which on its checksum is sooner joined than computed again.
_WORTH: Final = 1 << 16


def joined_with(data: memoryview, known: Iterable[tuple[int, int, int]]) -> int:
    """Return the CRC-32 of data, of some parts of which it is known.

    Parameters
    ----------
    data : memoryview
        The data.
    known : iterable of (int, int, int)
        Begin, end and checksum of these parts, in order.
    """
    result = at = 0
    for begin, end, checksum in known:
        if end - begin >= _WORTH:
            result = joined(crc32(data[at:begin], result), checksum, end - begin)
            at = end
    return crc32(data[at:], result)


def joined(first: int, second: int, length: int) -> int:
    """Return the CRC-32 of two parts, one behind the other.

    Parameters
    ----------
    first, second : int
        Checksums of the parts.
    length : int
        Of the second part [bytes].
    """
    # the first one is moved by the bits of the second: multiplied by x to their number
    return _product(_power(length), first) ^ second


@functools.lru_cache(maxsize=4096)
def _power(length: int) -> int:
    """Return x to the bits of so many bytes; most chunks of a file have one of a few lengths."""
    power, k = _ONE, 3
    while length:
        if length & 1:
            power = _product(_POWERS[k % len(_POWERS)], power)
        length >>= 1
        k += 1
    return power


def _product(a: int, b: int) -> int:
    """Return the product of two polynomials over bits, modulo that of the checksum."""
    result, bit = 0, _ONE
    while a:
        if a & bit:
            result ^= b
            a ^= bit
        bit >>= 1
        b = (b >> 1) ^ _POLYNOMIAL if b & 1 else b >> 1
    return result


def _powers() -> tuple[int, ...]:
    found = [_ONE >> 1]
    while len(found) < 32:  # the next one would be the first again
        found.append(_product(found[-1], found[-1]))
    return tuple(found)


#: x to the powers of two, from 1 on.
_POWERS: Final = _powers()
