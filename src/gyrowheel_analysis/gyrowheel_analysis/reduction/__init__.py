"""From 2 kHz samples to windows of whole revolutions: smooth motion, harmonics of the spin, mean voltages.

A window has the data from which the torque that its motion needs is computed exactly: the tilt as a polynomial in time
and its first and second harmonics of the spin angle, the smooth spin rate, and the harmonics of the motor current. The
amplitudes of the harmonics may vary within the window (on a cone they turn with the tilt). Voltages and currents are
plain means, so that their noise is simple.

In the order of the work: `samples` (the input), `quality` (missing, clipped, spiked and noisy readings), `clock`
(jitter), `motor_temperature`, `window_fit` (one window) with `mean_rates` and `outliers`, `segmentation` (the windows
of a recording or a plan) and `windows` (the output, groups of it, and coverage). The instruments as the samples show
them: `hum`, and `instrument_readings` for all of them.
"""
