"""The signature of an effect: the torques and voltages that it requires of coils and motor at every tilt and speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.reduction.segmentation import planned_windows
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect

Array = NDArray[np.float64]

_SPEEDS = 9
_TILTS = 8
#: Rings of tilts, from the upright on.
RINGS = 2
_SPOKES = 12
#: Part of the flexures' torque at the reference tilt, and of the supply voltage, below which an effect is invisible.
_NOTHING = 1e-4
_ROUNDING = 1e-10  # rounding errors are smaller
_WARM = 20.0  # of coils and motor above the air [K]
_PERIOD, _GLIMPSE = 2.5, 0.2  # of the cone, and the evaluated part of it [s]
#: States in which an effect is looked for, in turn, in words.
_STATES = {
    "held": "",
    "warm": f"Coils and motor are {_WARM:.0f} K warmer than the air.",
    "cone": f"The tilt turns about the case axis once in {_PERIOD} s.",
}
#: Rows of the balance in a signature, with their units.
ROWS = (
    ("coils, in phase with the tilt", "N·m"),
    ("coils, across the tilt", "N·m"),
    ("motor", "N·m"),
    ("coils, once a turn", "N·m"),
    ("coils, twice a turn", "N·m"),
    ("ripple on the shaft", "N·m"),
    ("motor voltage beyond that of its torque", "V"),
    ("ripple of the motor voltage", "V"),
)


@dataclass(frozen=True)
class Curve:
    """Contribution of the effect to one row of the torque balance along an axis, in `unit` (``N·m`` or ``V``)."""

    name: str
    unit: str
    values: Array


@dataclass(frozen=True)
class Signature:
    """Torques and voltages that an effect of its usual size requires while the tilt is held.

    Attributes
    ----------
    tilts : complex ndarray (m,)
        Tilts phi_x + i phi_y at `speed_held` [rad].
    torques : complex ndarray (m,)
        Mean torque of the coils there, x + i y [N m].
    speed : ndarray (k,)
        Speeds [rad/s].
    by_speed : tuple of Curve
        Rows over the speeds, at `tilt_held` about x.
    tilt : ndarray (j,)
        Tilts about x [rad].
    by_tilt : tuple of Curve
        Rows over the tilts, at `speed_held`.
    tilt_held, speed_held : float
        The tilt of `by_speed` [rad] and the speed of the rest [rad/s].
    state : str
        Special conditions in a sentence; empty without any.
    """

    tilts: NDArray[np.complex128]
    torques: NDArray[np.complex128]
    speed: Array
    by_speed: tuple[Curve, ...]
    tilt: Array
    by_tilt: tuple[Curve, ...]
    tilt_held: float
    speed_held: float
    state: str

    def to_json(self) -> dict[str, Any]:
        """Return the signature as a JSON object, to four digits."""

        def numbers(values: Any) -> list[float]:
            return [float(f"{value:.4g}") if abs(value) > _ROUNDING else 0.0 for value in values]

        def curves(rows: Sequence[Curve]) -> dict[str, list[float]]:
            return {f"{row.name} [{row.unit}]": numbers(row.values) for row in rows}

        return {
            "tilt_rad": [[*numbers((z.real, z.imag))] for z in self.tilts],
            "coil_torque_Nm": [[*numbers((t.real, t.imag))] for t in self.torques],
            "speed_rad_s": numbers(self.speed),
            "by_speed": curves(self.by_speed),
            "tilt_x_rad": numbers(self.tilt),
            "by_tilt": curves(self.by_tilt),
            "state": self.state,
        }


def signature(effect: Effect, bench: Bench) -> Signature | None:
    """Return the signature of an effect on a bench; None if it shows in no steady state, or depends on the way there.

    The coefficients have their usual sizes. Effects that a held tilt does not show are shown with warm coils and motor,
    or on a slow cone. The tilts are shown at the reference speed, or at a low one where the coils' torque is much
    larger: at the reference speed a tuned rotor stays tilted without torque, which hides what is proportional to it.
    """
    if effect.states:
        return None
    reference, low = bench.value("spin_rate_reference"), bench.value("spin_rate_minimum")
    stiffness = 0.5 * (bench.value("flexure_stiffness_x") + bench.value("flexure_stiffness_y"))
    nothing = {
        "N·m": _NOTHING * stiffness * bench.value("tilt_reference"),
        "V": _NOTHING * bench.value("supply_voltage"),
    }
    for state in _STATES:
        found = _signature(effect, bench, state, reference)
        rows = (*found.by_speed, *found.by_tilt)
        if any(float(np.abs(row.values).max()) > nothing[row.unit] for row in rows):
            slow = _signature(effect, bench, state, low + 0.2 * (reference - low))
            fast = max(float(np.abs(found.torques).max()), nothing["N·m"])
            return slow if float(np.abs(slow.torques).max()) > 1.5 * fast else found
    return None


def _signature(effect: Effect, bench: Bench, state: str, at: float) -> Signature:
    limit = bench.value("tilt_limit")
    low, high = bench.value("spin_rate_minimum"), bench.value("spin_rate_maximum")
    held = 0.6 * limit
    ring = np.exp(2j * np.pi * np.arange(_SPOKES) / _SPOKES)
    grid = np.concatenate([[0j], *(limit * k / RINGS * ring for k in range(1, RINGS + 1))])
    speeds, tilts = np.linspace(low, high, _SPEEDS), np.linspace(0.0, limit, _TILTS)
    plan = _plan([(at, grid), *((speed, [held]) for speed in speeds), (at, tilts)])
    windows = _put_into(state, planned_windows(plan, bench), bench)
    values = bench.values()
    balance = Balance(windows, bench)
    # the current that the motor needs anyway
    current = balance.predicted(values, [])[balance.row("spin")] / bench.value("motor_constant")
    balance = Balance(replace(windows, motor_current=current), bench)
    rows = balance.predicted(values, [ActiveEffect(effect, effect.defaults())])
    rows = rows - balance.predicted(values, [])

    def row(name: str) -> Array:
        return np.asarray(rows[balance.row(name)])

    def size(name: str) -> Array:
        return np.hypot(row(f"{name}_x"), row(f"{name}_y"))

    spin = row("spin")
    volts = row("motor_voltage") - bench.value("motor_resistance") / bench.value("motor_constant") * spin
    # at a tilt about x the part about x is in phase with the tilt
    shown = (
        row("tilt_x"), row("tilt_y"), spin, size("tilt_1n"), size("tilt_2n"), size("spin_ripple"), volts,
        size("voltage_ripple"),
    )  # fmt: skip

    def curves(part: slice) -> tuple[Curve, ...]:
        return tuple(Curve(name, unit, v[part]) for (name, unit), v in zip(ROWS, shown, strict=True))

    a, b = len(grid), len(grid) + len(speeds)
    return Signature(
        tilts=grid,
        torques=(row("tilt_x") + 1j * row("tilt_y"))[:a],
        speed=speeds,
        by_speed=curves(slice(a, b)),
        tilt=tilts,
        by_tilt=curves(slice(b, None)),
        tilt_held=held,
        speed_held=at,
        state=_STATES[state],
    )


def _put_into(state: str, windows: Windows, bench: Bench) -> Windows:
    """Return the windows of held tilts in another state (see `_STATES`)."""
    air = bench.value("air_temperature")
    if state == "warm":
        return replace(
            windows,
            coil_temperature=np.full(len(windows), air + _WARM),
            motor_temperatures=np.full((len(windows), 2), air + _WARM),
        )
    if state == "cone":
        turn = 1j * math.pi * _GLIMPSE / _PERIOD
        series = [turn**n / math.factorial(n) for n in range(windows.tilt.shape[1])]
        return replace(
            windows, duration=np.full(len(windows), _GLIMPSE), tilt=windows.tilt[:, :1] * np.array(series)
        )
    return windows


def _plan(states: Sequence[tuple[float, Any]]) -> Plan:
    """Return a plan that holds every tilt [rad] at its speed [rad/s]."""
    blocks = []
    for speed, tilts in states:
        pairs = [[float(np.real(z)) / DEG, float(np.imag(z)) / DEG] for z in tilts]
        blocks.append(f"  - {{spin_rpm: {float(speed) / RPM!r}, tilt_deg: {pairs}}}")
    return Plan.load("schema: 1\nname: signature\nhold_s: 2.0\nsegments:\n" + "\n".join(blocks) + "\n")
