"""The report on what is on the desk: a page to keep, with the commands that find the same again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gyrowheel.diagnosis.next_command import diagnosing, following
from gyrowheel.recordings.provenance import noted_machine
from gyrowheel.report.api import Report

if TYPE_CHECKING:
    from gyrowheel.comparison.api import Comparison
    from gyrowheel.diagnosis.api import Diagnosis
    from gyrowheel.models.api import Model
    from gyrowheel.recordings.api import Recording

#: Name of the file of a model that was not read from one.
MODEL = "wheel.yaml"


def before(model: Model, kept: Model, file: Path | None) -> list[str]:
    """Return what must be done before the commands of a report find the model that it is about.

    Parameters
    ----------
    model : Model
        The model that the report is about.
    kept : Model
        The model as it stands in its file.
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
