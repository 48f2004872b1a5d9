"""The verb `torques`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from gyrowheel.cli.console import advancing, put
from gyrowheel.cli.options import Json, Mixed, TorquePicture, example, numbers


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel torques --tilt 3 --speed 1000..4000"))(torques)


def torques(
    directories: Annotated[
        list[Path] | None,
        typer.Argument(metavar="DIR", help="Recordings with the holds to show.", show_default=False),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model", metavar="M.yaml", help="Model file.", show_default="bench gyrowheel without effects"
        ),
    ] = None,
    tilt: Annotated[
        str, typer.Option("--tilt", metavar="DEG", help="Tilts: 3, or 1,2,3, or 0..5, or 0..5:0.5, in deg.")
    ] = "3",
    azimuth: Annotated[
        float, typer.Option("--azimuth", metavar="DEG", help="Direction of the tilt from the x axis, in deg.")
    ] = 0.0,
    speed: Annotated[
        str | None,
        typer.Option(
            "--speed",
            metavar="RPM",
            help="Spin rates, written like tilts, in rpm.",
            show_default="the reference of the bench",
        ),
    ] = None,
    density: Annotated[
        float,
        typer.Option(
            "--density",
            metavar="RATIO",
            min=0.0,
            max=2.0,
            help="Air density, as a multiple of the usual one; 0: vacuum.",
        ),
    ] = 1.0,
    inverted: Annotated[bool, typer.Option("--inverted", help="Turn the rig upside down.")] = False,
    orbit: Annotated[
        bool, typer.Option("--orbit", help="Holds in orbit: without air, weight and the Earth's rate.")
    ] = False,
    mixed: Mixed = False,
    picture: TorquePicture = None,
    json: Json = None,
) -> None:
    """Show the torque that coils and motor supply in holds, part by part.

    Springs, gimbal, ripple of the shaft, losses, air, bearing, Earth and gravity:
    in the holds of a recording, with the part that the model does not explain, or
    in simulated holds, on the ground or in orbit. The parts sum to the whole. Below
    them: the voltages, and what is left to the limits of coils, motor and tilt.
    """
    import gyrowheel as gw

    loaded = gw.Model() if model is None else gw.Model.load(model)
    if directories:
        result = gw.torques(directories, loaded, orbit=orbit, mixed=mixed)
    else:
        tilts = [math.radians(value) for value in numbers(tilt, "--tilt")]
        rates = None if speed is None else [value * math.pi / 30.0 for value in numbers(speed, "--speed")]
        with advancing("simulating holds") as advance:
            result = gw.torques(
                model=loaded,
                tilt=tilts,
                azimuth=math.radians(azimuth),
                spin_rate=rates,
                air_density_ratio=density,
                rig="inverted" if inverted else "upright",
                orbit=orbit,
                progress=advance,
            )
    put(result, json, picture)
