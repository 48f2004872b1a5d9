"""The quantities of the bench at an instant, as SymPy symbols: the variables of laws.

Complex tilt ``z = tan(phi_x) + i tan(phi_y)`` in case axes; a complex torque is ``T_x + i T_y`` in case axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp


@dataclass(frozen=True)
class Quantity:
    """A symbol with its unit and meaning."""

    symbol: sp.Symbol
    unit: str
    description: str


def _real(name: str, unit: str, description: str, *, positive: bool = False) -> Quantity:
    assumptions = {"positive": True} if positive else {"real": True}
    return Quantity(sp.Symbol(name, **assumptions), unit, description)


QUANTITIES: dict[str, Quantity] = {
    quantity.symbol.name: quantity
    for quantity in (
        Quantity(sp.Symbol("z", complex=True), "rad", "complex tilt tan(phi_x) + i tan(phi_y)"),
        Quantity(sp.Symbol("z_rate", complex=True), "rad/s", "rate of the complex tilt"),
        _real("Omega", "rad/s", "spin rate", positive=True),
        _real("theta_z", "rad", "spin angle of the shaft"),
        _real("theta", "rad", "angle of a flexure"),
        _real("theta_rate", "rad/s", "rate of a flexure"),
        _real("axis", "1", "+1 for the inner flexure, -1 for the outer one"),
        _real("i_motor", "A", "current of the motor at the last sample"),
        Quantity(sp.Symbol("V_coil", complex=True), "V", "voltages of the coils, x + i y in case axes"),
        _real("T_coil", "K", "temperature of the torque coils", positive=True),
        _real(
            "T_winding", "K", "temperature of the motor's winding, computed from its current", positive=True
        ),
        _real("T_motor", "K", "temperature of the motor's magnets, computed from its current", positive=True),
        _real("T_air", "K", "air temperature", positive=True),
        _real("rho", "kg/m^3", "air density", positive=True),
        _real("up", "1", "component along case z of the unit vector that points up"),
        Quantity(sp.Symbol("up_across", complex=True), "1", "its components across the case axis, x + i y"),
        Quantity(
            sp.Symbol("home_x", complex=True),
            "1",
            "components across, x + i y in case axes, of the horizontal unit vector along which case x lies "
            "with the rig upright and not yawed",
        ),
        Quantity(sp.Symbol("home_y", complex=True), "1", "the same for case y"),
        _real("t", "s", "time since the start of the recording"),
        _real("Omega_ref", "rad/s", "reference spin rate of the bench", positive=True),
        _real("rho_ref", "kg/m^3", "reference air density of the bench", positive=True),
        _real("T_ref", "K", "reference temperature of the bench", positive=True),
        _real("z_ref", "rad", "reference tilt of the bench", positive=True),
        _real("N_ripple", "1", "periods a turn of the motor's ripple", positive=True),
    )
}

z, z_rate = QUANTITIES["z"].symbol, QUANTITIES["z_rate"].symbol
Omega, Omega_ref = QUANTITIES["Omega"].symbol, QUANTITIES["Omega_ref"].symbol
theta, theta_rate = QUANTITIES["theta"].symbol, QUANTITIES["theta_rate"].symbol
theta_z, axis, i_motor = QUANTITIES["theta_z"].symbol, QUANTITIES["axis"].symbol, QUANTITIES["i_motor"].symbol
V_coil = QUANTITIES["V_coil"].symbol
T_winding, T_motor = QUANTITIES["T_winding"].symbol, QUANTITIES["T_motor"].symbol
T_coil, T_air, T_ref = QUANTITIES["T_coil"].symbol, QUANTITIES["T_air"].symbol, QUANTITIES["T_ref"].symbol
rho, rho_ref = QUANTITIES["rho"].symbol, QUANTITIES["rho_ref"].symbol
up, up_across = QUANTITIES["up"].symbol, QUANTITIES["up_across"].symbol
home_x, home_y = QUANTITIES["home_x"].symbol, QUANTITIES["home_y"].symbol
t, z_ref, N_ripple = QUANTITIES["t"].symbol, QUANTITIES["z_ref"].symbol, QUANTITIES["N_ripple"].symbol

#: The reference values, as bench parameters.
REFERENCES = {
    "Omega_ref": "spin_rate_reference",
    "rho_ref": "air_density_reference",
    "T_ref": "air_temperature",
    "z_ref": "tilt_reference",
    "N_ripple": "motor_ripple_order",
}
