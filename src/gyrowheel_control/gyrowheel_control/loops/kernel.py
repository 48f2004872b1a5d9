"""The tilt and spin loops as one compiled update a sample, and the layout of their arrays.

As of `gyrowheel_sim.plant.kernel`, the text below the kernel line is compiled in another module: alone for the
controller, with the plant for the closed loop.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from gyrowheel_sim.instruments import Column
from gyrowheel_sim.jit import njit


class ControllerState(Column):
    """State of the controller."""

    started = 0, "1", "1 once the filters have started"
    tilt_x = 1, "rad", "low-passed tilt about case x"
    tilt_y = 2, "rad", "low-passed tilt about case y"
    last_tilt_x = 3, "rad", "tilt about case x through the low-pass of the derivative"
    last_tilt_y = 4, "rad", "tilt about case y through the low-pass of the derivative"
    integral_x = 5, "rad s", "integral of the tilt error about case x"
    integral_y = 6, "rad s", "integral of the tilt error about case y"
    spin_rate_once = 7, "rad/s", "spin rate, low-passed once"
    spin_rate = 8, "rad/s", "spin rate, low-passed twice"
    spin_integral = 9, "rad", "integral of the error of the spin rate"
    coil_voltage_x = 10, "V", "command that answers the last sample, in the closed loop without ROS"
    coil_voltage_y = 11, "V", "the same of coil y"
    motor_voltage = 12, "V", "the same of the motor"
    last_spin_angle = 13, "rad", "angle of the shaft at the last sample, for the phase-locked loop"
    phase_error = 14, "rad", "phase of the reference less that of the shaft, turns counted"
    phase_error_once = 15, "rad", "the same, low-passed once"
    phase_error_twice = 16, "rad", "the same, low-passed twice"


class SetpointColumn(Column):
    """Setpoint of the loops, extrapolated by its rates until the next one."""

    tilt_x = 0, "rad", "tilt about case x"
    tilt_y = 1, "rad", "tilt about case y"
    tilt_rate_x = 2, "rad/s", "its rate"
    tilt_rate_y = 3, "rad/s", "its rate"
    spin_rate = 4, "rad/s", "spin rate"
    spin_acceleration = 5, "rad/s^2", "its rate"


class CommandColumn(Column):
    """Voltages that answer a sample."""

    coil_voltage_x = 0, "V", "voltage of coil x"
    coil_voltage_y = 1, "V", "voltage of coil y"
    motor_voltage = 2, "V", "voltage of the motor"


# --- kernel ---


class ControllerParameters(NamedTuple):
    """Gains and the model constants that the loops use [SI]."""

    tilt_bandwidth: float  # 1/s
    tilt_integral: float  # 1/s^2
    tilt_lowpass: float  # Hz
    nutation_damping: float  # N m s/rad at the reference spin rate
    derivative_lowpass: float  # Hz
    phase_lead: float  # s
    spin_proportional: float  # N m s/rad
    spin_integral: float  # N m/rad
    spin_lowpass: float  # Hz
    stiffness: float  # N m/rad
    tuning_inertia: float  # kg m^2: Igx + Igy - Igz
    spin_inertia: float  # kg m^2: Irz + (Igx + Igy) / 2
    axial_inertia: float  # kg m^2: everything that turns with the shaft
    spin_rate_reference: float  # rad/s
    coil_constant: float  # N m/V
    coil_voltage_limit: float  # V
    motor_constant: float  # N m/A
    motor_resistance: float  # ohm
    supply_voltage: float  # V
    friction_coulomb: float  # N m
    friction_viscous: float  # N m s/rad
    sample_period: float  # s
    phase_locked: float  # 1: the spin loop follows the phase of the shaft; 0: its speed


@njit(cache=True, error_model="numpy", forceinline=True)
def controller_update(
    c: Any, s: Any, tilt_x: float, tilt_y: float, spin_angle: float, spin_rate: float, rx: float, ry: float,
    rx_rate: float, ry_rate: float, spin_ref: float, spin_acc: float,
) -> Any:  # fmt: skip
    """Return (coil voltage x, y, motor voltage) for one sample; `s` holds the state (`ControllerState`).

    Tilt: the rotor precesses at the rate that the coils demand, T = -i H v, so the loop sets a wanted tilt rate v
    (proportional and integral in the low-passed error, plus the reference rate), adds the holding torque of the
    detuned flexures and damps the nutation by a phase-advanced derivative. Spin: proportional and integral on a
    speed low-passed twice, far below twice the spin frequency, so that no 2N voltage reaches the motor. Or,
    phase-locked: a reference of the wanted speed runs beside the shaft, and the same gains act on the phase between
    the two, low-passed by the same filter, and on its rate. Only the angle of the shaft is used then; no turn is lost.
    """
    h = c.sample_period
    if s[ControllerState.started] == 0.0:  # first sample: start the filters where the machine is
        s[ControllerState.started] = 1.0
        s[ControllerState.tilt_x] = tilt_x
        s[ControllerState.tilt_y] = tilt_y
        s[ControllerState.last_tilt_x] = tilt_x
        s[ControllerState.last_tilt_y] = tilt_y
        s[ControllerState.spin_rate_once] = spin_rate
        s[ControllerState.spin_rate] = spin_rate
        s[ControllerState.last_spin_angle] = spin_angle - spin_ref * h
    a = 1.0 - math.exp(-2.0 * math.pi * c.tilt_lowpass * h)
    s[ControllerState.tilt_x] += a * (tilt_x - s[ControllerState.tilt_x])
    s[ControllerState.tilt_y] += a * (tilt_y - s[ControllerState.tilt_y])
    # derivative: the high-pass belonging to a first-order low-pass
    b = 1.0 - math.exp(-2.0 * math.pi * c.derivative_lowpass * h)
    dx = (tilt_x - s[ControllerState.last_tilt_x]) * b / h
    dy = (tilt_y - s[ControllerState.last_tilt_y]) * b / h
    s[ControllerState.last_tilt_x] += b * (tilt_x - s[ControllerState.last_tilt_x])
    s[ControllerState.last_tilt_y] += b * (tilt_y - s[ControllerState.last_tilt_y])
    ex = rx - s[ControllerState.tilt_x]
    ey = ry - s[ControllerState.tilt_y]
    vx = c.tilt_bandwidth * ex + c.tilt_integral * s[ControllerState.integral_x] + rx_rate
    vy = c.tilt_bandwidth * ey + c.tilt_integral * s[ControllerState.integral_y] + ry_rate
    # the low-passed rate drives every model term, so that neither noise nor 2N passes through them
    f = 1.0 - math.exp(-2.0 * math.pi * c.spin_lowpass * h)
    s[ControllerState.spin_rate_once] += f * (spin_rate - s[ControllerState.spin_rate_once])
    s[ControllerState.spin_rate] += f * (s[ControllerState.spin_rate_once] - s[ControllerState.spin_rate])
    Omega = s[ControllerState.spin_rate]
    H = c.spin_inertia * Omega
    Ke = c.stiffness - 0.5 * c.tuning_inertia * Omega * Omega
    gain = c.nutation_damping * Omega / c.spin_rate_reference
    cp = math.cos(c.phase_lead * Omega)
    sp = math.sin(c.phase_lead * Omega)
    ux = dx - rx_rate
    uy = dy - ry_rate
    Tx = H * vy + Ke * rx - gain * (cp * ux - sp * uy)
    Ty = -H * vx + Ke * ry - gain * (sp * ux + cp * uy)
    cx = Tx / c.coil_constant
    cy = Ty / c.coil_constant
    limit = c.coil_voltage_limit
    if abs(cx) < limit and abs(cy) < limit:  # integrate only while the coils follow
        s[ControllerState.integral_x] += h * ex
        s[ControllerState.integral_y] += h * ey
    cx = min(max(cx, -limit), limit)
    cy = min(max(cy, -limit), limit)
    torque = c.axial_inertia * spin_acc + c.friction_coulomb + c.friction_viscous * spin_ref
    error = spin_ref - Omega
    if c.phase_locked != 0.0:
        step = (spin_angle - s[ControllerState.last_spin_angle] + math.pi) % (2.0 * math.pi) - math.pi
        s[ControllerState.last_spin_angle] = spin_angle
        # a controller that missed samples has missed as many periods of its reference
        missed = max(round(step / (Omega * h)), 1.0) if Omega * h > 1e-3 else 1.0
        phase = s[ControllerState.phase_error] + spin_ref * missed * h - step
        # beyond half a turn the detector saturates, and the loop slips turns until it locks again
        s[ControllerState.phase_error] = min(max(phase, -math.pi), math.pi)
        s[ControllerState.phase_error_once] += f * (
            s[ControllerState.phase_error] - s[ControllerState.phase_error_once]
        )
        rate = f / h * (s[ControllerState.phase_error_once] - s[ControllerState.phase_error_twice])
        s[ControllerState.phase_error_twice] += h * rate
        torque += c.spin_proportional * rate + c.spin_integral * s[ControllerState.phase_error_twice]
    else:
        torque += c.spin_proportional * error + c.spin_integral * s[ControllerState.spin_integral]
    vm = c.motor_constant * spin_ref + c.motor_resistance * torque / c.motor_constant
    if abs(vm) < c.supply_voltage:
        s[ControllerState.spin_integral] += h * error
    vm = min(max(vm, -c.supply_voltage), c.supply_voltage)
    return cx, cy, vm
