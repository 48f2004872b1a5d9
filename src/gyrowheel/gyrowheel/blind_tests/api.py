"""Opening the sealed key of a blind test, with or without a model to judge."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from gyrowheel.blind_tests.judge import OpenedKey, Quantity
from gyrowheel.blind_tests.page import key_page
from gyrowheel.catalogue.api import load_bench
from gyrowheel.models.api import Model
from gyrowheel.show.result import Result
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import read_key


@dataclass(frozen=True, repr=False)
class Key(Result, OpenedKey):
    """Outcome of `gyrowheel.open_key`; the fields are those of `gyrowheel.blind_tests.judge.OpenedKey`."""

    def headline(self) -> str:
        """Return the hidden effects or, with a model, the comparison."""
        return self.sentence

    def page(self) -> Iterable[RenderableType]:
        """Return the tables of effects and parameters: hidden, in the model, and their distance."""
        return key_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel key --json``; SI units."""

        def content(q: Quantity) -> dict[str, Any]:
            numbers = {"hidden": q.hidden, "model": q.value, "standard_error": q.standard_error}
            owner = {"effect": q.owner, "coefficient": q.name} if q.owner else {"parameter": q.name}
            return owner | {"unit": q.unit} | numbers | {"distance": q.distance}

        return {
            "schema": 1,
            "key": str(self.path),
            "model": None if self.model is None else self.model.origin,
            "outcome": self.outcome,
            "sentence": self.sentence,
            "effects": [content(q) for q in self.effects],
            "parameters": [content(q) for q in self.parameters],
        }

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return effects and parameters as columns, a row for each coefficient or parameter; SI units."""
        rows = [*self.effects, *self.parameters]
        names = ("owner", "name", "unit", "hidden", "value", "standard_error", "distance")
        return {name: [getattr(q, name) for q in rows] for name in names}


def open_key(
    key: str | Path, against: Model | None = None, *, bench: str | Path | Bench | None = None
) -> Key:
    """Open the key file of a blind test: the hidden machine, compared with a model if one is given.

    Parameters
    ----------
    key : str or Path
        Key file.
    against : Model, optional
        The model to judge.
    bench : str, Path or Bench, optional
        The bench that the key was drawn for; that of the model, or ``gyrowheel``, if not given.

    Raises
    ------
    InputError
        If the file is missing, is not a key file or does not fit the bench, or both a bench and a model are given.
    """
    if against is not None:
        if bench is not None:
            raise InputError("bench: is that of the model; leave it out")
        loaded = against.stated_bench
    else:
        loaded = bench if isinstance(bench, Bench) else load_bench(bench or "gyrowheel")
    return Key(Path(key), read_key(loaded, Path(key)), loaded, against)
