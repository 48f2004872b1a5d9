"""What a key file holds, and how a model compares with it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gyrowheel.show.result import Result
from gyrowheel_core.quantities import listed

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel.models.api import Model
    from gyrowheel_sim.bench import Bench
    from gyrowheel_sim.effects import Effect
    from gyrowheel_sim.plant.scenario import Scenario

Outcome = Literal["right", "inaccurate", "described", "incomplete", "wrong"]
#: Standard errors that a coefficient may be off.
TOLERANCE = 3.0


@dataclass(frozen=True)
class Quantity:
    """A coefficient of an effect or a bench parameter: hidden, and in the model.

    Attributes
    ----------
    owner, name : str
        Effect, empty for a bench parameter; coefficient or parameter.
    unit : str
        SI unit.
    pure : bool
        Whether it is a number without unit that shapes a law.
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


@dataclass(frozen=True, repr=False)
class Key(Result):
    """Outcome of `gyrowheel.open_key`.

    Attributes
    ----------
    path : Path
        The key file.
    details : gyrowheel_sim.plant.scenario.Scenario
        The hidden machine: its effects and bench parameters.
    bench : gyrowheel_sim.bench.Bench
        The bench as its file describes it.
    model : Model or None
        The model that is judged.
    """

    path: Path
    details: Scenario
    bench: Bench
    model: Model | None

    @property
    def effects(self) -> tuple[Quantity, ...]:
        """Coefficients of all effects that are hidden or in the model."""
        from gyrowheel_sim.effects import registry
        from gyrowheel_sim.plant.unregistered_effects import UNREGISTERED

        library: dict[str, Effect] = {effect.name: effect for effect in UNREGISTERED}
        library |= registry() if self.model is None else self.model.details.library
        found = {} if self.model is None else self.model.effects
        errors = {} if self.model is None else self.model.effect_errors
        result = []
        for name in dict.fromkeys([*self.details.effects, *found]):
            for c in library[name].coefficients:
                hidden, value = (
                    self.details.effects.get(name, {}).get(c.name),
                    found.get(name, {}).get(c.name),
                )
                error = errors.get(name, {}).get(c.name, 0.0)
                result.append(Quantity(name, c.name, c.unit, c.shape is not None, hidden, value, error))
        return tuple(result)

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        """Bench parameters that differ from the bench file, in the model as fitted, else as stated."""
        result = []
        for name, hidden in self.details.values.items():
            p = self.bench.parameters[name]
            value, error = p.value, p.uncertainty
            if self.model is not None and name in self.model.parameters:
                fitted = self.model.parameters[name]
                value, error = fitted.value, fitted.standard_error
            result.append(Quantity("", name, p.unit, True, hidden, value, error))
        return tuple(result)

    @property
    def outcome(self) -> Outcome | None:
        """How the effects of the model compare with the hidden ones; None without a model.

        ``right``: the same effects, coefficients within three standard errors; ``inaccurate``: the same effects, a
        coefficient further off; ``described``: a formula stands for an effect outside the library; ``incomplete``:
        nothing wrong, not all; ``wrong``: one that was not hidden.
        """
        if self.model is None:
            return None
        hidden, named = set(self.details.effects), set(self.model.effects)
        if self._formulas():
            return "described"
        if named - hidden:
            return "wrong"
        if hidden - named:
            return "incomplete"
        return "inaccurate" if self._off() else "right"

    @property
    def sentence(self) -> str:
        """What was hidden and, against a model, how it compares."""
        hidden = list(self.details.effects)
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
        """Return the model's own formulas that stand for hidden effects outside the library; no more than these."""
        from gyrowheel_sim.effects import registry

        if self.model is None:
            return []
        extra = [name for name in self.model.effects if name not in self.details.effects]
        missing = [name for name in self.details.effects if name not in self.model.effects]
        own = all(name in self.model.details.declared for name in extra)
        outside = bool(missing) and not any(name in registry() for name in missing)
        return extra if own and outside else []

    def _off(self) -> list[str]:
        """Return the coefficients of effects that are off, or of which it is not known for lack of an error."""
        return [
            f"{q.owner} {q.name}"
            for q in self.effects
            if q.hidden != q.value and not (q.distance is not None and abs(q.distance) <= TOLERANCE)
        ]

    def __str__(self) -> str:
        """Return the sentence, and a line for each coefficient."""
        from gyrowheel.blind_tests.page import row

        return "\n".join([self.sentence, *(f"  {q.owner}: {' '.join(row(q)).strip()}" for q in self.effects)])

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.blind_tests.page import key_page

        return key_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel key --json``; SI units."""

        def content(q: Quantity) -> dict[str, Any]:
            numbers = {"hidden": q.hidden, "model": q.value, "standard_error": q.standard_error}
            owner = {"effect": q.owner, "coefficient": q.name} if q.owner else {"parameter": q.name}
            return owner | {"unit": q.unit} | numbers | {"distance": q.distance}

        return {
            "schema": 1,
            "key": str(self.path),
            "model": None if self.model is None else self.model.origin,
            "outcome": self.outcome,
            "sentence": self.sentence,
            "effects": [content(q) for q in self.effects],
            "parameters": [content(q) for q in self.parameters],
        }

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return effects and parameters as columns, a row for each coefficient or parameter; SI units."""
        rows = [*self.effects, *self.parameters]
        names = ("owner", "name", "unit", "hidden", "value", "standard_error", "distance")
        return {name: [getattr(q, name) for q in rows] for name in names}
