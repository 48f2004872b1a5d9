"""Compilation by numba with machine code that is kept on disk and checked as it is loaded.

Numba's own cache believes what lies in its folder: it unpickles it without a check, and knows its source by time and
size. Here the machine code is kept by `gyrowheel_core.cache`, under a name made of the whole source, the version of
numba and the processor.
"""

from __future__ import annotations

import functools
import hashlib
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
import numpy as np
from numba.core import caching
from numba.core.registry import cpu_target
from numba.core.serialize import dumps

from gyrowheel_core import cache

#: Name in a module under which its whole source stands, for a module that has no file.
SOURCE = "__kernel_source__"


def njit(function: FunctionType | None = None, *, cache: bool = False, **options: Any) -> Any:
    """Compile a function as `numba.njit` does; with `cache`, its machine code is kept and checked.

    Parameters
    ----------
    function : callable, optional
        The function; without one, a decorator is returned.
    cache : bool
        Whether to keep the machine code.
    **options
        As `numba.njit` takes them.
    """
    if function is None:
        return functools.partial(njit, cache=cache, **options)
    compiled: Any = numba.njit(**options)(function) if options else numba.njit(function)
    if cache:
        compiled._cache = _Kept(function)
    return compiled


def load_tables() -> None:
    """Load the tables of numba, which otherwise come with the first compiled function that is called."""
    cpu_target.target_context.refresh()


class _Kept(caching.FunctionCache):
    """The machine code of one function, one entry a signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._py_func = function
        self._impl = _Reduction()
        self._cache_path = str(cache.folder() or "")
        self._cache_file: Any = _Entries(function)
        self._enabled = True


class _Reduction(caching.CompileResultCacheImpl):
    """How machine code becomes an entry, without a folder of numba's own."""

    def __init__(self) -> None:
        self._locator = self

    def ensure_cache_path(self) -> None:
        """Do nothing: the folder is made where it is first asked for."""

    def check_cachable(self, result: Any) -> bool:
        """Whether the code can be used in another process."""
        return not result.library.has_dynamic_globals and all(part.can_cache for part in result.lifted)


class _Entries:
    """The entries of one function, each under a name that tells all it was made from."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._of = (
            _source(function.__module__),
            function.__module__,  # an entry names it: the same source in another module is another entry
            function.__qualname__,
            numba.__version__,
            np.__version__,
            sys.version,
            str(vars(numba.config)["BOUNDSCHECK"]),  # the module is filled as it is loaded
        )

    def _name(self, key: Any) -> str:
        return f"code_{cache.digest(*self._of, repr(key))}"

    def load(self, key: Any) -> Any:
        """Return the entry of a key, or None."""
        content = cache.read(self._name(key))
        return None if content is None else pickle.loads(content)

    def save(self, key: Any, data: Any) -> None:
        """Keep an entry."""
        cache.write(self._name(key), dumps(data))

    def flush(self) -> None:
        """Do nothing: entries of an older source are never asked for again."""


@functools.cache
def _source(module: str) -> str:
    """Return a digest of the source of a module: another one where a line of it differs."""
    found = sys.modules[module]
    text = getattr(found, SOURCE, None) or Path(str(found.__file__)).read_text(encoding="utf-8")
    return hashlib.sha256(text.encode()).hexdigest()
