"""From 2 kHz samples to windows of whole revolutions: smooth motion, harmonics of the spin, mean voltages.

A window is described so that the torque which its motion needs can be computed exactly: the tilt as a polynomial in
time plus its first and second harmonics of the spin angle, whose amplitudes may vary in the window (on a cone they
turn with the tilt), the smooth spin rate, and the harmonics of the motor's current. Voltages and currents are plain
means, which leaves their noise simple.
"""

from gyrowheel_analysis.reduction.windows import (
    FORWARD,
    HARMONICS,
    MOTOR_THERMAL,
    READING_NOISES,
    SETTLING,
    SPIN_SETTLING,
    Samples,
    Windows,
    concatenate,
    motor_temperatures,
    planned_windows,
    reading_noise,
    reduce,
    steady_spans,
    without_noise,
)

__all__ = [
    "FORWARD",
    "HARMONICS",
    "MOTOR_THERMAL",
    "READING_NOISES",
    "SETTLING",
    "SPIN_SETTLING",
    "Samples",
    "Windows",
    "concatenate",
    "motor_temperatures",
    "planned_windows",
    "reading_noise",
    "reduce",
    "steady_spans",
    "without_noise",
]
