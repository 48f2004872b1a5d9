"""Plans for any bench: shipped plans adapted to its limits, and a template for a plan file."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from gyrowheel_control.plans import demands
from gyrowheel_control.plans.demands import Segment
from gyrowheel_control.plans.plan import MARK, Plan, PlanFile, as_text
from gyrowheel_core.errors import InputError
from gyrowheel_core.quantities import short
from gyrowheel_core.units import DEG, RPM
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_sim.bench import Bench

#: Part of what coils and motor allow that a plan takes where it must be slowed down.
_SHARE: Final = 0.9
#: Part of what coils allow that holding the flexures may take; the rest is for slewing.
_HELD: Final = 0.5
_DIGITS: Final = 3  # of speeds and tilts
_SLOWEST: Final = 1e-4  # rad/s, rad/s^2: a rate where coils or motor have nothing left
_COARSE: Final = 2  # of rates, which are rounded down, and of times, which are rounded up


def plan_for(source: str | Path | Plan, bench: Bench) -> Plan:
    """Return the plan that a bench runs under a name, checked.

    A shipped plan is made for the limits of one bench. For another bench, it is replaced by the plan shipped for that
    bench (``dtg_cone`` for ``cone``), or adapted to its limits (`adapted`). A user's plan is not changed.

    Raises
    ------
    InputError
        If there is no such plan, or it is beyond the limits of the bench.
    """
    plan = source if isinstance(source, Plan) else Plan.load(source)
    if plan.written_for:
        own = f"{bench.name}_{plan.called}"
        if own.partition(MARK)[0] in Plan.shipped() and plan.written_for != bench.name:
            plan = Plan.load(own)
        plan = adapted(plan, bench)
    plan.check(bench)
    return plan


def plan_from_hold(plan: Plan, bench: Bench, tilt: complex, spin: float) -> Plan:
    """Return a plan for a bench that is held at a state: a ramp that coils and motor can follow leads from there.

    `tilt`: tilt angles phi_x + i phi_y that are held [rad]; `spin`: spin rate [rad/s]. Raises InputError if the plan
    becomes too long.
    """
    begun = plan.beginning_at(tilt, spin)
    first = begun.segments[0]
    slew, acceleration = (
        max(possible(bench, first, _SHARE), _SLOWEST)
        for possible in (demands.possible_slew, demands.possible_acceleration)
    )
    least = max(abs(first.tilt - tilt) / slew, abs(first.spin - spin) / acceleration)
    return begun if least <= first.ramp else plan.beginning_at(tilt, spin, least)


def adapted(plan: Plan, bench: Bench) -> Plan:
    """Return a shipped plan with the speeds, tilts and rates of a bench; the plan itself where nothing changes.

    The lowest, the reference and the highest speed of the bench for which it was written become those of this bench,
    with linear interpolation between; tilts are scaled with the largest tilt. Then everything that coils or motor
    cannot follow is slowed down: rates from hold to hold, cones, sweeps, the rate table. `Plan.fitting` lists the
    changes.

    Raises
    ------
    InputError
        If the bench cannot even reach its lowest speed, or hold any tilt.
    """
    base = _bench(plan.written_for)
    speeds, tilts = _speeds(base, bench), bench.value("tilt_limit") / base.value("tilt_limit")
    tilts = 1.0 if math.isclose(tilts, 1.0, rel_tol=1e-9) else tilts
    if speeds.same and tilts == 1.0 and (not _beyond(plan, bench) or _beyond(plan, base)):
        return plan  # also a variation that no bench of these limits can run
    content = read_yaml(plan.to_yaml(), plan.origin)
    change = _Change(plan, content, bench)
    change.map_speeds(speeds)
    change.scale_tilts(tilts)
    change.hold_longer(base.value("spin_rate_minimum") / bench.value("spin_rate_minimum"))
    change.ease_tilts()
    change.slow_down()
    return change.result()


def _beyond(plan: Plan, bench: Bench) -> bool:
    return any(True for _ in demands.excesses(plan.segments, bench))


@functools.cache
def _bench(name: str) -> Bench:
    return Bench.load(name)


@dataclass(frozen=True)
class _Speeds:
    """A map from the speeds of one bench to those of another, straight between the knots and beyond them."""

    knots: tuple[tuple[float, float], ...]

    @property
    def same(self) -> bool:
        return all(math.isclose(a, b, rel_tol=1e-9) for a, b in self.knots)

    def __call__(self, speed: float) -> float:
        pairs = list(zip(self.knots, self.knots[1:], strict=False))
        (x0, y0), (x1, y1) = next((pair for pair in pairs if speed <= pair[1][0]), pairs[-1])
        return y0 + (speed - x0) * (y1 - y0) / (x1 - x0)


def _speeds(base: Bench, bench: Bench) -> _Speeds:
    low, high = bench.value("spin_rate_minimum"), min(bench.value("spin_rate_maximum"), top_reach(bench))
    if high <= low:
        raise InputError(
            f"{bench.origin}: parameters.supply_voltage: {bench.value('supply_voltage'):g} V bring the motor to "
            f"{high / RPM:.0f} rpm; allowed: more than spin_rate_minimum, {low / RPM:.0f} rpm"
        )
    before, now = base.value("spin_rate_reference"), bench.value("spin_rate_reference")
    knots = [(base.value("spin_rate_minimum"), low), (before, now), (base.value("spin_rate_maximum"), high)]
    if not (low < now < high and knots[0][0] < before < knots[2][0]):
        del knots[1]
    return _Speeds(tuple(knots))


def top_reach(bench: Bench) -> float:
    """Return the speed up to which the supply leaves some voltage for accelerating [rad/s]."""
    return _SHARE * demands.SUPPLY_SHARE * bench.value("supply_voltage") / bench.value("motor_constant")


class _Change:
    """A plan in adaptation to another bench: content of its file, and the changes in words."""

    def __init__(self, plan: Plan, content: Any, bench: Bench) -> None:
        self._plan, self._content, self._bench = plan, content, bench
        self._said: list[str] = []
        self._speed: Callable[[float], float] = float
        self._tilt = self._table = 1.0

    @property
    def _blocks(self) -> list[dict[str, Any]]:
        return list(self._content["segments"])

    def _segments(self) -> Sequence[Segment]:
        return Plan.load(as_text(self._content)).segments

    def map_speeds(self, speeds: _Speeds) -> None:
        if speeds.same:
            return
        limits = speeds.knots[0][1] / RPM, speeds.knots[-1][1] / RPM

        def mapped(rpm: float) -> float:
            there = speeds(float(rpm) * RPM) / RPM
            rounded = _rounded(there, _DIGITS)
            # rounding must not lead beyond a limit that the speed itself keeps
            inside = limits[0] * (1 - 1e-9) <= there <= limits[1] * (1 + 1e-9)
            return min(max(rounded, limits[0]), limits[1]) if inside else rounded

        self._speed = mapped
        before = _range(self._blocks, "spin_rpm", "sweep_to_rpm")
        for block in self._blocks:
            for key in ("spin_rpm", "sweep_to_rpm"):
                if block.get(key) is not None:
                    block[key] = _each(block[key], mapped)
        after = _range(self._blocks, "spin_rpm", "sweep_to_rpm")
        self._said.append(f"speeds {before} → {after} rpm")

    def scale_tilts(self, ratio: float) -> None:
        if ratio == 1.0:
            return
        self._tilt *= ratio

        def scaled(value: float) -> float:
            return _rounded(float(value) * ratio, _DIGITS)

        before = self._largest_tilt()
        for block in self._blocks:
            for key in ("tilt_deg", "cone_radius_deg"):
                if block.get(key) is not None:
                    block[key] = _each(block[key], scaled)
        for key in ("tilt_limit_deg", "start_tilt_deg"):
            if self._content.get(key) is not None:
                self._content[key] = _each(self._content[key], scaled)
        if before > 0.0:
            self._said.append(f"largest tilt {short(before)} → {short(self._largest_tilt())} deg")

    def _largest_tilt(self) -> float:
        return max(abs(s.tilt) for s in self._segments()) / DEG

    def hold_longer(self, ratio: float) -> None:
        """Lengthen holds so that the slowest speed has as many turns as on the bench of the plan."""
        if ratio <= 1.0 + 1e-9:
            return
        before = self._content.get("hold_s", PlanFile.model_fields["hold_s"].default)
        self._content["hold_s"] = _up(float(before) * ratio)
        for block in self._blocks:
            if block.get("hold_s") is not None:
                block["hold_s"] = _up(float(block["hold_s"]) * ratio)
        self._said.append(f"holds {short(float(before))} → {short(self._content['hold_s'])} s")

    def ease_tilts(self) -> None:
        """Make tilts small enough for the coils to hold the flexures there."""
        bench = self._bench
        allowed = (
            _HELD * demands.COIL_SHARE * bench.value("coil_voltage_limit") * bench.value("coil_constant")
        )
        needed = max(demands.held_torque(bench, s) for s in self._segments())
        if needed > allowed:
            self.scale_tilts(_down(allowed / needed))

    def slow_down(self) -> None:
        """Slow down what coils and motor cannot follow, except in a variation that exceeds the bench anyway."""
        segments = self._segments()
        if any(excess.key in ("spin", "tilt") for excess in demands.excesses(segments, self._bench)):
            return
        self._slow_table(segments)
        rate = min((self._tilt_rate(s) for s in segments), default=math.inf)
        self._limit("tilt_rate_deg_s", rate / DEG, "tilt rate", "deg/s")
        rise = min((self._acceleration(s) for s in segments), default=math.inf)
        self._limit("spin_acceleration_rpm_s", rise / RPM, "acceleration", "rpm/s")
        slower = set()
        for index, block in enumerate(self._blocks):
            own = [s for s in segments if s.block == index]
            if block.get("cone_period_s") is not None:
                least = max(2.0 * math.pi * abs(s.tilt) / self._tilt_rate(s) for s in own)
                if float(block["cone_period_s"]) < least:
                    block["cone_period_s"] = _up(least)
                    slower.add("cones")
            if block.get("sweep_to_rpm") is not None:
                least = max(abs(s.spin_end - s.spin) / self._acceleration(s) for s in own)
                if float(block["hold_s"]) < least:
                    block["hold_s"] = _up(least)
                    slower.add("sweeps")
            if block.get("ramp_s") is not None:
                least = max(
                    max(
                        abs(s.tilt - s.tilt_from) / self._tilt_rate(s),
                        abs(s.spin - s.spin_from) / self._acceleration(s),
                    )
                    for s in own
                )
                if float(block["ramp_s"]) < least:
                    block["ramp_s"] = _up(least)
                    slower.add("ramps")
        if slower:
            self._said.append(f"{' and '.join(sorted(slower))} slower")

    def _tilt_rate(self, s: Segment) -> float:
        return max(demands.possible_slew(self._bench, s, _SHARE, self._table), _SLOWEST)

    def _acceleration(self, s: Segment) -> float:
        return max(demands.possible_acceleration(self._bench, s, _SHARE), _SLOWEST)

    def _limit(self, key: str, most: float, words: str, unit: str) -> None:
        """Bring a rate of the plan, and of its blocks, down to what is possible."""
        before = float(self._content.get(key, PlanFile.model_fields[key].default))
        after = before
        if before > most:
            after = self._content[key] = _down(most)
        for block in self._blocks:
            if block.get(key) is not None and float(block[key]) > most:
                block[key] = after = _down(most)
        if after < before:
            self._said.append(f"{words} {short(before)} → {short(after)} {unit}")

    def _slow_table(self, segments: Sequence[Segment]) -> None:
        """Let the rate table take half of what the coils can follow, at most."""
        turning = [s for s in segments if demands.table_rate(s) > 0.0]
        self._table = 0.0  # the rates beside it
        ratio = min((0.5 * self._tilt_rate(s) / demands.table_rate(s) for s in turning), default=1.0)
        self._table = 1.0
        if ratio < 1.0:
            self._table = ratio = _down(ratio)
            for block in self._blocks:
                if block.get("table_rate_deg_s") is not None:
                    block["table_rate_deg_s"] = _rounded(float(block["table_rate_deg_s"]) * ratio, _DIGITS)
            self._said.append(f"rates of the table × {short(ratio)}")

    def result(self) -> Plan:
        """Return the plan, with updated numbers in its texts."""
        plan, name = self._plan, self._bench.name
        content = self._content
        for block in self._blocks:
            if block.get("label"):
                block["label"] = self._retold(str(block["label"]))
        content["title"] = self._retold(f"{plan.title} (bench {name})")
        said = "; ".join(self._said)
        content["description"] = f"The plan {plan.called} for the limits of the bench {name}: {said}."
        made = Plan.load(as_text(content))
        made.called, made.origin = plan.called, f"plan {plan.called} for the bench {name}"
        made.fitting = tuple(self._said)
        return made

    def _retold(self, text: str) -> str:
        """Return a label with updated speeds, tilts and rates of the table."""

        def speed(found: re.Match[str]) -> str:
            parts = [
                number if number is None else short(self._speed(float(number))) for number in found.groups()
            ]
            return " to ".join(part for part in parts if part is not None) + " rpm"

        text = re.sub(r"(?:(\d+(?:\.\d+)?) to )?(\d+(?:\.\d+)?) rpm\b(?!/)", speed, text)
        text = re.sub(
            r"(\d+(?:\.\d+)?) deg/s",
            lambda m: f"{short(_rounded(float(m[1]) * self._table, _DIGITS))} deg/s",
            text,
        )
        return re.sub(
            r"(\d+(?:\.\d+)?) deg\b(?!/)",
            lambda m: f"{short(_rounded(float(m[1]) * self._tilt, _DIGITS))} deg",
            text,
        )


def _each(value: Any, change: Callable[[float], float]) -> Any:
    return [_each(item, change) for item in value] if isinstance(value, list | tuple) else change(value)


def _flat(value: Any) -> list[float]:
    return [number for item in value for number in _flat(item)] if isinstance(value, list) else [float(value)]


def _range(blocks: Sequence[dict[str, Any]], *names: str) -> str:
    values = [
        number
        for block in blocks
        for name in names
        if block.get(name) is not None
        for number in _flat(block[name])
    ]
    low, high = min(values), max(values)
    return short(low) if low == high else f"{short(low)} .. {short(high)}"


def _rounded(value: float, digits: int) -> float:
    number = float(f"{value:.{digits}g}")
    return int(number) if number.is_integer() else number


def _down(value: float) -> float:
    """Round down to two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - _COARSE + 1)
    return _rounded(math.floor(value / step + 1e-9) * step, _COARSE)


def _up(value: float) -> float:
    """Round up to two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - _COARSE + 1)
    return _rounded(math.ceil(value / step - 1e-9) * step, _COARSE)


#: The plan whose speeds, tilts and rates it takes.
_PATTERN: Final = "quick"

_TEXT: Final = """\
# A test plan for the bench {bench}. docs/plans.md has every key; `gyrowheel plans --check` finds what is wrong.
# Angles in degrees, speeds in rpm, times in seconds, as the keys say.
schema: 1
name: {name}
title: What it shows, in one line
description: What it is for.
hold_s: {hold}  # how long every tilt is held; half a second of it settles, a whole one after a change of speed
tilt_rate_deg_s: {rate}  # from one tilt to the next; at {fast} rpm this bench follows up to {most_rate} deg/s
spin_acceleration_rpm_s: {rise}  # from one speed to the next; near {fast} rpm up to {most_rise} rpm/s
# A tilt beyond three fifths of the hard stop, {usual} of {stop} deg, must be asked for:
# tilt_limit_deg: {wide}
segments:
  # Holds: tilts [phi_x, phi_y], one after the other. Speeds of this bench: {low} .. {high} rpm.
  - {{label: holds, spin_rpm: {fast}, tilt_deg: [[0, 0], [{tilt}, 0], [0, {tilt}], [-{tilt}, 0], [0, -{tilt}]]}}
  # A cone: the tilt turns about the case axis. It shows what moves with the rate of the tilt, and calibrates the coils.
  - {{label: cone, cone_radius_deg: {tilt}, cone_period_s: {period}, cone_turns: 1}}
  # A grid: every tilt at every speed; what is not said stays as it was. Three speeds tell most effects apart.
  - {{label: grid, spin_rpm: [{slow}, {middle}], tilt_deg: [[0, 0], [{tilt}, 0], [0, -{tilt}]]}}
  # A sweep of the speed:
  # - {{label: sweep, tilt_deg: [0, 0], sweep_to_rpm: {slow}, hold_s: 20}}
  # Rig, yaw, air density, preheat and rate table stay as they are until another block changes them:
  # - {{label: low pressure, spin_rpm: {fast}, air_density_ratio: 0.3, tilt_deg: [[0, 0], [{tilt}, 0]]}}
  # - {{label: upside down, rig: inverted, air_density_ratio: 1, tilt_deg: [[0, 0], [{tilt}, 0]]}}
  # - {{label: warm coils, rig: upright, preheat_k: 20, tilt_deg: [[{tilt}, 0], [0, {tilt}]]}}
"""


def plan_template(bench: Bench, name: str) -> str:
    """Return the text of a plan file for a bench.

    Parameters
    ----------
    bench : Bench
        The bench: speeds, tilts and rates are its own.
    name : str
        What the plan is called, such as the stem of its file; what a name may not have becomes ``_``.

    Raises
    ------
    InputError
        If the bench can run no plan at all.
    """
    plan = plan_for(_PATTERN, bench)
    content: dict[str, Any] = read_yaml(plan.to_yaml(), plan.origin)
    usual = demands.USUAL_SHARE * bench.value("tilt_limit")
    tilt = 0.8 * min(usual, max(abs(s.tilt) for s in plan.segments))
    speeds = sorted({s.spin for s in plan.segments})
    fastest = max(plan.segments, key=lambda s: (s.spin, abs(s.tilt)))
    period = max(float(block["cone_period_s"]) for block in content["segments"] if "cone_period_s" in block)
    stem = re.sub(r"[^a-z0-9_]+", "_", name.lower()).strip("_")
    return _TEXT.format(
        bench=bench.name,
        name=stem if stem[:1].isalpha() else f"plan_{stem}".rstrip("_"),
        hold=short(float(content.get("hold_s", 1.5))),
        rate=short(float(content.get("tilt_rate_deg_s", 8.0))),
        rise=short(float(content.get("spin_acceleration_rpm_s", 1000.0)), 4),
        most_rate=short(demands.possible_slew(bench, fastest) / DEG),
        most_rise=short(demands.possible_acceleration(bench, fastest) / RPM),
        usual=short(usual / DEG),
        stop=short(bench.value("tilt_limit") / DEG),
        wide=short(0.9 * bench.value("tilt_limit") / DEG, 2),
        low=short(bench.value("spin_rate_minimum") / RPM),
        high=short(bench.value("spin_rate_maximum") / RPM),
        fast=short(speeds[-1] / RPM),
        middle=short(speeds[len(speeds) // 2] / RPM),
        slow=short(speeds[0] / RPM),
        tilt=short(tilt / DEG, 2),
        period=short(period),
    )
