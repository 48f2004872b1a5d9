"""The finder's side of a case: recordings and the model of the bench go in, a diagnosis comes out.

This module must never see more; a test checks its imports.
"""

from __future__ import annotations

from pathlib import Path

from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.model import Model
from gyrowheel_recording.bags import Recording


def find(recording: Path, unused: Path, model: Model) -> Diagnosis:
    """Diagnose a recording.

    Parameters
    ----------
    recording : Path
        The recording to explain.
    unused : Path
        A recording of the same machine on which nothing is fitted: the error on it shows whether what was found
        holds.
    model : Model
        The bench as its file describes it.
    """
    return diagnose([Recording.open(recording)], model, validate=[Recording.open(unused)])
