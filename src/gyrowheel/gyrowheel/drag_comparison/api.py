"""Measured DC voltages next to simulated torques, hold by hold: the drag analysis of Huo et al. 2016."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrowheel.models.api import Model
from gyrowheel.recordings.api import Recording
from gyrowheel.recordings.inputs import Recordings, of_one_machine
from gyrowheel.show.result import Result
from gyrowheel_analysis.drag.notch import notched
from gyrowheel_analysis.drag.stream import DragTest, recorded_holds
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.reduction.quality import NEEDED
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

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
class Drag(Result, DragTest):
    """Outcome of `gyrowheel.drag`: the fields of `gyrowheel_analysis.drag.stream.DragTest`, and the believed `model`.

    Attributes
    ----------
    model : Model
        The believed model.
    """

    model: Model

    def headline(self) -> str:
        """Return the number of holds, and whether measured and simulated torques agree."""
        from gyrowheel.drag_comparison.page import disagreeing

        every = self.estimates
        constants = "calibrated" if all(e.calibrated for e in every) else "stated"
        return (
            f"{len(every)} holds; measured and simulated torques {disagreeing(self)} ({constants} constants)"
        )

    def page(self) -> Iterable[RenderableType]:
        """Return a table of holds for each coil and the motor, of each recording."""
        from gyrowheel.drag_comparison.page import drag_test_page

        return drag_test_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel drag --json``; SI units, the fields of the DragEstimate message."""
        return {
            "schema": 1,
            "model": self.model.origin,
            "recordings": [
                {
                    "recording": path,
                    "holds": [estimate.to_dict() for estimate in own],
                    "agreement": {
                        name: {
                            "agrees": one.agrees,
                            "chi2": one.chi2,
                            "p": one.p,
                            "apart": one.apart.tolist(),
                            "shared": one.shared.tolist(),
                        }
                        for name, one in zip(("coil_x", "coil_y", "motor"), judged, strict=True)
                    },
                }
                for path, own, judged in zip(self.recordings, self.holds, self.agreements, strict=True)
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
        from gyrowheel_recording.mapping.exchange import write_signals

        self._require_signals()
        named = [{"recording": r, **own} for r, own in zip(self.recordings, self.signals, strict=True)]
        return write_signals(named, SIGNAL_UNITS, path)

    def _require_signals(self) -> None:
        if len(self.signals) < len(self.recordings):
            raise InputError("signals: False; allowed: True, for what needs the filtered readings")


@one_thread()
def drag(
    recordings: Recordings, model: Model | None = None, *, mixed: bool = False, signals: bool = True
) -> Drag:
    """Compare measured DC voltages with simulated torques, hold by hold, as the drag estimator of the graph does.

    The estimates are computed from the measurements; recorded ones are not used.

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings. Holds are those of the setpoints; without setpoints they are found in the motion.
    model : Model, optional
        The believed model; one of the bench ``gyrowheel`` without effects if not given.
    mixed : bool
        Join recordings that state different machines.
    signals : bool
        Whether to keep the notch-filtered readings of every sample, which a picture and a table of them need.

    Raises
    ------
    InputError
        If a recording cannot be read or has no steady hold, or several state different machines.
    """
    known = Model() if model is None else model
    given = of_one_machine(recordings, mixed=mixed)
    found, filtered = [], []
    for own in given:
        holds = recorded_holds(own.data, known.details)
        if not holds:
            raise InputError(f"{own.path}: no steady hold")
        found.append(tuple(holds))
        if signals:
            filtered.append(_filtered(own, known))
    return Drag(tuple(found), known.bench, tuple(str(own.path) for own in given), tuple(filtered), known)


def _filtered(own: Recording, model: Model) -> dict[str, Any]:
    samples = samples_of(own.data)
    found = notched(samples.readings, NEEDED, samples.period(model.bench.sample_period))
    stamps = own.data.measurement["stamp_ns"] * 1e-9
    return {"stamp": stamps, **{f"notched_{name}": v for name, v in found.items()}}
