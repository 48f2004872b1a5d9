"""What data sets of HDF5 are read from, and what they grow to: looked at before HDF5 reads them.

A data set may stand in other files of the user, and its chunks are unpacked by filters until they end, whatever size
the data set has.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

from gyrowheel_core.errors import InputError
from gyrowheel_core.limits import largest, require_room
from gyrowheel_recording.tables.readers.damage import DEFLATED, inflated

_DEFLATE, _CHECKSUM, _LZF = 1, 3, 32000
#: Filters that unpack to as much as is known before: shuffling, checksums, and what has the size among its values.
_ONES: Final = (2, _CHECKSUM)
_SIZED: Final = (5, 6)
_LZF_MOST: Final = 88  # what LZF packs by, at most
_CURE: Final = "; h5repack writes them into one file, packed by GZIP"


def require_plain(node: Any, path: Path, name: str) -> None:
    """Refuse a data set that is in other files, or whose chunks could grow to more than the limit.

    Parameters
    ----------
    node : h5py.Dataset
        The data set.
    path : Path
        The file.
    name : str
        Name of the data set.
    """
    where = f"{path}: {name}"
    if node.is_virtual:
        raise InputError(
            f"{where}: its numbers are in other data sets (it is virtual), which are not read{_CURE}"
        )
    if node.external:
        raise InputError(
            f"{where}: its numbers are in another file (external storage), which is not read{_CURE}"
        )
    if node.chunks is None:
        return
    size = math.prod(map(int, node.chunks)) * node.dtype.itemsize
    require_room(size, f"{where}: a chunk of it")
    settings = node.id.get_create_plist()
    filters = [settings.get_filter(k) for k in range(settings.get_nfilters())]
    codes = [code for code, *_ in filters]
    for code, _, values, kind in filters:
        sized = code in _SIZED and len(values) > 4 and values[2] * values[4] <= size
        if not (sized or code in (*_ONES, _DEFLATE, _LZF)) or codes.count(code) > 1:
            title = kind.decode("utf-8", "replace") if isinstance(kind, bytes) else str(kind)
            raise InputError(f"{where}: its numbers are packed by {title or code}, which is not read{_CURE}")
    if _DEFLATE in codes or _LZF in codes:
        _require_chunks(node, where, codes, size)


def _require_chunks(node: Any, where: str, codes: list[int], size: int) -> None:
    """Refuse chunks that unpack to more than a chunk has, where that could matter."""
    most = DEFLATED if _DEFLATE in codes else _LZF_MOST
    if _DEFLATE in codes and _LZF in codes:
        most *= _LZF_MOST
    suspect: list[Any] = []

    def note(chunk: Any) -> None:
        if most * chunk.size > largest():
            suspect.append(chunk.chunk_offset)

    node.id.chunk_iter(note)
    packed_last = next(code for code in reversed(codes) if code != _CHECKSUM) == _DEFLATE
    for place in suspect:
        left_out, data = node.id.read_direct_chunk(place)
        if not packed_last or left_out or sum(map(len, inflated(data, size + 1))) > size:
            raise InputError(f"{where}: damaged: a chunk unpacks to more than the {size} bytes that it has")
