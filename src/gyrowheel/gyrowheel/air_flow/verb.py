"""The verbs of the air: `air` shows the models side by side, `cfd` computes torques with OpenFOAM."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from gyrowheel.cli.console import advancing, finding, notes, out, put_content
from gyrowheel.cli.options import Json, example
from gyrowheel.cli.outputs import TORQUE_TABLE
from gyrowheel.cli.resume import Resume, going_on, going_on_command, merged, place_of
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel.air_flow.api import Case, Result

cfd_app = typer.Typer(
    help="Compute air torques with OpenFOAM: mesh, run, sweep, table, pictures.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)

GeometryFile: TypeAlias = Annotated[
    str,
    typer.Option(
        "--geometry", metavar="G", help="Rotor and case: shipped name, or a file like geometry.yaml."
    ),
]
Tilt: TypeAlias = Annotated[
    float, typer.Option("--tilt", metavar="DEG", help="Tilt about the case's x axis, in deg.")
]
Speed: TypeAlias = Annotated[float, typer.Option("--speed", metavar="RPM", help="Spin rate, in rpm.")]
Direction: TypeAlias = Annotated[
    float, typer.Option("--direction", metavar="DEG", help="Axis of the tilt, from x towards y, in deg.")
]
MeshName: TypeAlias = Annotated[
    str,
    typer.Option(
        "--mesh", metavar="M", help="coarse, medium, fine (wall functions); low_re, low_re_fine; tiny."
    ),
]
ModelName: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="T",
        help="Turbulence: sst, paper (k-ε with wall functions), laminar.",
        show_default="sst on low_re meshes, else paper",
    ),
]
Temperature: TypeAlias = Annotated[
    float | None,
    typer.Option("--temperature", metavar="C", help="Air temperature, in °C.", show_default="the paper's 20"),
]
Pressure: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--pressure", metavar="HPA", help="Air pressure, in hPa.", show_default="the paper's 1013.25"
    ),
]
Iterations: TypeAlias = Annotated[
    int,
    typer.Option(
        "--iterations",
        metavar="N",
        help="Iterations of the solver; an existing case with fewer is continued.",
    ),
]
Window: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--window",
        metavar="N",
        help="Number of last iterations to average.",
        show_default="200, or the last half of more than 420",
    ),
]
Settle: TypeAlias = Annotated[
    int,
    typer.Option(
        "--settle",
        metavar="N",
        help="Continue until the torque has settled, at most to N iterations. 0: do not continue.",
    ),
]
Study: TypeAlias = Annotated[
    Path,
    typer.Option(
        "-o",
        "--output",
        metavar="DIR",
        help="Folder of the study; finished cases in it are kept.",
        show_default=False,
    ),
]


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    app.command(epilog=example("gyrowheel air --tilt 5 --speed 3500"))(air)
    app.add_typer(
        cfd_app,
        name="cfd",
        epilog=example("gyrowheel cfd run --tilt 5 --speed 3500 --mesh coarse -o runs/air"),
    )


def air(
    tilt: Tilt = 5.0,
    speed: Speed = 3500.0,
    temperature: Temperature = None,
    pressure: Pressure = None,
    geometry: GeometryFile = "gyrowheel",
    table: Annotated[
        str,
        typer.Option("--table", metavar="T", help="Torque table: shipped name, or a file of 'cfd table -o'."),
    ] = "gyrowheel",
    json: Json = None,
) -> None:
    """Show the air torque of all models side by side, and as coefficients of the air effects."""
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
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Folder of the study, needed unless --resume; finished cases in it are kept.",
            show_default=False,
        ),
    ] = None,
    resume: Resume = None,
    tilts: Annotated[str, typer.Option("--tilts", metavar="DEG,..", help="Tilts, in deg.")] = "0,1,2,3,4,5",
    speeds: Annotated[
        str, typer.Option("--speeds", metavar="RPM,..", help="Spin rates, in rpm.")
    ] = "1000,2000,3000,3500,4000",
    base: Annotated[
        float,
        typer.Option("--base", metavar="RPM", help="First speed of a tilt, from which the others start."),
    ] = 3500.0,
    mesh: MeshName = "low_re",
    model: ModelName = None,
    iterations: Iterations = 420,
    settle: Settle = 0,
    checks: Annotated[
        bool,
        typer.Option(
            "--checks",
            help="Also compute the cases that show the influence of mesh, model and axes, at the largest tilt.",
        ),
    ] = False,
    temperature: Temperature = None,
    pressure: Pressure = None,
    geometry: GeometryFile = "gyrowheel",
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs", metavar="N", min=1, help="Cases at a time.", show_default="cores of this machine"
        ),
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(
            "--dask",
            metavar="ADDRESS",
            help="Run on the workers of this Dask scheduler, which must see the folder of the study.",
            show_default=False,
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
        tilts=_numbers("--tilts", tilts),
        speeds=_numbers("--speeds", speeds),
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
        str,
        typer.Argument(
            metavar="DIR|FILE", help="Folder of a study, or a table; the shipped table by default."
        ),
    ] = "gyrowheel",
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Write the table (JSON, SI units).", show_default=False
        ),
        TORQUE_TABLE,
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="Check the table against what was found of the flow; exit with 1 if a line misses.",
        ),
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
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for the pictures.", show_default=False),
    ],
    study: Annotated[
        Path | None,
        typer.Argument(
            metavar="DIR", help="Folder of a study, for the pictures of mesh and flow.", show_default=False
        ),
    ] = None,
    table: Annotated[
        str,
        typer.Option("--table", metavar="T", help="Torque table: shipped name, or a file of 'cfd table -o'."),
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


def _numbers(option: str, text: str) -> list[float]:
    try:
        values = sorted({float(word) for word in text.split(",")})
    except ValueError:
        raise InputError(f"{option}: {text!r} is not a list of numbers like 0,1,2.5") from None
    return values
