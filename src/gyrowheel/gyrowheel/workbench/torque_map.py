"""Numbers for the picture of the missing torque as a map: its value and its standard deviation over the tilts."""

from __future__ import annotations

from typing import Any

import numpy as np

from gyrowheel.diagnosis.picture import at_speed, tilts_of
from gyrowheel.show.sentences.correction import PLACES, range_text
from gyrowheel.workbench.session import Session
from gyrowheel_core.units import DEG, RPM, unit_for

_CELLS = 23  # across the tilts
_SPEEDS = 5


def torque_maps(session: Session) -> list[dict[str, Any]]:
    """Return the map of the diagnosis, one entry a torque, at several speeds; empty without one.

    ``x`` and ``y`` are the tilts [deg] in the range of the map, the middles of cells. Of every speed ``value_x`` and
    ``value_y`` are the torque on the rotor, of the shaft ``value_x`` alone, and ``sigma`` its standard deviation, of
    both axes together. ``shape`` is the part of that, its root mean square, which is neither an offset nor a slope over
    the tilts: bench parameters share those with the map.
    """
    diagnosis = session.step.diagnosis
    found = None if diagnosis is None else diagnosis.map
    if found is None:
        return []
    within, square = found.effect.within, tilts_of(found, _CELLS) * (1.0 - 1.0 / _CELLS)
    z = square[np.abs(square) <= within.tilt]
    low, high = within.speed
    speeds = np.linspace(low, high, _SPEEDS if high - low > RPM else 1)
    states = [at_speed(found, speed, z) for speed in speeds]
    values, errors = ([make(own) for own in states] for make in (found.at, found.errors_at))
    shown = []
    for target in found.targets:
        most = max(float(np.abs(own[target]).max()) for own in values)
        unit = unit_for(most or 1.0, "N·m")

        def row(own: Any, size: float = unit.size) -> list[float]:
            return [float(f"{v:.4g}") for v in np.broadcast_to(own, z.shape) / size]

        shown.append(
            {
                "target": target,
                "title": PLACES[target],
                "range": range_text(found.effect),
                "unit": unit.label,
                "most": most / unit.size,
                "cell": 2.0 * within.tilt / _CELLS / DEG,
                "x": (z.real / DEG).round(4).tolist(),
                "y": (z.imag / DEG).round(4).tolist(),
                "speeds": [
                    {
                        "speed": round(speed / RPM),
                        "value_x": row(np.real(value[target])),
                        "value_y": row(np.imag(value[target])),
                        "sigma": row(np.sqrt(np.sum(np.abs(error[target]) ** 2, axis=0))),
                        "shape": round(_shape(error[target], z) / unit.size, 6),
                    }
                    for speed, value, error in zip(speeds, values, errors, strict=True)
                ],
            }
        )
    return shown


def _shape(errors: Any, tilt: Any) -> float:
    """Return the root mean square of errors (errors, n) at tilts (n,) without their mean and slopes."""
    plane = np.column_stack([np.ones(len(tilt)), tilt.real, tilt.imag])
    rest = errors.T - plane @ np.linalg.lstsq(plane, errors.T, rcond=None)[0]
    return float(np.sqrt(np.mean(np.sum(np.abs(rest) ** 2, axis=1))))
