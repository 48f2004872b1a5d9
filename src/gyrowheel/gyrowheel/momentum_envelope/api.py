"""Angular momentum that a wheel can reach."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel.catalogue.api import load_bench
from gyrowheel.models.api import Model
from gyrowheel.show.result import Result
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.mechanics.kinematics import Envelope, envelope

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

_MOST = 200  # spin rates


@dataclass(frozen=True, repr=False)
class Momentum(Result, Envelope):
    """Outcome of `gyrowheel.momentum`: momentum over spin rates, tilts and azimuths, exact and by eqs (1) and (2).

    The fields are those of `gyrowheel_sim.mechanics.kinematics.Envelope`; the equations are those of Huo et al. 2016.
    """

    def headline(self) -> str:
        """Return the range of the momentum, and the error of eq (1)."""
        low, high = self.along
        rates = " to ".join(dict.fromkeys(f"{rate / RPM:.0f}" for rate in self.speed[[0, -1]]))
        return (
            f"{self.bench.name}: {low:.4g} to {high:.4g} N·m·s along the case axis, up to {self.across:.3g} across it "
            f"at {rates} rpm and tilts up to {self.tilt[-1] / DEG:.3g}°; "
            f"eq (1) is within {100.0 * float(self.error_last.max()):.2g} %"
        )

    def page(self) -> Iterable[RenderableType]:
        """Return the momenta at every spin rate, and the error of eq (1) at every tilt."""
        from gyrowheel.momentum_envelope.page import momentum_page

        return momentum_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel momentum --json``; SI units.

        Lists over spin rates, over tilts, or over both; the values hold for every azimuth.
        """
        return {
            "schema": 1,
            "bench": self.bench.name,
            "spin_rate": self.speed.tolist(),
            "tilt": self.tilt.tolist(),
            "along_axis": self.approximate[:, :, 0, 2].tolist(),
            "across_axis": np.linalg.norm(self.approximate[:, :, 0, :2], axis=-1).tolist(),
            "exact_smallest": self.smallest[:, :, 0].tolist(),
            "exact_largest": self.largest[:, :, 0].tolist(),
            "error_last_form": self.error_last.tolist(),
            "error_middle_expression": self.error_middle.tolist(),
        }

    def to_columns(self) -> Mapping[str, Any]:
        """Return spin rate [rad/s], tilt, azimuth [rad] and momenta in case axes [N·m·s], a row for each state."""
        states = np.meshgrid(self.speed, self.tilt, self.azimuth, indexing="ij")
        columns = dict(
            zip(("spin_rate", "tilt", "azimuth"), (state.ravel() for state in states), strict=True)
        )
        for name, values in (("h", self.approximate), ("exact_mean", self.exact_mean)):
            columns |= {f"{name}_{axis}": values[..., k].ravel() for k, axis in enumerate("xyz")}
        return columns | {"exact_smallest": self.smallest.ravel(), "exact_largest": self.largest.ravel()}

    def plot(self, what: str = "caps") -> Figure:
        """Return a picture as a matplotlib figure.

        Parameters
        ----------
        what : str
            ``caps``: the momenta at single spin rates, and what eq (1) neglects (Fig. 3). ``body``: all momenta
            between the lowest and the highest spin rate (Fig. 4).

        Raises
        ------
        InputError
            If there is no such picture, or the body is asked for with a single spin rate.
        """
        from gyrowheel.momentum_envelope.picture import body_figure, caps_figure

        if what not in ("caps", "body"):
            raise InputError(f"momentum: picture '{what}' is not known; allowed: caps, body")
        if what == "caps":
            return caps_figure(self.bench, self.speed)
        if len(self.speed) < 2:
            raise InputError("momentum: the body of all momenta needs two spin rates or more; one is given")
        return body_figure(self.bench, self.speed)


def momentum(
    bench: str | Path | Bench | Model = "gyrowheel", *, spin_rate: float | Sequence[float] | None = None
) -> Momentum:
    """Return the angular momentum that a wheel can reach: eqs (1) and (2), Figs 3 and 4 of Huo et al. 2016.

    Parameters
    ----------
    bench : str, Path, Bench or Model
        Shipped name, bench file, bench, or a model, of which the estimated inertias are used.
    spin_rate : float or sequence, optional
        Spin rates [rad/s]; by default the highest of the bench, its reference, and one as far below the reference.

    Raises
    ------
    InputError
        If there is no such bench, or a spin rate is beyond its limits.
    """
    loaded = load_bench(bench.bench if isinstance(bench, Model) else bench)
    rates = None
    if spin_rate is not None:
        rates = np.unique(np.atleast_1d(np.asarray(spin_rate, dtype=np.float64)))
        if not 1 <= rates.size <= _MOST:
            raise InputError(f"spin_rate: {rates.size} values are given; allowed: 1 .. {_MOST}")
        low, high = loaded.value("spin_rate_minimum"), loaded.value("spin_rate_maximum")
        for rate in rates:
            if not low * (1.0 - 1e-9) <= rate <= high * (1.0 + 1e-9):
                raise InputError(
                    f"spin_rate: {rate / RPM:.6g} rpm is out of range; "
                    f"allowed: {low / RPM:.6g} .. {high / RPM:.6g} rpm"
                )
    return Momentum.of(envelope(loaded, rates))
