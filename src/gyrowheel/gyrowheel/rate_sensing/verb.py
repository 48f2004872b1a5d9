"""The verb `rate`."""

from __future__ import annotations

from gyrowheel.cli.console import put, working
from gyrowheel.cli.options import Json, Mixed, ModelFile, Recordings


def rate(directories: Recordings, model: ModelFile, mixed: Mixed = False, json: Json = None) -> None:
    """Use the wheel as a two-axis rate sensor: estimate the angular rate of the case.

    Where a rate table turned the rig (plan rate_table), scale and bias of both axes are calibrated against it.
    """
    import gyrowheel as gw
    from gyrowheel.recordings.inputs import opened

    loaded = gw.Model.load(model)
    recordings = opened(directories)
    with working("estimating rates") as say:
        result = gw.rate(recordings, loaded, mixed=mixed, progress=say)
    put(result, json)
