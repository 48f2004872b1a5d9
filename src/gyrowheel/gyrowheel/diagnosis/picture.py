"""The picture of a correction map: the torque over the tilts, speed by speed, and over speed and tilt."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel.show.figure import DARK, SOFT, Picture, drawn
from gyrowheel.show.sentences.correction import range_text
from gyrowheel_core.units import DEG, RPM, unit_for

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gyrowheel_analysis.diagnosis.correction_map import CorrectionMap

_SPEEDS = 4
_CELLS = 81  # a side of a panel
_ARROWS = 9


@drawn(framed=True)
def map_figure(found: CorrectionMap) -> Figure:
    """Draw a map over the plane of the tilt at four speeds, a line of panels for each torque.

    Colours are the size of the torque on the rotor and the torque on the shaft; arrows show the direction on the rotor.
    """
    targets = found.targets
    figure = Picture(16.0, 1.6 + 4.2 * len(targets))
    height = figure.get_figheight()
    figure.text(0.045, 1.0 - 0.4 / height, "The missing torque", fontsize=20, fontweight="bold", va="center")
    figure.text(
        0.045, 1.0 - 0.8 / height,
        f"Map of what no known law describes, {range_text(found.effect)}, at the middle of the temperatures.",
        fontsize=12.5, color=SOFT, va="center",
    )  # fmt: skip
    grid = figure.add_gridspec(
        len(targets), _SPEEDS + 1, left=0.06, right=0.94, top=1.0 - 1.3 / height, bottom=0.7 / height,
        width_ratios=[*[1.0] * _SPEEDS, 0.05], hspace=0.3,
    )  # fmt: skip
    low, high = found.effect.within.speed
    speeds = np.linspace(low, high, _SPEEDS)
    for line, target in enumerate(targets):
        rotor = target == "rotor_torque"
        values = [_torque(found, target, speed, _CELLS) for speed in speeds]
        most = max(float(np.nanmax(np.abs(own))) for own in values) or 1.0
        name, unit = unit_for(most, "N·m")
        for place, (speed, own) in enumerate(zip(speeds, values, strict=True)):
            axes = figure.add_subplot(grid[line, place])
            reach = found.effect.within.tilt / DEG
            image = axes.imshow(
                (np.abs(own) if rotor else own) / unit, origin="lower", extent=(-reach, reach, -reach, reach),
                cmap="OrRd" if rotor else "RdBu_r", vmin=0.0 if rotor else -most / unit, vmax=most / unit,
            )  # fmt: skip
            if rotor:
                _arrows(axes, found, speed, most)
            axes.set_title(f"{speed / RPM:.0f} rpm", fontsize=13, loc="center")
            axes.set_xlabel("tilt about x, °")
            if place == 0:
                axes.set_ylabel("tilt about y, °")
        bar = figure.colorbar(image, cax=figure.add_subplot(grid[line, _SPEEDS]))
        bar.set_label(f"{'on the rotor' if rotor else 'on the shaft'}, {name}")
    return figure


def tilts_of(found: CorrectionMap, cells: int) -> Any:
    """Return a square of tilts phi_x + i phi_y [rad] (cells, cells) that holds those of a map."""
    side = np.linspace(-found.effect.within.tilt, found.effect.within.tilt, cells)
    return side[None, :] + 1j * side[:, None]


def at_speed(found: CorrectionMap, speed: float, tilt: Any) -> dict[str, Any]:
    """Return the quantities of a map at tilts and a speed, at the middle of its temperatures."""
    within = found.effect.within
    middle = {"T_coil": 0.5 * sum(within.coils), "T_motor": 0.5 * sum(within.magnets)}
    return {"z": tilt, "Omega": np.full(tilt.shape, speed), **middle}


def _torque(found: CorrectionMap, target: Any, speed: float, cells: int) -> Any:
    """Return the torque [N m] over a square of tilts; nan beyond the largest tilt."""
    z = tilts_of(found, cells) * (1.0 - 1.0 / cells)  # of the middles of cells, so that all lie within
    value = found.at(at_speed(found, speed, z))[target]
    return np.where(np.abs(z) <= found.effect.within.tilt, np.broadcast_to(value, z.shape), np.nan)


def _arrows(axes: Any, found: CorrectionMap, speed: float, most: float) -> None:
    reach = found.effect.within.tilt / DEG
    side = np.linspace(-reach, reach, _ARROWS) * (1.0 - 1.0 / _ARROWS)
    value = _torque(found, "rotor_torque", speed, _ARROWS) * (0.3 * reach / most)
    axes.quiver(
        *np.meshgrid(side, side), value.real, value.imag, angles="xy", scale_units="xy", scale=1.0, width=0.006,
        color=DARK, alpha=0.8,
    )  # fmt: skip
