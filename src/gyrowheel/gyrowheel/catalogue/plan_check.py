"""Plan files of one's own: a new one to begin with, and all that is wrong with one at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gyrowheel.catalogue.plan_check_result import Outlook, PlanCheck
from gyrowheel_analysis.reduction import planned_windows
from gyrowheel_control.loops.supervision import plan_tilt_limit, usual_tilt_limit
from gyrowheel_control.plans import demands
from gyrowheel_control.plans.adaptation import skeleton
from gyrowheel_control.plans.format import json_schema
from gyrowheel_control.plans.inspection import Wrong, inspect
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import read_text, write_text
from gyrowheel_sim.bench import Bench


def check_plan(file: str | Path, bench: str | Path | Bench = "gyrowheel") -> PlanCheck:
    """Look at a plan file: return all that is wrong with it, or what it will do.

    Parameters
    ----------
    file : str or Path
        The plan file.
    bench : str, Path or Bench
        The bench that shall run it.

    Raises
    ------
    InputError
        If the file cannot be read, or is no YAML.
    """
    loaded = bench if isinstance(bench, Bench) else Bench.load(bench)
    return check_text(read_text(Path(file), errors="replace"), str(file), loaded)


def check_text(text: str, origin: str, loaded: Bench) -> PlanCheck:
    """Return the same for the text of a plan file, which messages call `origin`."""
    plan, wrong = inspect(text, origin, loaded)
    if plan is not None and not wrong:
        plan.origin = origin
        try:
            plan_tilt_limit(plan, loaded, usual_tilt_limit(loaded))
        except InputError as error:
            wrong = [Wrong(None, "tilt_limit_deg", str(error).removeprefix(f"{origin}: "))]
    return PlanCheck(
        origin,
        loaded.name,
        tuple(wrong),
        plan,
        _outlook(plan, loaded) if plan is not None and not wrong else None,
    )


def new_plan(file: str | Path, bench: str | Path | Bench = "gyrowheel") -> None:
    """Write a plan file to begin with, which the bench can run.

    Raises
    ------
    InputError
        If the file is there already or cannot be written, or the bench can run no plan.
    """
    loaded = bench if isinstance(bench, Bench) else Bench.load(bench)
    if Path(file).exists():
        raise InputError(f"{file}: exists; name a new file")
    write_text(Path(file), skeleton(loaded, Path(file).stem))


def plan_schema() -> dict[str, Any]:
    """Return the JSON schema of plan files, with which editors complete and check them."""
    return json_schema()


def _outlook(plan: Plan, bench: Bench) -> Outlook:
    segments, v = plan.segments, bench.value
    volts = [demands.coil_volts(bench, s) for s in segments]
    motor = [demands.motor_volts(bench, demands.top_speed(s), demands.spin_acceleration(s)) for s in segments]
    windows = planned_windows(plan, bench)
    starts = [float(start) for start in windows.start]
    empty = [
        f"{plan.place(k).removeprefix(f'{plan.origin}: ')}, {s.hold:g} s steady"
        for k, s in enumerate(segments)
        if not any(s.start <= start < s.end for start in starts)
    ]
    return Outlook(
        duration=plan.duration,
        segments=len(segments),
        holds=sum(not s.cone_rate and s.spin_end == s.spin for s in segments),
        cones=sum(bool(s.cone_rate) for s in segments),
        sweeps=sum(s.spin_end != s.spin for s in segments),
        speeds=tuple(sorted({w for s in segments for w in (s.spin, s.spin_end)})),
        largest_tilt=max(abs(s.tilt) for s in segments),
        coil_share=max(volts) / v("coil_voltage_limit"),
        motor_share=max(motor) / v("supply_voltage"),
        windows=len(windows),
        covered=float(sum(windows.duration)),
        empty=tuple(empty),
    )
