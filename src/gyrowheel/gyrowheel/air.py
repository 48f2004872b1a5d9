"""Air torque on the rotor: models side by side, torque tables, and computations with OpenFOAM."""

from __future__ import annotations

from pathlib import Path

from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.air.cfd.case import Case, Result, run_case, shared_mesh
from gyrowheel_sim.air.cfd.sweep import companions, plan, sweep
from gyrowheel_sim.air.check import check_table
from gyrowheel_sim.air.compare import compare
from gyrowheel_sim.air.geometry import Geometry
from gyrowheel_sim.air.state import AirState
from gyrowheel_sim.air.table import TorqueTable, collect_results

__all__ = [
    "AirState",
    "Case",
    "Geometry",
    "InputError",
    "Result",
    "TorqueTable",
    "air_state",
    "case_of",
    "check_table",
    "companions",
    "compare",
    "plan",
    "run_case",
    "shared_mesh",
    "sweep",
    "table_of",
]


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


def table_of(source: str) -> TorqueTable:
    """Return a torque table: shipped name, file, or the folder of a study, of which it is made."""
    if source != "gyrowheel" and Path(source).is_dir():
        return TorqueTable.of(collect_results(Path(source)), origin=source)
    return TorqueTable.load(source)
