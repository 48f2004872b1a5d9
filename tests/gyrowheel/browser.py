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
    """Return the accessibility violations of a page, of any level; in dark mode only those of colours."""
    axe = resources.files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8")
    said = []
    for theme in ("light", "dark"):
        page.emulate_media(color_scheme=theme)
        page.wait_for_function("(theme) => matchMedia(`(prefers-color-scheme: ${theme})`).matches", arg=theme)
        if page.evaluate("!window.axe"):
            page.evaluate(axe)
        rules = {"runOnly": ["color-contrast", "link-in-text-block"]} if theme == "dark" else {}
        found = page.evaluate("(rules) => axe.run(document, {resultTypes: ['violations'], ...rules})", rules)
        said += [
            f"{page.url}, {theme}: {fault['id']}: {node['html']}"
            for fault in found["violations"]
            for node in fault["nodes"]
        ]
    page.emulate_media(color_scheme="light")
    return said


def press(target: Any, *keys: str) -> None:
    """Press keys at an element, by default Enter, after the Tab key has left it and returned to it."""
    keyboard = target.page.keyboard
    for _ in range(20):  # a page that draws at that instant may move the focus
        target.focus()
        for key in ("Shift+Tab", "Tab"):
            keyboard.press(key)
        if target.evaluate("(own) => own === document.activeElement"):
            break
    else:
        raise AssertionError(f"{target}: is not reached with Tab")
    for key in keys or ("Enter",):
        keyboard.press(key)


def reached_by_tab(page: Any) -> list[str]:
    """Return the elements that the Tab key reaches from the first link of a page on: ids, own or of the parent."""
    page.locator("a").first.focus()
    places: list[str] = []
    for _ in range(600):
        page.keyboard.press("Tab")
        own = page.evaluate(
            "document.activeElement === document.body ? null : (document.activeElement.closest('[id]')?.id ?? '')"
        )
        if own is None:
            return places
        places.append(own)
    raise AssertionError(f"does not end: {places[-5:]}")
