"""One case of a flow computation: from tilt, speed, mesh and model to the torque with scatter and provenance.

The rotor is a body of revolution, so the flow about it is steady in the frame of the case: its wall moves along itself
with the velocity of a rotation about the tilted axis, and no frame of reference has to turn.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_air.cfd import openfoam
from gyrowheel_air.cfd.mesh import (
    MESHES,
    PolyMesh,
    block_mesh_dict,
    check_tilt,
    get_mesh,
    morph,
    read_field,
    read_patch,
    read_points,
    write_field,
    write_points,
)
from gyrowheel_air.cfd.openfoam import Torque, average, read_history, read_log
from gyrowheel_air.geometry import LENGTHS, Geometry
from gyrowheel_air.torque import AirState, tilt_axes
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import write_text
from gyrowheel_core.units import DEG, RPM

Array = NDArray[np.float64]
#: Receives the fraction done, 0 .. 1.
Advance = Callable[[float], None]
SCHEMA = 1
#: Core of the first guess: the air turns as a solid body with this part of the spin rate.
FIRST_SWIRL = 0.42
RESULT, REQUEST = "result.json", "case.json"
_LOG = "log.simpleFoam"
_STRETCH = 200  # iterations that a case goes on for at a time; a kill costs no more than these


@dataclass(frozen=True)
class Case:
    """The conditions and the method of a computation."""

    tilt: float  # angle of the tilt [rad]
    spin_rate: float  # spin rate [rad/s]
    direction: float = 0.0  # angle of the axis of the tilt from the case's x axis [rad]
    mesh: str = "low_re"  # resolution, a key of `MESHES`
    model: str = "sst"  # turbulence: ``"sst"``, ``"paper"`` (k-epsilon with wall functions) or ``"laminar"``
    #: Iterations from the first guess on, and how many of the last are averaged.
    iterations: int = 420
    window: int = 200
    #: Iterations up to which it goes on, a window at a time, until the torque has settled; the last half of
    #: all is then averaged, which must not be less than the window. 0: it does not go on.
    settle: int = 0
    #: Iterations of k-epsilon that come before another model's without a first guess.
    start_iterations: int = 100
    #: Air: density [kg/m^3], dynamic viscosity [Pa s].
    density: float = AirState.paper().density
    viscosity: float = AirState.paper().viscosity
    #: Rotor radius and height, case radius and height [m].
    lengths: tuple[float, float, float, float] = (0.0535, 0.038, 0.0575, 0.062)

    @classmethod
    def of(
        cls,
        geometry: Geometry,
        air: AirState,
        tilt: float,
        spin_rate: float,
        *,
        mesh: str = "low_re",
        model: str | None = None,
        **options: Any,
    ) -> Case:
        """Return a case of a geometry and an air state.

        Unless given, the model is SST on a mesh that resolves the wall layer, and the paper's on one for wall
        functions.

        Raises
        ------
        InputError
            If a value is unknown or out of range.
        """
        chosen = model or ("paper" if get_mesh(mesh).wall_functions else "sst")
        lengths = geometry.to_dict()
        case = cls(
            tilt=tilt,
            spin_rate=spin_rate,
            mesh=mesh,
            model=chosen,
            density=air.density,
            viscosity=air.viscosity,
            lengths=tuple(lengths[name] for name in LENGTHS),  # type: ignore[arg-type]
            **options,
        )
        case.check(geometry)
        return case

    def check(self, geometry: Geometry) -> None:
        """Refuse what cannot be computed.

        Raises
        ------
        InputError
            Naming what, its value and what is allowed.
        """
        get_mesh(self.mesh)
        check_tilt(geometry, self.tilt)
        if self.model not in openfoam.MODELS:
            raise InputError(f"model: {self.model!r} is not known; allowed: {', '.join(openfoam.MODELS)}")
        for name, value, low, high in (
            ("speed", self.spin_rate / RPM, 10.0, 20000.0),
            ("iterations", self.iterations, 2, 100000),
            ("window", self.window, 2, self.iterations),
            ("settle", self.settle, 0, 100000),
        ):
            if not low <= value <= high:
                raise InputError(f"{name}: {value:g} is out of range; allowed: {low:g} .. {high:g}")

    @property
    def name(self) -> str:
        """Name of the folder of the case."""
        turned = f"_dir{self.direction / DEG:.4g}" if self.direction else ""
        return f"tilt{self.tilt / DEG:+.4g}_speed{self.spin_rate / RPM:.6g}{turned}_{self.mesh}_{self.model}"

    @property
    def axes(self) -> Array:
        """Axes on which the torque is taken, see `tilt_axes`."""
        return tilt_axes(self.tilt, self.direction)

    @property
    def mesh_key(self) -> str:
        """Short name of all inputs of the mesh."""
        text = json.dumps([self.mesh, asdict(MESHES[self.mesh]), self.tilt, self.direction, self.lengths])
        short = hashlib.sha256(text.encode()).hexdigest()[:8]
        return f"{self.mesh}_tilt{self.tilt / DEG:+.4g}_{short}"

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return asdict(self) | {"lengths": list(self.lengths), "schema": SCHEMA}

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Case:
        """Return the object that `to_json` described."""
        fields = {k: v for k, v in content.items() if k != "schema"}
        return cls(**(fields | {"lengths": tuple(fields["lengths"])}))


@dataclass(frozen=True)
class Result:
    """The result of a case."""

    case: Case
    torque: Torque  # torque of the air on the rotor, on `Case.axes`
    #: By patch: mean and largest distance of the first cell's centre from the wall in wall units.
    y_plus: dict[str, tuple[float, float]]
    provenance: dict[str, Any]  # version, cells, iterations, first guess, residuals, CPU time

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values; torques in N m."""
        t = self.torque
        return {
            "schema": SCHEMA,
            "case": self.case.to_json(),
            "torque": {
                "mean": t.mean.tolist(),
                "scatter": t.scatter.tolist(),
                "drift": t.drift.tolist(),
                "pressure": t.pressure.tolist(),
                "window": t.window,
                "settled": t.settled,
                "steady": t.steady,
            },
            "y_plus": {name: list(values) for name, values in self.y_plus.items()},
            "provenance": self.provenance,
        }

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Result:
        """Return the object that `to_json` described."""
        t = content["torque"]
        arrays = {name: np.array(t[name]) for name in ("mean", "scatter", "drift", "pressure")}
        return cls(
            case=Case.from_json(content["case"]),
            torque=Torque(window=t["window"], **arrays),
            y_plus={name: (v[0], v[1]) for name, v in content["y_plus"].items()},
            provenance=content["provenance"],
        )


def finished(folder: Path, case: Case) -> Result | None:
    """Return the result in a folder if it answers the case; None without a result, or for one of another case.

    A case is answered by one of at least as many iterations, from whatever first guess. One that may go on until it has
    settled (`Case.settle`) is answered by one that has settled, or that went on for as many iterations.
    """
    result = _recorded(folder, case)
    return result if result is not None and _answers(result, case) else None


def _recorded(folder: Path, case: Case) -> Result | None:
    """Return the result in a folder if it is that of the case, however long it went on."""
    try:
        content = json.loads((folder / RESULT).read_text(encoding="utf-8"))
        result = Result.from_json(content)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    own = {name: getattr(case, name) for name in ("settle", "iterations", "window", "start_iterations")}
    return result if replace(result.case, **own) == case else None


def _answers(result: Result, case: Case) -> bool:
    done = result.provenance["iterations"]
    return done >= case.iterations and (result.torque.settled or done >= case.settle)


def make_mesh(case: Case, folder: Path) -> dict[str, Any]:
    """Make the mesh of a case in a folder, and check it.

    Returns
    -------
    dict
        ``cells``, ``non_orthogonality`` [deg], ``skewness``, ``aspect_ratio``, ``ok``.

    Raises
    ------
    InputError
        If OpenFOAM is not installed or fails, or checkMesh finds the mesh bad.
    """
    openfoam.require()
    geometry = _geometry(case)
    system = folder / "system"
    system.mkdir(parents=True, exist_ok=True)
    resolution = MESHES[case.mesh]
    for name, text in (
        ("blockMeshDict", block_mesh_dict(geometry, resolution)),
        ("controlDict", openfoam.mesh_control_dict()),
        ("fvSchemes", openfoam.schemes()),
        ("fvSolution", openfoam.solution()),
    ):
        (system / name).write_text(text, encoding="utf-8")
    openfoam.run(["blockMesh"], folder, folder / "log.blockMesh")
    points = folder / "constant" / "polyMesh" / "points"
    write_points(points, morph(read_points(points), geometry, case.tilt, case.direction))
    text = openfoam.run(["checkMesh"], folder, folder / "log.checkMesh")
    quality = mesh_quality(text)
    if not quality["ok"]:
        raise openfoam.SolverError(f"the mesh is bad: see {folder / 'log.checkMesh'}")
    return quality


def mesh_quality(text: str) -> dict[str, Any]:
    """Return the quality of a mesh from a log of checkMesh."""
    result: dict[str, Any] = {"ok": "Mesh OK." in text}
    for name, pattern, kind in (
        ("cells", r"^\s*cells:\s+(\d+)", int),
        ("non_orthogonality", r"non-orthogonality Max:\s+([\d.]+)", float),
        ("skewness", r"Max skewness = ([\d.]+)", float),
        ("aspect_ratio", r"Max aspect ratio = ([\d.]+)", float),
    ):
        found = re.search(pattern, text, re.MULTILINE)
        result[name] = kind(found.group(1)) if found else None
    return result


def run_case(
    case: Case, root: Path, *, first: Path | None = None, advance: Advance = lambda part: None
) -> Result:
    """Run a case below a folder, or return its result if it is there.

    A case with too few iterations, or one that has not settled, is continued, in this call or a later one. If only its
    window differs, it is averaged again.

    Parameters
    ----------
    case : Case
        The case to run.
    root : Path
        Folder of the study, with one folder for each case and one for the shared meshes.
    first : Path, optional
        Folder of a finished case on the same topology whose solution, scaled to this speed, is the first guess.
    advance : callable
        Receives the fraction of the iterations done.

    Raises
    ------
    InputError
        If OpenFOAM is not installed or fails.
    """
    folder = root / case.name
    result = _recorded(folder, case)
    if result is not None and _answers(result, case):
        if result.provenance["iterations"] == case.iterations and result.case.window != case.window:
            result = replace(result, case=case, torque=_torque(case, folder, case.iterations))
            write_json(folder / RESULT, result.to_json())
        return result
    openfoam.require()
    if result is None or not (folder / str(result.provenance["iterations"])).is_dir():
        result = _begin(case, folder, root, first, advance)
    while not _answers(result, case):
        result = _go_on(case, folder, result, advance)
    return result


def _begin(case: Case, folder: Path, root: Path, first: Path | None, advance: Advance) -> Result:
    """Run the first iterations of a case."""
    if folder.exists():
        if any(folder.iterdir()) and not (folder / REQUEST).is_file():
            raise InputError(f"{folder}: exists and is no case; name another folder for the study")
        shutil.rmtree(folder)  # remains of a killed run, or another case of this name
    folder.mkdir(parents=True)
    write_json(folder / REQUEST, case.to_json())
    quality = shared_mesh(case, root)
    seconds = 0.0
    guessed = 0 if first is not None or case.model == "paper" else case.start_iterations
    total = guessed + max(case.iterations, case.settle)
    if guessed > 0:
        # SST from solid-body rotation goes astray; k-epsilon on the same mesh does not, and SST from it settles
        before = replace(case, model="paper", iterations=guessed, window=2)
        seconds += _solve(before, folder / "start", root, first=None, step=lambda i: advance(i / total))
        first = folder / "start"
        guess = f"k-epsilon on the same mesh, {guessed} iterations from solid-body rotation"
    elif first is not None:
        guess = f"scaled from {first.name}"
    else:
        guess = f"solid-body rotation at {FIRST_SWIRL:g} of the spin rate"
    seconds += _solve(case, folder, root, first=first, step=lambda i: advance((guessed + i) / total))
    result = collect(case, folder, quality | {"first_guess": guess, "cpu_seconds": round(seconds, 1)})
    shutil.rmtree(folder / "start", ignore_errors=True)
    write_json(folder / RESULT, result.to_json())
    return result


def _go_on(case: Case, folder: Path, before: Result, advance: Advance) -> Result:
    """Continue a case for some iterations; its previous result stays until they are done."""
    done = before.provenance["iterations"]
    goal = case.iterations if done < case.iterations else case.settle
    for path in [*_times(folder), *_times(folder / "postProcessing" / "torque")]:
        # remains of a killed run
        if int(path.name) > done or (path.parent != folder and int(path.name) == done):
            shutil.rmtree(path)
    write_json(folder / REQUEST, case.to_json())
    text = openfoam.control_dict(done, min(case.window, _STRETCH, goal - done), case.density)
    (folder / "system" / "controlDict").write_text(text, encoding="utf-8")
    log = openfoam.run(
        ["simpleFoam"], folder, folder / _LOG, step=lambda i: advance(i / max(case.iterations, case.settle))
    )
    seconds = before.provenance["cpu_seconds"] + read_log(log).seconds
    result = collect(case, folder, before.provenance | {"cpu_seconds": round(seconds, 1)})
    write_json(folder / RESULT, result.to_json())
    shutil.rmtree(folder / str(done))
    return result


def collect(case: Case, folder: Path, provenance: dict[str, Any]) -> Result:
    """Read the result of a case that was run in a folder (see `run_case`)."""
    path = folder / _LOG
    log = read_log(path.read_text(encoding="utf-8", errors="replace"))
    if not log.finished:
        raise InputError(f"{path}: the run did not come to its end")
    done = int(last_time(folder).name)
    torque = _torque(case, folder, done)
    return Result(
        case=case,
        torque=torque,
        y_plus=wall_units(case, folder),
        provenance=provenance
        | {
            "program": "OpenFOAM simpleFoam",
            "version": log.version,
            "model": openfoam.MODELS[case.model][0],
            "wall_functions": MESHES[case.mesh].wall_functions or case.model == "paper",
            "iterations": done,
            "residuals": log.residuals,
        },
    )


def _torque(case: Case, folder: Path, done: int) -> Torque:
    """Return the torque after so many iterations."""
    total, pressure = read_history(folder / "postProcessing" / "torque")
    window = case.window
    if done != case.iterations:  # the last half; on the way there may be less than a window
        window = done // 2 if done < case.iterations else max(case.window, done // 2)
    return average(total, pressure, case.axes, window)


def wall_units(case: Case, folder: Path) -> dict[str, tuple[float, float]]:
    """Return mean and largest y+ of the first cells on each wall of a finished case.

    It comes from the computed wall stress. The function object of OpenFOAM of that name takes k instead, which is
    nearly zero where the cells resolve the wall layer.
    """
    mesh = PolyMesh.read(folder)
    last = last_time(folder)
    result = {}
    for patch in ("rotor", "case"):
        faces = mesh.patches[patch]
        stress = read_patch(last / "wallShearStress", patch, faces.stop - faces.start)
        speed = np.sqrt(np.linalg.norm(stress, axis=1))
        y = mesh.wall_distance(patch) * speed * case.density / case.viscosity
        area = np.linalg.norm(mesh.face_areas[faces], axis=1)
        result[patch] = (float(np.average(y, weights=area)), float(y.max()))
    return result


def last_time(folder: Path) -> Path:
    """Return the folder of the last iteration that a case has written; raises InputError without one."""
    times = [path for path in _times(folder) if path.name != "0"]
    if not times:
        raise InputError(f"{folder}: no solution has been written")
    return max(times, key=lambda p: int(p.name))


def _times(folder: Path) -> list[Path]:
    """Return the folders of iterations in a folder."""
    return [path for path in folder.iterdir() if path.is_dir() and path.name.isdigit()]


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file atomically."""
    write_text(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def _geometry(case: Case) -> Geometry:
    geometry = Geometry.load()
    for name, value in zip(LENGTHS, case.lengths, strict=True):
        geometry = geometry.with_value(name, value)
    return geometry.checked("case")


def shared_mesh(case: Case, root: Path) -> dict[str, Any]:
    """Make the mesh unless another case has made it; return its quality."""
    place = root / "meshes" / case.mesh_key
    quality = place / "quality.json"
    if not quality.is_file():
        work = place.with_name(f".{place.name}.{os.getpid()}")
        shutil.rmtree(work, ignore_errors=True)
        made = make_mesh(case, work)
        write_json(work / quality.name, made)
        try:
            work.rename(place)
        except OSError:  # another process was faster
            shutil.rmtree(work, ignore_errors=True)
    return dict(json.loads(quality.read_text(encoding="utf-8")))


def _solve(case: Case, folder: Path, root: Path, *, first: Path | None, step: openfoam.Step) -> float:
    """Write a case into a folder, run it, and return the CPU time [s]."""
    for name in ("system", "constant", "0"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    mesh_place = folder / "constant" / "polyMesh"
    if not mesh_place.exists():
        target = root / "meshes" / case.mesh_key / "constant" / "polyMesh"
        mesh_place.symlink_to(os.path.relpath(target, mesh_place.parent))
    write_json(folder / REQUEST, case.to_json())
    for path, text in (
        ("system/controlDict", openfoam.control_dict(0, case.iterations, case.density)),
        ("system/fvSchemes", openfoam.schemes()),
        ("system/fvSolution", openfoam.solution()),
        ("constant/transportProperties", openfoam.transport(case.viscosity / case.density)),
        ("constant/turbulenceProperties", openfoam.turbulence(case.model)),
    ):
        (folder / path).write_text(text, encoding="utf-8")
    _write_start(case, folder, first)
    return read_log(openfoam.run(["simpleFoam"], folder, folder / _LOG, step=step)).seconds


def _write_start(case: Case, folder: Path, first: Path | None) -> None:
    """Write the first guess: of another case, scaled by the speeds, or of a solid body."""
    mesh = PolyMesh.read(folder)
    values = _solid_body(case, mesh) if first is None else _scaled(case, first, mesh.cells)
    axis = " ".join(f"{v:.12g}" for v in case.axes[2])
    rotating = (
        f"type rotatingWallVelocity; origin (0 0 0); axis ({axis}); omega {case.spin_rate:.12g}; "
        "value uniform (0 0 0);"
    )
    walls = openfoam.wall_conditions(case.model, wall_functions=MESHES[case.mesh].wall_functions)
    conditions = {name: {"rotor": text, "case": text} for name, text in walls.items()}
    conditions["U"] = {"rotor": rotating, "case": "type noSlip;"}
    conditions["p"] = dict.fromkeys(("rotor", "case"), "type zeroGradient;")
    for name, patches in conditions.items():
        path = folder / "0" / name
        write_field(path, name, _DIMENSIONS[name], values.get(name, 0.0), patches)


_DIMENSIONS = {
    "U": "0 1 -1 0 0 0 0",
    "p": "0 2 -2 0 0 0 0",
    "k": "0 2 -2 0 0 0 0",
    "epsilon": "0 2 -3 0 0 0 0",
    "omega": "0 0 -1 0 0 0 0",
    "nut": "0 2 -1 0 0 0 0",
}


def _solid_body(case: Case, mesh: PolyMesh) -> dict[str, Array]:
    """Return the first guess where there is no solution to start from."""
    velocity = np.cross(FIRST_SWIRL * case.spin_rate * case.axes[2], mesh.cell_centres)
    k = 1.5 * (0.05 * case.spin_rate * case.lengths[0]) ** 2
    # an eddy viscosity of ten times the molecular one
    omega = k / (10.0 * case.viscosity / case.density)
    scalars = {"p": 0.0, "k": k, "omega": omega, "epsilon": 0.09 * k * omega}
    return {"U": velocity} | {name: np.full(mesh.cells, value) for name, value in scalars.items()}


def _scaled(case: Case, first: Path, cells: int) -> dict[str, Array]:
    """Return the solution of another case scaled to the speed of this one; k-epsilon to k-omega and back."""
    source = Case.from_json(json.loads((first / REQUEST).read_text(encoding="utf-8")))
    last = last_time(first)
    scale = case.spin_rate / source.spin_rate
    values = {
        "U": scale * read_field(last / "U", cells),
        "p": scale**2 * read_field(last / "p", cells),
    }
    theirs = openfoam.MODELS[source.model][1]
    if theirs is not None:
        k = scale**2 * read_field(last / "k", cells)
        other = scale ** {"epsilon": 3, "omega": 1}[theirs] * read_field(last / theirs, cells)
        dissipation = 0.09 * np.maximum(k, 1e-12)
        both = {theirs: other, "omega" if theirs == "epsilon" else "epsilon": other}
        if theirs == "epsilon":
            both["omega"] = other / dissipation
        else:
            both["epsilon"] = other * dissipation
        values |= {"k": k, **both}
    return values
