"""The state of the air: density and viscosity from temperature and pressure; Reynolds and Mach numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrowheel_core.errors import InputError

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
