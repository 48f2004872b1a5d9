"""All models of the air at one tilt and speed, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from gyrowheel_air.geometry import Geometry
from gyrowheel_air.surrogate import MODELS, coefficients, get_model, options_of
from gyrowheel_air.table import TorqueTable
from gyrowheel_air.torque import MACH_LIMIT, AirState, AirTorque, density_change, reynolds_number, split_tilt
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM


@dataclass(frozen=True)
class Comparison:
    """Results of all models at one tilt and speed."""

    tilt: tuple[float, float]  # phi_x, phi_y [rad]
    spin_rate: float  # spin rate [rad/s]
    air: AirState
    #: Eqs (9) and (10).
    reynolds: float
    density_change: float
    torques: Mapping[str, AirTorque]  # by model, for those that hold there
    refused: Mapping[str, str]  # reasons of the others, by model
    options: list[str]  # the surrogate as effects, each as ``NAME:COEF=VALUE,...``
    #: By model: what `gyrowheel_air.surrogate.coefficients` returns.
    coefficients: Mapping[str, Mapping[str, Mapping[str, tuple[float, float]]]]

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values [SI]; NaN where a model gives no value."""
        return {
            "schema": 1,
            "tilt": list(self.tilt),
            "spin_rate": self.spin_rate,
            "air_density": self.air.density,
            "air_viscosity": self.air.viscosity,
            "reynolds": self.reynolds,
            "density_change": self.density_change,
            "models": {
                name: {
                    "components": torque.components.tolist(),
                    "uncertainty": torque.uncertainty.tolist(),
                    "case": torque.case.tolist(),
                    "case_uncertainty": torque.case_uncertainty.tolist(),
                }
                for name, torque in self.torques.items()
            },
            "refused": dict(self.refused),
            "coefficients": {
                model: {
                    effect: {
                        name: {"value": value, "standard_error": error}
                        for name, (value, error) in members.items()
                    }
                    for effect, members in effects.items()
                }
                for model, effects in self.coefficients.items()
            },
        }


def _check_state(geometry: Geometry, air: AirState, tilt: float, spin_rate: float) -> None:
    """Refuse a tilt at which the rotor touches the case, and a speed at which the air is compressed.

    All models are of air of one density, which holds up to a Mach number of about 0.3 at the rim.
    """
    fastest = MACH_LIMIT * air.speed_of_sound / geometry.rotor_radius
    if not 0.0 < spin_rate <= fastest:
        raise InputError(
            f"speed: {spin_rate / RPM:g} rpm is out of range; allowed: > 0, and up to {fastest / RPM:.0f} rpm, "
            f"where the rim moves at {MACH_LIMIT:g} times the speed of sound"
        )
    free = geometry.free_tilt
    if not tilt <= free:
        raise InputError(
            f"tilt: {tilt / DEG:.4g} deg is out of range; allowed: up to {free / DEG:.2f} deg, "
            "where the rotor touches the case"
        )


def compare(
    geometry: Geometry, air: AirState, tilt: ArrayLike, spin_rate: float, table: TorqueTable
) -> Comparison:
    """Evaluate all models at one tilt [rad] and spin rate [rad/s].

    Raises
    ------
    InputError
        If tilt or spin rate are out of range for every model.
    """
    torques: dict[str, AirTorque] = {}
    refused: dict[str, str] = {}
    found: dict[str, Mapping[str, Mapping[str, tuple[float, float]]]] = {}
    pair = tuple(float(value) for value in tilt)  # type: ignore[union-attr, arg-type]
    _check_state(geometry, air, split_tilt(pair)[0], spin_rate)
    for name in MODELS:
        model = get_model(name, table)
        try:
            torques[name] = model.torque(geometry, air, pair, spin_rate)
        except InputError as error:
            refused[name] = str(error)
        try:
            found[name] = coefficients(model, geometry, air)
        except InputError as error:
            refused.setdefault(name, str(error))
    if not torques:
        raise InputError(next(iter(refused.values())))
    return Comparison(
        tilt=(pair[0], pair[1]),
        spin_rate=spin_rate,
        air=air,
        reynolds=reynolds_number(air, geometry.rotor_radius, spin_rate),
        density_change=density_change(air, geometry.rotor_radius, spin_rate),
        torques=torques,
        refused=refused,
        options=options_of(found.get("surrogate", {})),
        coefficients=found,
    )
