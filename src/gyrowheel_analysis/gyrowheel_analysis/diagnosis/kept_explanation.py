"""Explanations in the user's cache, so that a second verb on the same recordings need not search again.

A search takes most of the time of a comparison, a diagnosis or an addition, and all three need the same one. An entry
is found by everything that decides its content: recordings, model, and code. So it is never out of date; a damaged one
is computed again.
"""

from __future__ import annotations

import contextlib
import copyreg
import dataclasses
import io
import pickle
import time
from collections import OrderedDict
from collections.abc import Collection, Iterator, Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.diagnosis.explanation import Explanation, explained
from gyrowheel_analysis.fitting.fit import Unknowns
from gyrowheel_analysis.fitting.kept_windows import CODE
from gyrowheel_analysis.fitting.prediction import Prediction
from gyrowheel_analysis.fitting.preparation import Prepared, Progress
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_core import cache
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.library import LIBRARY

_PREFIX = "explanation_"
_MOST, _BYTES = 60, 1 << 30  # entries, and their total size; one of an hour may have 200 MB
_LIBRARIES = ("numba", "numpy", "scipy", "sympy")
_WORTH = 0.5  # s of search, from which on it is kept


def explanation_of(
    prepared: Prepared, recordings: Sequence[Recording], progress: Progress | None = None
) -> Explanation:
    """Return the explanation of prepared recordings, from the cache if it was found before; see `explained`."""
    # recordings for validation decide nothing of it
    first = dataclasses.replace(prepared, validation=None)
    try:
        name = _PREFIX + _key(first, recordings)
    except cache.UNREADABLE:  # an effect of another package, for example
        return explained(first, recordings, progress).validated_by(prepared.validation)
    if (content := cache.read(name)) is not None:
        with contextlib.suppress(*cache.UNREADABLE):
            found, columns = _Reader(content, first).load()
            first.problem.prediction.know(columns)
            return found.validated_by(prepared.validation)
    began = time.monotonic()
    found = explained(first, recordings, progress)
    if time.monotonic() - began > _WORTH and not found.ended:
        with contextlib.suppress(*cache.UNREADABLE):
            cache.write(name, _Writer(first).dumped((found, first.problem.prediction.known)))
            cache.keep_latest(_PREFIX, _MOST, _BYTES)
    return found.validated_by(prepared.validation)


def _key(first: Prepared, recordings: Sequence[Recording]) -> str:
    """Return a short name of all that decides an explanation."""
    unknowns, bench = first.problem.unknowns, first.problem.bench
    about: list[Any] = [
        bench.stated, unknowns.known, unknowns.known_errors, unknowns.assumed, first.problem.noise.scales
    ]  # fmt: skip
    parts = [code_key(unknowns.library, unknowns.declared), *(recording.content for recording in recordings)]
    for balance in first.problem.balances:
        about.append((balance.harmonics, sorted(balance.absent), balance.assumed, balance.phase_error))
        # hum that another recording shows is in the noise of these windows
        every = (getattr(balance.windows, field.name) for field in dataclasses.fields(balance.windows))
        parts += [np.ascontiguousarray(values).tobytes().hex() for values in every]
    return cache.digest(*parts, repr(about))


def code_key(library: Mapping[str, Effect], declared: Collection[str]) -> str:
    """Return a short name of the code of an analysis, and of those effects of a library that are not of this project.

    Raises
    ------
    One of `cache.UNREADABLE`
        If such an effect cannot be described.
    """
    own = {effect.name for effect in LIBRARY} - set(declared)
    foreign = {name: effect for name, effect in library.items() if name not in own}
    described = repr(sorted(foreign)), pickle.dumps(list(foreign.values())).hex()
    return cache.digest(cache.files_of(*CODE), *map(version, _LIBRARIES), *described)


def _known(first: Prepared) -> Iterator[tuple[str, Any]]:
    """Yield what an explanation shares with the prepared recordings, and what every process has, with names."""
    problem = first.problem
    yield from {
        "prepared": first, "problem": problem, "prediction": problem.prediction, "noise": problem.noise,
        "base": problem.base, "columns": problem.base_jacobian, "bench": problem.bench, "names": first.names,
        "shown": first.shown, "balances": problem.balances,
    }.items()  # fmt: skip
    for number, balance in enumerate(problem.balances):
        yield f"balance {number}", balance
        for name, own in vars(balance).items():
            if name in ("windows", "_uncleaned", "motion", "bench", "_response"):
                yield f"{name} {number}", own
    for name, effect in problem.unknowns.library.items():
        yield f"effect {name}", effect


#: What is not written of some classes, as it is large and follows from the rest, with what stands in its place.
_LEFT_OUT: dict[type, dict[str, Any]] = {
    Problem: {"_fits": OrderedDict(), "measured": None},
    Prediction: {"_states": OrderedDict(), "as_stated": None, "candidate_columns": None},
    Balance: {"_kinematics": None, "_derivatives": {}},
}


class _Writer(pickle.Pickler):
    """Writes an explanation, by name what it shares with the prepared recordings."""

    def __init__(self, first: Prepared) -> None:
        self._file = io.BytesIO()
        super().__init__(self._file, protocol=pickle.HIGHEST_PROTOCOL)
        self._first = first
        self._names = {id(own): name for name, own in _known(first) if own is not None}

    def dumped(self, content: object) -> bytes:
        """Return the content as it is written."""
        self.dump(content)
        return self._file.getvalue()

    def persistent_id(self, obj: Any) -> str | None:
        """Return the name of what is shared."""
        if isinstance(obj, Unknowns):
            if obj.known is not self._first.problem.unknowns.known:
                raise pickle.PicklingError("unknowns of another problem")
            return "unknowns with memory" if obj.memory else "unknowns"
        return self._names.get(id(obj))

    def reducer_override(self, obj: Any) -> Any:
        """Return how an object is written without what is left out."""
        if (left_out := _LEFT_OUT.get(type(obj))) is None:
            return NotImplemented
        state = {name: own for name, own in vars(obj).items() if name not in left_out}
        state |= {name: own for name, own in left_out.items() if name.startswith("_")}
        return copyreg.__newobj__, (type(obj),), state  # type: ignore[attr-defined]


class _Reader(pickle.Unpickler):
    """Reads an explanation of prepared recordings."""

    def __init__(self, content: bytes, first: Prepared) -> None:
        super().__init__(io.BytesIO(content))
        self._shared = dict(_known(first))
        unknowns = first.problem.unknowns
        self._shared |= {"unknowns": unknowns, "unknowns with memory": unknowns.with_memory()}

    def persistent_load(self, pid: str) -> Any:
        """Return what is shared."""
        return self._shared[pid]
