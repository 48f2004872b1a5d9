"""The public function `compare`."""

from __future__ import annotations

from gyrowheel.comparison.result import Comparison
from gyrowheel.models.api import Model
from gyrowheel.recordings.correction import explained_by, wrong_setups
from gyrowheel.recordings.inputs import Recordings, Say, data, opened, require_one_machine


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
    with explained_by(wrong):
        return Comparison(run(data(given), model.details, progress=progress), tuple(wrong))
