"""A sealed key of a blind test is opened, and judged against a model."""

from __future__ import annotations

from pathlib import Path

from gyrowheel.blind_tests.key import Key
from gyrowheel.catalogue.api import load_bench
from gyrowheel.models.api import Model
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import read_key


def open_key(
    key: str | Path, against: Model | None = None, *, bench: str | Path | Bench | None = None
) -> Key:
    """Open the key file of a blind test: what was hidden, beside what a model has.

    Parameters
    ----------
    key : str or Path
        Key file.
    against : Model, optional
        The model to judge; without it the key is shown alone.
    bench : str, Path or Bench, optional
        The bench that the key was drawn for; that of the model, or ``gyrowheel``, if not given.

    Raises
    ------
    InputError
        If the file is missing, is not a key file or does not fit the bench, or a bench is given beside a model.
    """
    if against is not None:
        if bench is not None:
            raise InputError("bench: is that of the model; leave it out")
        loaded = against.stated_bench
    else:
        loaded = bench if isinstance(bench, Bench) else load_bench(bench or "gyrowheel")
    return Key(Path(key), read_key(loaded, Path(key)), loaded, against)
