"""What a declaration of an effect in a file may have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, StrictBool, create_model

from gyrowheel_core.errors import InputError
from gyrowheel_core.schema import Number, Section, refuse, shown
from gyrowheel_sim.effects.declaration import Category
from gyrowheel_sim.effects.dimensions import Unit
from gyrowheel_sim.effects.grammar import NAME, RESERVED
from gyrowheel_sim.effects.targets import TARGETS

#: Names that a law may have in a declaration, and the targets that they mean.
LAW_FIELDS: dict[str, str] = {"torque": "rotor_torque", **{target: target for target in TARGETS}}
_LONGEST_TEXT = 300
_MOST_COEFFICIENTS = 12
_LARGEST = 1e100


def _line(raw: Any) -> str:
    if not isinstance(raw, str) or len(raw) > _LONGEST_TEXT:
        refuse(f"{shown(raw)} is not a text of up to {_LONGEST_TEXT} characters")
    return "".join(c if c.isprintable() else " " for c in " ".join(raw.split()))


def _unit(raw: Any) -> str:
    try:
        Unit.of(str(raw))
    except InputError as error:
        refuse(str(error))
    return str(raw).strip().replace("**", "^").replace("·", "*").replace(" ", "")


def _is_pair(raw: Any) -> Any:
    if not isinstance(raw, list | tuple) or len(raw) != 2:
        refuse(f"{shown(raw)} is not a pair of numbers, [low, high]")
    return tuple(raw)


def _grows(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        refuse(f"[{pair[0]:g}, {pair[1]:g}] is empty; allowed: low < high")
    return pair


def _not_huge(value: float) -> float:
    if abs(value) > _LARGEST:
        refuse(f"{value:g} is not finite")
    return value


def _some(value: float) -> float:
    if value <= 0.0:
        refuse(f"{value:g} is out of range; allowed: > 0")
    return value


#: A text of one line.
Line = Annotated[str, BeforeValidator(_line)]
Size = Annotated[Number, AfterValidator(_not_huge)]
Pair = Annotated[tuple[Size, Size], BeforeValidator(_is_pair), AfterValidator(_grows)]


class CoefficientEntry(Section):
    """A coefficient in a declaration; `gyrowheel_sim.effects.declaration.Coefficient` says what the fields mean."""

    unit: Annotated[str, BeforeValidator(_unit)] | None = None
    description: Line = ""
    usual: Pair | None = None
    bounds: Pair | None = None
    possible: Pair | None = None
    possible_source: Line = ""
    signed: StrictBool | None = None
    value: Size | None = None
    uncertainty: Size | None = None
    source: Line = ""


def _entry(raw: Any) -> Any:
    if raw is None or isinstance(raw, str):
        return {} if raw is None else {"unit": raw}
    if not isinstance(raw, Mapping):
        refuse(f"{shown(raw)} is not a unit or a mapping with unit, usual, bounds")
    return raw


def _named(raw: Any) -> Any:
    if not isinstance(raw, Mapping) or not raw:
        refuse("missing; an effect needs a coefficient, e.g. k: {unit: N*m/rad}")
    if len(raw) > _MOST_COEFFICIENTS:
        refuse(f"{len(raw)} coefficients; allowed: up to {_MOST_COEFFICIENTS}")
    for name in raw:
        if not isinstance(name, str) or NAME.fullmatch(name) is None:
            refuse(f"{shown(name)} is no name of a coefficient; letters, digits and _ are allowed")
        if name in RESERVED:
            refuse("the name is taken; choose another", name)
    return raw


def _alike(raw: Any) -> Any:
    if raw is not None and not isinstance(raw, Mapping):
        refuse("a mapping of effects to tests is expected")
    return {} if raw is None else {_line(str(name))[:40]: test for name, test in raw.items()}


class _Declaration(Section):
    title: Line = ""
    category: Category = "other"
    sentence: Line = ""
    validity: Line = ""
    source: Line = ""
    look_alikes: Annotated[dict[str, Line], BeforeValidator(_alike)] = Field(default_factory=dict)
    greatest: Annotated[Size, AfterValidator(_some)] | None = None
    coefficients: Annotated[
        dict[str, Annotated[CoefficientEntry, BeforeValidator(_entry)]], BeforeValidator(_named)
    ] = Field(None, validate_default=True)

    def laws(self) -> dict[str, Any]:
        """Return the formulas that are given, by the names of their fields."""
        return {field: getattr(self, field) for field in LAW_FIELDS if field in self.model_fields_set}


_FORMULAS: dict[str, Any] = dict.fromkeys(LAW_FIELDS, (Any, None))
#: A declaration: the fields above, and a formula for every target that a law of it acts on.
Declaration: type[_Declaration] = create_model("Declaration", __base__=_Declaration, **_FORMULAS)
