"""The windows that a plan would give, without running it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gyrowheel_analysis.reduction.motor_temperature import MOTOR_THERMAL
from gyrowheel_analysis.reduction.quality import READING_NOISES
from gyrowheel_analysis.reduction.steady import (
    CONE_SETTLING,
    FEWEST_REVOLUTIONS,
    LONGEST,
    SETTLING,
    SHORTEST,
    SPEED_CHANGE,
    SPIN_SETTLING,
    cone_window,
    window_count,
)
from gyrowheel_analysis.reduction.window_fit import spin_terms
from gyrowheel_analysis.reduction.windows import DEGREE, FORWARD, HARMONICS, MODULATION, Windows, attitude
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench


def planned_windows(plan: Plan, bench: Bench) -> Windows:
    """Return the windows that a plan would give if the loops followed it exactly, to judge it before it is run.

    Parameters
    ----------
    plan : Plan
        The plan.
    bench : Bench
        Gives the noise, the state of the air and the time constant of the heated coils.
    """
    h, noise = bench.sample_period, bench.value
    powers = np.arange(DEGREE + 1)
    rows: list[dict[str, Any]] = []
    warm = 0.0
    for s in plan.segments:
        # the coils follow the heater within a second and cool with their own time constant
        cooling = noise("coil_thermal_resistance") * noise("coil_heat_capacity")
        warm = s.environment.preheat or warm * math.exp(-(s.ramp + s.hold) / cooling)
        changed = abs(s.spin - s.spin_from) > SPEED_CHANGE
        settling = SPIN_SETTLING if changed else SETTLING
        if changed and s.cone_rate:
            settling += CONE_SETTLING
        length = s.hold - settling
        longest = LONGEST if s.cone_rate == 0.0 else cone_window(abs(s.cone_rate), s.spin)
        count = window_count(length, longest, cone=bool(s.cone_rate))
        duration = length / count
        if duration < SHORTEST or duration * s.spin < FEWEST_REVOLUTIONS * 2.0 * math.pi:
            continue
        slope = (s.spin_end - s.spin) / s.hold
        for k in range(count):
            middle = settling + (k + 0.5) * duration
            turn = 1j * s.cone_rate * 0.5 * duration
            series = np.array([turn**n / math.factorial(n) for n in powers])
            spin = np.zeros(DEGREE)
            spin[:2] = s.spin + slope * middle, slope * 0.5 * duration
            samples = duration / h
            rows.append(
                {
                    "start": s.start + s.ramp + middle - 0.5 * duration,
                    "duration": duration,
                    "samples": samples,
                    "segment": -1,
                    "tilt": s.tilt * np.exp(1j * s.cone_rate * middle) * series,
                    "tilt_harmonics": np.zeros((len(HARMONICS), MODULATION), dtype=complex),
                    "spin": spin,
                    "current_harmonics": np.zeros((len(HARMONICS), MODULATION), dtype=complex),
                    "coil_voltage": 0.0j,
                    "motor_voltage": 0.0,
                    "motor_current": 0.0,
                    "coil_temperature": noise("air_temperature") + warm,
                    "coil_temperature_rate": 0.0,
                    "air_temperature": noise("air_temperature"),
                    "air_pressure": noise("air_pressure") * s.environment.air_density_ratio,
                    "motor_temperatures": np.full(2, noise("air_temperature")),
                    "motor_temperature_rates": np.zeros(2),
                    "temperature_sensitivity": np.zeros((2, len(MOTOR_THERMAL))),
                    "coil_harmonics": np.zeros(len(FORWARD), dtype=complex),
                    "angle_harmonics": np.zeros(len(FORWARD), dtype=complex),
                    "harmonic_variance": np.ones(len(FORWARD)),
                    "hum_variance": np.zeros((2, len(FORWARD))),
                    "spin_ripple": 0.0j,
                    "current_ripple": 0.0j,
                    "voltage_ripple": 0.0j,
                    **attitude(s.environment),
                    # variance at the ends of a polynomial of this degree: see `fit_window`
                    "tilt_rate_variance": 2.0
                    * (DEGREE + 1) ** 2
                    / samples
                    * (noise("tilt_noise") / duration) ** 2,
                    "spin_acceleration_variance": 2.0
                    * spin_terms(duration) ** 5
                    / samples
                    * (noise("spin_angle_noise") / duration**2) ** 2,
                    "reading_noise": np.array([noise(name) for name in READING_NOISES]),
                }
            )
    return Windows.of(rows)
