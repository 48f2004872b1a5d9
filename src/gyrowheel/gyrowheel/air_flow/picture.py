"""Pictures of the air: mesh and what depends on it, torques by tilt and speed, pressure, secondary flow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.figure import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    PINK,
    SOFT,
    VERMILION,
    Picture,
    add_grid,
    finished,
    headline,
    shared_legend,
    style,
)
from gyrowheel_air.cfd.case import Result
from gyrowheel_air.correlations import drag
from gyrowheel_air.flow import Flow, of_study
from gyrowheel_air.geometry import Geometry
from gyrowheel_air.surrogate import get_model
from gyrowheel_air.table import TorqueTable
from gyrowheel_air.torque import density_change, reynolds_number
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
_DOTS = 110  # per inch
_GAP = 8.0  # mm, width of the rim gap in pictures
_MODEL_LOOK = {
    "correlation": (GREEN, "--"),
    "vorticity": (PINK, "-."),
    "table": (BLUE, "-"),
    "surrogate": (VERMILION, ":"),
}
_TURBULENCE_LOOK = {
    "sst": (BLUE, "o", "SST, wall layer resolved"),
    "paper": (VERMILION, "s", "k-ε, wall functions (as the paper)"),
    "laminar": (GREEN, "^", "laminar"),
}
_NAMES = ("T1, back to the case axis", "T2, across", "T3, brakes the spin")


def air_figures(table: TorqueTable, study: Path | None = None) -> Iterator[tuple[str, Figure, str]]:
    """Yield name, figure and explanation of every picture that the data allow.

    Those of mesh and flow need the folder of a study with its solutions; InputError if it cannot be read.
    """
    drawings: dict[str, Callable[[], tuple[Figure, str] | None]] = {
        "mesh_dependence": lambda: mesh_dependence(table),
        "reynolds": lambda: numbers(table),
        "torque_by_tilt": lambda: by_tilt(table),
        "torque_by_speed": lambda: by_speed(table),
    }
    if study is not None:
        cases = of_study(study)
        drawings |= {
            "mesh": lambda: mesh_section(cases),
            "pressure": lambda: pressure(cases),
            "axial_velocity": lambda: section(cases, "axial"),
            "radial_velocity": lambda: section(cases, "radial"),
        }
    for name, draw in drawings.items():
        with style():
            result = draw()
            if result is not None:
                finished(result[0])
        if result is not None:
            yield name, *result


# ---- from the table


def mesh_dependence(table: TorqueTable) -> tuple[Figure, str] | None:
    """Return a picture of the torques against the number of cells (the paper's Fig. 6)."""
    rows = [row for row, _ in table.alternatives()]
    if not rows:
        return None
    tilt = max(row.case.tilt for row in rows)
    speed = next(row.case.spin_rate for row in rows if row.case.tilt == tilt)
    base = [r for r in (table.at(tilt, speed), table.at(0.0, speed)) if r is not None]
    figure, axes = _figure(1, 3, (12.0, 4.6))
    for component, panel in enumerate(axes):
        for model in _TURBULENCE_LOOK:
            for place in (tilt, 0.0):
                found = sorted(
                    (
                        r
                        for r in [*rows, *base]
                        if r.case.model == model and r.case.tilt == place and r.case.spin_rate == speed
                    ),
                    key=lambda r: int(r.provenance["cells"]),
                )
                # at no tilt T1 and T2 are zero by symmetry, which shows nothing
                if found and (place == tilt or component == 2):
                    _over_cells(panel, component, model, found, filled=place == tilt)
        if component == 2:
            expected = drag(_geometry(table), table.air, speed, regime="II")
            panel.axhline(1e3 * expected.total, color=SOFT, linestyle="--", linewidth=1)
            panel.annotate(
                "dashed: disc II + Bilgen & Boulos",
                (0.98, 0.03),
                xycoords="axes fraction",
                ha="right",
                va="bottom",
                fontsize=9,
                color=SOFT,
            )
        panel.set_title(_NAMES[component])
        panel.set_xlabel("thousand cells")
        panel.set_ylim(bottom=0.0)
    axes[0].set_ylabel("magnitude of the torque, mN·m")
    _legend(figure, axes[0])
    headline(
        figure,
        f"Mesh and turbulence model, {speed / RPM:.0f} rpm",
        f"filled: tilt {tilt / DEG:.0f}°; hollow: no tilt, where symmetry makes T1 and T2 zero on any mesh; "
        "bars: scatter over the iterations",
    )
    return figure, (
        "Torques against the number of cells; not at zero tilt, where symmetry makes T1 and T2 zero on every mesh."
    )


def _over_cells(panel: Axes, component: int, model: str, found: Sequence[Result], *, filled: bool) -> None:
    """Draw one component of the torque over the number of cells, with the y+ of wall functions."""
    colour, marker, label = _TURBULENCE_LOOK[model]
    cells = [r.provenance["cells"] / 1e3 for r in found]
    size = [1e3 * abs(r.torque.mean[component]) for r in found]
    panel.errorbar(
        cells,
        size,
        [1e3 * r.torque.scatter[component] for r in found],
        color=colour,
        marker=marker,
        markerfacecolor=colour if filled else "white",
        markersize=7,
        linestyle="-"
        if model == "sst"
        else "none",  # the k-epsilon rows differ in more than their number of cells
        linewidth=1.0,
        capsize=3,
        label=label if filled else None,
    )
    for r, x, y in zip(found, cells, size, strict=True) if model == "paper" and filled else ():
        panel.annotate(
            f"y⁺ {r.y_plus['rotor'][0]:.0f}",
            (x, y),
            xytext=(7, -12),
            textcoords="offset points",
            fontsize=9,
            color=colour,
        )


def numbers(table: TorqueTable) -> tuple[Figure, str]:
    """Return a picture of Reynolds number and change of density over speed (the paper's Fig. 7)."""
    geometry = _geometry(table)
    speeds = np.linspace(0.0, 5000.0, 101)[1:] * RPM
    re = np.array([reynolds_number(table.air, geometry.rotor_radius, w) for w in speeds])
    change = np.array([density_change(table.air, geometry.rotor_radius, w) for w in speeds])
    figure, axes = _figure(1, 2, (10.0, 4.2))
    left, right = axes
    left.plot(speeds / RPM, re / 1e3, color=BLUE)
    left.axhline(158.0, color=SOFT, linestyle="--", linewidth=1)
    left.annotate("end faces turn turbulent (II to IV)", (100.0, 161.0), fontsize=9, color=SOFT)
    left.set_title("Reynolds number, thousands (eq 9)")
    right.plot(speeds / RPM, 100.0 * change, color=BLUE)
    right.set_title("change of density, % (eq 10)")
    for panel in axes:
        panel.axvspan(table.speeds[0] / RPM, table.speeds[-1] / RPM, color=FAINT, alpha=0.6, zorder=0)
        panel.set_xlabel("spin rate, rpm")
        panel.set_ylim(bottom=0.0)
        panel.set_xlim(0.0, 5000.0)
    left.set_ylim(0.0, 180.0)
    at = float(np.interp(table.speeds[-1], speeds, re))
    headline(
        figure,
        "Incompressible, and below the transition of the end faces",
        f"grey: the speeds of the table, up to Re = {at / 1e3:.0f} thousand; "
        f"the density changes by {100 * float(np.interp(table.speeds[-1], speeds, change)):.2f} % at most",
    )
    return figure, "Reynolds number and change of density at the rim over the spin rate."


def by_tilt(table: TorqueTable) -> tuple[Figure, str]:
    """Return a picture of the torques over the tilt at one speed (the paper's Fig. 8)."""
    speed = float(min(table.speeds, key=lambda w: abs(w - 3500.0 * RPM)))
    tilts = np.linspace(0.0, table.tilts[-1], 51)
    return _torques(
        table,
        tilts / DEG,
        [(tilt, speed) for tilt in tilts],
        [(r.case.tilt / DEG, r) for r in table.grid if r.case.spin_rate == speed],
        "tilt, deg",
        f"Torque of the air over the tilt, {speed / RPM:.0f} rpm",
        "Tilting about one axis gives both transverse torques; the drag on the spin changes much less.",
    )


def by_speed(table: TorqueTable) -> tuple[Figure, str]:
    """Return a picture of the torques over the speed at the largest tilt (the paper's Fig. 9)."""
    tilt = float(table.tilts[-1])
    speeds = np.linspace(table.speeds[0], table.speeds[-1], 51)
    return _torques(
        table,
        speeds / RPM,
        [(tilt, speed) for speed in speeds],
        [(r.case.spin_rate / RPM, r) for r in table.grid if r.case.tilt == tilt],
        "spin rate, rpm",
        f"Torque of the air over the speed, tilt {tilt / DEG:.0f}°",
        "All three grow with the speed: the transverse ones nearly as its square, the drag as its power 1.5.",
    )


def _torques(
    table: TorqueTable,
    x: Array,
    places: Sequence[tuple[float, float]],
    rows: Sequence[tuple[float, Result]],
    label: str,
    title: str,
    sentence: str,
) -> tuple[Figure, str]:
    geometry = _geometry(table)
    figure, axes = _figure(1, 3, (12.0, 4.6))
    for name, (colour, line) in _MODEL_LOOK.items():
        model = get_model(name, table)
        found = [model.torque(geometry, table.air, (tilt, 0.0), speed) for tilt, speed in places]
        mean = 1e3 * np.abs([t.components for t in found])
        error = 1e3 * np.array([t.uncertainty for t in found])
        for i, panel in enumerate(axes):
            if np.isfinite(mean[1:, i]).all():
                panel.plot(x, mean[:, i], line, color=colour, label=name, linewidth=1.6)
                if name in ("correlation", "vorticity", "table"):
                    low, high = mean[:, i] - error[:, i], mean[:, i] + error[:, i]
                    panel.fill_between(x, low, high, color=colour, alpha=0.12, linewidth=0)
    for i, panel in enumerate(axes):
        for at, row in rows:
            panel.errorbar(
                at,
                1e3 * abs(row.torque.mean[i]),
                1e3 * row.torque.scatter[i],
                color=BLUE,
                marker="o",
                markersize=5,
                capsize=3,
                linewidth=1,
            )
        panel.set_title(_NAMES[i])
        panel.set_xlabel(label)
        panel.set_ylim(bottom=0.0)
    axes[0].set_ylabel("magnitude of the torque, mN·m")
    _legend(figure, *axes)
    headline(
        figure,
        title,
        "dots: computed cases with their scatter; bands: standard uncertainty that the model states",
    )
    return figure, sentence


def _geometry(table: TorqueTable) -> Geometry:
    geometry = Geometry.load()
    for name, value in table.lengths.items():
        geometry = geometry.with_value(name, value)
    return geometry


def _figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    figure = Picture(*size, dots=_DOTS)
    grid = figure.add_gridspec(rows, columns, left=0.065, right=0.972, top=0.74, bottom=0.13, wspace=0.2)
    axes = [figure.add_subplot(grid[row, column]) for row in range(rows) for column in range(columns)]
    for panel in axes:
        add_grid(panel, "y")
    return figure, axes


def _legend(figure: Figure, *axes: Axes) -> None:
    above = 1.0 - 0.08 / figure.get_figheight()
    shared_legend(figure, axes, loc="upper right", ncols=4, fontsize=10, bbox_to_anchor=(0.985, above))


# ---- from the flow


def mesh_section(flows: Sequence[Flow]) -> tuple[Figure, str] | None:
    """Return a picture of the mesh: a section, and the surface of the rotor (the paper's Fig. 5)."""
    if not flows:
        return None
    from matplotlib.collections import PolyCollection
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    flow = max(flows, key=lambda item: item.tilt)
    figure = Picture(11.0, 4.9, dots=_DOTS)
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
    return (
        figure,
        "The mesh follows the tilted rotor without a break: its blocks are moved, not generated again.",
    )


def pressure(flows: Sequence[Flow]) -> tuple[Figure, str] | None:
    """Return a picture of the pressure on the rotor's top (the paper's Fig. 10)."""
    if not flows:
        return None
    from matplotlib.collections import PolyCollection

    figure = Picture(4.0 * len(flows) + 0.9, 5.0, dots=_DOTS)
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

    figure = Picture(4.3 * len(flows) + 1.0, 6.4, dots=_DOTS)
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
