"""Table 1, eqs (1) to (8), Figs 3 and 4 and the appendices: momentum, and equations against their derivation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from gyrowheel.paper_figures.evidence import (
    REFERENCE,
    SPEEDS,
    TILT,
    Evidence,
    Finding,
    Statements,
    Verdict,
    part,
    within,
)
from gyrowheel.show.figure import BLUE, VERMILION, Curve, Panel, curves_figure
from gyrowheel_core.quantities import fixed, short
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.mechanics import derivation as d
from gyrowheel_sim.mechanics import kinematics as k
from gyrowheel_sim.mechanics.dynamics import generalised_forces, inertia_terms
from gyrowheel_sim.mechanics.kinematics import joint_of_azimuth, revolution, tilt_of_joint

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
_SPHERE = 1e-3  # a mean momentum this near to the sphere, relative, lies on it
_SMALL = 0.01  # an approximation this near is one
_ROUNDING = 1e-10  # relative: two expressions that differ by less are one
_LATITUDE = 40.0 * DEG
_EARTH = 7.292e-5  # rad/s, of the Earth in inertial space (IERS conventions)
_NOTHING = 0.01  # a torque below this share of the air's could be left out

STATEMENTS = Statements()


@STATEMENTS("table-1", "Table 1", "Moments of inertia, tilt and spin range of the rotor.")
def _rotor(e: Evidence) -> Finding:
    x, y, z = (e.bench.value(f"rotor_inertia_{axis}") for axis in "xyz")
    possible = z < x + y
    return Finding(
        "agree" if possible else "disagree",
        f"Irz = {1e6 * z:.0f} mg·m², below Irx + Iry = {1e6 * (x + y):.0f}; a ratio Irz/Irx of {z / x:.3f}.",
        "A body can have these moments of inertia, and the bench has them. Stiffness, gimbal, shaft, coils and motor "
        "are not given; the bench assumes them and says so.",
        {"rotor_inertia_x_kg_m2": x, "rotor_inertia_z_kg_m2": z},
    )


@STATEMENTS(
    "eq-1-middle",
    "Eq (1), middle",
    "The rotor's momentum is its inertia times the rates of the three joint angles.",
)
def _middle(e: Evidence) -> Finding:
    d = e.momentum
    errors = {round(tilt / DEG): float(error) for tilt, error in zip(d.tilt, d.error_middle, strict=True)}
    text = " / ".join(f"{100.0 * errors[k]:.1f}" for k in (1, 3, 5))
    return Finding(
        "disagree" if errors[5] > _SMALL else "agree",
        f"The middle expression is wrong by {text} % of the momentum at 1 / 3 / 5°.",
        "It multiplies the inertias with the rates of the joint angles; the momentum is that with the rotor's "
        "angular velocity, eq (5). The error is Irx/Irz tan φ.",
        {f"error_at_{k}_deg": errors[k] for k in (1, 3, 5)},
        lambda: e.momentum.plot("caps"),
    )


@STATEMENTS(
    "eq-1-last",
    "Eq (1), last form",
    "As the spin is much faster than the flexures' rates, the momentum is Irz times the spin rate, along the rotor.",
)
def _last(e: Evidence) -> Finding:
    d = e.momentum
    errors = {round(tilt / DEG): float(error) for tilt, error in zip(d.tilt, d.error_last, strict=True)}
    text = " / ".join(short(100.0 * errors[k], 2) for k in (1, 3, 5))
    return Finding(
        "agree" if errors[5] < _SMALL else "disagree",
        f"The last form is within {text} % at every instant at 1 / 3 / 5°, and exact on average.",
        "It is an approximation because a universal joint passes on a constant speed unevenly. It holds in axes that "
        "turn with the shaft, which the text does not say: as printed, the part across runs round a circle.",
        {f"error_at_{k}_deg": errors[k] for k in (1, 3, 5)},
    )


@STATEMENTS("eq-2", "Eq (2)", "A tilt φ in direction β gives the two joint angles.")
def _joint(e: Evidence) -> Finding:
    limit = e.bench.value("tilt_limit")
    worst = 0.0
    for tilt in np.linspace(0.2, 1.0, 5) * limit:
        turn = revolution()
        # a tilt that is fixed in the case turns backwards in the motor frame
        phi_x, phi_y = tilt_of_joint(*joint_of_azimuth(tilt, 0.3 - turn), turn)
        found = np.tan(phi_x) + 1j * np.tan(phi_y)
        worst = max(worst, float(np.abs(found / (np.tan(tilt) * np.exp(0.3j)) - 1.0).max()))
    return Finding(
        "agree" if worst < 1e-12 else "disagree",
        f"Joint angles by eq (2), with β turning backwards at the spin rate, give the tilt back within {worst:.0e}.",
        "Eq (2) is exact. The text leaves open that β turns backwards while a tilt stands still in the case.",
        {"largest_relative_error": worst},
    )


@STATEMENTS(
    "fig-3",
    "Fig. 3",
    "At a constant speed, the momenta of all tilts form part of a sphere whose radius the speed sets.",
)
def _caps(e: Evidence) -> Finding:
    d, inertia = e.momentum, e.bench.value("rotor_inertia_z")
    radius = inertia * d.speed
    size = np.linalg.norm(d.exact_mean, axis=-1)
    off = float(np.abs(size / radius[:, None, None] - 1.0).max())
    ripple = float((np.abs(np.stack([d.smallest, d.largest]) / radius[:, None, None] - 1.0)).max())
    text = " / ".join(fixed(float(value), 4) for value in radius)
    speeds = " / ".join(f"{value / RPM:.0f}" for value in d.speed)
    return Finding(
        "agree" if off < _SPHERE else "disagree",
        f"Radii of {text} N·m·s at {speeds} rpm; the mean momentum lies on the sphere {within(off)}.",
        f"Within a revolution its size ripples by up to {100.0 * ripple:.2g} %, along the rotor's axis.",
        {"largest_distance_from_sphere": off, "largest_ripple": ripple},
        lambda: e.momentum.plot("caps"),
    )


@STATEMENTS("fig-4", "Fig. 4", "All momenta fill a solid between two spherical surfaces of different radii.")
def _body(e: Evidence) -> Finding:
    low, high = e.momentum.along
    across, d = e.momentum.across, e.momentum
    # the two ends are caps of different radius if momentum grows with speed at every tilt
    nested = bool(np.all(np.diff(np.linalg.norm(d.exact_mean, axis=-1), axis=0) > 0.0))
    return Finding(
        "agree" if nested else "disagree",
        f"From {fixed(low, 4)} to {fixed(high, 4)} N·m·s along the case axis, up to {fixed(across, 3)} across it.",
        "Tilts up to 5° and 3000 to 4000 rpm. The exact momentum fills the same body, with a ripple at the rim.",
        {"along_least_n_m_s": low, "along_most_n_m_s": high, "across_most_n_m_s": across},
        lambda: e.momentum.plot("body"),
    )


def _points() -> Array:
    """Return joint angles and rates, (n, 6) [rad, rad/s], at which expressions are compared."""
    rng = np.random.default_rng(1)
    return rng.uniform(-1.0, 1.0, (20, 6)) * [0.09, 0.09, 3.0, 300.0, 300.0, 400.0]


def _numeric(expression: Any, *arguments: Any) -> Any:
    return sp.lambdify([*d.ANGLES, *d.RATES, *arguments], expression, cse=True)


def _same(worst: float) -> Verdict:
    return "agree" if worst < _ROUNDING else "disagree"


@STATEMENTS("eq-3-5", "Eqs (3) to (5)", "The angular velocities of shaft, gimbal and rotor.")
def _rates(e: Evidence) -> Finding:
    derived = d.derive(body_rate=True)
    rate = _numeric(derived.rotor_rate, *d.BODY_RATE)
    body, worst = (0.3, -0.2, 0.5), 0.0
    for point in _points():
        x, y, z, x_rate, y_rate, z_rate = point
        own = k.rotor_rate(x, y, z, x_rate, y_rate, z_rate, body)
        worst = max(worst, float(np.abs(rate(*point, *body).ravel() - own).max() / np.abs(own).max()))
    return Finding(
        _same(worst),
        f"Eq (5), and with it (3) and (4), equals the derived angular velocity {within(worst)}.",
        "Also for a case that turns.",
        {"largest_relative_error": worst},
    )


@STATEMENTS(
    "axes-order",
    "Section 2.1.1",
    "A sentence assigns the angles θx, θy, θz to the axes z of the motor, x and y of the gimbal, in this order.",
)
def _order(e: Evidence) -> Finding:
    rates = np.eye(3) * 100.0
    # at no tilt: the axis about which each rate turns the rotor
    axes = ["xyz"[int(np.argmax(np.abs(k.rotor_rate(0.0, 0.0, 0.0, *row))))] for row in rates]
    sentence = ["z", "x", "y"]
    return Finding(
        "agree" if axes == sentence else "disagree",
        f"By eqs (3) to (5) the three angles turn about {', '.join(axes)}.",
        "The sentence has another order than the equations next to it. Read as the sentence says, θx would be the "
        "spin and the tilt of eq (7) would not follow it.",
    )


@STATEMENTS("eq-6", "Eq (6), Apps A, B", "Mass matrix and nonlinear terms of the equations of motion.")
def _masses(e: Evidence) -> Finding:
    derived = d.derive(body_rate=False)
    inertias = [e.bench.value(f"{body}_inertia_{axis}") for body in ("rotor", "gimbal") for axis in "xyz"]
    inertias.append(e.bench.value("shaft_inertia"))
    symbols = (*d.ROTOR_INERTIA, *d.GIMBAL_INERTIA, d.SHAFT_INERTIA)
    mass, velocity = _numeric(derived.mass, *symbols), _numeric(derived.velocity, *symbols)
    worst = 0.0
    for point in _points():
        x, y = point[:2]
        m11, m13, m22, m23, m33, *forces = inertia_terms(
            math.sin(x), math.cos(x), math.sin(y), math.cos(y), *point[3:], *inertias
        )
        own = np.array([[m11, 0.0, m13], [0.0, m22, m23], [m13, m23, m33]])
        for ours, theirs in (
            (own, mass(*point, *inertias)),
            (np.array(forces), velocity(*point, *inertias).ravel()),
        ):
            worst = max(worst, float(np.abs(ours - theirs).max() / np.abs(theirs).max()))
    return Finding(
        _same(worst),
        f"Mass matrix and velocity terms equal the derivation {within(worst)}.",
        "All terms of eq (6) and of both appendices are right; one inertia has a misprinted index in the text.",
        {"largest_relative_error": worst},
    )


@STATEMENTS("app-a-potential", "App. A", "The flexures' potential energy is K θ² of each.")
def _half(e: Evidence) -> Finding:
    derived = d.derive(body_rate=False)
    x, y, _ = d.ANGLES
    printed = d.STIFFNESS[0] * x**2 + d.STIFFNESS[1] * y**2
    factor = float(sp.simplify(printed.diff(x) / derived.potential.diff(x)))
    bench = e.bench
    tuned = math.sqrt(2.0 * bench.flexure_stiffness / bench.tuning_inertia)
    found = e.parts_by_speed
    spring, air = part(found, "flexure_stiffness").real, part(found, "aero_restoring").real
    bare = found.coil.real - air
    wrong = bare + (factor - 1.0) * spring

    def draw() -> Figure:
        rpm = [rate / RPM for rate in SPEEDS]
        curves = [
            Curve("stiffness of eq (6)", rpm, 1e3 * bare, BLUE, marker="o"),
            Curve("stiffness that V as printed gives", rpm, 1e3 * wrong, VERMILION, marker="s"),
        ]
        return curves_figure(
            "Torque of the coils at 3°, without air",
            "along the tilt, on the bench as stated; zero where the flexures are tuned",
            [Panel("", "spin rate, rpm", "torque, mN·m", curves)],
        )

    return Finding(
        "agree" if factor == 1.0 else "disagree",
        f"Stiffness {factor:g} times as large; tuned at {math.sqrt(factor) * tuned / RPM:.0f} instead of "
        f"{tuned / RPM:.0f} rpm (times {math.sqrt(factor):.4f}); 3° at 1000 rpm takes {1e3 * wrong[0]:.2f} instead "
        f"of {1e3 * bare[0]:.2f} mN·m.",
        "A spring stores half of K θ². Eq (6) itself has the right stiffness; only with the half does it follow from "
        "the energies, and only then is energy conserved.",
        {
            "stiffness_factor": factor,
            "tuned_speed_rad_s": tuned,
            "tuned_speed_as_printed_rad_s": math.sqrt(factor) * tuned,
            "holding_torque_n_m": float(bare[0]),
            "holding_torque_as_printed_n_m": float(wrong[0]),
        },
        draw,
    )


def _printed_map() -> sp.Matrix:
    """Return the map of the disturbance as eq (6) prints it, from torque components to generalised forces."""
    x, y, _ = d.ANGLES
    sx, cx, sy, cy = sp.sin(x), sp.cos(x), sp.sin(y), sp.cos(y)
    return sp.Matrix([[cy, 0, sy], [0, 1, 0], [-cx * sy, -sx, cx * cy]])


def _turning(tilt: float) -> tuple[Array, Array, Array, Array]:
    """Return shaft angles over a revolution, the flexure angles of a tilt about x, and the case-to-rotor matrices."""
    angle = np.arange(360, dtype=np.float64) * DEG
    theta_x, theta_y = k.joint_of_azimuth(tilt, -angle)
    to_rotor = k.gimbal_to_rotor(theta_y) @ k.motor_to_gimbal(theta_x) @ k.case_to_motor(angle)
    return angle, theta_x, theta_y, to_rotor


def _air_torque(e: Evidence) -> tuple[float, float]:
    """Return size of the computed transverse torques at the experiment's tilt and reference speed [N m]."""
    row = e.table.at(TILT, REFERENCE)
    assert row is not None
    return float(-row.torque.mean[0]), float(row.torque.mean[1])


@STATEMENTS("eq-6-sign", "Eq (6), App. A", "A matrix maps the air's torque to the generalised forces.")
def _sign(e: Evidence) -> Finding:
    derived = d.derive(body_rate=False).rotor_torque
    ours, theirs = _numeric(derived), _numeric(_printed_map())
    off = np.max([np.abs(ours(*point) - theirs(*point)) for point in _points()], axis=0)
    wrong = [(row + 1, column + 1) for row, column in np.argwhere(off > _ROUNDING)]
    along, across = _air_torque(e)
    angle, theta_x, _, to_rotor = _turning(TILT)
    z = math.tan(TILT)

    def false(torque: complex) -> Array:
        """Return the error of the torque on the shaft by the wrong sign, over a revolution [N m]."""
        case = np.array([torque.real, torque.imag, z * torque.imag])  # across the rotor's axis
        return np.asarray(-2.0 * np.sin(theta_x) * (to_rotor @ case)[:, 1])

    lost = abs(float(false(1j * across).mean()))
    ripple = 2.0 * abs(complex((false(along + 0j) * np.exp(-2j * angle)).mean()))
    return Finding(
        "disagree" if wrong else "agree",
        f"{9 - len(wrong)} of 9 elements are those of virtual work; wrong: "
        f"{', '.join(f'row {r}, column {c}' for r, c in wrong)}. At 3° and 3500 rpm {1e3 * lost:.3f} mN·m are lost "
        f"on the shaft, and a false ripple of {1e3 * ripple:.3f} mN·m twice a revolution appears.",
        "The third row must have +sin θx: only then is the power of the air's torque that of the generalised forces.",
        {"lost_on_shaft_n_m": lost, "false_ripple_n_m": ripple, "wrong_elements": float(len(wrong))},
    )


@STATEMENTS("eq-6-frame", "Eq (6), App. A", "That matrix is meant for the torques of Figs 8 and 9.")
def _frame(e: Evidence) -> Finding:
    along, _ = _air_torque(e)
    angle, theta_x, theta_y, _ = _turning(TILT)
    # the first column of the printed map, and back to case axes by the inverse of eq (8)
    spinning = np.exp(1j * angle) * along * np.cos(theta_y)
    fixed = generalised_forces(
        np.sin(theta_x), np.cos(theta_x), np.sin(angle), np.cos(angle), along, 0.0, 0.0
    )
    still = np.exp(1j * angle) * (fixed[0] + 1j * fixed[1] / np.cos(theta_x))
    share = abs(complex(spinning.mean())) / abs(complex(still.mean()))

    def draw() -> Figure:
        degrees = angle / DEG
        curves = [
            Curve("as printed: about x", degrees, 1e3 * spinning.real, VERMILION),
            Curve("as printed: about y", degrees, 1e3 * spinning.imag, VERMILION, line="--"),
            Curve("case axes: about x", degrees, 1e3 * still.real, BLUE),
            Curve("case axes: about y", degrees, 1e3 * still.imag, BLUE, line="--"),
        ]
        return curves_figure(
            "A constant air torque, as it arrives in the case",
            "3° and 3500 rpm: as printed it turns with the rotor and averages to nothing",
            [Panel("", "angle of the shaft, deg", "torque, mN·m", curves)],
        )

    return Finding(
        "disagree" if share < 0.5 else "agree",
        f"Of a constant {1e3 * along:.2f} mN·m, {100.0 * share:.2g} % are left in the average over a revolution.",
        "The printed map takes components along the spinning rotor's axes. The air's torque stands still in the "
        "case: put in as printed, it becomes a torque once a revolution, and the averaged voltages would show none "
        "of it.",
        {"air_torque_n_m": along, "share_left_in_average": share},
        draw,
    )


@STATEMENTS("eq-7", "Eq (7)", "The measured tilts follow from the joint angles.")
def _tilts(e: Evidence) -> Finding:
    worst = 0.0
    for point in _points():
        x, y, z = point[:3]
        sx, cx, sy, cy, sz, cz = math.sin(x), math.cos(x), math.sin(y), math.cos(y), math.sin(z), math.cos(z)
        printed = np.array([sx * cy * cz - sy * sz, sx * cy * sz + sy * cz]) / (cx * cy)
        worst = max(worst, float(np.abs(np.tan(k.tilt_of_joint(x, y, z)) - printed).max()))
    return Finding(
        _same(worst),
        f"Eq (7) equals the derived tilt {within(worst)}.",
        "It is exact.",
        {"largest_error": worst},
    )


@STATEMENTS("eq-8", "Eq (8)", "A matrix maps the coils' torques to the generalised forces.")
def _coils(e: Evidence) -> Finding:
    derived = _numeric(d.derive(body_rate=False).case_torque)
    worst = left_out = 0.0
    for point in _points():
        x, _, z = point[:3]
        printed = np.array(
            [[math.cos(z), math.sin(z)], [-math.sin(z) * math.cos(x), math.cos(z) * math.cos(x)]]
        )
        exact = derived(*point)
        worst = max(worst, float(np.abs(exact[:2, :2] - printed).max()))
        left_out = max(left_out, float(abs(exact[1, 2])))
    return Finding(
        _same(worst),
        f"Eq (8) equals virtual work {within(worst)}.",
        f"For torques across the case axis. A torque along it, as the air's has, adds up to {left_out:.2f} of itself "
        "to the second force, and the eq leaves that out.",
        {"largest_error": worst},
    )


@STATEMENTS("earth-rate", "Section 2.2", "On the ground the case does not turn: its rate is zero.")
def _earth(e: Evidence) -> Finding:
    rate = _EARTH * math.cos(_LATITUDE)
    needed = e.bench.value("rotor_inertia_z") * REFERENCE * rate
    along, across = _air_torque(e)
    return Finding(
        "disagree" if needed > _NOTHING * across else "agree",
        f"At {_LATITUDE / DEG:.0f}° of latitude and 3500 rpm the Earth's rate takes {1e3 * needed:.3f} mN·m.",
        f"That is {short(100.0 * needed / along, 2)} % of the air torque along the tilt at 3°, and "
        f"{short(100.0 * needed / across, 2)} % of that across. Turning the rig about the vertical shows it.",
        {
            "earth_torque_n_m": needed,
            "share_of_air_along": needed / along,
            "share_of_air_across": needed / across,
        },
    )
