"""Pictures of the computed flow: mesh, pressure on the rotor's top, and velocities on a section."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.figure import Picture, headline
from gyrowheel.show.style import BLUE, INK
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gyrowheel_air.flow import Flow

Array = NDArray[np.float64]
_GAP = 8.0  # mm, what is drawn of the rim gap


def blank(size: tuple[float, float]) -> Figure:
    """Return an empty figure, width and height in inches."""
    return Picture(*size, dots=110)


def mesh_section(flows: Sequence[Flow]) -> tuple[Figure, str] | None:
    """Return a picture of the mesh: a section, and the surface of the rotor (the paper's Fig. 5)."""
    if not flows:
        return None
    from matplotlib.collections import PolyCollection
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    flow = max(flows, key=lambda item: item.tilt)
    figure = blank((11.0, 4.9))
    left = figure.add_axes((0.06, 0.06, 0.46, 0.74))
    quads = 1e3 * flow.section
    left.add_collection(PolyCollection(list(quads), facecolors="white", edgecolors=BLUE, linewidths=0.25))
    _frame_section(left, quads)
    left.set_title("section through the axes")
    right: Any = figure.add_axes((0.54, -0.02, 0.46, 0.84), projection="3d")
    right.add_collection3d(
        Poly3DCollection(1e3 * flow.surface, facecolors="#DCE9F3", edgecolors=BLUE, linewidths=0.3)
    )
    right.set(xlim=(-50, 50), ylim=(-50, 50), zlim=(-50, 50))
    right.set_box_aspect((1, 1, 1), zoom=1.35)
    right.view_init(elev=25, azim=-35)
    right.set_axis_off()
    right.set_title("surface of the rotor", y=0.95)
    headline(
        figure,
        f"The mesh, tilt {flow.tilt / DEG:.0f}°: {flow.cells} hexahedra",
        f"resolution '{flow.mesh}': fine at every wall; the same blocks for every tilt",
    )
    return figure, "The mesh follows the tilted rotor without a break: blocks are moved, not made anew."


def pressure(flows: Sequence[Flow]) -> tuple[Figure, str] | None:
    """Return a picture of the pressure on the rotor's top (the paper's Fig. 10)."""
    if not flows:
        return None
    from matplotlib.collections import PolyCollection

    figure = blank((4.0 * len(flows) + 0.9, 5.0))
    limit = max(float(np.abs(flow.pressure).max()) for flow in flows)
    width = 0.85 / len(flows)
    for i, flow in enumerate(flows):
        axes = figure.add_axes((0.055 + i * width, 0.11, width - 0.04, 0.68))
        patches = PolyCollection(
            list(1e3 * flow.top), array=flow.pressure, cmap="RdBu_r", edgecolors="face", linewidths=0.2
        )
        patches.set_clim(-limit, limit)
        axes.add_collection(patches)
        axes.set(xlim=(-55, 55), ylim=(-55, 55), aspect="equal")
        axes.axhline(0.0, color=INK, linewidth=0.5, linestyle=":")
        axes.set_title(_place(flow))
        axes.set_xlabel("along the tilt's axis, mm")
        if i == 0:
            axes.set_ylabel("a quarter turn ahead, mm")
    bar = figure.colorbar(patches, cax=figure.add_axes((0.915, 0.16, 0.012, 0.56)))
    bar.set_label("pressure less its mean, Pa")
    headline(
        figure,
        "Pressure on the rotor's top",
        "with tilt its centre leaves the rotor's axis, which gives T1 and a part of T2; the rotor turns anticlockwise",
    )
    return figure, (
        "Without tilt the pressure has rings; with tilt it is higher over one half, which turns the rotor back."
    )


def section(flows: Sequence[Flow], which: str) -> tuple[Figure, str] | None:
    """Return a picture of the axial or the radial velocity on a section (the paper's Figs 11 and 12)."""
    if not flows:
        return None
    from matplotlib.collections import PolyCollection

    figure = blank((4.3 * len(flows) + 1.0, 6.4))
    shown = [flow.axial if which == "axial" else flow.radial for flow in flows]
    limit = max(float(np.percentile(np.abs(values), 99.5)) for values in shown)
    grid = figure.add_gridspec(
        2,
        2 * len(flows),
        left=1.0 / figure.get_figwidth(),
        right=0.9,
        top=0.83,
        bottom=0.075,
        height_ratios=(1.0, 1.15),
        hspace=0.3,
        wspace=0.28,
    )
    for i, (flow, values) in enumerate(zip(flows, shown, strict=True)):
        rim, quads = 1e3 * flow.case_radius, 1e3 * flow.section
        top = figure.add_subplot(grid[0, 2 * i : 2 * i + 2])
        sides = [figure.add_subplot(grid[1, 2 * i + side]) for side in (0, 1)]
        for axes in (top, *sides):
            patches = PolyCollection(
                list(quads), array=values, cmap="RdBu_r", edgecolors="face", linewidths=0.2
            )
            patches.set_clim(-limit, limit)
            axes.add_collection(patches)
        _frame_section(top, quads)
        top.set_title(_place(flow))
        top.set_xlabel("")
        for axes, (low, high) in zip(sides, ((-rim, -rim + _GAP), (rim - _GAP, rim)), strict=True):
            axes.set(xlim=(low, high), ylim=top.get_ylim())
            axes.set_xlabel("y, mm")
        sides[1].tick_params(labelleft=False)
        if i == 0:
            sides[0].set_ylabel("rim gaps, drawn wider\nz, mm")
        else:
            top.set_ylabel("")
            sides[0].tick_params(labelleft=False)
            top.tick_params(labelleft=False)
    bar = figure.colorbar(patches, cax=figure.add_axes((0.925, 0.2, 0.012, 0.5)), extend="both")
    bar.set_label({"axial": "axial velocity (up), m/s", "radial": "radial velocity (out), m/s"}[which])
    text = {
        "axial": "without tilt, Taylor vortices fill the rim gap; with tilt, air runs through it and sweeps them away",
        "radial": "out along the rotor's faces, back in along the case; with tilt one side differs from the other",
    }[which]
    headline(figure, f"{which.capitalize()} velocity on the section across the axis of the tilt", text)
    return figure, f"{which.capitalize()} velocity: {text}."


def _frame_section(axes: Axes, quads: Array) -> None:
    low, high = quads.min(axis=(0, 1)), quads.max(axis=(0, 1))
    axes.set(xlim=(low[0] - 1, high[0] + 1), ylim=(low[1] - 1, high[1] + 1), aspect="equal")
    axes.set_xlabel("y, mm")
    axes.set_ylabel("z, mm")


def _place(flow: Flow) -> str:
    return f"{flow.tilt / DEG:.0f}°, {flow.spin_rate / RPM:.0f} rpm"
