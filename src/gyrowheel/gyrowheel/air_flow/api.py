"""Air torque on the rotor: models side by side, torque tables, and computations with OpenFOAM."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from gyrowheel.simulation.code_identity import files_of
from gyrowheel_air.cfd.case import Case, Result, run_case, shared_mesh
from gyrowheel_air.cfd.sweep import Outcome, Step, Tell, companions, plan
from gyrowheel_air.cfd.sweep import sweep as run_sweep
from gyrowheel_air.check import check_table
from gyrowheel_air.compare import compare
from gyrowheel_air.geometry import Geometry
from gyrowheel_air.state import AirState
from gyrowheel_air.table import TorqueTable, collect_results
from gyrowheel_core.cache import digest
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import json_text
from gyrowheel_core.journal import Work, begin, require_same
from gyrowheel_core.journal import begun as what_begun
from gyrowheel_core.units import DEG, RPM

__all__ = [
    "AirState",
    "Case",
    "Geometry",
    "InputError",
    "Result",
    "SweepSettings",
    "TorqueTable",
    "air_state",
    "case_of",
    "check_table",
    "compare",
    "run_case",
    "shared_mesh",
    "sweep",
    "sweep_settings",
    "table_of",
]

KIND = "sweep"


def air_state(temperature: float | None = None, pressure: float | None = None) -> AirState:
    """Return the air of a computation; what is not given is as in the paper.

    Parameters
    ----------
    temperature : float, optional
        Air temperature [°C].
    pressure : float, optional
        Air pressure [hPa].
    """
    if temperature is None and pressure is None:
        return AirState.paper()
    given = 20.0 if temperature is None else temperature
    return AirState.of(given + 273.15, 101325.0 if pressure is None else 100.0 * pressure)


def case_of(
    geometry: str,
    tilt: float,
    speed: float,
    mesh: str,
    model: str | None,
    *,
    direction: float = 0.0,
    temperature: float | None = None,
    pressure: float | None = None,
    iterations: int | None = None,
    window: int | None = None,
    settle: int = 0,
) -> Case:
    """Return a case of the flow computation.

    Parameters
    ----------
    geometry : str
        Rotor and case: shipped name, or a file.
    tilt, direction : float
        Tilt about the case's x axis, and how far its axis is turned from x towards y [°].
    speed : float
        Spin rate [rpm].
    mesh : str
        Name of the mesh.
    model : str or None
        Model of turbulence; the usual one of the mesh if None.
    temperature, pressure : float, optional
        See `air_state`.
    iterations, window : int, optional
        Iterations of the solver, and how many of the last ones are averaged.
    settle : int
        Go on until the torque has settled, but not beyond so many iterations; 0: do not go on.

    Raises
    ------
    InputError
        If a name is not known or a value is out of range.
    """
    options = {}
    if iterations is not None:
        usual = iterations // 2 if iterations > Case.iterations else min(Case.window, iterations // 2)
        options = {"iterations": iterations, "window": max(2, usual)}
    if window is not None:
        options["window"] = window
    return Case.of(
        Geometry.load(geometry),
        air_state(temperature, pressure),
        tilt * DEG,
        speed * RPM,
        mesh=mesh,
        model=model,
        direction=direction * DEG,
        settle=settle,
        **options,
    )


@dataclass(frozen=True)
class SweepSettings:
    """What a sweep computes; its folder keeps them under these names.

    Attributes
    ----------
    tilts, speeds : sequence of float
        Tilts [°] and spin rates [rpm].
    base : float
        Spin rate from which the others of a tilt start [rpm].
    checks : bool
        Compute the cases as well that show the influence of mesh, model and axes, at the largest tilt.
    geometry, mesh, model, iterations, settle, temperature, pressure
        See `case_of`.
    """

    tilts: Sequence[float]
    speeds: Sequence[float]
    base: float = 3500.0
    geometry: str = "gyrowheel"
    mesh: str = "low_re"
    model: str | None = None
    iterations: int = Case.iterations
    settle: int = 0
    checks: bool = False
    temperature: float | None = None
    pressure: float | None = None

    def levels(self) -> list[list[Step]]:
        """Return the cases, those that start from others behind them."""
        cases = [self._case(tilt, speed) for tilt in self.tilts for speed in self.speeds]
        base = self.base * RPM
        levels = plan(
            cases[0], [tilt * DEG for tilt in self.tilts], [rate * RPM for rate in self.speeds], base
        )
        if self.checks:
            levels.append(companions(cases[0], max(self.tilts) * DEG, base))
        return levels

    def _case(self, tilt: float, speed: float) -> Case:
        return case_of(
            self.geometry,
            tilt,
            speed,
            self.mesh,
            self.model,
            temperature=self.temperature,
            pressure=self.pressure,
            iterations=self.iterations,
            settle=self.settle,
        )


def sweep(
    folder: Path,
    settings: SweepSettings,
    *,
    jobs: int | None = None,
    dask: str | None = None,
    resume: bool = False,
    begun: Callable[[], object] | None = None,
    tell: Tell,
) -> Outcome:
    """Compute the torque at all tilts and speeds; cases that the folder has already are not computed again.

    Parameters
    ----------
    folder : Path
        Folder of the study.
    settings : SweepSettings
        What to compute.
    jobs : int, optional
        Cases at a time; one per core if not given.
    dask : str, optional
        Address of a Dask scheduler whose workers run the cases and see the folder.
    resume : bool
        Go on with the sweep that the folder was last used for: settings must be the same, and so must the code.
    begun : callable, optional
        Called before the first case is computed; from then on the sweep can be gone on with.
    tell : callable
        Told after each case; see `gyrowheel_air.cfd.sweep.Tell`.

    Raises
    ------
    InputError
        If a value is unknown or out of range, there is nothing to go on with, OpenFOAM is not installed, or another
        sweep works in the folder.
    """
    if Path(settings.geometry).is_file():
        settings = replace(settings, geometry=str(Path(settings.geometry).absolute()))
    work = Work(
        kind=KIND,
        settings=asdict(settings),
        contents={"geometry": digest(json_text(Geometry.load(settings.geometry).to_dict()))},
        versions={"gyrowheel": files_of("gyrowheel_air")},
    )
    if resume:
        require_same(folder, work)

    def note() -> None:
        begin(folder, work)
        if begun is not None:
            begun()

    return run_sweep(
        settings.levels(), folder, jobs=jobs or os.cpu_count() or 1, dask=dask, begin=note, tell=tell
    )


def sweep_settings(folder: Path) -> dict[str, Any]:
    """Return the settings, by name, with which the last one in a folder was begun.

    Raises
    ------
    InputError
        If there is none.
    """
    return what_begun(folder, KIND).settings


def table_of(source: str) -> TorqueTable:
    """Return a torque table: shipped name, file, or the folder of a study, of which it is made."""
    if source != "gyrowheel" and Path(source).is_dir():
        return TorqueTable.of(collect_results(Path(source)), origin=source)
    return TorqueTable.load(source)
