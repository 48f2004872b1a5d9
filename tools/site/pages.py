"""Sphinx extension: contents from the index pages, API at ``<!-- api: -->`` comments, formulas without a script.

The pages stay plain Markdown that a forge shows with lists and formulas.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util import logging

_LOG = logging.getLogger(__name__)
#: Entry of a list or a table: title and path of a page.
_PAGE = re.compile(r"^(?:- |\| )\[([^]]+)\]\(([^)#:]+)\.md\)", re.MULTILINE)
_API = re.compile(r"^<!-- api: (.*?) -->$", re.MULTILINE)
#: Element that would load a file from the network.
_REMOTE = re.compile(
    r"<(?:script|link|img|iframe|source|video)\b[^>]*\b(?:src|href)=\"(?:https?:)?//[^\"]*\""
)
_HOME = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>gyrowheel</title>
<meta http-equiv="refresh" content="0; url={home}">
<a href="{home}">gyrowheel</a>
</html>
"""


def contents(page: str, text: str) -> str:
    """Return the contents of an index page: a toctree for each heading with a list or table of pages.

    Parameters
    ----------
    page : str
        Name of the index page, as ``docs/README``.
    text : str
        Its Markdown.
    """
    folder = PurePosixPath(page).parent
    trees = []
    for part in re.split(r"^##? ", text, flags=re.MULTILINE):
        heading = part.partition("\n")[0].strip()
        entries = [f"{title} </{_within(folder, place)}>" for title, place in _PAGE.findall(part)]
        if entries:
            trees.append("\n".join(["```{toctree}", ":hidden:", f":caption: {heading}", "", *entries, "```"]))
    return "\n\n".join(trees)


def _within(folder: PurePosixPath, place: str) -> str:
    parts: list[str] = []
    for part in (folder / place).parts:
        if part == "..":
            parts.pop()
        else:
            parts.append(part)
    return "/".join(parts)


def _read(_: Sphinx, page: str, source: list[str]) -> None:
    text = source[0]
    if page.startswith("docs/") and page.endswith("/README"):
        text = f"{text}\n\n{contents(page, text)}\n"
    source[0] = _API.sub(lambda found: _described(found[1].split()), text)


def _described(names: list[str]) -> str:
    import inspect

    import gyrowheel

    lines = ["```{eval-rst}"]
    for name in names:
        if inspect.isclass(getattr(gyrowheel, name)):
            lines += [
                f".. autoclass:: gyrowheel.{name}",
                "   :members:",
                "   :inherited-members: Exception, tuple",
            ]
        elif callable(getattr(gyrowheel, name)):
            lines.append(f".. autofunction:: gyrowheel.{name}")
        else:
            lines += [f".. autodata:: gyrowheel.{name}", "   :no-value:"]
        lines.append("")
    return "\n".join([*lines, "```"])


def _set(translator: Any, node: nodes.Element, *, block: bool) -> None:
    try:
        text = tex2mathml(node.astext(), as_block=block)
    except MathError as error:
        _LOG.warning("%s: %s", node.astext(), error, location=node)
        text = translator.encode(node.astext())
    translator.body.append(text)
    raise nodes.SkipNode


def _inline(translator: Any, node: nodes.Element) -> None:
    _set(translator, node, block=False)


def _block(translator: Any, node: nodes.Element) -> None:
    _set(translator, node, block=True)


def _finished(app: Sphinx, problem: Exception | None) -> None:
    """Write ``index.html``, and refuse a site that would need the network."""
    if problem is not None or app.builder.format != "html":
        return
    folder = Path(app.outdir)
    (folder / "index.html").write_text(_HOME.format(home=f"{app.config.root_doc}.html"), encoding="utf-8")
    for page in folder.rglob("*.html"):
        if found := _REMOTE.search(page.read_text(encoding="utf-8")):
            raise ExtensionError(f"{page.relative_to(folder)}: needs the network: {found[0]}")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension."""
    app.connect("source-read", _read)
    app.connect("build-finished", _finished)
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
