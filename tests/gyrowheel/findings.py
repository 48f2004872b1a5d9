"""Diagnoses, and judged cases of a campaign, made up for tests of what is done with them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gyrowheel.campaigns.judge import Judged
from gyrowheel_analysis.diagnosis.correction_map import CorrectionMap
from gyrowheel_analysis.diagnosis.estimates import DetectionLimit, Estimate, NuisanceEstimate
from gyrowheel_analysis.diagnosis.findings import (
    EffectFinding,
    FreeForm,
    InstrumentFinding,
    NextTest,
    TieReport,
)
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.residuals.error_table import ErrorRow, ErrorTable, Residuals
from gyrowheel_analysis.residuals.growth import Growth
from gyrowheel_analysis.residuals.maps import Look, Region
from gyrowheel_core.units import RPM
from gyrowheel_sim.effects import get
from gyrowheel_sim.effects.torque_map import MapRange, MapTerm, torque_map

WINDAGE = {"w": 1.0e-3, "n": 1.5}


def row(size: float) -> ErrorRow:
    """Return a row of errors of some size [N·m]."""
    return ErrorRow({"tilt_x": size, "tilt_y": 0.9 * size, "spin": 0.1 * size}, (size / 2e-5) ** 2)


TABLE = ErrorTable(row(4e-4), row(2.1e-5), row(2e-5), row(3e-4), row(2.4e-5), row(2e-5))


def residuals(name: str = "drag", role: str = "fit", count: int = 12) -> Residuals:
    """Return residuals that fall to the noise."""
    rng = np.random.default_rng(count)
    time = np.linspace(1.0, 30.0, count)
    noise = np.full(count, 2e-5)
    tilt = 0.03 * np.exp(1j * rng.uniform(0.0, 6.0, count))
    channels = {
        channel: (20.0 * noise * rng.normal(size=count), noise * rng.normal(size=count), noise)
        for channel in ("tilt_x", "tilt_y", "spin")
    }
    return Residuals(name, role, time, np.repeat([366.5, 157.0], count // 2), tilt, channels)


def finding(name: str, *ties: TieReport, size: float = 1.0) -> EffectFinding:
    """Return a finding of a registered effect of its usual size."""
    effect = get(name)
    coefficients = {c.name: Estimate(size * c.default, 0.01 * c.default, c.unit) for c in effect.coefficients}
    law = Growth("tilt", "tilt", 0.022j, uniform=True)
    return EffectFinding(
        name, effect.title, effect.sentence, coefficients, 321.0, effect.formula, (law,), (), ties
    )


def delay_finding(*ties: TieReport) -> InstrumentFinding:
    """Return the finding of a delay of the coil voltages."""
    return InstrumentFinding("coil_voltage_delay", "coil_voltage", "delay", -2e-4, 2e-5, 0.0, "s", 74.0, ties)


def tie(name: str, plan: str | None = "air_density") -> TieReport:
    """Return a tie with a registered effect."""
    return TieReport(
        name, get(name).title, 3.2, plan, None if plan is None else 88.0, None if plan is None else 1.2
    )


def limit(name: str, value: float) -> tuple[DetectionLimit, ...]:
    """Return the same detection limit for every amplitude of an effect."""
    effect = get(name)
    return tuple(
        DetectionLimit(name, effect.title, c.name, value, c.unit, c.usual) for c in effect.amplitudes
    )


def diagnosis(verdict: str, *findings: EffectFinding, **changes: Any) -> Diagnosis:
    """Return a diagnosis."""
    result = Diagnosis(
        verdict=verdict,  # type: ignore[arg-type]
        windows=40,
        effects=findings,
        error=TABLE,
        where=(Region("tilt", 3500 * RPM, (), 0.8, Look("mixed", 4e-4, 2e-5)),),
        nuisance={
            "coil_constant": NuisanceEstimate(0.0206, 5e-5, 0.02, 4e-4, "N*m/V"),
            "motor_constant": NuisanceEstimate(0.03, 1e-4, 0.03, 3e-4, "N*m/A"),
        },
        limits=(
            *limit("gravity_offset", 0.011),
            *limit("windage", 1e-4),
            *limit("tilt_bias", float("inf")),
        ),
        residuals=(residuals(), residuals("other", "validation", 8)),
        recordings=("drag",),
        model="model.yaml",
        seconds=1.0,
    )
    return replace(result, **changes)


UNKNOWN = diagnosis(
    "unknown",
    free_form=(
        FreeForm(
            "rotor_torque = a*z^2",
            99.0,
            {"a": Estimate(1e-3, 1e-5, "N*m")},
            "It grows with the tilt squared.",
        ),
    ),
)
#: A map with a slope in the tilt on the rotor, and a constant and a slope in the speed on the shaft.
MAP = CorrectionMap(
    torque_map(
        "map",
        [
            MapTerm("rotor_torque", 1, 0, 0, 0),
            MapTerm("shaft_torque", 0, 0, 0, 0),
            MapTerm("shaft_torque", 0, 0, 0, 1),
        ],
        MapRange((150.0, 370.0), 0.054, (293.0, 303.0), (293.0, 303.0)),
        modes=[(1e-5, 0.0, 0.0, 0.0), (0.0, 2e-5, 0.0, 0.0), (0.0, 0.0, 3e-6, 4e-6)],
    ),
    values={"x100_00": 3e-4, "y100_00": -4e-4, "c000_00": 1e-4, "c000_10": -5e-5},
    errors={"x100_00": 1e-5, "y100_00": 2e-5, "c000_00": 3e-6, "c000_10": 4e-6},
    effects={},
    gain=300.0,
    orthogonal=True,
    dependence=(),
    leading=(),
    nearest="",
    nearest_share=0.0,
    error=TABLE,
)
AMBIGUOUS = diagnosis(
    "ambiguous",
    finding("aero_cross", tie("flexure_damping")),
    next_test=NextTest("air_density", 88.0, 1.2, separates=("aero_cross", "flexure_damping")),
)


def judged_case(index: int, kind: str = "single", outcome: Any = "exact", **changes: Any) -> Judged:
    """Return a case of a campaign as it was judged."""
    truth = {} if kind == "none" else {"windage": WINDAGE}
    named = ["windage"] if outcome == "exact" and truth else []
    verdict = "effect" if named else "nothing_missing"
    base = Judged(
        index, kind, truth, dict.fromkeys(truth, 3.0), True, verdict, named, [], outcome, seconds=2.0
    )
    return replace(base, **changes)
