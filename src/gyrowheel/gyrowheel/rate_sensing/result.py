"""Rates of the case, with the wheel used as a rate sensor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.show.result import Result

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel_analysis.rate_sensor import Line
    from gyrowheel_analysis.rate_sensor import Rates as Details


@dataclass(frozen=True, repr=False)
class Rates(Result):
    """Outcome of `gyrowheel.rate`.

    Attributes
    ----------
    details : gyrowheel_analysis.rate_sensor.Rates
        The result of the analysis package, in full.
    """

    details: Details

    @property
    def time(self) -> NDArray[np.float64]:
        """Middle of every steady window, since the start of its recording [s], shape (n,)."""
        return self.details.time

    @property
    def rate(self) -> NDArray[np.float64]:
        """Rate of the case in inertial space about its x and y axes [rad/s], shape (n, 2)."""
        return self.details.rate

    @property
    def standard_error(self) -> NDArray[np.float64]:
        """Standard error of `rate` from noise and drift [rad/s], shape (n, 2)."""
        return self.details.standard_error

    @property
    def reference(self) -> NDArray[np.float64]:
        """Commanded rate of the rate table about the same axes [rad/s], shape (n, 2)."""
        return self.details.reference

    @property
    def lines(self) -> tuple[Line | None, Line | None]:
        """Scale and bias of each axis against the table; None if the table hardly turned about it."""
        return self.details.lines

    def __str__(self) -> str:
        """Return range of the rates, and scale of the axes that were calibrated."""
        parts = [
            f"about {axis} {own.min():.4g} .. {own.max():.4g}"
            for axis, own in zip("xy", self.rate.T, strict=True)
        ]
        lines = [f"{len(self.time)} windows, rate [rad/s] {', '.join(parts)}"]
        lines += [
            f"  {axis}: scale {line.scale:.6g} ± {line.scale_error:.2g}, bias {line.bias:.3g} rad/s"
            for axis, line in zip("xy", self.lines, strict=True)
            if line is not None
        ]
        return "\n".join(lines)

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.rate_sensing.page import rates_page

        return rates_page(self.details)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel rate --json``; SI units."""
        return self.details.to_json()

    def to_columns(self) -> Mapping[str, NDArray[np.float64]]:
        """Return time [s], rates, standard errors and references [rad/s] as columns of shape (n,)."""
        columns = {"time": self.time}
        for name in ("rate", "standard_error", "reference"):
            for k, axis in enumerate("xy"):
                columns[f"{name}_{axis}"] = getattr(self, name)[:, k]
        return columns
