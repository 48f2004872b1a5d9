"""The tilt and spin loops as one compiled update a sample, and the whole closed loop as one compiled run.

As `gyrowheel_sim.plant.kernel`, the text below the kernel line is compiled together with the plant by
`gyrowheel_sim.plant.compose`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from gyrowheel_control.loops.state import CommandColumn, ControllerState, SetpointColumn
from gyrowheel_sim.instruments.readings import Reading
from gyrowheel_sim.jit import njit
from gyrowheel_sim.plant.kernel import plant_advance, plant_measure

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


@njit(cache=True, error_model="numpy")
def closed_loop(
    p: Any, coef: Any, active: Any, env: Any, state: Any, held: Any, c: Any, s: Any, setpoints: Any, stamps: Any,
    start: int, noise: Any, measurement: Any, command: Any,
) -> None:  # fmt: skip
    """Run samples `start` .. start + len(measurement) - 1 of the closed loop under one environment.

    `setpoints` (m, 6), columns `SetpointColumn`, hold from `stamps` (m,) [ns] on and are continued by their rates.
    Sample k is read, then the command that answers it is computed; it acts one sample later (see `plant_advance`).
    """
    h = p.sample_period
    period = round(h * 1e9)
    row = 0
    for i in range(len(measurement)):
        k = start + i
        out = measurement[i]
        if k == 0:
            plant_measure(p, coef, active, env, state, 0.0, held[0], held[1], held[2], held, noise[i], out)
        else:
            # the command of the sample before, computed below, waits in the state
            plant_advance(
                p, coef, active, env, state, held, (k - 1) * h,
                s[ControllerState.coil_voltage_x], s[ControllerState.coil_voltage_y], s[ControllerState.motor_voltage],
                noise[i], out,
            )  # fmt: skip
        now = k * period
        while row + 1 < len(stamps) and stamps[row + 1] <= now:
            row += 1
        age = (now - stamps[row]) * 1e-9
        r = setpoints[row]
        x_rate, y_rate = r[SetpointColumn.tilt_rate_x], r[SetpointColumn.tilt_rate_y]
        acceleration = r[SetpointColumn.spin_acceleration]
        vx, vy, vm = controller_update(
            c,
            s,
            out[Reading.tilt_x],
            out[Reading.tilt_y],
            out[Reading.spin_angle],
            out[Reading.spin_rate],
            r[SetpointColumn.tilt_x] + x_rate * age,
            r[SetpointColumn.tilt_y] + y_rate * age,
            x_rate,
            y_rate,
            r[SetpointColumn.spin_rate] + acceleration * age,
            acceleration,
        )
        s[ControllerState.coil_voltage_x] = vx
        s[ControllerState.coil_voltage_y] = vy
        s[ControllerState.motor_voltage] = vm
        command[i, CommandColumn.coil_voltage_x] = vx
        command[i, CommandColumn.coil_voltage_y] = vy
        command[i, CommandColumn.motor_voltage] = vm
