"""Test plans: what the bench does when, read from YAML, checked against the bench, turned into setpoints."""

from __future__ import annotations

import difflib
import itertools
import math
import random
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gyrowheel_control.plans.variation import MARK, as_text, varied
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, read_text
from gyrowheel_core.schema import Number, Section, Whole, check
from gyrowheel_core.units import DEG, RPM
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import AirDensityRatio, Environment, Preheat, Rig, TableRate, Yaw

#: Interval of the setpoints [s]; the controller continues each by its rates until the next.
SETPOINT_PERIOD = 0.005
RAMP, HOLD = 0, 1
#: Longest plan [s]; all its samples are held in memory.
LONGEST = 86_400.0
SETPOINT_DTYPE = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("segment", np.uint32),
        ("phase", np.uint8),
        ("tilt_x", float),
        ("tilt_y", float),
        ("tilt_rate_x", float),
        ("tilt_rate_y", float),
        ("spin_rate", float),
        ("spin_acceleration", float),
    ]
)

#: Numbers of a plan beyond any bench, so that what is computed from them stays finite.
Seconds = Annotated[Number, Field(ge=0.001, le=3600.0)]
Degrees = Annotated[Number, Field(ge=-90.0, le=90.0)]
Rpm = Annotated[Number, Field(ge=-1.0e6, le=1.0e6)]
Rate = Annotated[Number, Field(ge=1.0e-6, le=1.0e6)]
Tilt = tuple[Degrees, Degrees]


class Block(Section):
    """One entry of a plan: a hold, a grid of holds (speeds times tilts), a cone, or a change of speed.

    Angles in degrees, speeds in rpm, times in seconds, as the field names say. The environment (rig, yaw, air
    density, preheat, rate of the table) stays as it is until a block changes it.
    """

    label: str = ""
    spin_rpm: Rpm | list[Rpm] | None = None
    tilt_deg: list[Tilt] | Tilt | None = None
    hold_s: Seconds | None = None
    ramp_s: Seconds | None = None
    tilt_rate_deg_s: Rate | None = None
    spin_acceleration_rpm_s: Rate | None = None
    cone_radius_deg: Annotated[Degrees, Field(gt=0.0)] | None = None
    cone_period_s: Annotated[Number, Field(gt=0.05, le=3600.0)] | None = None
    cone_turns: Annotated[Number, Field(ge=0.001, le=1000.0)] = 1.0
    sweep_to_rpm: Rpm | None = None
    repeat: Annotated[Whole, Field(ge=1, le=1000)] = 1
    shuffle_seed: Whole | None = None
    rig: Rig | None = None
    yaw_deg: Yaw | None = None
    air_density_ratio: AirDensityRatio | None = None
    preheat_k: Preheat | None = None
    table_rate_deg_s: TableRate | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Block:
        if (self.cone_radius_deg is None) != (self.cone_period_s is None):
            raise ValueError("a cone needs both cone_radius_deg and cone_period_s")
        if self.cone_radius_deg is not None and self.tilt_deg is not None:
            raise ValueError("a block is either a cone or a grid of tilts, not both")
        if self.sweep_to_rpm is not None and self.hold_s is None:
            raise ValueError("sweep_to_rpm needs hold_s, the time that the sweep takes")
        return self


class PlanFile(Section):
    """A plan file."""

    schema_: Literal[1] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    title: str = ""
    description: str = ""
    tilt_rate_deg_s: Rate = 8.0
    spin_acceleration_rpm_s: Rate = 1000.0
    hold_s: Seconds = 1.5
    tilt_limit_deg: Annotated[Degrees, Field(gt=0.0)] | None = None
    segments: Annotated[list[Block], Field(min_length=1)]


@dataclass(frozen=True)
class Segment:
    """One ramp to a state and the steady motion after it [SI].

    Attributes
    ----------
    start, ramp, hold : float
        Start time, time of the ramp, and time of the steady motion [s].
    tilt_from, tilt : complex
        Tilt angles phi_x + i phi_y before and after the ramp [rad].
    spin_from, spin, spin_end : float
        Spin rate before and after the ramp, and at the end of the steady motion [rad/s].
    cone_rate : float
        Rate at which the tilt turns about the case axis during the steady motion [rad/s]; 0 for a hold.
    environment : Environment
        The environment in which it runs.
    label : str
        What it is called.
    """

    start: float
    ramp: float
    hold: float
    tilt_from: complex
    tilt: complex
    spin_from: float
    spin: float
    spin_end: float
    cone_rate: float
    environment: Environment
    label: str

    @property
    def end(self) -> float:
        """End time [s]."""
        return self.start + self.ramp + self.hold


class Plan:
    """A test plan: a list of segments in time.

    Use `Plan.load`; the attributes are `name`, `called` (the same, or what was typed of a variation), `title`,
    `description`, `segments`, `duration` [s] and `tilt_limit`, the tilt that the guards of the bench must allow [rad],
    or None where the usual one will do.
    """

    def __init__(self, content: PlanFile, text: str, origin: str) -> None:
        self.name = self.called = content.name
        self.title = content.title
        self.description = content.description
        self.origin = origin
        self.tilt_limit = None if content.tilt_limit_deg is None else content.tilt_limit_deg * DEG
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
        if "\n" in text:
            return cls._from_text(text, "plan text")
        base, mark, settings = text.rpartition(MARK)
        if mark and not is_file(Path(text)):
            plain = cls.load(base)
            content = varied(read_yaml(plain.to_yaml(), plain.origin), settings, f"plan '{text}'")
            plan = cls._from_text(as_text(content), f"plan '{text}'")
            plan.called = text
            return plan
        if text in cls.shipped():
            file = resources.files("gyrowheel_control").joinpath(f"plans/{text}.yaml")
            return cls._from_text(file.read_text(encoding="utf-8"), f"{text}.yaml")
        path = Path(text)
        if not is_file(path):
            near = difflib.get_close_matches(text, cls.shipped(), n=2)
            hint = f"; did you mean {', '.join(near)}?" if near else f"; shipped: {', '.join(cls.shipped())}"
            raise InputError(f"plan '{text}': no such shipped plan or file{hint}")
        return cls._from_text(read_text(path, errors="replace"), str(path))

    @classmethod
    def _from_text(cls, text: str, origin: str) -> Plan:
        content = check(PlanFile, read_yaml(text, origin), origin, kind="plan")
        return cls(content, text, origin)

    @staticmethod
    def shipped() -> list[str]:
        """Return the names of the plans that come with the project."""
        folder = resources.files("gyrowheel_control").joinpath("plans")
        return sorted(f.name.removesuffix(".yaml") for f in folder.iterdir() if f.name.endswith(".yaml"))

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
        v = bench.value
        low, high, tilt_limit = v("spin_rate_minimum"), v("spin_rate_maximum"), v("tilt_limit")
        spin_inertia, axial, tuning = bench.precession_inertia, bench.axial_inertia, bench.tuning_inertia
        for index, s in enumerate(self.segments):
            where = f"{self.origin}: segment {index}" + (f" ({s.label})" if s.label else "")
            for spin in (s.spin, s.spin_end):
                if not low * (1 - 1e-9) <= spin <= high * (1 + 1e-9):
                    raise InputError(
                        f"{where}: spin {spin / RPM:.0f} rpm is beyond the bench; "
                        f"allowed: {low / RPM:.0f} .. {high / RPM:.0f} rpm"
                    )
            if abs(s.tilt) > tilt_limit * (1 + 1e-9):
                raise InputError(
                    f"{where}: tilt {abs(s.tilt) / DEG:.2f} deg is beyond the bench; "
                    f"allowed: up to {tilt_limit / DEG:.2f} deg"
                )
            top = max(s.spin_from, s.spin, s.spin_end)
            rate = abs(s.tilt - s.tilt_from) / s.ramp
            rate = max(rate, abs(s.cone_rate) * abs(s.tilt))
            # a turning case takes the torque of a tilt that turns in a case at rest
            rate += abs(s.environment.table_rate * s.environment.up_across)
            hold = max(abs(0.5 * (v("flexure_stiffness_x") + v("flexure_stiffness_y")) - 0.5 * tuning * w * w)
                       for w in (s.spin_from, s.spin, s.spin_end)) * max(abs(s.tilt), abs(s.tilt_from))  # fmt: skip
            volts = (spin_inertia * top * rate + hold) / v("coil_constant")
            # half the range is left for damping the nutation
            if volts > 0.75 * v("coil_voltage_limit"):
                raise InputError(
                    f"{where}: slewing at {rate / DEG:.1f} deg/s and {top / RPM:.0f} rpm needs {volts:.1f} V of the "
                    f"coils; allowed: {0.75 * v('coil_voltage_limit'):.1f} V"
                )
            acceleration = max(
                abs(s.spin - s.spin_from) / s.ramp,
                abs(s.spin_end - s.spin) / s.hold,
            )
            volts = v("motor_constant") * top + v("motor_resistance") * axial * acceleration / v(
                "motor_constant"
            )
            if volts > 0.95 * v("supply_voltage"):
                raise InputError(
                    f"{where}: {acceleration / RPM:.0f} rpm/s at {top / RPM:.0f} rpm needs {volts:.1f} V of the motor; "
                    f"allowed: {0.95 * v('supply_voltage'):.1f} V"
                )

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


def _segments(content: PlanFile, origin: str) -> Iterator[Segment]:
    tilt, spin, time = 0.0 + 0.0j, math.nan, 0.0
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
                ramp = block.ramp_s or max(abs(target - tilt) / slope, abs(to - start_spin) / rise, 0.05)
                ramp = _whole(ramp)
                if block.cone_radius_deg is not None and block.cone_period_s is not None:
                    cone_rate = 2.0 * math.pi / block.cone_period_s
                    # half a second for the loop to settle on the cone, then the turns asked for
                    hold = _whole(0.5 + block.cone_turns * block.cone_period_s)
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
