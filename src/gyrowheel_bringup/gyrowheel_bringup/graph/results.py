"""Progress, result and errors of a graph, and the check that a recording has all samples of its plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import info

_CLOCK_PERIOD_NS = 10_000_000  # plans end at whole multiples of this


class GraphError(RuntimeError):
    """A node failed, or the graph makes no progress.

    Attributes
    ----------
    node : str
        The node that failed; empty if it was not a single node.
    fault : str
        Name of the failure: the fault or guard state that the node itself named (``controller_silent``,
        ``tilt_stop``, ``clock_jump`` ...), ``node_died``, ``start_timeout``, ``stalled``, ``samples_lost``,
        ``strangers`` (other nodes published on the topics of the bench), ``plan_refused`` or ``plan_aborted``.
    report : str
        Exit code and last log lines of every node that did not end well, in several lines.
    """

    def __init__(self, fault: str, message: str, *, node: str = "", report: str = "") -> None:
        super().__init__(message)
        self.fault = fault
        self.node = node
        self.report = report


@dataclass(frozen=True)
class Progress:
    """Progress of a plan."""

    #: Number of the current segment, from 0, and number of segments.
    segment: int
    segments: int
    label: str  # label of the current segment
    #: Simulated time since the start of the plan, and its length [s].
    elapsed: float
    duration: float


@dataclass(frozen=True)
class GraphResult:
    """Result of a run of a plan."""

    plan: str  # name of the plan
    segments: int  # segments completed
    #: Simulated time of the plan, and wall-clock time from its acceptance to its end [s].
    simulated_seconds: float
    wall_seconds: float
    recording: Path | None  # directory of the recording
    samples: int  # samples recorded; 0 without a recording
    #: Messages recorded, by topic; empty without a recording, and while it is in progress.
    counts: Mapping[str, int]
    pids: Mapping[str, int]  # process ids of the nodes
    #: In real time, the counts of the plant: ``late_commands``, ``missing_commands``, ``held_samples``,
    #: ``late_samples``, ``displaced_samples``, ``worst_delay_ms``, ``behind_s``; empty in lock-step.
    pace: Mapping[str, float] = field(default_factory=dict)
    #: Drag estimates of the plan, in the order of time; without those of the last hold while the graph goes
    #: on.
    estimates: tuple[Estimate, ...] = ()

    @property
    def ratio(self) -> float:
        """Simulated seconds per second of wall-clock time."""
        return self.simulated_seconds / self.wall_seconds


def counted(record: Path, plan: Plan, sample_period: float, *, exactly: bool) -> tuple[dict[str, int], int]:
    """Return the messages of a completed recording by topic, and its samples.

    Parameters
    ----------
    record : Path
        The recording.
    plan : Plan
        The plan that was run.
    sample_period : float
        Time between two samples [s].
    exactly : bool
        Whether it must have exactly the samples of the plan, as in lock-step; else it must last at least as long.

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
        # the last one is the first without a setpoint
        published = -(-end_ns // round(sample_period * 1e9)) + 1
        if samples != published:
            raise GraphError("samples_lost", f"{record}: {samples} samples recorded of {published} published")
        return dict(found.topics), samples
    if missing:
        raise GraphError("samples_lost", f"{record}: {missing} of {samples + missing} samples are missing")
    # by the stamps: a pause of the bench has no samples, and the times are right
    if found.duration < plan.duration - 1.5 * sample_period:
        raise GraphError(
            "samples_lost",
            f"{record}: lasts {found.duration:.4g} s, but the plan takes {plan.duration:.4g} s: its end is missing",
        )
    return dict(found.topics), samples
