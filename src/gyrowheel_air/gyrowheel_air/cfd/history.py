"""Output files of a run: torque at every iteration, residuals, times; whether it has settled and is steady."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrowheel_air.cfd.openfoam import version_in
from gyrowheel_core.errors import InputError

Array = NDArray[np.float64]
#: A torque is settled when the means of both halves of the window differ by less than this part of it.
DRIFT_LIMIT = 0.01
#: A run is steady when its torque scatters less than this part of it about the mean.
SCATTER_LIMIT = 0.02


@dataclass(frozen=True)
class Torque:
    """The torque of a run averaged over its last iterations, on axes that the caller chose."""

    #: Mean; standard deviation over the iterations; mean of the second half less that of the first [N m].
    mean: Array
    scatter: Array
    drift: Array
    pressure: Array  # the share of the pressure in the mean [N m]; the rest is friction
    window: int  # iterations averaged

    @property
    def settled(self) -> bool:
        """Whether the mean has stopped moving: no component drifts by more than 1 % of the torque's size."""
        return bool(np.all(np.abs(self.drift) <= DRIFT_LIMIT * self._size))

    @property
    def steady(self) -> bool:
        """Whether it is steady: no component scatters by more than 2 % of the torque's size."""
        return bool(np.all(self.scatter <= SCATTER_LIMIT * self._size))

    @property
    def _size(self) -> float:
        return float(np.linalg.norm(self.mean))


def read_moments(path: Path) -> tuple[NDArray[np.int64], Array, Array]:
    """Read the log of the torque on the rotor.

    Parameters
    ----------
    path : Path
        ``moment.dat`` of the function object ``forces``.

    Returns
    -------
    iteration : (n,) array of int
    total, pressure : (n, 3) arrays
        Torque about the origin, and the share of the pressure [N m].

    Raises
    ------
    InputError
        If the file is missing, empty, cut off in a line, or holds what is no number.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such log of the torque; the run has not finished")
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        words = line.replace("(", " ").replace(")", " ").split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise InputError(f"{path}: line {number}: not a row of numbers") from None
        if len(values) != 10:
            raise InputError(f"{path}: line {number}: {len(values)} numbers, 10 are expected")
        rows.append(values)
    if not rows:
        raise InputError(f"{path}: empty; the run has not finished")
    table = np.array(rows)
    return table[:, 0].astype(np.int64), table[:, 1:4], table[:, 4:7]


def read_history(folder: Path) -> tuple[Array, Array]:
    """Read the logs of the torque of a run that went on one or more times.

    Parameters
    ----------
    folder : Path
        Of the function object: in it a folder for each iteration from which the run went on.

    Returns
    -------
    total, pressure : (n, 3) arrays
        As from `read_moments`.

    Raises
    ------
    InputError
        If there is none, one is broken, or iterations are missing between them.
    """
    starts = (
        sorted(int(path.name) for path in folder.iterdir() if path.name.isdigit()) if folder.is_dir() else []
    )
    parts = [read_moments(folder / str(start) / "moment.dat") for start in starts or [0]]
    iteration = np.concatenate([part[0] for part in parts])
    if np.any(np.diff(iteration) != 1):
        raise InputError(f"{folder}: iterations are missing between the logs of the torque")
    return np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts])


def average(total: Array, pressure: Array, axes: Array, window: int) -> Torque:
    """Average a history of the torque over its last iterations.

    Parameters
    ----------
    total, pressure : (n, 3) arrays
        As from `read_moments`.
    axes : (3, 3) array
        Unit vectors, one a row, on which the torque is taken.
    window : int
        Iterations to average.

    Raises
    ------
    InputError
        If there are fewer iterations than that, or a value is not finite.
    """
    if len(total) < window:
        raise InputError(f"the run has {len(total)} iterations, the average needs {window}")
    last = total[-window:] @ axes.T
    if not np.all(np.isfinite(last)):
        raise InputError("the torque of the run is not finite: it diverged")
    half = window // 2
    return Torque(
        mean=last.mean(axis=0),
        scatter=last.std(axis=0),
        drift=last[-half:].mean(axis=0) - last[:half].mean(axis=0),
        pressure=(pressure[-window:] @ axes.T).mean(axis=0),
        window=window,
    )


@dataclass(frozen=True)
class SolverLog:
    """Content of the solver's log."""

    version: str | None  # openFOAM's version
    iterations: int  # iterations done
    residuals: dict[str, float]  # initial residual of each field in the last iteration
    seconds: float  # CPU time [s]
    finished: bool  # whether it came to its end


def read_log(text: str) -> SolverLog:
    """Read a log of simpleFoam; a truncated log is read as far as it goes."""
    residuals = {}
    for field, value in re.findall(r"Solving for (\w+), Initial residual = ([-+.\deE]+)", text):
        residuals[field] = float(value)
    times = re.findall(r"ExecutionTime = ([\d.]+) s", text)
    return SolverLog(
        version=version_in(text),
        iterations=len(re.findall(r"^Time = \d+\s*$", text, re.MULTILINE)),
        residuals=residuals,
        seconds=float(times[-1]) if times else 0.0,
        finished=bool(re.search(r"^End\s*$", text, re.MULTILINE)),
    )
