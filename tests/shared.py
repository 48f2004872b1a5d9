"""Expensive read-only test data, made once per test run and shared by all its workers."""

from __future__ import annotations

import fcntl
import os
import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

Made = TypeVar("Made")


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], Made]) -> Made:
    """Return test data that the first worker to ask makes in a new folder; the others wait and read them.

    Parameters
    ----------
    factory : pytest.TempPathFactory
        Gives the folder of this test run.
    name : str
        Name of the data, unique in the run.
    make : callable
        Makes the data, given a folder for its files; the result is kept as a pickle.
    """
    root = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent
    root = root / "shared"
    root.mkdir(exist_ok=True)
    kept = root / f"{name}.pickle"
    with (root / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            made = make(Path(tempfile.mkdtemp(prefix=f"{name}-", dir=root)))
            (root / f"{name}.part").write_bytes(pickle.dumps(made))
            (root / f"{name}.part").rename(kept)
            return made
    found: Made = pickle.loads(kept.read_bytes())
    return found
