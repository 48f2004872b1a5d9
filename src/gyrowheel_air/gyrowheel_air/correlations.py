"""Air torque without flow computation: published drag correlations of discs and cylinders, end-gap vorticity.

A rotor is decomposed into two end faces (a disc in a closed case, Daily & Nece 1960) and a rim (a cylinder in a
cylinder, Bilgen & Boulos 1973; alternatives: Wendt 1933, Vrancik 1968). None of the experiments contains the gap
between them.

References
----------
- Daily, J. W.; Nece, R. E. Chamber dimension effects on induced flow and frictional resistance of enclosed rotating
  disks. J. Basic Eng. 1960, 82, 217-230.
- Bilgen, E.; Boulos, R. Functional dependence of torque coefficient of coaxial cylinders on gap width and Reynolds
  numbers. J. Fluids Eng. 1973, 95, 122-126.
- Wendt, F. Turbulente Stroemungen zwischen zwei rotierenden konaxialen Zylindern. Ing.-Arch. 1933, 4, 577-595.
- Vrancik, J. E. Prediction of windage power loss in alternators. NASA TN D-4849, 1968.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from gyrowheel_air.geometry import Geometry
from gyrowheel_air.torque import AirState, AirTorque, check_speed, reynolds_number, split_tilt, tilt_axes
from gyrowheel_core.errors import InputError

CYLINDERS: Final = ("bilgen_boulos", "wendt", "vrancik")
REGIMES: Final = ("I", "II", "III", "IV")
#: Meaning of the regimes of a disc: wall layers merged or separate, laminar or turbulent.
REGIME_SENSE: Final[dict[str, str]] = {
    "I": "laminar, wall layers merged",
    "II": "laminar, wall layers separate",
    "III": "turbulent, wall layers merged",
    "IV": "turbulent, wall layers separate",
}
#: Scatter of the measurements about the correlations, as their authors' figures show it (1 sigma, relative).
DISC_SCATTER: Final = 0.05
CYLINDER_SCATTER: Final = 0.06


@dataclass(frozen=True)
class Drag:
    """Drag of the spinning rotor without tilt, by its parts."""

    #: Torque that brakes both end faces, and the rim [N m], above zero.
    discs: float
    cylinder: float
    #: Standard uncertainty of each [N m]: scatter of the measurements, and the spread of the alternatives.
    disc_uncertainty: float
    cylinder_uncertainty: float
    regime: str  # regime of the discs, of `REGIMES`
    #: Re of the disc (rho Omega R^2/mu) and of the rim gap (rho Omega R t/mu).
    reynolds: float
    gap_reynolds: float

    @property
    def total(self) -> float:
        """Torque that brakes the rotor [N m]."""
        return self.discs + self.cylinder

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of `total` [N m]."""
        return math.hypot(self.disc_uncertainty, self.cylinder_uncertainty)


def disc_coefficient(regime: str, reynolds: float, gap_ratio: float) -> float:
    """Return Cm = T / (rho Omega^2 a^5 / 2) of both faces of a disc in one regime (Daily & Nece).

    `regime`: ``"I"`` .. ``"IV"``. `reynolds`: rho Omega a^2/mu; `gap_ratio`: gap between disc and case over
    the disc's radius, s/a.
    """
    if regime == "I":
        return 2.0 * math.pi / (gap_ratio * reynolds)
    if regime == "II":
        return 3.70 * gap_ratio**0.1 * reynolds**-0.5
    if regime == "III":
        return 0.080 * gap_ratio ** (-1.0 / 6.0) * reynolds**-0.25
    if regime == "IV":
        return 0.102 * gap_ratio**0.1 * reynolds**-0.2
    raise InputError(f"disc regime: {regime!r} is not known; allowed: {', '.join(REGIMES)}")


def disc_boundary(first: str, second: str, gap_ratio: float) -> float:
    """Return the Reynolds number at which two regimes of a disc give the same torque.

    That is where one ends and the other begins: each curve is the larger one on its side.
    """
    from scipy.optimize import brentq  # takes long to load

    def difference(log_re: float) -> float:
        re = math.exp(log_re)
        return math.log(disc_coefficient(first, re, gap_ratio) / disc_coefficient(second, re, gap_ratio))

    return math.exp(brentq(difference, math.log(1e-3), math.log(1e12), xtol=1e-13, rtol=1e-14))


def disc_regime(reynolds: float, gap_ratio: float) -> str:
    """Return the regime of a disc: laminar before turbulent, merged wall layers before separate ones.

    Laminar flow ends where the first turbulent curve crosses the laminar one; within each, the merged form holds below
    the crossing of its two curves.
    """
    laminar = "I" if reynolds < disc_boundary("I", "II", gap_ratio) else "II"
    turbulent = "III" if reynolds < disc_boundary("III", "IV", gap_ratio) else "IV"
    both = [disc_coefficient(regime, reynolds, gap_ratio) for regime in (laminar, turbulent)]
    return laminar if both[0] >= both[1] else turbulent


def cylinder_coefficient(kind: str, gap_reynolds: float, gap_ratio: float) -> float:
    """Return C = T / (pi rho Omega^2 R^4 L / 2) of a cylinder in a cylinder.

    `kind`: of `CYLINDERS`; `gap_reynolds`: rho Omega R t/mu with the gap t; `gap_ratio`: gap over the inner
    radius, t/R.
    """
    if kind == "bilgen_boulos":
        for limit, factor, power in ((64.0, 10.0, -1.0), (500.0, 2.0, -0.6), (1e4, 1.03, -0.5)):
            if gap_reynolds < limit:
                return factor * gap_ratio**0.3 * gap_reynolds**power
        return 0.065 * gap_ratio**0.3 * gap_reynolds**-0.2
    if kind == "wendt":
        return _wendt(gap_reynolds, gap_ratio)
    if kind == "vrancik":
        from scipy.optimize import brentq

        # 1/sqrt(Cd) = 2.04 + 1.768 ln(Re_g sqrt(Cd)), and C = 2 Cd here; T = Cd pi rho Omega^2 R^4 L
        log_cd = brentq(
            lambda x: math.exp(-0.5 * x) - 2.04 - 1.768 * math.log(gap_reynolds * math.exp(0.5 * x)),
            -20.0,
            10.0,
        )
        return 2.0 * math.exp(log_cd)
    raise InputError(f"cylinder: {kind!r} is not known; allowed: {', '.join(CYLINDERS)}")


def _wendt(gap_reynolds: float, gap_ratio: float) -> float:
    """Wendt's torque of the inner cylinder, 400 < Re_g < 1e5, in the form of Lewis & Swinney (1999) and Dubrulle."""
    eta = 1.0 / (1.0 + gap_ratio)
    if gap_reynolds < 1e4:
        nu_form = 1.45 * eta**1.5 / (1.0 - eta) ** 1.75 * gap_reynolds**1.5
    else:
        nu_form = 0.23 * eta**1.5 / (1.0 - eta) ** 1.75 * gap_reynolds**1.7
    # G = T/(rho nu^2 L), and T = C pi rho Omega^2 R^4 L/2 with Omega R = Re_g nu/t
    return nu_form * 2.0 / math.pi * (gap_ratio / gap_reynolds) ** 2


def drag(
    geometry: Geometry,
    air: AirState,
    spin_rate: float,
    *,
    cylinder: str = "bilgen_boulos",
    regime: str | None = None,
) -> Drag:
    """Return the drag of the spinning rotor without tilt.

    Parameters
    ----------
    geometry : Geometry
        Rotor and case.
    air : AirState
        The air.
    spin_rate : float
        Spin rate [rad/s], not zero.
    cylinder : str
        Correlation of the rim, of `CYLINDERS`.
    regime : str, optional
        Regime of the end faces; by default the one in which they are.

    Raises
    ------
    InputError
        If a name is unknown or the spin rate is zero.
    """
    if not abs(spin_rate) > 0.0 or not math.isfinite(spin_rate):
        raise InputError(f"spin rate: {spin_rate:g} rad/s is out of range; allowed: not zero")
    re = reynolds_number(air, geometry.rotor_radius, spin_rate)
    radial, axial = geometry.rim_gap / geometry.rotor_radius, geometry.end_gap / geometry.rotor_radius
    re_gap = re * radial
    in_regime = disc_regime(re, axial) if regime is None else regime
    pressure = air.density * spin_rate**2
    disc_size = 0.5 * pressure * geometry.rotor_radius**5
    rim_size = 0.5 * math.pi * pressure * geometry.rotor_radius**4 * geometry.rotor_height
    discs = disc_size * disc_coefficient(in_regime, re, axial)
    rim = rim_size * cylinder_coefficient(cylinder, re_gap, radial)
    others = [rim_size * cylinder_coefficient(kind, re_gap, radial) for kind in CYLINDERS]
    return Drag(
        discs=discs,
        cylinder=rim,
        disc_uncertainty=DISC_SCATTER * discs,
        # half the range of three, taken as that of a uniform distribution
        cylinder_uncertainty=math.hypot(
            CYLINDER_SCATTER * rim, 0.5 * (max(others) - min(others)) / math.sqrt(3.0)
        ),
        regime=in_regime,
        reynolds=re,
        gap_reynolds=re_gap,
    )


NAN = float("nan")


@dataclass(frozen=True)
class Correlation:
    """Drag on the spin by published correlations, which give no transverse torques."""

    cylinder: str = "bilgen_boulos"  # correlation of the rim, see `gyrowheel_air.correlations`
    regime: str | None = None  # regime of the end faces; by default the one in which they are

    @property
    def name(self) -> str:
        """Name of the model."""
        return "correlation"

    def torque(self, geometry: Geometry, air: AirState, tilt: ArrayLike, spin_rate: float) -> AirTorque:
        """Return the torque of the air (see `AirModel.torque`); transverse components are NaN at a tilt."""
        check_speed(spin_rate)
        angle, direction = split_tilt(tilt)
        found = drag(geometry, air, spin_rate, cylinder=self.cylinder, regime=self.regime)
        across = 0.0 if angle == 0.0 else NAN  # zero by symmetry
        return AirTorque(
            np.array([across, across, -found.total]),
            np.array([across, across, found.uncertainty]),
            tilt_axes(angle, direction),
        )


@dataclass(frozen=True)
class Vorticity:
    """The restoring torque by the vorticity of the core of each end gap; the drag by the correlations.

    Between the wall layers of an end gap the air turns as a solid body with the part K of the spin rate. Tilting the
    rotor makes the gap wedge-shaped: columns of air are stretched and squeezed once a turn, keep their vorticity over
    their height, and so a pressure builds up that is odd about the axis of the tilt. Its moment on both faces is
    T1 = -(3 pi/16) rho K^2 Omega^2 R^6/s phi with the end gap s. It has no losses, so it gives no torque across.
    """

    #: Core swirl ratio K, and its standard uncertainty: 0.29 .. 0.38 in the flow computations of the shipped
    #: rotor.
    swirl: float = 0.335
    swirl_uncertainty: float = 0.026
    #: Relative standard uncertainty of the formula itself: it lies within 8 .. 17 % of those computations.
    model_uncertainty: float = 0.15
    cylinder: str = "bilgen_boulos"  # correlation of the rim

    @property
    def name(self) -> str:
        """Name of the model."""
        return "vorticity"

    def stiffness(self, geometry: Geometry, air: AirState, spin_rate: float) -> float:
        """Return the restoring torque per tilt [N m/rad]; spin rate in rad/s."""
        pressure = air.density * (self.swirl * spin_rate) ** 2
        return 3.0 * math.pi / 16.0 * pressure * geometry.rotor_radius**6 / geometry.end_gap

    def torque(self, geometry: Geometry, air: AirState, tilt: ArrayLike, spin_rate: float) -> AirTorque:
        """Return the torque of the air (see `AirModel.torque`); the component across is NaN at a tilt."""
        check_speed(spin_rate)
        angle, direction = split_tilt(tilt)
        restoring = self.stiffness(geometry, air, spin_rate) * angle
        found = drag(geometry, air, spin_rate, cylinder=self.cylinder)
        lengths = geometry.lengths
        gap = 0.5 * math.hypot(lengths["case_height"].uncertainty, lengths["rotor_height"].uncertainty)
        relative = math.hypot(
            2.0 * self.swirl_uncertainty / self.swirl,
            self.model_uncertainty,
            gap / geometry.end_gap,
            6.0 * lengths["rotor_radius"].uncertainty / geometry.rotor_radius,
        )
        across = 0.0 if angle == 0.0 else NAN
        return AirTorque(
            np.array([-restoring, across, -found.total]),
            np.array([relative * restoring, across, found.uncertainty]),
            tilt_axes(angle, direction),
        )
