"""A model of the air as effects of the machine: their coefficients, and the options that add them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gyrowheel_air import get_model
from gyrowheel_air.geometry import Geometry
from gyrowheel_air.state import AirState
from gyrowheel_air.surrogate import coefficients
from gyrowheel_air.table import TorqueTable
from gyrowheel_sim.bench import Bench


@dataclass(frozen=True)
class AirEffects:
    """Coefficients of the air's effects by a model.

    Attributes
    ----------
    values, errors : dict of str to dict of str to float
        By effect and coefficient: value, and standard uncertainty [SI].
    """

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
    """Return the air's effects as a model has them: what a simulated machine, or a model to be fitted, starts from.

    Parameters
    ----------
    model : str
        Of `gyrowheel_air.MODELS`. What it says nothing of is left out.
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
