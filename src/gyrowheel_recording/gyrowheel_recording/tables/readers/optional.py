"""Libraries that are not installed with the project, because their licence asks more than that of the project."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from gyrowheel_core.errors import InputError


def library(name: str, extra: str, path: Path) -> Any:
    """Return a library that reads a format.

    Raises
    ------
    InputError
        If it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(
            f"{path}: needs the library {name}, which is not installed; pip install 'gyrowheel-analysis[{extra}]'"
        ) from None
