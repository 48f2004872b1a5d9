"""The effects that a model lacks, with the evidence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gyrowheel.show.result import Result
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_analysis.diagnosis.result import (
        DatedEvent,
        DetectionLimit,
        EffectFinding,
        FreeForm,
        InstrumentFinding,
        NextTest,
        Proof,
        Verdict,
    )
    from gyrowheel_analysis.diagnosis.result import Diagnosis as Details
    from gyrowheel_analysis.reduction.not_as_stated import ReadingFinding
    from gyrowheel_analysis.residuals.error_table import ErrorTable
    from gyrowheel_analysis.residuals.regions import Region
    from gyrowheel_recording.mislabelled.fixes import WrongSetup
    from gyrowheel_sim.effects import Effect


@dataclass(frozen=True, repr=False)
class Diagnosis(Result):
    """Outcome of `gyrowheel.diagnose`.

    Attributes
    ----------
    details : gyrowheel_analysis.diagnosis.result.Diagnosis
        The result of the analysis package, in full.
    """

    details: Details

    @property
    def verdict(self) -> Verdict:
        """``nothing_missing``, ``effect``, ``ambiguous``, ``unknown`` or ``insufficient_data``."""
        return self.details.verdict

    @property
    def sentence(self) -> str:
        """The verdict in a sentence."""
        from gyrowheel.show.sentences.diagnosis import verdict_sentence

        return verdict_sentence(self.details)

    @property
    def proof(self) -> Proof | None:
        """Whether what was found predicts what was not fitted: ``.proven``, ``.recording``, ``.reason`` and numbers."""
        return self.details.proof

    @property
    def effects(self) -> tuple[EffectFinding, ...]:
        """The missing physical effects, strongest first: ``.name``, ``.coefficients``, ``.delta_chi2``, ``.ties``."""
        return self.details.effects

    @property
    def instruments(self) -> tuple[InstrumentFinding, ...]:
        """Instruments that are not as the bench states them: ``.channel``, ``.quantity``, ``.value``, ``.stated``."""
        return self.details.instruments

    @property
    def readings(self) -> tuple[ReadingFinding, ...]:
        """What the samples show of the instruments beside what is stated: hum, steps, jitter, rate of the clock."""
        return self.details.readings

    @property
    def free_form(self) -> tuple[FreeForm, ...]:
        """For the verdict ``unknown``: formulas for what no known effect explains."""
        return self.details.free_form

    @property
    def events(self) -> tuple[DatedEvent, ...]:
        """What changed in the middle of a recording: ``.time``, ``.kind``, ``.channel``, ``.size`` and more."""
        return self.details.events

    @property
    def error(self) -> ErrorTable | None:
        """The error before and after adding the findings; None for ``insufficient_data``."""
        return self.details.error

    @property
    def where(self) -> tuple[Region, ...]:
        """Regions where the model fails without the findings, worst first."""
        return self.details.where

    @property
    def next_test(self) -> NextTest | None:
        """The test to run next: ``.plan``, ``.minutes``, ``.expected_separation``."""
        return self.details.next_test

    @property
    def limits(self) -> tuple[DetectionLimit, ...]:
        """Detection limits: the smallest size of every known effect that these recordings would show."""
        return self.details.limits

    @property
    def setup(self) -> tuple[WrongSetup, ...]:
        """Columns of the recordings that cannot be what they are called; nothing is diagnosed then."""
        return self.details.setup

    @property
    def recordings(self) -> tuple[str, ...]:
        """Paths of the recordings."""
        return self.details.recordings

    @property
    def parts(self) -> tuple[str, ...]:
        """What lies before, between and after the events, as paths for `Recording.open`; empty without events."""
        from gyrowheel_analysis.diagnosis.events import parts_between

        fitted = [event for event in self.events if event.recording in self.recordings]
        return tuple(parts_between(fitted))

    def to_add(self) -> list[str | Effect]:
        """Return what `Model.add` takes: names of effects, and effects made from the proposed formulas.

        Raises
        ------
        InputError
            If nothing was found, or the recordings cannot decide between several effects.
        """
        from gyrowheel_sim.effects import effect_from_mapping

        for own, ties in self.details.ties.items():
            if ties:
                names = ", ".join((own, *(tie.name for tie in ties)))
                test = (
                    ""
                    if self.next_test is None
                    else f", or run plan {self.next_test.plan} and diagnose again"
                )
                raise InputError(
                    f"diagnosis: the recordings cannot decide between {names}; name the effect to add{test}"
                )
        if self.verdict == "unknown" and not self.free_form:
            raise InputError(f"diagnosis: nothing to add: {self.sentence}")
        found: list[str | Effect] = list(self.details.ties)
        found += [effect_from_mapping(f.name, f.declaration, "diagnosis.free_form") for f in self.free_form]
        if not found:
            raise InputError(f"diagnosis: nothing to add, its verdict is {self.verdict}")
        return found

    def __str__(self) -> str:
        """Return the verdict and the findings in a few lines."""
        from gyrowheel.diagnosis.page import coefficients_line
        from gyrowheel.show.sentences.instruments import instrument_sentence
        from gyrowheel.show.sentences.proof import proof_sentence

        lines = [self.sentence]
        lines += [f"  {finding.name}: {coefficients_line(finding)}" for finding in self.effects]
        lines += [f"  {finding.name}: {instrument_sentence(finding)}" for finding in self.instruments]
        lines += [f"  {form.formula}" for form in self.free_form]
        if self.next_test is not None:
            lines.append(f"  next test: plan {self.next_test.plan}, {self.next_test.minutes:.1f} min")
        return "\n".join([*lines, proof_sentence(self.details.proof, self.error)])

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.diagnosis.page import error_section, findings

        yield from findings(self.details)
        yield from error_section(self.details)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel diagnose --json``; SI units."""
        from gyrowheel.show.contract import diagnosis_json

        return diagnosis_json(self.details)

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the findings as columns, one row for each coefficient; those of instruments in whole, as found."""
        from gyrowheel_analysis.diagnosis.result import Estimate

        items = [(f.name, f.delta_chi2, f.coefficients) for f in self.effects]
        items += [(f.name, f.delta_chi2, f.coefficients) for f in self.free_form]
        items += [
            (f.name, f.delta_chi2, {f.quantity: Estimate(f.value, f.standard_error, f.unit)})
            for f in self.instruments
        ]
        rows = [
            (name, key, e.value, e.standard_error, e.unit, delta)
            for name, delta, coefficients in items
            for key, e in coefficients.items()
        ]
        names = ("effect", "coefficient", "value", "standard_error", "unit", "delta_chi2")
        return {name: [row[k] for row in rows] for k, name in enumerate(names)}

    def plot(self) -> Figure:
        """Return the picture of the error before and after adding the findings as a matplotlib figure.

        Raises
        ------
        InputError
            If the recordings have too little steady motion for a diagnosis.
        """
        from gyrowheel.diagnosis.page import coefficients_line
        from gyrowheel.show.error_fall import error_figure

        if self.error is None:
            raise InputError(f"diagnosis: nothing to draw: {self.sentence}")
        subtitle = "   ".join(f"{f.name}: {coefficients_line(f)}" for f in self.effects)
        return error_figure(
            self.details.residuals, self.error, title=self.sentence.rstrip("."), subtitle=subtitle
        )
