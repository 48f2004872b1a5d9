"""The judge of blind tests: one vocabulary of outcomes for the answers of a diagnosis, a model and a campaign."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_sim.effects import EffectValues

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


class Finding(Protocol):
    """A named effect or instrument, with its alternatives."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def ties(self) -> Any:
        """Alternatives, each with its ``name`` and ``separating_plan``."""


@dataclass(frozen=True)
class Named:
    """An effect that is named without alternatives, as a model does."""

    name: str
    ties: tuple[()] = ()


@dataclass(frozen=True)
class Judgement:
    """Comparison of a verdict with the truth.

    Attributes
    ----------
    outcome : str
        One of `OUTCOMES`.
    sentence : str
        The outcome in words.
    """

    outcome: Outcome
    sentence: str

    @property
    def right(self) -> bool:
        """Whether the verdict agrees with the key."""
        return self.outcome in RIGHT


def judge(diagnosis: Diagnosis, truth: EffectValues) -> Judgement:
    """Compare a verdict with the hidden effects."""
    tests: list[str | None] = []
    outcome: Outcome = "unknown"
    if diagnosis.verdict != "unknown":
        outcome, tests = judge_names(diagnosis.effects, truth)
    if outcome == "missed" and diagnosis.verdict == "nothing_missing" and _below_limits(diagnosis, truth):
        outcome = "below_limit"
    words = f"{'Right' if outcome in RIGHT else 'WRONG'}: {OUTCOMES[outcome]}"
    if outcome == "exact" and any(finding.ties for finding in diagnosis.effects):
        words += "; alternatives are named too"
    if outcome == "tied":
        words += f": plan {' and '.join(dict.fromkeys(map(str, tests)))}"
    return Judgement(outcome, f"{words}.")


def judge_names(
    findings: Iterable[Finding],
    truth: Iterable[str],
    *,
    instruments: Iterable[str] = (),
    imitated: Mapping[str, str | None] | None = None,
) -> tuple[Outcome, list[str | None]]:
    """Compare named effects with the hidden ones.

    Parameters
    ----------
    findings : iterable
        The named effects, with their alternatives.
    truth : iterable of str
        Names of the hidden effects.
    instruments : iterable of str
        Hidden errors of instruments: an effect that ties with one is not misnamed.
    imitated : mapping of str to str or None, optional
        Effects that are alternatives of a named instrument, each with the test that separates them.

    Returns
    -------
    outcome : str
        ``exact``, ``tied``, ``tied_without_test``, ``partial``, ``missed`` or ``misnamed``.
    tests : list of str or None
        For every hidden effect that is an alternative only: the test that separates it, if one is named.
    """
    findings, truth, imitated = list(findings), list(truth), imitated or {}
    if sorted(finding.name for finding in findings) == sorted(truth):
        return "exact", []
    left, tests = {*truth, *instruments}, []
    for finding in sorted(findings, key=lambda f: f.name not in left):
        if finding.name in left:
            left.discard(finding.name)
            continue
        ties = sorted((t for t in finding.ties if t.name in left), key=lambda t: t.separating_plan is None)
        if not ties:
            return "misnamed", []
        left.discard(ties[0].name)
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
