"""Pages of HTML: templates, the one style of all pages, and numbers marked with their place in the JSON."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from importlib import resources
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from gyrowheel_core.errors import visible
from gyrowheel_core.files import json_text
from gyrowheel_core.quantities import decimal, fixed, pair, short
from gyrowheel_core.units import Unit, unit_for

if TYPE_CHECKING:
    import jinja2

#: Beginning of a report: of a page of HTML, and of one in Markdown.
REPORT_MARKS = ('<meta name="generator" content="gyrowheel">', "<!-- report of gyrowheel -->")
#: Title of a report as PDF.
REPORT_TITLE = "gyrowheel report"
_OWN = "gyrowheel.show"
#: Standard errors to both sides that hold a normal variate in 95 of 100 cases.
INTERVAL = 1.96
_PLAIN = Unit("", 1.0)


@functools.cache
def environment(*packages: str) -> jinja2.Environment:
    """Return the template reader of packages, in order of precedence; values are escaped."""
    import jinja2

    return jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [jinja2.FunctionLoader(functools.partial(template_text, own)) for own in (*packages, _OWN)]
        ),
        autoescape=True,
        finalize=_shown,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _shown(value: Any) -> Any:
    """Return what a template is given; texts of users without characters that hide."""
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def style_sheet() -> Markup:
    """Return the style of all pages: reports and the workbench look alike."""
    return Markup(template_text(_OWN, "page.css"))


def template_text(package: str, name: str) -> str | None:
    """Return the text of a file in the folder ``files`` of a package; None if it does not exist."""
    file = resources.files(package).joinpath("files", name)
    return file.read_text(encoding="utf-8") if file.is_file() else None


def embedded(content: Any) -> Markup:
    """Return JSON for embedding in a page: nothing in it ends its element."""
    return Markup(json_text(content).replace("<", "\\u003c"))


class Cells:
    """Makes marked text of the JSON object of a page."""

    def __init__(self, content: Mapping[str, Any]) -> None:
        self._content = content

    def at(self, place: str) -> Any:
        """Return the value at a place such as ``diagnosis.effects.0.name``."""
        here: Any = self._content
        for step in place.split("."):
            here = here[int(step)] if isinstance(here, list | tuple) else here[step]
        return here

    def words(self, place: str) -> Markup:
        """Return a text of the JSON, unchanged."""
        return Markup('<span data-field="{}">{}</span>').format(place, self.at(place))

    def shown(self, place: str, text: str, how: str) -> Markup:
        """Return a text of the JSON in another form; `how` names the function that makes it."""
        return Markup('<span data-field="{}" data-how="{}">{}</span>').format(place, how, text)

    def number(self, place: str, unit: Unit, form: Callable[[float], str] = fixed) -> Markup:
        """Return a number of the JSON in a unit, without its label; a dash for null."""
        value = self.at(place)
        return Markup("–") if value is None else _data(place, value, unit, form(value / unit.size))

    def digits(self, place: str, count: int, unit: Unit = _PLAIN) -> Markup:
        """Return a number of the JSON with some digits behind the point."""
        return self.number(place, unit, lambda value: f"{value:.{count}f}")

    def quantity(self, place: str, unit: str, *, pure: bool = False) -> Markup:
        """Return a number of the JSON with the unit in which people read it."""
        shown = unit_for(self.at(place), unit, pure=pure)
        return self.number(place, shown, short) + _label(shown)

    def percent(self, place: str) -> Markup:
        """Return a share of the JSON in per cent."""
        return self.number(place, Unit("%", 1e-2), lambda share: decimal(share, 0)) + " %"

    def estimate(
        self,
        place: str,
        unit: str,
        *,
        pure: bool = False,
        keys: tuple[str, str] = ("value", "standard_error"),
    ) -> Markup:
        """Return a value of the JSON and its standard error, ``5.378 ± 0.079 mN·m/rad``."""
        value, error = (self.at(f"{place}.{key}") for key in keys)
        shown = unit_for(max(abs(value), abs(error)), unit, pure=pure)
        first, _, second = pair(value / shown.size, error / shown.size).partition(" ± ")
        text = _data(f"{place}.{keys[0]}", value, shown, first)
        if second:
            text += Markup(" ± ") + _data(f"{place}.{keys[1]}", error, shown, second)
        return text + _label(shown)

    def interval(self, place: str, unit: str, *, pure: bool = False) -> Markup:
        """Return the 95 % interval of a coefficient: from all uncertainties, or its standard error if not fitted."""
        given = self.at(place)
        if (ends := given.get("interval")) is not None:
            shown = unit_for(max(map(abs, ends)), unit, pure=pure)
            error = 0.5 * (ends[1] - ends[0]) / shown.size
            texts = [pair(end / shown.size, error).partition(" ± ")[0] for end in ends]
            data = [_data(f"{place}.interval.{k}", end, shown, texts[k]) for k, end in enumerate(ends)]
        else:
            value, error = given["value"], given["standard_error"]
            shown = unit_for(max(abs(value), abs(error)), unit, pure=pure)
            # as many digits as the value has in front of its error
            digits = len(pair(value / shown.size, error / shown.size).partition(" ± ")[0].partition(".")[2])
            data = [
                _data(f"{place}.value", end, shown, decimal(end / shown.size, digits), sigma)
                for sigma in (-INTERVAL, INTERVAL)
                for end in (value + sigma * error,)
            ]
        return data[0] + Markup(" … ") + data[1] + _label(shown)


def declared(value: float, unit: Unit) -> Markup:
    """Return a number that an effect declares and no result has."""
    return Markup('<data value="{!r}" data-declared data-size="{!r}">{}</data>').format(
        value, unit.size, short(value / unit.size)
    )


def _data(place: str, value: float, unit: Unit, text: str, sigma: float = 0.0) -> Markup:
    extra = Markup(' data-sigma="{}"').format(sigma) if sigma else Markup("")
    return Markup('<data value="{}" data-field="{}" data-size="{}"{}>{}</data>').format(
        repr(float(value)), place, repr(unit.size), extra, text
    )


def label(unit: Unit) -> Markup:
    """Return the label of a unit, marked as such: some have digits."""
    return Markup('<span data-how="unit">{}</span>').format(unit.label)


def _label(unit: Unit) -> Markup:
    return Markup("\N{NO-BREAK SPACE}") + label(unit) if unit.label else Markup("")
