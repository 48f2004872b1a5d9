"""Check of a plan file: everything that is wrong with it, or its demands on a bench."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel_control.plans.inspection import Wrong
    from gyrowheel_control.plans.plan import Plan
    from gyrowheel_sim.bench import Bench


@dataclass(frozen=True)
class Outlook:
    """Content of a plan on a bench, and its demands.

    Attributes
    ----------
    duration : float
        Length [s].
    segments, holds, cones, sweeps : int
        Number of all segments, and of those with a fixed tilt, a cone, and a change of speed.
    speeds : tuple of float
        Spin rates, from the lowest on [rad/s].
    largest_tilt : float
        [rad].
    coil_share, motor_share : float
        Largest voltage of coils and motor, without losses of the motor, over the limit.
    windows : int
        Number of windows of whole revolutions into which the analysis divides the steady motion.
    covered : float
        Their length [s].
    empty : tuple of str
        Segments that are too short for a window, a text each.
    """

    duration: float
    segments: int
    holds: int
    cones: int
    sweeps: int
    speeds: tuple[float, ...]
    largest_tilt: float
    coil_share: float
    motor_share: float
    windows: int
    covered: float
    empty: tuple[str, ...]


@dataclass(frozen=True)
class CheckedPlan:
    """Outcome of the check of a plan file.

    Attributes
    ----------
    file : str
        The plan file.
    bench : str
        Name of the bench.
    wrong : tuple of Wrong
        All that is wrong, each with `line` (or None), `place` and `said`; empty if the bench can run the plan.
    plan : Plan or None
        The plan, if it can be read.
    outlook : Outlook or None
        What it will do, if nothing is wrong.
    """

    file: str
    bench: str
    wrong: tuple[Wrong, ...]
    plan: Plan | None
    outlook: Outlook | None

    @property
    def good(self) -> bool:
        """Whether the bench can run it."""
        return not self.wrong


def check_text(text: str, origin: str, loaded: Bench) -> CheckedPlan:
    """Check the text of a plan file, which messages call `origin`."""
    from gyrowheel_control.loops.supervision import plan_tilt_limit, usual_tilt_limit
    from gyrowheel_control.plans.inspection import Wrong, inspect

    plan, wrong = inspect(text, origin, loaded)
    if plan is not None and not wrong:
        plan.origin = origin
        try:
            plan_tilt_limit(plan, loaded, usual_tilt_limit(loaded))
        except InputError as error:
            wrong = [Wrong(None, "tilt_limit_deg", str(error).removeprefix(f"{origin}: "))]
    outlook = _outlook(plan, loaded) if plan is not None and not wrong else None
    return CheckedPlan(origin, loaded.name, tuple(wrong), plan, outlook)


def _outlook(plan: Plan, bench: Bench) -> Outlook:
    from gyrowheel_analysis.reduction.segmentation import planned_windows
    from gyrowheel_control.plans import demands

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
