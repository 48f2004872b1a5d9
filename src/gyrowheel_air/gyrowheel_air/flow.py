"""Extract of the computed flow for pictures: section across the axis of the tilt, top and surface of the rotor.

A solution takes a hundred megabytes; its extract some hundred kilobytes, which ship with the project.
"""

from __future__ import annotations

import functools
import io
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_air.cfd.case import Result, last_time
from gyrowheel_air.cfd.mesh import PolyMesh, read_field
from gyrowheel_air.table import collect_results
from gyrowheel_core.files import write_bytes
from gyrowheel_core.units import DEG, RPM

Array = NDArray[np.float64]
#: The conditions of the paper's Figs 10 to 12: tilt [rad] and spin rate [rad/s].
CONDITIONS = ((0.0, 3500.0 * RPM), (5.0 * DEG, 3500.0 * RPM), (5.0 * DEG, 2000.0 * RPM))
_PLACES = "section", "top", "surface"  # rounded to 0.1 micrometre
_FLAT = 1e-7  # m: how far a face of the section may lie off its plane


@dataclass(frozen=True)
class Flow:
    """The flow in one case, on the faces of a mesh; a face has four corners."""

    #: Tilt about the case's x axis [rad] and spin rate [rad/s].
    tilt: float
    spin_rate: float
    #: Names of mesh and turbulence model.
    mesh: str
    model: str
    cells: int  # cells of the mesh
    #: Lengths [m].
    rotor_height: float
    case_radius: float
    section: Array  # faces in the plane across the axis of the tilt: case y and z of their corners [m]
    #: Velocity up and outwards there [m/s].
    axial: Array
    radial: Array
    top: Array  # faces of the rotor's top: along the axis of the tilt, and a quarter turn ahead of it [m]
    #: Pressure less its mean there [Pa], and area of the faces [m^2].
    pressure: Array
    area: Array
    surface: Array  # faces of the rotor in the frame of the case [m]

    @classmethod
    def of(cls, result: Result, folder: Path) -> Flow:
        """Take the flow from a solution.

        Parameters
        ----------
        result : Result
            The finished case.
        folder : Path
            Folder of its solution.

        Raises
        ------
        InputError
            If the solution cannot be read.
        """
        mesh, case = PolyMesh.read(folder), result.case
        inner = len(mesh.neighbour)
        flat = np.flatnonzero(np.all(np.abs(mesh.points[mesh.faces[:inner], 0]) < _FLAT, axis=1))
        velocity = read_field(last_time(folder) / "U", mesh.cells)
        there = 0.5 * (velocity[mesh.owner[flat]] + velocity[mesh.neighbour[flat]])
        rotor = mesh.patches["rotor"]
        upper = mesh.face_centres[rotor] @ case.axes[2] > 0.4999 * case.lengths[1]
        # at a wall the pressure has no gradient: it is that of the cell
        kinematic = read_field(last_time(folder) / "p", mesh.cells)[mesh.owner[rotor]]
        pressure = case.density * kinematic[upper]
        area = np.linalg.norm(mesh.face_areas[rotor][upper], axis=1)
        return cls(
            tilt=case.tilt,
            spin_rate=case.spin_rate,
            mesh=case.mesh,
            model=case.model,
            cells=mesh.cells,
            rotor_height=case.lengths[1],
            case_radius=case.lengths[2],
            section=mesh.points[mesh.faces[flat]][:, :, 1:],
            axial=there[:, 2],
            radial=there[:, 1] * np.sign(mesh.face_centres[flat][:, 1]),
            top=mesh.points[mesh.faces[rotor][upper]] @ case.axes[:2].T,
            pressure=pressure - np.average(pressure, weights=area),
            area=area,
            surface=mesh.points[mesh.faces[rotor]],
        )

    @property
    def moment(self) -> tuple[float, float]:
        """Torque of the pressure on the top [N m]: about the axis of the tilt, and a quarter turn ahead of it."""
        x, y = np.moveaxis(self.top.mean(axis=1), -1, 0)
        force = -self.pressure * self.area  # along the rotor's axis, which points out of the top
        return float(np.sum(y * force)), float(-np.sum(x * force))


def of_study(study: Path) -> list[Flow]:
    """Return the flow under the paper's conditions as far as they are in the folder of a study.

    Raises
    ------
    InputError
        If the study cannot be read.
    """
    results = collect_results(study)
    counted = Counter((r.case.mesh, r.case.model) for r in results)
    method = counted.most_common(1)[0][0] if counted else None
    return [
        Flow.of(result, study / result.case.name)
        for tilt, rate in CONDITIONS
        for result in results
        if np.allclose([result.case.tilt, result.case.spin_rate, result.case.direction], [tilt, rate, 0.0])
        and (result.case.mesh, result.case.model) == method
    ]


def write(path: Path, flows: Sequence[Flow]) -> None:
    """Write flows as a compressed file of arrays, in single precision."""
    plain: list[dict[str, Any]] = []
    arrays: dict[str, Any] = {}
    for number, flow in enumerate(flows):
        plain.append({})
        for item in fields(flow):
            value = getattr(flow, item.name)
            if not isinstance(value, np.ndarray):
                plain[-1][item.name] = value
            elif item.name in _PLACES:
                arrays[f"{number}_{item.name}"] = np.round(1e7 * value).astype(np.int32)
            else:
                arrays[f"{number}_{item.name}"] = value.astype(np.float32)
    stream = io.BytesIO()
    np.savez_compressed(stream, about=np.frombuffer(json.dumps(plain).encode(), dtype=np.uint8), **arrays)
    write_bytes(path, stream.getvalue())


@functools.cache
def shipped() -> tuple[Flow, ...]:
    """Return the flow under the paper's conditions that comes with the project."""
    data = resources.files("gyrowheel_air").joinpath("data/flow.npz").read_bytes()
    with np.load(io.BytesIO(data)) as content:
        plain = json.loads(content["about"].tobytes())
        return tuple(
            Flow(
                **own,
                **{
                    name: content[f"{number}_{name}"].astype(np.float64) * (1e-7 if name in _PLACES else 1.0)
                    for name in (item.name for item in fields(Flow))
                    if name not in own
                },
            )
            for number, own in enumerate(plain)
        )
