"""The paper's analysis of a recording: measured DC voltages beside simulated torques."""

from __future__ import annotations

from typing import Any

from gyrowheel.drag_comparison.result import Drag
from gyrowheel.models.api import Model
from gyrowheel.recordings.api import Recording
from gyrowheel.recordings.inputs import Recordings, data, opened, require_one_machine
from gyrowheel_analysis.drag.notch import notched
from gyrowheel_analysis.drag.stream import recorded_holds
from gyrowheel_analysis.fitting.preparation import one_thread, samples_of
from gyrowheel_analysis.reduction import NEEDED
from gyrowheel_core.errors import InputError


@one_thread()
def drag(
    recordings: Recordings, model: Model | None = None, *, mixed: bool = False, signals: bool = True
) -> Drag:
    """Compare measured DC voltages with simulated torques, hold by hold, as the drag estimator of the graph does.

    The estimates are computed anew from the measurements; recorded ones are not used.

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings. Holds are those of the setpoints; without setpoints they are found in the motion.
    model : Model, optional
        The believed model; one of the bench ``gyrowheel`` without effects if not given.
    mixed : bool
        Join recordings that state different machines.
    signals : bool
        Whether to keep the notch-filtered readings of every sample, which a picture and a table of them need.

    Raises
    ------
    InputError
        If a recording cannot be read or has no steady hold, or several state different machines.
    """
    known = Model() if model is None else model
    given = opened(recordings)
    require_one_machine(data(given), mixed=mixed)
    found, filtered = [], []
    for own in given:
        holds = recorded_holds(own.data, known.details)
        if not holds:
            raise InputError(f"{own.path}: no steady hold")
        found.append(tuple(holds))
        if signals:
            filtered.append(_filtered(own, known))
    return Drag(tuple(found), known, tuple(str(own.path) for own in given), tuple(filtered))


def _filtered(own: Recording, model: Model) -> dict[str, Any]:
    samples = samples_of(own.data)
    found = notched(samples.readings, NEEDED, samples.period(model.bench.sample_period))
    stamps = own.data.measurement["stamp_ns"] * 1e-9
    return {"stamp": stamps, **{f"notched_{name}": v for name, v in found.items()}}
