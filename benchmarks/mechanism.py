"""The same mechanism for other integrators: its equations of motion for SciPy, and its bodies and joints for MuJoCo.

No effects, no sensors, no temperatures: rotor, gimbal, shaft, flexures, coils, motor and bearing of the default bench.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import DOP853

from benchmarks.ours import MECHANICAL, bench
from gyrowheel_sim.effects.targets import INERTIAS
from gyrowheel_sim.mechanics.dynamics import (
    case_accelerations,
    case_to_joint,
    generalised_forces,
    inertia_terms,
    joint_accelerations,
)

#: dy/dt = f(t, y, voltages) with y = (n_x, n_y, n_x', n_y', theta_z, Omega).
Rates = Callable[[float, NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def rates() -> Any:
    """Return the equations of motion in the case frame as a compiled function, see `Rates`.

    The constants of the bench are constants of the machine code.
    """
    v = bench().value
    inertias = tuple(v(name) for name in INERTIAS)
    stiffness_x, stiffness_y = v("flexure_stiffness_x"), v("flexure_stiffness_y")
    damping_x, damping_y = v("flexure_damping_x"), v("flexure_damping_y")
    coulomb, viscous = v("bearing_coulomb"), v("bearing_viscous")
    coil, motor, resistance = v("coil_constant"), v("motor_constant"), v("motor_resistance")

    @njit(error_model="numpy")
    def f(t: Any, y: Any, voltages: Any) -> Any:
        spin = y[5]
        sz, cz = math.sin(y[4]), math.cos(y[4])
        sx, cx, sy, cy, wx, wy = case_to_joint(y[0], y[1], y[2], y[3], sz, cz, spin)
        m11, m13, m22, m23, m33, f1, f2, f3 = inertia_terms(sx, cx, sy, cy, wx, wy, spin, *inertias)
        q1, q2, _ = generalised_forces(sx, cx, sz, cz, coil * voltages[0], coil * voltages[1], 0.0)
        b1 = q1 + f1 - stiffness_x * math.asin(sx) - damping_x * wx
        b2 = q2 + f2 - stiffness_y * math.asin(sy) - damping_y * wy
        b3 = f3 + motor * (voltages[2] - motor * spin) / resistance - coulomb - viscous * spin
        ax, ay, az = joint_accelerations(m11, m13, m22, m23, m33, b1, b2, b3)
        out = np.empty(6)
        out[0], out[1], out[4], out[5] = y[2], y[3], spin, az
        out[2], out[3] = case_accelerations(sx, cx, sy, cy, wx, wy, sz, cz, spin, ax, ay, az)
        return out

    return f


def reference(
    f: Any, start: NDArray[np.float64], voltages: NDArray[np.float64], substeps: int
) -> NDArray[np.float64]:
    """Return the motion at every sample, shape (n, 6), by the eighth-order formula of DOP853 at a fixed step.

    Parameters
    ----------
    f : callable
        Result of `rates`.
    start : ndarray (6,)
        State at the start.
    voltages : ndarray (n, 3)
        Voltages, each held for one sample [V].
    substeps : int
        Steps per sample.
    """
    stages = DOP853.n_stages
    a, b = np.ascontiguousarray(DOP853.A[:stages, :stages]), np.ascontiguousarray(DOP853.B)
    step = bench().sample_period / substeps

    @njit(error_model="numpy")
    def run(y: Any, out: Any) -> None:
        slopes = np.zeros((stages, MECHANICAL))
        for k in range(len(voltages)):
            for _ in range(substeps):
                for i in range(stages):
                    at = y.copy()
                    for j in range(i):
                        at += step * a[i, j] * slopes[j]
                    slopes[i] = f(0.0, at, voltages[k])
                for i in range(stages):
                    y += step * b[i] * slopes[i]
            out[k] = y

    out = np.empty((len(voltages), MECHANICAL))
    run(np.array(start[:MECHANICAL]), out)
    return out


_BODIES = """
<mujoco>
  <compiler angle="radian"/>
  <option integrator="RK4" timestep="{step!r}" gravity="0 0 0">
    <flag constraint="disable" contact="disable" equality="disable" limit="disable" frictionloss="disable"
          actuation="disable" sensor="disable" gravity="disable"/>
  </option>
  <worldbody>
    <body>
      <joint type="hinge" axis="0 0 1" damping="{drag!r}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{half!r} {half!r} {shaft_inertia!r}"/>
      <body>
        <joint type="hinge" axis="1 0 0" stiffness="{flexure_stiffness_x!r}" damping="{flexure_damping_x!r}"/>
        <inertial pos="0 0 0" mass="1" diaginertia="{gimbal_inertia_x!r} {gimbal_inertia_y!r} {gimbal_inertia_z!r}"/>
        <body>
          <joint type="hinge" axis="0 1 0" stiffness="{flexure_stiffness_y!r}" damping="{flexure_damping_y!r}"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{rotor_inertia_x!r} {rotor_inertia_y!r} {rotor_inertia_z!r}"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


class MujocoWheel:
    """The mechanism in MuJoCo: a shaft, a gimbal and a rotor on three hinges with springs and dampers.

    Parameters
    ----------
    step : float
        Step of its Runge-Kutta integrator of fourth order [s].
    """

    def __init__(self, step: float) -> None:
        v = bench().value
        drag = v("bearing_viscous") + v("motor_constant") ** 2 / v("motor_resistance")
        xml = _BODIES.format(step=step, drag=drag, half=0.5 * v("shaft_inertia"), **bench().values())
        self._model = mujoco.MjModel.from_xml_string(xml)
        self._data = mujoco.MjData(self._model)
        self._coil = v("coil_constant")
        self._motor = v("motor_constant") / v("motor_resistance")
        self._coulomb = v("bearing_coulomb")

    def start(self, state: NDArray[np.float64]) -> None:
        """Set the state, given in the case frame."""
        mujoco.mj_resetData(self._model, self._data)
        nx, ny, ux, uy, angle, spin = state[:MECHANICAL]
        sx, _, sy, _, wx, wy = case_to_joint(nx, ny, ux, uy, math.sin(angle), math.cos(angle), spin)
        self._data.qpos[:] = angle, math.asin(sx), math.asin(sy)
        self._data.qvel[:] = spin, wx, wy

    def advance(self, voltages: NDArray[np.float64], steps: int) -> None:
        """Hold voltages for some steps: the coils' torque is fixed in the case, the motor's acts on the shaft."""
        self._data.xfrc_applied[3, 3:5] = self._coil * voltages[0], self._coil * voltages[1]
        self._data.qfrc_applied[0] = self._motor * voltages[2] - self._coulomb
        mujoco.mj_step(self._model, self._data, steps)

    def axis(self) -> tuple[float, float]:
        """Return (n_x, n_y) of the spin axis."""
        z, x, y = self._data.qpos
        sx, sy, cy = math.sin(x), math.sin(y), math.cos(y)
        across = sx * cy
        return across * math.sin(z) + sy * math.cos(z), sy * math.sin(z) - across * math.cos(z)
