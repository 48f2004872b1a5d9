"""The gallery of notebooks: runs the scripts of examples/ cell by cell and writes a page of each with its output.

``make notebooks`` calls this. The scripts are notebooks in the percent format of jupytext: Jupyter and editors open
them directly. Pages and pictures are in docs/notebooks.
"""

from __future__ import annotations

import argparse
import base64
import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import jupytext
from nbclient import NotebookClient

ROOT: Final = Path(__file__).resolve().parent.parent
SCRIPTS: Final = ROOT / "examples"
PAGES: Final = ROOT / "docs" / "notebooks"
#: The notebooks, in the order of the gallery.
GALLERY: Final = (
    "loop",
    "fit_parameters",
    "own_effect",
    "own_data",
    "raw_columns",
    "paper_figures",
    "cluster",
)
_MADE: Final = "<!-- Made by `make notebooks` from examples/{name}.py; edit that. -->"
_INDEX: Final = """\
# Notebooks

<!-- Made by `make notebooks`; edit the scripts in examples. -->

Each is a script in [examples](../../examples/loop.py) and a notebook: Jupyter with jupytext, and editors that support
cells (`# %%`), open it as one. The tests run them; a page shows the output of its script at the time when the page was
made.

"""
_WAIT: Final = 1800  # s: limit for a cell that never ends


def read(name: str) -> Any:
    """Return a script as a notebook."""
    return jupytext.read(SCRIPTS / f"{name}.py", fmt="py:percent")


def run(notebook: Any, folder: Path) -> Any:
    """Run a notebook in a folder; return it with its outputs."""
    NotebookClient(
        notebook,
        timeout=_WAIT,
        startup_timeout=_WAIT,
        kernel_name="python3",
        coalesce_streams=True,  # printed text arrives in pieces
        resources={"metadata": {"path": str(folder)}},
    ).execute()
    return notebook


def title(notebook: Any) -> str:
    """Return the heading with which a notebook begins."""
    return str(notebook.cells[0].source.partition("\n")[0].removeprefix("# "))


def code(page: str) -> list[str]:
    """Return the code of a page, cell by cell."""
    return re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


def page(name: str, notebook: Any) -> tuple[str, dict[str, bytes]]:
    """Return the page of a notebook that was run, and its pictures by name."""
    pictures: dict[str, bytes] = {}
    first, *rest = notebook.cells
    head, _, text = first.source.partition("\n")
    lines = [head, "", _MADE.format(name=name), text]
    for cell in rest:
        if cell.cell_type == "markdown":
            lines += ["", cell.source]
        elif cell.source.strip():
            lines += ["", "```python", cell.source, "```"]
            lines += _shown(name, cell.outputs, pictures)
    lines += ["", "[All notebooks](README.md)"]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)) + "\n", pictures


def _shown(name: str, outputs: Sequence[Any], pictures: dict[str, bytes]) -> Iterator[str]:
    printed = "".join(output.text for output in outputs if output.output_type == "stream")
    if printed:
        yield from ("", "```", printed.rstrip(), "```")
    for output in outputs:
        data = output.get("data", {})
        if "image/png" in data:
            file = f"{name}-{len(pictures) + 1}.png"
            pictures[file] = base64.b64decode(data["image/png"])
            yield from ("", f"![What the cell above draws]({file})")
        elif "text/plain" in data:
            yield from ("", "```", data["text/plain"].rstrip(), "```")


def index() -> str:
    """Return the page that lists the notebooks."""
    rows = []
    for name in GALLERY:
        notebook = read(name)
        words = " ".join(notebook.cells[0].source.partition("\n")[2].split())
        about = re.split(r"[.?:] (?=[A-Z])", words)[0].rstrip(".")
        rows.append(f"- [{title(notebook)}]({name}.md): {about}")
    return _INDEX + "\n".join(rows) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the named notebooks, or all, and write their pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[[], *GALLERY], help="notebooks; all if none is named")
    chosen = parser.parse_args(arguments).names or GALLERY
    PAGES.mkdir(exist_ok=True)
    for name in chosen:
        with tempfile.TemporaryDirectory() as folder:
            text, pictures = page(name, run(read(name), Path(folder)))
        for old in PAGES.glob(f"{name}-*.png"):
            old.unlink()
        (PAGES / f"{name}.md").write_text(text, encoding="utf-8")
        for file, content in pictures.items():
            (PAGES / file).write_bytes(content)
        print(f"written: docs/notebooks/{name}.md")
    (PAGES / "README.md").write_text(index(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
