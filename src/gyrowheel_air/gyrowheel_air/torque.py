"""The air, and its torque on the rotor: one form for all models, on the rotor's axes and in the frame of the case."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrowheel_air.geometry import Geometry
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM

#: Specific gas constant of dry air [J/(kg K)] (ISO 2533).
GAS_CONSTANT = 287.05287
#: Ratio of the specific heats of air.
HEAT_RATIO = 1.4
#: Mach number up to which the density of the air may be taken as constant (it changes by 6 %).
MACH_LIMIT = 0.3
#: Sutherland's law for air (ISO 2533): mu = B T^1.5 / (T + S).
_SUTHERLAND_B, _SUTHERLAND_S = 1.458e-6, 110.4


@dataclass(frozen=True)
class AirState:
    """The air in the case."""

    temperature: float  # temperature [K]
    pressure: float  # absolute pressure [Pa]
    density: float  # density [kg/m^3]
    viscosity: float  # dynamic viscosity [Pa s]

    @classmethod
    def of(cls, temperature: float = 293.15, pressure: float = 101325.0) -> AirState:
        """Return dry air at a temperature [K] and a pressure [Pa]: ideal gas, Sutherland's viscosity.

        Raises
        ------
        InputError
            If one is out of the range in which both laws hold.
        """
        for name, value, low, high, unit in (
            ("temperature", temperature, 200.0, 400.0, "K"),
            ("pressure", pressure, 1e3, 3e5, "Pa"),
        ):
            if not low <= value <= high:
                raise InputError(
                    f"air {name}: {value:g} {unit} is out of range; allowed: {low:g} .. {high:g} {unit}"
                )
        return cls(
            temperature,
            pressure,
            density=pressure / (GAS_CONSTANT * temperature),
            viscosity=_SUTHERLAND_B * temperature**1.5 / (temperature + _SUTHERLAND_S),
        )

    @classmethod
    def paper(cls) -> AirState:
        """Return the air of the published ground test, with its rounded density and viscosity (Table 2)."""
        return cls(temperature=293.15, pressure=101325.0, density=1.205, viscosity=1.81e-5)

    def with_density(self, density: float) -> AirState:
        """Return the same air at another density [kg/m^3]: the pressure follows, the viscosity stays."""
        return AirState(self.temperature, self.pressure * density / self.density, density, self.viscosity)

    @property
    def speed_of_sound(self) -> float:
        """Speed of sound [m/s]."""
        return math.sqrt(HEAT_RATIO * GAS_CONSTANT * self.temperature)


def reynolds_number(air: AirState, radius: float, spin_rate: float) -> float:
    """Return Re = rho R^2 Omega / mu (eq 9).

    Parameters
    ----------
    air : AirState
        The air.
    radius : float
        Radius of the rotor [m].
    spin_rate : float
        Spin rate [rad/s].
    """
    return air.density * radius**2 * abs(spin_rate) / air.viscosity


def density_change(air: AirState, radius: float, spin_rate: float) -> float:
    """Return the relative change of the density d rho / rho = gamma/2 M^2 at the rotor's rim (eq 10).

    Parameters and units as for `reynolds_number`.
    """
    mach = radius * abs(spin_rate) / air.speed_of_sound
    return 0.5 * HEAT_RATIO * mach**2


Array = NDArray[np.float64]


@dataclass(frozen=True)
class AirTorque:
    """Torque of the air on a rotor whose tilt is held.

    Three components on the axes of `tilt_axes`: about the axis of the tilt (negative: back towards the case axis), a
    quarter turn ahead of it round the rotor's axis, and about the rotor's axis (negative: brakes the spin). A component
    that a model does not give is NaN.
    """

    #: The components and their standard uncertainties [N m].
    components: Array
    uncertainty: Array
    axes: Array  # the axes, one a row, in the frame of the case

    @property
    def case(self) -> Array:
        """The torque in the frame of the case [N m], shape (3,); NaN where a component is missing."""
        return np.asarray(self.axes.T @ self.components)

    @property
    def case_uncertainty(self) -> Array:
        """Standard uncertainty of `case` [N m], the components taken as independent."""
        return np.sqrt(np.square(self.axes.T) @ np.square(self.uncertainty))


@runtime_checkable
class AirModel(Protocol):
    """Interface of the models of the air."""

    @property
    def name(self) -> str:
        """Name by which users ask for it."""

    def torque(self, geometry: Geometry, air: AirState, tilt: ArrayLike, spin_rate: float) -> AirTorque:
        """Return the torque of the air.

        `geometry`: rotor and case; `air`: the air in the case; `tilt` (2,): tilt of the rotor as read by the
        sensors: phi_x, phi_y [rad]; `spin_rate`: spin rate [rad/s], above zero. Raises InputError if the
        model does not hold there.
        """


def tilt_axes(tilt: float, direction: float = 0.0) -> Array:
    """Return the axis of a tilt, the direction a quarter turn ahead of it round the rotor's axis, and that axis.

    Parameters
    ----------
    tilt : float
        Angle of the tilt [rad].
    direction : float
        Angle of its axis from the case's x axis [rad].

    Returns
    -------
    (3, 3) array
        Unit vectors in the frame of the case, one a row.
    """
    first = np.array([math.cos(direction), math.sin(direction), 0.0])
    flat = np.array([-math.sin(direction), math.cos(direction), 0.0])
    rotor = math.cos(tilt) * np.array([0.0, 0.0, 1.0]) - math.sin(tilt) * flat
    return np.array([first, np.cross(rotor, first), rotor])


def split_tilt(tilt: ArrayLike) -> tuple[float, float]:
    """Return the angle of a tilt and the direction of its axis [rad] from phi_x and phi_y [rad].

    ``tan phi = |z|`` and the direction is ``arg z`` with ``z = tan phi_x + i tan phi_y``. Raises InputError
    if it is not two finite angles below a right angle.
    """
    values = np.asarray(tilt, dtype=float)
    if values.shape != (2,) or not np.all(np.abs(values) < 0.5 * math.pi):
        raise InputError(f"tilt: {tilt!r} is not two angles phi_x, phi_y below 90 deg")
    z = complex(math.tan(values[0]), math.tan(values[1]))
    return math.atan(abs(z)), math.atan2(z.imag, z.real)


def check_range(
    tilt: float, spin_rate: float, tilt_limit: float, speeds: tuple[float, float], source: str
) -> None:
    """Refuse a tilt [rad] or a spin rate [rad/s] outside the range of a table or a fit, named by `source`.

    The error has the value and the allowed range.
    """
    if tilt > tilt_limit * (1.0 + 1e-9):
        raise InputError(
            f"tilt: {tilt / DEG:.4g} deg is out of the range of the {source}; allowed: 0 .. {tilt_limit / DEG:.4g} deg"
        )
    low, high = speeds
    if not low * (1.0 - 1e-9) <= spin_rate <= high * (1.0 + 1e-9):
        raise InputError(
            f"speed: {spin_rate / RPM:.6g} rpm is out of the range of the {source}; "
            f"allowed: {low / RPM:.6g} .. {high / RPM:.6g} rpm"
        )


def check_speed(spin_rate: float) -> None:
    """Refuse a spin rate that is not above zero."""
    if not (math.isfinite(spin_rate) and spin_rate > 0.0):
        raise InputError(f"spin rate: {spin_rate:g} rad/s is out of range; allowed: > 0")
