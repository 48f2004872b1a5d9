"""The model file: what may stand in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from gyrowheel_core.schema import Names, Number, Section, Text

SCHEMA = 1


def _with_its_error(value: Any) -> Any:
    return value if isinstance(value, Mapping | Estimate) else {"value": value}


def _or_none(value: Any) -> Any:
    return [] if value is None else value


class Estimate(Section):
    """A value with its standard error; what is allowed for the value depends on the parameter or coefficient."""

    value: Any
    standard_error: Annotated[Number, Field(ge=0.0)] = 0.0


#: An `Estimate`, or a number alone.
ValueEntry = Annotated[Estimate, BeforeValidator(_with_its_error)]


class EffectEntry(BaseModel):
    """An effect: its coefficients by name, and its declaration if it is a user's own."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, ValueEntry]

    declaration: Any = None

    @property
    def coefficients(self) -> dict[str, Estimate]:
        """The coefficients that the file gives."""
        return dict(self.__pydantic_extra__)

    @property
    def is_declared(self) -> bool:
        """Whether the entry declares the effect."""
        return "declaration" in self.model_fields_set


class HistoryEntry(BaseModel):
    """A change of the model; what else it tells is for people."""

    model_config = ConfigDict(extra="allow", frozen=True)

    calibrated: Names[ValueEntry] = Field(default_factory=dict)
    restated: Names[ValueEntry] = Field(default_factory=dict)


class ModelFile(Section):
    """A model file."""

    schema_: Literal[1] = Field(alias="schema")
    bench: Annotated[
        Text, Field(json_schema_extra={"allowed": "the name of a bench, or the path of its file"})
    ] = "gyrowheel"
    overrides: Names[ValueEntry] = Field(default_factory=dict)
    effects: Names[EffectEntry] = Field(default_factory=dict)
    history: Annotated[list[HistoryEntry], BeforeValidator(_or_none)] = Field(default_factory=list)
