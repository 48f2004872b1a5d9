"""How pictures are written: a file is whole, or as it was before."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gyrowheel_core.files import new_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, folders and all.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with new_file(path) as place:
        figure.savefig(place, format="png", dpi=figure.dpi)
