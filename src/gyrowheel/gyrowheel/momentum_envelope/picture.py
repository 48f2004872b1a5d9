"""Pictures of the momentum that a wheel can take, Figs 3 and 4 of Huo et al. 2016.

The exact momentum of the rotor is drawn next to the approximation of the paper: the difference is neglected there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.figure import BLUE, FAINT, GREEN, GROUND, SOFT, VERMILION, Picture, add_grid, drawn
from gyrowheel_core.units import DEG, RPM, unit_for
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.mechanics import kinematics as k
from gyrowheel_sim.mechanics.kinematics import largest_errors, revolution, rotor_inertias, speeds_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

#: The caps are flat: their heights are drawn this much too large.
STRETCH = 12.0
_DOTS = 110
_BOX = 0.8  # height of a box over its width
_EXACT, _LAST, _MIDDLE = BLUE, VERMILION, GREEN


@drawn(10.5)
def caps_figure(bench: Bench, speeds: Array | None = None) -> Figure:
    """Draw Fig. 3: the caps at up to three spin rates [rad/s], and the exact form next to the approximations.

    Of more than three spin rates, lowest first, the lowest, the middle one and the highest are drawn.
    """
    speeds = _three(bench, speeds)
    figure = Picture(11.5, 7.9, dots=_DOTS)
    title = f"Angular momentum that the wheel reaches, tilt up to {bench.value('tilt_limit') / DEG:.3g}°"
    figure.text(0.03, 0.965, title, fontsize=16, fontweight="bold", va="center")
    unit, scale = unit_for(bench.value("rotor_inertia_z") * float(speeds[-1]), "N·m·s")
    turn = np.linspace(0.0, 2.0 * np.pi, 49)
    heights = bench.value("rotor_inertia_z") * speeds / scale
    wide = float(heights[-1]) * np.sin(bench.value("tilt_limit"))
    left = 0.005 + 0.16 * (3 - len(speeds))
    for place, (speed, height) in enumerate(zip(speeds, heights, strict=True)):
        axes: Any = figure.add_axes((left + 0.32 * place, 0.455, 0.31, 0.42), projection="3d")
        axes.patch.set_visible(False)  # it would cover the label of its neighbour
        x, y, z = np.moveaxis(_cap(bench, speed, turn) / scale, -1, 0)
        axes.plot_surface(x, y, z, cmap="viridis", linewidth=0.2, edgecolor=GROUND, rcount=12, ccount=48)
        tall = 2.0 * wide * _BOX / STRETCH
        _box(axes, wide, height - 0.65 * tall, height + 0.35 * tall, unit, heights=3)
        axes.set_title(
            f"({'abc'[place]})  {speed / RPM:.0f} rpm: radius {height:.3g} {unit}", y=1.01, loc="center"
        )
    panels = [
        figure.add_axes((left, 0.08, width, 0.31))
        for left, width in ((0.07, 0.245), (0.415, 0.235), (0.74, 0.24))
    ]
    _revolution(panels[0], bench, _middle(speeds), scale, unit)
    _error_panel(panels[1], bench, _middle(speeds))
    _paths(panels[2], bench, _middle(speeds), scale, unit)
    return figure


@drawn(10.5)
def body_figure(bench: Bench, speeds: Array | None = None) -> Figure:
    """Draw Fig. 4: the body of all momenta between the lowest and the highest speed, cut open, and its section."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    speeds = _three(bench, speeds)
    figure = Picture(11.5, 5.5, dots=_DOTS)
    unit, scale = unit_for(bench.value("rotor_inertia_z") * float(speeds[-1]), "N·m·s")
    limit, inertia = bench.value("tilt_limit"), bench.value("rotor_inertia_z") / scale
    axes: Any = figure.add_axes((0.0, 0.02, 0.5, 0.86), projection="3d", computed_zorder=False)
    # a quarter towards the viewer is cut away
    # the momentum points a quarter turn behind the azimuth of the tilt
    turn = np.linspace(0.5 * np.pi, 2.0 * np.pi, 37)
    bottom, top = (_cap(bench, speed, turn) / scale for speed in (speeds[0], speeds[-1]))
    between = np.linspace(float(speeds[0]), float(speeds[-1]), 9)
    rim = np.stack([_cap(bench, speed, turn)[-1] / scale for speed in between])
    faces = []
    for angle in (turn[0], turn[-1]):
        one = np.array([angle])
        sides = [_cap(bench, speed, one)[:, 0] / scale for speed in (speeds[0], speeds[-1])]
        faces.append(np.concatenate([sides[0], sides[1][::-1]]))
    axes.plot_surface(*np.moveaxis(bottom, -1, 0), color="#4E79A7", linewidth=0.1, edgecolor=GROUND, zorder=1)
    axes.plot_surface(*np.moveaxis(rim, -1, 0), color="#A0CBE8", linewidth=0.1, edgecolor=GROUND, zorder=2)
    axes.add_collection3d(
        Poly3DCollection(faces, facecolor="#F1CE63", edgecolor="#7A6520", linewidth=0.6, zorder=3)
    )
    axes.plot_surface(*np.moveaxis(top, -1, 0), color="#86BC86", linewidth=0.1, edgecolor=GROUND, zorder=4)
    wide = inertia * float(speeds[-1]) * np.sin(limit)
    low, high = inertia * float(speeds[0]) * np.cos(limit), inertia * float(speeds[-1])
    _box(axes, wide, low - 0.02 * high, 1.01 * high, unit)
    axes.view_init(elev=18, azim=-45)
    title = f"Angular momentum, tilt up to {limit / DEG:.3g}°, {speeds[0] / RPM:.0f} to {speeds[-1] / RPM:.0f} rpm"
    figure.text(0.03, 0.94, title, fontsize=16, fontweight="bold", va="center")
    section = figure.add_axes((0.57, 0.12, 0.40, 0.70))
    tilt = np.linspace(-limit, limit, 61)
    for speed in speeds:
        section.plot(
            inertia * speed * np.sin(tilt), inertia * speed * np.cos(tilt), color=_EXACT, linewidth=1.8
        )
        section.annotate(
            f"{speed / RPM:.0f} rpm", (0.0, inertia * speed), xytext=(0, 5), textcoords="offset points", ha="center",
            color=_EXACT,
        )  # fmt: skip
    for side in (-limit, limit):
        ends = inertia * np.array([speeds[0], speeds[-1]])
        section.plot(ends * np.sin(side), ends * np.cos(side), color=_EXACT, linewidth=1.8)
    # ripple of the exact momentum within a revolution, along the spin axis
    for angle in (-limit, -0.5 * limit, 0.5 * limit, limit):
        size = np.linalg.norm(
            k.held_momentum(_middle(speeds), abs(angle), 0.0, revolution(), rotor_inertias(bench)) / scale,
            axis=-1,
        )
        ends = np.array([size.min(), size.max()])
        section.plot(
            ends * np.sin(angle), ends * np.cos(angle), color=_LAST, linewidth=4.0, solid_capstyle="butt"
        )
    section.plot([], [], color=_LAST, linewidth=4.0, label="exact, within a revolution")
    section.legend(loc="center", bbox_to_anchor=(0.5, 0.33))
    section.set_xlabel(f"across the case axis, {unit}")
    section.set_ylabel(f"along the case axis, {unit}")
    section.set_title("section")
    section.grid(color=FAINT, linewidth=0.8)
    section.margins(y=0.12)
    section.set_axisbelow(True)
    return figure


def _three(bench: Bench, speeds: Array | None) -> Array:
    """Return at most three speeds: the lowest, the middle one, the highest."""
    given = speeds_of(bench) if speeds is None else speeds
    return given if len(given) <= 3 else given[[0, len(given) // 2, -1]]


def _middle(speeds: Array) -> float:
    return float(speeds[len(speeds) // 2])


def _cap(bench: Bench, speed: float, turn: Array, tilts: int = 12) -> Array:
    """Return the cap of a speed over the azimuths `turn`, shape (tilts, azimuths, 3)."""
    tilt = np.linspace(0.0, bench.value("tilt_limit"), tilts)
    phi, alpha = np.meshgrid(tilt, turn, indexing="ij")
    return k.momentum_envelope(np.full(phi.shape, speed), phi, alpha, bench.value("rotor_inertia_z"))


def _box(axes: Any, wide: float, low: float, high: float, unit: str, *, heights: int = 4) -> None:
    axes.set_xlim(-wide, wide)
    axes.set_ylim(-wide, wide)
    axes.set_zlim(low, high)
    axes.set_box_aspect((1.0, 1.0, _BOX))
    axes.locator_params(nbins=4)
    axes.locator_params(axis="z", nbins=heights)
    axes.tick_params(labelsize=8.5, pad=0)
    axes.tick_params(axis="z", pad=3)
    axes.set_xlabel(f"$H_x$, {unit}", labelpad=2, parse_math=True)
    axes.set_ylabel(f"$H_y$, {unit}", labelpad=4, parse_math=True)
    axes.set_zlabel(f"$H_z$, {unit}", labelpad=6, parse_math=True)
    for pane in (axes.xaxis, axes.yaxis, axes.zaxis):
        pane.set_pane_color((0.97, 0.97, 0.97, 1.0))


def _revolution(axes: Axes, bench: Bench, speed: float, scale: float, unit: str) -> None:
    """Draw the size of the exact momentum over a revolution at some tilts."""
    limit = bench.value("tilt_limit")
    turn = np.linspace(0.0, 2.0 * np.pi, 145)
    shades = ("#9ECAE1", "#4292C6", "#08519C")
    for part, shade in zip((0.2, 0.6, 1.0), shades, strict=True):
        size = np.linalg.norm(k.held_momentum(speed, part * limit, 0.0, turn, rotor_inertias(bench)), axis=-1)
        axes.plot(
            turn / DEG, size / scale, color=shade, linewidth=1.8, label=f"exact, {part * limit / DEG:.2g}°"
        )
    level = bench.value("rotor_inertia_z") * speed / scale
    axes.axhline(level, color=_LAST, linewidth=1.6, linestyle="--", label="eq (1), last form")
    axes.set_xticks([0, 90, 180, 270, 360])
    axes.set_xlabel("angle of the shaft, deg")
    axes.set_ylabel(f"momentum, {unit}")
    axes.set_title(f"size in a turn, {speed / RPM:.0f} rpm")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.55 * (high - low))
    axes.legend(loc="upper center", ncols=2, fontsize=9, columnspacing=1.0, handlelength=1.4)
    add_grid(axes, "y")


def _error_panel(axes: Axes, bench: Bench, speed: float) -> None:
    """Draw the errors of both forms of eq (1) over the tilt."""
    tilt = np.linspace(0.02, 1.0, 50) * bench.value("tilt_limit")
    last, middle = largest_errors(tilt, speed, rotor_inertias(bench))
    forms = (("middle expression, I·θ'", middle, _MIDDLE), ("last form", last, _LAST))
    for name, values, colour in forms:
        axes.plot(tilt / DEG, 100.0 * values, color=colour, linewidth=1.8)
        axes.annotate(
            name,
            (tilt[30] / DEG, 100.0 * values[30]),
            xytext=(0, 9),
            textcoords="offset points",
            ha="center",
            color=colour,
        )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlim(0.0, bench.value("tilt_limit") / DEG)
    axes.set_ylim(1e-4, 300.0 * float(middle[-1]))
    axes.set_xlabel("tilt, deg")
    axes.set_ylabel("% of the momentum")
    axes.set_title("largest error of eq (1)")
    add_grid(axes)


def _paths(axes: Axes, bench: Bench, speed: float, scale: float, unit: str) -> None:
    """Draw the part across the axis over a revolution: in the motor frame a circle, in the case a point."""
    limit = bench.value("tilt_limit")
    turn = np.linspace(0.0, 2.0 * np.pi, 145)
    theta_x, theta_y = k.joint_of_azimuth(limit, -turn)
    motor = (
        k.spin_momentum(theta_x, theta_y, np.full(turn.shape, speed), bench.value("rotor_inertia_z")) / scale
    )
    case = k.held_momentum(speed, limit, 0.0, turn, rotor_inertias(bench)) / scale
    axes.plot(motor[:, 0], motor[:, 1], color=_LAST, linewidth=1.8, label="eq (1), motor axes")
    # dots, as a line may be shorter than a dot of the picture
    axes.plot(case[:, 0], case[:, 1], "o", color=_EXACT, markersize=5.0, label="exact, case axes")
    axes.plot(0.0, 0.0, "+", color=SOFT)
    size = float(np.abs(motor[:, :2]).max())
    axes.set_xlim(-1.25 * size, 1.25 * size)
    axes.set_ylim(-1.25 * size, 1.75 * size)
    axes.set_aspect("equal")
    axes.set_xlabel(f"$H_x$, {unit}", parse_math=True)
    axes.set_ylabel(f"$H_y$, {unit}", parse_math=True)
    axes.set_title(f"across the axis, tilt {limit / DEG:.0f}°")
    axes.legend(loc="upper center", fontsize=9, handlelength=1.4)
    add_grid(axes)
