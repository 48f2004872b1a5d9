"""A real browser: Debian's Chromium, driven by Playwright, with axe-core within its pages."""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium")
_NEEDED = {"Playwright": "playwright", "axe-core": "axe_playwright_python"}
_MISSING = [name for name, module in _NEEDED.items() if importlib.util.find_spec(module) is None]
if CHROMIUM is None:
    _MISSING.append("Chromium")
needs_browser = pytest.mark.skipif(bool(_MISSING), reason=f"{' and '.join(_MISSING)}: not installed")


@contextmanager
def opened_browser() -> Iterator[Any]:
    """Yield a browser without a window."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        yield play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])


def faults(page: Any) -> list[str]:
    """Return the faults of accessibility of a page, of any level, in light and in dark."""
    axe = resources.files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8")
    said = []
    for theme in ("light", "dark"):
        page.emulate_media(color_scheme=theme)
        page.wait_for_function("(theme) => matchMedia(`(prefers-color-scheme: ${theme})`).matches", arg=theme)
        if page.evaluate("!window.axe"):
            page.evaluate(axe)
        found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
        said += [
            f"{page.url}, {theme}: {fault['id']}: {node['html']}"
            for fault in found["violations"]
            for node in fault["nodes"]
        ]
    page.emulate_media(color_scheme="light")
    return said


def press(target: Any, *keys: str) -> None:
    """Go to an element with the Tab key alone, either way, and press keys there: Enter if none are given."""
    keyboard = target.page.keyboard
    target.wait_for()
    way = "(own) => own === document.activeElement ? 0 : own.compareDocumentPosition(document.activeElement)"
    for _ in range(600):
        if not (place := target.evaluate(way)):
            break
        keyboard.press("Shift+Tab" if place & 4 else "Tab")  # 4: the focus is behind it
    else:
        raise AssertionError(f"{target}: is not reached with Tab")
    for key in keys or ("Enter",):
        keyboard.press(key)
