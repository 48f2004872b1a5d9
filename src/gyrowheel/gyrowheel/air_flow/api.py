"""Air torque on the rotor: comparison of models, torque tables, and computations with OpenFOAM."""

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
from gyrowheel_air.table import TorqueTable, collect_results
from gyrowheel_air.torque import AirState
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
    """Return the air of a computation, of a temperature [°C] and a pressure [hPa]; by default that of the paper."""
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
    """Return a case of the flow computation, in the units of the command line: degrees, rpm, °C, hPa.

    `direction` turns the axis of the tilt from x towards y. Without a turbulence model that of the mesh is used. The
    torque is averaged over the `window` last iterations; after `iterations` the solver continues until the torque has
    settled, at most to `settle`.
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
    """Settings of a sweep, as its folder keeps them; those without a comment as in `case_of`."""

    tilts: Sequence[float]  # tilts [°] and spin rates [rpm]
    speeds: Sequence[float]
    base: float = 3500.0  # spin rate from which the others of a tilt start [rpm]
    geometry: str = "gyrowheel"
    mesh: str = "low_re"
    model: str | None = None
    iterations: int = Case.iterations
    settle: int = 0
    #: Compute the cases as well that show the influence of mesh, model and axes, at the largest tilt.
    checks: bool = False
    temperature: float | None = None
    pressure: float | None = None

    def levels(self) -> list[list[Step]]:
        """Return the cases in levels: those of a level start from results of earlier ones."""
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
    """Compute the torque at all tilts and speeds; finished cases in the folder are not computed again.

    Parameters
    ----------
    folder : Path
        Folder of the study.
    settings : SweepSettings
        The settings.
    jobs : int, optional
        Cases at a time; one per core if not given.
    dask : str, optional
        Address of a Dask scheduler whose workers run the cases and see the folder.
    resume : bool
        Resume the last sweep of the folder: settings and code must be the same.
    begun : callable, optional
        Called before the first case is computed; from then on the sweep can be resumed.
    tell : callable
        Called after each case; see `gyrowheel_air.cfd.sweep.Tell`.

    Raises
    ------
    InputError
        If a value is unknown or out of range, there is nothing to resume, OpenFOAM is not installed, or another sweep
        works in the folder.
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
    """Return the settings, by name, of the last sweep of a folder; InputError if it has no sweep."""
    return what_begun(folder, KIND).settings


def table_of(source: str) -> TorqueTable:
    """Return a torque table: a shipped name, a file, or the folder of a study, whose results it collects."""
    if source != "gyrowheel" and Path(source).is_dir():
        return TorqueTable.of(collect_results(Path(source)), origin=source)
    return TorqueTable.load(source)
