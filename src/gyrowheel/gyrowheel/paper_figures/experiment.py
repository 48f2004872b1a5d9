"""Figs 14 to 17: the measured voltages, and what they are made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrowheel.paper_figures.curves import Curve, Panel, curves_figure
from gyrowheel.paper_figures.evidence import REFERENCE, SPEEDS, TILT, Evidence, Statement, air_part, part
from gyrowheel.paper_figures.result import Finding
from gyrowheel.show.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION
from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
_MILLI = 1e3
_CLEAR = 3.0  # standard errors beyond which a voltage has changed
_SMALL = 0.05  # a share of the air below this is no air


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


def _tilt_panel(e: Evidence, place: int, title: str) -> Panel:
    # the first hold is the reference; the later ones at 0 deg are references of their own
    shown = [k for k, own in enumerate(e.holds(e.tilts, air=True)) if k == 0 or abs(own.tilt_x) > 0.1 * DEG]
    shown.sort(key=lambda k: e.holds(e.tilts, air=True)[k].tilt_x)
    with_air, without = ([e.holds(e.tilts, air=air)[k] for k in shown] for air in (True, False))
    x = [own.tilt_x / DEG for own in with_air]
    measured, error, model = _increments(with_air, place)
    bare = _increments(without, place)[2]
    return Panel(
        title,
        "tilt about x, deg",
        "change of voltage from 0°, mV",
        [
            Curve("measured", x, _MILLI * measured, INK, _MILLI * error, line="", marker="o"),
            Curve("model with air", x, _MILLI * model, BLUE),
            Curve("model without air", x, _MILLI * bare, VERMILION, line="--"),
        ],
    )


def _fig_14_picture(e: Evidence) -> Figure:
    panels = [_tilt_panel(e, 0, "coil x"), _tilt_panel(e, 1, "coil y")]
    return curves_figure(
        "Voltages of the coils over the tilt, 3500 rpm",
        "simulated bench with the computed air; bars: standard errors",
        panels,
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
        lambda: _fig_14_picture(e),
    )


def _spring_error(e: Evidence) -> float:
    """Return how well the torque of the springs along the tilt is known, by what the bench states [N m]."""
    parameters = e.bench.parameters
    both = (parameters[f"flexure_stiffness_{axis}"].uncertainty for axis in "xy")
    return 0.5 * math.tan(TILT) * math.hypot(*both)


def _gimbal_error(e: Evidence, spin_rate: float) -> float:
    """Return how well the torque of the gimbal along the tilt is known, by what the bench states [N m]."""
    relative = e.bench.parameters["gimbal_inertia_x"].relative_uncertainty
    return math.tan(TILT) * relative * 0.5 * e.bench.tuning_inertia * spin_rate**2


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
        lambda: curves_figure(
            "Voltage of the motor over the tilt, 3500 rpm",
            "simulated bench with the computed air; bars: standard errors",
            [_tilt_panel(e, 2, "motor")],
        ),
    )


def _tilted(e: Evidence, *, air: bool) -> list[Estimate]:
    """Return the holds at 3 deg of the sweep of the speed."""
    return [own for own in e.holds(e.speeds, air=air) if abs(own.tilt_x) > 0.5 * TILT]


def _speed_panel(e: Evidence, place: int, title: str) -> Panel:
    x = [own.spin_rate / RPM for own in _tilted(e, air=True)]
    measured, error, model = _increments(_tilted(e, air=True), place)
    bare = _increments(_tilted(e, air=False), place)[2]
    return Panel(
        title,
        "spin rate, rpm",
        "change of voltage from 0°, mV",
        [
            Curve("measured", x, _MILLI * measured, INK, _MILLI * error, line="", marker="o"),
            Curve("model with air", x, _MILLI * model, BLUE),
            Curve("model without air", x, _MILLI * bare, VERMILION, line="--"),
        ],
    )


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
        lambda: curves_figure(
            "Voltages of the coils over the speed, 3°",
            "simulated bench with the computed air; bars: standard errors",
            [_speed_panel(e, 0, "coil x"), _speed_panel(e, 1, "coil y")],
        ),
    )


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
            "What makes the change of the voltage in Fig. 16",
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


STATEMENTS = (
    Statement(
        "fig-14",
        "Fig. 14",
        "Tilting about one axis changes the voltages of both coils, the more the larger the tilt.",
        _fig_14,
    ),
    Statement(
        "fig-14-cause",
        "Fig. 14",
        "These voltage increments reflect the transverse torques of the air.",
        _fig_14_cause,
    ),
    Statement(
        "fig-15",
        "Fig. 15",
        "The motor's voltage does not depend on the tilt, hence the torque on the spin does not.",
        _fig_15,
    ),
    Statement("fig-16", "Fig. 16", "At 3°, the increments of both coils grow with the speed.", _fig_16),
    Statement(
        "fig-16-cause",
        "Fig. 16 (a)",
        "The increment along the tilt reflects the torque of the air.",
        _fig_16_cause,
    ),
    Statement(
        "fig-16-across",
        "Fig. 16 (b)",
        "The increment across the tilt reflects the torque of the air.",
        _fig_16_across,
    ),
    Statement(
        "fig-17", "Fig. 17", "At 3°, the increment of the motor's voltage grows with the speed.", _fig_17
    ),
    Statement(
        "fig-17-cause", "Fig. 17", "That increment reflects the air's torque on the spin.", _fig_17_cause
    ),
)
