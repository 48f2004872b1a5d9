"""The verb `calibrate`."""

from __future__ import annotations

import contextlib
import shlex
from typing import Annotated

import typer

from gyrowheel.cli.console import editing, put_json, put_text, warn_of, working
from gyrowheel.cli.options import Json, Mixed, ModelFile, Recordings, example
from gyrowheel.show.files import require_writable
from gyrowheel_core.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel calibrate runs/cone runs/coast_down --model wheel.yaml"))(calibrate)


def calibrate(
    directories: Recordings,
    model: ModelFile,
    write: Annotated[bool, typer.Option("--write", help="Write the constants into the model file.")] = False,
    mixed: Mixed = False,
    json: Json = None,
) -> None:
    """Calibrate the torque constants of coils and motor from recordings.

    The reference of the coils is the rotor's angular momentum: its precession takes
    a torque known from inertia and motion alone (plan cone). The reference of the
    motor is voltage over speed (plan coast_down). Without --write the constants
    are only shown.
    """
    import gyrowheel as gw
    from gyrowheel.recordings.inputs import opened

    recordings = opened(directories)
    if write:
        require_writable(model)
    with editing(model) if write else contextlib.nullcontext():
        loaded = gw.Model.load(model)
        with working("calibrating") as say:
            from gyrowheel.calibration.page import calibration_page

            result = gw.calibrate(recordings, loaded, mixed=mixed, progress=say)
        if write and result.setup:
            from gyrowheel.show.sentences.setup import setup_line

            raise InputError(setup_line(result.setup))
        if write:
            result.model.save(model)
    warn_of(result.setup)
    if json is not None:
        put_json(json, result.to_dict() | {"written": write})
    if json != "-":
        named = " ".join(shlex.quote(str(directory)) for directory in directories)
        following = (
            None if write else f"gyrowheel calibrate {named} --model {shlex.quote(str(model))} --write"
        )
        put_text(calibration_page(result.details, following=following))
