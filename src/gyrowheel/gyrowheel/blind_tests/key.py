"""The content of a key file, compared with a model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gyrowheel.blind_tests.judge import Named, Outcome, judge_names
from gyrowheel_core.quantities import listed
from gyrowheel_sim.effects import registry
from gyrowheel_sim.plant.unregistered_effects import UNREGISTERED

if TYPE_CHECKING:
    from gyrowheel.models.api import Model
    from gyrowheel_sim.bench import Bench
    from gyrowheel_sim.effects import Effect
    from gyrowheel_sim.plant.scenario import Scenario

#: Standard errors that a coefficient may be off.
TOLERANCE = 3.0
#: Outcomes as the JSON of a key names them.
_NAMES: dict[Outcome, str] = {
    "exact": "right",
    "inaccurate": "inaccurate",
    "unknown": "described",
    "partial": "incomplete",
    "missed": "incomplete",
    "misnamed": "wrong",
}


@dataclass(frozen=True)
class Quantity:
    """A coefficient of an effect, or a bench parameter: hidden value and value of the model.

    Attributes
    ----------
    owner, name : str
        Effect, empty for a bench parameter; coefficient or parameter.
    unit : str
        SI unit.
    pure : bool
        Whether the value is shown as a number without unit prefix.
    hidden, value : float or None
        In the key and in the model [SI]; None where it has none.
    standard_error : float
        Of the value in the model [SI]; 0 where none is stated.
    """

    owner: str
    name: str
    unit: str
    pure: bool
    hidden: float | None
    value: float | None
    standard_error: float = 0.0

    @property
    def distance(self) -> float | None:
        """Model minus key in standard errors; None where one of the three is missing."""
        if self.hidden is None or self.value is None or not self.standard_error > 0.0:
            return None
        return (self.value - self.hidden) / self.standard_error


@dataclass(frozen=True)
class OpenedKey:
    """A hidden machine, and the model that is judged.

    Attributes
    ----------
    path : Path
        The key file.
    hidden : gyrowheel_sim.plant.scenario.Scenario
        The hidden machine: its effects and bench parameters.
    bench : gyrowheel_sim.bench.Bench
        The bench as its file describes it.
    model : Model or None
        The model that is judged.
    """

    path: Path
    hidden: Scenario
    bench: Bench
    model: Model | None

    @property
    def effects(self) -> tuple[Quantity, ...]:
        """Coefficients of all effects that are hidden or in the model."""
        library: dict[str, Effect] = {effect.name: effect for effect in UNREGISTERED}
        library |= registry() if self.model is None else self.model.details.library
        found = {} if self.model is None else self.model.effects
        errors = {} if self.model is None else self.model.effect_errors
        return tuple(
            Quantity(
                name,
                c.name,
                c.unit,
                c.shape is not None,
                self.hidden.effects.get(name, {}).get(c.name),
                found.get(name, {}).get(c.name),
                errors.get(name, {}).get(c.name, 0.0),
            )
            for name in dict.fromkeys([*self.hidden.effects, *found])
            for c in library[name].coefficients
        )

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        """Bench parameters that differ from the bench file, in the model as fitted, else as stated."""
        result = []
        for name, hidden in self.hidden.values.items():
            p = self.bench.parameters[name]
            value, error = p.value, p.uncertainty
            if self.model is not None and name in self.model.parameters:
                fitted = self.model.parameters[name]
                value, error = fitted.value, fitted.standard_error
            result.append(Quantity("", name, p.unit, True, hidden, value, error))
        return tuple(result)

    @property
    def judged(self) -> Outcome | None:
        """Comparison of the model's effects with the hidden ones, as `blind_tests.judge`; None without a model."""
        if self.model is None:
            return None
        if self._formulas():
            return "unknown"
        outcome, _ = judge_names(map(Named, self.model.effects), self.hidden.effects)
        return "inaccurate" if outcome == "exact" and self._off() else outcome

    @property
    def outcome(self) -> str | None:
        """Comparison of the model's effects with the hidden ones; None without a model.

        ``right``: the same effects, coefficients within three standard errors; ``inaccurate``: the same effects, a
        coefficient further off; ``described``: a formula stands for an effect outside the library; ``incomplete``:
        hidden effects are missing, and no other is there; ``wrong``: an effect that was not hidden.
        """
        return None if self.judged is None else _NAMES[self.judged]

    @property
    def sentence(self) -> str:
        """The hidden effects and, with a model, the comparison."""
        hidden = list(self.hidden.effects)
        secret = f"Hidden: {listed(hidden, 'and')}." if hidden else "No effect was hidden."
        if self.model is None:
            return secret
        named = list(self.model.effects)
        invented = [name for name in named if name not in hidden]
        missing = [name for name in hidden if name not in named]
        if formulas := self._formulas():
            return (
                f"{secret} It is outside the library; the model has the formula {listed(formulas, 'and')} in its "
                "place: the error on a validation recording shows how good that is."
            )
        if invented:
            text = f"WRONG: the model has {listed(invented, 'and')}, not hidden."
            return f"{text} {secret}"
        if missing:
            return f"Incomplete: the model lacks {listed(missing, 'and')}."
        if not hidden:
            return "Right: no effect was hidden, and the model has none."
        if off := self._off():
            return f"The effects are right, but more than {TOLERANCE:.0f} standard errors off: {listed(off, 'and')}."
        return f"Right: the model has {listed(hidden, 'and')}, within {TOLERANCE:.0f} standard errors."

    def _formulas(self) -> list[str]:
        """Return the user-defined formulas of the model, if they alone stand for effects outside the library."""
        if self.model is None:
            return []
        extra = [name for name in self.model.effects if name not in self.hidden.effects]
        missing = [name for name in self.hidden.effects if name not in self.model.effects]
        own = all(name in self.model.details.declared for name in extra)
        outside = bool(missing) and not any(name in registry() for name in missing)
        return extra if own and outside else []

    def _off(self) -> list[str]:
        """Return the coefficients of effects that are off, or have no standard error to tell."""
        return [
            f"{q.owner} {q.name}"
            for q in self.effects
            if q.hidden != q.value and not (q.distance is not None and abs(q.distance) <= TOLERANCE)
        ]
