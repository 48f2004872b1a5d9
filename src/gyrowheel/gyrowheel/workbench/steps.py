"""A model with its results, and the report on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gyrowheel.comparison.api import Comparison
from gyrowheel.diagnosis.api import Diagnosis
from gyrowheel.diagnosis.next_command import diagnosing, following
from gyrowheel.models.api import Model
from gyrowheel.recordings.api import Recording
from gyrowheel.recordings.provenance import noted_machine
from gyrowheel.report.api import Report
from gyrowheel_analysis.drag.estimate import Estimate

#: Name of the file of a model that was not read from one.
MODEL = "wheel.yaml"


@dataclass(frozen=True)
class Step:
    """A model, and the results found with it.

    Attributes
    ----------
    model : Model
        The model.
    comparison : Comparison or None
        Comparison with the fitted recordings.
    holds : dict of str to tuple of Estimate
        Measured and predicted values of every hold of the opened recordings, by the key of the recording.
    diagnosis : Diagnosis or None
        Its diagnosis.
    """

    model: Model
    comparison: Comparison | None = None
    holds: Mapping[str, tuple[Estimate, ...]] = field(default_factory=dict)
    diagnosis: Diagnosis | None = None


def before(model: Model, kept: Model, file: Path | None) -> list[str]:
    """Return the commands that come before those of a report, so that they find its model.

    Parameters
    ----------
    model : Model
        The model that the report is about.
    kept : Model
        The model in its file.
    file : Path or None
        That file; None if the model was not read from one.
    """
    if model is not kept:
        return ["# first save the model in the workbench, under the name that follows"]
    return [] if file else [f"gyrowheel model new --model {MODEL}"]


def report_page(
    diagnosis: Diagnosis,
    comparison: Comparison | None,
    model: Model,
    recordings: tuple[Sequence[Recording], Sequence[Recording]],
    kept: Model,
    file: Path | None,
) -> str:
    """Return the report on a diagnosis as one page of HTML.

    Parameters
    ----------
    diagnosis, comparison : Diagnosis, Comparison or None
        What was found, and where the model fails.
    model : Model
        The model that was diagnosed.
    recordings : (sequence of Recording, sequence of Recording)
        Those that were fitted, and those that were not.
    kept, file : Model, Path or None
        As `before` takes them.
    """
    fitted, unused = recordings
    paths, held = ([recording.path for recording in own] for own in recordings)
    named = file or Path(MODEL)
    return Report.around(
        diagnosis,
        model,
        fitted,
        unused,
        comparison=comparison,
        commands=[*before(model, kept, file), diagnosing(paths, named, held)],
        next_command=following(
            diagnosis, paths, held, named, model.bench_source, machine=noted_machine(fitted)
        ),
    ).html()
