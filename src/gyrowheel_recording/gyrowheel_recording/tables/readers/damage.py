"""What becomes of the errors that libraries raise on damaged files: one error of the user that names the file."""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from gyrowheel_core.errors import InputError, one_line

#: What deflate packs by, at most.
DEFLATED: Final = 1032
_LONGEST: Final = 300  # characters of what a library says
_PIECE: Final = 1 << 24  # bytes


@contextlib.contextmanager
def refused(path: Path) -> Iterator[None]:
    """Make one error of the user of whatever a library raises within the block."""
    try:
        with np.errstate(all="ignore"):
            yield
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{path}: cannot be read: it claims more memory than there is") from None
    except Exception as error:  # on damaged data libraries pass on whatever happens to them
        raise InputError(f"{path}: cannot be read: {said(error)}") from None


def said(error: BaseException) -> str:
    """Return what an error of a library says, in one line that is not too long."""
    text = one_line(error)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def inflated(packed: bytes, most: int) -> Iterator[bytes]:
    """Yield what bytes deflated by zlib hold, in pieces, up to `most` bytes of it."""
    inflate = zlib.decompressobj()
    rest, got = packed, 0
    while got < most:
        piece = inflate.decompress(rest, min(most - got, _PIECE))
        if not piece:
            return
        rest, got = inflate.unconsumed_tail, got + len(piece)
        yield piece
