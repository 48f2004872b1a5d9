"""The diagnosis of a case, from recordings and the model of the bench alone; a test checks the imports."""

from __future__ import annotations

from pathlib import Path

from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.model import Model
from gyrowheel_recording.bags import Recording


def find(recording: Path, unused: Path, model: Model) -> Diagnosis:
    """Diagnose a recording with the model of the bench; on the second recording nothing is fitted."""
    return diagnose([Recording.open(recording)], model, validate=[Recording.open(unused)])
