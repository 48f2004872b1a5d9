"""Kernel files as one compiled module.

A kernel file is a module of this project whose text after the line ``# --- kernel ---`` can stand in another module.
One source with everything that calls each other lets the compiler see all of it. The module is made from the text in
memory; a second process loads the machine code that belongs to that text (`gyrowheel_sim.jit`) instead of compiling.
"""

from __future__ import annotations

import functools
import re
import sys
from collections.abc import Sequence
from importlib import resources
from types import ModuleType

from gyrowheel_core.cache import digest
from gyrowheel_sim.jit import SOURCE

_MARK = "# --- kernel ---"
_END = "# --- end of kernel ---"
_HEADER = """\
import math
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from gyrowheel_sim.jit import njit
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
    name = f"gyrowheel_kernel_{digest(text)}"
    if name in sys.modules:
        return sys.modules[name]
    module = ModuleType(name)
    setattr(module, SOURCE, text)
    sys.modules[name] = module
    try:
        exec(compile(text, f"<{name}>", "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return module
