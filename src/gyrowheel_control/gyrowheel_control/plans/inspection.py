"""All problems of a plan file at once, each with its line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from gyrowheel_control.plans import demands
from gyrowheel_control.plans.demands import Segment
from gyrowheel_control.plans.plan import Plan, PlanFile, as_text
from gyrowheel_core.errors import InputError
from gyrowheel_core.quantities import short
from gyrowheel_core.schema import problems
from gyrowheel_core.units import DEG, RPM
from gyrowheel_core.yaml_text import lines, read_yaml
from gyrowheel_sim.bench import Bench

#: Keys that ask for what can be beyond a bench, those that are meant first.
_KEYS: Final[Mapping[str, tuple[str, ...]]] = {
    "spin": ("spin_rpm", "sweep_to_rpm"),
    "tilt": ("tilt_deg", "cone_radius_deg"),
    "slew": ("tilt_rate_deg_s", "cone_period_s", "ramp_s", "table_rate_deg_s"),
    "acceleration": ("spin_acceleration_rpm_s", "ramp_s", "sweep_to_rpm"),
}


class Wrong(NamedTuple):
    """A problem of a plan file."""

    line: int | None
    """Line of the file, from 1; None for the whole file."""
    place: str
    """Path of keys and block numbers, such as ``segments.2.spin_rpm``."""
    said: str
    """Problem and allowed values."""


def inspect(text: str, origin: str, bench: Bench) -> tuple[Plan | None, list[Wrong]]:
    """Return the plan in a text and all its problems on a bench, in the order of the lines.

    Unreadable blocks do not hide other problems: the other blocks are checked without them.

    Parameters
    ----------
    text : str
        Text of the file.
    origin : str
        Its name, for messages.
    bench : Bench
        The bench that shall run it.

    Returns
    -------
    Plan or None
        None where the text is no plan.
    list of Wrong
        Empty where the bench can run it.

    Raises
    ------
    InputError
        If the text is no YAML, or no mapping at all.
    """
    content = read_yaml(text, origin)
    if not isinstance(content, Mapping):
        raise InputError(f"{origin}: not a plan (a mapping with schema, name, segments is expected)")
    at = lines(text)
    found = [_wrong(at, place, said) for place, said in problems(PlanFile, content)]
    plan, whole = None, not found
    try:
        if whole:
            plan = Plan.load(text if "\n" in text else f"{text}\n")
        else:
            plan = _rest(content, [problem.place for problem in problems(PlanFile, content)], bench)
    except InputError as error:
        if whole:
            place, _, said = str(error).removeprefix("plan text: ").partition(": ")
            found.append(_wrong(at, tuple(place.split(".")), said))
    if plan is not None:
        kept = _kept(content, found) if not whole else None
        found += _beyond(at, content, plan, bench, kept)
    order = {".".join(place): k for k, place in enumerate(at)}
    return plan if whole else None, sorted(
        found, key=lambda wrong: (wrong.line or 0, order.get(wrong.place, 0))
    )


def _wrong(at: Mapping[tuple[str, ...], int], place: Sequence[str], said: str) -> Wrong:
    """Return a problem with the line of the nearest key in the file."""
    for end in range(len(place), 0, -1):
        if (line := at.get(tuple(place[:end]))) is not None:
            return Wrong(line, ".".join(place), said)
    return Wrong(None, ".".join(place), said)


def _kept(content: Mapping[str, Any], found: Sequence[Wrong]) -> list[int]:
    """Return the numbers of the blocks that can be read."""
    broken = {wrong.place.split(".")[1] for wrong in found if wrong.place.startswith("segments.")}
    blocks = content.get("segments")
    return [k for k in range(len(blocks)) if str(k) not in broken] if isinstance(blocks, list) else []


def _rest(content: Mapping[str, Any], places: Sequence[tuple[str, ...]], bench: Bench) -> Plan | None:
    """Return the plan of the readable blocks; None if there are none."""
    broken = {place[1] for place in places if place[0] == "segments" and len(place) > 1}
    gone = {place[0] for place in places if len(place) == 1 or place[0] != "segments"}
    blocks = content.get("segments")
    if not isinstance(blocks, list):
        return None
    rest = {key: value for key, value in content.items() if key not in gone} | {"schema": 1, "name": "rest"}
    rest["segments"] = [block for k, block in enumerate(blocks) if str(k) not in broken]
    if not rest["segments"]:
        return None
    if rest["segments"][0].get("spin_rpm") is None:  # it stood in a block that cannot be read
        rest["segments"][0] = {**rest["segments"][0], "spin_rpm": bench.value("spin_rate_reference") / RPM}
    return Plan.load(as_text(rest))


def _beyond(
    at: Mapping[tuple[str, ...], int],
    content: Mapping[str, Any],
    plan: Plan,
    bench: Bench,
    kept: Sequence[int] | None,
) -> Iterator[Wrong]:
    """Yield the demands beyond the bench, once a block and kind; for a partial plan only speeds and tilts."""
    told = set()
    worse = {e.segment for e in demands.excesses(plan.segments, bench) if e.key in ("spin", "tilt")}
    for excess in demands.excesses(plan.segments, bench):
        s = plan.segments[excess.segment]
        follows = excess.key in ("slew", "acceleration")
        if (s.block, excess.key) in told or (follows and (excess.segment in worse or kept is not None)):
            continue
        told.add((s.block, excess.key))
        number = s.block if kept is None else kept[s.block]
        block = content["segments"][number]
        key = next((key for key in _KEYS[excess.key] if block.get(key) is not None), "")
        place = ("segments", str(number), *([key] if key else []))
        if follows and not key and content.get(_KEYS[excess.key][0]) is not None:
            place = (_KEYS[excess.key][0],)
        called = f" ({s.label})" if s.label and follows else ""
        yield _wrong(at, place, f"{excess.said}{_cure(bench, s, excess.key)}{called}")


def _cure(bench: Bench, s: Segment, kind: str) -> str:
    """Return the possible rate, where it does not follow from the allowed voltage alone."""
    if kind == "slew" and (rate := demands.possible_slew(bench, s)) > 0.0:
        return f", so up to {short(rate / DEG)} deg/s here"
    if kind == "acceleration" and (rise := demands.possible_acceleration(bench, s)) > 0.0:
        return f", so up to {short(rise / RPM)} rpm/s here"
    return ""
