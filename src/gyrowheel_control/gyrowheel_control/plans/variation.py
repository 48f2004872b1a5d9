"""Variations of a plan: the same at other speeds or tilts, or in another environment, as ``survey@rig=inverted``."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import yaml

from gyrowheel_core.errors import InputError

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
