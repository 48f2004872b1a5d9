"""The signature of an effect: what it asks of coils and motor at every tilt and speed, as data and as a picture."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.reduction import Windows, planned_windows
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_SPEEDS = 9
_TILTS = 8
_RINGS, _SPOKES = 2, 12
#: What no bench could see: a part of the torque of the flexures at the reference tilt, and of the supply.
_NOTHING = 1e-4
_ROUNDING = 1e-10  # what computing leaves of zero
_WARM = 20.0  # of coils and motor above the air [K]
_PERIOD, _GLIMPSE = 2.5, 0.2  # of the cone, and what of it is looked at [s]
_VISIBLE = {"N·m": 1e-8, "V": 1e-5}  # less is not drawn
#: States in which an effect is looked for, one after the other, in words.
_STATES = {
    "held": "",
    "warm": f"Coils and motor are {_WARM:.0f} K warmer than the air.",
    "cone": f"The tilt turns about the case axis once in {_PERIOD} s.",
}
_MILLI = 1e-3
#: Rows that are shown, with their units and colours: of the palette of Okabe and Ito, which people tell apart whatever
#: their colour vision.
_ROWS = (
    ("coils, in phase with the tilt", "N·m", "#0072B2"),
    ("coils, across the tilt", "N·m", "#D55E00"),
    ("motor", "N·m", "#009E73"),
    ("coils, once a turn", "N·m", "#E69F00"),
    ("coils, twice a turn", "N·m", "#56B4E9"),
    ("ripple on the shaft", "N·m", "#444444"),
    ("motor voltage beyond that of its torque", "V", "#CC79A7"),
    ("ripple of the motor voltage", "V", "#444444"),
)
_INK, _FAINT = "#222222", "#E4E4E4"
_STYLE: Any = {  # typed by matplotlib key by key
    "font.family": "sans-serif",
    "font.size": 9.5,
    "axes.edgecolor": "#888888",
    "axes.labelcolor": _INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": _INK,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "svg.fonttype": "none",  # text stays text: smaller files, the same on every machine
    "svg.hashsalt": "gyrowheel",
}


@dataclass(frozen=True)
class Curve:
    """One row of the torque balance along an axis.

    Attributes
    ----------
    name : str
        What it is.
    unit : str
        ``N·m`` or ``V``.
    values : ndarray (k,)
        What the effect adds to what coils or motor must give [`unit`].
    """

    name: str
    unit: str
    values: Array


@dataclass(frozen=True)
class Signature:
    """What an effect of its usual size adds to what coils and motor must give while the tilt is held.

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
        What else is so, in a sentence; empty where nothing is.
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
    """Return the signature of an effect on a bench; None if it shows in no steady state.

    The coefficients have their usual sizes. Effects that a held tilt does not show are shown with warm coils and motor,
    or on a slow cone. The speed at which the tilts are shown is the reference speed, or a low one where the coils'
    torque is much larger there: at the reference speed a tuned rotor needs no torque to stay tilted, and nothing shows
    that acts in proportion to it.
    """
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
            much = float(np.abs(slow.torques).max()) > 1.5 * float(np.abs(found.torques).max())
            return slow if much else found
    return None


def _signature(effect: Effect, bench: Bench, state: str, at: float) -> Signature:
    limit = bench.value("tilt_limit")
    low, high = bench.value("spin_rate_minimum"), bench.value("spin_rate_maximum")
    held = 0.6 * limit
    ring = np.exp(2j * np.pi * np.arange(_SPOKES) / _SPOKES)
    grid = np.concatenate([[0j], *(limit * k / _RINGS * ring for k in range(1, _RINGS + 1))])
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
    # at a tilt about x what is in phase with the tilt is the part about x
    shown = (
        row("tilt_x"), row("tilt_y"), spin, size("tilt_1n"), size("tilt_2n"), size("spin_ripple"), volts,
        size("voltage_ripple"),
    )  # fmt: skip

    def curves(part: slice) -> tuple[Curve, ...]:
        return tuple(Curve(name, unit, v[part]) for (name, unit, _), v in zip(_ROWS, shown, strict=True))

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


# --- drawing ---


def to_svg(found: Signature, description: str = "") -> str:
    """Return the picture of a signature as an SVG document, 760 wide; `description` goes into its metadata."""
    import matplotlib as mpl

    with mpl.rc_context(_STYLE):
        figure = draw(found)
        stream = io.StringIO()
        metadata: Mapping[str, Any] = {"Date": None, "Creator": None, "Description": description}
        figure.savefig(stream, format="svg", metadata=metadata)
    # a hundredth of a dot is fine enough
    text = re.sub(r"(?<=[\d ])\.?\d*\.\d{3,}(?=[\s\")])", lambda m: f"{float(m[0]):.2f}", stream.getvalue())
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n"


def draw(found: Signature) -> Figure:
    """Return the figure of `to_svg`: the torque over the tilts, and rows over speed and tilt."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 2.75), dpi=100, facecolor="white")
    grid = figure.add_gridspec(
        1, 3, left=0.045, right=0.985, top=0.80, bottom=0.20, wspace=0.36, width_ratios=(1.0, 1.25, 1.25)
    )
    _arrows(figure.add_subplot(grid[0]), found)
    rpm, tilt = found.speed_held / RPM, found.tilt_held / DEG
    shown = _visible(found)
    volts = bool(shown) and all(row.unit == "V" for row, _ in shown)
    for place, title, label, x, rows in (
        (1, f"at a tilt of {tilt:.0f}°", "speed, rpm", found.speed / RPM, found.by_speed),
        (2, f"at {rpm:.0f} rpm", "tilt, deg", found.tilt / DEG, found.by_tilt),
    ):
        axes = figure.add_subplot(grid[place])
        _lines(axes, x, [rows[index] for _, index in shown], [index for _, index in shown])
        axes.set_title(title)
        axes.set_xlabel(label)
        axes.set_ylabel("V" if volts else "mN·m", labelpad=2)
    handles = figure.axes[1].get_legend_handles_labels()
    figure.legend(
        *handles,
        loc="upper left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=4,
        frameon=False,
        fontsize=9.5,
        handlelength=1.4,
    )
    return figure


def _visible(found: Signature) -> list[tuple[Curve, int]]:
    """Return the rows that are more than a hundredth of the largest of their unit; volts only where nothing else is."""
    sizes = [
        max(float(np.abs(a.values).max()), float(np.abs(b.values).max()))
        for a, b in zip(found.by_speed, found.by_tilt, strict=True)
    ]
    for unit in ("N·m", "V"):
        rows = [(row, k) for k, row in enumerate(found.by_speed) if row.unit == unit]
        largest = max(sizes[k] for _, k in rows)
        if largest > _VISIBLE[unit]:
            return [(row, k) for row, k in rows if sizes[k] > 0.01 * largest]
    return []


def _lines(axes: Axes, x: Array, rows: Sequence[Curve], colours: Sequence[int]) -> None:
    axes.axhline(0.0, color="#BBBBBB", linewidth=0.8, zorder=1)
    for row, colour in zip(rows, colours, strict=True):
        scale = _MILLI if row.unit == "N·m" else 1.0
        axes.plot(x, row.values / scale, color=_ROWS[colour][2], linewidth=1.8, label=row.name, zorder=3)
    axes.margins(x=0.03, y=0.12)
    axes.grid(axis="y", color=_FAINT, linewidth=0.8)
    axes.set_axisbelow(True)
    low, high = axes.get_ylim()
    if low > -0.05 * high and high > 0.0:
        axes.set_ylim(min(low, 0.0), high)
    axes.locator_params(axis="y", nbins=5)


def _arrows(axes: Axes, found: Signature) -> None:
    """Draw the torque of the coils as an arrow at every tilt."""
    from matplotlib.patches import Circle

    z, longest = found.tilts / DEG, float(np.abs(found.torques).max())
    limit = float(np.abs(z).max())
    for k in range(1, _RINGS + 1):
        axes.add_patch(
            Circle((0.0, 0.0), limit * k / _RINGS, fill=False, color=_FAINT, linewidth=0.8, zorder=1)
        )
    text = "no steady torque of the coils"
    rows = [row for row in (*found.by_speed, *found.by_tilt) if row.unit == "N·m"]
    if longest > max(_VISIBLE["N·m"], 0.01 * max(float(np.abs(row.values).max()) for row in rows)):
        arrow = found.torques / longest * 0.46 * limit
        axes.quiver(
            z.real, z.imag, arrow.real, arrow.imag, angles="xy", scale_units="xy", scale=1.0, color=_INK, width=0.011,
            headwidth=4.0, headlength=4.5, headaxislength=4.0, zorder=3,
        )  # fmt: skip
        text = f"longest: {_short(longest / _MILLI)} mN·m"
    axes.set_aspect("equal")
    axes.set_xlim(-1.5 * limit, 1.5 * limit)
    axes.set_ylim(-1.5 * limit, 1.5 * limit)
    axes.set_axis_off()
    axes.set_title("torque over the tilt", loc="center")
    axes.text(0.5, -0.1, text, transform=axes.transAxes, ha="center", va="center", color="#555555")


def _short(value: float) -> str:
    places = max(1 - math.floor(math.log10(value)), 0)
    return f"{value:.{places}f}"
