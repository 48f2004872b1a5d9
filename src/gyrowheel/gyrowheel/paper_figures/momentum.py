"""Table 1, eqs (1) and (2), Figs 3 and 4: the angular momentum."""

from __future__ import annotations

import numpy as np

from gyrowheel.paper_figures.evidence import Evidence, Finding, Statements, within
from gyrowheel_core.quantities import fixed, short
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.mechanics.kinematics import joint_of_azimuth, tilt_of_joint
from gyrowheel_sim.mechanics.momentum import revolution

_SPHERE = 1e-3  # a mean momentum this near to the sphere, relative, lies on it
_SMALL = 0.01  # an approximation this near is one

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
        # a tilt that stands in the case turns backwards in the motor frame
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
