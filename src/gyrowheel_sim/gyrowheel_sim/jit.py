"""Compilation by numba, with machine code that is kept on disk and checked when it is loaded.

Numba's own cache unpickles whatever its folder contains, and identifies a source by time and size. Here
`gyrowheel_core.cache` keeps the machine code, under a name made of the whole source, the version of numba and the
processor.

A kernel file is a module of this project whose text after the line ``# --- kernel ---`` can be compiled as part of
another module. One module with all functions that call each other lets the compiler see all of them. It is made in
memory; another process loads the machine code of the same text.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import re
import sys
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, ClassVar

import numpy as np

from gyrowheel_core import cache
from gyrowheel_core.cache import digest
from gyrowheel_core.errors import InputError
from gyrowheel_core.locks import changing
from gyrowheel_core.surroundings import ignored_here

_SETTINGS = ".numba_config.yaml"
with ignored_here(_SETTINGS) as _ignored:
    import numba
    from numba import types
    from numba.core import caching, cgutils, config
    from numba.core.ccallback import CFunc
    from numba.core.runtime.nrt import rtsys
    from numba.core.serialize import dumps
    from numba.extending import intrinsic
    from numba.extending import register_jitable as register_jitable
if _ignored:  # it would look again whenever it compiles
    config._config_fname = os.devnull

#: Attribute of a module without a file that contains its source.
SOURCE = "__kernel_source__"
#: How long a process waits for another one that compiles the same code [s]; after that it compiles all code itself.
_LONGEST_WAIT = 120.0


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
        _keep(compiled, function)
    return compiled


def _keep(compiled: Any, function: Callable[..., Any]) -> None:
    """Have machine code kept; of processes that lack the same code, one compiles it and the others wait for it."""
    kept, compile_ = _Kept(function), compiled.compile

    def in_turn(*signature: Any) -> Any:
        with contextlib.ExitStack() as kept.entries.turn:
            return compile_(*signature)

    compiled._cache, compiled.compile = kept, in_turn


_NUMBERS = types.CPointer(types.float64)
_LAWS = types.void(_NUMBERS, types.CPointer(types.uint8), _NUMBERS, _NUMBERS, _NUMBERS)


def called_by_address(function: FunctionType) -> Any:
    """Compile a function for `call_laws`; its machine code is kept as that of `njit`.

    Its arguments are pointers: to the coefficients, the flags of active effects, the state of the plant, the
    quantities of the instant, and the sums that it adds to.
    """
    compiled: Any = CFunc(function, (_LAWS.args, _LAWS.return_type), {}, {"error_model": "numpy"})
    _keep(compiled, function)
    compiled.compile()
    return compiled


def _call_laws(_: Any, address: Any, coef: Any, active: Any, state: Any, q: Any, sums: Any) -> Any:
    """Return the tuple `sums` as the function at `address` changes it (see `called_by_address`), as it is at address 0.

    A law can so join a plant that was compiled without it. The quantities `q` are a tuple or an array.
    """

    def code(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = dict(zip(("address", "coef", "active", "state", "q", "sums"), signature.args, strict=True))
        values = dict(zip(kinds, arguments, strict=True))
        double = target.get_value_type(types.float64)

        def numbers(name: str) -> list[Any]:
            return [
                target.cast(builder, builder.extract_value(values[name], index), kind, types.float64)
                for index, kind in enumerate(kinds[name])
            ]

        def stored(given: list[Any]) -> Any:
            array = cgutils.alloca_once(builder, double, size=max(len(given), 1))
            for index, value in enumerate(given):
                builder.store(value, cgutils.gep(builder, array, index))
            return array

        before, start = numbers("sums"), builder.block
        with builder.if_then(cgutils.is_not_null(builder, values["address"]), likely=False):
            pointers = [
                target.make_array(kinds[name])(target, builder, values[name]).data
                if isinstance(kinds[name], types.Array)
                else stored(numbers(name))
                for name in ("coef", "active", "state", "q")
            ]
            pointers.append(stored(before))
            kind = target.get_function_pointer_type(types.ExternalFunctionPointer(_LAWS, int))
            target.call_function_pointer(builder, builder.inttoptr(values["address"], kind), pointers)
            sums_after = [cgutils.gep(builder, pointers[-1], index) for index in range(len(before))]
            after, end = [builder.load(place) for place in sums_after], builder.block
        results = []
        for old, new in zip(before, after, strict=True):
            result = builder.phi(double)
            result.add_incoming(old, start)
            result.add_incoming(new, end)
            results.append(result)
        return target.make_tuple(builder, signature.return_type, results)

    return sums(address, coef, active, state, q, sums), code


#: Compiled code alone calls it, with `_call_laws` without its first argument.
call_laws: Any = intrinsic(_call_laws)


class _Kept(caching.FunctionCache):
    """The machine code of one function, one entry a signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._py_func = function
        self._impl = _Reduction()
        self._cache_path = str(cache.folder() or "")
        self.entries = _Entries(function)
        self._cache_file: Any = self.entries
        self._enabled = True

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the kept machine code of a signature, or None.

        Numba would first load the tables by which it translates source, half a second's work. Machine code needs only
        the memory manager of arrays. (Code that hashes would need more: no kernel has sets or dictionaries.)
        """
        rtsys.initialize(target_context)
        return self._load_overload(sig, target_context)


class _Reduction(caching.CompileResultCacheImpl):
    """Serialisation of machine code to an entry, without a folder of numba's."""

    def __init__(self) -> None:
        self._locator = self

    def ensure_cache_path(self) -> None:
        """Do nothing: the folder is made at its first use."""

    def check_cachable(self, result: Any) -> bool:
        """Whether the code can be used in another process."""
        return not result.library.has_dynamic_globals and all(part.can_cache for part in result.lifted)


class _Entries:
    """The cache entries of one function, each under a name that covers all its inputs.

    `turn` has the locks of entries that were missing, until they are compiled.
    """

    turn: contextlib.ExitStack
    wait: ClassVar[float] = _LONGEST_WAIT

    def __init__(self, function: Callable[..., Any]) -> None:
        self._of = (
            _source(function.__module__),
            _source(__name__),  # `call_laws` is a part of the machine code
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
        """Return the entry of a key, if need be once another process has compiled it; None if it must be compiled."""
        name, place = self._name(key), cache.folder()
        found = self._read(name)
        if found is None and place is not None:
            try:
                self.turn.enter_context(changing(place / name, wait=self.wait))
                found = self._read(name)
            except InputError:  # a disk that is full, or a process that stands still
                _Entries.wait = 0.0
        return found

    def _read(self, name: str) -> Any:
        content = cache.read(name)
        with contextlib.suppress(
            ImportError, AttributeError
        ):  # of a class that another version has elsewhere
            return None if content is None else pickle.loads(content)
        return None

    def save(self, key: Any, data: Any) -> None:
        """Keep an entry."""
        cache.write(self._name(key), dumps(data))

    def flush(self) -> None:
        """Do nothing: entries of an older source are never requested again."""


@functools.cache
def _source(module: str) -> str:
    """Return a digest of the source of a module."""
    found = sys.modules[module]
    text = getattr(found, SOURCE, None) or Path(str(found.__file__)).read_text(encoding="utf-8")
    return hashlib.sha256(text.encode()).hexdigest()


_MARK = "# --- kernel ---"
_END = "# --- end of kernel ---"
_HEADER = """\
import math
from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
from gyrowheel_sim.jit import call_laws, called_by_address, njit, register_jitable

"""


def kernel_text(package: str, name: str) -> str:
    """Return the part of a kernel file of a package that is compiled."""
    text = resources.files(package).joinpath(name).read_text(encoding="utf-8")
    body = text.split(_MARK, 1)[1].split(_END, 1)[0]
    return f"# from {package}/{name}\n" + re.sub(r"^\n+", "", body)


@functools.cache
def compile_kernels(*files: tuple[str, str]) -> ModuleType:
    """Return one compiled module of kernel files, (package, file name) each."""
    text = "\n\n".join(kernel_text(package, name) for package, name in files)
    return compile_source(text, "kernels of the bench")


def compile_source(source: str, what: str) -> ModuleType:
    """Return the compiled module of a source; `what` goes into its docstring."""
    text = f'"""Generated: {what} in one compiled module."""\n{_HEADER}{source}'
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
