"""Table 2, eqs (9) and (10), Figs 5 to 12: the computed flow and its torques."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrowheel.air_flow import picture as air_flow
from gyrowheel.paper_figures.evidence import REFERENCE, Evidence, Finding, Statements, Verdict
from gyrowheel.show.figure import finished, style
from gyrowheel_air.cfd.case import Result
from gyrowheel_air.correlations import disc_boundary
from gyrowheel_air.flow import Flow
from gyrowheel_air.surrogate import fit_table
from gyrowheel_air.torque import AirState, density_change, reynolds_number
from gyrowheel_core.quantities import decimal
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
_CLEAR = 2.0  # scatters beyond which a difference is one
_TAYLOR = 41.3  # Re_g sqrt(t/R) at the onset of Taylor vortices in a narrow gap (Taylor 1923)
_CONSTANT = 0.05  # what varies by less is almost constant
_INDEPENDENT = 0.05  # a result that varies by less over meshes does not depend on them

STATEMENTS = Statements()


def _drawn(draw: Callable[[], tuple[Figure, str] | None]) -> Callable[[], Figure]:
    def figure() -> Figure:
        with style():
            found = draw()
            assert found is not None
            return finished(found[0])

    return figure


@STATEMENTS("table-2", "Table 2", "Lengths of rotor and case, and the air at 20 °C.")
def _air(e: Evidence) -> Finding:
    usual = AirState.of(e.air.temperature, e.air.pressure)
    density, viscosity = e.air.density / usual.density - 1.0, e.air.viscosity / usual.viscosity - 1.0
    g = e.geometry
    # lowest point of the tilted rotor's corner against the case
    limit = e.bench.value("tilt_limit")
    reach = g.rotor_radius * math.cos(limit) + 0.5 * g.rotor_height * math.sin(limit)
    left = g.case_radius - reach
    return Finding(
        "agree" if max(abs(density), abs(viscosity)) < 0.01 and left > 0.0 else "disagree",
        f"The gas law and Sutherland's law give the density within {100.0 * abs(density):.2f} % and the viscosity "
        f"within {100.0 * abs(viscosity):.2f} %. At 5°, {1e3 * left:.2f} of {1e3 * g.rim_gap:.0f} mm are left in the "
        "rim gap.",
        "The numbers fit one another, and the rotor can tilt that far in that case.",
        {
            "density_relative_difference": density,
            "viscosity_relative_difference": viscosity,
            "gap_left_m": left,
        },
    )


@STATEMENTS("fig-5", "Fig. 5", "The flow is computed on a tetrahedral mesh of about two million cells.")
def _mesh(e: Evidence) -> Finding:
    flow = max(e.flows, key=lambda own: own.tilt)
    row = e.table.at(flow.tilt, flow.spin_rate)
    assert row is not None
    return Finding(
        "cannot be decided",
        f"{flow.cells} hexahedra in place of 1,987,570 tetrahedra; first cell at y⁺ = {row.y_plus['rotor'][0]:.2f} "
        "on average, so that the wall layer is resolved.",
        "A picture of a mesh states nothing that could be true or false. Ours resolves the layer that wall functions "
        "leave out, with fewer cells.",
        {"cells": float(flow.cells), "y_plus": float(row.y_plus["rotor"][0])},
        _drawn(lambda: air_flow.mesh_section(e.flows)),
    )


@STATEMENTS(
    "fig-6",
    "Fig. 6",
    "Three meshes, without tilt, show results that no longer depend on the mesh from 1.2 million cells on.",
)
def _independence(e: Evidence) -> Finding:
    upright = [r for r in e.table.rows if r.case.tilt == 0.0 and math.isclose(r.case.spin_rate, REFERENCE)]
    across = max(float(np.abs(r.torque.mean[:2]).max()) for r in upright)
    drag = {r.case.mesh: -float(r.torque.mean[2]) for r in upright if r.case.model == "paper"}
    spread = max(drag.values()) / min(drag.values()) - 1.0
    return Finding(
        "disagree" if spread > _INDEPENDENT else "agree",
        f"Without tilt the transverse torque is below {1e3 * across:.3f} mN·m on every mesh. The drag by k-ε with "
        f"wall functions is {1e3 * min(drag.values()):.2f} to {1e3 * max(drag.values()):.2f} mN·m on three meshes, "
        f"{100.0 * spread:.0f} % apart.",
        "Without tilt symmetry makes T_dy zero, so it shows nothing about a mesh. The drag does, and with wall "
        "functions it follows the thickness of the cells at the wall, not their number.",
        {"largest_transverse_n_m": across, "relative_spread_of_drag": spread},
        _drawn(lambda: air_flow.mesh_dependence(e.table)),
    )


@STATEMENTS("fig-7", "Fig. 7, eq (9)", "The Reynolds number is so large that the flow is turbulent.")
def _turbulent(e: Evidence) -> Finding:
    g, speeds = e.geometry, e.table.speeds
    re = [reynolds_number(e.air, g.rotor_radius, w) for w in speeds[[0, -1]]]
    onset = disc_boundary("II", "IV", g.end_gap / g.rotor_radius)
    slowest = e.correlation(float(speeds[0]))
    taylor = slowest.gap_reynolds * math.sqrt(g.rim_gap / g.rotor_radius)
    return Finding(
        "agree" if re[1] > onset else "disagree",
        f"Re = {re[0]:,.0f} to {re[1]:,.0f} at 1000 to 4000 rpm; the end faces turn turbulent at {onset:,.0f}. In "
        f"the rim gap the Taylor number is {taylor / _TAYLOR:.0f} times that of the first vortices, or more.",
        "A large Reynolds number alone does not make a flow turbulent. By Daily and Nece the layers on the end faces "
        "are laminar and separate; the rim gap is full of Taylor vortices.",
        {"reynolds_least": re[0], "reynolds_most": re[1], "transition": onset, "taylor_number": taylor},
        _drawn(lambda: air_flow.numbers(e.table)),
    )


@STATEMENTS("fig-7-density", "Fig. 7, eq (10)", "The air can be taken as incompressible.")
def _incompressible(e: Evidence) -> Finding:
    top = float(e.table.speeds[-1])
    change = density_change(e.air, e.geometry.rotor_radius, top)
    exact = math.expm1(change)  # solid-body rotation at one temperature: p = p0 exp(V²/2RT)
    return Finding(
        "agree" if exact < 0.05 else "disagree",
        f"The density changes by {100.0 * change:.2f} % at 4000 rpm; without the approximation of eq (10) by "
        f"{100.0 * exact:.3f} %.",
        "Eq (10) holds at one temperature, as the text says.",
        {"density_change": change, "density_change_exact": exact},
    )


def _series(e: Evidence, component: int, *, tilts: bool, at: float) -> tuple[Array, Array]:
    """Return magnitudes and scatters of a torque [N m] over the tilts at a speed, or over the speeds at a tilt."""
    places = [(t, at) for t in e.table.tilts] if tilts else [(at, w) for w in e.table.speeds]
    rows = [_row(e, *place) for place in places]
    return (
        np.array([abs(r.torque.mean[component]) for r in rows]),
        np.array([r.torque.scatter[component] for r in rows]),
    )


def _row(e: Evidence, tilt: float, rate: float) -> Result:
    row = e.table.at(tilt, rate)
    assert row is not None  # the table has a whole grid
    return row


@STATEMENTS("fig-8", "Fig. 8", "A tilt about one axis gives torques about both transverse axes.")
def _both(e: Evidence) -> Finding:
    tilted = [r for r in e.table.grid if r.case.tilt > 0.0]
    clear = sum(bool(np.all(np.abs(r.torque.mean[:2]) > _CLEAR * r.torque.scatter[:2])) for r in tilted)
    row = _row(e, 3.0 * DEG, REFERENCE).torque.mean
    return Finding(
        "agree" if clear == len(tilted) else "disagree",
        f"In {clear} of {len(tilted)} cases with a tilt both torques lie beyond twice their scatter; at 3° and 3500 "
        f"rpm T1 = {decimal(1e3 * row[0], 2)}, T2 = {decimal(1e3 * row[1], 2)} mN·m.",
        "T1 pushes the rotor back to the case axis; T2, a quarter turn ahead, drives the tilt round with the spin.",
        {"t1_n_m": float(row[0]), "t2_n_m": float(row[1])},
        _drawn(lambda: air_flow.by_tilt(e.table)),
    )


@STATEMENTS("fig-8-growth", "Fig. 8", "Both transverse torques grow with the tilt.")
def _grow(e: Evidence) -> Finding:
    falls, within_scatter = [], 0
    for component in (0, 1):
        for rate in e.table.speeds:
            size, scatter = _series(e, component, tilts=True, at=float(rate))
            for k in range(1, len(size) - 1):
                if size[k] <= size[k + 1]:
                    continue
                if size[k] - size[k + 1] > _CLEAR * math.hypot(scatter[k], scatter[k + 1]):
                    falls.append((component, k, float(rate), size[k], size[k + 1]))
                else:
                    within_scatter += 1
    one = sum(component == 0 for component, *_ in falls)
    listed = "; ".join(
        f"T{component + 1} from {e.table.tilts[k] / DEG:.0f} to {e.table.tilts[k + 1] / DEG:.0f}° at "
        f"{rate / RPM:.0f} rpm from {1e3 * first:.2f} to {1e3 * second:.2f} mN·m"
        for component, k, rate, first, second in falls
    )
    wandering = sum(not r.torque.steady for r in e.table.grid)
    return Finding(
        "disagree" if falls else "agree",
        f"Steps over which a torque falls by more than twice its scatter: {listed or 'none'}. By less: "
        f"{within_scatter}. {'T1 grows everywhere.' if not one else ''}".rstrip(),
        "The settled flow changes its state between 3 and 5°: fewer and larger vortices are left in the rim gap, "
        "with less T2. Before it has settled, T2 grows. A steady solution cannot say where a real rotor changes "
        f"over; {wandering} of {len(e.table.grid)} cases do not become steady.",
        {
            "falls_of_t1": float(one),
            "falls_of_t2": float(len(falls) - one),
            "unsteady_cases": float(wandering),
        },
        _drawn(lambda: air_flow.by_tilt(e.table)),
    )


@STATEMENTS("fig-8-drag", "Fig. 8", "The torque on the spin hardly changes with the tilt.")
def _constant(e: Evidence) -> Finding:
    ranges = []
    for rate in e.table.speeds:
        size, _ = _series(e, 2, tilts=True, at=float(rate))
        ranges.append(float(np.ptp(size) / size.mean()))
    wall = {
        r.case.tilt: -float(r.torque.mean[2])
        for r in e.table.rows
        if (r.case.mesh, r.case.model) == ("coarse", "paper")
    }
    their = abs(wall[max(wall)] / wall[0.0] - 1.0)
    low, high = 100.0 * min(ranges), 100.0 * max(ranges)
    return Finding(
        "agree" if max(ranges) < _CONSTANT else "disagree",
        f"T3 falls by {low:.0f} to {high:.0f} % of its mean up to 5°, at every speed. With k-ε and wall functions on "
        f"a coarse mesh, as in the paper, by {100.0 * their:.1f} %.",
        "Taylor vortices in the rim gap carry much of the drag, and the tilt sweeps them away. Wall functions bring "
        "an eddy viscosity that carries the drag with or without vortices.",
        {"least_fall": min(ranges), "largest_fall": max(ranges), "fall_with_wall_functions": their},
        _drawn(lambda: air_flow.by_tilt(e.table)),
    )


@STATEMENTS("fig-9", "Fig. 9", "At 5° all three torques grow with the speed, not linearly.")
def _speeds(e: Evidence) -> Finding:
    tilt = float(e.table.tilts[-1])
    grows = [bool(np.all(np.diff(_series(e, i, tilts=False, at=tilt)[0]) > 0.0)) for i in range(3)]
    laws = [law for law in fit_table(e.table).laws if law is not None]
    text = ", ".join(f"{law.exponent:.2f}" for law in laws)
    nonlinear = all(law.exponent - 1.0 > 3.0 * law.exponent_error for law in laws)
    return Finding(
        "agree" if all(grows) and nonlinear else "disagree",
        f"At 5° all three grow at every step; over the table with the powers {text} of the speed.",
        "T1 and T2 grow nearly as the square of the speed, as a pressure does; T3 as a laminar layer.",
        {f"exponent_t{i + 1}": law.exponent for i, law in enumerate(laws)},
        _drawn(lambda: air_flow.by_speed(e.table)),
    )


def _flows(e: Evidence) -> list[Flow]:
    """Return the flows without tilt, with the largest tilt, and with that at a lower speed."""
    places = ((0.0, 3500.0), (5.0 * DEG, 3500.0), (5.0 * DEG, 2000.0))
    return [
        next(f for f in e.flows if math.isclose(f.tilt, tilt) and math.isclose(f.spin_rate, rpm * RPM))
        for tilt, rpm in places
    ]


def _uneven(
    e: Evidence, measure: Callable[[Flow], tuple[float, float]], which: str, factor: float
) -> tuple[list[float], list[float], dict[str, float], Verdict, Callable[[], Figure]]:
    """Return size and asymmetry of a velocity in `_flows`, and values, verdict and picture of the finding.

    The flow is uneven if the tilt increases the asymmetry by more than `factor`.
    """
    sizes, apart = (list(column) for column in zip(*map(measure, _flows(e)), strict=True))
    values = {
        "asymmetry_5_deg": apart[1],
        "asymmetry_0_deg": apart[0],
        "rms_3500_rpm_m_s": sizes[1],
        "rms_2000_rpm_m_s": sizes[2],
    }
    verdict: Verdict = "agree" if apart[1] > factor * apart[0] and sizes[1] > sizes[2] else "disagree"
    return sizes, apart, values, verdict, _drawn(lambda: air_flow.section(e.flows, which))


@STATEMENTS(
    "fig-10",
    "Fig. 10",
    "A tilt shifts the pressure on the rotor's top; that makes the transverse torques. It grows with the speed.",
)
def _pressure(e: Evidence) -> Finding:
    still, tilted, slow = _flows(e)
    moved, level = (math.hypot(*flow.moment) for flow in (tilted, still))
    ratio = float(np.ptp(tilted.pressure) / np.ptp(slow.pressure))
    row = _row(e, 5.0 * DEG, REFERENCE).torque
    share = row.pressure[:2] / row.mean[:2]
    deflected = moved > 20.0 * level and ratio > 1.0
    return Finding(
        "agree" if deflected and share[0] > 0.5 else "disagree",
        f"On the rotor's top the pressure turns with {1e3 * moved:.2f} mN·m at 5°, without tilt with "
        f"{1e3 * level:.3f}. Pressure makes {100.0 * share[0]:.0f} % of T1 and {100.0 * share[1]:.0f} % of T2. From "
        f"2000 to 3500 rpm its range grows {ratio:.1f} times.",
        "The pressure is highest where the gap is narrow and upstream of it. Friction acts against T2, hence "
        "more than 100 %.",
        {
            "moment_of_top_n_m": moved,
            "share_of_t1": float(share[0]),
            "share_of_t2": float(share[1]),
            "range_ratio": ratio,
        },
        _drawn(lambda: air_flow.pressure(e.flows)),
    )


def _sides(flow: Flow) -> tuple[float, float]:
    """Return the rms of the axial velocity in the rim gap [m/s], and the difference of both sides over it."""
    middle, area = flow.section.mean(axis=1), _areas(flow.section)
    inside = np.abs(middle[:, 0]) > flow.case_radius - 4.5e-3
    size = math.sqrt(float(np.average(np.square(flow.axial[inside]), weights=area[inside])))
    sides = (inside & (middle[:, 0] > 0.0), inside & (middle[:, 0] < 0.0))
    right, left = (float(np.average(flow.axial[side], weights=area[side])) for side in sides)
    return size, abs(right - left) / size


def _halves(flow: Flow) -> tuple[float, float]:
    """Return the rms of the radial velocity [m/s], and the difference of both sides above the rotor over it."""
    middle, area = flow.section.mean(axis=1), _areas(flow.section)
    size = math.sqrt(float(np.average(np.square(flow.radial), weights=area)))
    upper = middle[:, 1] > 0.5 * flow.rotor_height
    means = []
    for side in (1.0, -1.0):
        here = upper & (side * middle[:, 0] > 0.0)
        means.append(float(np.average(np.square(flow.radial[here]), weights=area[here])))
    return size, abs(math.sqrt(means[0]) - math.sqrt(means[1])) / size


def _areas(quads: Array) -> Array:
    one, two = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    return np.asarray(0.5 * np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]))


@STATEMENTS("fig-11", "Fig. 11", "A tilt makes the axial flow uneven; it is weaker at a lower speed.")
def _axial(e: Evidence) -> Finding:
    sizes, apart, values, verdict, draw = _uneven(e, _sides, "axial", 10.0)
    return Finding(
        verdict,
        f"Up one rim gap and down the other: the means of both sides are {apart[1]:.2f} of the rms apart at 5°, "
        f"{apart[0]:.3f} without tilt. The rms in the gaps is {sizes[1]:.2f} m/s at 3500 rpm and {sizes[2]:.2f} "
        "at 2000.",
        "Without tilt a row of Taylor vortices fills the gap. What the figure does not say: the tilt sweeps them "
        "away, and with them a part of T3.",
        values,
        draw,
    )


@STATEMENTS("fig-12", "Fig. 12", "A tilt makes the radial flow uneven; it is weaker at a lower speed.")
def _radial(e: Evidence) -> Finding:
    sizes, apart, values, verdict, draw = _uneven(e, _halves, "radial", 3.0)
    return Finding(
        verdict,
        f"Above the rotor the rms of both sides is {100.0 * apart[1]:.0f} % apart at 5°, {100.0 * apart[0]:.1f} % "
        f"without tilt. The rms is {sizes[1]:.2f} m/s at 3500 rpm and {sizes[2]:.2f} at 2000.",
        "The faces of the rotor throw air out, and it comes back along the case.",
        values,
        draw,
    )


@STATEMENTS("drag-friction", "Section 3.2", "The torque on the spin comes mainly from friction.")
def _friction(e: Evidence) -> Finding:
    share = max(abs(r.torque.pressure[2] / r.torque.mean[2]) for r in e.table.grid)
    return Finding(
        "agree" if share < 0.01 else "disagree",
        f"The pressure has less than {max(0.01, 100.0 * float(share)):.2g} % of T3.",
        "On a body of revolution pressure cannot act about its axis.",
        {"largest_share_of_pressure": float(share)},
    )


@STATEMENTS("damping", "Section 5", "All torques of the air damp.")
def _damping(e: Evidence) -> Finding:
    tilted = [r.torque.mean for r in e.table.grid if r.case.tilt > 0.0]
    restoring = sum(mean[0] < 0.0 for mean in tilted)
    driving = sum(mean[1] > 0.0 for mean in tilted)
    braking = sum(r.torque.mean[2] < 0.0 for r in e.table.grid)
    return Finding(
        "disagree" if driving == len(tilted) else "agree",
        f"T3 brakes in {braking} of {len(e.table.grid)} cases. T1 turns the rotor back in {restoring} of "
        f"{len(tilted)}, and T2 acts ahead of the tilt in {driving} of {len(tilted)}.",
        "T3 damps. T1 is a spring, which takes no energy. T2 pushes the tilt round in the direction of the spin, and "
        "feeds a motion that turns this way. Nothing here says what a rate of the tilt adds.",
        {"cases": float(len(tilted)), "t2_ahead": float(driving)},
    )
