"""One case from beginning to end: simulated, diagnosed, judged, kept."""

from __future__ import annotations

import os
import shutil
import tempfile
import traceback
from pathlib import Path

from threadpoolctl import threadpool_limits

from gyrowheel.campaigns.cases import Case
from gyrowheel.campaigns.finder import find
from gyrowheel.campaigns.hidden import Secret, hide, record, yardstick
from gyrowheel.campaigns.judge import Judged, failed, judge
from gyrowheel.show.contract import diagnosis_json
from gyrowheel_analysis.model import Model
from gyrowheel_core.errors import one_line
from gyrowheel_core.files import disk_errors, json_text, temporary_path, write_text


def run_case(keep: str | None, case: Case, scratch: str | None = None) -> Judged:
    """Simulate a case, diagnose it, and judge the answer; the case determines the result completely.

    `keep` is a folder that keeps recordings, key and diagnosis, `scratch` one for temporary files; both must exist.
    InputError if recordings cannot be written; MemoryError and OSError if the machine lacks something.
    """
    # not undone: several threads of one worker may run cases, and all need this limit
    threadpool_limits(limits=1, user_api="blas")
    campaign = case.campaign
    secret = hide(case, yardstick(campaign.bench, campaign.plan))
    folder = Path(tempfile.mkdtemp(prefix=f"case-{case.index}-", dir=scratch))
    try:
        recording, unused = folder / "recording", folder / "unused"
        record(case, secret, campaign.plan, 0, recording)
        record(case, secret, campaign.validation_plan, 1, unused)
        judged = _answered(case, secret, recording, unused, folder)
        if keep is not None:
            write_text(folder / "key.json", json_text(secret.to_json()), private=True)
            _move(folder, kept_case(keep, case.index))
        return judged
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def kept_case(keep: str | Path, index: int) -> Path:
    """Return the folder in which a case is kept."""
    return Path(keep) / f"case-{index:04d}"


def _answered(case: Case, secret: Secret, recording: Path, unused: Path, folder: Path) -> Judged:
    try:
        answer = find(recording, unused, Model(case.campaign.bench))
    except (MemoryError, OSError):  # of the computer, and no wrong answer: the campaign can be resumed
        raise
    except Exception as error:  # one failed case must not end the others
        write_text(folder / "error.txt", traceback.format_exc())
        return failed(case, secret, f"{type(error).__name__}: {one_line(error)}")
    write_text(folder / "diagnosis.json", json_text(diagnosis_json(answer)))
    return judge(case, secret, answer)


def _move(folder: Path, target: Path) -> None:
    """Copy a folder to a place where it appears as a whole."""
    with disk_errors(target), temporary_path(target, folder=True, mode=0o700) as (place, _):
        shutil.copytree(folder, place / target.name)
        shutil.rmtree(target, ignore_errors=True)  # of this case, before the campaign was interrupted
        os.replace(place / target.name, target)
