"""A model of the wheel: a bench, the effects added to it, and the history of these changes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gyrowheel.recordings.api import refuse_wrong_setups
from gyrowheel.recordings.inputs import Recordings, Say, data, opened, opened_apart, require_one_machine
from gyrowheel.show.result import Shown, columns_of
from gyrowheel_analysis.model import Model as Details
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel.models.addition import Addition
    from gyrowheel.models.estimation import Fit
    from gyrowheel_analysis.diagnosis.correction_map import CorrectionMap
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_analysis.model import Override
    from gyrowheel_sim.bench import Bench
    from gyrowheel_sim.effects import Effect


class Model(Shown):
    """A bench with added effects and estimated parameter values; immutable: every change makes a new model.

    Parameters
    ----------
    bench : str or Path
        Shipped name of a bench (``gyrowheel``, ``dtg``) or path of a bench file. The model has no effects.

    Raises
    ------
    InputError
        If there is no such bench, or its file has errors.
    """

    def __init__(self, bench: str | Path = "gyrowheel") -> None:
        # any other type would become the name of a missing file
        self._details = Details.new(str(bench) if isinstance(bench, Path) else bench)
        self._added: Addition | None = None

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Read a model file.

        Raises
        ------
        InputError
            If the file is missing, is not a model file, or a field is missing, unknown or out of range.
        """
        return cls.of(Details.load(path))

    @classmethod
    def of(cls, details: Details, added: Addition | None = None) -> Model:
        """Return the model around one of the analysis package."""
        made = cls.__new__(cls)
        made._details, made._added = details, added
        return made

    @property
    def details(self) -> Details:
        """The model as the packages below have it."""
        return self._details

    @property
    def bench(self) -> Bench:
        """The bench with the parameter values estimated from recordings."""
        return self._details.bench

    @property
    def stated_bench(self) -> Bench:
        """The bench as its file describes it."""
        return self._details.stated_bench

    @property
    def bench_source(self) -> str:
        """Shipped name of the bench or path of its file, usable from the working directory."""
        file = Path(self._details.origin).parent / self._details.bench_source
        return str(file) if file.is_file() else self._details.bench_source

    @property
    def effects(self) -> Mapping[str, Mapping[str, float]]:
        """Effects with their coefficients [SI]: {effect: {coefficient: value}}."""
        return {name: dict(values) for name, values in self._details.effects.items()}

    @property
    def effect_errors(self) -> Mapping[str, Mapping[str, float]]:
        """Standard errors of the coefficients [SI]: {effect: {coefficient: standard error}}."""
        return {name: dict(values) for name, values in self._details.effect_errors.items()}

    @property
    def parameters(self) -> Mapping[str, Override]:
        """Bench parameters estimated from recordings [SI], each with ``.value`` and ``.standard_error``."""
        return dict(self._details.overrides)

    @property
    def history(self) -> tuple[Mapping[str, Any], ...]:
        """Every change, oldest first: time, what, recordings, errors before and after."""
        return tuple(dict(entry) for entry in self._details.history)

    @property
    def origin(self) -> str:
        """File that it was read from; ``model`` if it was not read from one."""
        return self._details.origin

    @property
    def added(self) -> Addition | None:
        """Outcome of the `add` that made this model; None for a model made in another way."""
        return self._added

    def add(
        self,
        what: Diagnosis | CorrectionMap | str | Effect | Sequence[str | Effect],
        *,
        fit: Recordings,
        validate: Recordings = (),
        mixed: bool = False,
        progress: Say | None = None,
    ) -> Model:
        """Return a new model with further effects, refitted.

        Parameters
        ----------
        what : Diagnosis, CorrectionMap, str, Effect or a sequence of these two
            A diagnosis: all effects that it found, or its map where it found no law. A map is the missing torque as a
            smooth function: that of a diagnosis (``found.map``), or ``map`` for one that is fitted now. A name is that
            of an effect (`gyrowheel.effects`) or of the error of a bench parameter (``stiffness_error`` and the like);
            ``aero:MODEL`` stands for all effects of an air model. `gyrowheel.own_effect` makes one from a formula.
        fit : Recording, path or list
            Recordings on which coefficients and bench parameters are fitted.
        validate : Recording, path or list, optional
            Recordings that are only predicted.
        mixed : bool
            Join recordings that state different machines.
        progress : callable, optional
            Called with a line of text now and then.

        Returns
        -------
        Model
            The new model; `added` has its errors before and after, `history` has one more entry.

        Raises
        ------
        InputError
            If an effect is unknown or already in the model, the diagnosis names nothing or cannot decide, no map
            predicts data that are left out, or the recordings have too little steady motion.
        """
        from gyrowheel.models.addition import Addition
        from gyrowheel_analysis.add import add_effect, add_map

        mapped = _map_of(what)
        chosen = [] if mapped is not None else _chosen(what)  # type: ignore[arg-type]
        for item in chosen:
            if isinstance(item, str):
                require_known(item)
        fitted, unused = opened_apart(fit, validate)
        require_one_machine(data([*fitted, *unused]), mixed=mixed)
        refuse_wrong_setups([*fitted, *unused], self._details, mixed=mixed)
        own, others = data(fitted), data(unused)
        if mapped is None:
            found = add_effect(self._details, chosen, own, others, progress=progress)
        else:
            given = None if isinstance(mapped, str) else mapped
            found = add_map(self._details, own, others, given, progress=progress)
        return Model.of(found.model, Addition.of(found))

    def fit(
        self,
        recordings: Recordings,
        *,
        free: str | Sequence[str] | None = None,
        fixed: str | Sequence[str] = (),
        priors: Mapping[str, tuple[float, float] | None] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        loss: str = "linear",
        mixed: bool = False,
        progress: Say | None = None,
    ) -> Fit[Model]:
        """Estimate parameters of the model from recordings; the user decides which.

        Parameters
        ----------
        recordings : Recording, path or list
            Recordings of one machine.
        free, fixed : str or sequence of str, optional
            Parameters to estimate, all unless given; and those of them to hold at the model's value. ``windage.w`` is
            a coefficient, ``windage`` all coefficients of an effect, ``bench`` all uncertain bench parameters; ``*``
            stands for any letters.
        priors : mapping, optional
            {parameter: (mean, standard deviation)} [SI], or {parameter: None} for no prior. Unless given, bench
            parameters have their stated uncertainty, and exponents that of their declaration.
        bounds : mapping, optional
            {parameter: (lowest, highest)} [SI].
        loss : str
            ``linear`` (least squares), or ``soft_l1``, ``huber``, ``cauchy`` for noise with heavy tails.
        mixed : bool
            Join recordings that state different machines.
        progress : callable, optional
            Called with a line of text now and then.

        Returns
        -------
        Fit
            Estimates, covariance, profiles, criteria and residuals; ``.model`` is a new model that has the estimates.

        Raises
        ------
        InputError
            If a name, prior or bound is not allowed, the recordings have too little steady motion, or they do not
            determine a free parameter.
        """
        from dataclasses import replace

        from gyrowheel.models.estimation import Fit, Matrix
        from gyrowheel_analysis.estimation.estimate import estimate

        given = opened(recordings)
        require_one_machine(data(given), mixed=mixed)
        refuse_wrong_setups(given, self._details, mixed=mixed)
        found = estimate(
            self._details,
            data(given),
            free=free,
            fixed=fixed,
            priors=priors,
            bounds=bounds,
            loss=loss,
            progress=progress,
        )
        labelled = Matrix(found.covariance.names, found.covariance.values)
        return Fit.of(replace(found, covariance=labelled), model=Model.of(found.fitted))

    def remove(self, *names: str) -> Model:
        """Return a new model without the named effects; the other coefficients keep their values.

        Raises
        ------
        InputError
            If the model does not have one of them.
        """
        from datetime import UTC, datetime

        details = self._details
        now = datetime.now(UTC).isoformat(timespec="seconds")
        for name in names:
            details = details.removed(name, now)
        return Model.of(details)

    def undo(self) -> Model:
        """Return the model as it was before its last change.

        Raises
        ------
        InputError
            If there is nothing to undo.
        """
        return Model.of(self._details.undone())

    def diff(self, other: Model) -> list[str]:
        """Return the differences between this model and `other`, one line each."""
        return self._details.diff(other.details)

    def save(self, path: str | Path) -> None:
        """Write the model file atomically: a failure leaves the old file.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        self._details.save(path)

    def export(self, path: str | Path, format: str | None = None) -> None:
        """Write the plant, without noise, for other programs; the controller and the plan are theirs.

        Parameters
        ----------
        path : str or Path
            File to write.
        format : str, optional
            ``python``: a module (.py) that needs NumPy alone. ``fmu``: a functional mock-up unit (.fmu, FMI 2.0 for
            co-simulation), which runs that module. By default the ending of the path decides.

        Raises
        ------
        InputError
            If the format is not known or not that of the path, its package is not installed, or the file cannot be
            written.
        """
        from gyrowheel.models.export import export

        export(self._details, Path(path), format)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the model file."""
        return self._details.to_mapping()

    def to_columns(self) -> Mapping[str, list[Any]]:
        """Return the coefficients as columns: effect, coefficient, value, standard_error [SI]."""
        return columns_of(
            "effect coefficient value standard_error",
            (
                (name, key, value, self._details.effect_errors.get(name, {}).get(key, 0.0))
                for name, values in self._details.effects.items()
                for key, value in values.items()
            ),
        )

    def plot(self) -> Figure:
        """Return the picture of the error before and after the `add` that made this model.

        Raises
        ------
        InputError
            If the model was made in another way.
        """
        if self._added is None:
            raise InputError(f"{self.origin}: has no error before and after to draw: it was not made by add")
        return self._added.plot()

    def headline(self) -> str:
        """Return bench and names of the effects."""
        return f"{self._details.bench_source}; {', '.join(self._details.effects) or 'no effects'}"

    def page(self) -> Iterable[RenderableType]:
        """Return effects, parameters estimated from recordings, and history."""
        from gyrowheel.models.page import model_page

        return model_page(self._details)


def effects_to_add(found: Diagnosis) -> list[str | Effect]:
    """Return the effects of a diagnosis for `Model.add`; InputError as of `gyrowheel.Diagnosis.to_add`."""
    from gyrowheel.show.sentences.diagnosis import verdict_sentence
    from gyrowheel_sim.effects import effect_from_mapping

    for own, ties in found.ties.items():
        if ties:
            names = ", ".join((own, *(tie.name for tie in ties)))
            test = (
                "" if found.next_test is None else f", or run plan {found.next_test.plan} and diagnose again"
            )
            raise InputError(
                f"diagnosis: the recordings cannot decide between {names}; name the effect to add{test}"
            )
    if found.verdict == "unknown" and not found.free_form and found.map is not None:
        raise InputError("diagnosis: no law to add, but a map: give found.map to Model.add")
    if found.verdict == "unknown" and not found.free_form:
        raise InputError(f"diagnosis: nothing to add: {verdict_sentence(found)}")
    chosen: list[str | Effect] = list(found.ties)
    chosen += [effect_from_mapping(f.name, f.declaration, "diagnosis.free_form") for f in found.free_form]
    if not chosen:
        raise InputError(f"diagnosis: nothing to add, its verdict is {found.verdict}")
    return chosen


def _map_of(what: object) -> CorrectionMap | Literal["map"] | None:
    """Return the map that is to be added, ``map`` for one that is still to be fitted; None for anything else."""
    from gyrowheel_analysis.diagnosis.correction_map import NAME, CorrectionMap
    from gyrowheel_analysis.diagnosis.result import Diagnosis

    if isinstance(what, Diagnosis):
        return what.map if what.verdict == "unknown" and not what.free_form else None
    every = [what] if isinstance(what, str) or not isinstance(what, Sequence) else list(what)
    maps = [item for item in every if item == NAME or isinstance(item, CorrectionMap)]
    if maps and len(every) > 1:
        raise InputError("effect: a map is fitted to all that is missing; add it alone")
    return maps[0] if maps else None  # type: ignore[return-value]


def _chosen(what: Diagnosis | str | Effect | Sequence[str | Effect]) -> list[str | Effect]:
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_sim.effects import Effect

    if isinstance(what, Diagnosis):
        return effects_to_add(what)
    chosen = [what] if isinstance(what, str | Effect) else list(what)
    if not chosen:
        raise InputError("nothing to add: name an effect, or give a formula")
    return chosen


def require_known(name: str) -> None:
    """Refuse a name that is neither an effect nor an air model nor the error of a bench parameter."""
    from gyrowheel_analysis.add import is_air
    from gyrowheel_analysis.fitting.fit import ERRORS
    from gyrowheel_sim.effects import get

    if name not in ERRORS and not is_air(name):
        get(name)
