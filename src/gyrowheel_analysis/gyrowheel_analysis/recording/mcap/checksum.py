"""The checksum of joined parts from those of the parts, so that they can be computed at the same time."""

from __future__ import annotations

from typing import Final

_POLYNOMIAL: Final = 0xEDB88320  # of CRC-32, the highest power in the lowest bit
_ONE: Final = 1 << 31


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
    power, k = _ONE, 3
    while length:
        if length & 1:
            power = _product(_POWERS[k % len(_POWERS)], power)
        length >>= 1
        k += 1
    return _product(power, first) ^ second


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
