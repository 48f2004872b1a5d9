"""Kernel files as one compiled module, cached on disk by content.

A kernel file is a module of this project whose text after the line ``# --- kernel ---`` can stand in another module.
One source file with everything that calls each other lets the compiler see all of it, and a second process loads the
machine code instead of compiling.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import re
import sys
import tempfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from types import ModuleType

import numba
import numpy as np

from gyrowheel_core.files import write_text

_MARK = "# --- kernel ---"
_END = "# --- end of kernel ---"
_HEADER = """\
import math
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable

"""


def kernel_text(package: str, name: str) -> str:
    """Return what a kernel file of a package has to be compiled."""
    text = resources.files(package).joinpath(name).read_text(encoding="utf-8")
    body = text.split(_MARK, 1)[1].split(_END, 1)[0]
    return f"# from {package}/{name}\n" + re.sub(r"^\n+", "", body)


@functools.cache
def compile_kernels(*files: tuple[str, str]) -> ModuleType:
    """Return one compiled module of kernel files, (package, file name) each."""
    return compile_source([kernel_text(package, name) for package, name in files], "kernels of the bench")


def compile_source(parts: Sequence[str], what: str) -> ModuleType:
    """Return the module that has these pieces of source, in order; `what` goes into its docstring."""
    text = f'"""Generated: {what} in one compiled module."""\n{_HEADER}' + "\n\n".join(parts)
    name = f"gyrowheel_kernel_{digest(text, numba.__version__, np.__version__, sys.version)}"
    if name in sys.modules:
        return sys.modules[name]
    path = cache_folder() / f"{name}.py"
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        write_text(path, text)
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:  # pragma: no cover - only a broken interpreter gets here
        raise RuntimeError(f"cannot load the generated module {path}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def digest(*texts: str) -> str:
    """Return a short name of texts: another one where any of them differs."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:20]


@functools.cache
def cache_folder() -> Path:
    """Return the folder of compiled kernels: ``$GYROWHEEL_CACHE``, the user's cache folder, or a temporary one."""
    base = os.environ.get("GYROWHEEL_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "gyrowheel"
    )
    folder = Path(base)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="gyrowheel-cache-"))
    return folder
