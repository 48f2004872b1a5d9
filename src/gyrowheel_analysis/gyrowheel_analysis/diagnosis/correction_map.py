"""The facts of a correction map: on what the missing torque depends, what it resembles, and the error with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from gyrowheel_analysis.residuals.error_table import ErrorTable
from gyrowheel_sim.effects.torque_map import Target, TorqueMap, values_at

Variable = Literal["speed", "tilt", "azimuth", "temperature"]
#: Name of a map in a model, unless it is taken.
NAME = "map"


@dataclass(frozen=True)
class Dependence:
    """How much of the variance of a torque is lost without a variable; the shares of several overlap."""

    target: Target
    variable: Variable
    share: float


@dataclass(frozen=True)
class LeadingTerm:
    """Terms of a map of one power of tilt, mirrored tilt and |tilt|, at any speed, and their share of its variance."""

    target: Target
    powers: tuple[int, int, int]
    share: float


@dataclass(frozen=True)
class CorrectionMap:
    """The missing torque as a smooth function of tilt, speed and temperature.

    Attributes
    ----------
    effect : TorqueMap
        The map as an effect, for `Model.add`; its range and the errors of its coefficients are in it.
    values, errors : dict of str to float
        Its coefficients and their standard errors [N m].
    effects : dict of str to dict
        Coefficients of the effects that were found and belong to it: they are added with it.
    gain : float
        Increase of twice the log likelihood of the recordings against everything else that was found.
    orthogonal : bool
        Whether it leaves to the bench parameters all that they can explain. If not, they would need values far from
        their stated ones.
    dependence : tuple of Dependence
        On what it depends, largest share first for each target.
    leading : tuple of LeadingTerm
        Its largest terms.
    nearest : str
        The known effect that is most like it; empty without one.
    nearest_share : float
        Share of its variance that this effect explains.
    error : ErrorTable
        The error without and with it, on the recordings and on those for validation.
    """

    effect: TorqueMap
    values: Mapping[str, float]
    errors: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]]
    gain: float
    orthogonal: bool
    dependence: tuple[Dependence, ...]
    leading: tuple[LeadingTerm, ...]
    nearest: str
    nearest_share: float
    error: ErrorTable

    @property
    def targets(self) -> tuple[Target, ...]:
        """What it acts on."""
        return tuple(dict.fromkeys(term.target for term in self.effect.terms))

    def at(self, quantities: Mapping[str, Any]) -> dict[Target, Any]:
        """Return its torques at quantities by name, arrays: on the rotor x + i y in case axes, on the shaft [N m]."""
        values = {**quantities, **self.values}
        return {
            law.target: self.effect.law_at(index, values)  # type: ignore[misc]
            for index, law in enumerate(self.effect.laws)
        }

    def errors_at(self, quantities: Mapping[str, Any]) -> dict[Target, Any]:
        """Return independent errors of its torques at quantities by name, arrays (n,): (errors, n) [N m].

        Each is by one standard deviation: the sum of their squares is the variance.
        """
        names = [own.name for own in self.effect.coefficients]
        modes = np.array(self.effect.modes).reshape(-1, len(names))
        errors: dict[Target, Any] = dict.fromkeys(self.targets, 0.0)
        for term, value in values_at(self.effect.terms, self.effect.within, quantities):
            on_rotor = term.target == "rotor_torque"
            parts = [value, 1j * value] if on_rotor else [np.real(value), np.imag(value)]
            for name, part in zip(term.names, parts, strict=False):
                errors[term.target] = errors[term.target] + np.multiply.outer(
                    modes[:, names.index(name)], part
                )
        return errors
