"""The angular momentum that a wheel can reach."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel.show.result import Result
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_sim.bench import Bench
    from gyrowheel_sim.mechanics.momentum import Envelope


@dataclass(frozen=True, repr=False)
class Momentum(Result):
    """Outcome of `gyrowheel.momentum`.

    Attributes
    ----------
    details : gyrowheel_sim.mechanics.momentum.Envelope
        Momentum over spin rates, tilts and azimuths, arrays; exact and by eqs (1) and (2) of Huo et al. 2016.
    bench : gyrowheel_sim.bench.Bench
        The bench.
    """

    details: Envelope
    bench: Bench

    @property
    def along(self) -> tuple[float, float]:
        """Least and most momentum along the case axis [N·m·s]."""
        along = self.details.approximate[..., 2]
        return float(along.min()), float(along.max())

    @property
    def across(self) -> float:
        """Most momentum across the case axis [N·m·s], reached in every direction."""
        return float(np.linalg.norm(self.details.approximate[..., :2], axis=-1).max())

    def __str__(self) -> str:
        """Return how much momentum can be reached, and how exact eq (1) is."""
        d = self.details
        low, high = self.along
        rates = sorted({f"{rate / RPM:.0f}": None for rate in d.speed[[0, -1]]}, key=float)
        lines = [
            f"{self.bench.name}: {low:.4g} to {high:.4g} N·m·s along the case axis, up to {self.across:.3g} across it",
            f"  at {' to '.join(rates)} rpm and tilts up to {d.tilt[-1] / DEG:.3g}°; "
            f"eq (1) is within {100.0 * float(d.error_last.max()):.2g} %",
        ]
        return "\n".join(lines)

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.momentum_envelope.page import momentum_page

        return momentum_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel momentum --json``; SI units.

        Lists over spin rates, over tilts, or over both: one azimuth stands for all.
        """
        d = self.details
        return {
            "schema": 1,
            "bench": self.bench.name,
            "spin_rate": d.speed.tolist(),
            "tilt": d.tilt.tolist(),
            "along_axis": d.approximate[:, :, 0, 2].tolist(),
            "across_axis": np.linalg.norm(d.approximate[:, :, 0, :2], axis=-1).tolist(),
            "exact_smallest": d.smallest[:, :, 0].tolist(),
            "exact_largest": d.largest[:, :, 0].tolist(),
            "error_last_form": d.error_last.tolist(),
            "error_middle_expression": d.error_middle.tolist(),
        }

    def to_columns(self) -> Mapping[str, Any]:
        """Return spin rate [rad/s], tilt, azimuth [rad] and momenta in case axes [N·m·s], a row for each state."""
        d = self.details
        states = np.meshgrid(d.speed, d.tilt, d.azimuth, indexing="ij")
        columns = dict(
            zip(("spin_rate", "tilt", "azimuth"), (state.ravel() for state in states), strict=True)
        )
        for name, values in (("h", d.approximate), ("exact_mean", d.exact_mean)):
            columns |= {f"{name}_{axis}": values[..., k].ravel() for k, axis in enumerate("xyz")}
        return columns | {"exact_smallest": d.smallest.ravel(), "exact_largest": d.largest.ravel()}

    def plot(self, what: str = "caps") -> Figure:
        """Return a picture as a matplotlib figure.

        Parameters
        ----------
        what : str
            ``caps``: the momenta at single spin rates, and what eq (1) leaves out (Fig. 3). ``body``: all momenta
            between the lowest and the highest spin rate (Fig. 4).

        Raises
        ------
        InputError
            If there is no such picture, or there is one spin rate alone for the body.
        """
        from gyrowheel.momentum_envelope.picture import body_figure, caps_figure

        if what not in ("caps", "body"):
            raise InputError(f"momentum: picture '{what}' is not known; allowed: caps, body")
        if what == "caps":
            return caps_figure(self.bench, self.details.speed)
        if len(self.details.speed) < 2:
            raise InputError("momentum: the body of all momenta needs two spin rates or more; one is given")
        return body_figure(self.bench, self.details.speed)
