"""What several tests of the physics use: a bench without noise, held tilts by inverse dynamics and in closed loop."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrowheel_control.loops.closed_loop import Run, simulate
from gyrowheel_control.loops.controller import Gains
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import EffectValues
from gyrowheel_sim.mechanics.dynamics import Joint, Spin, inverse
from gyrowheel_sim.plant.scenario import Scenario

BENCH = Bench.load()
#: Readings without noise and drift.
QUIET = {name: 0.0 for name in BENCH.values() if name.endswith(("_noise", "_drift"))}
#: Moments of inertia in the order that the functions of `dynamics` take.
INERTIAS = (
    BENCH.value("rotor_inertia_x"),
    BENCH.value("rotor_inertia_y"),
    BENCH.value("rotor_inertia_z"),
    BENCH.value("gimbal_inertia_x"),
    BENCH.value("gimbal_inertia_y"),
    BENCH.value("gimbal_inertia_z"),
    BENCH.value("shaft_inertia"),
)
#: Everything that turns with the shaft.
AXIAL_INERTIA = (
    BENCH.value("rotor_inertia_z") + BENCH.value("gimbal_inertia_z") + BENCH.value("shaft_inertia")
)
#: Igx + Igy - Igz: what tunes the flexures.
TUNING_INERTIA = 2.0 * BENCH.value("gimbal_inertia_x") - BENCH.value("gimbal_inertia_z")


def quiet_run(plan: Plan, effects: EffectValues | None = None, gains: Gains | None = None) -> Run:
    """Return a closed-loop run without noise of the default bench."""
    return simulate(BENCH, Scenario(values=QUIET, effects=effects or {}), plan, gains=gains)


def hold_plan(rpm: float, *tilts_deg: float, hold_s: float = 3.0) -> Plan:
    """Return a plan that holds some tilts about x, one after the other, at one speed."""
    tilts = ", ".join(f"[{tilt}, 0]" for tilt in tilts_deg)
    return Plan.load(
        f"schema: 1\nname: hold\nhold_s: {hold_s}\nsegments:\n  - {{spin_rpm: {rpm}, tilt_deg: [{tilts}]}}\n"
    )


class Held(NamedTuple):
    """Means over whole revolutions at the end of a run, and amplitudes of exp(2i theta_z)."""

    tilt: complex  # complex tilt tan(phi_x) + i tan(phi_y)
    tilt_2n: complex
    coil_torque: complex  # N m
    motor_voltage: float  # V
    motor_current_2n: complex  # A


def held(run: Run, seconds: float = 2.0) -> Held:
    """Reduce the last seconds of a run at a constant tilt."""
    m = run.measurement[-round(seconds / BENCH.sample_period) :]
    angle = np.unwrap(m[:, 2])
    turns = np.floor((angle[-1] - angle[0]) / (2.0 * np.pi))
    stop = np.searchsorted(angle, angle[0] + 2.0 * np.pi * turns - 0.5 * (angle[1] - angle[0]))
    m, angle = m[:stop], angle[:stop]
    waves = np.exp(1j * np.outer(angle, [0, 2, -2, 4, -4]))
    readings = np.column_stack([np.tan(m[:, 0]) + 1j * np.tan(m[:, 1]), m[:, 7]])
    amplitude = np.linalg.lstsq(waves, readings, rcond=None)[0]
    volts = m[:, 4:7].mean(axis=0)
    torque = BENCH.value("coil_constant") * complex(volts[0], volts[1])
    return Held(amplitude[0, 0], amplitude[1, 0], torque, float(volts[2]), amplitude[1, 1])


class Needed(NamedTuple):
    """What a perfectly held tilt needs over one revolution, at equal steps of the angle from the tilt to the shaft."""

    angle: NDArray[np.float64]  # rad
    rate: NDArray[np.float64]  # of that angle: spin rate less the rate of the cone [rad/s]
    coil_torque: NDArray[np.complex128]  # about the tilt and across it [N m]
    motor_torque: float  # N m

    def coil_harmonic(self, order: int) -> complex:
        """Return the time average of the coil torque times exp(-i order angle)."""
        time = 1.0 / self.rate
        return complex((time * self.coil_torque * np.exp(-1j * order * self.angle)).sum() / time.sum())


def flexure_forces(joint: Joint) -> tuple[Any, Any]:
    """Return the torques of the two flexures of the default bench on the joint."""
    v = BENCH.value
    return (
        -v("flexure_stiffness_x") * joint.theta_x - v("flexure_damping_x") * joint.theta_x_rate,
        -v("flexure_stiffness_y") * joint.theta_y - v("flexure_damping_y") * joint.theta_y_rate,
    )


def perfect_hold(tilt_deg: float, rpm: float, cone_rate: float = 0.0) -> Needed:
    """Return the torques that hold a tilt about x exactly, or turn it on a cone, while the motor's torque is constant.

    A universal joint cannot pass on a constant speed: its shaft has to ripple twice a revolution, and the torque of the
    coils depends on that. The ripple for which the motor's torque is constant is found by iteration.
    """
    n = 64
    angle = np.arange(n, dtype=np.float64) * (2.0 * np.pi / n)
    order = np.fft.fftfreq(n, 1.0 / n)
    passing = order != 0
    mean = rpm * RPM - cone_rate
    rate = np.full(n, mean)
    z = np.full(n, np.tan(tilt_deg * DEG) + 0j)
    for _ in range(40):
        acceleration = rate * np.fft.ifft(1j * order * np.fft.fft(rate)).real
        spin = rate + cone_rate
        motion = Spin(z, 1j * cone_rate * z, -(cone_rate**2) * z, angle, spin, acceleration)
        joint = inverse(motion, INERTIAS)
        flex_x, flex_y = flexure_forces(joint)
        coil = np.exp(1j * angle) * (
            joint.inertial[0] - flex_x + 1j * (joint.inertial[1] - flex_y) / joint.cx
        )
        friction = BENCH.value("bearing_coulomb") + BENCH.value("bearing_viscous") * spin
        motor = joint.inertial[2] + friction
        ripple = np.zeros(n, complex)
        ripple[passing] = -np.fft.fft(motor)[passing] / (1j * order[passing] * AXIAL_INERTIA * mean)
        rate = rate + np.fft.ifft(ripple).real
        rate = rate * mean * np.mean(1.0 / rate)  # the mean over time stays
    return Needed(angle, rate, coil, float(np.sum(motor / rate) / np.sum(1.0 / rate)))
