"""Power laws for the air torque, in the form of the effects `aero_restoring`, `aero_cross`, `windage`.

With the tilt z = tan phi_x + i tan phi_y, r = Omega/Omega_0 and d = rho/rho_0:

    across the rotor's axis, T_x + i T_y = (-k r^n1 d^(n1-1) + i c r^n2 d^(n2-1)) z
    along the rotor's axis, -w r^n3 d^(n3-1)

The exponent of the density follows from similarity, T = rho Omega^2 R^5 f(Re), at constant viscosity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrowheel_air.correlations import Correlation, Vorticity
from gyrowheel_air.geometry import Geometry
from gyrowheel_air.table import Table, TorqueTable
from gyrowheel_air.torque import (
    AirModel,
    AirState,
    AirTorque,
    check_range,
    check_speed,
    split_tilt,
    tilt_axes,
)
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]
#: The effect of each component, and the name of its size.
EFFECTS: tuple[tuple[str, str], ...] = (("aero_restoring", "k"), ("aero_cross", "c"), ("windage", "w"))
#: Spin rate and density to which the sizes refer, as in the shipped bench file.
REFERENCE_SPEED = 3500.0 * RPM
REFERENCE_DENSITY = 1.205


@dataclass(frozen=True)
class PowerLaw:
    """size * r^n, fitted to the torques of one component."""

    #: Size at the reference speed and density [N m/rad, or N m], and its standard uncertainty with all that
    #: the fit does not see (mesh, turbulence model).
    size: float
    size_error: float
    #: Exponent of the spin rate, and its standard error.
    exponent: float
    exponent_error: float
    #: Relative residuals of the fit: root mean square, and the largest in size.
    rms: float
    largest: float


@dataclass(frozen=True)
class Surrogate:
    """Power laws as a model of the air."""

    #: Of the restoring component, the one across, the drag; None where nothing is known.
    laws: tuple[PowerLaw | None, PowerLaw | None, PowerLaw | None]
    tilt_limit: float  # largest tilt that the fit has seen [rad]
    speeds: tuple[float, float]  # lowest and highest spin rate that it has seen [rad/s]
    lengths: Mapping[str, float]  # lengths of rotor and case [m]; another geometry is refused
    viscosity: float  # viscosity of the air fitted to [Pa s]; another one enters by similarity
    #: Spin rate [rad/s] and density [kg/m^3] to which the sizes refer.
    reference_speed: float = REFERENCE_SPEED
    reference_density: float = REFERENCE_DENSITY

    @property
    def name(self) -> str:
        """Name of the model."""
        return "surrogate"

    def torque(self, geometry: Geometry, air: AirState, tilt: ArrayLike, spin_rate: float) -> AirTorque:
        """Return the torque of the air (see `AirModel.torque`); the uncertainty holds the residual of the fit."""
        check_speed(spin_rate)
        angle, direction = split_tilt(tilt)
        self._check(geometry, angle, spin_rate)
        r, d = spin_rate / self.reference_speed, air.density / self.reference_density
        m = air.viscosity / self.viscosity
        tangent, cosine = math.tan(angle), math.cos(angle)
        # the laws give the parts across the rotor's axis in case x and y: the second is foreshortened
        shape = (-tangent, tangent / cosine, -1.0)
        values, errors = np.zeros(3), np.zeros(3)
        for i, law in enumerate(self.laws):
            if law is None:
                values[i] = errors[i] = 0.0 if shape[i] == 0.0 else math.nan
                continue
            n = law.exponent
            size = law.size * r**n * d ** (n - 1.0) * m ** (2.0 - n)
            relative = math.hypot(law.size_error / law.size, law.exponent_error * abs(math.log(r)), law.rms)
            values[i], errors[i] = shape[i] * size, abs(shape[i] * size) * relative
        return AirTorque(values, errors, tilt_axes(angle, direction))

    def coefficients(
        self, reference_speed: float = REFERENCE_SPEED, reference_density: float = REFERENCE_DENSITY
    ) -> dict[str, dict[str, tuple[float, float]]]:
        """Return value and standard uncertainty of each coefficient of each effect, by the effects' names [SI].

        `reference_speed`, `reference_density`: spin rate [rad/s] and density [kg/m^3] at which the sizes are
        wanted: those of the bench.
        """
        found = {}
        for (effect, name), law in zip(EFFECTS, self.laws, strict=True):
            if law is not None:
                r, d = reference_speed / self.reference_speed, reference_density / self.reference_density
                factor = r**law.exponent * d ** (law.exponent - 1.0)
                size = factor * law.size
                error = size * math.hypot(law.size_error / law.size, law.exponent_error * math.log(r * d))
                found[effect] = {name: (size, error), "n": (law.exponent, law.exponent_error)}
        return found

    def _check(self, geometry: Geometry, angle: float, spin_rate: float) -> None:
        check_range(angle, spin_rate, self.tilt_limit, self.speeds, "surrogate")
        for name, value in geometry.to_dict().items():
            if not math.isclose(value, self.lengths[name], rel_tol=1e-6):
                raise InputError(
                    f"geometry: {name}: {1e3 * value:.5g} mm; the surrogate was fitted for "
                    f"{1e3 * self.lengths[name]:.5g} mm; allowed: that one, or fit it to a table of this geometry"
                )


def fit_table(table: TorqueTable) -> Surrogate:
    """Fit the power laws to the grid of a table.

    Each component by least squares of the logarithms: all rows count by their relative residual. The uncertainty of a
    size is that of the fit and the spread of the table over meshes and turbulence models.

    Raises
    ------
    InputError
        If the table has fewer than two speeds or no tilt, or a component changes its sign.
    """
    tilts = np.array([row.case.tilt for row in table.grid])
    speeds = np.array([row.case.spin_rate for row in table.grid])
    torques = np.array([row.torque.mean for row in table.grid])
    mesh, model = table.spread
    return _fit(
        tilts, speeds, torques, np.hypot(mesh, model), table.lengths, table.air.density, table.air.viscosity
    )


def fit_model(
    model: AirModel,
    geometry: Geometry,
    air: AirState,
    *,
    tilts: Sequence[float] = tuple(DEG * np.array([1.0, 2.0, 3.0, 4.0, 5.0])),
    speeds: Sequence[float] = tuple(RPM * np.array([1000.0, 2000.0, 3000.0, 3500.0, 4000.0])),
) -> Surrogate:
    """Fit the power laws to any model over tilts [rad] and spin rates [rad/s], in one air.

    A table is evaluated at its own rows. The uncertainty of a size is that of the fit and the relative
    uncertainty that the model states. Raises InputError if the model does not hold in the whole range.
    """
    if isinstance(model, Surrogate):
        return model
    if isinstance(model, Table):
        tilts, speeds = (
            [tilt for tilt in model.table.tilts.tolist() if tilt > 0.0],
            model.table.speeds.tolist(),
        )
    asked = [(tilt, speed) for tilt in tilts for speed in speeds]
    found = [model.torque(geometry, air, (tilt, 0.0), speed) for tilt, speed in asked]
    torques = np.array([t.components for t in found])
    stated = np.array([t.uncertainty / np.abs(t.components) for t in found]).mean(axis=0)
    pairs = np.array(asked)
    return _fit(pairs[:, 0], pairs[:, 1], torques, stated, geometry.to_dict(), air.density, air.viscosity)


def coefficients(
    model: AirModel,
    geometry: Geometry,
    air: AirState,
    *,
    reference_speed: float = REFERENCE_SPEED,
    reference_density: float = REFERENCE_DENSITY,
) -> dict[str, dict[str, tuple[float, float]]]:
    """Return the coefficients of the air's effects that fit a model best, with uncertainties.

    Parameters
    ----------
    model : AirModel
        Any of the four.
    geometry : Geometry
        Rotor and case.
    air : AirState
        The air at which the power laws are fitted.
    reference_speed, reference_density : float
        Spin rate [rad/s] and density [kg/m^3] at which the sizes are wanted; by default those of the shipped bench.

    Returns
    -------
    dict
        By effect (``aero_restoring``, ``aero_cross``, ``windage``) and coefficient (k, c, w and n): value and standard
        uncertainty [SI]. Effects that the model does not describe are left out.
    """
    return fit_model(model, geometry, air).coefficients(reference_speed, reference_density)


def _fit(
    tilts: Array,
    speeds: Array,
    torques: Array,
    systematic: Array,
    lengths: Mapping[str, float],
    density: float,
    viscosity: float,
) -> Surrogate:
    shapes = np.column_stack([-np.tan(tilts), np.tan(tilts) / np.cos(tilts), -np.ones(len(tilts))])
    laws: list[PowerLaw | None] = []
    for i, (effect, _) in enumerate(EFFECTS):
        used = (shapes[:, i] != 0.0) & np.isfinite(torques[:, i])
        if not used.any():
            laws.append(None)
            continue
        sizes = torques[used, i] / shapes[used, i]
        if np.any(sizes <= 0.0):
            raise InputError(
                f"surrogate: {effect}: the torque changes its sign over the table: no power law holds"
            )
        law = _power_law(speeds[used] / REFERENCE_SPEED, sizes, float(systematic[i]))
        if law is None:
            raise InputError(f"surrogate: {effect}: fewer than three rows or two speeds; more are needed")
        # the fit was in this air: back to the reference density
        factor = (REFERENCE_DENSITY / density) ** (law.exponent - 1.0)
        laws.append(
            PowerLaw(
                law.size * factor,
                law.size_error * factor,
                law.exponent,
                law.exponent_error,
                law.rms,
                law.largest,
            )
        )
    return Surrogate(
        laws=(laws[0], laws[1], laws[2]),
        tilt_limit=float(tilts.max()),
        speeds=(float(speeds.min()), float(speeds.max())),
        lengths=dict(lengths),
        viscosity=viscosity,
    )


def _power_law(ratios: Array, sizes: Array, systematic: float) -> PowerLaw | None:
    if len(sizes) < 3 or np.ptp(ratios) == 0.0:
        return None
    design = np.column_stack([np.ones(len(ratios)), np.log(ratios)])
    solution, *_ = np.linalg.lstsq(design, np.log(sizes), rcond=None)
    residual = np.log(sizes) - design @ solution
    variance = residual @ residual / (len(sizes) - 2)
    covariance = variance * np.linalg.inv(design.T @ design)
    size = math.exp(solution[0])
    return PowerLaw(
        size=size,
        size_error=size * math.hypot(math.sqrt(covariance[0, 0]), systematic),
        exponent=float(solution[1]),
        exponent_error=math.sqrt(covariance[1, 1]),
        rms=float(np.sqrt(np.mean(np.expm1(residual) ** 2))),
        largest=float(np.max(np.abs(np.expm1(residual)))),
    )


@dataclass(frozen=True)
class AirEffects:
    """Coefficients of the air's effects by a model."""

    #: By effect and coefficient: value, and standard uncertainty [SI].
    values: dict[str, dict[str, float]]
    errors: dict[str, dict[str, float]]

    @property
    def options(self) -> list[str]:
        """The effects, each as ``NAME:COEF=VALUE,...``."""
        pairs = {
            effect: {name: (value, self.errors[effect][name]) for name, value in members.items()}
            for effect, members in self.values.items()
        }
        return options_of(pairs)


def options_of(found: Mapping[str, Mapping[str, tuple[float, float]]]) -> list[str]:
    """Return what `coefficients` returned, each effect as ``NAME:COEF=VALUE,...``."""
    return [
        f"{effect}:{','.join(f'{name}={value:.4g}' for name, (value, _) in members.items())}"
        for effect, members in found.items()
    ]


def air_effects(
    model: str = "table",
    *,
    bench: Bench | None = None,
    geometry: Geometry | None = None,
    air: AirState | None = None,
    table: TorqueTable | None = None,
) -> AirEffects:
    """Return the effects of the air by a model, for a simulated machine or as the start of a fit.

    Parameters
    ----------
    model : str
        One of `MODELS`. Effects that it does not describe are left out.
    bench : Bench, optional
        Bench at whose reference speed and density the sizes are wanted; the shipped one by default.
    geometry : Geometry, optional
        Rotor and case; the shipped ones by default.
    air : AirState, optional
        The air in which the power laws are fitted; the paper's by default.
    table : TorqueTable, optional
        Table for ``table`` and ``surrogate``; the shipped one by default.

    Raises
    ------
    InputError
        If the model is unknown, or does not hold for this geometry and air.
    """
    values = (bench or Bench.load()).values()
    found = coefficients(
        get_model(model, table),
        geometry or Geometry.load(),
        air or AirState.paper(),
        reference_speed=values["spin_rate_reference"],
        reference_density=values["air_density_reference"],
    )
    return AirEffects(
        values={
            effect: {name: pair[0] for name, pair in members.items()} for effect, members in found.items()
        },
        errors={
            effect: {name: pair[1] for name, pair in members.items()} for effect, members in found.items()
        },
    )


MODELS = ("correlation", "vorticity", "table", "surrogate")


def get_model(name: str, table: TorqueTable | None = None) -> AirModel:
    """Return a model of the air by name.

    Parameters
    ----------
    name : str
        Of `MODELS`.
    table : TorqueTable, optional
        Table for ``table`` and ``surrogate``; the shipped one by default.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    if name in ("correlation", "vorticity"):
        return Correlation() if name == "correlation" else Vorticity()
    if name not in MODELS:
        raise InputError(f"air model: {name!r} is not known; allowed: {', '.join(MODELS)}")
    rows = TorqueTable.load() if table is None else table
    return Table(rows) if name == "table" else fit_table(rows)
