"""Judgement of a diagnosis against the key of a blind test."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from gyrowheel_core.files import read_json
from gyrowheel_core.schema import check
from gyrowheel_sim.effects import EffectValues
from gyrowheel_sim.plant.scenario import KeyFile

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import Diagnosis

Outcome = Literal["exact", "tied", "below_limit", "wrong"]


class Finding(Protocol):
    """What a verdict names: an effect or an instrument, with what explains the recordings as well."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def ties(self) -> Any:
        """Alternatives, each with its ``name`` and ``separating_plan``."""


@dataclass(frozen=True)
class Judgement:
    """How a verdict compares with the truth.

    Attributes
    ----------
    outcome : str
        ``exact``; ``tied`` (the truth is among the alternatives of the verdict, and the test that separates them is
        named); ``below_limit`` (nothing was found, and the truth is below the stated detection limit);
        ``wrong``.
    sentence : str
        The outcome in words.
    """

    outcome: Outcome
    sentence: str

    @property
    def right(self) -> bool:
        """Whether the verdict agrees with the key."""
        return self.outcome != "wrong"


def hidden_effects(key: Path) -> EffectValues:
    """Return the effects in a key file.

    Raises
    ------
    InputError
        If the file is missing or is not a key file.
    """
    return dict(check(KeyFile, read_json(key), str(key), kind="key file").effects)


def judge(diagnosis: Diagnosis, truth: EffectValues) -> Judgement:
    """Compare a verdict with the effects that were hidden."""
    named = [finding.name for finding in diagnosis.effects]
    if sorted(named) == sorted(truth) and diagnosis.verdict in ("effect", "ambiguous", "nothing_missing"):
        ties = any(finding.ties for finding in diagnosis.effects)
        return Judgement(
            "exact", "The verdict is right" + ("; the alternatives were named too." if ties else ".")
        )
    tests = _tests_for(diagnosis, truth)
    if tests is not None:
        return Judgement(
            "tied", f"The verdict names it among the alternatives; plan {tests} would separate them."
        )
    if not named and diagnosis.verdict == "nothing_missing" and _below_limits(diagnosis, truth):
        return Judgement(
            "below_limit",
            "Rightly nothing was found: the hidden effect is below the detection limit stated above.",
        )
    return Judgement("wrong", "WRONG: the verdict does not agree with the key.")


def matched(findings: Iterable[Finding], truth: Iterable[str]) -> tuple[set[str], list[str | None]] | None:
    """Match what a verdict names with what was hidden.

    Parameters
    ----------
    findings : iterable of Finding
        What the verdict names.
    truth : iterable of str
        Names of the hidden effects.

    Returns
    -------
    left : set of str
        Hidden effects that are not named.
    tests : list of str or None
        For every hidden effect that is only an alternative: the test that separates it, if there is one.

    None if an effect is named that was not hidden, and neither was any of its alternatives.
    """
    left = set(truth)
    tests: list[str | None] = []
    for finding in sorted(findings, key=lambda f: f.name not in left):
        if finding.name in left:
            left.discard(finding.name)
            continue
        ties = sorted((t for t in finding.ties if t.name in left), key=lambda t: t.separating_plan is None)
        if not ties:
            return None
        left.discard(ties[0].name)
        tests.append(ties[0].separating_plan)
    return left, tests


def _tests_for(diagnosis: Diagnosis, truth: EffectValues) -> str | None:
    """Return the tests that would separate the truth from its ties; None if the verdict misses the truth."""
    left, tests = matched(diagnosis.effects, truth) or (set(truth), [])
    named = [test for test in tests if test]
    if left or len(named) < len(tests):
        return None
    return " and ".join(dict.fromkeys(named)) or None


def _below_limits(diagnosis: Diagnosis, truth: EffectValues) -> bool:
    limits = {(limit.effect, limit.coefficient): limit.value for limit in diagnosis.limits}
    return all(_below(name, values, limits) for name, values in truth.items())


def _below(name: str, values: Mapping[str, float], limits: Mapping[tuple[str, str], float]) -> bool:
    stated = {key: limits[name, key] for key in values if (name, key) in limits}
    return bool(stated) and all(abs(values[key]) < limit for key, limit in stated.items())
