"""Files of users: every mistake is named in one line, with its place and what is allowed."""

from __future__ import annotations

import contextlib
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, field_validator

from gyrowheel_core.errors import InputError
from gyrowheel_core.schema import Names, Number, Section, Text, Whole, check, refuse


class Part(Section):
    """A part of a file."""

    unit: Literal["m", "mm"]
    value: Annotated[Number, Field(ge=0.0, le=10.0)]
    share: Annotated[Number, Field(gt=0.0)] = 1.0
    place: tuple[Number, Number] | list[tuple[Number, Number]] | None = None

    @field_validator("unit")
    @classmethod
    def _metric(cls, unit: str) -> str:
        if unit == "mm":
            refuse("'mm' is out of fashion; allowed: m", "kind")
        return unit


class File(Section):
    """A file."""

    schema_: Literal[1] = Field(alias="schema")
    name: Text
    parts: Names[Part] = Field(default_factory=dict)
    order: list[Whole] = Field(default_factory=list)
    flag: bool = False


def content(**changes: Any) -> dict[str, Any]:
    whole = {"schema": 1, "name": "a", "parts": {"one": {"unit": "m", "value": "1e-3"}}}
    return {key: value for key, value in (whole | changes).items() if value is not ...}


def part(**changes: Any) -> dict[str, Any]:
    whole = {"unit": "m", "value": 1} | changes
    return content(parts={"one": {key: value for key, value in whole.items() if value is not ...}})


def test_valid_content_is_read() -> None:
    read = check(File, content(order=[1, 2]), "FILE")
    assert (read.parts["one"].value, read.order) == (1e-3, [1, 2])
    assert check(File, content(parts=None), "FILE").parts == {}
    assert "5" in check(File, content(parts={5: {"unit": "m", "value": 1}}), "FILE").parts


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (5, "FILE: not a file of parts (a mapping with schema, name is expected)"),
        (content(schema=2, colour=1), "FILE: schema: 2 is not known; allowed: 1"),
        (content(schema=...), "FILE: schema: missing; allowed: 1"),
        (content(name=...), "FILE: name: missing"),
        (content(name=""), "FILE: name: '' is too short; allowed: length >= 1"),
        (content(name=5), "FILE: name: 5 is not a text"),
        (content(name=..., nmae="a"), "FILE: nmae: no such field; did you mean name?"),
        (content(colour=1), "FILE: colour: no such field; allowed: schema, name, parts, order, flag"),
        (content(parts=[1]), "FILE: parts: [1] is not a mapping"),
        (content(parts={"one": 5}), "FILE: parts.one: 5 is not a mapping"),
        (content(order=5), "FILE: order: 5 is not a list"),
        (content(order=[1, "x"]), "FILE: order.1: 'x' is not a whole number"),
        (content(order=[True]), "FILE: order.0: True is not a number"),
        (content(flag="perhaps"), "FILE: flag: 'perhaps' is neither true nor false"),
        (part(unit="kg"), "FILE: parts.one.unit: 'kg' is not known; allowed: m, mm"),
        (part(unit="mm"), "FILE: parts.one.unit.kind: 'mm' is out of fashion; allowed: m"),
        (part(unit=...), "FILE: parts.one.unit: missing; allowed: m, mm"),
        (part(value="much"), "FILE: parts.one.value: 'much' is not a number; allowed: 0 .. 10"),
        (part(value=True), "FILE: parts.one.value: True is not a number; allowed: 0 .. 10"),
        (part(value=11), "FILE: parts.one.value: 11 is out of range; allowed: 0 .. 10"),
        (part(value="nan"), "FILE: parts.one.value: 'nan' is not finite; allowed: 0 .. 10"),
        (part(share=0), "FILE: parts.one.share: 0 is out of range; allowed: > 0"),
        (part(vlaue=1), "FILE: parts.one.vlaue: no such field; did you mean value?"),
        (part(place=5), "FILE: parts.one.place: 5 is not a list"),
        (part(place=[1, "x"]), "FILE: parts.one.place.1: 'x' is not a number"),
        (part(place=[[1, 2], [3, "x"]]), "FILE: parts.one.place.1.1: 'x' is not a number"),
    ],
)
def test_an_invalid_field_is_reported_in_one_line(raw: Any, said: str) -> None:
    with pytest.raises(InputError) as caught:
        check(File, raw, "FILE", kind="file of parts")
    assert str(caught.value) == said


def test_the_place_in_a_file_precedes_the_field() -> None:
    with pytest.raises(InputError, match=r"^FILE: here\.unit: missing"):
        check(Part, {"value": 1}, "FILE: here", separator=".")


SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
KEYS = st.sampled_from(["schema", "name", "parts", "order", "unit", "value", "place"]) | st.text(max_size=3)


@given(st.recursive(SCALARS, lambda s: st.lists(s, max_size=3) | st.dictionaries(KEYS, s, max_size=4)))
@pytest.mark.slow
def test_any_content_is_read_or_refused_in_one_line(raw: Any) -> None:
    said = []
    for read in (raw, content(parts={"one": raw}), part(place=raw), content(order=raw)):
        with contextlib.suppress(InputError):
            check(File, read, "FILE", kind="file of parts")
            continue
        with pytest.raises(InputError) as caught:
            check(File, read, "FILE", kind="file of parts")
        said.append(str(caught.value))
    assert all(len(line.splitlines()) == 1 for line in said)
