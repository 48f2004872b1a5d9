"""Simulated seconds per second: the open-loop step, SciPy and MuJoCo at equal accuracy, and the closed loop."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import scipy
from numba import njit
from numpy.typing import NDArray
from rich.table import Table
from scipy.integrate import ode, odeint, solve_ivp

from benchmarks.mechanism import MujocoWheel, rates, reference
from benchmarks.ours import MECHANICAL, Held, bench, hold, quiet, steps
from benchmarks.results import Bar, Figure, MeasurementError, Report, number
from benchmarks.timing import Timing, by_turns
from gyrowheel.show.layout import figures_table
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.plant.scenario import Scenario

Fraction = Callable[[float], None]

TILT, SPIN = 3.0 * DEG, 3500.0 * RPM
SETTLE, SPAN = 3.0, 2.0  # s
LIMIT = 1e-6  # rad
ROUNDS = 9
#: Ten effects of different kinds; each acts at every stage of every step.
EFFECTS = (
    "aero_restoring",
    "aero_cross",
    "windage",
    "bearing_coulomb",
    "bearing_viscous",
    "coil_tilt",
    "coil_heating",
    "cubic_stiffness",
    "flexure_damping",
    "gravity_offset",
)
PLAN = """
schema: 1
name: benchmark
hold_s: 3
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [3, 0], [0, 3]]}
  - {spin_rpm: 2000, tilt_deg: [[3, 0], [0, 3]]}
"""
Motion = NDArray[np.float64]


class NotReachedError(MeasurementError):
    """A contestant does not reach the accuracy with any of its settings."""


@dataclass(frozen=True)
class Contestant:
    """One integrator with one setting.

    Attributes
    ----------
    family : str
        The integrator.
    interface : str
        The function that calls it, if there are several.
    setting : str
        Its step or tolerance.
    go : callable
        Runs the whole span; returns (n_x, n_y) at the samples `at`, shape (m, 2).
    at : ndarray of int
        Numbers of the samples, counted from 1, at which it returns the tilt.
    """

    family: str
    interface: str
    setting: str
    go: Callable[[], Motion]
    at: NDArray[np.intp]

    @property
    def name(self) -> str:
        """Integrator and interface."""
        return f"{self.family}, {self.interface}" if self.interface else self.family

    def error(self, truth: Motion) -> float:
        """Return the largest tilt error over the span [rad]."""
        difference = self.go() - truth[self.at - 1, :2]
        return float(np.hypot(difference[:, 0], difference[:, 1]).max())


def coarsest(
    settings: Sequence[Callable[[], Contestant]], truth: Motion, limit: float = LIMIT
) -> tuple[Contestant, float]:
    """Return the first contestant, from coarse to fine, whose error is within the limit, and its error.

    Raises
    ------
    NotReachedError
        If no error is within the limit.
    """
    for make in settings:
        contestant = make()
        error = contestant.error(truth)
        if error <= limit:
            return contestant, error
    raise NotReachedError(f"{contestant.name} left out: error {error:.2g} rad even with {contestant.setting}")


def measure(progress: Fraction) -> list[Report]:
    """Measure open loop and closed loop."""
    record = hold(Scenario.nominal(), TILT, SPIN, SETTLE, SPAN)
    constant = np.tile(record.voltages.mean(axis=0), (len(record.voltages), 1))
    return [
        _open_loop(record, record.voltages, lambda part: progress(0.45 * part), changing=True),
        _open_loop(record, constant, lambda part: progress(0.45 + 0.45 * part), changing=False),
        _closed_loop(lambda part: progress(0.9 + 0.1 * part)),
    ]


def _open_loop(record: Held, voltages: Motion, progress: Fraction, *, changing: bool) -> Report:
    f, period = rates(), bench().sample_period
    truth = reference(f, record.state, voltages, 4)
    doubt = float(np.abs(reference(f, record.state, voltages, 2) - truth)[:, :2].max())
    if doubt > 1e-12:
        raise NotReachedError(f"the reference itself is good to {doubt:.2g} rad only")
    progress(0.1)
    # ours first
    families = [
        _ours(record, voltages),
        *_scipy(f, record, voltages, changing=changing),
        _mujoco(record, voltages),
    ]
    chosen, missing = [coarsest(families[0], truth)], []
    for family in families[1:]:
        try:
            chosen.append(coarsest(family, truth))
        except NotReachedError as error:
            missing.append(f"{error}.")
    progress(0.4)
    times = by_turns(
        {c.name: c.go for c, _ in chosen}, ROUNDS, progress=lambda part: progress(0.4 + 0.6 * part)
    )
    default = _ours(record, voltages)[0]().error(truth)
    kind = "voltages as the loop gives them" if changing else "constant voltages"
    ours, rest = chosen[0][0], chosen[1:]
    speed = {name: SPAN / t.best for name, t in times.items()}
    figures = [
        Figure("speed", speed[ours.name], "s/s", bar=Bar(">=", 800.0)),
        *(
            Figure(
                "speed",
                speed[ours.name],
                "s/s",
                c.family,
                speed[c.name],
                Bar(">=", 30.0, "ratio") if c.family.startswith("MuJoCo") else None,
            )
            for c in _quickest(rest, times)
        ),
        Figure("tilt error", default, "rad", bar=Bar("<=", LIMIT)),
    ]
    change = (
        "The voltages change at every sample, so SciPy's integrators restart at every sample."
        if changing
        else "The voltages are the mean of those of the loop: nothing damps the nutation that the loop leaves."
    )
    return Report(
        f"Open loop, {kind}",
        figures,
        notes=[
            f"{SPAN:g} s at {SPIN / RPM:.0f} rpm and {TILT / DEG:g}°, from the state in which the closed loop with "
            f"noise is after holding for {SETTLE:g} s. {change}",
            f"The reference is the formula of eighth order of DOP853 at a step of {period / 4 * 1e3:g} ms; at twice "
            f"that it differs by {doubt:.0e} rad. Tilt error: of one step a sample.",
            *missing,
        ],
        details=[_table(chosen, times)],
    )


def _ours(record: Held, voltages: Motion) -> list[Callable[[], Contestant]]:
    period = bench().sample_period
    every = np.arange(1, len(voltages) + 1)

    def make(substeps: int) -> Contestant:
        go = steps(record.machine, record.state, voltages, substeps)
        return Contestant("ours", "", f"{period / substeps * 1e3:.3g} ms", lambda: go()[:, :2], every)

    return [functools.partial(make, n) for n in (1, 2, 3, 4, 6, 8)]


def _mujoco(record: Held, voltages: Motion) -> list[Callable[[], Contestant]]:
    period = bench().sample_period
    at = _checkpoints(len(voltages))
    constant = bool((voltages == voltages[0]).all())

    def make(substeps: int) -> Contestant:
        wheel = MujocoWheel(period / substeps)

        def go() -> Motion:
            wheel.start(record.state)
            out = np.empty((len(at), 2))
            done = 0
            for row, stop in enumerate(at):
                if constant:
                    wheel.advance(voltages[0], int(stop - done) * substeps)
                else:
                    for k in range(done, stop):
                        wheel.advance(voltages[k], substeps)
                done = stop
                out[row] = wheel.axis()
            return out

        return Contestant("MuJoCo RK4", "", f"{period / substeps * 1e3:.3g} ms", go, at)

    return [functools.partial(make, n) for n in (1, 2, 3, 4, 5, 6, 8, 10, 12, 16)]


def _scipy(f: Any, record: Held, voltages: Motion, *, changing: bool) -> list[list[Callable[[], Contestant]]]:
    """Return DOP853 and LSODA by each of SciPy's interfaces; the faster one is used."""
    period, n = bench().sample_period, len(voltages)
    start, held = np.array(record.state[:MECHANICAL]), np.ascontiguousarray(voltages[0])
    # tolerances in units in which all six entries have the same magnitude: a rate is an angle times the spin rate
    size = np.array([1.0, 1.0, SPIN, SPIN, 1.0, SPIN])

    @njit(error_model="numpy")
    def motion(t: Any, y: Any) -> Any:
        return f(t, y, held)

    @njit(error_model="numpy")
    def driven(t: Any, y: Any, coil_x: float, coil_y: float, motor: float) -> Any:
        return f(t, y, (coil_x, coil_y, motor))

    times, at = np.append(0.0, _checkpoints(n) * period), _checkpoints(n)
    every, commands = np.arange(1, n + 1), [tuple(row) for row in voltages.tolist()]

    def by_solve_ivp(method: str, tolerance: float) -> Motion:
        found = solve_ivp(
            motion, (0.0, n * period), start, method=method, t_eval=times[1:], rtol=tolerance, atol=tolerance * size
        )  # fmt: skip
        return np.asarray(found.y[:2].T)

    def by_ode(tolerance: float) -> Motion:
        solver = ode(motion).set_integrator("dop853", rtol=tolerance, atol=tolerance, nsteps=10**6)
        solver.set_initial_value(start, 0.0)
        return np.array([solver.integrate(t)[:2] for t in times[1:]])

    def by_odeint(tolerance: float) -> Motion:
        found = odeint(motion, start, times, tfirst=True, rtol=tolerance, atol=tolerance * size, mxstep=10**6)
        return np.asarray(found[1:, :2])

    def anew_by_ode(tolerance: float) -> Motion:
        solver = ode(driven).set_integrator(
            "dop853", rtol=tolerance, atol=tolerance, nsteps=10**6, first_step=period
        )
        out, y = np.empty((n, 2)), start
        for k in range(n):
            solver.set_f_params(*commands[k]).set_initial_value(y, 0.0)
            y = solver.integrate(period)
            out[k] = y[:2]
        return out

    def anew_by_odeint(tolerance: float) -> Motion:
        out, y, span = np.empty((n, 2)), start, np.array([0.0, period])
        scaled = tolerance * size
        for k in range(n):
            y = odeint(driven, y, span, args=commands[k], tfirst=True, rtol=tolerance, atol=scaled)[1]
            out[k] = y[:2]
        return out

    routes: dict[tuple[str, str], tuple[Callable[[float], Motion], NDArray[np.intp]]]
    if changing:
        routes = {
            ("SciPy DOP853", "ode"): (anew_by_ode, every),
            ("SciPy LSODA", "odeint"): (anew_by_odeint, every),
        }
    else:
        routes = {
            ("SciPy DOP853", "solve_ivp"): (lambda tolerance: by_solve_ivp("DOP853", tolerance), at),
            ("SciPy DOP853", "ode"): (by_ode, at),
            ("SciPy LSODA", "solve_ivp"): (lambda tolerance: by_solve_ivp("LSODA", tolerance), at),
            ("SciPy LSODA", "odeint"): (by_odeint, at),
        }

    def make(route: tuple[str, str], tolerance: float) -> Contestant:
        go, samples = routes[route]
        return Contestant(*route, f"{tolerance:.0e}", lambda: go(tolerance), samples)

    tolerances = [10.0 ** (-0.5 * k) for k in range(4, 25)]
    return [[functools.partial(make, route, t) for t in tolerances] for route in routes]


def _checkpoints(samples: int) -> NDArray[np.intp]:
    return np.linspace(0, samples, 41).round().astype(np.intp)[1:]


def _quickest(
    contestants: Sequence[tuple[Contestant, float]], times: Mapping[str, Timing]
) -> list[Contestant]:
    """Return one contestant of each family: the faster of two interfaces to one integrator."""
    found: dict[str, Contestant] = {}
    for contestant, _ in contestants:
        other = found.get(contestant.family)
        if other is None or times[contestant.name].best < times[other.name].best:
            found[contestant.family] = contestant
    return list(found.values())


def _table(chosen: Sequence[tuple[Contestant, float]], times: Mapping[str, Timing]) -> Table:
    table = figures_table("", "step, tolerance", "error, rad", "best", "median", "by the clock")
    for contestant, error in chosen:
        timing = times[contestant.name]
        table.add_row(
            contestant.name,
            contestant.setting,
            f"{error:.1e}",
            *_speeds(SPAN, timing),
        )
    return table


def _speeds(span: float, timing: Timing) -> tuple[str, str, str]:
    return number(span / timing.best), number(span / timing.median), number(span / timing.clock)


def _closed_loop(progress: Fraction) -> Report:
    plan = Plan.load(PLAN)
    loops = {
        "no effect": Scenario.nominal(),
        f"{len(EFFECTS)} effects": Scenario.nominal({name: {} for name in EFFECTS}),
        "no effect, no noise": quiet(),
    }
    times = by_turns(
        {name: functools.partial(simulate, bench(), scenario, plan) for name, scenario in loops.items()},
        ROUNDS,
        progress=progress,
    )
    table = figures_table("", "best", "median", "by the clock")
    for name, timing in times.items():
        table.add_row(name, *_speeds(plan.duration, timing))
    speed = {name: plan.duration / timing.best for name, timing in times.items()}
    ten = f"{len(EFFECTS)} effects"
    return Report(
        "Closed loop",
        [Figure(f"speed, {ten}", speed[ten], "s/s", bar=Bar(">=", 300.0))],
        notes=[
            f"A plan of {plan.duration:.1f} s with five holds at two speeds: plant, sensors with noise and drift, "
            f"controller; from the plan to the arrays of readings. The effects: {', '.join(EFFECTS)}.",
            f"Speed, here and above: simulated seconds per second on one core, best of {ROUNDS} rounds by turns, "
            f"everybody with the coarsest step or tolerance that keeps the tilt within {LIMIT:g} rad of the reference. "
            "Seconds are those of the processor, which a machine that does nothing else needs by the clock; the last "
            "column has what the clock showed.",
            f"Ours gives its state at every sample; the others only forty times where the voltages are constant. SciPy "
            f"{scipy.__version__} with the same equations of motion, compiled; MuJoCo {mujoco.__version__} with bodies "
            "and joints.",
        ],
        details=[table],
    )
