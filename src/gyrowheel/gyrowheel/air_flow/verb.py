"""The verbs of the air: `air` compares the models, `cfd` computes torques with OpenFOAM."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from gyrowheel.cli.console import advancing, finding, notes, out, put_content
from gyrowheel.cli.options import (
    Json,
    Resume,
    argument,
    example,
    going_on,
    going_on_command,
    merged,
    numbers,
    option,
    place_of,
)
from gyrowheel.cli.outputs import TORQUE_TABLE
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel.air_flow.api import Case, Result

cfd_app = typer.Typer(
    help="Compute air torques with OpenFOAM: mesh, run, sweep, table, pictures.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

GeometryFile: TypeAlias = Annotated[
    str, option("--geometry G", "Rotor and case: shipped name, or a file like geometry.yaml.")
]
Tilt: TypeAlias = Annotated[float, option("--tilt DEG", "Tilt about the case's x axis, in deg.")]
Speed: TypeAlias = Annotated[float, option("--speed RPM", "Spin rate, in rpm.")]
Direction: TypeAlias = Annotated[
    float, option("--direction DEG", "Axis of the tilt, from x towards y, in deg.")
]
MeshName: TypeAlias = Annotated[
    str, option("--mesh M", "coarse, medium, fine (wall functions); low_re, low_re_fine; tiny.")
]
ModelName: TypeAlias = Annotated[
    str | None,
    option(
        "--model T",
        "Turbulence: sst, paper (k-ε with wall functions), laminar.",
        "sst on low_re meshes, else paper",
    ),
]
Temperature: TypeAlias = Annotated[
    float | None, option("--temperature C", "Air temperature, in °C.", "the paper's 20")
]
Pressure: TypeAlias = Annotated[
    float | None, option("--pressure HPA", "Air pressure, in hPa.", "the paper's 1013.25")
]
Iterations: TypeAlias = Annotated[
    int, option("--iterations N", "Iterations of the solver; an existing case with fewer is continued.")
]
Window: TypeAlias = Annotated[
    int | None,
    option("--window N", "Number of last iterations to average.", "200, or the last half of more than 420"),
]
Settle: TypeAlias = Annotated[
    int,
    option(
        "--settle N", "Continue until the torque has settled, at most to N iterations. 0: do not continue."
    ),
]
Study: TypeAlias = Annotated[
    Path, option("-o --output DIR", "Folder of the study; finished cases in it are kept.")
]


def air(
    tilt: Tilt = 5.0,
    speed: Speed = 3500.0,
    temperature: Temperature = None,
    pressure: Pressure = None,
    geometry: GeometryFile = "gyrowheel",
    table: Annotated[
        str, option("--table T", "Torque table: shipped name, or a file of 'cfd table -o'.")
    ] = "gyrowheel",
    json: Json = None,
) -> None:
    """Compare the air torque of all models, and show it as coefficients of the air effects."""
    from gyrowheel.air_flow import page as render
    from gyrowheel.air_flow.api import Geometry, TorqueTable, air_state, compare
    from gyrowheel_core.units import DEG, RPM

    state = air_state(temperature, pressure)
    found = compare(Geometry.load(geometry), state, (tilt * DEG, 0.0), speed * RPM, TorqueTable.load(table))
    put_content(json, found.to_json(), render.comparison_page(found))


@cfd_app.command(epilog=example("gyrowheel cfd mesh --tilt 5 --mesh low_re -o runs/mesh"))
def mesh(
    output: Study,
    tilt: Tilt = 0.0,
    direction: Direction = 0.0,
    mesh: MeshName = "low_re",
    geometry: GeometryFile = "gyrowheel",
    json: Json = None,
) -> None:
    """Make the mesh of one tilt, and check it."""
    from gyrowheel.air_flow import page as render
    from gyrowheel.air_flow.api import case_of, shared_mesh
    from gyrowheel.show.files import disk_errors

    case = case_of(geometry, tilt, 3500.0, mesh, None, direction=direction)
    with disk_errors(output):
        quality = shared_mesh(case, output)
    content = {"schema": 1, "mesh": mesh, "tilt": case.tilt, "folder": str(output / "meshes" / case.mesh_key)}
    put_content(json, content | quality, render.mesh_page(case, quality, str(content["folder"])))


@cfd_app.command(epilog=example("gyrowheel cfd run --tilt 5 --speed 3500 --mesh coarse -o runs/air"))
def run(
    output: Study,
    tilt: Tilt = 5.0,
    speed: Speed = 3500.0,
    direction: Direction = 0.0,
    mesh: MeshName = "low_re",
    model: ModelName = None,
    iterations: Iterations = 420,
    window: Window = None,
    settle: Settle = 0,
    temperature: Temperature = None,
    pressure: Pressure = None,
    geometry: GeometryFile = "gyrowheel",
    json: Json = None,
) -> None:
    """Compute the torque of one tilt and speed, on one core."""
    from gyrowheel.air_flow import page as render
    from gyrowheel.air_flow.api import case_of, run_case
    from gyrowheel.show.files import disk_errors

    case = case_of(
        geometry,
        tilt,
        speed,
        mesh,
        model,
        direction=direction,
        temperature=temperature,
        pressure=pressure,
        iterations=iterations,
        window=window,
        settle=settle,
    )
    with disk_errors(output), advancing(f"{case.mesh} {case.model}, {tilt:g} deg, {speed:g} rpm") as advance:
        result = run_case(case, output, advance=advance)
    put_content(json, result.to_json(), render.result_page(result, str(output / case.name)))


@cfd_app.command(epilog=example("gyrowheel cfd sweep -o runs/air --jobs 4"))
def sweep(
    context: typer.Context,
    output: Annotated[
        Path | None,
        option(
            "-o --output DIR", "Folder of the study, needed unless --resume; finished cases in it are kept."
        ),
    ] = None,
    resume: Resume = None,
    tilts: Annotated[str, option("--tilts DEG,..", "Tilts, in deg.")] = "0,1,2,3,4,5",
    speeds: Annotated[str, option("--speeds RPM,..", "Spin rates, in rpm.")] = "1000,2000,3000,3500,4000",
    base: Annotated[
        float, option("--base RPM", "First speed of a tilt, from which the others start.")
    ] = 3500.0,
    mesh: MeshName = "low_re",
    model: ModelName = None,
    iterations: Iterations = 420,
    settle: Settle = 0,
    checks: Annotated[
        bool,
        option(
            "--checks",
            "Also compute the cases that show the influence of mesh, model and axes, at the largest tilt.",
        ),
    ] = False,
    temperature: Temperature = None,
    pressure: Pressure = None,
    geometry: GeometryFile = "gyrowheel",
    jobs: Annotated[
        int | None, option("--jobs N", "Cases at a time.", "cores of this machine", min=1)
    ] = None,
    dask: Annotated[
        str | None,
        option(
            "--dask ADDRESS",
            "Run on the workers of this Dask scheduler, which must see the folder of the study.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Compute all tilts and speeds; finished cases in the folder are kept."""
    from gyrowheel.air_flow import api as sweeps
    from gyrowheel.air_flow import page as render
    from gyrowheel.show.files import disk_errors

    if output is None and resume is None:
        raise InputError("-o: missing; name the folder of the study")
    folder = place_of(output, resume, "sweep")
    settings = sweeps.SweepSettings(
        tilts=sorted({*numbers(tilts, "--tilts")}),
        speeds=sorted({*numbers(speeds, "--speeds")}),
        base=base,
        geometry=geometry,
        mesh=mesh,
        model=model,
        iterations=iterations,
        settle=settle,
        checks=checks,
        temperature=temperature,
        pressure=pressure,
    )
    if resume is not None:
        settings = replace(settings, **merged(context, asdict(settings), sweeps.sweep_settings(resume)))
    again = going_on_command("cfd sweep", folder, {"jobs": jobs, "dask": dask, "json": json})

    def tell(case: Case, result: Result | str, done: int, total: int) -> None:
        notes().print(render.sweep_line(case, result, done, total), soft_wrap=True)

    with going_on(again) as begun, disk_errors(folder):
        outcome = sweeps.sweep(
            folder, settings, jobs=jobs, dask=dask, resume=resume is not None, begun=begun, tell=tell
        )
    put_content(
        json,
        {
            "schema": 1,
            "results": [result.to_json() for result in outcome.results],
            "failed": outcome.failed,
            "reused": outcome.reused,
        },
        render.sweep_page(outcome, str(folder)),
    )
    finding(bool(outcome.failed))


@cfd_app.command(epilog=example("gyrowheel cfd table runs/air --check -o table.json"))
def table(
    study: Annotated[
        str, argument("DIR|FILE", "Folder of a study, or a table; the shipped table by default.")
    ] = "gyrowheel",
    output: Annotated[
        Path | None, option("-o --output FILE", "Write the table (JSON, SI units)."), TORQUE_TABLE
    ] = None,
    check: Annotated[
        bool, option("--check", "Check the table against known results; exit with 1 if a line misses.")
    ] = False,
    json: Json = None,
) -> None:
    """Show a torque table, make one from a study, or check it."""
    from gyrowheel.air_flow import page as render
    from gyrowheel.air_flow.api import check_table, table_of
    from gyrowheel.show.files import disk_errors

    loaded = table_of(study)
    if output is not None:
        with disk_errors(output):
            output.parent.mkdir(parents=True, exist_ok=True)
            loaded.write(output)
        notes().print(f"table: {output}", soft_wrap=True)
    checks = check_table(loaded) if check else []
    put_content(
        json,
        render.table_json(loaded, checks),
        render.check_page(loaded, checks) if checks else render.table_page(loaded),
    )
    finding(any(item.holds is False for item in checks))


@cfd_app.command(epilog=example("gyrowheel cfd pictures runs/air -o pictures"))
def pictures(
    output: Annotated[Path, option("-o --output DIR", "Folder for the pictures.")],
    study: Annotated[
        Path | None, argument("DIR", "Folder of a study, for the pictures of mesh and flow.")
    ] = None,
    table: Annotated[
        str, option("--table T", "Torque table: shipped name, or a file of 'cfd table -o'.")
    ] = "gyrowheel",
) -> None:
    """Draw torques, mesh and flow as in Figs 5 to 12 of the paper."""
    from gyrowheel.air_flow.api import TorqueTable
    from gyrowheel.air_flow.picture import air_figures
    from gyrowheel.show.figure import write_figure
    from gyrowheel.show.files import disk_errors

    with disk_errors(output):
        output.mkdir(parents=True, exist_ok=True)
    for name, figure, sentence in air_figures(TorqueTable.load(table), study):
        path = output / f"{name}.png"
        write_figure(figure, path)
        out().print(f"{path}: {sentence}", soft_wrap=True)
