"""The two models that need no flow computation: correlations alone, and with an end-gap vorticity model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gyrowheel_air.correlations import drag
from gyrowheel_air.geometry import Geometry
from gyrowheel_air.state import AirState
from gyrowheel_air.torque import AirTorque, check_speed, split_tilt, tilt_axes

NAN = float("nan")


@dataclass(frozen=True)
class Correlation:
    """Drag on the spin by published correlations; they say nothing of the transverse torques.

    Attributes
    ----------
    cylinder : str
        Correlation of the rim, see `gyrowheel_air.correlations`.
    regime : str, optional
        Regime of the end faces; by default the one in which they are.
    """

    cylinder: str = "bilgen_boulos"
    regime: str | None = None

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

    Attributes
    ----------
    swirl, swirl_uncertainty : float
        Core swirl ratio K, and its standard uncertainty: 0.29 .. 0.38 in the flow computations of the shipped rotor.
    model_uncertainty : float
        Relative standard uncertainty of the formula itself: it lies within 8 .. 17 % of those computations.
    cylinder : str
        Correlation of the rim.
    """

    swirl: float = 0.335
    swirl_uncertainty: float = 0.026
    model_uncertainty: float = 0.15
    cylinder: str = "bilgen_boulos"

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
