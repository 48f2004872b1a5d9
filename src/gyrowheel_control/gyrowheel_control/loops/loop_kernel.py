"""The whole closed loop as one compiled run: plant and controller, sample by sample.

As `gyrowheel_sim.plant.kernel`, the text below the kernel line is compiled together with the plant by
`gyrowheel_sim.plant.compiled`.
"""

from __future__ import annotations

from typing import Any

from gyrowheel_control.loops.kernel import CommandColumn, ControllerState, SetpointColumn, controller_update
from gyrowheel_sim.instruments import Reading
from gyrowheel_sim.jit import njit
from gyrowheel_sim.plant.kernel import plant_advance, plant_measure

# --- kernel ---


@njit(cache=True, error_model="numpy")
def closed_loop(
    p: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, held: Any, c: Any, s: Any, setpoints: Any,
    stamps: Any,
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
            plant_measure(
                p, coef, active, further, env, state, 0.0, held[0], held[1], held[2], held, noise[i], out
            )
        else:
            # the command of the sample before, computed below, waits in the state
            plant_advance(
                p, coef, active, further, env, state, held, (k - 1) * h,
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
