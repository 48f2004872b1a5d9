"""Statements of the paper, their findings, and the evidence, computed once when it is needed."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gyrowheel.drag_comparison.api import drag
from gyrowheel.models.api import Model
from gyrowheel.momentum_envelope.api import Momentum, momentum
from gyrowheel.recordings.api import Recording
from gyrowheel.simulation.api import simulate
from gyrowheel.torque_budget.api import Torques, torques
from gyrowheel_air.correlations import Drag as Correlated
from gyrowheel_air.correlations import drag as correlated
from gyrowheel_air.flow import Flow, shipped
from gyrowheel_air.geometry import Geometry
from gyrowheel_air.surrogate import air_effects
from gyrowheel_air.table import TorqueTable
from gyrowheel_air.torque import AirState
from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import draw_machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
#: The experiment's tilt and speeds [rad, rad/s].
TILT = 3.0 * DEG
SPEEDS = tuple(rpm * RPM for rpm in (1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 3500.0, 4000.0))
REFERENCE = 3500.0 * RPM
_MACHINE = 1  # seed of the machine that is calibrated


Verdict = Literal["agree", "disagree", "cannot be decided"]
VERDICTS: tuple[Verdict, ...] = ("agree", "disagree", "cannot be decided")


@dataclass(frozen=True)
class Finding:
    """Judgement of one statement.

    Attributes
    ----------
    verdict : str
        ``agree``, ``disagree`` or ``cannot be decided``.
    ours : str
        Computed numbers, in words.
    why : str
        Reason of the verdict.
    values : mapping of str to float
        Numbers [SI], by names that end in their unit.
    draw : callable, optional
        Makes the picture.
    """

    verdict: Verdict
    ours: str
    why: str
    values: Mapping[str, float] = field(default_factory=dict)
    draw: Callable[[], Figure] | None = None


@dataclass(frozen=True)
class Row:
    """A statement of the paper with its finding.

    Attributes
    ----------
    name : str
        Short name, also of the picture.
    where : str
        Figure, table, equation or section.
    statement : str
        Content of the statement, in other words.
    finding : Finding
        The finding.
    """

    name: str
    where: str
    statement: str
    finding: Finding

    def to_dict(self) -> dict[str, Any]:
        """Return the row as in the JSON file."""
        found = self.finding
        return {
            "name": self.name,
            "where": self.where,
            "statement": self.statement,
            "verdict": found.verdict,
            "ours": found.ours,
            "why": found.why,
            "values": dict(found.values),
            "picture": f"{self.name}.png" if found.draw is not None else None,
        }


@dataclass(frozen=True)
class JudgedPaper:
    """Statements of the paper with their findings.

    Attributes
    ----------
    rows : tuple of Row
        The statements, in the order of the paper.
    total : int
        Number of all statements; more than rows if the run was interrupted or some were selected.
    seed : int
        Seed of the noise of the recordings.
    """

    rows: tuple[Row, ...]
    total: int
    seed: int

    def counts(self) -> dict[Verdict, int]:
        """Return the number of rows of each verdict."""
        return {verdict: sum(row.finding.verdict == verdict for row in self.rows) for verdict in VERDICTS}


Judge: TypeAlias = Callable[["Evidence"], Finding]


class Statement(NamedTuple):
    """A statement of the paper: its name, place and content (see `Row`), and the function that judges it."""

    name: str
    where: str
    statement: str
    judge: Judge


class Statements(list[Statement]):
    """Statements of a part of the paper, in its order; called with name, place and content it decorates a judge."""

    def __call__(self, name: str, where: str, statement: str) -> Callable[[Judge], Judge]:
        """Return a decorator that adds a statement."""

        def add(judge: Judge) -> Judge:
            self.append(Statement(name, where, statement, judge))
            return judge

        return add


class Evidence:
    """Bench, air, flow and recordings; the seed is that of the noise of the recordings."""

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    @functools.cached_property
    def bench(self) -> Bench:
        """The bench as stated."""
        return Bench.load()

    @functools.cached_property
    def geometry(self) -> Geometry:
        """Rotor and case."""
        return Geometry.load()

    @functools.cached_property
    def air(self) -> AirState:
        """The air of Table 2."""
        return AirState.paper()

    @functools.cached_property
    def table(self) -> TorqueTable:
        """The computed torques."""
        return TorqueTable.load()

    @functools.cached_property
    def flows(self) -> tuple[Flow, ...]:
        """The computed flow under the conditions of Figs 10 to 12."""
        return shipped()

    @functools.cached_property
    def momentum(self) -> Momentum:
        """The momenta of Figs 3 and 4."""
        return momentum(self.bench)

    def correlation(self, spin_rate: float, regime: str | None = None) -> Correlated:
        """Return the drag by the correlations, without tilt."""
        return correlated(self.geometry, self.air, spin_rate, regime=regime)

    @functools.cached_property
    def air_effects(self) -> dict[str, dict[str, float]]:
        """The computed air as effects of the machine.

        Power laws for the torques across; the drag on the spin with the fall over the tilt that the table has at the
        reference speed up to the experiment's 3 deg.
        """
        found = {
            name: dict(values) for name, values in air_effects("surrogate", bench=self.bench).values.items()
        }
        rows = [row for row in self.table.grid if row.case.tilt <= TILT + 1e-9]
        rows = [row for row in rows if math.isclose(row.case.spin_rate, REFERENCE)]
        square = np.array([math.tan(row.case.tilt) ** 2 for row in rows])
        braking = np.array([-row.torque.mean[2] for row in rows])
        slope, upright = np.polyfit(square, braking, 1)
        reference = math.tan(self.bench.value("tilt_reference")) ** 2
        n = found["windage"]["n"]
        found["windage"]["w"] = float(upright)
        found["windage_tilt"] = {"w": float(slope * reference), "n": n}
        return found

    @functools.cached_property
    def model(self) -> Model:
        """The bench with the air."""
        bare = Model()
        return Model.of(replace(bare.details, effects=self.air_effects))

    @functools.cached_property
    def tilts(self) -> Recording:
        """The paper's sweep of the tilt, with air in the machine."""
        return simulate("paper_tilt", effects=self.air_effects, seed=self.seed)

    @functools.cached_property
    def speeds(self) -> Recording:
        """The paper's sweep of the speed, with air in the machine."""
        return simulate("paper_speed", effects=self.air_effects, seed=self.seed)

    @functools.cached_property
    def cone(self) -> Recording:
        """A slow cone of another machine, with air in it."""
        return simulate("cone", effects=self.air_effects, machine=_MACHINE, seed=self.seed)

    @functools.cached_property
    def other_machine(self) -> Mapping[str, float]:
        """True parameters of that machine [SI], drawn within their stated uncertainties."""
        return draw_machine(self.bench, np.random.default_rng(_MACHINE))

    def holds(self, recording: Recording, *, air: bool) -> tuple[Estimate, ...]:
        """Return the drag estimates of a recording by the bench with or without air."""
        key = (id(recording), air)
        if key not in self._holds:
            self._holds[key] = drag(recording, self.model if air else Model()).holds[0]
        return self._holds[key]

    @functools.cached_property
    def _holds(self) -> dict[Any, tuple[Estimate, ...]]:
        return {}

    @functools.cached_property
    def parts_by_speed(self) -> Torques:
        """Torque of coils and motor at the experiment's tilt and speeds, part by part."""
        return torques(model=self.model, tilt=TILT, spin_rate=SPEEDS)

    @functools.cached_property
    def parts_by_tilt(self) -> Torques:
        """The same at the reference speed, at tilts of 0 to 3 deg."""
        return torques(model=self.model, tilt=[0.0, 1.0 * DEG, 2.0 * DEG, TILT], spin_rate=REFERENCE)


def within(worst: float) -> str:
    """Return the accuracy of an agreement in words."""
    return f"within {worst:.0e}" if worst > 0.0 else "exactly"


def part(found: Torques, name: str) -> Any:
    """Return the coil torques of a part [N m], complex (n,); zero without such a part."""
    return sum((own.coil for own in found.parts if own.name == name), np.zeros(len(found), dtype=complex))


def air_part(found: Torques) -> tuple[Any, Array]:
    """Return the torques of the air on coils, complex (n,), and motor (n,) [N m]."""
    own = [item for item in found.parts if item.effect]
    return sum(item.coil for item in own), np.asarray(sum(item.motor for item in own))
