"""The public function `calibrate`."""

from __future__ import annotations

from gyrowheel.calibration.result import Calibration
from gyrowheel.models.api import Model
from gyrowheel.recordings.correction import explained_by, wrong_setups
from gyrowheel.recordings.inputs import Recordings, Say, data, opened, require_one_machine


def calibrate(
    recordings: Recordings, model: Model, *, mixed: bool = False, progress: Say | None = None
) -> Calibration:
    """Calibrate the torque constants of coils and motor.

    The reference of the coils is the angular momentum of the rotor: its precession takes a torque that follows from
    inertia and motion alone (plan ``cone``). The reference of the motor is voltage over speed (plan ``coast_down``).

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings of one machine.
    model : Model
        The model; its effects are taken into account, its constants of coils and motor are not.
    mixed : bool
        Join recordings that state different machines.
    progress : callable, optional
        Called with a line of text now and then.

    Returns
    -------
    Calibration
        The constants; ``.model`` is a new model that has them.

    Raises
    ------
    InputError
        If there is too little steady motion, or nothing could be determined.
    """
    from gyrowheel_analysis.calibrate import calibrate as run

    given = opened(recordings)
    require_one_machine(data(given), mixed=mixed)
    wrong = wrong_setups(given, model.details, mixed=mixed)
    with explained_by(wrong):
        return Calibration(run(data(given), model.details, progress=progress), tuple(wrong))
