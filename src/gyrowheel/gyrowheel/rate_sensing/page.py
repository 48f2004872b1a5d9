"""Rates of the case and the calibration of the wheel as a rate sensor."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.show.layout import figures_table, heading, indented, sentences
from gyrowheel_analysis.rate_sensor import Rates
from gyrowheel_core.quantities import pair, short
from gyrowheel_core.units import DEG


def rates_page(result: Rates) -> Iterator[RenderableType]:
    """Yield the rates, window by window, and the calibration of each axis where the table turned."""
    yield heading("Rate of the case in inertial space")
    table = figures_table(
        "time\ns", "about x\ndeg/s", "reference\ndeg/s", "about y\ndeg/s", "reference\ndeg/s"
    )
    for time, rate, error, reference in zip(
        result.time, result.rate, result.standard_error, result.reference, strict=True
    ):
        cells = []
        for k in range(2):
            cells += [pair(rate[k] / DEG, error[k] / DEG), short(reference[k] / DEG)]
        table.add_row(f"{time:.1f}", *cells)
    yield indented(table)
    yield Text()
    if any(result.lines):
        yield heading("Calibration against the rate table")
        axes = figures_table("axis", "scale", "bias\ndeg/h", "residual RMS\ndeg/h")
        for name, line in zip("xy", result.lines, strict=True):
            if line is not None:
                hour = DEG / 3600.0
                axes.add_row(
                    f"about {name}",
                    pair(line.scale, line.scale_error),
                    pair(line.bias / hour, line.bias_error / hour),
                    short(line.rms / hour, 2),
                )
        yield indented(axes)
        yield Text()
    else:
        yield from sentences(
            ["the rate table hardly turned: nothing to calibrate against (plan rate_table turns it)"]
        )
