"""Measured DC voltages beside simulated torques, hold by hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel.results.base import Result

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel.model import Model
    from gyrowheel_analysis.drag import Estimate


@dataclass(frozen=True, repr=False)
class Drag(Result):
    """Outcome of `gyrowheel.drag`.

    Attributes
    ----------
    holds : tuple of tuple of gyrowheel_analysis.drag.Estimate
        Drag estimates of the settled holds, for each recording.
    model : Model
        The believed model.
    recordings : tuple of str
        Paths of the recordings.
    """

    holds: tuple[tuple[Estimate, ...], ...]
    model: Model
    recordings: tuple[str, ...]

    def __str__(self) -> str:
        """Return number of holds and largest difference."""
        every = [estimate for own in self.holds for estimate in own]
        worst = max(float(np.max(np.abs(e.residual / e.residual_std))) for e in every)
        constants = "calibrated" if all(e.calibrated for e in every) else "stated"
        return (
            f"{len(every)} holds; measured and simulated torques differ by up to {worst:.2g} standard errors "
            f"({constants} constants)"
        )

    def _page(self) -> Iterable[RenderableType]:
        from gyrowheel.text.drag import drag_page
        from gyrowheel.text.layout import heading

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
