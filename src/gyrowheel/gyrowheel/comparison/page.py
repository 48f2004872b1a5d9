"""Errors of each channel, the regions where a model fails, and the variables of the residual."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import RenderableType
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from gyrowheel.show.error_table import unit_of
from gyrowheel.show.formulas import is_pure
from gyrowheel.show.layout import commands, figures_table, heading, sentences, words_table
from gyrowheel.show.sentences.findings import event_sentences, reading_sentence, untold_sentences
from gyrowheel.show.sentences.residuals import (
    TITLES,
    dependence_sentences,
    probability,
    region_description,
    region_name,
)
from gyrowheel.show.sentences.setup import misstated_sentence
from gyrowheel_analysis.channels import CHANNELS, LISTED
from gyrowheel_analysis.residuals.maps import DEFAULT
from gyrowheel_core.quantities import decimal, fixed, quantity, with_error
from gyrowheel_core.units import DEG, RPM, unit_for

if TYPE_CHECKING:
    from gyrowheel_analysis.compare import Comparison
    from gyrowheel_analysis.compare_models import ModelComparison, ModelSide
    from gyrowheel_analysis.compare_sets import Difference, SetComparison
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_analysis.reduction.windows import Coverage
    from gyrowheel_analysis.residuals.dependence import PartDependence
    from gyrowheel_analysis.residuals.error_table import WindowResiduals
    from gyrowheel_analysis.residuals.maps import Region, ResidualMap, Span

_MOST_REGIONS = 5
_NO_SIGNAL = 1.0  # FIT of a channel in which there is nothing but noise [%]
_MAP_LEGEND = (
    "Mean residual torque: of the coils along the tilt and a quarter turn ahead of it, and of the motor."
)
_POOR, _BAD = 2.0, 5.0  # χ²/N
_SAME_SPEED = 0.04
_SHORT = {
    "tilt": "tilt", "spin": "spin",
    "tilt_1n": "1N", "tilt_2n": "2N", "angle_1n": "a1N", "angle_2n": "a2N",
    "spin_ripple": "rip", "motor_voltage": "volt", "voltage_ripple": "vrip",
}  # fmt: skip
_LEGEND = (
    "RMS and noise: windows weighted by 1/noise². χ²/N: (RMS/noise)²; of tilt, spin and voltage once the slow drift "
    "is taken out that windows share. FIT: part of the signal explained. Theil: 0 perfect, 1 useless; its parts: a "
    "constant offset (bias), a wrong amplitude (var), a wrong shape (cov). Raw: RMS with the unchanged model file, "
    "nothing fitted."
)


def verdict(result: Comparison) -> str:
    """Return in a sentence without its stop whether the model fails."""
    return "The model fails" if result.fails else "The model explains these recordings to their noise"


def comparison_page(
    result: Comparison, maps: Iterable[ResidualMap] | None = None
) -> Iterator[RenderableType]:
    """Yield a comparison, part by part.

    Without `maps` a map over speed and tilt is shown where the model fails.
    """
    colour = "red" if result.fails else "green"
    for item in result.misstated:
        yield Text(f"{misstated_sentence(item, result.model)}.", style="bold red")
    yield Panel(Text(f"{verdict(result)}.", style="bold"), border_style=colour, expand=False)
    yield heading("Prediction error, bench parameters fitted within their uncertainties")
    yield channel_table(result)
    yield Text(_LEGEND, style="dim")
    yield from coverage(result.coverage)
    if result.events:
        yield heading("Events in the recordings, taken out of the residual")
        several = len({*result.recordings, *(event.recording for event in result.events)}) > 1
        yield from sentences(event_sentences(result.events, several=several))
    yield from readings(result)
    yield from failures(result.where, result.dependence, failing=result.fails)
    for each in [m for m in result.maps if m.over == DEFAULT and result.fails] if maps is None else maps:
        yield from map_table(each, result)


def coverage(found: Coverage) -> Iterator[RenderableType]:
    """Yield how much of the recordings takes part; in yellow if it is not nearly all of their steady motion."""
    yield Text(f"{found.sentence()}.", style="dim" if found.complete else "yellow")


def readings(found: Comparison | Diagnosis) -> Iterator[RenderableType]:
    """Yield deviations of the instruments that the samples show."""
    if found.readings:
        yield heading("Instruments, by the samples themselves")
        yield from sentences([reading_sentence(item) for item in found.readings])
    for text in untold_sentences(found.hum_unknown):
        yield Text(text, style="dim")


def channel_table(result: Comparison) -> Table:
    """Return the metrics of every channel."""
    table = figures_table(
        "", "\nunit", "RMS\n", "noise\n", "χ²/N\n", "FIT\n%", "Theil\n", "bias var cov\n%  ", "raw\n"
    )
    table.columns[0].no_wrap = True
    table.columns[1].justify = "left"
    shown = unit_of({name: m.noise_floor_rms for name, m in result.channels.items()})
    for name, m in result.channels.items():
        unit = shown[name]
        table.add_row(
            LISTED[name].title,
            Text(unit.label, style="dim"),
            fixed(m.rms / unit.size),
            fixed(m.noise_floor_rms / unit.size),
            Text(fixed(m.chi2_per_n), style="bold red" if m.chi2_per_n > 2.0 else "green"),
            f"{m.fit_percent:.1f}" if m.fit_percent > _NO_SIGNAL else "–",
            f"{m.theil:.3f}",
            " ".join(f"{100.0 * part:3.0f}" for part in (m.theil_bias, m.theil_variance, m.theil_covariance)),
            fixed(result.raw_rms[name] / unit.size),
        )
    return table


def map_table(shown: ResidualMap, result: Comparison) -> Iterator[RenderableType]:
    """Yield a map as a table: over one variable with the mean residuals, over two with χ²/N of the parts that fail."""
    if len(shown.over) == 1:
        yield heading(f"Residual over the {TITLES[shown.over[0]]}")
        yield _list_of(shown, result.data)
        yield Text(_MAP_LEGEND, style="dim")
        return
    rows, columns = shown.over
    total = {
        name: sum(cell.count * cell.chi2_per_n[name] for cell in shown.cells)
        / sum(cell.count for cell in shown.cells)
        for name in result.data.parts
    }
    worst = max(total, key=lambda name: total[name])
    for name in [n for n in total if total[n] > 2.0] or [worst]:
        yield heading(f"χ²/N of {CHANNELS[name].title} over {TITLES[rows]} and {TITLES[columns]}")
        yield _grid_of(shown, name)


def _grid_of(shown: ResidualMap, part: str) -> Table:
    rows, columns = shown.over
    across = shown.along(columns)
    table = figures_table(_axis_title(rows), *(span_text(columns, span) for span in across))
    table.columns[0].justify, table.columns[0].no_wrap = "right", True
    cells = {(_key(c.spans[rows]), _key(c.spans[columns])): c for c in shown.cells}
    for row in shown.along(rows):
        line = [cells.get((_key(row), _key(span))) for span in across]
        table.add_row(
            span_text(rows, row),
            *(Text("·", style="dim") if cell is None else _chi2(cell.chi2_per_n[part]) for cell in line),
        )
    return table


def _list_of(shown: ResidualMap, data: WindowResiduals) -> Table:
    """Return a table of the cells along one variable."""
    (variable,) = shown.over
    # parts that are noise everywhere have no column
    parts = [
        name
        for name in data.parts
        if name in ("tilt", "spin") or max(cell.chi2_per_n[name] for cell in shown.cells) > _POOR
    ]
    name, size = unit_for(min(float(np.median(data.parts[part].sigma)) for part in ("tilt", "spin")), "N·m")
    table = figures_table(
        f"\n{_axis_title(variable)}",
        "\nno.",
        f"along\n{name}",
        f"across\n{name}",
        f"spin\n{name}",
        *(f"{'χ²/N' if part == parts[0] else ''}\n{_SHORT[part]}" for part in parts),
    )
    table.columns[0].justify, table.columns[0].no_wrap = "right", True
    for cell in shown.cells:
        values = (
            None if cell.turned is None else cell.turned.real,
            None if cell.turned is None else cell.turned.imag,
            cell.mean["spin"].real,
        )
        table.add_row(
            span_text(variable, cell.spans[variable]),
            str(cell.count),
            *("–" if value is None else decimal(value / size, 0, sign=True) for value in values),
            *(_chi2(cell.chi2_per_n[part]) for part in parts),
        )
    return table


def _key(span: Span) -> tuple[float, float] | None:
    return None if math.isnan(span.low) else (span.low, span.high)


def _chi2(value: float) -> Text:
    style = "bold red" if value > _BAD else "yellow" if value > _POOR else "green"
    return Text(f"{value:.0f}" if value >= 9.95 else f"{value:.1f}", style=style)


def _axis_title(variable: str) -> str:
    return {
        "tilt": "tilt °",
        "azimuth": "azimuth °",
        "speed": "rpm",
        "time": "time s",
        "temperature": "coils °C",
    }[variable]


def span_text(variable: str, span: Span) -> str:
    """Return the position of a cell in readable units."""
    if math.isnan(span.low):
        return "upright"
    if variable == "azimuth":
        return decimal(math.degrees(span.middle), 0)
    size, offset = {
        "tilt": (DEG, 0.0), "speed": (RPM, 0.0), "time": (1.0, 0.0), "temperature": (1.0, 273.15),
    }[variable]  # fmt: skip
    low, high = (span.low - offset) / size, (span.high - offset) / size
    digits = 1 if variable == "tilt" else 0
    if variable == "speed":
        low, high = round(low, -1), round(high, -1)
    a, b = decimal(low, digits), decimal(high, digits)
    return a if a == b or (variable == "speed" and high - low < _SAME_SPEED * high) else f"{a} .. {b}"


def failures(
    where: Iterable[Region], dependence: Iterable[PartDependence] = (), *, failing: bool = True
) -> Iterator[RenderableType]:
    """Yield the regions where the model fails, and the variables of the residual."""
    regions = list(where)
    if regions:
        yield heading(
            "Where the model fails"
            if failing
            else "The model fails nowhere visibly; most of the noise is here"
        )
        table = words_table("share of χ²", "where, and what the residual looks like", "")
        table.columns[0].justify = "right"
        for region in regions[:_MOST_REGIONS]:
            table.add_row(
                f"{100.0 * region.share_of_chi2:.0f} %",
                Text(region_name(region), style="bold"),
                region_description(region),
            )
        yield table
    yield from sentences(dependence_sentences(dependence))


def preference(result: ModelComparison) -> str:
    """Return which of two models the recordings prefer."""
    one, two = (_name(side, other) for side, other in _both(result))
    odds = f"natural log of the Bayes factor {decimal(abs(result.evidence), 1)}"
    if result.preferred == "none":
        test = "no plan of this bench separates them"
        if result.test is not None:
            test = f"run plan {result.test.plan} ({decimal(result.test.minutes, 1)} min): expected Δχ² " + (
                f"{result.test.expected_separation:.0f}"
            )
        return f"These recordings cannot decide between {one} and {two} ({odds}); {test}."
    better, worse = (one, two) if result.preferred == "first" else (two, one)
    side = result.first if result.preferred == "first" else result.second
    more = "" if side.explains else f" Neither explains them: {better} leaves χ²/N {fixed(side.chi2_per_n)}."
    return f"These recordings prefer {better} to {worse} ({odds}).{more}"


def models_page(result: ModelComparison) -> Iterator[RenderableType]:
    """Yield two models side by side, which one is preferred, and the test that decides."""
    names = [_name(side, other) for side, other in _both(result)]
    yield heading("χ²/N, coefficients fitted again")
    table = figures_table("", *names)
    for channel, value in result.first.channels.items():
        table.add_row(LISTED[channel].title, fixed(value), fixed(result.second.channels[channel]))
    table.add_row("all", *(fixed(side.chi2_per_n) for side, _ in _both(result)))
    table.add_row("all, as the file states", *(fixed(side.stated_chi2_per_n) for side, _ in _both(result)))
    yield Padding(table, (0, 0, 0, 2))
    yield heading("Coefficients")
    shown = words_table("", "", "", whole=(0, 1, 2))
    for name, (side, _) in zip(names, _both(result), strict=True):
        first = Text(name, style="cyan")
        for effect, values in side.coefficients.items():
            for key, e in values.items():
                number = with_error(e.value, e.standard_error, e.unit, pure=is_pure(effect, key))
                shown.add_row(first, f"{effect} {key}", number)
                first = Text()
        if not side.coefficients:
            shown.add_row(first, "no effects", "")
    yield Padding(shown, (0, 0, 0, 2))
    yield Text()
    yield Text(preference(result), style="bold")
    if result.test is not None:
        yield from commands(
            "Next", f"gyrowheel up --plan {result.test.plan} --record runs/{result.test.plan}"
        )


def _both(result: ModelComparison) -> tuple[tuple[ModelSide, ModelSide], tuple[ModelSide, ModelSide]]:
    return (result.first, result.second), (result.second, result.first)


def _name(side: ModelSide, other: ModelSide) -> str:
    """Return the name of a model: its file, or its effects where both have the same file."""
    effects = " + ".join(side.coefficients) or "no effects"
    return Path(side.name).name if side.name != other.name else effects


def change_sentence(result: SetComparison) -> str:
    """Return in a sentence what changed between two sets of recordings."""
    tried = f"{result.tried} differences were tried"
    if not result.changes:
        text = f"Nothing changed between the two sets beyond chance; {tried}."
    else:
        many = len(result.changes)
        what = "; ".join(_changed(d) for c in result.changes for d in c.differences)
        text = f"{many} {'thing' if many == 1 else 'things'} changed from the first set to the second: {what}; {tried}."
    if not result.explains:
        left = f"χ²/N {fixed(result.chi2_per_n)}"
        text += f" The model explains neither set ({left}): diagnose one of them first."
    return text


def _changed(own: Difference) -> str:
    """Return a difference in words."""
    effect, _, key = own.name.partition(".")
    step = with_error(own.difference, own.standard_error, own.unit, pure=is_pure(effect, key))
    return f"{own.name} by {'' if step.startswith('−') else '+'}{step}"


def sets_page(result: SetComparison) -> Iterator[RenderableType]:
    """Yield what changed between two sets, what else may explain it, and what would have shown of the rest."""
    colour = "yellow" if result.changes or not result.explains else "green"
    yield Panel(Text(change_sentence(result), style="bold"), border_style=colour, expand=False)
    yield from sentences([f"first set: {', '.join(result.first)}", f"second set: {', '.join(result.second)}"])
    if result.changes:
        yield heading("What changed")
        yield Padding(
            _differences([d for c in result.changes for d in c.differences], changed=True), (0, 0, 0, 2)
        )
        yield from sentences([text for c in result.changes for text in _alternatives(c.name, c.alternatives)])
    yield heading("Both sets together")
    facts = [
        f"χ²/N {fixed(result.common_chi2_per_n)} if nothing differs, {fixed(result.chi2_per_n)} with the changes",
        f"all quantities of the model different: χ² falls by {decimal(result.gain, 0)} with {result.degrees} that the "
        f"recordings determine (p {probability(result.p)})",
    ]
    yield from sentences(facts)
    changed = {d.name for c in result.changes for d in c.differences}
    if rest := [own for own in result.tested if own.name not in changed]:
        yield heading(
            "Quantities of the model, each different alone" if not result.changes else "The rest, each alone"
        )
        yield Padding(_differences(rest, changed=False), (0, 0, 0, 2))
        yield Text("visible: a smaller difference would not have been reported.", style="dim")


def _differences(rows: Iterable[Difference], *, changed: bool) -> RenderableType:
    """Return a table of differences: those that changed with both values, others with what is visible."""
    columns = ("first", "second", "difference") if changed else ("difference", "visible")
    table = words_table("", *columns, whole=range(len(columns) + 1))
    for own in rows:
        effect, _, key = own.name.partition(".")
        pure = is_pure(effect, key)
        values = [quantity(value, own.unit, pure=pure, digits=5) for value in (own.first, own.second)]
        step = with_error(own.difference, own.standard_error, own.unit, pure=pure)
        least = quantity(own.visible, own.unit, pure=pure, digits=2)
        table.add_row(Text(own.name, style="cyan"), *((*values, step) if changed else (step, least)))
    return table


def _alternatives(name: str, others: Iterable[tuple[str, float]]) -> list[str]:
    """Return what explains a change as well."""
    if not (near := list(others)):
        return []
    listed_ones = ", ".join(f"{other} (χ² {decimal(loss, 1)} worse)" for other, loss in near[:_MOST_REGIONS])
    return [f"in place of {name} may have changed: {listed_ones}"]
