"""The readings of one sample, and the slow drifts of the instruments that give them."""

from __future__ import annotations

from gyrowheel_sim.columns import Column


class Reading(Column):
    """Columns of a sample, in the order of the Measurement message."""

    tilt_x = 0, "rad", "tilt about case x"
    tilt_y = 1, "rad", "tilt about case y"
    spin_angle = 2, "rad", "angle of the shaft, 0 .. 2 pi"
    spin_rate = 3, "rad/s", "spin rate of the shaft"
    coil_voltage_x = 4, "V", "voltage of the coils that turn the rotor about case x"
    coil_voltage_y = 5, "V", "the same about case y"
    motor_voltage = 6, "V", "voltage of the motor"
    motor_current = 7, "A", "current of the motor"
    coil_temperature = 8, "K", "temperature of the torque coils"
    air_temperature = 9, "K", "temperature of the air in the case"
    air_pressure = 10, "Pa", "air pressure in the case"


class Drift(Column):
    """Slow drifts of the instruments, part of the state of the plant; the bench states their standard deviations."""

    coil_voltage_x = 0, "V", "drift of the reading of coil voltage x"
    coil_voltage_y = 1, "V", "drift of the reading of coil voltage y"
    motor_voltage = 2, "V", "drift of the reading of the motor voltage"
    motor_current = 3, "A", "drift of the reading of the motor current"


#: Bench parameter that states the standard deviation of each drift.
DRIFT_SIZES = {
    Drift.coil_voltage_x: "coil_voltage_drift",
    Drift.coil_voltage_y: "coil_voltage_drift",
    Drift.motor_voltage: "motor_voltage_drift",
    Drift.motor_current: "motor_current_drift",
}
#: Standard normal numbers that one sample takes: one a reading, then one a drift.
N_NOISE = len(Reading) + len(Drift)
