"""Test plans: read from YAML, checked against the bench, converted to setpoints."""

from __future__ import annotations

import copy
import difflib
import functools
import itertools
import math
import os
import random
from collections.abc import Iterator
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_control.plans.demands import Segment, excesses
from gyrowheel_control.plans.format import CONE_SETTLING, PlanFile
from gyrowheel_control.plans.variation import MARK, as_text, varied
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, read_text
from gyrowheel_core.schema import check
from gyrowheel_core.units import DEG, RPM
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment

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
