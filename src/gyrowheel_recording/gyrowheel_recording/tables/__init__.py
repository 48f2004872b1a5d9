"""Tables of other programs, of whatever format: columns by name, with units and clocks where a file states them.

A reader is found by what a file begins with, then by its ending. What columns mean is not known here; `exchange` says
it.
"""

from gyrowheel_recording.tables.formats import READABLE, Format, format_of, read_grid
from gyrowheel_recording.tables.grid import Column, Grid
from gyrowheel_recording.tables.text import EMPTY, TextForm, form_of_file, text_of

__all__ = [
    "EMPTY",
    "READABLE",
    "Column",
    "Format",
    "Grid",
    "TextForm",
    "form_of_file",
    "format_of",
    "read_grid",
    "text_of",
]
