"""Where a model fails: errors of each channel, regions, and what the residual depends on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from gyrowheel_bringup.render.errors import CHANNELS
from gyrowheel_bringup.render.layout import figures_table, heading, sentences, words_table
from gyrowheel_bringup.render.quantities import fixed, torque_edge

if TYPE_CHECKING:
    from gyrowheel_analysis.compare import Comparison
    from gyrowheel_analysis.where import Region

_MOST_REGIONS = 5
_SUSPICIOUS = 1.3  # mean square of the residuals in units of their noise
_LEGEND = (
    "FIT: part of the signal explained. Theil: 0 perfect, 1 useless; its parts say whether the error is a constant "
    "(bias), a wrong size (var.) or a wrong shape (cov.). Raw: RMS of the model file as it stands, nothing fitted."
)


def comparison(result: Comparison) -> Iterator[RenderableType]:
    """Yield what a comparison says, part by part."""
    yield heading("How well the model predicts, with the bench's parameters within their uncertainties")
    yield channel_table(result)
    yield Text(_LEGEND, style="dim")
    yield from failures(result.where, result.dependence, failing=fails(result))


def channel_table(result: Comparison) -> Table:
    """Return the metrics of every channel."""
    shown = torque_edge(m.noise_floor_rms for m in result.channels.values())
    table = figures_table(
        "",
        f"RMS\n{shown.label}",
        f"noise\n{shown.label}",
        "χ²/N\n",
        "FIT\n%",
        "Theil\n",
        "bias\n%",
        "var.\n%",
        "cov.\n%",
        f"raw\n{shown.label}",
    )
    table.columns[0].no_wrap = True
    for name, title in CHANNELS.items():
        m = result.channels[name]
        table.add_row(
            title,
            fixed(m.rms / shown.size),
            fixed(m.noise_floor_rms / shown.size),
            Text(fixed(m.chi2_per_n), style="bold red" if m.chi2_per_n > 2.0 else "green"),
            fixed(m.fit_percent),
            f"{m.theil:.4f}",
            *(f"{100.0 * part:.0f}" for part in (m.theil_bias, m.theil_variance, m.theil_covariance)),
            fixed(result.raw_rms[name] / shown.size),
        )
    return table


def fails(result: Comparison) -> bool:
    """Whether the error of a channel is visibly more than noise."""
    return max(metrics.chi2_per_n for metrics in result.channels.values()) > _SUSPICIOUS


def failures(
    where: Iterable[Region], dependence: Iterable[str] = (), *, failing: bool = True
) -> Iterator[RenderableType]:
    """Yield the regions where the model fails, and on what the residual depends."""
    regions = list(where)
    if regions:
        yield heading(
            "Where it fails" if failing else "Nowhere does it fail visibly; most of the noise is here"
        )
        table = words_table("share of χ²", "where", "how")
        table.columns[0].justify = "right"
        for region in regions[:_MOST_REGIONS]:
            table.add_row(f"{100.0 * region.share_of_chi2:.0f} %", region.region, region.description)
        yield table
    yield from sentences(dependence)
