"""Rotor and case: the lengths between which the air moves, read from a parameter file."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, read_text
from gyrowheel_core.schema import Name, Names, Number, Section, check
from gyrowheel_core.units import DEG
from gyrowheel_core.yaml_text import read_yaml


class LengthEntry(Section):
    """A length as a geometry file states it [m]."""

    value: Annotated[Number, Field(ge=1e-4, le=10.0)]
    unit: Literal["m"]
    uncertainty: Annotated[Number, Field(ge=0.0, le=10.0)]
    source: Name
    description: Name = ""


class Lengths(Section):
    """The lengths of rotor and case."""

    rotor_radius: LengthEntry
    rotor_height: LengthEntry
    case_radius: LengthEntry
    case_height: LengthEntry


class GeometryFile(Section):
    """A geometry file."""

    schema_: Literal[1] = Field(alias="schema")
    name: Name = "geometry"
    title: Name = ""
    references: Names[Name] = Field(default_factory=dict)
    lengths: Lengths


LENGTHS = tuple(Lengths.model_fields)


@dataclass(frozen=True)
class Length:
    """One length of rotor or case."""

    #: Value and standard uncertainty [m].
    value: float
    uncertainty: float
    #: Where the value comes from, and what it is.
    source: str
    description: str = ""


@dataclass(frozen=True)
class Geometry:
    """A cylindrical rotor centred in a cylindrical case; all lengths in metres."""

    #: What it is called.
    name: str
    title: str
    lengths: Mapping[str, Length]  # the four lengths by name
    #: Full citations by the key with which a source starts.
    references: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def load(cls, source: str | Path = "gyrowheel") -> Geometry:
        """Read a geometry by shipped name (``"gyrowheel"``) or from a file.

        Raises
        ------
        InputError
            If the file is missing, is no YAML, or a field of it is missing, unknown or out of range.
        """
        if str(source) == "gyrowheel":
            file = resources.files("gyrowheel_air").joinpath("geometry.yaml")
            return cls.from_text(file.read_text(encoding="utf-8"), origin="geometry.yaml")
        path = Path(source)
        if not is_file(path):
            raise InputError(f"geometry '{source}': no such shipped geometry or file; shipped: gyrowheel")
        return cls.from_text(read_text(path, errors="replace"), origin=str(path))

    @classmethod
    def from_text(cls, text: str, *, origin: str) -> Geometry:
        """Read a geometry from the text of a file (see `load`)."""
        content = check(GeometryFile, read_yaml(text, origin), origin, kind="geometry file")
        lengths = {
            name: Length(entry.value, entry.uncertainty, entry.source, entry.description)
            for name, entry in content.lengths
        }
        return cls(content.name, content.title, lengths, content.references).checked(origin)

    def checked(self, origin: str = "geometry") -> Geometry:
        """Return the geometry itself if the rotor fits into the case.

        Raises
        ------
        InputError
            If it does not.
        """
        for inner, outer in (("rotor_radius", "case_radius"), ("rotor_height", "case_height")):
            if self.lengths[inner].value >= self.lengths[outer].value:
                raise InputError(
                    f"{origin}: lengths.{inner}: {self.lengths[inner].value:g} m is out of range; "
                    f"allowed: less than {outer}, {self.lengths[outer].value:g} m"
                )
        return self

    def with_value(self, name: str, value: float) -> Geometry:
        """Return the same geometry with another value of one length [m]."""
        return replace(self, lengths={**self.lengths, name: replace(self.lengths[name], value=value)})

    @property
    def rotor_radius(self) -> float:
        """Radius of the rotor [m]."""
        return self.lengths["rotor_radius"].value

    @property
    def rotor_height(self) -> float:
        """Height of the rotor [m]."""
        return self.lengths["rotor_height"].value

    @property
    def case_radius(self) -> float:
        """Inner radius of the case [m]."""
        return self.lengths["case_radius"].value

    @property
    def case_height(self) -> float:
        """Inner height of the case [m]."""
        return self.lengths["case_height"].value

    @property
    def rim_gap(self) -> float:
        """Gap between the rims of rotor and case [m]."""
        return self.case_radius - self.rotor_radius

    @property
    def end_gap(self) -> float:
        """Gap between an end face of the rotor and that of the case [m]."""
        return 0.5 * (self.case_height - self.rotor_height)

    def clearance(self, tilt: float) -> float:
        """Return the smallest distance of the tilted rotor's edge from the case [m]; below zero it touches.

        Parameters
        ----------
        tilt : float
            Angle of the tilt [rad].
        """
        s, c = abs(math.sin(tilt)), math.cos(tilt)
        side = self.rotor_radius * c + 0.5 * self.rotor_height * s
        top = self.rotor_radius * s + 0.5 * self.rotor_height * c
        return min(self.case_radius - side, 0.5 * self.case_height - top)

    @property
    def free_tilt(self) -> float:
        """Tilt up to which the rotor does not touch the case, to a hundredth of a degree [rad]."""
        steps = itertools.takewhile(lambda k: self.clearance(0.01 * k * DEG) >= 0.0, range(9001))
        return 0.01 * max(steps, default=0) * DEG

    def to_dict(self) -> dict[str, float]:
        """Return the four lengths by name [m]."""
        return {name: self.lengths[name].value for name in LENGTHS}
