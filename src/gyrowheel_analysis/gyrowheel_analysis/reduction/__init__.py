"""From 2 kHz samples to windows of whole revolutions: smooth motion, harmonics of the spin, mean voltages.

A window is described so that the torque which its motion needs can be computed exactly: the tilt as a polynomial in
time plus its first and second harmonics of the spin angle, whose amplitudes may vary in the window (on a cone they
turn with the tilt), the smooth spin rate, and the harmonics of the motor's current. Voltages and currents are plain
means, which leaves their noise simple.
"""

from gyrowheel_analysis.reduction.coverage import Coverage
from gyrowheel_analysis.reduction.motor_temperature import MOTOR_THERMAL, motor_temperatures
from gyrowheel_analysis.reduction.planned import planned_windows
from gyrowheel_analysis.reduction.quality import NEEDED, READING_NOISES, readable, reading_noise
from gyrowheel_analysis.reduction.recorded import reduce, reduce_and_account
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.steady import LONGEST, SETTLING, SPIN_SETTLING, steady_spans
from gyrowheel_analysis.reduction.windows import FORWARD, HARMONICS, Windows, concatenate, without_noise

__all__ = [
    "FORWARD",
    "HARMONICS",
    "LONGEST",
    "MOTOR_THERMAL",
    "NEEDED",
    "READING_NOISES",
    "SETTLING",
    "SPIN_SETTLING",
    "Coverage",
    "Samples",
    "Windows",
    "concatenate",
    "motor_temperatures",
    "planned_windows",
    "readable",
    "reading_noise",
    "reduce",
    "reduce_and_account",
    "steady_spans",
    "without_noise",
]
