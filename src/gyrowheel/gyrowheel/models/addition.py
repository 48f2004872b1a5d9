"""Outcome of adding effects to a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gyrowheel.show.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_analysis.add import Added as Details
    from gyrowheel_analysis.diagnosis.result import Estimate
    from gyrowheel_analysis.residuals.error_table import ErrorTable


@dataclass(frozen=True, repr=False)
class Addition(Result):
    """Outcome of `Model.add`: fitted coefficients, and the error before and after.

    Attributes
    ----------
    details : gyrowheel_analysis.add.Added
        The result of the fit, in full.
    """

    details: Details

    @property
    def coefficients(self) -> Mapping[str, Mapping[str, Estimate]]:
        """Fitted coefficients: {effect: {coefficient: estimate}} with ``.value``, ``.standard_error``, ``.unit``."""
        return {name: dict(values) for name, values in self.details.coefficients.items()}

    @property
    def error(self) -> ErrorTable:
        """The error before and after, on the fitted and on the validation recordings."""
        return self.details.error

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings, such as an effect that may not be real, and what happened in the middle of a recording."""
        from gyrowheel.show.sentences.events import event_sentences
        from gyrowheel.show.sentences.fits import doubt_sentence

        happened = event_sentences(self.details.events, several=True)
        return (*happened, *(doubt_sentence(doubt) for doubt in self.details.doubts))

    def __str__(self) -> str:
        """Return the coefficients and how the error fell, in a few lines."""
        from gyrowheel.show.error_table import fall, units_of
        from gyrowheel.show.sentences.proof import proof_sentence

        e = self.error
        if e.validation_before is not None and e.validation_after is not None:
            floor = e.validation_noise_floor or e.noise_floor
            rows = e.validation_before, e.validation_after, floor
            sentence = fall(*rows, "the validation recordings", units_of(e))
        else:
            sentence = fall(e.before, e.after, e.noise_floor, "the fitted recordings", units_of(e))
        lines = [f"Added {', '.join(self.details.coefficients)}. {sentence}", *self.notes]
        return "\n".join([*lines, proof_sentence(self.details.proof, e)])

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.models.page import changes
        from gyrowheel.show.error_table import error_table
        from gyrowheel.show.layout import heading, sentences
        from gyrowheel.show.sentences.proof import proof_line

        yield from changes(self.details.model)
        yield heading("Error")
        yield error_table(self.error)
        yield from sentences(self.notes)
        yield proof_line(self.details.proof, self.error)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel model add --json``; SI units."""
        from gyrowheel.show.contract import event_json, proof_json

        content = self.details.model.to_mapping()
        return {
            "schema": 1,
            "model": self.details.model.origin,
            "effects": content["effects"],
            "overrides": content["overrides"],
            "error": self.error.to_json(),
            "events": [event_json(event, several=True) for event in self.details.events],
            "proof": proof_json(self.details.proof, self.error),
        }

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the fitted coefficients as columns, a row for each."""
        rows = [
            (name, key, e.value, e.standard_error, e.unit)
            for name, values in self.details.coefficients.items()
            for key, e in values.items()
        ]
        names = ("effect", "coefficient", "value", "standard_error", "unit")
        return {name: [row[k] for row in rows] for k, name in enumerate(names)}

    def plot(self) -> Figure:
        """Return the picture of the error before and after as a matplotlib figure."""
        from gyrowheel.show.error_fall import error_figure

        names = ", ".join(self.details.coefficients)
        return error_figure(self.details.residuals, self.error, title=f"The error falls with {names}")
