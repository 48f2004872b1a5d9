"""The effects that a model lacks, with the evidence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gyrowheel.models.api import Model, effects_to_add
from gyrowheel.recordings.inputs import Recordings, Say, data, opened_apart, require_one_machine
from gyrowheel.show.result import Result, columns_of
from gyrowheel_analysis.diagnosis import result as facts
from gyrowheel_analysis.diagnosis.estimates import Estimate
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_sim.effects import Effect


@dataclass(frozen=True, repr=False)
class Diagnosis(Result, facts.Diagnosis):
    """Outcome of `gyrowheel.diagnose`; the fields are those of `gyrowheel_analysis.diagnosis.result.Diagnosis`."""

    @property
    def sentence(self) -> str:
        """The verdict in a sentence."""
        from gyrowheel.show.sentences.diagnosis import verdict_sentence

        return verdict_sentence(self)

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts before, between and after the events, as paths for `Recording.open`; empty without events."""
        from gyrowheel_analysis.diagnosis.events import parts_between

        return tuple(parts_between([event for event in self.events if event.recording in self.recordings]))

    def to_add(self) -> list[str | Effect]:
        """Return what `Model.add` takes: names of effects, and effects made from the proposed formulas.

        Raises
        ------
        InputError
            If nothing was found, or the recordings cannot decide between several effects.
        """
        return effects_to_add(self)

    def headline(self) -> str:
        """Return the verdict in a sentence."""
        return self.sentence

    def page(self) -> Iterable[RenderableType]:
        """Return verdict, findings with evidence, errors, instruments, moved parameters and detection limits."""
        from gyrowheel.diagnosis.page import diagnosis_page

        return diagnosis_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel diagnose --json``; SI units."""
        from gyrowheel.show.contract import diagnosis_json

        return diagnosis_json(self)

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the findings as columns, one row for each coefficient; those of instruments as total values."""
        items = [(f.name, f.delta_chi2, f.coefficients) for f in self.effects]
        items += [(f.name, f.delta_chi2, f.coefficients) for f in self.free_form]
        items += [
            (f.name, f.delta_chi2, {f.quantity: Estimate(f.value, f.standard_error, f.unit)})
            for f in self.instruments
        ]
        return columns_of(
            "effect coefficient value standard_error unit delta_chi2",
            (
                (name, key, e.value, e.standard_error, e.unit, delta)
                for name, delta, coefficients in items
                for key, e in coefficients.items()
            ),
        )

    def plot(self) -> Figure:
        """Return the error before and after adding the findings, window by window and channel by channel.

        Raises
        ------
        InputError
            If the recordings have too little steady motion for a diagnosis.
        """
        from gyrowheel.diagnosis.page import coefficients_line
        from gyrowheel.show.error_fall import error_figure

        if self.error is None:
            raise InputError(f"diagnosis: nothing to draw: {self.sentence}")
        subtitle = "; ".join(f"{f.name}: {coefficients_line(f)}" for f in self.effects)
        return error_figure(self.residuals, self.error, title=self.sentence.rstrip("."), subtitle=subtitle)

    def plot_map(self) -> Figure:
        """Return the map of the missing torque over the tilts, speed by speed.

        Raises
        ------
        InputError
            If the diagnosis has no map.
        """
        from gyrowheel.diagnosis.picture import map_figure

        if self.map is None:
            raise InputError(f"diagnosis: no map to draw: {self.sentence}")
        return map_figure(self.map)


def diagnose(
    recordings: Recordings,
    model: Model,
    *,
    validate: Recordings = (),
    averages: bool = False,
    mixed: bool = False,
    quick: bool = False,
    progress: Say | None = None,
) -> Diagnosis:
    """Find out which physical effects a model lacks.

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings of one machine.
    model : Model
        The model.
    validate : Recording, path or list, optional
        Further recordings of the machine, which are only predicted: the error on them shows whether the finding holds.
    averages : bool
        Use averages over whole revolutions only, for example where filters suppress faster signals.
    mixed : bool
        Join recordings that state different machines.
    quick : bool
        Leave out the next test, and detection limits where something was found: the verdict is the same.
    progress : callable, optional
        Called with a line of text now and then. If it raises `SearchEnded`, the search ends with what it has found.

    Raises
    ------
    InputError
        If a recording cannot be read, is given twice, or is of another machine.
    """
    from gyrowheel_analysis.diagnosis.diagnose import diagnose as run

    fitted, unused = opened_apart(recordings, validate)
    require_one_machine(data([*fitted, *unused]), mixed=mixed)
    return Diagnosis.of(
        run(
            data(fitted),
            model.details,
            validate=data(unused),
            averages=averages,
            mixed=mixed,
            quick=quick,
            progress=progress,
        )
    )
