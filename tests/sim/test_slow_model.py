"""The slow equation of the tilt in the case: where its coefficients come from, and how far it holds."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.mechanics import derivation as d

from .helpers import BENCH, INERTIAS, TUNING_INERTIA, perfect_hold

v = BENCH.value
STIFFNESS = v("flexure_stiffness_x")
#: How fast the stiffness falls with tilt and speed [kg m^2]: reaction of the shaft, and a small part of the gimbal.
SHAFT_REACTION = 0.25 / (1.0 / v("shaft_inertia") + 1.0 / v("rotor_inertia_z"))
GIMBAL_REACTION = 1.3e-6


@pytest.mark.slow
def test_coefficients_by_averaging_the_equations_of_motion():
    slow = d.average()
    (Irx, _, Irz), (Igx, Igy, Igz) = d.ROTOR_INERTIA, d.GIMBAL_INERTIA
    assert sp.expand(slow.inertia - (Irx + Igx / 2)) == 0
    assert sp.expand(slow.momentum - (Irz + Igx) * d.SPIN_RATE) == 0
    tuning = Igx + Igy - Igz
    assert sp.expand(slow.stiffness - (sum(d.STIFFNESS) - tuning * d.SPIN_RATE**2) / 2) == 0
    assert sp.expand(slow.damping - sum(d.DAMPING) / 2) == 0


@pytest.mark.parametrize("rpm", [1000, 2000, 3500, 4000])
@pytest.mark.parametrize("tilt_deg", [1.0, 3.0, 5.0])
def test_holding_torque(tilt_deg, rpm):
    """K (1 - |z|^2/4) - A Omega^2/2 - c3 Omega^2 |z|^2 in phase, -C Omega across: good to the fifth order of the tilt.

    That is 0.0008 mN m at 3 deg and 0.011 mN m at 5 deg.
    """
    z, spin = np.tan(tilt_deg * DEG), rpm * RPM
    stiffness = STIFFNESS * (1.0 - z**2 / 4.0) - 0.5 * TUNING_INERTIA * spin**2
    reaction = (SHAFT_REACTION + GIMBAL_REACTION) * spin**2 * z**2
    needed = perfect_hold(tilt_deg, rpm).coil_harmonic(0)
    expected = complex(stiffness - reaction, -v("flexure_damping_x") * spin) * z
    assert abs(needed - expected) < 2.5 * z**5


def test_reaction_of_the_shaft():
    """c3 is 2.50e-5 kg m^2: a quarter of shaft and rotor in series, and 1.3e-6 of the gimbal."""
    z, spin = np.tan(1.0 * DEG), 3500.0 * RPM
    needed = perfect_hold(1.0, 3500.0).coil_harmonic(0).real / z
    found = (STIFFNESS * (1.0 - z**2 / 4.0) - 0.5 * TUNING_INERTIA * spin**2 - needed) / (spin * z) ** 2
    assert found == pytest.approx(2.50e-5, abs=0.005e-5)
    assert found == pytest.approx(SHAFT_REACTION + GIMBAL_REACTION, abs=0.005e-5)


@pytest.mark.parametrize("cone_rate", [-0.5, 0.5, 3.0])
def test_slewing_torque(cone_rate):
    """Turning a tilt on a cone needs (I_rz + I_gx) Omega times its rate: 11.4 mN m per deg/s at 3500 rpm."""
    z = np.tan(1.0 * DEG)
    momentum = (INERTIAS[2] + INERTIAS[3]) * 3500.0 * RPM
    moving, still = (perfect_hold(1.0, 3500.0, rate).coil_harmonic(0) for rate in (cone_rate, 0.0))
    inertia = INERTIAS[0] + 0.5 * INERTIAS[3]
    expected = (momentum * cone_rate - inertia * cone_rate**2) * z
    assert (moving - still).real == pytest.approx(expected, rel=2e-4)
    assert momentum * DEG == pytest.approx(11.4e-3, abs=0.05e-3)
