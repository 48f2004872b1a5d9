"""What the tests of the air share: made-up tables, and programs that play a recorded run in place of OpenFOAM."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gyrowheel_air.cfd.case import Case, Result
from gyrowheel_air.cfd.openfoam import Torque
from gyrowheel_air.cfd.sweep import plan
from gyrowheel_air.geometry import Geometry
from gyrowheel_air.table import TorqueTable
from gyrowheel_air.torque import AirState
from gyrowheel_core.units import DEG, RPM

RECORDED = Path(__file__).parent / "recorded"
GEOMETRY = Geometry.load()
AIR = AirState.paper()


def tiny(tilt: float = 5.0, rpm: float = 3500.0, **options: object) -> Case:
    settings = {"mesh": "tiny", "iterations": 40, "window": 20} | options
    return Case.of(GEOMETRY, AIR, tilt * DEG, rpm * RPM, **settings)  # type: ignore[arg-type]


def levels_of(tilts: list[float], rpms: list[float]):
    template = tiny()
    return plan(template, [t * DEG for t in tilts], [w * RPM for w in rpms], 3500 * RPM)


SPEEDS = RPM * np.array([1000.0, 2000.0, 3000.0, 3500.0, 4000.0])
TILTS = DEG * np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])


def row(tilt: float, speed: float, torque: ArrayLike, *, scatter: float = 0.0, **options: Any) -> Result:
    """Return a row of a table that was never computed."""
    mean = np.asarray(torque, dtype=float)
    nothing = np.zeros(3)
    stress = float(np.sqrt(abs(mean[2]) / 1e-3))  # y+ goes with the root of the stress on the wall
    return Result(
        case=Case.of(GEOMETRY, AIR, tilt, speed, **options),
        torque=Torque(mean, np.full(3, scatter), nothing, mean * [0.99, 1.0, 0.0], 200),
        y_plus={"rotor": (stress, 2.0 * stress), "case": (0.8, 1.5)},
        provenance={"cells": 1000, "wall_functions": False, "model": "made up", "version": "none"},
    )


def power_laws(
    tilt: float, speed: float, k: float = 0.022, c: float = 0.0053, w: float = 0.95e-3
) -> np.ndarray:
    """Return torques that follow power laws exactly, on the axes of the tilt."""
    r = speed / (3500.0 * RPM)
    across = np.tan(tilt)
    return np.array([-k * r**2.05 * across, c * r**1.98 * across / np.cos(tilt), -w * r**1.48])


def found_laws(tilt: float, speed: float) -> np.ndarray:
    """Return torques as they were found of the published rotor: the drag falls with the tilt."""
    laws = power_laws(tilt, speed, k=0.0258, c=0.0067, w=0.92e-3)
    return laws * [1.0, 1.0, 1.0 - 0.17 * tilt / TILTS[-1]]


def made_up(
    law: Callable[[float, float], np.ndarray] = power_laws,
    tilts: Sequence[float] | np.ndarray = TILTS,
    speeds: Sequence[float] | np.ndarray = SPEEDS,
    beside: Sequence[Result] = (),
) -> TorqueTable:
    """Return a table that follows a law."""
    grid = [row(tilt, speed, law(tilt, speed)) for tilt in tilts for speed in speeds]
    return TorqueTable.of([*grid, *beside], origin="made up")


class Player:
    """Programs named like OpenFOAM's that write down their calls and play a recorded run of 40 iterations.

    Parameters
    ----------
    folder : Path
        Where the programs and the list of calls go.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.path = folder
        self._calls = folder / "calls"
        self._calls.touch()
        self._hang = folder / "hang"
        self._fail = folder / "fail"
        for name, body in (
            ("blockMesh", f"mkdir -p constant && tar -xzf '{RECORDED}/polyMesh.tar.gz' -C constant"),
            ("checkMesh", f"cat '{RECORDED}/log.checkMesh'"),
            (
                "simpleFoam",
                _SIMPLE_FOAM.format(calls=self._calls, hang=self._hang, fail=self._fail, rec=RECORDED),
            ),
        ):
            program = folder / name
            program.write_text(f"#!/bin/sh\nset -e\n{body}\n", encoding="utf-8")
            program.chmod(program.stat().st_mode | stat.S_IXUSR)

    @property
    def search_path(self) -> str:
        """PATH with these programs first."""
        return f"{self.path}{os.pathsep}{os.environ['PATH']}"

    @property
    def calls(self) -> list[str]:
        """Names of the cases that were solved, in order."""
        return [Path(line).name for line in self._calls.read_text(encoding="utf-8").split()]

    def hang_at(self, call: int | None) -> None:
        """Let the call of this number never end; None: let all end."""
        self._hang.unlink(missing_ok=True)
        if call is not None:
            self._hang.write_text(str(call), encoding="utf-8")

    def fail_in(self, name: str) -> None:
        """Let a case of this name diverge."""
        self._fail.write_text(name, encoding="utf-8")


_SIMPLE_FOAM = """\
pwd >> '{calls}'
if [ -f '{hang}' ] && [ "$(wc -l < '{calls}')" -eq "$(cat '{hang}')" ]; then exec sleep 1000; fi
if [ -f '{fail}' ] && [ "$(basename "$PWD")" = "$(cat '{fail}')" ]; then
  echo '--> FOAM FATAL ERROR: Maximum number of iterations exceeded'; echo; exit 1
fi
end=$(sed -n 's/^endTime \\(.*\\);/\\1/p' system/controlDict)
start=$(sed -n 's/^startTime \\(.*\\);/\\1/p' system/controlDict)
mkdir -p "$end" "postProcessing/torque/$start"
awk -v s="$start" -v e="$end" '/^#/ || $1 <= e - s {{ if (!/^#/) $1 += s; print }}' '{rec}/moment.dat' \\
  > "postProcessing/torque/$start/moment.dat"
gzip -dc '{rec}/wallShearStress.gz' > "$end/wallShearStress"
for field in U p k epsilon omega; do
  value=1; [ $field = U ] && value='(0 0 0)'
  echo "internalField uniform $value; boundaryField {{ }}" > "$end/$field"
done
cat '{rec}/log.simpleFoam'
"""
