"""The public function `rate`."""

from __future__ import annotations

from gyrowheel.models.api import Model
from gyrowheel.rate_sensing.result import Rates
from gyrowheel.recordings.inputs import Recordings, Say, data, opened, require_one_machine


def rate(recordings: Recordings, model: Model, *, mixed: bool = False, progress: Say | None = None) -> Rates:
    """Use the wheel as a two-axis rate sensor: estimate the angular rate of the case.

    Where a rate table turned the rig (plan ``rate_table``), scale and bias of both axes are calibrated against it.

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings of one machine.
    model : Model
        The model whose torques are subtracted.
    mixed : bool
        Join recordings that state different machines.
    progress : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If a recording cannot be read, or there is no steady motion in any.
    """
    from gyrowheel_analysis.rate_sensor import rates

    given = opened(recordings)
    require_one_machine(data(given), mixed=mixed)
    return Rates(rates(data(given), model.details, progress=progress))
