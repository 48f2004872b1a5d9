"""The rate of the case, with the wheel as a two-axis rate sensor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from gyrowheel.models.api import Model
from gyrowheel.recordings.inputs import Recordings, Say, data, of_one_machine
from gyrowheel.show.result import Result
from gyrowheel_analysis import rate_sensor as facts

if TYPE_CHECKING:
    from rich.console import RenderableType


@dataclass(frozen=True, repr=False)
class Rates(Result, facts.Rates):
    """Outcome of `gyrowheel.rate`; the fields are those of `gyrowheel_analysis.rate_sensor.Rates`."""

    def headline(self) -> str:
        """Return number of windows and range of the rates."""
        parts = [
            f"about {axis} {own.min():.4g} .. {own.max():.4g}"
            for axis, own in zip("xy", self.rate.T, strict=True)
        ]
        return f"{len(self.time)} windows, rate [rad/s] {', '.join(parts)}"

    def page(self) -> Iterable[RenderableType]:
        """Return the rates window by window, and scale and bias of each axis where the table turned."""
        from gyrowheel.rate_sensing.page import rates_page

        return rates_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel rate --json``; SI units."""
        return self.to_json()

    def to_columns(self) -> Mapping[str, NDArray[Any]]:
        """Return time [s], rates, standard errors and references [rad/s] as columns of shape (n,)."""
        columns = {"time": self.time}
        for name in ("rate", "standard_error", "reference"):
            for k, axis in enumerate("xy"):
                columns[f"{name}_{axis}"] = getattr(self, name)[:, k]
        return columns


def rate(recordings: Recordings, model: Model, *, mixed: bool = False, progress: Say | None = None) -> Rates:
    """Use the wheel as a two-axis rate sensor: estimate the angular rate of the case.

    Where a rate table turned the rig (plan ``rate_table``), scale and bias of both axes are calibrated against it.

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings of one machine.
    model : Model
        The model whose torques are subtracted.
    mixed : bool
        Join recordings that state different machines.
    progress : callable, optional
        Called with a line of text now and then.

    Raises
    ------
    InputError
        If a recording cannot be read, or there is no steady motion in any.
    """
    given = of_one_machine(recordings, mixed=mixed)
    return Rates.of(facts.rates(data(given), model.details, progress=progress))
