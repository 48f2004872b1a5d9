"""Several processes, or several models in one, that change the same file: no change is lost, or it is said."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import gyrowheel as gw

from .conftest import Wheel
from .helpers import Shell

_COMMAND = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()"]


@pytest.mark.slow
@pytest.mark.study  # five writers of one model, in `test_killed.py`, are part of every run
def test_every_addition_is_in_the_model(wheel: Wheel, tmp_path: Path) -> None:
    """Three `model add` at once: each effect is in the file, and nothing else is left beside it."""
    model = tmp_path / "model.yaml"
    gw.Model("gyrowheel").save(model)
    names = ["windage", "tilt_bias", "fixed_torque"]
    running = [
        subprocess.Popen(
            [*_COMMAND, "model", "add", name, "--model", str(model), "--fit", str(wheel.recording)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for name in names
    ]
    said = [process.communicate(timeout=600)[1] for process in running]
    assert [process.returncode for process in running] == [0, 0, 0], said
    assert set(gw.Model.load(model).effects) == set(names)
    assert len(gw.Model.load(model).history) == 3
    assert [place.name for place in tmp_path.iterdir()] == ["model.yaml"]


def test_concurrent_changes_are_not_overwritten(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model that was read before somebody else changed its file is not saved over it; its own changes are."""
    model = tmp_path / "model.yaml"
    first = gw.Model("gyrowheel")
    first.save(model)
    mine, theirs = gw.Model.load(model), gw.Model.load(model)
    mine.save(model)
    mine.save(model)  # what this process wrote itself is no change of somebody else
    theirs.save(model)
    model.write_text(model.read_text() + "# a remark\n")
    with pytest.raises(gw.InputError, match="somebody else has changed it"):
        mine.save(model)
    assert model.read_text().endswith("# a remark\n")
    mine.save(tmp_path / "other.yaml")
    gw.Model.load(model).save(model)


@pytest.mark.slow
def test_a_recording_that_changes_during_a_comparison_is_named(
    gyrowheel: Shell, wheel: Wheel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = tmp_path / "drag"
    shutil.copytree(wheel.recording, recording)
    gyrowheel.good("info", recording)
    compare = gw.compare

    def meanwhile(*arguments: Any, **named: Any) -> Any:
        found = compare(*arguments, **named)
        os.utime(recording / "drag_0.mcap")
        return found

    monkeypatch.setattr(gw, "compare", meanwhile)
    said = gyrowheel.good("compare", recording, "--model", wheel.model).err
    assert f"warning: {recording} was changed after it was read; the result is of what was read" in said
    monkeypatch.undo()
    assert "was changed" not in gyrowheel.good("compare", recording, "--model", wheel.model).err
