"""The verb `torques`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import advancing, put
from gyrowheel.cli.options import Json, Mixed, TorquePicture, argument, numbers, option


def torques(
    directories: Annotated[list[Path] | None, argument("DIR", "Recordings with the holds to show.")] = None,
    model: Annotated[
        Path | None, option("--model M.yaml", "Model file.", "bench gyrowheel without effects")
    ] = None,
    tilt: Annotated[str, option("--tilt DEG", "Tilts: 3, or 1,2,3, or 0..5, or 0..5:0.5, in deg.")] = "3",
    azimuth: Annotated[
        float, option("--azimuth DEG", "Direction of the tilt from the x axis, in deg.")
    ] = 0.0,
    speed: Annotated[
        str | None,
        option("--speed RPM", "Spin rates, written like tilts, in rpm.", "the reference of the bench"),
    ] = None,
    density: Annotated[
        float,
        option(
            "--density RATIO", "Air density, as a multiple of the usual one; 0: vacuum.", min=0.0, max=2.0
        ),
    ] = 1.0,
    inverted: Annotated[bool, option("--inverted", "Turn the rig upside down.")] = False,
    orbit: Annotated[
        bool, option("--orbit", "Holds in orbit: without air, weight and the Earth's rate.")
    ] = False,
    mixed: Mixed = False,
    picture: TorquePicture = None,
    json: Json = None,
) -> None:
    """Show the torque that coils and motor supply in holds, part by part.

    Springs, gimbal, ripple of the shaft, losses, air, bearing, Earth and gravity:
    in the holds of a recording, with the part that the model does not explain, or
    in simulated holds, on the ground or in orbit. The parts add up to the whole.
    Below them: voltages, and margins to the limits of coils, motor and tilt.
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
