"""From 2 kHz samples to windows of whole revolutions: smooth motion, harmonics of the spin, mean voltages.

A window holds what it takes to compute exactly the torque that its motion needs: the tilt as a polynomial in time and
its first and second harmonics of the spin angle, the smooth spin rate, and the harmonics of the motor current. The
amplitudes of the harmonics may vary within the window (on a cone they turn with the tilt). Voltages and currents are
plain means, so that their noise is simple.

In the order of the work: `samples` (what goes in), `quality` (missing, clipped, spiked and noisy readings), `instants`
(jitter of the stamps), `motor_temperature`, `steady` (which stretches are steady motion), `window_fit` (one window),
`recorded` (the windows of a recording) or `planned` (those that a plan would give), `windows` (what comes out),
`coverage`, `groups`. What the samples show of the instruments: `stamps`, `spectra`, `hum`, `hum_amplitude`, `lattice`,
and `shown` for all of it.
"""

from gyrowheel_analysis.reduction.coverage import Coverage
from gyrowheel_analysis.reduction.motor_temperature import MOTOR_THERMAL, motor_temperatures
from gyrowheel_analysis.reduction.planned import planned_windows
from gyrowheel_analysis.reduction.quality import NEEDED, READING_NOISES, readable, reading_noise
from gyrowheel_analysis.reduction.recorded import reduce, reduce_and_account
from gyrowheel_analysis.reduction.samples import Commanded, Samples
from gyrowheel_analysis.reduction.shown import Shown, look
from gyrowheel_analysis.reduction.stamps import Stamps
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
    "Commanded",
    "Coverage",
    "Samples",
    "Shown",
    "Stamps",
    "Windows",
    "concatenate",
    "look",
    "motor_temperatures",
    "planned_windows",
    "readable",
    "reading_noise",
    "reduce",
    "reduce_and_account",
    "steady_spans",
    "without_noise",
]
