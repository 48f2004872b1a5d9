"""Outcome of adding effects to a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gyrowheel.show.result import Result, columns_of
from gyrowheel_analysis.add import Added

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


@dataclass(frozen=True, repr=False)
class Addition(Result, Added):
    """Outcome of `Model.add`: fitted coefficients, and the error before and after.

    The fields are those of `gyrowheel_analysis.add.Added`.
    """

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings, such as an effect that may not be real, and events in the middle of a recording."""
        from gyrowheel.models.page import addition_notes

        return addition_notes(self)

    def headline(self) -> str:
        """Return the effects, and how the error fell: on the validation recordings where there are any."""
        from gyrowheel.show.error_table import fall, units_of

        e = self.error
        if e.validation_before is not None and e.validation_after is not None:
            floor = e.validation_noise_floor or e.noise_floor
            rows = e.validation_before, e.validation_after, floor
            sentence = fall(*rows, "the validation recordings", units_of(e))
        else:
            sentence = fall(e.before, e.after, e.noise_floor, "the fitted recordings", units_of(e))
        return f"Added {', '.join(self.coefficients)}. {sentence}"

    def page(self) -> Iterable[RenderableType]:
        """Return the effects, parameters that moved, the error before and after, warnings and the proof."""
        from gyrowheel.models.page import addition_page

        return addition_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel model add --json``; SI units."""
        from gyrowheel.show.contract import event_json, proof_json

        content = self.model.to_mapping()
        return {
            "schema": 1,
            "model": self.model.origin,
            "effects": content["effects"],
            "overrides": content["overrides"],
            "error": self.error.to_json(),
            "events": [event_json(event, several=True) for event in self.events],
            "proof": proof_json(self.proof, self.error),
        }

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the fitted coefficients as columns, a row for each."""
        return columns_of(
            "effect coefficient value standard_error unit",
            (
                (name, key, e.value, e.standard_error, e.unit)
                for name, values in self.coefficients.items()
                for key, e in values.items()
            ),
        )

    def plot(self) -> Figure:
        """Return the picture of the error before and after as a matplotlib figure."""
        from gyrowheel.show.error_fall import error_figure

        return error_figure(
            self.residuals, self.error, title=f"The error falls with {', '.join(self.coefficients)}"
        )
