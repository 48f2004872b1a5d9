"""Reads a report as a browser does, and follows every number on it to the field that it was taken from."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

VOID = {"meta", "img", "br", "link", "input", "hr"}


@dataclass
class Element:
    """An element of a page."""

    tag: str
    attributes: dict[str, str]
    parent: Element | None = None
    text: str = ""

    def within(self, attribute: str) -> Element | None:
        """Return the nearest element round about, or this one, that has an attribute."""
        here: Element | None = self
        while here is not None and attribute not in here.attributes:
            here = here.parent
        return here


@dataclass
class Page(HTMLParser):
    """A page: its elements, its pieces of text with the element that holds them, and the JSON within it."""

    text: str
    elements: list[Element] = field(default_factory=list)
    pieces: list[tuple[str, Element]] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self.open: list[Element] = []
        self.feed(self.text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        own = Element(tag, {key: value or "" for key, value in attrs}, self.open[-1] if self.open else None)
        self.elements.append(own)
        if tag not in VOID:
            self.open.append(own)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop().tag == tag

    def handle_data(self, data: str) -> None:
        if self.open:
            self.pieces.append((data, self.open[-1]))
            for element in self.open:
                element.text += data

    @property
    def content(self) -> Any:
        """The JSON object of the page."""
        (own,) = [e for e in self.elements if e.attributes.get("id") == "content"]
        return json.loads(own.text)


def at(content: Any, place: str) -> Any:
    """Return what stands at a place of a JSON object."""
    for step in place.split("."):
        content = content[int(step)] if isinstance(content, list) else content[step]
    return content


def check_numbers(page: Page) -> int:
    """Hold every marked number and text of a page to the JSON; return how many there were.

    In what is told of the result, every digit stands in an element that says where it comes from.
    """
    content, count = page.content, 0
    for element in page.elements:
        marks = element.attributes
        if element.tag == "data" and "data-field" in marks:
            wanted = at(content, marks["data-field"])
            if "data-sigma" in marks:
                place = marks["data-field"].replace(".value", ".standard_error")
                wanted += float(marks["data-sigma"]) * at(content, place)
            assert float(marks["value"]) == wanted
            shown = element.text.replace("−", "-")
            digits, _, power = shown.partition("e")
            step = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
            # rounded once, or to three significant digits of a large number
            step = max(step, 10.0 ** (len(digits.lstrip("-").partition(".")[0]) - 3) if step >= 1.0 else step)
            size = float(marks["data-size"])
            assert abs(float(shown) - wanted / size) <= 0.5001 * step, (marks, shown)
            count += 1
        elif "data-field" in marks and "data-how" not in marks:
            assert element.text == at(content, marks["data-field"])
            count += 1
    for text, element in page.pieces:
        if element.within("data-told") is None or not re.search("[0-9]", text):
            continue
        told = any(element.within(mark) for mark in ("data-field", "data-how", "data-declared"))
        assert told or element.tag in ("th", "figcaption"), text
    return count
