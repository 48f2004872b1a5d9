"""Notch-filtered signals of recordings as a table."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from gyrowheel_core.errors import printable
from gyrowheel_core.files import new_file
from gyrowheel_recording.mapping.table import check_suffix

_HEAD: Final = ["recording", "stamp", "notched_tilt_x"]


def write_signals(
    signals: Sequence[Mapping[str, Any]], units: Mapping[str, str], file: str | Path
) -> list[str]:
    """Write signals as a table, the recordings one after the other.

    Parameters
    ----------
    signals : sequence of mapping
        For each recording ``recording``, its name, and columns of equal length [SI], ``stamp`` first.
    units : mapping
        Unit of each column, for the metadata of a Parquet file.
    file : str or Path
        The ``.csv`` or ``.parquet`` file; it is whole or as it was before.

    Returns
    -------
    list of str
        Names of the columns.

    Raises
    ------
    InputError
        If the file has another ending, or cannot be written.
    """
    path = Path(file)
    check_suffix(path)
    names = [name for name in signals[0] if name != "recording"]
    fields = [pa.field("recording", pa.string())]
    fields += [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in names]
    schema = pa.schema(fields, metadata={"gyrowheel": json.dumps({"signals": "notched"})})
    paths = [printable(str(own["recording"])) for own in signals for _ in own["stamp"]]
    columns = [pa.array(np.concatenate([own[name] for own in signals])) for name in names]
    table = pa.Table.from_arrays([pa.array(paths, pa.string()), *columns], schema=schema)
    with new_file(path) as place, place.open("wb") as opened:
        if path.suffix == ".csv":
            pc.write_csv(table, opened)
        else:
            pq.write_table(table, opened, compression="zstd")
    return [str(name) for name in schema.names]


def is_signal_head(names: Sequence[str]) -> bool:
    """Return whether the first line of a table is one of `write_signals`."""
    return list(names[: len(_HEAD)]) == _HEAD
