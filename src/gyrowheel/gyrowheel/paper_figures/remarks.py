"""Fig. 13 and the remarks: what the experiment rests on."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from gyrowheel.calibration.api import calibrate
from gyrowheel.models.api import Model
from gyrowheel.paper_figures.evidence import REFERENCE, SPEEDS, TILT, Evidence, Statement, air_part
from gyrowheel.paper_figures.result import Finding
from gyrowheel.recordings.picture import recording_figure
from gyrowheel.torque_budget.api import torques
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.effects import get

_MILLI = 1e3
_CLEAR = 3.0  # standard errors within which a calibrated constant must be


def _needed(e: Evidence) -> Finding:
    found = e.parts_by_speed
    coils, _ = air_part(found)
    place = SPEEDS.index(REFERENCE)
    share = abs(complex(coils[place])) / abs(complex(found.coil[place]))
    return Finding(
        "agree" if share > 0.1 else "disagree",
        f"At 3° and 3500 rpm the air has {_MILLI * abs(complex(coils[place])):.2f} mN·m, {share:.1f} times what the "
        "coils hold in all.",
        "Near the tuned speed springs and gimbal cancel, and the air is the largest part.",
        {"air_n_m": abs(complex(coils[place])), "air_over_all": share},
    )


def _platform(e: Evidence) -> Finding:
    bench, found = e.bench, e.parts_by_speed
    motor, coils = float(found.motor_margin.min()), float(found.coil_margin.min())
    plans = [Plan.load(name) for name in ("paper_tilt", "paper_speed")]
    tilt = max(abs(s.tilt) for plan in plans for s in plan.segments)
    fastest = bench.precession_inertia / bench.value("rotor_inertia_x") * float(SPEEDS[-1])
    samples = 2.0 * math.pi / fastest / bench.sample_period
    return Finding(
        "agree" if min(motor, coils) > 0.0 and samples > 2.0 else "disagree",
        f"Tilts to {tilt / DEG:.0f}° and speeds to {SPEEDS[-1] / RPM:.0f} rpm leave {100.0 * motor:.0f} % of the 28 "
        f"V to the motor and {100.0 * coils:.0f} % to the coils; the nutation has {samples:.0f} samples a period.",
        "The test can be run with the stated supply and sampling. Constants of coils and motor are assumed. Our "
        "bench has a spin loop of either kind, proportional-integral or phase-locked.",
        {"motor_margin": motor, "coil_margin": coils, "samples_per_nutation": samples},
        lambda: recording_figure(e.speeds.data),
    )


def _constant(e: Evidence) -> Finding:
    constant = calibrate(e.cone, e.model).constants["coil_constant"].after
    bench, true = e.bench, e.other_machine["coil_constant"]
    relative = constant.standard_error / constant.value
    off = abs(constant.value - true) / constant.standard_error
    slew = bench.precession_inertia * REFERENCE * DEG
    return Finding(
        "disagree" if relative < 0.01 and off < _CLEAR else "agree",
        f"A slow cone gives {_MILLI * constant.value:.3f} ± {_MILLI * constant.standard_error:.3f} mN·m/V "
        f"({100.0 * relative:.2f} %) on a machine that has {_MILLI * true:.3f}; stated are 20 ± 0.4.",
        f"Turning the tilt takes a torque known from Irz and Ω alone, {_MILLI * slew:.1f} mN·m for each °/s at 3500 "
        "rpm. It calibrates the coils in place, whatever springs and air do. What varies with tilt or heat is an "
        "effect to be found.",
        {
            "coil_constant_n_m_per_v": constant.value,
            "standard_error_n_m_per_v": constant.standard_error,
            "true_n_m_per_v": true,
        },
    )


def _beats(e: Evidence) -> Finding:
    b = e.bench
    nutation = (
        b.precession_inertia / (b.value("rotor_inertia_x") + 0.5 * b.value("gimbal_inertia_x")) * REFERENCE
    )
    beat = 2.0 * REFERENCE - nutation
    hertz = [value / (2.0 * math.pi) for value in (REFERENCE, 2.0 * REFERENCE, nutation, beat)]
    return Finding(
        "agree",
        f"At 3500 rpm: {hertz[0]:.1f} and {hertz[1]:.1f} Hz once and twice a revolution, nutation at {hertz[2]:.1f} "
        f"Hz, and a beat at {abs(hertz[3]):.1f} Hz, which an uneven rotor makes.",
        "All of them are torques that average to nothing, but for two rectified ones of 0.01 mN·m.",
        {"nutation_hz": hertz[2], "beat_hz": abs(hertz[3])},
    )


def _uneven(e: Evidence) -> Finding:
    values = get("inertia_anisotropy").defaults()
    bare = Model()
    uneven = Model.of(replace(bare.details, effects={"inertia_anisotropy": values}))

    def asymmetry(model: Model) -> float:
        """Return by how much the coils' torque differs between a tilt about x and one about y [N m]."""
        about: list[Any] = [
            torques(model=model, tilt=TILT, azimuth=azimuth, spin_rate=REFERENCE).coil[0]
            for azimuth in (0.0, 0.5 * math.pi)
        ]
        return abs(complex(about[0] + 1j * about[1]))

    without, found = asymmetry(bare), asymmetry(uneven)
    ripple = values["d"] * REFERENCE**2 * math.tan(TILT)
    return Finding(
        "disagree" if found - without < 0.01 * ripple else "agree",
        f"Moments of inertia that differ by {1e6 * values['d']:.3g} mg·m² give a torque of the order of "
        f"{_MILLI * ripple:.2f} mN·m twice a revolution, and make averaged voltages of both axes differ by "
        f"less than {max(0.001, 1e6 * abs(found - without)):.2g} µN·m.",
        "The rotor turns, so that its unevenness averages out over a revolution. What differs between the axes of "
        "the case must stand in the case: coils, sensors, their alignment.",
        {"ripple_n_m": ripple, "asymmetry_n_m": found - without},
    )


#: What comes before the voltages, and what is said about them.
SETUP = (
    Statement(
        "overlooked", "Section 2.2", "On the ground, the air's torque must not be overlooked.", _needed
    ),
    Statement(
        "fig-13",
        "Fig. 13",
        "A platform with a 28 V supply, 0.5 ms sampling and a phase-locked spin loop runs tilts to 3° and 1000 "
        "to 4000 rpm.",
        _platform,
    ),
)
REMARKS = (
    Statement(
        "coil-constant",
        "Section 4",
        "Voltages cannot be converted to torques: the coils' constant is unknown and varies.",
        _constant,
    ),
    Statement(
        "remark-1",
        "Remark 1",
        "Vibrations at multiples of the spin rate and at beat frequencies accompany the motion.",
        _beats,
    ),
    Statement(
        "remark-2",
        "Remark 2",
        "An uneven rotor explains that the voltages of Figs 14 and 16 are not symmetric.",
        _uneven,
    ),
)
