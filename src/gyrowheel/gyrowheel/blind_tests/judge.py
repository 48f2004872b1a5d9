"""The judge of blind tests: outcomes of a diagnosis, a model and a campaign, and the key compared with a model."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from gyrowheel_core.quantities import listed
from gyrowheel_sim.effects import registry
from gyrowheel_sim.plant.scenario import UNREGISTERED

if TYPE_CHECKING:
    from gyrowheel.models.api import Model
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_sim.bench import Bench
    from gyrowheel_sim.effects import Effect, EffectValues
    from gyrowheel_sim.plant.scenario import Scenario

Outcome = Literal[
    "exact",
    "inaccurate",
    "tied",
    "tied_without_test",
    "partial",
    "missed",
    "below_limit",
    "unknown",
    "misnamed",
    "named_right",
    "failed",
]
#: Meaning of each outcome.
OUTCOMES: dict[Outcome, str] = {
    "exact": "all hidden effects are named, and no other",
    "inaccurate": "all hidden effects are named, and no other, but a coefficient is off",
    "tied": "the hidden effect is a named alternative, and the test that separates them is named",
    "tied_without_test": "the hidden effect is a named alternative, but no test that separates them is named",
    "partial": "some hidden effects are named, and no other",
    "missed": "no effect is named",
    "below_limit": "no effect is named, and the hidden one is below its detection limit",
    "unknown": "called unknown, or described by a formula",
    "misnamed": "an effect is named that was not hidden",
    "named_right": "outside the library: named as the library effect that is right with another exponent",
    "failed": "the diagnosis failed",
}
#: Outcomes that agree with the key of a single diagnosis.
RIGHT: tuple[Outcome, ...] = ("exact", "tied", "below_limit")
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


class Finding(Protocol):
    """A named effect or instrument, with its alternatives."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def ties(self) -> Any:
        """Alternatives, each with its ``names`` and ``separating_plan``."""


@dataclass(frozen=True)
class Named:
    """An effect that is named without alternatives, as a model does."""

    name: str
    ties: tuple[()] = ()


@dataclass(frozen=True)
class Judgement:
    """Comparison of a verdict with the truth."""

    outcome: Outcome  # one of `OUTCOMES`
    sentence: str  # the outcome in words

    @property
    def right(self) -> bool:
        """Whether the verdict agrees with the key."""
        return self.outcome in RIGHT


def judge(diagnosis: Diagnosis, truth: EffectValues) -> Judgement:
    """Compare a verdict with the hidden effects."""
    tests: list[str | None] = []
    outcome: Outcome = "unknown"
    if diagnosis.verdict != "unknown":
        outcome, tests = judge_names(diagnosis.effects, truth, imitated=imitated(diagnosis, truth))
    if outcome == "missed" and diagnosis.verdict == "nothing_missing" and _below_limits(diagnosis, truth):
        outcome = "below_limit"
    words = f"{'Right' if outcome in RIGHT else 'WRONG'}: {OUTCOMES[outcome]}"
    if outcome == "exact" and any(finding.ties for finding in diagnosis.effects):
        words += "; alternatives are named too"
    if outcome == "tied":
        words += f": plan {' and '.join(dict.fromkeys(map(str, tests)))}"
    return Judgement(outcome, f"{words}.")


def imitated(diagnosis: Diagnosis, hidden: Collection[str]) -> dict[str, str | None]:
    """Return what is an alternative of a named instrument, each with the test that separates them.

    Two together are an alternative only if both are `hidden`.
    """
    return {
        name: tie.separating_plan
        for found in diagnosis.instruments
        for tie in found.ties
        if len(tie.names) == 1 or {*hidden}.issuperset(tie.names)
        for name in tie.names
    }


def judge_names(
    findings: Iterable[Finding],
    truth: Iterable[str],
    *,
    instruments: Iterable[str] = (),
    imitated: Mapping[str, str | None] | None = None,
) -> tuple[Outcome, list[str | None]]:
    """Compare named effects with the hidden ones.

    `instruments` are hidden errors of instruments: an effect that ties with one is not misnamed. `imitated` are the
    alternatives of named instruments (see the function of that name). The second result has, for every hidden effect
    that is an alternative only, the test that separates it, or None.
    """
    findings, truth, imitated = list(findings), list(truth), imitated or {}
    if sorted(finding.name for finding in findings) == sorted(truth):
        return "exact", []
    left, tests = {*truth, *instruments}, []
    for finding in sorted(findings, key=lambda f: f.name not in left):
        if finding.name in left:
            left.discard(finding.name)
            continue
        ties = sorted(
            (t for t in finding.ties if left.issuperset(t.names)), key=lambda t: t.separating_plan is None
        )
        if not ties:
            return "misnamed", []
        left.difference_update(ties[0].names)
        tests.append(ties[0].separating_plan)
    left &= {*truth}
    tests += [imitated[name] for name in sorted(left) if name in imitated]
    if left - imitated.keys():
        return "partial" if findings else "missed", []
    return "tied" if all(tests) else "tied_without_test", tests


def _below_limits(diagnosis: Diagnosis, truth: EffectValues) -> bool:
    """Return whether every hidden effect is smaller than its detection limits."""
    limits = {(limit.effect, limit.coefficient): limit.value for limit in diagnosis.limits}

    def below(name: str, values: Mapping[str, float]) -> bool:
        stated = {key: limits[name, key] for key in values if (name, key) in limits}
        return bool(stated) and all(abs(values[key]) < limit for key, limit in stated.items())

    return all(below(name, values) for name, values in truth.items())


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
        coefficient further off; ``described``: a formula describes an effect outside the library; ``incomplete``:
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
        """Return the user-defined formulas of the model, if they alone describe the effects outside the library."""
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
