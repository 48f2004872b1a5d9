"""Outcome of fitting chosen parameters of a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from gyrowheel.show.result import Result, columns_of
from gyrowheel_analysis.estimation import result as facts
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from rich.console import RenderableType


#: The model of the front door, which imports this module.
ModelType = TypeVar("ModelType")


class Matrix(facts.Matrix):
    """A symmetric matrix whose rows and columns have names, as `gyrowheel_analysis.estimation.result.Matrix`."""

    def to_frame(self) -> pandas.DataFrame:
        """Return a data frame labelled by the names.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        return _pandas("to_frame").DataFrame(self.values, index=list(self.names), columns=list(self.names))


@dataclass(frozen=True, repr=False, eq=False)
class Fit(Result, facts.Estimation, Generic[ModelType]):
    """Outcome of `Model.fit`: estimates with priors, covariance, profiles, criteria and residuals.

    The fields are those of `gyrowheel_analysis.estimation.result.Estimation`, and one more.

    Attributes
    ----------
    model : Model
        A new model with the estimates, and an entry in its history.
    """

    covariance: Matrix
    model: ModelType

    @property
    def params(self) -> Mapping[str, facts.Parameter]:
        """All parameters by name, each with ``.value``, ``.standard_error``, ``.unit``, ``.prior``, ``.data``."""
        return self.parameters

    @property
    def errors(self) -> Mapping[str, float]:
        """Standard errors of the free parameters [SI]."""
        return {name: self.parameters[name].standard_error for name in self.names}

    @property
    def correlation(self) -> Matrix:
        """Correlation of the free parameters; ``.to_frame()`` as a data frame, as that of ``covariance``."""
        own = super().correlation
        return Matrix(own.names, own.values)

    def conf_interval(self, *names: str, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return profile intervals [SI] of free parameters, of all coefficients of effects unless named.

        Raises
        ------
        InputError
            If a parameter is unknown or fixed.
        """
        _require_level(level)
        return {name: self.interval(name, level) for name in names or self._effects()}

    def residuals(self) -> pandas.DataFrame:
        """Return every row with its residual as a data frame; its ``attrs["units"]`` has the units of the columns.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        frame = _pandas("residuals").DataFrame(self.table())
        frame.attrs["units"] = {
            "time": "s",
            "spin_rate": "rad/s",
            "tilt_x": "rad",
            "tilt_y": "rad",
            "whitened": "1",
            "leverage": "1",
        } | dict.fromkeys(("measured", "predicted", "residual", "noise", "prediction_error"), "column unit")
        return frame

    def headline(self) -> str:
        """Return the coefficients of the effects, or the free parameters, with their standard errors."""
        from gyrowheel.models.page import estimate_of

        names = self._effects()
        shown = ", ".join(f"{name} = {estimate_of(self.parameters[name])}" for name in names[:4])
        return shown + (f" and {len(names) - 4} more" if len(names) > 4 else "")

    def page(self) -> Iterable[RenderableType]:
        """Return the estimates with their priors, the channels, and the criteria."""
        from gyrowheel.models.page import fit_page

        return fit_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel model fit --json``; SI units."""
        return {
            "schema": 1,
            "recordings": list(self.recordings),
            "model": self.fitted.origin,
            "loss": self.loss,
            "parameters": {name: _json_of(own) for name, own in self.parameters.items()},
            "covariance": {"names": self.names, "values": self.covariance.values.tolist()},
            "chi2": self.chi2,
            "chi2_rows": self.chi2_rows,
            "rows": self.rows,
            "degrees_of_freedom": self.degrees_of_freedom,
            "channels": {name: {"chi2": chi2, "rows": n} for name, (chi2, n) in self.channels.items()},
            "log_likelihood": self.log_likelihood,
            "log_evidence": self.log_evidence,
            "aic": self.aic,
            "bic": self.bic,
        }

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the parameters as columns, a row for each; SI units."""
        return columns_of(
            "parameter value standard_error unit free start prior_mean prior_deviation data_value data_error",
            (
                (
                    p.name,
                    p.value,
                    p.standard_error,
                    p.unit,
                    p.free,
                    p.start,
                    *(p.prior or (None,) * 2),
                    *(p.data or (None,) * 2),
                )
                for p in self.parameters.values()
            ),
        )

    def plot(self, *names: str) -> Figure:
        """Return a picture: of one parameter its profile, of two their contours, of none the correlation matrix.

        Raises
        ------
        InputError
            If a parameter is unknown or fixed, or more than two are named.
        """
        from gyrowheel.models.estimation_picture import contour_figure, correlation_figure, profile_figure

        if len(names) > 2:
            raise InputError(f"plot: {len(names)} parameters are named; allowed: up to 2")
        if len(names) == 2:
            return contour_figure(self, names[0], names[1])
        return profile_figure(self, names[0]) if names else correlation_figure(self)

    def _effects(self) -> list[str]:
        return [name for name in self.names if "." in name] or self.names


def _pandas(what: str) -> Any:
    try:
        import pandas
    except ImportError:
        raise InputError(f"{what}: needs pandas, which is not installed: pip install pandas") from None
    return pandas


def _json_of(own: facts.Parameter) -> dict[str, Any]:
    import math

    return {
        "value": own.value,
        "standard_error": own.standard_error,
        "unit": own.unit,
        "free": own.free,
        "start": own.start,
        "prior": None
        if own.prior is None
        else {"mean": own.prior.mean, "standard_deviation": own.prior.deviation},
        "bounds": [None if math.isinf(end) else end for end in own.bounds],
        "at_bound": own.at_bound,
        "data": None if own.data is None else {"value": own.data[0], "standard_error": own.data[1]},
    }


def _require_level(level: float) -> None:
    if not 0.0 < level < 1.0:
        raise InputError(f"level: {level} is out of range; allowed: between 0 and 1")
