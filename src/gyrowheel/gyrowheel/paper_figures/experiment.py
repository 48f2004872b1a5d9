"""Figs 13 to 17 and the remarks: the experiment, its voltages and their causes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.calibration.api import calibrate
from gyrowheel.models.api import Model
from gyrowheel.paper_figures.evidence import (
    REFERENCE,
    SPEEDS,
    TILT,
    Evidence,
    Finding,
    Statements,
    air_part,
    part,
)
from gyrowheel.recordings.picture import recording_figure
from gyrowheel.show.figure import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION, Curve, Panel, curves_figure
from gyrowheel.torque_budget.api import torques
from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.effects import get

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
_MILLI = 1e3
_CLEAR = 3.0  # standard errors beyond which a voltage has changed, and within which a constant is right
_SMALL = 0.05  # a share of the air below this is no air

STATEMENTS = Statements()


@STATEMENTS("overlooked", "Section 2.2", "On the ground, the air's torque must not be overlooked.")
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


@STATEMENTS(
    "fig-13",
    "Fig. 13",
    "A platform with a 28 V supply, 0.5 ms sampling and a phase-locked spin loop runs tilts to 3° and 1000 to 4000 "
    "rpm.",
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


def _increments(holds: Sequence[Estimate], place: int) -> tuple[Array, Array, Array]:
    """Return measured increments of a voltage, their standard errors, and the predicted ones [V]."""
    return (
        np.array([own.voltage_increment[place] for own in holds]),
        np.array([own.voltage_increment_std[place] for own in holds]),
        np.array([own.simulated_voltage_increment[place] for own in holds]),
    )


def _tilting(e: Evidence) -> Sequence[Estimate]:
    """Return the holds of the sweep of the tilt from 0 to 3 deg."""
    return e.holds(e.tilts, air=True)[:7]


def _panel(
    title: str, x_label: str, place: int, holds: tuple[Sequence[Estimate], Sequence[Estimate]]
) -> Panel:
    """Return increments of a voltage, measured and by the model; `holds` are the estimates with and without air."""
    with_air, without = holds
    x = [own.spin_rate / RPM if "rpm" in x_label else own.tilt_x / DEG for own in with_air]
    measured, error, model = _increments(with_air, place)
    bare = _increments(without, place)[2]
    curves = [
        Curve("measured", x, _MILLI * measured, INK, _MILLI * error, line="", marker="o"),
        Curve("model with air", x, _MILLI * model, BLUE),
        Curve("model without air", x, _MILLI * bare, VERMILION, line="--"),
    ]
    return Panel(title, x_label, "change of voltage from 0°, mV", curves)


def _picture(title: str, panels: Sequence[Panel]) -> Figure:
    return curves_figure(title, "simulated bench with the computed air; bars: standard errors", panels)


def _tilt_panel(e: Evidence, place: int, title: str) -> Panel:
    # the first hold is the reference; later holds at 0 deg are further references
    every = e.holds(e.tilts, air=True)
    shown = [k for k, own in enumerate(every) if k == 0 or abs(own.tilt_x) > 0.1 * DEG]
    shown.sort(key=lambda k: every[k].tilt_x)
    with_air, without = ([e.holds(e.tilts, air=air)[k] for k in shown] for air in (True, False))
    return _panel(title, "tilt about x, deg", place, (with_air, without))


@STATEMENTS(
    "fig-14",
    "Fig. 14",
    "Tilting about one axis changes the voltages of both coils, the more the larger the tilt.",
)
def _fig_14(e: Evidence) -> Finding:
    holds = _tilting(e)
    sizes, errors = zip(*(_increments(holds, place)[:2] for place in (0, 1)), strict=True)
    both = all(abs(size[-1]) > _CLEAR * error[-1] for size, error in zip(sizes, errors, strict=True))
    rising = all(
        bool(np.all(np.diff(np.abs(size)) > -_CLEAR * np.hypot(error[1:], error[:-1])))
        for size, error in zip(sizes, errors, strict=True)
    )
    text = " and ".join(
        f"{_MILLI * size[-1]:+.1f} ± {_MILLI * error[-1]:.1f} mV"
        for size, error in zip(sizes, errors, strict=True)
    )
    return Finding(
        "agree" if both and rising else "disagree",
        f"From 0 to 3° the coils change by {text}, at no step back beyond its error.",
        "On a recording of the same plan, simulated with the computed air in the machine.",
        {"coil_x_v": float(sizes[0][-1]), "coil_y_v": float(sizes[1][-1])},
        lambda: _picture(
            "Voltages of the coils over the tilt, 3500 rpm",
            [_tilt_panel(e, 0, "coil x"), _tilt_panel(e, 1, "coil y")],
        ),
    )


def _spring_error(e: Evidence) -> float:
    """Return the stated uncertainty of the torque of the springs along the tilt [N m]."""
    parameters = e.bench.parameters
    both = (parameters[f"flexure_stiffness_{axis}"].uncertainty for axis in "xy")
    return 0.5 * math.tan(TILT) * math.hypot(*both)


def _gimbal_error(e: Evidence, spin_rate: float) -> float:
    """Return the stated uncertainty of the torque of the gimbal along the tilt [N m]."""
    relative = e.bench.parameters["gimbal_inertia_x"].relative_uncertainty
    return math.tan(TILT) * relative * 0.5 * e.bench.tuning_inertia * spin_rate**2


@STATEMENTS("fig-14-cause", "Fig. 14", "These voltage increments reflect the transverse torques of the air.")
def _fig_14_cause(e: Evidence) -> Finding:
    found = e.parts_by_tilt
    whole, (coils, _) = found.coil, air_part(found)
    along, air = float(whole[-1].real), float(coils[-1].real)
    unknown = math.hypot(_spring_error(e), _gimbal_error(e, REFERENCE))
    across, air_across = float(whole[-1].imag), float(coils[-1].imag)
    return Finding(
        "cannot be decided" if unknown > 0.3 * air else "agree",
        f"At 3° the coils hold {_MILLI * along:.2f} mN·m along the tilt: air {_MILLI * air:+.2f}, all else "
        f"{_MILLI * (along - air):+.2f}. Across: {_MILLI * across:.2f}, of it air {_MILLI * air_across:.2f}.",
        f"Springs of 2 % and a gimbal of 10 % uncertainty leave ± {_MILLI * unknown:.2f} mN·m along the tilt "
        f"unknown, {100.0 * unknown / air:.0f} % of the air. A spring gives the same voltages. Another density of "
        "the air would decide.",
        {
            "along_n_m": along,
            "air_along_n_m": air,
            "unknown_along_n_m": unknown,
            "across_n_m": across,
            "air_across_n_m": air_across,
        },
        lambda: found.plot(),
    )


@STATEMENTS(
    "fig-15",
    "Fig. 15",
    "The motor's voltage does not depend on the tilt, hence the torque on the spin does not.",
)
def _fig_15(e: Evidence) -> Finding:
    measured, error, _ = _increments(_tilting(e), 2)
    b = e.bench
    row, upright = e.table.at(TILT, REFERENCE), e.table.at(0.0, REFERENCE)
    assert row is not None
    assert upright is not None
    change = float(upright.torque.mean[2] - row.torque.mean[2])
    volts = change * b.value("motor_resistance") / b.value("motor_constant")
    level = float(_tilting(e)[0].dc_voltage[2])
    seen = abs(measured[-1]) > _CLEAR * error[-1]
    return Finding(
        "cannot be decided" if abs(volts) > error[-1] else "agree",
        f"From 0 to 3° the motor's voltage changes by {_MILLI * measured[-1]:+.1f} ± {_MILLI * error[-1]:.1f} mV of "
        f"{level:.2f} V, {'beyond' if seen else 'within'} {_CLEAR:g} standard errors.",
        f"The computed T3 falls by {_MILLI * abs(change):.3f} mN·m, worth {_MILLI * abs(volts):.1f} mV or "
        f"{100.0 * abs(volts) / level:.2f} % of the voltage. In a figure that shows volts, a T3 that falls and one "
        "that does not look alike.",
        {"measured_v": float(measured[-1]), "standard_error_v": float(error[-1]), "expected_v": volts},
        lambda: _picture("Voltage of the motor over the tilt, 3500 rpm", [_tilt_panel(e, 2, "motor")]),
    )


def _tilted(e: Evidence, *, air: bool) -> list[Estimate]:
    """Return the holds at 3 deg of the sweep of the speed."""
    return [own for own in e.holds(e.speeds, air=air) if abs(own.tilt_x) > 0.5 * TILT]


def _speed_panel(e: Evidence, place: int, title: str) -> Panel:
    return _panel(title, "spin rate, rpm", place, (_tilted(e, air=True), _tilted(e, air=False)))


@STATEMENTS("fig-16", "Fig. 16", "At 3°, the increments of both coils grow with the speed.")
def _fig_16(e: Evidence) -> Finding:
    holds = _tilted(e, air=True)
    ends, grows = [], []
    for place in (0, 1):
        size, error, _ = _increments(holds, place)
        change = np.abs(size - size[0])
        ends.append((float(size[-1] - size[0]), float(math.hypot(error[-1], error[0]))))
        grows.append(bool(np.all(np.diff(change) > -_CLEAR * np.hypot(error[1:], error[:-1]))))
    text = " and ".join(f"{_MILLI * end:+.1f} ± {_MILLI * error:.1f} mV" for end, error in ends)
    return Finding(
        "agree" if all(grows) else "disagree",
        f"From 1000 to 4000 rpm at 3° the coils change by {text}, more at every step.",
        "Each from the hold at 0° and the same speed. The voltage itself falls and changes its sign on this bench; "
        "what grows is its distance from that at 1000 rpm.",
        {"coil_x_v": ends[0][0], "coil_y_v": ends[1][0]},
        lambda: _picture(
            "Voltages of the coils over the speed, 3°",
            [_speed_panel(e, 0, "coil x"), _speed_panel(e, 1, "coil y")],
        ),
    )


@STATEMENTS("fig-16-cause", "Fig. 16 (a)", "The increment along the tilt reflects the torque of the air.")
def _fig_16_cause(e: Evidence) -> Finding:
    found = e.parts_by_speed
    whole, (coils, _) = found.coil, air_part(found)
    change = float((whole[-1] - whole[0]).real)
    air = float((coils[-1] - coils[0]).real)
    gimbal, ripple = (
        float((own[-1] - own[0]).real) for own in (part(found, "gimbal_inertia"), part(found, "joint_ripple"))
    )
    volts = change / e.bench.value("coil_constant")
    other = change - air
    unknown = _gimbal_error(e, SPEEDS[-1]) - _gimbal_error(e, SPEEDS[0])

    def draw() -> Figure:
        rpm = [rate / RPM for rate in SPEEDS]
        rows = (
            ("gimbal", part(found, "gimbal_inertia"), VERMILION, "s"),
            ("joint ripple", part(found, "joint_ripple"), ORANGE, "v"),
            ("air", coils, BLUE, "o"),
            ("springs", part(found, "flexure_stiffness"), GREEN, "^"),
        )
        curves = [
            Curve(name, rpm, _MILLI * (own - own[0]).real, colour, marker=marker)
            for name, own, colour, marker in rows
        ]
        curves.append(Curve("all", rpm, _MILLI * (whole - whole[0]).real, INK, line="--"))
        return curves_figure(
            "Parts of the change of the voltage in Fig. 16",
            "torque of the coils along a tilt of 3°, change from 1000 rpm, on the bench as stated",
            [Panel("", "spin rate, rpm", "change of torque, mN·m", curves)],
        )

    return Finding(
        "disagree" if abs(air) < 0.5 * abs(other) else "agree",
        f"From 1000 to 4000 rpm {_MILLI * change:+.2f} mN·m, {volts:+.3f} V: gimbal {_MILLI * gimbal:+.2f}, joint "
        f"ripple {_MILLI * ripple:+.2f}, air {_MILLI * air:+.2f}.",
        f"Along the tilt, what is not air makes {100.0 * other / change:.0f} % of the increment; the air acts "
        f"against it and cancels {100.0 * abs(air / other):.0f} %. The gimbal's part alone is uncertain by ± "
        f"{_MILLI * unknown:.2f} mN·m. For any wheel tuned at Ω₀ that part is K z (Ω/Ω₀)²: the curve comes without "
        "air.",
        {
            "change_n_m": change,
            "change_v": volts,
            "gimbal_n_m": gimbal,
            "joint_ripple_n_m": ripple,
            "air_n_m": air,
            "share_not_air": other / change,
        },
        draw,
    )


@STATEMENTS("fig-16-across", "Fig. 16 (b)", "The increment across the tilt reflects the torque of the air.")
def _fig_16_across(e: Evidence) -> Finding:
    found = e.parts_by_speed
    whole, (coils, _) = found.coil, air_part(found)
    change, air = float((whole[-1] - whole[0]).imag), float((coils[-1] - coils[0]).imag)
    share = air / change
    return Finding(
        "agree" if 0.8 < share < 1.2 else "disagree",
        f"From 1000 to 4000 rpm {_MILLI * change:+.3f} mN·m across the tilt, of it air {_MILLI * air:+.3f}, "
        f"{100.0 * share:.0f} %.",
        "Across the tilt springs and gimbal have no part; what is left is the loss of the flexures. This voltage "
        "does show the air, if the loss is small and the spin loop lets nothing through at twice the spin rate.",
        {"change_n_m": change, "air_n_m": air, "share": share},
        lambda: found.plot(),
    )


@STATEMENTS("fig-17", "Fig. 17", "At 3°, the increment of the motor's voltage grows with the speed.")
def _fig_17(e: Evidence) -> Finding:
    holds = _tilted(e, air=True)
    volts = np.array([own.dc_voltage[2] for own in holds])
    change = float(volts[-1] - volts[0])
    return Finding(
        "agree" if bool(np.all(np.diff(volts) > 0.0)) else "disagree",
        f"From 1000 to 4000 rpm at 3° the motor's voltage rises from {volts[0]:.2f} to {volts[-1]:.2f} V.",
        f"It rises at every step, by {change:.2f} V in all.",
        {"change_v": change},
        lambda: _motor_picture(e),
    )


def _motor_picture(e: Evidence) -> Figure:
    found, b = e.parts_by_speed, e.bench
    rpm = [rate / RPM for rate in SPEEDS]
    back = b.value("motor_constant") * np.array(SPEEDS)
    factor = b.value("motor_resistance") / b.value("motor_constant")
    _, motor = air_part(found)
    measured = [own.dc_voltage[2] for own in _tilted(e, air=True)]
    left = [
        Curve("measured", rpm, measured, INK, line="", marker="o"),
        Curve("back-EMF alone", rpm, back, VERMILION, line="--"),
    ]
    right = [
        Curve("air", rpm, _MILLI * factor * motor, BLUE, marker="o"),
        Curve("bearing", rpm, _MILLI * factor * (found.motor - motor), SOFT, marker="s"),
    ]
    return curves_figure(
        "Voltage of the motor over the speed, 3°",
        "nearly all of it is back-EMF; right, what torques add to it",
        [
            Panel("all", "spin rate, rpm", "voltage, V", left),
            Panel("torques", "spin rate, rpm", "voltage, mV", right),
        ],
    )


@STATEMENTS("fig-17-cause", "Fig. 17", "That increment reflects the air's torque on the spin.")
def _fig_17_cause(e: Evidence) -> Finding:
    found, b = e.parts_by_speed, e.bench
    _, motor = air_part(found)
    whole = float(found.motor_voltage[-1] - found.motor_voltage[0])
    back = b.value("motor_constant") * (SPEEDS[-1] - SPEEDS[0])
    air = float(motor[-1] - motor[0]) * b.value("motor_resistance") / b.value("motor_constant")
    known = b.parameters["motor_constant"].relative_uncertainty * back
    return Finding(
        "disagree" if air < _SMALL * whole else "agree",
        f"Of {whole:.2f} V, {back:.2f} V are back-EMF ({100.0 * back / whole:.1f} %), {air:.3f} V air "
        f"({100.0 * air / whole:.2f} %).",
        f"The voltage of a motor follows its speed. A motor constant known to 1 % leaves ± {known:.3f} V unknown, "
        f"{known / air:.1f} times the air's part. The motor's current shows the torque; the paper gives none.",
        {"change_v": whole, "back_emf_v": back, "air_v": air, "unknown_v": known},
        lambda: _motor_picture(e),
    )


@STATEMENTS(
    "coil-constant",
    "Section 4",
    "Voltages cannot be converted to torques: the coils' constant is unknown and varies.",
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


@STATEMENTS(
    "remark-1",
    "Remark 1",
    "Vibrations at multiples of the spin rate and at beat frequencies accompany the motion.",
)
def _beats(e: Evidence) -> Finding:
    b = e.bench
    nutation = b.precession_inertia / b.transverse_inertia * REFERENCE
    beat = 2.0 * REFERENCE - nutation
    hertz = [value / (2.0 * math.pi) for value in (REFERENCE, 2.0 * REFERENCE, nutation, beat)]
    return Finding(
        "agree",
        f"At 3500 rpm: {hertz[0]:.1f} and {hertz[1]:.1f} Hz once and twice a revolution, nutation at {hertz[2]:.1f} "
        f"Hz, and a beat at {abs(hertz[3]):.1f} Hz, which an uneven rotor makes.",
        "All of them are torques that average to nothing, but for two rectified ones of 0.01 mN·m.",
        {"nutation_hz": hertz[2], "beat_hz": abs(hertz[3])},
    )


@STATEMENTS(
    "remark-2", "Remark 2", "An uneven rotor explains that the voltages of Figs 14 and 16 are not symmetric."
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
