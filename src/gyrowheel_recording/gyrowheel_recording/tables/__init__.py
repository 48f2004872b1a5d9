"""Tables of other programs, of any format: columns by name, with units and clocks where a file states them.

The reader is chosen by the first bytes of a file, then by its ending. The meaning of columns is not known here, but to
`mapping`.
"""

from gyrowheel_recording.tables.formats import READABLE, Format, format_of, read_grid
from gyrowheel_recording.tables.grid import Column, Grid
from gyrowheel_recording.tables.text import EMPTY, TextForm, form_of_file, text_of

__all__ = [
    "EMPTY", "READABLE", "Column", "Format", "Grid", "TextForm", "form_of_file", "format_of", "read_grid",
    "text_of",
]  # fmt: skip
