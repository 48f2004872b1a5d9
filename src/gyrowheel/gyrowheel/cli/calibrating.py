"""The verb `calibrate`."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from gyrowheel.cli.finding import open_all
from gyrowheel.cli.options import Json, ModelFile, Recordings, example
from gyrowheel.cli.shell import put_json, put_text, working
from gyrowheel_core.files import require_writable


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel calibrate runs/cone runs/coast_down --model wheel.yaml"))(calibrate)


def calibrate(
    directories: Recordings,
    model: ModelFile,
    write: Annotated[bool, typer.Option("--write", help="Write the constants into the model file.")] = False,
    json: Json = None,
) -> None:
    """Calibrate coils and motor in place: what a volt and an ampere mean.

    The ruler of the coils is the rotor's momentum: turning its tilt takes a
    torque known from its inertia and the motion alone (plan cone). That of the
    motor is volts over speed (plan coast_down). Without --write the constants
    are only shown.
    """
    from gyrowheel_analysis.model import Model

    loaded = Model.load(model)
    recordings = open_all(directories)
    if write:
        require_writable(model)
    with working("calibrating") as say:
        from gyrowheel.text.calibration import calibration_page
        from gyrowheel_analysis.calibrate import calibrate as run

        result = run(recordings, loaded, progress=say)
    if write:
        result.model.save(model)
    if json is not None:
        from gyrowheel.results.contract import calibration_json

        put_json(json, calibration_json(result) | {"model": str(model), "written": write})
    if json != "-":
        named = " ".join(shlex.quote(str(directory)) for directory in directories)
        following = (
            None if write else f"gyrowheel calibrate {named} --model {shlex.quote(str(model))} --write"
        )
        put_text(calibration_page(result, following=following))
