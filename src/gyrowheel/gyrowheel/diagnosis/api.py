"""The public function `diagnose`."""

from __future__ import annotations

from gyrowheel.diagnosis.result import Diagnosis
from gyrowheel.models.api import Model
from gyrowheel.recordings.inputs import Recordings, Say, data, opened_apart, require_one_machine


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
