"""OpenFOAM: its programs and their execution, what a run writes, and the dictionaries that it reads."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_core.processes import die_with_parent

#: Where distributions put OpenFOAM's own files; the programs need to know it, and nothing else of its shell setup.
_HOMES = ("/usr/share/openfoam", "/usr/lib/openfoam")
INSTALL_HINT = (
    "OpenFOAM is not installed (no simpleFoam, blockMesh on the PATH): install it with 'apt-get install openfoam' "
    "(Debian, Ubuntu); all but 'cfd mesh', 'cfd run' and 'cfd sweep' works without it, on the shipped table"
)


#: Receives the present iteration of a program.
Step = Callable[[int], None]


class SolverError(InputError):
    """A program of OpenFOAM failed; the text names the program, the reason that it gave and its log."""


def available() -> bool:
    """Return whether OpenFOAM is installed."""
    return all(shutil.which(name) for name in ("simpleFoam", "blockMesh", "checkMesh"))


def require() -> None:
    """Refuse to continue without OpenFOAM; the error says how to install it."""
    if not available():
        raise InputError(INSTALL_HINT)


def environment() -> dict[str, str]:
    """Return the environment for programs of OpenFOAM.

    The distribution's ``bashrc`` is not sourced: it sets what the packaged programs do not need and fails under
    ``set -u``. ``WM_PROJECT_DIR`` alone is needed: the programs find their dictionaries below it.
    """
    result = dict(os.environ)
    if "WM_PROJECT_DIR" not in result:
        found = next((home for home in _HOMES if Path(home, "etc", "controlDict").is_file()), None)
        if found is not None:
            result["WM_PROJECT_DIR"] = found
    # one case, one core: the parallel libraries that it links must not start threads of their own
    return result | {"OMP_NUM_THREADS": "1", "FOAM_SIGFPE": "true"}


def version_in(text: str) -> str | None:
    """Return the version and patch that a log names, for example ``1912 (patch=200626)``, or None."""
    found = re.search(r"^Build\s*:\s*(?:OPENFOAM=)?(.+?)\s*$", text, re.MULTILINE)
    if found is None:
        return None
    number, _, patch = found.group(1).partition(" ")
    return f"{number} ({patch.strip()})" if patch else number


def run(command: list[str], folder: Path, log: Path, *, step: Step | None = None) -> str:
    """Run one program in a case folder, its output into a log, and return the log.

    The program is a process group of its own and ends with this one: on an interrupt, an error, or a kill by
    SIGTERM that was turned into an exception. While it runs, `step` is told its last iteration now and then.

    Raises
    ------
    SolverError
        If the program ends with an error.
    """
    with log.open("w", encoding="utf-8") as target:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=target,
            stderr=subprocess.STDOUT,
            env=environment() | {"PWD": str(folder.resolve())},
            start_new_session=True,
            preexec_fn=die_with_parent,
        )
        try:
            code = _wait(process, log, step)
        except BaseException:
            _end(process)
            raise
    text = log.read_text(encoding="utf-8", errors="replace")
    if code != 0:
        raise SolverError(f"{command[0]} failed: {reason(text, code)}; log: {log}")
    return text


def _wait(process: subprocess.Popen[bytes], log: Path, step: Step | None) -> int:
    while step is not None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(timeout=0.5)
        with log.open("rb") as source:
            source.seek(max(0, log.stat().st_size - 4096))
            times = re.findall(rb"^Time = (\d+)\s*$", source.read(), re.MULTILINE)
        if times:
            step(int(times[-1]))
    return process.wait()


def reason(text: str, code: int) -> str:
    """Return the reason of a failure, in one line, from the log of the program."""
    error = re.search(r"--> FOAM FATAL (?:IO )?ERROR:?\s*(.+?)(?:\n\s*\n|\n\s*From |\Z)", text, re.DOTALL)
    if error is not None:
        return " ".join(error.group(1).split())
    if "sigFpe" in text or code in (-signal.SIGFPE, 128 + signal.SIGFPE):
        return "the solution diverged (floating-point exception)"
    if code < 0:
        return f"ended by signal {-code} ({signal.strsignal(-code)})"
    last = text.strip().splitlines()[-1:]
    return " ".join(last[0].split()) if last else f"exit status {code}"


def _end(process: subprocess.Popen[bytes]) -> None:
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    process.wait()


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


#: Turbulence models by the name that users give: OpenFOAM's name, and the field with k (none: no turbulence).
MODELS: Final[dict[str, tuple[str, str | None]]] = {
    "sst": ("kOmegaSST", "omega"),
    "paper": ("kEpsilon", "epsilon"),
    "laminar": ("laminar", None),
}

#: Relaxation factors: velocity, turbulence, pressure.
RELAXATION: Final[tuple[float, float, float]] = (0.8, 0.7, 1.0)


def control_dict(start: int, iterations: int, density: float) -> str:
    """Return ``system/controlDict`` for so many iterations from a start, with torque and wall stress logged."""
    return _file(
        "controlDict",
        f"""application simpleFoam;
startFrom startTime;
startTime {start};
stopAt endTime;
endTime {start + iterations};
deltaT 1;
writeControl runTime;
writeInterval {iterations};
purgeWrite 1;
writeFormat ascii;
writePrecision 9;
timeFormat general;
runTimeModifiable false;

functions
{{
    torque
    {{
        type forces;
        libs (forces);
        patches (rotor);
        rho rhoInf;
        rhoInf {density:.9g};
        CofR (0 0 0);
        writeControl timeStep;
        writeInterval 1;
        log false;
    }}
    wallShearStress
    {{
        type wallShearStress;
        libs (fieldFunctionObjects);
        patches (rotor case);
        writeControl writeTime;
        log false;
    }}
}}
""",
    )


def schemes() -> str:
    """Return ``system/fvSchemes``."""
    return _file(
        "fvSchemes",
        """ddtSchemes { default steadyState; }
gradSchemes { default Gauss linear; }
divSchemes
{
    default none;
    div(phi,U) bounded Gauss linearUpwind grad(U);
    div(phi,k) bounded Gauss upwind;
    div(phi,epsilon) bounded Gauss upwind;
    div(phi,omega) bounded Gauss upwind;
    div((nuEff*dev2(T(grad(U))))) Gauss linear;
}
laplacianSchemes { default Gauss linear corrected; }
interpolationSchemes { default linear; }
snGradSchemes { default corrected; }
wallDist { method meshWave; }
""",
    )


def solution() -> str:
    """Return ``system/fvSolution``: SIMPLEC."""
    velocity, turbulence, pressure = RELAXATION
    return _file(
        "fvSolution",
        f"""solvers
{{
    p
    {{
        solver GAMG;
        smoother GaussSeidel;
        tolerance 1e-10;
        relTol 0.05;
    }}
    "(U|k|epsilon|omega)"
    {{
        solver smoothSolver;
        smoother symGaussSeidel;
        tolerance 1e-12;
        relTol 0.1;
    }}
}}
SIMPLE
{{
    consistent yes;
    nNonOrthogonalCorrectors 0;
    pRefCell 0;
    pRefValue 0;
}}
relaxationFactors
{{
    fields {{ p {pressure:g}; }}
    equations {{ U {velocity:g}; "(k|epsilon|omega)" {turbulence:g}; }}
}}
""",
    )


def mesh_control_dict() -> str:
    """Return a ``system/controlDict`` that is enough to make and check a mesh."""
    return _file(
        "controlDict",
        "application blockMesh;\nstartFrom startTime;\nstartTime 0;\nstopAt endTime;\nendTime 1;\ndeltaT 1;\n"
        "writeControl timeStep;\nwriteInterval 1;\nwriteFormat ascii;\nwritePrecision 12;\n",
    )


def transport(viscosity: float) -> str:
    """Return ``constant/transportProperties`` for a kinematic viscosity [m^2/s]."""
    return _file("transportProperties", f"transportModel Newtonian;\nnu {viscosity:.9g};\n")


def turbulence(model: str) -> str:
    """Return ``constant/turbulenceProperties`` for a model of `MODELS`."""
    if MODELS[model][1] is None:
        return _file("turbulenceProperties", "simulationType laminar;\n")
    return _file(
        "turbulenceProperties",
        f"simulationType RAS;\nRAS\n{{\n    RASModel {MODELS[model][0]};\n    turbulence on;\n"
        "    printCoeffs off;\n}\n",
    )


def wall_conditions(model: str, *, wall_functions: bool) -> dict[str, str]:
    """Return the conditions of k, of the field with it, and of nut at a wall; none without turbulence."""
    second = MODELS[model][1]
    if second is None:
        return {}
    wall = {"epsilon": "epsilonWallFunction", "omega": "omegaWallFunction"}[second]
    if wall_functions or model == "paper":
        k, nut = "type kqRWallFunction; value uniform 0;", "type nutkWallFunction; value uniform 0;"
    else:
        # the cells resolve the wall layer: no turbulence at the wall; the name is that of a wall function
        # because omegaWallFunction asks the condition of nut for its constants
        k, nut = "type fixedValue; value uniform 1e-12;", "type nutLowReWallFunction; value uniform 0;"
    return {"k": k, second: f"type {wall}; value uniform 1;", "nut": nut}


def _file(name: str, body: str) -> str:
    return f"FoamFile\n{{\n    version 2.0;\n    format ascii;\n    class dictionary;\n    object {name};\n}}\n\n{body}"
