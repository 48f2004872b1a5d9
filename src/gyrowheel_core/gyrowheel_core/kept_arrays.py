"""Arrays in the user's cache on disk: of results that take long to compute."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core import cache


def read(name: str) -> dict[str, NDArray[Any]] | None:
    """Return the arrays of an entry by name; None if it is missing or damaged, see `cache.read`."""
    content = cache.read(name)
    if content is None or not zipfile.is_zipfile(file := io.BytesIO(content)):
        return None
    try:
        with np.load(file, allow_pickle=False) as found:
            return dict(found)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None


def write(name: str, **arrays: Any) -> None:
    """Keep arrays by name, see `cache.write`."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    cache.write(name, file.getvalue())
