"""The plant as one step of compiled code: rotor, coils, motor, thermal states, sensors, noise and drift.

This module is not run as it stands: `compose` puts the generated laws of the effects, the body of `dynamics` and
the body of this module into one source file, which is compiled once and cached on disk.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from gyrowheel_sim.effects.no_laws import evaluate_laws, evaluate_samples
from gyrowheel_sim.mechanics.dynamics import (
    case_accelerations,
    case_to_joint,
    generalised_forces,
    inertia_terms,
    joint_accelerations,
    moving_case_forces,
)

# --- kernel ---

# n_x, n_y, n_x', n_y', theta_z, Omega | T_coil, p_air | drifts of coil x, coil y, motor voltage and motor current |
# T_winding, T_motor, rate of the table, its acceleration, coil voltages as the torque follows them |
# motor current, coil lag and supply drop at the last sample
N_STATE = 21
N_NOISE = 15  # 11 readings, 4 drifts
N_MEASUREMENT = 11
# what points up and the home axes, in case axes (see `effects.code.ENVIRONMENT`), then the pressure to which the jar is
# set [Pa], the temperature of the coils' heater above the air [K] (0 = off), the rate to which the table is set [rad/s]
N_ENVIRONMENT = 10
PRESSURE = 7
HEATER = 8
TABLE = 9
HEATER_TIME = 0.5  # s
PUMP_TIME = 0.3  # s; the case holds 0.3 litre of air
TABLE_TIME = 0.05  # s


@njit(cache=True, error_model="numpy", forceinline=True)
def plant_rates(
    p: Any, coef: Any, active: Any, env: Any, t: float, rho: float, s: Any,
    vx: float, vy: float, vm: float, nx: float, ny: float, ux: float, uy: float, angle: float, Omega: float,
) -> Any:  # fmt: skip
    """Return (n_x'', n_y'', Omega') of the rotor with every active effect.

    `s` is the state at the start of the step, for what changes slowly; (vx, vy) are the voltages that the coils'
    torque belongs to, vm is that of the motor.
    """
    nz = math.sqrt(1.0 - nx * nx - ny * ny)
    nz_rate = -(nx * ux + ny * uy) / nz
    zx = -ny / nz
    zy = nx / nz
    zx_rate = -(uy - ny * nz_rate / nz) / nz
    zy_rate = (ux - nx * nz_rate / nz) / nz
    sz = math.sin(angle)
    cz = math.cos(angle)
    sx, cx, sy, cy, wx, wy = case_to_joint(nx, ny, ux, uy, sz, cz, Omega)
    theta_x = math.asin(sx)
    theta_y = math.asin(sy)
    (
        Tx, Ty, axial, shaft, flex_x, flex_y, difference, turn_x, turn_y, gain, mirror_x, mirror_y, motor, resistance
    ) = evaluate_laws(
        coef, active, env, zx, zy, zx_rate, zy_rate, angle, Omega, theta_x, theta_y, wx, wy,
        s[6], p.air_temperature, s[12], s[13], rho, s[18], t,
    )  # fmt: skip
    Tx += p.fixed_torque_x
    Ty += p.fixed_torque_y
    # across the spin axis: T . n = 0 fixes the z component
    Tz = zx * Ty - zy * Tx
    k = p.coil_constant * (1.0 + gain - s[20] / p.supply_voltage)
    Kx = k * (vx + mirror_x * vx + mirror_y * vy)
    Ky = k * (vy + mirror_y * vx - mirror_x * vy)
    Q1, Q2, Q3 = generalised_forces(
        sx, cx, sz, cz,
        Tx + axial * nx, Ty + axial * ny, Tz + axial * nz,
    )  # fmt: skip
    C1, C2, _ = generalised_forces(sx, cx, sz, cz, Kx, Ky, 0.0)
    constant = p.motor_constant * (1.0 + motor)
    current = (vm - constant * Omega) / (p.motor_resistance * (1.0 + resistance))
    sign = 1.0 if Omega > 0.0 else (-1.0 if Omega < 0.0 else 0.0)
    friction = p.bearing_coulomb * sign + p.bearing_viscous * Omega
    Irx = p.rotor_inertia_x + difference
    Iry = p.rotor_inertia_y - difference
    m11, m13, m22, m23, m33, f1, f2, f3 = inertia_terms(
        sx, cx, sy, cy, wx, wy, Omega,
        Irx, Iry, p.rotor_inertia_z,
        p.gimbal_inertia_x, p.gimbal_inertia_y, p.gimbal_inertia_z, p.shaft_inertia,
    )  # fmt: skip
    b1 = Q1 + C1 + f1 + flex_x - p.flexure_stiffness_x * theta_x - p.flexure_damping_x * wx
    b2 = Q2 + C2 + f2 + flex_y - p.flexure_stiffness_y * theta_y - p.flexure_damping_y * wy
    b3 = Q3 + f3 + shaft + constant * current - friction
    if s[14] != 0.0 or s[15] != 0.0 or turn_x != 0.0 or turn_y != 0.0:
        # the table turns the case about the vertical
        e1, e2, e3 = moving_case_forces(
            sx, cx, sy, cy, sz, cz, wx, wy, Omega, Irx, Iry, p.rotor_inertia_z,
            p.gimbal_inertia_x, p.gimbal_inertia_y, p.gimbal_inertia_z, p.shaft_inertia,
            turn_x + s[14] * env[1], turn_y + s[14] * env[2], s[14] * env[0], s[15] * env[1], s[15] * env[2],
            s[15] * env[0],
        )  # fmt: skip
        b1 -= e1
        b2 -= e2
        b3 -= e3
    ax, ay, az = joint_accelerations(m11, m13, m22, m23, m33, b1, b2, b3)
    ax_case, ay_case = case_accelerations(sx, cx, sy, cy, wx, wy, sz, cz, Omega, ax, ay, az)
    return ax_case, ay_case, az


@njit(cache=True, error_model="numpy", forceinline=True)
def plant_step(
    p: Any, coef: Any, active: Any, env: Any, state: Any, t: float, vx: float, vy: float, vm: float
) -> None:
    """Advance `state` in place by one sample period under held voltages (classical Runge-Kutta, fourth order)."""
    h = p.sample_period
    T_coil = state[6]
    T_air = p.air_temperature
    rho = state[7] / (p.gas_constant * T_air)
    # The coils' torque follows their voltage with a lag. The parabola that has the same mean and slope as its
    # exponential over the sample is what the step integrates exactly, however short the lag.
    lag = state[19]
    vx1 = vx2 = vx3 = vx
    vy1 = vy2 = vy3 = vy
    if lag > 0.0:
        q = h / lag
        left = math.exp(-q)
        m0 = (1.0 - left) / q
        m1 = (m0 - left) / q  # mean of s exp(-q s), s = 0 .. 1
        m2 = (2.0 * m1 - left) / q  # mean of s^2 exp(-q s)
        c1 = 3.0 * (2.0 * m1 - m0)
        c2 = 5.0 * (6.0 * m2 - 6.0 * m1 + m0)
        gx = state[16] - vx
        gy = state[17] - vy
        vx1 = vx + gx * (m0 - c1 + c2)
        vy1 = vy + gy * (m0 - c1 + c2)
        vx2 = vx + gx * (m0 - 0.5 * c2)
        vy2 = vy + gy * (m0 - 0.5 * c2)
        vx3 = vx + gx * (m0 + c1 + c2)
        vy3 = vy + gy * (m0 + c1 + c2)
        state[16] = vx + gx * left
        state[17] = vy + gy * left
    else:
        state[16] = vx
        state[17] = vy
    # the table follows its command; its mean rate over the sample counts
    table = state[14]
    left = math.exp(-h / TABLE_TIME)
    after = env[TABLE] + (table - env[TABLE]) * left
    if abs(after - env[TABLE]) < 1.0e-9:
        after = env[TABLE]
    state[15] = (after - table) / h
    state[14] = 0.5 * (table + after)
    x, y, ux, uy, a, w = state[0], state[1], state[2], state[3], state[4], state[5]
    xs, ys, uxs, uys, as_, ws = x, y, ux, uy, a, w
    kx = ky = 0.0
    dx = dy = dux = duy = da = dw = 0.0
    for stage in range(4):
        c = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
        ex = vx1 if stage == 0 else (vx3 if stage == 3 else vx2)
        ey = vy1 if stage == 0 else (vy3 if stage == 3 else vy2)
        ax, ay, aw = plant_rates(
            p, coef, active, env, t + c, rho, state, ex, ey, vm, xs, ys, uxs, uys, as_, ws
        )
        if stage == 0:
            kx = ax
            ky = ay
        weight = 1.0 if stage == 0 or stage == 3 else 2.0
        dx += weight * uxs
        dy += weight * uys
        da += weight * ws
        dux += weight * ax
        duy += weight * ay
        dw += weight * aw
        c = h if stage == 2 else 0.5 * h
        xs, ys, as_ = x + c * uxs, y + c * uys, a + c * ws
        uxs, uys, ws = ux + c * ax, uy + c * ay, w + c * aw
    s = h / 6.0
    # What the step falls behind a free nutation, whose first slopes are kx + i ky: with n the angle of the nutation in
    # one step, exp(i n) less the first five terms of its series, over i n; and the same once more integrated.
    n = (
        (p.rotor_inertia_z + p.gimbal_inertia_x)
        / (0.5 * (p.rotor_inertia_x + p.rotor_inertia_y + p.gimbal_inertia_x))
        * w
        * h
    )
    q = n * n
    cubic = n * q / 120.0 * (1.0 - q / 42.0)
    fourth = q * q / 720.0 * (1.0 - q / 56.0)
    real = n * cubic
    imag = n * fourth
    state[0] = x + s * dx + h * h * (fourth * kx + cubic * ky)
    state[1] = y + s * dy + h * h * (fourth * ky - cubic * kx)
    state[2] = ux + s * dux + h * (real * kx - imag * ky)
    state[3] = uy + s * duy + h * (real * ky + imag * kx)
    angle = a + s * da
    state[4] = angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi))
    state[5] = w + s * dw
    state[14] = after
    # coils: electrical heating, loss to the air; the heater brings them to its temperature within about a second
    power = (vx * vx + vy * vy) / p.coil_resistance - (T_coil - T_air) / p.coil_thermal_resistance
    if env[HEATER] > 0.0:
        power += p.coil_heat_capacity * (T_air + env[HEATER] - T_coil) / HEATER_TIME
    state[6] = T_coil + h * power / p.coil_heat_capacity
    state[7] += h * (env[PRESSURE] - state[7]) / PUMP_TIME
    # motor: the current heats the winding, the winding the magnets, these the air
    current = state[18]
    inward = (state[12] - state[13]) / p.winding_thermal_resistance
    outward = (state[13] - T_air) / p.motor_thermal_resistance
    state[12] += h * (p.motor_resistance * current * current - inward) / p.winding_heat_capacity
    state[13] += h * (inward - outward) / p.motor_heat_capacity


@njit(cache=True, error_model="numpy", forceinline=True)
def plant_measure(
    p: Any,
    coef: Any,
    active: Any,
    env: Any,
    state: Any,
    t: float,
    vx: float,
    vy: float,
    vm: float,
    noise: Any,
    out: Any,
) -> None:
    """Write one sample of every sensor into `out` (11 values), advancing the slow drifts in `state`."""
    a = math.exp(-p.sample_period / p.drift_time)
    b = math.sqrt(1.0 - a * a)
    state[8] = a * state[8] + b * p.coil_voltage_drift * noise[11]
    state[9] = a * state[9] + b * p.coil_voltage_drift * noise[12]
    state[10] = a * state[10] + b * p.motor_voltage_drift * noise[13]
    state[11] = a * state[11] + b * p.motor_current_drift * noise[14]
    nx, ny, ux, uy, Omega, T_coil = state[0], state[1], state[2], state[3], state[5], state[6]
    nz = math.sqrt(1.0 - nx * nx - ny * ny)
    nz_rate = -(nx * ux + ny * uy) / nz
    zx, zy = -ny / nz, nx / nz
    zx_rate, zy_rate = -(uy - ny * nz_rate / nz) / nz, (ux - nx * nz_rate / nz) / nz
    T_air = p.air_temperature
    rho = state[7] / (p.gas_constant * T_air)
    _, _, _, _, _, _, _, _, _, _, _, _, motor, resistance = evaluate_laws(
        coef, active, env, zx, zy, zx_rate, zy_rate, state[4], Omega,
        0.0, 0.0, 0.0, 0.0, T_coil, T_air, state[12], state[13], rho, state[18], t,
    )  # fmt: skip
    current = (vm - p.motor_constant * (1.0 + motor) * Omega) / (p.motor_resistance * (1.0 + resistance))
    lag, drop, bias_x, bias_y = evaluate_samples(
        coef, active, env, zx, zy, zx_rate, zy_rate, state[4], Omega,
        0.0, 0.0, 0.0, 0.0, T_coil, T_air, state[12], state[13], rho, current, t,
    )  # fmt: skip
    state[18] = current
    state[19] = lag
    state[20] = drop
    out[0] = p.tilt_scale * math.atan(zx) + p.tilt_bias_x + bias_x + p.tilt_noise * noise[0]
    out[1] = p.tilt_scale * math.atan(zy) + p.tilt_bias_y + bias_y + p.tilt_noise * noise[1]
    angle = state[4] + p.spin_angle_noise * noise[2]
    out[2] = angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi))
    out[3] = Omega + p.spin_rate_noise * noise[3]
    out[4] = vx + state[8] + p.coil_voltage_noise * noise[4]
    out[5] = vy + state[9] + p.coil_voltage_noise * noise[5]
    out[6] = vm + state[10] + p.motor_voltage_noise * noise[6]
    out[7] = current + state[11] + p.motor_current_noise * noise[7]
    out[8] = T_coil + p.temperature_bias + p.temperature_noise * noise[8]
    out[9] = T_air + p.temperature_noise * noise[9]
    out[10] = state[7] + p.pressure_bias + p.pressure_noise * noise[10]


@njit(cache=True, error_model="numpy")
def saturated(value: float, limit: float) -> float:
    """Return `value` held within +-`limit`."""
    return min(max(value, -limit), limit)


@njit(cache=True, error_model="numpy", forceinline=True)
def plant_advance(
    p: Any, coef: Any, active: Any, env: Any, state: Any, held: Any, t: float, vx: float, vy: float, vm: float,
    noise: Any, out: Any,
) -> None:  # fmt: skip
    """Advance by one sample: the command waiting in `held` acts, (vx, vy, vm) waits for the next, `out` is read.

    The command that answers a sample therefore acts one sample later, as on a computer that writes its outputs at
    the next tick.
    """
    ax, ay, am = held[0], held[1], held[2]
    # the supply may have fallen since the command was taken
    top = max(p.supply_voltage - state[20], 0.0)
    am = saturated(am, top)
    plant_step(p, coef, active, env, state, t, ax, ay, am)
    held[0] = saturated(vx, p.coil_voltage_limit)
    held[1] = saturated(vy, p.coil_voltage_limit)
    held[2] = saturated(vm, p.supply_voltage)
    plant_measure(p, coef, active, env, state, t + p.sample_period, ax, ay, am, noise, out)
