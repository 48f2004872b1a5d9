"""What is expensive to make and that nothing changes: made once in a run, for all its workers."""

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
    """Return what is made in a new folder by the first worker that asks for it; the others wait, and read it.

    Parameters
    ----------
    factory : pytest.TempPathFactory
        Knows the folder of this run.
    name : str
        Names it within the run.
    make : callable
        Makes it, with files in the folder that it is given; the result is kept as a pickle.
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
