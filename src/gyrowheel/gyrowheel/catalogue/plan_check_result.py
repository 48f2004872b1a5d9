"""What a plan file asks of a bench: all that is wrong with it, or what it will do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gyrowheel.show.result import Result

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel_control.plans.inspection import Wrong
    from gyrowheel_control.plans.plan import Plan


@dataclass(frozen=True)
class Outlook:
    """What a plan will do on a bench.

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
        Largest voltage that coils and motor need, losses of the motor aside, over the largest that there is.
    windows : int
        Number of windows of whole revolutions into which the analysis divides the steady motion.
    covered : float
        Their length [s].
    empty : tuple of str
        Segments that are too short for a window, in words.
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


@dataclass(frozen=True, repr=False)
class PlanCheck(Result):
    """Outcome of `gyrowheel.check_plan`.

    Attributes
    ----------
    file : str
        The plan file.
    bench : str
        Name of the bench.
    wrong : tuple of Wrong
        All that is wrong, each with `line` (or None), `place` and `said`; empty where the bench can run the plan.
    plan : Plan or None
        The plan, where it can be read.
    outlook : Outlook or None
        What it will do, where nothing is wrong.
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

    def __str__(self) -> str:
        """Return what is wrong, a line each, or what it will do."""
        from gyrowheel.catalogue.plan_page import outlook_lines, wrong_line

        if self.outlook is None:
            return "\n".join(f"{self.file}:{wrong_line(item)}" for item in self.wrong)
        return "\n".join([f"{self.file}: nothing wrong, bench {self.bench}", *outlook_lines(self.outlook)])

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.catalogue.plan_page import check_page

        return check_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel plans --check --json``."""
        from dataclasses import asdict

        return {
            "schema": 1,
            "file": self.file,
            "bench": self.bench,
            "good": self.good,
            "wrong": [item._asdict() for item in self.wrong],
            "outlook": None if self.outlook is None else asdict(self.outlook),
        }

    def to_columns(self) -> Mapping[str, Any]:
        """Return what is wrong, one a row."""
        return {name: [getattr(item, name) for item in self.wrong] for name in ("line", "place", "said")}
