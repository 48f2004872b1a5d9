"""Import of tables of other programs (CSV, Parquet) as recordings, and export of recordings as tables.

A map file states which column of a table has which reading, in which unit; docs/exchange.md describes it.
"""

from gyrowheel_recording.mapping.exchange import (
    Imported,
    export_recording,
    import_table,
    is_exported_map,
    is_exported_table,
)
from gyrowheel_recording.mapping.map_file import ColumnMap, Source
from gyrowheel_recording.mapping.table import check_suffix

__all__ = [
    "ColumnMap", "Imported", "Source", "check_suffix", "export_recording", "import_table", "is_exported_map",
    "is_exported_table",
]  # fmt: skip
