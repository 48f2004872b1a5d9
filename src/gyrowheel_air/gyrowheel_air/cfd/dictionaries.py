"""OpenFOAM dictionaries of a case: texts of the files in ``system`` and ``constant``."""

from __future__ import annotations

from typing import Final

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
