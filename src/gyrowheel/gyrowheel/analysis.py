"""Functions that compare recordings with a model."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from gyrowheel.correcting import wrong_setups
from gyrowheel.inputs import Recordings, Say, data, opened, opened_apart, require_one_machine
from gyrowheel.model import Model
from gyrowheel.results.calibration import Calibration
from gyrowheel.results.comparison import Comparison
from gyrowheel.results.diagnosis import Diagnosis
from gyrowheel.results.rates import Rates
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel_analysis.setups.cures import WrongSetup


def compare(
    recordings: Recordings, model: Model, *, mixed: bool = False, progress: Say | None = None
) -> Comparison:
    """Compare a model with recordings: how large the error is, and where it sits.

    The bench's uncertain parameters are fitted within their stated uncertainties, so that what remains is what the
    model cannot explain.

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings of one machine.
    model : Model
        The model.
    mixed : bool
        Join recordings that state different machines.
    progress : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If a recording cannot be read, is given twice, has too little steady motion, or is of another machine.
    """
    from gyrowheel_analysis.compare import compare as run

    given = opened(recordings)
    require_one_machine(data(given), mixed=mixed)
    wrong = wrong_setups(given, model.details, mixed=mixed)
    with _instead(wrong):
        return Comparison(run(data(given), model.details, progress=progress), tuple(wrong))


def diagnose(
    recordings: Recordings,
    model: Model,
    *,
    validate: Recordings = (),
    averages: bool = False,
    mixed: bool = False,
    progress: Say | None = None,
) -> Diagnosis:
    """Find out which physical effects a model lacks.

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings of one machine.
    model : Model
        The model.
    validate : Recording, path or list, optional
        Further recordings of the machine, which are only predicted: the error on them shows whether the finding holds.
    averages : bool
        Use averages over whole revolutions alone, as where filters hide what happens within one.
    mixed : bool
        Join recordings that state different machines.
    progress : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If a recording cannot be read, is given twice, or is of another machine.
    """
    from gyrowheel_analysis.diagnosis.diagnose import diagnose as run

    fitted, unused = opened_apart(recordings, validate)
    require_one_machine(data([*fitted, *unused]), mixed=mixed)
    return Diagnosis(
        run(
            data(fitted),
            model.details,
            validate=data(unused),
            averages=averages,
            mixed=mixed,
            progress=progress,
        )
    )


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
    with _instead(wrong):
        return Calibration(run(data(given), model.details, progress=progress), tuple(wrong))


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


@contextlib.contextmanager
def _instead(wrong: Sequence[WrongSetup]) -> Iterator[None]:
    """Tell of a wrong setup instead of an error that comes of it."""
    try:
        yield
    except InputError as error:
        if not wrong:
            raise
        from gyrowheel.text.sentences.setup import setup_line

        raise InputError(setup_line(wrong)) from error
