"""The plant as one step of compiled code: rotor, coils, motor, thermal states; the instruments read it.

This module itself is not run: `gyrowheel_sim.plant.compiled` combines the array indices, the equations of motion, the
generated laws of the effects, the instruments and the text below in one source, which is compiled once and cached on
disk. Effects act only through the interface of `gyrowheel_sim.effects.generated`: no law target is named here.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from gyrowheel_sim.effects.law_code import Instant
from gyrowheel_sim.instruments import ROWS, WIDTH, Chain, Past
from gyrowheel_sim.instruments.kernel import (
    SHORTEST_FILTER,
    SUB_STEPS,
    advance_drifts,
    encoded,
    filter_started,
    filtered,
    has_chain,
    moved_to,
    read_held,
    read_instruments,
    remember,
    remember_next,
    sensed_tilt,
)
from gyrowheel_sim.jit import call_laws, njit, register_jitable
from gyrowheel_sim.mechanics.dynamics import (
    case_accelerations,
    case_to_joint,
    generalised_forces,
    inertia_terms,
    joint_accelerations,
    moving_case_forces,
)
from gyrowheel_sim.plant.compiled import DRIFT_START, MEMORY_START, Further, State, Surroundings

if TYPE_CHECKING:
    from gyrowheel_sim.effects.generated import (
        LAW_MEMORY,
        acting,
        changed,
        changed_at_sample,
        evaluate_laws,
        evaluate_samples,
        hold_samples,
        lag_of_coils,
        law_rates,
        law_starts,
        law_states,
        reading_errors,
        remembers,
    )

# --- kernel ---

HEATER_TIME = 0.5  # s
PUMP_TIME = 0.3  # s; the case holds 0.3 litre of air
TABLE_TIME = 0.05  # s


@register_jitable(forceinline=True)
def instant_of(
    p: Any, env: Any, s: Any, t: float, rho: float, zx: float, zy: float, zx_rate: float, zy_rate: float,
    angle: float, Omega: float, theta_x: float, theta_y: float, wx: float, wy: float, current: float,
    vx: float, vy: float,
) -> Instant:  # fmt: skip
    """Return the inputs of the laws: the motion from the arguments, the rest from state and surroundings."""
    return Instant(
        zx=zx, zy=zy, zx_rate=zx_rate, zy_rate=zy_rate, theta_z=angle, Omega=Omega,
        theta_x=theta_x, theta_y=theta_y, theta_x_rate=wx, theta_y_rate=wy,
        T_coil=s[State.coil_temperature], T_air=p.air_temperature, T_winding=s[State.winding_temperature],
        T_motor=s[State.motor_temperature], rho=rho, i_motor=current, Vx=vx, Vy=vy, t=t,
        up=env[Surroundings.up], up_x=env[Surroundings.up_x], up_y=env[Surroundings.up_y],
        home_xx=env[Surroundings.home_xx], home_xy=env[Surroundings.home_xy],
        home_yx=env[Surroundings.home_yx], home_yy=env[Surroundings.home_yy],
    )  # fmt: skip


@register_jitable(forceinline=True)
def laws_at(coef: Any, active: Any, further: Any, state: Any, q: Instant) -> Any:
    """Return the laws at an instant, with those that are not compiled here: `further` has their addresses."""
    laws = evaluate_laws(coef, active, state, q)
    return call_laws(further[Further.evaluate_laws], coef, active, state, q, laws)


@register_jitable(forceinline=True)
def samples_at(coef: Any, active: Any, further: Any, state: Any, q: Instant) -> Any:
    """Return the same of the laws that are evaluated once a sample."""
    laws = evaluate_samples(coef, active, state, q)
    return call_laws(further[Further.evaluate_samples], coef, active, state, q, laws)


@register_jitable(forceinline=True)
def write_rates(coef: Any, active: Any, further: Any, state: Any, q: Instant) -> None:
    """Write the rates of the states of all effects into `state`."""
    law_rates(coef, active, state, q)
    call_laws(further[Further.law_rates], coef, active, state, q, ())


@njit(cache=True, error_model="numpy", forceinline=True)
def plant_rates(
    p: Any, coef: Any, active: Any, further: Any, env: Any, t: float, rho: float, s: Any,
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
    at = instant_of(
        p, env, s, t, rho, zx, zy, zx_rate, zy_rate, angle, Omega, theta_x, theta_y, wx, wy,
        s[State.motor_current], vx, vy,
    )  # fmt: skip
    laws = laws_at(coef, active, further, s, at)
    act = acting(laws)
    m = changed(p, laws, s)
    Tx = act.across_x + m.fixed_torque_x
    Ty = act.across_y + m.fixed_torque_y
    # across the spin axis: T . n = 0 fixes the z component
    Tz = zx * Ty - zy * Tx
    k = m.coil_constant
    Kx = k * (vx + act.mirror_x * vx + act.mirror_y * vy)
    Ky = k * (vy + act.mirror_y * vx - act.mirror_x * vy)
    Q1, Q2, Q3 = generalised_forces(
        sx, cx, sz, cz,
        Tx + act.along * nx, Ty + act.along * ny, Tz + act.along * nz,
    )  # fmt: skip
    C1, C2, _ = generalised_forces(sx, cx, sz, cz, Kx, Ky, 0.0)
    current = (vm - m.motor_constant * Omega) / m.motor_resistance
    sign = 1.0 if Omega > 0.0 else (-1.0 if Omega < 0.0 else 0.0)
    friction = m.bearing_coulomb * sign + m.bearing_viscous * Omega
    m11, m13, m22, m23, m33, f1, f2, f3 = inertia_terms(
        sx, cx, sy, cy, wx, wy, Omega,
        m.rotor_inertia_x, m.rotor_inertia_y, m.rotor_inertia_z,
        m.gimbal_inertia_x, m.gimbal_inertia_y, m.gimbal_inertia_z, m.shaft_inertia,
    )  # fmt: skip
    b1 = Q1 + C1 + f1 + act.flexure_x - m.flexure_stiffness_x * theta_x - m.flexure_damping_x * wx
    b2 = Q2 + C2 + f2 + act.flexure_y - m.flexure_stiffness_y * theta_y - m.flexure_damping_y * wy
    b3 = Q3 + f3 + act.shaft + m.motor_constant * current - friction
    table, faster = s[State.table_rate], s[State.table_acceleration]
    if table != 0.0 or faster != 0.0 or act.case_rate_x != 0.0 or act.case_rate_y != 0.0:
        # the table turns the case about the vertical
        e1, e2, e3 = moving_case_forces(
            sx, cx, sy, cy, sz, cz, wx, wy, Omega,
            m.rotor_inertia_x, m.rotor_inertia_y, m.rotor_inertia_z,
            m.gimbal_inertia_x, m.gimbal_inertia_y, m.gimbal_inertia_z, m.shaft_inertia,
            act.case_rate_x + table * at.up_x, act.case_rate_y + table * at.up_y, table * at.up,
            faster * at.up_x, faster * at.up_y, faster * at.up,
        )  # fmt: skip
        b1 -= e1
        b2 -= e2
        b3 -= e3
    ax, ay, az = joint_accelerations(m11, m13, m22, m23, m33, b1, b2, b3)
    ax_case, ay_case = case_accelerations(sx, cx, sy, cy, wx, wy, sz, cz, Omega, ax, ay, az)
    return ax_case, ay_case, az


@njit(cache=True, error_model="numpy", forceinline=True)
def tilt_of(nx: float, ny: float, ux: float, uy: float) -> Any:
    """Return the tilt (zx, zy) of a spin axis, and its rate."""
    nz = math.sqrt(1.0 - nx * nx - ny * ny)
    nz_rate = -(nx * ux + ny * uy) / nz
    return -ny / nz, nx / nz, -(uy - ny * nz_rate / nz) / nz, (ux - nx * nz_rate / nz) / nz


@njit(cache=True, error_model="numpy")
def instant_now(p: Any, env: Any, state: Any, t: float, rho: float) -> Any:
    """Return the inputs of the laws by the state of the machine."""
    nx, ny, ux, uy = state[State.n_x], state[State.n_y], state[State.n_x_rate], state[State.n_y_rate]
    angle, Omega = state[State.spin_angle], state[State.spin_rate]
    zx, zy, zx_rate, zy_rate = tilt_of(nx, ny, ux, uy)
    sx, _, sy, _, wx, wy = case_to_joint(nx, ny, ux, uy, math.sin(angle), math.cos(angle), Omega)
    return instant_of(
        p, env, state, t, rho, zx, zy, zx_rate, zy_rate, angle, Omega, math.asin(sx), math.asin(sy), wx, wy,
        state[State.motor_current], state[State.coil_x], state[State.coil_y],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def begin_memory(p: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, t: float) -> None:
    """Give the states of the effects their start values, at the first sample."""
    if (remembers(active) or further[Further.law_rates] != 0) and state[-1] == 0.0:
        rho = state[State.air_pressure] / (p.gas_constant * p.air_temperature)
        at = instant_now(p, env, state, t, rho)
        law_starts(coef, active, state, at)
        call_laws(further[Further.law_starts], coef, active, state, at, ())
        state[-1] = 1.0


@njit(cache=True, error_model="numpy")
def advance_memory(
    p: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, t: float, rho: float, h: float
) -> None:
    """Advance the states of the effects to the middle of a sample, where the laws of its motion take them."""
    if remembers(active) or further[Further.law_rates] != 0:
        write_rates(coef, active, further, state, instant_now(p, env, state, t, rho))
        n = law_states(state)
        for i in range(LAW_MEMORY, LAW_MEMORY + n):
            state[i] += 0.5 * h * state[i + n]
            state[i + 2 * n] = state[i]


@njit(cache=True, error_model="numpy")
def complete_memory(
    p: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, t: float, rho: float, h: float
) -> None:
    """Advance the states of the effects to the end of a sample, with the mean of the rates at both ends (Heun)."""
    if remembers(active) or further[Further.law_rates] != 0:
        n = law_states(state)
        for i in range(LAW_MEMORY, LAW_MEMORY + n):
            state[i] += 0.5 * h * state[i + n]
        write_rates(coef, active, further, state, instant_now(p, env, state, t, rho))
        for i in range(LAW_MEMORY, LAW_MEMORY + n):
            state[i] = state[i + 2 * n] + 0.5 * h * state[i + n]


@njit(cache=True, error_model="numpy", forceinline=True)
def plant_step(
    p: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, t: float, vx: float, vy: float, vm: float,
) -> None:  # fmt: skip
    """Advance `state` in place by one sample period under held voltages (classical Runge-Kutta, fourth order)."""
    h = p.sample_period
    T_coil = state[State.coil_temperature]
    T_air = p.air_temperature
    rho = state[State.air_pressure] / (p.gas_constant * T_air)
    advance_memory(p, coef, active, further, env, state, t, rho, h)
    # The coils' torque follows their voltage with a lag. The parabola that has the same mean and slope as its
    # exponential over the sample is what the step integrates exactly, however short the lag.
    lag = lag_of_coils(state)
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
        gx = state[State.coil_x] - vx
        gy = state[State.coil_y] - vy
        vx1 = vx + gx * (m0 - c1 + c2)
        vy1 = vy + gy * (m0 - c1 + c2)
        vx2 = vx + gx * (m0 - 0.5 * c2)
        vy2 = vy + gy * (m0 - 0.5 * c2)
        vx3 = vx + gx * (m0 + c1 + c2)
        vy3 = vy + gy * (m0 + c1 + c2)
        state[State.coil_x] = vx + gx * left
        state[State.coil_y] = vy + gy * left
    else:
        state[State.coil_x] = vx
        state[State.coil_y] = vy
    # the table follows its command; its mean rate over the sample counts
    table, wanted = state[State.table_rate], env[Surroundings.table_rate]
    left = math.exp(-h / TABLE_TIME)
    after = wanted + (table - wanted) * left
    if abs(after - wanted) < 1.0e-9:
        after = wanted
    state[State.table_acceleration] = (after - table) / h
    state[State.table_rate] = 0.5 * (table + after)
    x, y = state[State.n_x], state[State.n_y]
    ux, uy = state[State.n_x_rate], state[State.n_y_rate]
    a, w = state[State.spin_angle], state[State.spin_rate]
    xs, ys, uxs, uys, as_, ws = x, y, ux, uy, a, w
    kx = ky = 0.0
    dx = dy = dux = duy = da = dw = 0.0
    for stage in range(4):
        c = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
        ex = vx1 if stage == 0 else (vx3 if stage == 3 else vx2)
        ey = vy1 if stage == 0 else (vy3 if stage == 3 else vy2)
        ax, ay, aw = plant_rates(
            p, coef, active, further, env, t + c, rho, state, ex, ey, vm, xs, ys, uxs, uys, as_, ws
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
    # Truncation error of the step for a free nutation, whose first slopes are kx + i ky: with n the nutation angle of
    # one step, exp(i n) less the first five terms of its series, over i n; and its integral.
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
    state[State.n_x] = x + s * dx + h * h * (fourth * kx + cubic * ky)
    state[State.n_y] = y + s * dy + h * h * (fourth * ky - cubic * kx)
    state[State.n_x_rate] = ux + s * dux + h * (real * kx - imag * ky)
    state[State.n_y_rate] = uy + s * duy + h * (real * ky + imag * kx)
    angle = a + s * da
    state[State.spin_angle] = angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi))
    state[State.spin_rate] = w + s * dw
    state[State.table_rate] = after
    complete_memory(p, coef, active, further, env, state, t + h, rho, h)
    # coils: electrical heating, loss to the air; the heater brings them to its temperature within about a second
    power = (vx * vx + vy * vy) / p.coil_resistance - (T_coil - T_air) / p.coil_thermal_resistance
    if env[Surroundings.heater] > 0.0:
        power += p.coil_heat_capacity * (T_air + env[Surroundings.heater] - T_coil) / HEATER_TIME
    state[State.coil_temperature] = T_coil + h * power / p.coil_heat_capacity
    state[State.air_pressure] += h * (env[Surroundings.pressure] - state[State.air_pressure]) / PUMP_TIME
    # motor: the current heats the winding, the winding the magnets, these the air
    current = state[State.motor_current]
    winding, magnets = state[State.winding_temperature], state[State.motor_temperature]
    inward = (winding - magnets) / p.winding_thermal_resistance
    outward = (magnets - T_air) / p.motor_thermal_resistance
    state[State.winding_temperature] += (
        h * (p.motor_resistance * current * current - inward) / p.winding_heat_capacity
    )
    state[State.motor_temperature] += h * (inward - outward) / p.motor_heat_capacity


@njit(cache=True, error_model="numpy")
def saturated(value: float, limit: float) -> float:
    """Return `value` held within +-`limit`."""
    return min(max(value, -limit), limit)


@njit(cache=True, error_model="numpy", forceinline=True)
def angle_at(q: Any, state: Any, age: float) -> Any:
    """Return the angle of the shaft and the spin rate at an instant within the memory of the instruments."""
    return moved_to(state, MEMORY_START, q.sample_period, Past.spin_angle, Past.spin_rate, age, 2.0 * math.pi)


@njit(cache=True, error_model="numpy")
def tilt_at(
    p: Any, q: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, t: float, rho: float, current: float,
    age: float,
) -> Any:  # fmt: skip
    """Return the output of the tilt sensors for an instant within the memory of the instruments."""
    h = p.sample_period
    nx, ux = moved_to(state, MEMORY_START, h, Past.n_x, Past.n_x_rate, age, 0.0)
    ny, uy = moved_to(state, MEMORY_START, h, Past.n_y, Past.n_y_rate, age, 0.0)
    angle, Omega = angle_at(q, state, age)
    zx, zy, zx_rate, zy_rate = tilt_of(nx, ny, ux, uy)
    at = instant_of(
        p, env, state, t - age * h, rho, zx, zy, zx_rate, zy_rate, angle, Omega, 0.0, 0.0, 0.0, 0.0, current,
        state[State.coil_x], state[State.coil_y],
    )  # fmt: skip
    error = reading_errors(samples_at(coef, active, further, state, at))
    return sensed_tilt(q, zx, zy, error.tilt_x, error.tilt_y)


@njit(cache=True, error_model="numpy")
def read_through_chain(
    p: Any, q: Any, m: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, held: Any, t: float, rho: float,
    vx: float, vy: float, vm: float, current: float,
) -> Any:  # fmt: skip
    """Return tilts, angle, voltages and current after delays and filters.

    `q` are the parameters as the laws of the sample change them, `m` as those of the instant do.
    """
    h = p.sample_period
    Omega, before = state[State.spin_rate], state[MEMORY_START + ROWS + WIDTH + Past.spin_rate]
    first = remember(
        state, MEMORY_START, h, state[State.n_x], state[State.n_y], state[State.n_x_rate], state[State.n_y_rate],
        state[State.spin_angle], Omega, vx, vy, vm, current,
    )  # fmt: skip
    # the voltages that wait act from now on; the speed goes on as it did
    ahead = saturated(held[2], max(q.supply_voltage, 0.0))
    speed = Omega if first else 2.0 * Omega - before
    remember_next(
        state, MEMORY_START, held[0], held[1], ahead, (ahead - m.motor_constant * speed) / m.motor_resistance
    )
    age = q.tilt_delay / h
    time = q.tilt_filter_time
    if time > SHORTEST_FILTER:
        if first:
            tilt_x, tilt_y = tilt_at(p, q, coef, active, further, env, state, t, rho, current, age + 1.0)
            filter_started(state, MEMORY_START, Chain.tilt_x, tilt_x)
            filter_started(state, MEMORY_START, Chain.tilt_y, tilt_y)
        step = h / SUB_STEPS
        left = math.exp(-step / time)
        mean = (1.0 - left) * time / step
        order = int(q.tilt_filter_order)
        tilt_x = tilt_y = 0.0
        for i in range(SUB_STEPS):
            now = age + 1.0 - (i + 1) / SUB_STEPS
            tilt_x, tilt_y = tilt_at(p, q, coef, active, further, env, state, t, rho, current, now)
            tilt_x = filtered(state, MEMORY_START, Chain.tilt_x, order, left, mean, tilt_x)
            tilt_y = filtered(state, MEMORY_START, Chain.tilt_y, order, left, mean, tilt_y)
    else:
        tilt_x, tilt_y = tilt_at(p, q, coef, active, further, env, state, t, rho, current, age)
    angle, _ = angle_at(q, state, q.spin_angle_delay / h)
    vx = read_held(
        state, MEMORY_START, h, first, Past.coil_voltage_x, Chain.coil_voltage_x,
        q.coil_voltage_delay, q.coil_voltage_filter_time, q.coil_voltage_filter_order,
    )  # fmt: skip
    vy = read_held(
        state, MEMORY_START, h, first, Past.coil_voltage_y, Chain.coil_voltage_y,
        q.coil_voltage_delay, q.coil_voltage_filter_time, q.coil_voltage_filter_order,
    )  # fmt: skip
    vm = read_held(
        state, MEMORY_START, h, first, Past.motor_voltage, Chain.motor_voltage,
        q.motor_voltage_delay, q.motor_voltage_filter_time, q.motor_voltage_filter_order,
    )  # fmt: skip
    current = read_held(
        state, MEMORY_START, h, first, Past.motor_current, Chain.motor_current,
        q.motor_current_delay, q.motor_current_filter_time, q.motor_current_filter_order,
    )  # fmt: skip
    return tilt_x, tilt_y, angle, vx, vy, vm, current


@njit(cache=True, error_model="numpy", forceinline=True)
def plant_measure(
    p: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, t: float, vx: float, vy: float, vm: float,
    held: Any,
    noise: Any, out: Any,
) -> None:  # fmt: skip
    """Write one sample of every reading into `out`, advancing in `state` what changes once a sample.

    (vx, vy, vm) are the voltages of the interval that ends at the sample, `held` those of the next one.
    """
    advance_drifts(p, state, DRIFT_START, noise)
    begin_memory(p, coef, active, further, env, state, t)
    angle, Omega, T_coil = state[State.spin_angle], state[State.spin_rate], state[State.coil_temperature]
    zx, zy, zx_rate, zy_rate = tilt_of(
        state[State.n_x], state[State.n_y], state[State.n_x_rate], state[State.n_y_rate]
    )
    T_air = p.air_temperature
    rho = state[State.air_pressure] / (p.gas_constant * T_air)
    # the laws at an instant know the current of the sample before, those evaluated once a sample its own
    at = instant_of(
        p, env, state, t, rho, zx, zy, zx_rate, zy_rate, angle, Omega, 0.0, 0.0, 0.0, 0.0,
        state[State.motor_current], state[State.coil_x], state[State.coil_y],
    )  # fmt: skip
    m = changed(p, laws_at(coef, active, further, state, at), state)
    current = (vm - m.motor_constant * Omega) / m.motor_resistance
    at = instant_of(
        p, env, state, t, rho, zx, zy, zx_rate, zy_rate, angle, Omega, 0.0, 0.0, 0.0, 0.0, current,
        state[State.coil_x], state[State.coil_y],
    )  # fmt: skip
    laws = samples_at(coef, active, further, state, at)
    hold_samples(state, laws)
    state[State.motor_current] = current
    error = reading_errors(laws)
    q = changed_at_sample(p, state)
    if has_chain(q):
        tilt_x, tilt_y, angle, vx, vy, vm, current = read_through_chain(
            p, q, m, coef, active, further, env, state, held, t, rho, vx, vy, vm, current
        )
    else:
        tilt_x, tilt_y = sensed_tilt(q, zx, zy, error.tilt_x, error.tilt_y)
    read_instruments(
        p, error, state, DRIFT_START, noise, t, tilt_x, tilt_y, encoded(q, angle), Omega, vx, vy, vm, current,
        T_coil, T_air, state[State.air_pressure], out,
    )  # fmt: skip


@njit(cache=True, error_model="numpy", forceinline=True)
def plant_advance(
    p: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, held: Any, t: float, vx: float, vy: float,
    vm: float,
    noise: Any, out: Any,
) -> None:  # fmt: skip
    """Advance by one sample: the command waiting in `held` acts, (vx, vy, vm) waits for the next, `out` is read.

    The command that answers a sample therefore acts one sample later, as on a computer that writes its outputs at
    the next tick.
    """
    ax, ay, am = held[0], held[1], held[2]
    # the supply may have fallen since the command was taken
    top = max(changed_at_sample(p, state).supply_voltage, 0.0)
    am = saturated(am, top)
    plant_step(p, coef, active, further, env, state, t, ax, ay, am)
    held[0] = saturated(vx, p.coil_voltage_limit)
    held[1] = saturated(vy, p.coil_voltage_limit)
    held[2] = saturated(vm, p.supply_voltage)
    plant_measure(p, coef, active, further, env, state, t + p.sample_period, ax, ay, am, held, noise, out)
