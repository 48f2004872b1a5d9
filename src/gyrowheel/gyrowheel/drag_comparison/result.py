"""Measured DC voltages beside simulated torques, hold by hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel.show.result import Result
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel.models.api import Model
    from gyrowheel_analysis.drag.estimate import Estimate


#: Units of the columns of `Drag.signals`.
SIGNAL_UNITS = {
    "stamp": "s",
    "notched_tilt_x": "rad",
    "notched_tilt_y": "rad",
    "notched_coil_voltage_x": "V",
    "notched_coil_voltage_y": "V",
    "notched_motor_voltage": "V",
    "notched_motor_current": "A",
}


@dataclass(frozen=True, repr=False)
class Drag(Result):
    """Outcome of `gyrowheel.drag`.

    Attributes
    ----------
    holds : tuple of tuple of gyrowheel_analysis.drag.estimate.Estimate
        Drag estimates of the settled holds, for each recording.
    model : Model
        The believed model.
    recordings : tuple of str
        Paths of the recordings.
    signals : tuple of dict
        For each recording ``stamp`` [s] and the notch-filtered readings, of which the DC voltages are means:
        ``notched_tilt_x``, ``notched_tilt_y`` [rad], ``notched_coil_voltage_x``, ``notched_coil_voltage_y``,
        ``notched_motor_voltage`` [V] and ``notched_motor_current`` [A]; ndarrays (n,), NaN where a sample is lost.
        Empty where they were not asked for.
    """

    holds: tuple[tuple[Estimate, ...], ...]
    model: Model
    recordings: tuple[str, ...]
    signals: tuple[Mapping[str, Any], ...]

    def __str__(self) -> str:
        """Return number of holds and largest difference."""
        every = [estimate for own in self.holds for estimate in own]
        worst = max(float(np.max(np.abs(e.residual / e.residual_std))) for e in every)
        constants = "calibrated" if all(e.calibrated for e in every) else "stated"
        return (
            f"{len(every)} holds; measured and simulated torques differ by up to {worst:.2g} standard errors "
            f"({constants} constants)"
        )

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.drag_comparison.page import drag_page
        from gyrowheel.show.layout import heading

        for path, own in zip(self.recordings, self.holds, strict=True):
            if len(self.recordings) > 1:
                yield heading(path)
            yield from drag_page(own)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel drag --json``; SI units, the fields of the DragEstimate message."""
        return {
            "schema": 1,
            "model": self.model.origin,
            "recordings": [
                {"recording": path, "holds": [estimate.to_dict() for estimate in own]}
                for path, own in zip(self.recordings, self.holds, strict=True)
            ],
        }

    def plot(self) -> Figure:
        """Return a picture of filtered voltages over time, and of increments over tilt and speed.

        Raises
        ------
        InputError
            If the signals were not kept.
        """
        from gyrowheel.drag_comparison.picture import figure_of_drag

        self._require_signals()
        return figure_of_drag(self)

    def write_signals(self, path: str | Path) -> list[str]:
        """Write `signals` as a table, ``.csv`` or ``.parquet``, and return the names of its columns.

        Raises
        ------
        InputError
            If the file has another ending, or cannot be written, or the signals were not kept.
        """
        from gyrowheel_recording.mapping.table_export import write_signals

        self._require_signals()
        named = [{"recording": r, **own} for r, own in zip(self.recordings, self.signals, strict=True)]
        return write_signals(named, SIGNAL_UNITS, path)

    def _require_signals(self) -> None:
        if len(self.signals) < len(self.recordings):
            raise InputError("signals: False; allowed: True, for what needs the filtered readings")

    def to_columns(self) -> Mapping[str, Any]:
        """Return a row for each hold; fields of three values have a column each: ``_x``, ``_y`` and ``_motor``."""
        rows = [
            {"recording": path, **estimate.to_dict()}
            for path, own in zip(self.recordings, self.holds, strict=True)
            for estimate in own
        ]
        columns: dict[str, list[Any]] = {}
        for row in rows:
            for name, value in row.items():
                if isinstance(value, list):
                    for end, part in zip(("x", "y", "motor"), value, strict=True):
                        columns.setdefault(f"{name}_{end}", []).append(part)
                else:
                    columns.setdefault(name, []).append(value)
        return columns
