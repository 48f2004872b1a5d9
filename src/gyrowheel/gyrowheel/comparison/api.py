"""The error of a model on recordings; two models on the same recordings; one model on two sets of recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from gyrowheel.models.api import Model
from gyrowheel.recordings.api import explained_by, refuse_wrong_setups, wrong_setups
from gyrowheel.recordings.inputs import Recordings, Say, data, of_one_machine, opened_apart
from gyrowheel.show.result import Result, columns_of
from gyrowheel_analysis import compare as facts
from gyrowheel_analysis import compare_models as two_models
from gyrowheel_analysis import compare_sets as two_sets
from gyrowheel_analysis.residuals.maps import ResidualMap, residual_map, variables_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_recording.mislabelled import WrongSetup


@dataclass(frozen=True, repr=False)
class Comparison(Result, facts.Comparison):
    """Outcome of `gyrowheel.compare`.

    The fields are those of `gyrowheel_analysis.compare.Comparison`, and one more.

    Attributes
    ----------
    setup : tuple of WrongSetup
        Columns that cannot be what they are called; if there are any, all other results are meaningless.
    """

    setup: tuple[WrongSetup, ...] = ()

    def map(self, *over: str) -> ResidualMap:
        """Return a map of the residual over one or two variables.

        Parameters
        ----------
        *over : str
            Of ``tilt``, ``azimuth``, ``speed``, ``time``, ``temperature``.

        Raises
        ------
        InputError
            If there is no such variable, or more than two are given.
        """
        return residual_map(self.data, map_variables(",".join(over)))

    def headline(self) -> str:
        """Return whether the model fails, and χ²/N of every channel."""
        from gyrowheel.comparison.page import verdict

        chi2 = ", ".join(f"{name} {metrics.chi2_per_n:.3g}" for name, metrics in self.channels.items())
        return f"{verdict(self)}; χ²/N (1: noise): {chi2}"

    def page(self) -> Iterable[RenderableType]:
        """Return the errors of every channel, the regions where the model fails, and a map where it does."""
        from gyrowheel.comparison.page import comparison_page

        return comparison_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel compare --json``; SI units."""
        from gyrowheel.show.contract import comparison_json, setup_json

        return comparison_json(self) | {"setup": setup_json(self.setup)}

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the errors as columns, a row for each channel; RMS in N·m or V."""
        rows = [
            {"channel": name, **asdict(metrics), "raw_rms": self.raw_rms[name]}
            for name, metrics in self.channels.items()
        ]
        return {key: [row[key] for row in rows] for key in rows[0]}

    def plot(self) -> Figure:
        """Return the residual over the tilts of every speed, and χ²/N over each variable."""
        from gyrowheel.comparison.picture import figure_of_failure

        return figure_of_failure(self)


def map_variables(text: str) -> tuple[str, ...]:
    """Return the variables of a map, given as ``speed`` or ``speed,tilt``; InputError if there is no such map."""
    return variables_of(text)


def compare(
    recordings: Recordings, model: Model, *, mixed: bool = False, progress: Say | None = None
) -> Comparison:
    """Compare a model with recordings: how large the error is, and where it sits.

    The uncertain bench parameters are fitted within their stated uncertainties; the model cannot explain the remaining
    error.

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings of one machine.
    model : Model
        The model.
    mixed : bool
        Join recordings that state different machines.
    progress : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If a recording cannot be read, is given twice, has too little steady motion, or is of another machine.
    """
    given = of_one_machine(recordings, mixed=mixed)
    wrong = wrong_setups(given, model.details, mixed=mixed)
    with explained_by(wrong):
        found = facts.compare(data(given), model.details, explain=not wrong, progress=progress)
    channels, raw = MappingProxyType(found.channels), MappingProxyType(found.raw_rms)
    return Comparison.of(replace(found, channels=channels, raw_rms=raw), setup=tuple(wrong))


@dataclass(frozen=True, repr=False)
class ModelComparison(Result, two_models.ModelComparison):
    """Outcome of `gyrowheel.compare_models`.

    The fields are those of `gyrowheel_analysis.compare_models.ModelComparison`.
    """

    def headline(self) -> str:
        """Return which model the recordings prefer."""
        from gyrowheel.comparison.page import preference

        return preference(self)

    def page(self) -> Iterable[RenderableType]:
        """Return the models side by side, which one is preferred, and the test that decides."""
        from gyrowheel.comparison.page import models_page

        return models_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel compare A.yaml B.yaml --json``; SI units."""
        return {
            "schema": 1,
            "recordings": list(self.recordings),
            "models": [asdict(side) for side in (self.first, self.second)],
            "evidence": self.evidence,
            "preferred": self.preferred,
            "test": None
            if self.test is None
            else {
                "plan": self.test.plan,
                "expected_separation": self.test.expected_separation,
                "minutes": self.test.minutes,
            },
        }

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return χ²/N of both models as columns, a row for each channel."""
        return columns_of(
            "channel first second",
            ((name, value, self.second.channels[name]) for name, value in self.first.channels.items()),
        )


def compare_models(
    first: Model, second: Model, on: Recordings, *, mixed: bool = False, progress: Say | None = None
) -> ModelComparison:
    """Compare two models of one bench on the same recordings; their coefficients are fitted again.

    Parameters
    ----------
    first, second : Model
        Models with different effects.
    on : Recording, path or list
        Recordings of one machine.
    mixed : bool
        Join recordings that state different machines.
    progress : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If the models have different benches or the same effects, or the recordings cannot be read, have too little
        steady motion, or columns that cannot be what they are called.
    """
    given = of_one_machine(on, mixed=mixed)
    refuse_wrong_setups(given, first.details, mixed=mixed)
    return ModelComparison.of(
        two_models.compare_models(first.details, second.details, data(given), progress=progress)
    )


@dataclass(frozen=True, repr=False)
class SetComparison(Result, two_sets.SetComparison):
    """Outcome of `gyrowheel.compare_sets`.

    The fields are those of `gyrowheel_analysis.compare_sets.SetComparison`.
    """

    def headline(self) -> str:
        """Return what changed."""
        from gyrowheel.comparison.page import change_sentence

        return change_sentence(self)

    def page(self) -> Iterable[RenderableType]:
        """Return what changed, what else may explain it, and the difference that would have shown of the rest."""
        from gyrowheel.comparison.page import sets_page

        return sets_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel compare --on DIR --against DIR --json``; SI units."""
        own = asdict(self)
        for change in own["changes"]:
            change["alternatives"] = [{"name": name, "loss": loss} for name, loss in change["alternatives"]]
        return {"schema": 1, "summary": self.headline(), **own}

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the difference of every quantity of the model, each tried alone, as columns; SI units."""
        rows = [asdict(own) for own in self.tested]
        return {key: [row[key] for row in rows] for key in rows[0]}


def compare_sets(
    model: Model, first: Recordings, second: Recordings, *, progress: Say | None = None
) -> SetComparison:
    """Compare two sets of recordings under one model: what changed between two benches, days or firmware versions.

    All coefficients of the model and all uncertain bench parameters are fitted to both sets together. Then each of
    them, and each effect that the model lacks, may differ between the sets.

    Parameters
    ----------
    model : Model
        The model.
    first, second : Recording, path or list
        The two sets; the machines may be different ones of one bench.
    progress : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If a recording cannot be read or is in both sets, or they have too little steady motion, or columns that cannot
        be what they are called.
    """
    own, its = opened_apart(first, second)
    for given in (own, its):
        refuse_wrong_setups(given, model.details, mixed=True)
    return SetComparison.of(two_sets.compare_sets(model.details, data(own), data(its), progress=progress))
