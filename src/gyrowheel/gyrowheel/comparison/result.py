"""The error of a model on recordings, and where it is large."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from gyrowheel.show.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel_analysis.compare import ChannelMetrics
    from gyrowheel_analysis.compare import Comparison as Details
    from gyrowheel_analysis.residuals.maps import ResidualMap
    from gyrowheel_analysis.residuals.regions import Region
    from gyrowheel_recording.mislabelled.fixes import WrongSetup


@dataclass(frozen=True, repr=False)
class Comparison(Result):
    """Outcome of `gyrowheel.compare`.

    Attributes
    ----------
    details : gyrowheel_analysis.compare.Comparison
        The result of the analysis package, in full.
    setup : tuple of WrongSetup
        Columns that cannot be what they are called; then nothing else here is worth anything.
    """

    details: Details
    setup: tuple[WrongSetup, ...] = ()

    @property
    def channels(self) -> Mapping[str, ChannelMetrics]:
        """Errors by channel: ``.rms`` and ``.noise_floor_rms`` in N·m or V, ``.chi2_per_n`` (1: noise) and more."""
        return MappingProxyType(self.details.channels)

    @property
    def raw_rms(self) -> Mapping[str, float]:
        """RMS error by channel without fitting anything [N·m or V]."""
        return MappingProxyType(self.details.raw_rms)

    @property
    def worst(self) -> float:
        """Largest χ²/N of all channels; 1 is noise alone."""
        return max(metrics.chi2_per_n for metrics in self.channels.values())

    @property
    def fails(self) -> bool:
        """Whether the error of any channel is significantly above the noise."""
        from gyrowheel.comparison.page import fails

        return fails(self.details)

    @property
    def where(self) -> tuple[Region, ...]:
        """Regions where the model fails, worst first, each with ``.share_of_chi2``."""
        return self.details.where

    @property
    def recordings(self) -> tuple[str, ...]:
        """Paths of the recordings."""
        return self.details.recordings

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
        from gyrowheel_analysis.residuals.maps import residual_map

        return residual_map(self.details.data, map_variables(",".join(over)))

    def __str__(self) -> str:
        """Return χ²/N of every channel, and where the model fails."""
        from gyrowheel.show.sentences.residuals import region_name

        head = "The model fails" if self.fails else "The model explains these recordings to their noise"
        chi2 = ", ".join(f"{name} {metrics.chi2_per_n:.3g}" for name, metrics in self.channels.items())
        lines = [f"{head}; χ²/N (1: noise): {chi2}"]
        if self.fails:
            lines += [
                f"  {100.0 * region.share_of_chi2:.0f} % of χ²: {region_name(region)}"
                for region in self.where[:3]
            ]
        return "\n".join(lines)

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from rich.panel import Panel
        from rich.text import Text

        from gyrowheel.comparison.page import channel_table, failures

        verdict = "The model fails." if self.fails else "The model explains these recordings to their noise."
        yield Panel(Text(verdict, style="bold"), border_style="red" if self.fails else "green")
        yield channel_table(self.details)
        yield from failures(self.details.where, self.details.dependence, failing=self.fails)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel compare --json``; SI units."""
        from gyrowheel.show.contract import comparison_json, setup_json

        return comparison_json(self.details) | {"setup": setup_json(self.setup)}

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the errors as columns, a row for each channel; RMS in N·m or V."""
        from dataclasses import asdict

        rows = [
            {"channel": name, **asdict(metrics), "raw_rms": self.raw_rms[name]}
            for name, metrics in self.channels.items()
        ]
        return {key: [row[key] for row in rows] for key in rows[0]}

    def plot(self) -> Figure:
        """Return the picture of where the model fails as a matplotlib figure."""
        from gyrowheel.comparison.picture import figure_of_failure

        return figure_of_failure(self.details)


def map_variables(text: str) -> tuple[str, ...]:
    """Return the variables of a map, given as ``speed`` or ``speed,tilt``; InputError if there is no such map."""
    from gyrowheel_analysis.residuals.maps import variables_of

    return variables_of(text)
