"""The notebooks in examples/ run unchanged and show what the API returns; their pages are made from these scripts."""

from __future__ import annotations

import runpy
from pathlib import Path

import nbformat
import pytest

from tools import notebooks, page_outputs

#: Files that each script writes, and what it must say.
OUTCOMES: dict[str, tuple[list[str], str]] = {
    "loop": ([], "aero_cross"),
    "fit_parameters": ([], "bearing_viscous"),
    "own_effect": ([], "k = 0.00"),
    "own_data": (["bench3.csv"], "windage"),
    "raw_columns": (["check", "check.parquet"], "largest tilt"),
    "paper_figures": (["paper_tilt"], ""),
    "cluster": ([], "cases"),
}
LONG = ("loop", "fit_parameters", "own_effect", "own_data", "paper_figures", "cluster")


def test_all_notebooks_are_in_the_gallery_and_run_here() -> None:
    scripts = {path.stem for path in notebooks.SCRIPTS.glob("*.py")}
    assert scripts == set(notebooks.GALLERY) == set(OUTCOMES)
    assert (notebooks.PAGES / "README.md").read_text(encoding="utf-8") == notebooks.index()


@pytest.mark.parametrize("name", OUTCOMES)
def test_page_has_the_cells_of_its_script(name: str) -> None:
    page = (notebooks.PAGES / f"{name}.md").read_text(encoding="utf-8")
    cells = [cell.source for cell in notebooks.read(name).cells if cell.cell_type == "code"]
    assert notebooks.code(page) == [f"{source}\n" for source in cells], "`make notebooks` writes it anew"
    assert len(cells) >= 1
    assert "Traceback" not in page
    for picture in notebooks.PAGES.glob(f"{name}-*.png"):
        assert f"({picture.name})" in page


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        # what `test_front_door`, `test_lab_tables`, `test_paper` and `test_campaign` show, too
        pytest.param(name, marks=[pytest.mark.study] if name in LONG else [])
        for name in OUTCOMES
    ],
)
def test_script_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(notebooks.SCRIPTS / f"{name}.py"), run_name="__main__")
    files, words = OUTCOMES[name]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(files)
    said = capsys.readouterr()
    assert words in said.out
    assert said.err == ""
    page = (notebooks.PAGES / f"{name}.md").read_text(encoding="utf-8")
    shown = "".join(step.shown for step in page_outputs.steps(page))
    assert page_outputs.differences(shown, said.out) == [], "`python -m tools.page_outputs` renews it"


@pytest.mark.study
def test_notebook_shows_verdict_and_picture(tmp_path: Path) -> None:
    """As a notebook, in a kernel of its own: text, tables and pictures arrive, and nothing beside them."""
    notebook = notebooks.read("loop")
    notebook.cells += [nbformat.v4.new_code_cell(source) for source in ("print(quick)", "found")]
    text, pictures = notebooks.page("loop", notebooks.run(notebook, tmp_path))
    assert "An effect is missing" in text
    assert [len(content) > 10_000 for content in pictures.values()] == [True]
    (printed,), (shown,) = (cell.outputs for cell in notebook.cells[-2:])
    assert "machine" in printed.text
    assert "\x1b" not in printed.text  # no colours of a terminal
    assert "An effect is missing" in shown.data["text/html"]
    assert "<table" in shown.data["text/html"]
    assert "An effect is missing" in shown.data["text/plain"]
    assert all(len(cell.outputs) <= 1 for cell in notebook.cells if cell.cell_type == "code")
    assert list(tmp_path.iterdir()) == []
