"""The verb `calibrate`."""

from __future__ import annotations

import contextlib
import shlex
from typing import Annotated

from gyrowheel.cli.console import editing, put, warn_of, working
from gyrowheel.cli.options import Json, Mixed, ModelFile, Recordings, option
from gyrowheel.show.files import require_writable
from gyrowheel_core.errors import InputError


def calibrate(
    directories: Recordings,
    model: ModelFile,
    write: Annotated[bool, option("--write", "Write the constants into the model file.")] = False,
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
    from gyrowheel.calibration.page import written
    from gyrowheel.recordings.inputs import opened
    from gyrowheel.show.layout import commands
    from gyrowheel.show.sentences.setup import setup_line

    recordings = opened(directories)
    if write:
        require_writable(model)
    with editing(model) if write else contextlib.nullcontext():
        loaded = gw.Model.load(model)
        with working("calibrating") as say:
            result = gw.calibrate(recordings, loaded, mixed=mixed, progress=say)
        if write and result.setup:
            raise InputError(setup_line(result.setup))
        if write:
            result.model.save(model)
    warn_of(result.setup)
    following = shlex.join(
        ["gyrowheel", "calibrate", *map(str, directories), "--model", str(model), "--write"]
    )
    after = written() if write else commands("Next: nothing has been written yet", following)
    put(result, json, after=after, more={"written": write})
