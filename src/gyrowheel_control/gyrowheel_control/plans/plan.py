"""Test plans: read from YAML, checked against the bench, varied, converted to setpoints.

Reading, messages, the page of the format and the JSON schema for editors come from the declaration of the format:
every key with its unit, range, default and meaning. A variation is the same plan at other speeds or tilts, or in
another environment, as ``survey@rig=inverted``.
"""

from __future__ import annotations

import copy
import difflib
import functools
import itertools
import math
import os
import random
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gyrowheel_control.plans.demands import Segment, excesses
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, read_text
from gyrowheel_core.schema import Number, Section, Whole, check
from gyrowheel_core.units import DEG, RPM
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import AirDensityRatio, Environment, Preheat, Rig, TableRate, Yaw

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


#: Interval of the setpoints [s]; the controller continues each by its rates until the next.
SETPOINT_PERIOD = 0.005
RAMP, HOLD = 0, 1
#: Longest plan [s]; all its samples are held in memory.
LONGEST = 86_400.0
_SHORT = 1 << 14  # characters of a text whose content is kept
_NUMBERS = ("tilt_x", "tilt_y", "tilt_rate_x", "tilt_rate_y", "spin_rate", "spin_acceleration")
SETPOINT_DTYPE = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("segment", np.uint32),
        ("phase", np.uint8),
        *((name, float) for name in _NUMBERS),
    ]
)


class Plan:
    """A test plan: a list of segments in time.

    Use `Plan.load`; the attributes are `name`, `called` (the same, or what was typed of a variation), `title`,
    `description`, `segments`, `duration` [s], `tilt_limit`, the tilt that the guards of the bench must allow [rad],
    or None where the usual one will do, `written_for`, the shipped bench whose limits a shipped plan is made for
    (empty for a plan of one's own, which is taken as it stands), and `fitting`, what was changed for another bench, in
    words (see `gyrowheel_control.plans.adaptation`).
    """

    def __init__(self, content: PlanFile, text: str, origin: str) -> None:
        self.name = self.called = content.name
        self.title = content.title
        self.description = content.description
        self.origin = origin
        self.tilt_limit = None if content.tilt_limit_deg is None else content.tilt_limit_deg * DEG
        self.written_for = ""
        self.fitting: tuple[str, ...] = ()
        self._content = content
        self._text = text
        self.segments: tuple[Segment, ...] = tuple(_segments(content, origin))

    @classmethod
    def load(cls, source: str | Path) -> Plan:
        """Read a plan: a shipped name, the path of a plan file, or the YAML text of one.

        A name or path may be followed by a variation, as ``survey@rig=inverted,spin_ratio=0.5`` (see `variation`).

        Raises
        ------
        InputError
            If there is no such plan, or a field of it is missing, unknown or out of range.
        """
        text = str(source)
        if "\n" in text and not os.path.isfile(text):  # names of files may have line breaks, too
            return cls._from_text(text, "plan text")
        base, mark, settings = text.rpartition(MARK)
        if mark and not is_file(Path(text)):
            plain = cls.load(base)
            content = varied(read_yaml(plain.to_yaml(), plain.origin), settings, f"plan '{text}'")
            plan = cls._from_text(as_text(content), f"plan '{text}'")
            plan.called, plan.written_for = text, plain.written_for
            return plan
        if text in cls.shipped():
            file = resources.files("gyrowheel_control").joinpath(f"plans/{text}.yaml")
            plan = cls._from_text(file.read_text(encoding="utf-8"), f"{text}.yaml")
            first, *others = Bench.shipped()
            plan.written_for = next((name for name in others if text.startswith(f"{name}_")), first)
            return plan
        path = Path(text)
        if not is_file(path):
            near = difflib.get_close_matches(text, cls.shipped(), n=2)
            hint = f"; did you mean {', '.join(near)}?" if near else f"; shipped: {', '.join(cls.shipped())}"
            raise InputError(f"plan '{text}': no such shipped plan or file{hint}")
        return cls._from_text(read_text(path, errors="replace"), str(path))

    @classmethod
    def _from_text(cls, text: str, origin: str) -> Plan:
        read = _kept if len(text) <= _SHORT else _read
        return cls(read(text, origin), text, origin)

    @staticmethod
    def shipped() -> list[str]:
        """Return the names of the plans that come with the project."""
        folder = resources.files("gyrowheel_control").joinpath("plans")
        return sorted(f.name.removesuffix(".yaml") for f in folder.iterdir() if f.name.endswith(".yaml"))

    def beginning_at(self, tilt: complex, spin: float, ramp: float = 0.0) -> Plan:
        """Return the plan for a bench that is held at a state: its first ramp begins there.

        `tilt`: tilt angles phi_x + i phi_y [rad]; `spin`: spin rate [rad/s]; `ramp`: the least time of that ramp [s].
        Raises InputError if the plan becomes too long.
        """
        plan = copy.copy(self)
        plan.segments = tuple(_segments(self._content, self.origin, (tilt, spin, ramp)))
        return plan

    @property
    def duration(self) -> float:
        """Length of the plan [s]."""
        return self.segments[-1].end

    @property
    def initial_spin_rate(self) -> float:
        """Spin rate at which the plan starts [rad/s]."""
        return self.segments[0].spin_from

    def to_yaml(self) -> str:
        """Return the text of the plan file."""
        return self._text

    def check(self, bench: Bench) -> None:
        """Check the plan against the limits of a bench: tilt, speed, voltages needed for slewing and spin-up.

        Raises
        ------
        InputError
            Naming plan, segment, value and the allowed range.
        """
        for excess in excesses(self.segments, bench):
            raise InputError(f"{self.place(excess.segment)}: {excess.said}")

    def place(self, segment: int) -> str:
        """Return how messages call a segment: file, number and label."""
        label = self.segments[segment].label
        return f"{self.origin}: segment {segment}" + (f" ({label})" if label else "")

    def environment(self) -> list[Environment]:
        """Return the changes of the environment, the first at time 0."""
        events: list[Environment] = []
        for s in self.segments:
            if not events or replace(s.environment, time=events[-1].time) != events[-1]:
                events.append(s.environment)
        return events

    def setpoints(self) -> NDArray[Any]:
        """Return the setpoints of the whole plan every `SETPOINT_PERIOD`, dtype `SETPOINT_DTYPE`."""
        n = round(self.duration / SETPOINT_PERIOD)
        result = np.zeros(n, dtype=SETPOINT_DTYPE)
        period_ns = round(SETPOINT_PERIOD * 1e9)
        result["stamp_ns"] = np.arange(n, dtype=np.int64) * period_ns
        time = np.arange(n) * SETPOINT_PERIOD
        starts = np.array([s.start for s in self.segments])
        owner = np.clip(np.searchsorted(starts, time + 1e-9, side="right") - 1, 0, len(starts) - 1)
        for index, s in enumerate(self.segments):
            rows = np.flatnonzero(owner == index)
            if not rows.size:
                continue
            tau = time[rows] - s.start
            ramping = tau < s.ramp - 1e-9
            held = np.maximum(tau - s.ramp, 0.0)
            turn = np.exp(1j * s.cone_rate * held)
            slew = (s.tilt - s.tilt_from) / s.ramp
            tilt = np.where(ramping, s.tilt_from + slew * tau, s.tilt * turn)
            tilt_rate = np.where(ramping, slew, 1j * s.cone_rate * s.tilt * turn)
            up = (s.spin - s.spin_from) / s.ramp
            along = (s.spin_end - s.spin) / s.hold
            result["segment"][rows] = index
            result["phase"][rows] = np.where(ramping, RAMP, HOLD)
            result["tilt_x"][rows], result["tilt_y"][rows] = tilt.real, tilt.imag
            result["tilt_rate_x"][rows], result["tilt_rate_y"][rows] = tilt_rate.real, tilt_rate.imag
            result["spin_rate"][rows] = np.where(ramping, s.spin_from + up * tau, s.spin + along * held)
            result["spin_acceleration"][rows] = np.where(ramping, up, along)
        return result


def _segments(
    content: PlanFile, origin: str, start: tuple[complex, float, float] | None = None
) -> Iterator[Segment]:
    """Yield the segments; `start`: tilt [rad] and spin rate [rad/s] before them, and the least first ramp [s]."""
    tilt, spin, least = start or (complex(*content.start_tilt_deg) * DEG, math.nan, 0.0)
    time = 0.0
    environment = Environment()
    for index, block in enumerate(content.segments):
        where = f"{origin}: segments.{index}"
        speeds = block.spin_rpm if isinstance(block.spin_rpm, list) else [block.spin_rpm]
        if math.isnan(spin) and speeds[0] is None:
            raise InputError(f"{where}.spin_rpm: the first segment must give a speed")
        changes: dict[str, Any] = {
            "rig": block.rig,
            "yaw": None if block.yaw_deg is None else block.yaw_deg * DEG,
            "air_density_ratio": block.air_density_ratio,
            "preheat": block.preheat_k,
            "table_rate": None if block.table_rate_deg_s is None else block.table_rate_deg_s * DEG,
        }
        environment = replace(environment, **{k: v for k, v in changes.items() if v is not None})
        tilts: list[tuple[float, float] | None]
        if isinstance(block.tilt_deg, list):
            tilts = list(block.tilt_deg)
        elif block.cone_radius_deg is not None:
            tilts = [(block.cone_radius_deg, 0.0)]
        else:
            tilts = [block.tilt_deg]
        shuffler = random.Random(block.shuffle_seed)
        for _, rpm in itertools.product(range(block.repeat), speeds):
            order = list(tilts)
            if block.shuffle_seed is not None:
                shuffler.shuffle(order)
            for pair in order:
                target = tilt if pair is None else complex(pair[0], pair[1]) * DEG
                to = spin if rpm is None else rpm * RPM
                first = math.isnan(spin)
                start_spin = to if first else spin
                slope = (block.tilt_rate_deg_s or content.tilt_rate_deg_s) * DEG
                rise = (block.spin_acceleration_rpm_s or content.spin_acceleration_rpm_s) * RPM
                needed = max(abs(target - tilt) / slope, abs(to - start_spin) / rise, 0.05)
                ramp = block.ramp_s or needed
                if start is not None and time == 0.0:  # no plan knows how far it is
                    ramp = max(ramp, needed, least)
                ramp = _whole(ramp)
                if block.cone_radius_deg is not None and block.cone_period_s is not None:
                    cone_rate = 2.0 * math.pi / block.cone_period_s
                    hold = _whole(CONE_SETTLING + block.cone_turns * block.cone_period_s)
                else:
                    cone_rate, hold = 0.0, _whole(block.hold_s or content.hold_s)
                end = to if block.sweep_to_rpm is None else block.sweep_to_rpm * RPM
                yield Segment(
                    start=time,
                    ramp=ramp,
                    hold=hold,
                    tilt_from=tilt,
                    tilt=target,
                    spin_from=start_spin,
                    spin=to,
                    spin_end=end,
                    cone_rate=cone_rate,
                    environment=replace(environment, time=time),
                    label=block.label,
                    block=index,
                )
                time = round(time + ramp + hold, 9)
                if time > LONGEST:
                    raise InputError(
                        f"{where}: here the plan is {time:.6g} s long; allowed: up to {LONGEST:g} s "
                        "(hold_s, ramp_s, cone_turns, repeat and the number of tilts make its length)"
                    )
                tilt = target * complex(math.cos(cone_rate * hold), math.sin(cone_rate * hold))
                spin = end


def _whole(seconds: float) -> float:
    """Round up to whole setpoint periods."""
    return round(math.ceil(seconds / SETPOINT_PERIOD - 1e-9) * SETPOINT_PERIOD, 9)


def _read(text: str, origin: str) -> PlanFile:
    """Return the content of a plan file."""
    return check(PlanFile, read_yaml(text, origin), origin, kind="plan")


#: The same, cached: few plans are read again and again.
_kept = functools.lru_cache(maxsize=32)(_read)


#: What separates a plan from its variation, and the settings of a variation from each other.
MARK, BETWEEN = "@", ","
#: Settings of the environment, which then hold for the whole plan; their ranges are those of a plan's file.
_ENVIRONMENT = ("rig", "yaw_deg", "air_density_ratio", "preheat_k")
_RATIO = (0.01, 10.0)


def varied(content: Mapping[str, Any], settings: str, origin: str) -> dict[str, Any]:
    """Return the content of a plan file with some settings changed throughout.

    Parameters
    ----------
    content : mapping
        Content of a plan file, which is not changed.
    settings : str
        ``name=value``, separated by commas: `rig`, `yaw_deg`, `air_density_ratio`, `preheat_k` for the whole plan,
        `hold_s` for every hold, `tilt_ratio` and `spin_ratio` times all tilts and all speeds.
    origin : str
        What the plan is called in errors.

    Raises
    ------
    InputError
        If a setting is unknown, given twice, or no number.
    """
    result = copy.deepcopy(dict(content))
    seen = set()
    for setting in settings.split(BETWEEN):
        name, _, value = (part.strip() for part in setting.partition("="))
        if name not in _SETTINGS:
            raise InputError(f"{origin}: {name!r} cannot be varied; allowed: {', '.join(_SETTINGS)}")
        if name in seen:
            raise InputError(f"{origin}: {name} is given twice")
        seen.add(name)
        blocks = result.get("segments")
        if not isinstance(blocks, list) or not all(isinstance(block, dict) for block in blocks) or not blocks:
            return result  # the plan's own check reports it
        _SETTINGS[name](result, name, _value(name, value, origin))
        tail = re.sub(r"[^a-z0-9]+", "_", value.lower().replace("-", "m"))
        result["name"] = f"{result.get('name')}_{name}_{tail}"
    return result


def _value(name: str, text: str, origin: str) -> Any:
    if name == "rig":
        return text
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{origin}: {name}: {text!r} is not a number")
    if name.endswith("_ratio") and name not in _ENVIRONMENT and not _RATIO[0] <= number <= _RATIO[1]:
        raise InputError(
            f"{origin}: {name}: {number:g} is out of range; allowed: {_RATIO[0]:g} .. {_RATIO[1]:g}"
        )
    return number


def _surround(plan: dict[str, Any], name: str, value: Any) -> None:
    first, *others = plan["segments"]
    first[name] = value
    for block in others:
        block.pop(name, None)


def _hold(plan: dict[str, Any], name: str, value: Any) -> None:
    plan[name] = value
    for block in plan["segments"]:
        if "sweep_to_rpm" not in block:  # whose time it is
            block.pop(name, None)


def _scale(*fields: str) -> Callable[[dict[str, Any], str, Any], None]:
    def scale(plan: dict[str, Any], name: str, value: float) -> None:
        for block in plan["segments"]:
            block |= {field: _times(block[field], value) for field in fields if field in block}

    return scale


def _times(value: Any, ratio: float) -> Any:
    if isinstance(value, list):
        return [_times(item, ratio) for item in value]
    return value * ratio if isinstance(value, int | float) and not isinstance(value, bool) else value


_SETTINGS: Mapping[str, Callable[[dict[str, Any], str, Any], None]] = {
    **dict.fromkeys(_ENVIRONMENT, _surround),
    "hold_s": _hold,
    "tilt_ratio": _scale("tilt_deg", "cone_radius_deg"),
    "spin_ratio": _scale("spin_rpm", "sweep_to_rpm"),
}


def as_text(content: Mapping[str, Any]) -> str:
    """Return the text of a plan file with a content."""
    return yaml.safe_dump(
        dict(content), sort_keys=False, allow_unicode=True, default_flow_style=None, width=110
    )
