"""Torque that coils and motor supply in the holds of a recording, or in simulated ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel.models.api import Model
from gyrowheel.recordings.inputs import Fraction, Recordings, data, of_one_machine
from gyrowheel.show.result import Result
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_analysis.torques import HoldTorques, hold_torques
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_core.readings import Readings
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.environment import ORBIT
from gyrowheel_sim.plant.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

_HOLD = 6.0  # s; transients of the start and of the pump have died away
_MOST = 500  # holds


@dataclass(frozen=True, repr=False)
class Torques(Result, HoldTorques):
    """Outcome of `torques`: the torque of every part, the voltages and the margins, arrays over the holds (n,).

    The fields are those of `gyrowheel_analysis.torques.HoldTorques`; complex numbers are x + i y in case axes.
    """

    def headline(self) -> str:
        """Return the largest torques."""
        place = " in orbit" if self.orbit else ""
        return (
            f"{len(self)} holds{place}; coils supply up to {1e3 * np.abs(self.coil).max():.3g} mN·m, "
            f"motor up to {1e3 * np.abs(self.motor).max():.3g} mN·m"
        )

    def page(self) -> Iterable[RenderableType]:
        """Return the tables of torques, voltages and margins."""
        from gyrowheel.torque_budget.page import torques_page

        return torques_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel torques --json``; SI units."""

        def xy(value: complex) -> list[float]:
            return [float(np.real(value)), float(np.imag(value))]

        holds = []
        for k in range(len(self)):
            hold: dict[str, Any] = {
                "tilt": xy(self.tilt[k]),
                "spin_rate": float(self.spin_rate[k]),
                "coil_torque": xy(self.coil[k]),
                "motor_torque": float(self.motor[k]),
                "parts": {
                    part.name: {"coil": xy(part.coil[k]), "motor": float(part.motor[k])}
                    for part in self.parts
                },
                "coil_voltage": xy(self.coil_voltage[k]),
                "motor_voltage": float(self.motor_voltage[k]),
                "margin": {
                    "coil": float(self.coil_margin[k]),
                    "motor": float(self.motor_margin[k]),
                    "tilt": float(self.tilt_margin[k]),
                },
            }
            if self.recordings:
                hold["measured"] = {
                    "coil": xy(self.measured_coil[k]),  # type: ignore[index]
                    "motor": float(self.measured_motor[k]),  # type: ignore[index]
                }
                hold["remainder"] = {
                    "coil": xy(self.remainder_coil[k]),
                    "motor": float(self.remainder_motor[k]),
                }
            holds.append(hold)
        return {
            "schema": 1,
            "model": self.model,
            "recordings": list(self.recordings),
            "orbit": self.orbit,
            "holds": holds,
        }

    def to_columns(self) -> Mapping[str, Any]:
        """Return tilt [rad], spin rate [rad/s] and the torques of every part [N·m] as columns of shape (n,)."""
        columns: dict[str, Any] = {
            "tilt_x": np.real(self.tilt), "tilt_y": np.imag(self.tilt), "spin_rate": self.spin_rate,
        }  # fmt: skip
        torques = [
            ("all", self.coil, self.motor),
            *((part.name, part.coil, part.motor) for part in self.parts),
        ]
        if self.recordings:
            torques.append(("remainder", self.remainder_coil, self.remainder_motor))
        for name, coil, motor in torques:
            columns |= {
                f"{name}_coil_x": np.real(coil),
                f"{name}_coil_y": np.imag(coil),
                f"{name}_motor": motor,
            }
        return columns

    def plot(self) -> Figure:
        """Return the parts stacked over spin rate or tilt: along the tilt, across it, and of the motor."""
        from gyrowheel.torque_budget.picture import figure_of_torques

        return figure_of_torques(self)


@one_thread()
def torques(
    recordings: Recordings | None = None,
    model: Model | None = None,
    *,
    tilt: float | Sequence[float] = 0.0,
    azimuth: float = 0.0,
    spin_rate: float | Sequence[float] | None = None,
    air_density_ratio: float = 1.0,
    rig: str = "upright",
    orbit: bool = False,
    mixed: bool = False,
    progress: Fraction | None = None,
) -> Torques:
    """Split the torque of coils and motor into parts: springs, gimbal, shaft ripple, losses, air, bearing and others.

    Parameters
    ----------
    recordings : Recording, path or list, optional
        Recordings whose holds are split, with the measured torque and the one that the model does not explain. Without
        them the model itself is simulated in the holds given by the arguments below, without noise.
    model : Model, optional
        The model; one of the bench ``gyrowheel`` without effects if not given.
    tilt : float or sequence
        Tilt magnitudes [rad].
    azimuth : float
        Direction of the tilt, from the case x axis [rad].
    spin_rate : float or sequence, optional
        Spin rates [rad/s]; the reference rate of the bench if not given.
    air_density_ratio : float
        Density of the air over that of the laboratory; 0 is a vacuum.
    rig : str
        ``upright`` or ``inverted``.
    orbit : bool
        Simulate the holds in orbit: without air, weight and the rate of the Earth.
    mixed : bool
        Join recordings that state different machines.
    progress : callable, optional
        Called with the fraction done, 0 .. 1.

    Raises
    ------
    InputError
        If a recording cannot be read or has no steady hold, or a hold is beyond the limits of the bench,
        or `orbit` is combined with recordings, with `air_density_ratio` or with `rig`.
    """
    if orbit and (recordings is not None or air_density_ratio != 1.0 or rig != "upright"):
        raise InputError(
            "orbit: cannot be combined with recordings, density or an inverted rig: "
            "only simulated holds can be in orbit, without air and weight"
        )
    known = Model() if model is None else model
    if recordings is not None:
        given = of_one_machine(recordings, mixed=mixed)
        found = [
            hold_torques(reduce(samples_of(own), known.details.reference_bench), known.details)
            for own in data(given)
        ]
        if not any(len(own) for own in found):
            raise InputError(f"{', '.join(str(own.path) for own in given)}: no steady hold")
        holds_of = [own for own in found if len(own)]
        return Torques.of(
            HoldTorques.joined(holds_of, model=known.origin, recordings=tuple(str(r.path) for r in given))
        )
    bench = known.bench
    rates = np.atleast_1d(bench.value("spin_rate_reference") if spin_rate is None else spin_rate)
    holds = [(float(w), float(t)) for w in rates for t in np.atleast_1d(tilt)]
    if not holds or len(holds) > _MOST:
        raise InputError(f"holds: {len(holds)} are asked for; allowed: 1 .. {_MOST}")
    done = []
    for number, (rate, magnitude) in enumerate(holds):
        plan = _plan(rate, magnitude, azimuth, air_density_ratio, rig)
        plan.check(bench)
        done.append(_simulated(known, _in_orbit(plan) if orbit else plan, orbit=orbit))
        if progress is not None:
            progress((number + 1) / len(holds))
    return Torques.of(HoldTorques.joined(done, model=known.origin, orbit=orbit))


def _plan(spin_rate: float, tilt: float, azimuth: float, density: float, rig: str) -> Plan:
    """Return a plan of one hold."""
    # tilts about the two axes whose tangents are the components of the spin axis
    tangent = math.tan(tilt)
    about = [math.atan(tangent * part) / DEG for part in (math.cos(azimuth), math.sin(azimuth))]
    return Plan.load(
        f"schema: 1\nname: hold\nhold_s: {_HOLD}\nsegments:\n  - {{spin_rpm: {spin_rate / RPM!r}, tilt_deg: "
        f"[{about[0]!r}, {about[1]!r}], air_density_ratio: {density!r}, rig: {rig}}}\n"
    )


def _in_orbit(plan: Plan) -> Plan:
    """Return a plan whose holds are in orbit."""
    result = copy(plan)
    result.segments = tuple(
        replace(own, environment=replace(own.environment, rig=ORBIT, air_density_ratio=0.0))
        for own in plan.segments
    )
    return result


def _simulated(model: Model, plan: Plan, *, orbit: bool) -> HoldTorques:
    """Return one hold of the machine that a model describes, its readings free of noise."""
    bench, details = model.bench, model.details
    values = {name: 0.0 for name in bench.values() if name.endswith(("_noise", "_drift"))}
    if orbit:
        values["air_pressure"] = 0.0  # outside too: there is nothing to pump
    machine = Scenario(values=values, effects=details.effects, declared=details.declared)
    run = simulate(bench, machine, plan)
    time = np.arange(len(run.measurement), dtype=np.float64) * bench.sample_period
    samples = Samples(
        time, Readings(run.measurement), run.setpoints["stamp_ns"] * 1e-9, run.setpoints, run.environment
    )
    windows = reduce(samples, bench)
    return hold_torques(windows.select([-1]), details, measured=False)
