"""Places in the arrays of the loops: the controller's state, setpoints and commands."""

from __future__ import annotations

from gyrowheel_sim.columns import Column


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
    """What the loops are to follow; it is continued by its rates until the next one comes."""

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
