"""An independent bench: numbers from the bench file, a mechanism in MuJoCo, effects by virtual work in case axes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml
from numba import njit
from numpy.typing import NDArray

from benchmarks.independent.instruments import WRONG, Instruments, is_instrument

Array = NDArray[np.float64]

BENCH_FILE = Path(__file__).parents[2] / "src/gyrowheel_sim/gyrowheel_sim/config/bench.yaml"

#: Coefficients of the possible effects, in the order of the array of the compiled code.
COEFFICIENTS = (
    ("aero_restoring", "k"),
    ("aero_restoring", "n"),
    ("aero_cross", "c"),
    ("aero_cross", "n"),
    ("windage", "w"),
    ("windage", "n"),
    ("windage_tilt", "w"),
    ("windage_tilt", "n"),
    ("eddy_drag", "e"),
    ("bearing_coulomb", "T"),
    ("bearing_viscous", "b"),
    ("cubic_stiffness", "q"),
    ("flexure_damping", "C"),
    ("flexure_hysteresis", "h"),
    ("external_damping", "D"),
    ("fixed_torque", "F_x"),
    ("fixed_torque", "F_y"),
    ("stiffness_anisotropy", "k"),
    ("static_imbalance", "S_x"),
    ("static_imbalance", "S_y"),
    ("cogging", "C_x"),
    ("cogging", "C_y"),
    ("coil_tilt", "g"),
    ("coil_heating", "a"),
    ("coil_anisotropy", "p_x"),
    ("coil_anisotropy", "p_y"),
    ("tilt_bias", "B_x"),
    ("tilt_bias", "B_y"),
    ("tilt_rotation", "a"),
    ("runout", "R_x"),
    ("runout", "R_y"),
)
#: Errors of bench parameters: the parameters that share one factor.
ERRORS = {
    "stiffness_error": ("flexure_stiffness_x", "flexure_stiffness_y"),
    "gimbal_inertia_error": ("gimbal_inertia_x", "gimbal_inertia_y", "gimbal_inertia_z"),
    "shaft_inertia_error": ("shaft_inertia",),
    "rotor_inertia_error": ("rotor_inertia_z",),
    "transverse_inertia_error": ("rotor_inertia_x", "rotor_inertia_y"),
    "coil_gain_error": ("coil_constant",),
    "motor_constant_error": ("motor_constant",),
    "motor_resistance_error": ("motor_resistance",),
}
_PLACE = {pair: index for index, pair in enumerate(COEFFICIENTS)}
_NUMBERS = (
    "coil_constant",
    "motor_constant",
    "motor_resistance",
    "bearing_coulomb",
    "bearing_viscous",
    "fixed_torque_x",
    "fixed_torque_y",
    "spin_rate_reference",
    "tilt_reference",
    "motor_ripple_order",
)

_XML = """
<mujoco>
  <compiler angle="radian"/>
  <option integrator="RK4" timestep="{step!r}">
    <flag constraint="disable" contact="disable" equality="disable" limit="disable" frictionloss="disable"
          actuation="disable" sensor="disable" gravity="disable"/>
  </option>
  <worldbody>
    <body name="shaft">
      <joint name="spin" type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="0.1" diaginertia="{shaft!r} {shaft!r} {shaft_inertia!r}"/>
      <body name="gimbal">
        <joint name="inner" type="hinge" axis="1 0 0" stiffness="{inner!r}" damping="{flexure_damping_x!r}"/>
        <inertial pos="0 0 0" mass="0.01" diaginertia="{gimbal_inertia_x!r} {gimbal_inertia_y!r} {gimbal_inertia_z!r}"/>
        <body name="rotor">
          <joint name="outer" type="hinge" axis="0 1 0" stiffness="{outer!r}" damping="{flexure_damping_y!r}"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{rotor_inertia_x!r} {rotor_inertia_y!r} {rotor_inertia_z!r}"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@dataclass(frozen=True)
class Number:
    """A line of the bench file."""

    value: float
    uncertainty: float
    group: str


def bench_file() -> dict[str, Number]:
    """Return the parameters of the bench file as plain numbers [SI]."""
    content = yaml.safe_load(BENCH_FILE.read_text(encoding="utf-8"))
    result = {}
    for name, line in content["parameters"].items():
        value, text = float(line["value"]), str(line["uncertainty"])
        relative = text.endswith("%")
        sigma = float(text.removesuffix("%")) * (0.01 * abs(value) if relative else 1.0)
        result[name] = Number(value, sigma, str(line.get("group", name)))
    return result


@dataclass(frozen=True)
class Secret:
    """The truth of a machine.

    Attributes
    ----------
    numbers : dict of str to float
        Every parameter of the bench [SI].
    effects : dict
        {effect or error of a parameter: {coefficient: value}}.
    """

    numbers: dict[str, float]
    effects: dict[str, dict[str, float]] = field(default_factory=dict)

    @classmethod
    def stated(cls, effects: Mapping[str, Mapping[str, float]] | None = None) -> Secret:
        """Return a machine with the values of the bench file and some effects."""
        numbers = {name: line.value for name, line in bench_file().items()}
        return cls(numbers, {name: dict(values) for name, values in (effects or {}).items()})._with_wrong()

    def _with_wrong(self) -> Secret:
        """Return the same machine with its instrument errors in its numbers."""
        for name, lines in WRONG.items():
            for key, line in lines.items():
                self.numbers[line] += self.effects.get(name, {}).get(key, 0.0)
        return self

    @classmethod
    def drawn(
        cls,
        rng: np.random.Generator,
        effects: Mapping[str, Mapping[str, float]],
        *,
        instruments: bool = False,
    ) -> Secret:
        """Return a machine with every parameter drawn within its uncertainty; parameters of a group change together.

        An error that several parameters share is added to the drawn values; any other error replaces the drawn value.
        Instruments are as stated, except those among the effects, unless `instruments` has them drawn as well.
        """
        lines = bench_file()
        (apart,) = rng.spawn(1)
        normal = {
            line.group: float((apart if is_instrument(name) else rng).normal())
            for name, line in lines.items()
            if next(n for n, other in lines.items() if other.group == line.group) == name
        }
        if not instruments:
            normal |= {line.group: 0.0 for name, line in lines.items() if is_instrument(name)}
        numbers = {n: line.value + normal[line.group] * line.uncertainty for n, line in lines.items()}
        for name, values in effects.items():
            wrong = ERRORS.get(name, ())
            for parameter in wrong:
                line = lines[parameter]
                alone = len({lines[other].group for other in wrong}) == 1
                numbers[parameter] = (line.value if alone else numbers[parameter]) + line.value * values[
                    "relative_error"
                ]
        return cls(numbers, {name: dict(values) for name, values in effects.items()})._with_wrong()


class Machine:
    """Shaft, gimbal and rotor on three hinges, with coils, motor and bearing.

    Parameters
    ----------
    secret : Secret
        Truth of the machine.
    substeps : int
        Steps of MuJoCo's Runge-Kutta integrator per sample. In joint angles a constant tilt oscillates once per
        revolution, and the integration error is a false torque: 0.0005 mN m at 3 degrees with four steps.
    """

    def __init__(self, secret: Secret, substeps: int = 4) -> None:
        n = secret.numbers
        coefficients = np.zeros(len(COEFFICIENTS))
        for name, values in secret.effects.items():
            for key, value in values.items():
                if name not in ERRORS and name not in WRONG:
                    coefficients[_PLACE[name, key]] = value
        softer = float(coefficients[_PLACE["stiffness_anisotropy", "k"]])
        step = n["sample_period"] / substeps
        self._model = mujoco.MjModel.from_xml_string(
            _XML.format(
                step=step,
                shaft=0.5 * n["shaft_inertia"],
                inner=n["flexure_stiffness_x"] + softer,
                outer=n["flexure_stiffness_y"] - softer,
                **n,
            )
        )
        data = self._data = mujoco.MjData(self._model)
        self.substeps = substeps
        self._step, self._period = step, n["sample_period"]
        density = n["air_pressure"] / (n["gas_constant"] * n["air_temperature"])
        self._p = np.array([*(n[name] for name in _NUMBERS), density / n["air_density_reference"]])
        self._c = coefficients
        self._damping = n["flexure_damping_x"], n["flexure_damping_y"]
        self._n = n
        self.instruments = Instruments(n, substeps)
        #: Spin, inner and outer joint [rad], [rad/s].
        self.angles, self.rates = data.qpos, data.qvel
        self._torque, self._joint_torque = data.xfrc_applied[3, 3:6], data.qfrc_applied
        #: Temperature of the coils [K].
        self.coil_temperature = n["air_temperature"]

    def start(self, spin: float) -> None:
        """Set a spin rate without tilt."""
        mujoco.mj_resetData(self._model, self._data)
        self.rates[0] = spin
        self.coil_temperature = self._n["air_temperature"]

    def advance(
        self, coil_x: float, coil_y: float, motor: float, each: Callable[[], None] | None = None
    ) -> None:
        """Hold three voltages for one sample; `each` is called after every step of the integrator."""
        n, c = self._n, self._c
        model, data = self._model, self._data
        # losses of the flexures: with the rate, and (hysteresis) with the rate over the speed
        loss = c[_PLACE["flexure_damping", "C"]] + c[_PLACE["flexure_hysteresis", "h"]] / self.rates[0]
        model.dof_damping[1] = self._damping[0] + loss
        model.dof_damping[2] = self._damping[1] + loss
        warm = self.coil_temperature - n["air_temperature"]
        for _ in range(self.substeps):
            _push(
                self._p, c, self.angles, self.rates, coil_x, coil_y, motor, warm, 0.5 * self._step,
                self._torque, self._joint_torque,
            )  # fmt: skip
            mujoco.mj_step(model, data)
            if each is not None:
                each()
        power = (coil_x**2 + coil_y**2) / n["coil_resistance"] - warm / n["coil_thermal_resistance"]
        self.coil_temperature += self._period * power / n["coil_heat_capacity"]

    def read(self, motor: float) -> tuple[float, float, float, float, float]:
        """Return the sensor readings at this instant, without noise.

        Two tilts [rad], spin angle [rad], spin rate [rad/s] and motor current [A].

        Parameters
        ----------
        motor : float
            Voltage of the motor since the last sample [V].
        """
        n, c = self._n, self._c
        zx, zy = _tangents(self.angles[0], self.angles[1], self.angles[2])
        spin, angle = float(self.rates[0]), float(self.angles[0])
        turned = c[_PLACE["tilt_rotation", "a"]]
        out, across = c[_PLACE["runout", "R_x"]], c[_PLACE["runout", "R_y"]]
        cos, sin = math.cos(angle), math.sin(angle)
        x = n["tilt_scale"] * math.atan(zx) + n["tilt_bias_x"] + c[_PLACE["tilt_bias", "B_x"]] - turned * zy
        y = n["tilt_scale"] * math.atan(zy) + n["tilt_bias_y"] + c[_PLACE["tilt_bias", "B_y"]] + turned * zx
        current = (motor - n["motor_constant"] * spin) / n["motor_resistance"]
        x, y = x + out * cos - across * sin, y + out * sin + across * cos
        return *self.instruments.sensor(x, y, math.atan(zx), math.atan(zy)), angle, spin, current


@njit(cache=True)
def _tangents(spin: float, inner: float, outer: float) -> Any:
    """Return tangents of the two tilts in the case for the joint angles."""
    sz, cz = math.sin(spin), math.cos(spin)
    sx, cx, sy, cy = math.sin(inner), math.cos(inner), math.sin(outer), math.cos(outer)
    nx = sx * cy * sz + sy * cz
    ny = -sx * cy * cz + sy * sz
    nz = cx * cy
    return -ny / nz, nx / nz


_INSTANT = 1.0e-6  # s; short compared with every motion


@njit(cache=True)
def _push(
    p: Any, c: Any, angles: Any, rates: Any, coil_x: float, coil_y: float, motor: float, warm: float, half: float,
    torque: Any, joint_torque: Any,
) -> None:  # fmt: skip
    """Write the torques on the rotor in case axes and in the joints, at the middle of a step."""
    k, km, resistance, coulomb, viscous, fx, fy, reference, tilt_reference, order, density = p
    spin = rates[0]
    angle, inner, outer = angles[0] + half * spin, angles[1] + half * rates[1], angles[2] + half * rates[2]
    zx, zy = _tangents(angle, inner, outer)
    # tilt rate at the middle of the step: half a step later the rates have turned with the rotor
    a, b, e = angles, rates, _INSTANT
    zx1, zy1 = _tangents(a[0] - e * b[0], a[1] - e * b[1], a[2] - e * b[2])
    zx2, zy2 = _tangents(a[0] + e * b[0], a[1] + e * b[1], a[2] + e * b[2])
    zx_rate, zy_rate = 0.5 * (zx2 - zx1) / e, 0.5 * (zy2 - zy1) / e
    nz = 1.0 / math.sqrt(1.0 + zx * zx + zy * zy)
    nx, ny = zy * nz, -zx * nz
    square = (zx * zx + zy * zy) / tilt_reference**2
    r = spin / reference
    # across the tilted rotor: in phase with the tilt, a quarter turn ahead of it, with its rate, fixed in the case
    in_phase = -c[0] * r ** c[1] * density ** (c[1] - 1.0)
    ahead = c[2] * r ** c[3] * density ** (c[3] - 1.0)
    cos, sin = math.cos(angle), math.sin(angle)
    tx = in_phase * zx - ahead * zy - c[14] * zx_rate + c[15] + fx - c[18] * sin - c[19] * cos
    ty = in_phase * zy + ahead * zx - c[14] * zy_rate + c[16] + fy + c[18] * cos - c[19] * sin
    tz = zx * ty - zy * tx  # no component along the rotor's axis
    # drag along the axis of the rotor
    drag = c[4] * r ** c[5] * density ** (c[5] - 1.0)
    drag += c[6] * r ** c[7] * density ** (c[7] - 1.0) * square
    drag += c[8] * spin
    # coils, which are fixed in the case
    gain = k * (1.0 + c[22] * square + c[23] * warm)
    cx = gain * (coil_x + c[24] * coil_x + c[25] * coil_y)
    cy = gain * (coil_y + c[25] * coil_x - c[24] * coil_y)
    torque[0] = tx - drag * nx + cx
    torque[1] = ty - drag * ny + cy
    torque[2] = tz - drag * nz
    # shaft: motor, bearing, cogging
    shaft = km * (motor - km * spin) / resistance
    shaft -= coulomb + c[9] + (viscous + c[10]) * spin
    joint_torque[0] = shaft + c[20] * math.cos(order * angle) + c[21] * math.sin(order * angle)
    joint_torque[1] = -c[11] * inner**3
    joint_torque[2] = -c[11] * outer**3
