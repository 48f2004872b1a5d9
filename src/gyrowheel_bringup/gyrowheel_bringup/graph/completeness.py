"""Whether the recording of a plan holds all its samples."""

from __future__ import annotations

from pathlib import Path

from gyrowheel_bringup.graph.results import GraphError
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import info

_CLOCK_PERIOD_NS = 10_000_000  # plans end at whole multiples of this


def counted(record: Path, plan: Plan, sample_period: float, *, exactly: bool) -> tuple[dict[str, int], int]:
    """Return the messages of a completed recording by topic, and its samples.

    Parameters
    ----------
    record : Path
        The recording.
    plan : Plan
        The plan that was walked.
    sample_period : float
        Time between two samples [s].
    exactly : bool
        Whether it has the samples of the plan and no others, as in lock-step; else it lasts at least as long.

    Raises
    ------
    GraphError
        If it lacks a sample of the plan.
    """
    found = info(record)
    samples, missing = found.integrity.samples, found.integrity.missing
    if exactly:
        end_ns = round(plan.duration * 1e9)
        end_ns += -end_ns % _CLOCK_PERIOD_NS
        # the last one is the first at which no setpoint holds any more
        published = -(-end_ns // round(sample_period * 1e9)) + 1
        if samples != published:
            raise GraphError("samples_lost", f"{record}: {samples} samples recorded of {published} published")
        return dict(found.topics), samples
    if missing:
        raise GraphError("samples_lost", f"{record}: {missing} of {samples + missing} samples are missing")
    # by the stamps: where the bench stood still there are fewer samples, and their times are true
    if found.duration < plan.duration - 1.5 * sample_period:
        raise GraphError(
            "samples_lost",
            f"{record}: lasts {found.duration:.4g} s, but the plan takes {plan.duration:.4g} s: its end is missing",
        )
    return dict(found.topics), samples
