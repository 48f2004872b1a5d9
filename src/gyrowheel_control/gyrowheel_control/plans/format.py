"""Format of plan files: every key with its unit, range, default and meaning.

Reading, messages, the page of the format and the JSON schema for editors come from these declarations.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from gyrowheel_core.schema import Number, Section, Whole
from gyrowheel_sim.environment import AirDensityRatio, Preheat, Rig, TableRate, Yaw

#: Numbers of a plan beyond any bench, so that what is computed from them stays finite.
Seconds = Annotated[Number, Field(ge=0.001, le=3600.0)]
Degrees = Annotated[Number, Field(ge=-90.0, le=90.0)]
Radius = Annotated[Number, Field(gt=0.0, le=90.0)]
Rpm = Annotated[Number, Field(ge=-1.0e6, le=1.0e6)]
Rate = Annotated[Number, Field(ge=1.0e-6, le=1.0e6)]
Tilt = tuple[Degrees, Degrees]
#: Time after the ramp onto a cone in which the loop settles, before the turns that were asked for [s].
CONE_SETTLING: Final = 0.5


def _key(default: Any, about: str, unit: str = "") -> Any:
    return Field(default, description=about, json_schema_extra={"unit": unit} if unit else None)


class Block(Section):
    """One entry of a plan: a hold, a grid of holds (speeds times tilts), a cone, or a change of speed.

    Angles in degrees, speeds in rpm, times in seconds, as the field names say. The environment (rig, yaw, air
    density, preheat, rate of the table) stays as it is until a block changes it.
    """

    label: str = _key("", "what it is called in tables, pictures and messages")
    spin_rpm: Rpm | list[Rpm] | None = _key(
        None, "spin rate; of a list, every tilt is held at each in turn. Left out: the one before", "rpm"
    )
    tilt_deg: list[Tilt] | Tilt | None = _key(
        None, "tilt angles φx and φy; a list is held one after the other. Left out: the tilt before", "deg"
    )
    hold_s: Seconds | None = _key(None, "how long each tilt is held. Left out: `hold_s` of the plan", "s")
    ramp_s: Seconds | None = _key(
        None, "time of the way there. Left out: as the rates of tilt and speed give it, at least 0.05 s", "s"
    )
    tilt_rate_deg_s: Rate | None = _key(
        None, "rate of the tilt on the way there. Left out: that of the plan", "deg/s"
    )
    spin_acceleration_rpm_s: Rate | None = _key(
        None, "acceleration on the way there. Left out: that of the plan", "rpm/s"
    )
    cone_radius_deg: Radius | None = _key(
        None, "a cone: the tilt turns about the case axis at this angle; with `cone_period_s`", "deg"
    )
    cone_period_s: Annotated[Number, Field(gt=0.05, le=3600.0)] | None = _key(
        None, "time of one turn of the cone", "s"
    )
    cone_turns: Annotated[Number, Field(ge=0.001, le=1000.0)] = _key(
        1.0, f"turns of the cone, after {CONE_SETTLING:g} s in which the loop settles"
    )
    sweep_to_rpm: Rpm | None = _key(
        None, "the speed goes to this one, evenly, during `hold_s`, which must be given here", "rpm"
    )
    repeat: Annotated[Whole, Field(ge=1, le=1000)] = _key(1, "how often all of it is done")
    shuffle_seed: Whole | None = _key(
        None, "tilts in a random order that this number gives, another at each speed"
    )
    rig: Rig | None = _key(None, "which axis of the case points up; inverted: z down. At first `upright`")
    yaw_deg: Yaw | None = _key(None, "turn of the rig about the vertical. At first 0", "deg")
    air_density_ratio: AirDensityRatio | None = _key(
        None, "air density over the ambient one, 0 a vacuum. At first 1"
    )
    preheat_k: Preheat | None = _key(
        None,
        "temperature at which a heater keeps the coils above that of the air. At first 0, no heater",
        "K",
    )
    table_rate_deg_s: TableRate | None = _key(
        None, "rate at which a rate table turns the rig about the vertical. At first 0", "deg/s"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Block:
        if (self.cone_radius_deg is None) != (self.cone_period_s is None):
            raise ValueError("a cone needs both cone_radius_deg and cone_period_s")
        if self.cone_radius_deg is not None and self.tilt_deg is not None:
            raise ValueError("a block is either a cone or a grid of tilts, not both")
        if self.sweep_to_rpm is not None and self.hold_s is None:
            raise ValueError("sweep_to_rpm needs hold_s, the time that the sweep takes")
        for name in ("spin_rpm", "tilt_deg"):
            if getattr(self, name) == []:
                raise ValueError(f"{name} is an empty list; allowed: at least one value, or leave it out")
        return self


class PlanFile(Section):
    """A plan file."""

    schema_: Literal[1] = Field(alias="schema", description="version of the format")
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")] = Field(
        description="what recordings and results call it"
    )
    title: str = _key("", "one line for people")
    description: str = _key("", "what it is for")
    tilt_rate_deg_s: Rate = _key(8.0, "rate of the tilt from one hold to the next", "deg/s")
    spin_acceleration_rpm_s: Rate = _key(1000.0, "acceleration from one speed to the next", "rpm/s")
    hold_s: Seconds = _key(1.5, "how long each tilt is held where its block says nothing", "s")
    tilt_limit_deg: Radius | None = _key(
        None,
        "the tilt that the guards of the bench must allow, where it is beyond three fifths of its hard stop",
        "deg",
    )
    start_tilt_deg: Tilt = _key(
        (0.0, 0.0), "tilt angles φx and φy that the bench holds when the plan begins", "deg"
    )
    segments: Annotated[list[Block], Field(min_length=1)] = Field(
        description="blocks, one after the other; the first must give a speed"
    )


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of plan files (draft 7, which editors know best)."""
    document = _draft7(PlanFile.model_json_schema(by_alias=True))
    assert isinstance(document, dict)
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        **document,
        "title": "test plan of gyrowheel",
        "description": "docs/plans.md tells more",
    }


#: What pydantic calls otherwise: bounds where a validator stands before them, and the place of definitions.
_NAMES: Final = {
    "$defs": "definitions",
    "ge": "minimum",
    "gt": "exclusiveMinimum",
    "le": "maximum",
    "lt": "exclusiveMaximum",
}


def _draft7(node: Any) -> Any:
    """Return a node of a schema in the words of draft 7; a unit goes into the description, which editors show."""
    if isinstance(node, list):
        return [_draft7(item) for item in node]
    if not isinstance(node, Mapping):
        return node
    result = {
        _NAMES.get(key, key): _reference(value) if key == "$ref" else _draft7(value)
        for key, value in node.items()
        if key not in ("prefixItems", "unit")
    }
    if "prefixItems" in node:
        result["items"] = _draft7(node["prefixItems"])
    if isinstance(node.get("unit"), str):
        result["description"] = f"[{node['unit']}] {node['description']}"
    return result


def _reference(place: str) -> str:
    return place.replace("#/$defs/", "#/definitions/")
