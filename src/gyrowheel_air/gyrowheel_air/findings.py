"""What the flow about the published rotor was found to do, from a parameter file with uncertainties and sources."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from importlib import resources
from typing import Annotated, Literal

from pydantic import Field

from gyrowheel_core.schema import Name, Names, Number, Section, check
from gyrowheel_core.yaml_text import read_yaml


class _Entry(Section):
    """A finding as the file states it."""

    value: Number
    unit: Name
    uncertainty: Annotated[Number, Field(ge=0.0)]
    source: Name
    description: Name


class _File(Section):
    """A file of findings."""

    schema_: Literal[1] = Field(alias="schema")
    name: Name
    title: Name
    findings: Names[_Entry]


@dataclass(frozen=True)
class Finding:
    """One number that was found.

    Attributes
    ----------
    value, uncertainty : float
        Value and standard uncertainty, in its unit (SI).
    unit, source, description : str
        Unit, where both numbers come from, and what it is.
    """

    value: float
    uncertainty: float
    unit: str
    source: str
    description: str

    def bar(self, times: float) -> tuple[float, float]:
        """Return the range within so many standard uncertainties."""
        return self.value - times * self.uncertainty, self.value + times * self.uncertainty


@functools.cache
def findings() -> dict[str, Finding]:
    """Return the findings by name."""
    origin = "findings.yaml"
    text = resources.files("gyrowheel_air").joinpath(origin).read_text(encoding="utf-8")
    content = check(_File, read_yaml(text, origin), origin, kind="file of findings")
    return {
        name: Finding(entry.value, entry.uncertainty, entry.unit, entry.source, entry.description)
        for name, entry in content.findings.items()
    }
