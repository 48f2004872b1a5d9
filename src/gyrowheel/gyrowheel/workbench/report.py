"""The report on a diagnosis of the workbench, with the commands that make it again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gyrowheel.comparison.api import Comparison
from gyrowheel.diagnosis.api import Diagnosis
from gyrowheel.diagnosis.page import diagnosing, following
from gyrowheel.models.api import Model
from gyrowheel.recordings.api import Recording, noted_machine
from gyrowheel.report.api import Report

#: Name of the file of a model that was not read from one.
MODEL = "wheel.yaml"


def before(model: Model, kept: Model, file: Path | None) -> list[str]:
    """Return the commands that come before those of a report, so that they find its model.

    `kept` is the model in `file`; None if the model was not read from one.
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

    `recordings` are those that were fitted, and those that were not; `kept` and `file` as in `before`.
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
