"""Gains of the tilt and spin loops: part of what a bench file may state of its controller."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from gyrowheel_core.errors import InputError


@dataclass(frozen=True)
class Gains:
    """Gains of the loops.

    They are rates, filters and shares of the bench's own momentum and inertia, so that one set serves benches of any
    size. The defaults settle a 3 deg ramp at 8 deg/s to 0.015 deg within 0.5 s from 1000 to 4000 rpm on the default
    bench, where they are 0.12 N m s/rad, 0.012 N m s/rad and 0.02 N m/rad.

    Attributes
    ----------
    tilt_bandwidth : float
        Bandwidth of the tilt loop [1/s].
    tilt_integral : float
        Integral gain of the tilt loop [1/s^2].
    tilt_lowpass : float
        Low-pass of the tilt readings [Hz].
    nutation_damping : float
        Gain of the nutation damper over the angular momentum of the spin.
    derivative_lowpass : float
        Low-pass of its derivative [Hz].
    spin_proportional, spin_integral : float
        Gains of the spin loop over the moment of inertia of all that turns [1/s], [1/s^2]; of a phase-locked loop
        (`Bench.spin_loop`) on the rate of the phase between reference and shaft, and on the phase itself. Assumed: the
        publication names its loop and gives no gain.
    spin_lowpass : float
        Low-pass of the spin reading, applied twice [Hz].
    """

    tilt_bandwidth: float = 12.0
    tilt_integral: float = 30.0
    tilt_lowpass: float = 25.0
    nutation_damping: float = 0.1832
    derivative_lowpass: float = 400.0
    spin_proportional: float = 6.34
    spin_integral: float = 10.57
    spin_lowpass: float = 6.0

    def __post_init__(self) -> None:
        """Check every gain."""
        for item in fields(self):
            value = getattr(self, item.name)
            if not math.isfinite(value) or value < 0.0:
                raise InputError(f"gains.{item.name}: {value!r} is out of range; allowed: >= 0")
