"""The scripts in examples/ run as they stand, and a notebook shows what the API returns."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
#: Files that each script writes, and what it must say.
OUTCOMES = {
    "compare": (["compare.png"], "The model fails"),
    "diagnose_and_add": (["error.png", "wheel.yaml"], "aero_cross"),
    "own_effect": (["brake.yaml"], "k = 0.00"),
    "read_and_plot": (["recording.png", "recording.parquet", "check"], "largest tilt"),
}


def test_all_examples_are_run_here() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(OUTCOMES)


@pytest.mark.parametrize("name", OUTCOMES)
def test_example_runs_and_is_short(name: str, tmp_path: Path) -> None:
    script = EXAMPLES / f"{name}.py"
    assert len(script.read_text(encoding="utf-8").splitlines()) < 30
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    files, words = OUTCOMES[name]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(files)
    assert words in done.stdout
    assert done.stderr == ""


def test_notebook_shows_verdict_and_picture_in_eight_lines(tmp_path: Path) -> None:
    verdict = """\
import gyrowheel as gw
quick = gw.Recording.open("quick")
model = gw.Model("gyrowheel")
found = gw.diagnose(quick, model)
found"""
    picture = """\
check = gw.Recording.open("check")
better = model.add(found, fit=quick, validate=check)
better.plot()"""
    recorded = """\
import gyrowheel as gw
for plan in ("quick", "check"):
    gw.simulate(plan, effects={"windage": {}}, machine=6, folder=plan)"""
    subprocess.run([sys.executable, "-c", recorded], cwd=tmp_path, check=True)
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(verdict), nbformat.v4.new_code_cell(picture)]
    )
    patient = {"timeout": 800, "startup_timeout": 800}
    NotebookClient(notebook, **patient, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown, drawn = (
        [output for output in cell.outputs if output.output_type == "execute_result"]
        for cell in notebook.cells
    )
    assert "An effect is missing" in shown[0].data["text/html"]
    assert "<table" in shown[0].data["text/html"]
    assert "An effect is missing" in shown[0].data["text/plain"]
    assert len(drawn[0].data["image/png"]) > 10_000
    # nothing is printed beside the results
    assert [len(cell.outputs) for cell in notebook.cells] == [1, 1]
