"""Pages of HTML: their templates, and the one style that all of them have."""

from __future__ import annotations

import functools
from importlib import resources
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from gyrowheel_core.files import json_text

if TYPE_CHECKING:
    import jinja2

#: Beginning of a report: of a page of HTML, and of one in Markdown.
REPORT_MARKS = ('<meta name="generator" content="gyrowheel">', "<!-- report of gyrowheel -->")
#: Title of a report as PDF.
REPORT_TITLE = "gyrowheel report"
_OWN = "gyrowheel.show"


@functools.cache
def environment(*packages: str) -> jinja2.Environment:
    """Return the template reader of packages, in order of precedence; values are escaped."""
    import jinja2

    return jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [jinja2.FunctionLoader(functools.partial(template_text, own)) for own in (*packages, _OWN)]
        ),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


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
