"""Where a model fails: the residual of every window, the regions that carry most of the misfit, and how it grows.

The residual is what was measured less what the model asks for, as torques and voltages of coils and motor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit

from gyrowheel_analysis.balance import CHANNELS as AVERAGES
from gyrowheel_analysis.balance import Balance
from gyrowheel_analysis.errors import channel_values
from gyrowheel_analysis.grouping import speed_groups
from gyrowheel_analysis.reduction import Windows
from gyrowheel_analysis.wording import number, size, size_and_noise, unit_for
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.units import DEG, RPM

Array = NDArray[np.float64]

_SHOWN = 5
#: A part is spoken of if its misfit is this many deviations beyond that of noise, that of the averages, which may drift
#: together, this many times that of noise; and if it has this share of the whole.
_BEYOND = 6.0
_DRIFTING = 4.0
_SHARE = 0.03
_STANDS_IN = (
    0.03  # by which time, which stands in for all that changes, must describe it better than what changes
)
_PLAINER = 0.01  # of the sum of squares that a plainer description may leave
_MOST_SENTENCES = 3


@dataclass(frozen=True)
class Kind:
    """A kind of residual: the rows of the balance that make it, its names and its unit.

    Attributes
    ----------
    rows : tuple of str
        Channels of `Balance`; two are real and imaginary part.
    title : str
        Short name: where the model fails.
    subject : str
        The same in a sentence: what is beyond the model.
    unit : str
        ``N·m`` or ``V``.
    patterns : tuple of str
        Ways to depend on the motion that are tried, see `_pattern`.
    """

    rows: tuple[str, ...]
    title: str
    subject: str
    unit: str
    patterns: tuple[str, ...]


#: The averages; then what the coils give once and twice a revolution, and the motor's ripple.
PARTS: dict[str, Kind] = {
    "tilt": Kind(
        ("tilt_x", "tilt_y"), "tilt", "coil torque", "N·m",
        ("tilt", "still", "cube", "rate", "load", "table", "room", "mirror"),
    ),
    "spin": Kind(("spin",), "spin", "motor torque", "N·m", ("still", "square", "acceleration")),
    "tilt_1n": Kind(
        ("tilt_1n_x", "tilt_1n_y"), "tilt 1N", "coil torque once a revolution", "N·m", ("still", "tilt", "mirror")
    ),
    "tilt_2n": Kind(
        ("tilt_2n_x", "tilt_2n_y"), "tilt 2N", "coil torque twice a revolution", "N·m", ("mirror", "still", "tilt")
    ),
    "spin_ripple": Kind(
        ("spin_ripple_x", "spin_ripple_y"), "spin ripple", "ripple of the motor torque", "N·m", ("still", "square")
    ),
    "motor_voltage": Kind(("motor_voltage",), "voltage", "motor voltage", "V", ("still", "square", "acceleration")),
    "voltage_ripple": Kind(
        ("voltage_ripple_x", "voltage_ripple_y"), "voltage ripple", "ripple of the motor voltage", "V", ("still",)
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Part:
    """The residual of one kind in every window.

    Attributes
    ----------
    kind : Kind
        What it is.
    values : ndarray (n,)
        Residual, complex for a kind of two rows: the averages in case axes x + i y, amplitudes in axes that turn.
    sigma : ndarray (n,)
        Standard deviation of its noise, of one of two rows.
    load : ndarray (n,) or None
        What the model asks for [unit of the kind]; None where that is not known.
    """

    kind: Kind
    values: NDArray[Any]
    sigma: Array
    load: NDArray[Any] | None = None

    def at(self, mask: NDArray[np.bool_]) -> Part:
        """Return the part in some of the windows."""
        return Part(
            self.kind, self.values[mask], self.sigma[mask], None if self.load is None else self.load[mask]
        )

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.values) * len(self.kind.rows)

    @property
    def squares(self) -> Array:
        """Square of the residual over that of its noise, for all rows together."""
        return np.asarray(np.abs(self.values) ** 2 / self.sigma**2)


@dataclass(frozen=True)
class WindowResiduals:
    """The residuals of all windows of some recordings.

    Attributes
    ----------
    windows : Windows
        The windows.
    recording : ndarray (n,)
        To which recording each belongs, from 0.
    parts : dict of str to Part
        By the names of `PARTS`; without what the recordings were not reduced to.
    """

    windows: Windows
    recording: NDArray[np.int64]
    parts: Mapping[str, Part]

    @property
    def chi2(self) -> float:
        """Sum of the squares of all residuals over their noise."""
        return sum(float(part.squares.sum()) for part in self.parts.values())


def window_residuals(
    balances: Sequence[Balance], windows: Windows, rows: Array, deviation: Array
) -> WindowResiduals:
    """Put the residual rows of all recordings together, window by window.

    Parameters
    ----------
    balances : sequence of Balance
        One a recording.
    windows : Windows
        The windows of all of them.
    rows, deviation : ndarray (N,)
        Residual rows and the standard deviation of their noise.
    """
    parts = {}
    for name, kind in PARTS.items():
        if not all(row in balance.channels for row in kind.rows for balance in balances):
            continue
        own: list[Any] = [channel_values(balances, rows, row) for row in kind.rows]
        noise = [channel_values(balances, deviation, row) for row in kind.rows]
        values = own[0] + 1j * own[1] if len(own) == 2 else own[0]
        load = None
        if name == "tilt" and np.any(windows.coil_voltage):
            # not what was measured, which has the residual in it
            x, y = (np.concatenate([b.measured[b.channel(row)] for b in balances]) for row in kind.rows)
            load = x + 1j * y - values
        parts[name] = Part(kind, values, np.sqrt(np.mean(np.square(noise), axis=0)), load)
    recording = np.repeat(np.arange(len(balances)), [len(balance.windows) for balance in balances])
    return WindowResiduals(windows, recording, parts)


#: The name by which `discovery.verdict` knows it.
tilt_and_spin = window_residuals


# ---- regions


@dataclass(frozen=True)
class Region:
    """A part of the data and its share of the misfit.

    Attributes
    ----------
    region : str
        Which part: channel, speed, kind of motion, air, coils.
    share_of_chi2 : float
        Its share of the sum of squares of the residuals in units of their noise.
    description : str
        What the residual looks like there.
    """

    region: str
    share_of_chi2: float
    description: str

    def to_json(self) -> dict[str, Any]:
        """Return the region as a JSON object."""
        return {"region": self.region, "share_of_chi2": self.share_of_chi2, "description": self.description}


def regions(data: WindowResiduals, bench: Bench) -> list[Region]:
    """Return the few regions that carry most of the misfit, largest share first."""
    labels = np.array(_labels(data.windows, bench))
    total = data.chi2
    found = []
    for part in data.parts.values():
        squares = part.squares
        for label in dict.fromkeys(labels):
            mask = labels == label
            share = float(squares[mask].sum()) / total if total else 0.0
            found.append((share, part, label, mask))
    found.sort(key=lambda item: -item[0])
    return [
        Region(f"{part.kind.title}, {label}", share, _describe(part, data.windows, mask))
        for share, part, label, mask in found[:_SHOWN]
    ]


def _labels(w: Windows, bench: Bench) -> list[str]:
    name = [""] * len(w)
    for group in speed_groups(w.mean_spin):
        speed = float(np.median(w.mean_spin[group])) / RPM
        for index in group:
            name[index] = f"{round(speed / 10) * 10:.0f} rpm"
    ambient = bench.value("air_pressure")
    labels = []
    for index in range(len(w)):
        parts = [name[index]]
        if abs(w.mean_tilt_rate[index]) > 0.5 * DEG:
            parts.append("cone")
        if w.air_pressure[index] < 0.8 * ambient:
            parts.append("low pressure")
        if w.coil_temperature[index] - bench.value("air_temperature") > 8.0:
            parts.append("warm coils")
        if w.up[index] < 0:
            parts.append("inverted")
        labels.append(", ".join(parts))
    return labels


def _describe(part: Part, w: Windows, mask: NDArray[np.bool_]) -> str:
    """Return in words what a residual looks like in some windows."""
    kind, r, sigma = part.kind, part.values[mask], part.sigma[mask]
    rms, noise = _rms(r), _rms(sigma)
    if not np.iscomplexobj(r):
        weight = 1.0 / sigma**2
        mean = float(np.sum(weight * r) / np.sum(weight))
        if abs(mean) > 0.5 * rms:
            side = "more" if mean > 0 else "less"
            about = size_and_noise(abs(mean), noise, kind.unit, f" {side} than the model")
            return f"{kind.subject} {about}"
    text = f"{kind.subject} beyond the model {size_and_noise(rms, noise, kind.unit, ' rms')}"
    if len(r) < 2 or float(np.abs(w.mean_tilt[mask]).max()) < 0.5 * DEG:
        return text
    if rms < 1.5 * noise * (math.sqrt(2.0) if np.iscomplexobj(r) else 1.0):
        return f"{text}; hardly more than noise"
    if not kind.rows[0].startswith("tilt"):
        return text
    power = float(np.mean(np.abs(r) ** 2))
    # a constant, and a part in proportion to the tilt (its mirror image where it comes twice a revolution)
    p = _pattern("mirror" if kind.rows[0].startswith("tilt_2n") else "tilt", w)[mask]
    design = np.column_stack([np.ones(len(p)), p])
    (constant, slope), *_ = np.linalg.lstsq(design, r, rcond=None)
    left = r - design @ np.array([constant, slope])
    if abs(slope) ** 2 * float(np.var(p)) > 0.5 * power:
        turns = f"turns with the tilt, {_phase(slope)}"
        return f"{text}; {turns if kind.rows[0] == 'tilt_x' else 'in proportion to the tilt'}"
    if abs(constant) ** 2 > 0.5 * power:
        return f"{text}; constant{_axes(complex(constant), kind)}"
    if float(np.mean(np.abs(left) ** 2)) > 0.5 * power:
        return f"{text}; neither constant nor in proportion to the tilt"
    return text


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2))) if len(values) else 0.0


def _phase(slope: complex) -> str:
    angle = math.degrees(math.atan2(slope.imag, slope.real))
    if abs(angle) < 20.0:
        return "in phase with it"
    if abs(abs(angle) - 180.0) < 20.0:
        return "against it"
    side = "ahead of" if angle > 0 else "behind"
    return f"{abs(angle):.0f}° {side} it"


def _axes(value: complex, kind: Kind) -> str:
    """Return the components of a constant, where its axes mean something to people."""
    if kind.rows[0] != "tilt_x":
        return " in the rotor" if kind.rows[0].startswith("tilt") else ""
    name, scale = unit_for(abs(value), kind.unit)
    x, y = (number(v / scale, sign=True) for v in (value.real, value.imag))
    return f", {x} {name} about x and {y} about y"


# ---- growth


def growth(data: WindowResiduals) -> list[str]:
    """Return how the residual stands to the motion and how it grows, as sentences that can be checked.

    The parts that carry most of the misfit are spoken of, and only what describes more than half of a part is said.
    """
    sentences = [_grows(part, data.windows) for part in _failing(data)]
    return [sentence for sentence in sentences if sentence is not None][:_MOST_SENTENCES]


def law_of_growth(data: WindowResiduals) -> str:
    """Return how the largest part of the residual grows with the speed: ``Ω^1.9±0.2``, or an empty text."""
    for part in _failing(data)[:1]:
        weight, speeds = 1.0 / part.sigma**2, speed_groups(data.windows.mean_spin)
        described = [d for n in part.kind.patterns for d in _described(n, part, data.windows, weight, speeds)]
        best = _where_usual(max(described, key=lambda d: d.explained), part, data.windows, weight)
        mean = complex(np.sum(best.weight * best.amplitude))
        if len(best.speed) > 2 and abs(mean) > 0.0:
            exponent = _exponent(best.speed, np.real(best.amplitude * np.conj(mean)) / abs(mean), best.sure)
            return "" if exponent is None else _power(*exponent)
    return ""


def _failing(data: WindowResiduals) -> list[Part]:
    """Return the parts that are clearly more than noise, the worst first."""
    beyond = {name: float(part.squares.sum()) - part.rows for name, part in data.parts.items()}
    whole = sum(max(value, 0.0) for value in beyond.values())
    names = [name for name, part in data.parts.items() if beyond[name] > max(_least(part), _SHARE * whole)]
    return [data.parts[name] for name in sorted(names, key=lambda n: -beyond[n])]


def _least(part: Part) -> float:
    if part.kind.rows[0] in AVERAGES:
        return (_DRIFTING - 1.0) * part.rows
    return _BEYOND * math.sqrt(2.0 * part.rows)


@dataclass(frozen=True)
class _Description:
    """A pattern with an amplitude of its own at every speed, and what it explains of the sum of squares.

    `sure` is the inverse variance of the amplitudes: `weight`, but for averages, which may drift together at a speed.
    """

    pattern: str
    speed: Array
    amplitude: NDArray[Any]
    weight: Array
    explained: float
    sure: Array


def _grows(part: Part, w: Windows) -> str | None:
    weight = 1.0 / part.sigma**2
    total = float(np.sum(part.squares))
    speeds = speed_groups(w.mean_spin)
    tried = [d for name in part.kind.patterns for d in _described(name, part, w, weight, speeds)]
    if not tried:
        return None
    # of patterns that describe it as well as any other the plainest one, which comes first
    most = max(d.explained for d in tried)
    best = next(d for d in tried if d.explained > most - _PLAINER * total)
    alone = max(
        (c for name in part.kind.patterns for c in _linear(name, part, w, weight)),
        key=lambda c: c[1].gain - (_STANDS_IN * total if c[1].name == "time" else 0.0),
        default=None,
    )
    if alone is not None and alone[1].gain > max(most + _PLAINER * total, 0.5 * (total - part.rows)):
        # two numbers say more than an amplitude for every speed
        return _who(part.kind, alone[0], alone[1].direction) + alone[1].text(part.kind, alone[0], first=True)
    other = _along_variable(best, part, w, weight, speeds)
    explained = best.explained + (other.gain if other is not None else 0.0)
    if explained < 0.5 * (total - part.rows):
        return None
    mean = complex(np.sum(best.weight * best.amplitude) / np.sum(best.weight))
    if abs(mean) == 0.0:
        return None
    if other is not None and other.gain > best.explained:
        # the amplitude is hardly ever the mean one, and may change its sign: both ends say what it is
        return _who(part.kind, best.pattern, other.direction) + other.text(
            part.kind, best.pattern, first=True
        )
    best = _where_usual(best, part, w, weight)
    mean = complex(np.sum(best.weight * best.amplitude) / np.sum(best.weight))
    sizes = np.real(best.amplitude * np.conj(mean)) / max(abs(mean), 1e-300)
    text = _beyond(
        part.kind, best.pattern, mean, alone=float(np.ptp(sizes)) < 0.1 * float(np.abs(sizes).max())
    )
    text += _growing(best.speed, sizes, best.sure, part.kind, best.pattern)
    return text + (other.text(part.kind, best.pattern) if other is not None else "")


def _where_usual(best: _Description, part: Part, w: Windows, weight: Array) -> _Description:
    """Return a description read off where nothing but the speed is changed, if every speed has such windows."""
    usual = _usual(w)
    if usual.all():
        return best
    alike = part.at(usual)
    groups = speed_groups(w.mean_spin[usual])
    found = next(_described(best.pattern, alike, w.select(usual), weight[usual], groups), best)
    return found if len(found.speed) == len(best.speed) else best


def _usual(w: Windows) -> NDArray[np.bool_]:
    """Return which windows have the air, the attitude and the warmth that most have."""
    air, up = float(np.median(w.air_pressure)), float(np.median(w.up))
    same = (np.abs(w.air_pressure / air - 1.0) < 0.2) & (np.abs(w.up - up) < 0.5)
    return same & (np.abs(w.coil_temperature - np.median(w.coil_temperature)) < 8.0)


def _described(
    name: str, part: Part, w: Windows, weight: Array, speeds: Sequence[NDArray[np.int64]]
) -> Iterator[_Description]:
    """Yield a pattern with its amplitude at every speed; nothing where the windows do not have it."""
    p = _pattern(name, w, part.load)
    if not np.any(np.abs(p) > 0.0):
        return
    real = not np.iscomplexobj(part.values)
    rows = []
    for index in speeds:
        g, q, r = weight[index], p[index], part.values[index]
        norm = float(np.sum(g * np.abs(q) ** 2))
        if norm > 0.0:
            a = np.sum(g * r * np.conj(q)) / norm
            alone = norm / len(index) if part.kind.rows[0] in AVERAGES else norm
            rows.append((float(np.mean(w.mean_spin[index])), a.real if real else a, norm, alone))
    if rows:
        speed, amplitude, norm_, sure = (np.array(column) for column in zip(*rows, strict=True))
        explained = float(np.sum(np.abs(amplitude) ** 2 * norm_))
        yield _Description(name, speed, amplitude, norm_, explained, sure)


def _pattern(name: str, w: Windows, load: NDArray[Any] | None = None) -> NDArray[Any]:
    """Return a way in which a residual may depend on the motion, for an amplitude of one; zero where it is not there.

    ``tilt``: the tilt [rad]; ``mirror``: its mirror image; ``square``: its square; ``cube``: its cube;
    ``rate``: its rate [rad/s];
    ``load``: what the model asks of the coils [N m]; ``still``: one; ``acceleration``: of the spin [rad/s^2];
    ``table``: rate of the table about the axes of the case [rad/s]; ``room``: a direction that stands in the room while
    the rig turns.
    """
    z = np.asarray(w.mean_tilt)
    if name == "tilt":
        return z
    if name == "mirror":
        return np.conj(z)
    if name == "cube":
        return z * np.abs(z) ** 2
    if name == "square":
        return np.abs(z) ** 2
    if name == "rate":
        return np.where(np.abs(w.mean_tilt_rate) > 0.5 * DEG, w.mean_tilt_rate, 0.0)
    if name == "load":
        return np.zeros(len(w)) if load is None else load
    if name == "acceleration":
        return np.where(np.abs(w.mean_spin_acceleration) > 1.0, w.mean_spin_acceleration, 0.0)
    if name == "table":
        return np.asarray(w.table_rate * w.up_across)
    if name == "room":
        # where the rig is not turned it is the same as a direction in the case
        return w.home_x if np.ptp(np.angle(w.home_x * np.exp(0.1j))) > 0.1 else np.zeros(len(w))
    return np.ones(len(w))


_WORDS = {
    "tilt": "turns with the tilt",
    "mirror": "is in proportion to the tilt, mirrored",
    "square": "grows with the tilt squared",
    "cube": "grows with the cube of the tilt",
    "rate": "goes with the rate of the tilt",
    "load": "is in proportion to what they have to give",
    "acceleration": "goes with the acceleration of the spin",
    "table": "goes with the rate of the table",
    "room": "stands in the room while the rig is turned",
    "still": "is the same at every tilt",
}
_PER = {
    "tilt": "/rad", "mirror": "/rad", "square": "/rad²", "cube": "/rad³", "rate": " per rad/s",
    "acceleration": " per rad/s²", "table": " per rad/s",
}  # fmt: skip


def _amounts(values: Sequence[float], kind: Kind, pattern: str) -> tuple[list[str], str]:
    """Return amplitudes of a pattern as numbers, and the unit of them all."""
    name, scale = ("%", 1e-2) if pattern == "load" else unit_for(max(abs(v) for v in values), kind.unit)
    signed = min(values) < 0.0
    return [number(v / scale, sign=signed) for v in values], f"{name}{_PER.get(pattern, '')}"


def _who(kind: Kind, pattern: str, direction: complex) -> str:
    """Return what is beyond the model, and how it stands to the motion."""
    if len(kind.rows) == 1:
        return f"the {kind.subject} beyond the model's" + (
            "" if pattern == "still" else f" {_WORDS[pattern]}"
        )
    tilt = kind.rows[0] == "tilt_x"
    words = (
        "is in proportion to the tilt"
        if pattern == "mirror" and kind.rows[0] == "tilt_2n_x"
        else _WORDS[pattern]
    )
    text = f"{'the coils give a torque' if tilt else f'there is a {kind.subject}'} beyond the model's that {words}"
    return f"{text}, {_phase(direction)}" if tilt and pattern in ("tilt", "cube", "rate") else text


def _beyond(kind: Kind, pattern: str, mean: complex, *, alone: bool = False) -> str:
    """Return the same with its size."""
    per = _PER.get(pattern, "")
    if len(kind.rows) == 1:
        side = "more" if mean.real > 0 else "less"
        text = f"the {kind.subject} is {size(abs(mean), kind.unit)}{per} {side} than the model asks for"
        return text if pattern == "still" else f"{text}, which {_WORDS[pattern]}"
    text = _who(kind, pattern, mean)
    if pattern == "still" and kind.rows[0] == "tilt_x":
        return text + _axes(mean, kind)
    (amount,), unit = _amounts([abs(mean)], kind, pattern)
    sign = "−" if pattern == "load" and mean.real < 0.0 else ""
    return f"{text}, {sign}{amount} {unit}{'' if alone else ' on average'}"


def _growing(speed: Array, sizes: Array, weight: Array, kind: Kind, pattern: str) -> str:
    """Return how a size grows with the speed: a power where that describes it, else both ends."""
    if len(speed) < 2:
        return ""
    exponent = _exponent(speed, sizes, weight) if len(speed) > 2 else None
    if exponent is not None:
        value, error = exponent
        if abs(value) < max(2.0 * error, 0.08) and abs(value) < 0.2:
            return ", at every speed"
        return f", and {'grows' if value > 0 else 'falls'} as {_power(value, error)}"
    low, high = float(sizes[0]), float(sizes[-1])
    if max(abs(low), abs(high)) == 0.0 or np.ptp(sizes) < 0.15 * float(np.abs(sizes).max()):
        return ""
    (a, b), unit = _amounts([low, high], kind, pattern)
    return f", from {a} to {b} {unit} between {speed[0] / RPM:.0f} and {speed[-1] / RPM:.0f} rpm"


def _power(value: float, error: float) -> str:
    digits = 1 if error >= 0.1 else 2
    return f"Ω^{value:.{digits}f}±{max(error, 0.01):.{digits}f}".replace("-", "−")


@dataclass(frozen=True)
class _Change:
    """How an amplitude changes with a variable that is not the speed: its ends along `direction`."""

    name: str
    low: float
    high: float
    at_low: float
    at_high: float
    direction: complex
    gain: float

    def text(self, kind: Kind, pattern: str, *, first: bool = False) -> str:
        """Return the change as the end of a sentence."""
        (a, b), unit = _amounts([self.at_low, self.at_high], kind, pattern)
        ends = _VARIABLES[self.name][1].format(
            low=_shown(self.name, self.low), high=_shown(self.name, self.high)
        )
        comma = " and goes" if len(kind.rows) == 2 or pattern != "still" else " goes"
        return f"{comma if first else '; it goes'} from {a} to {b} {unit} {ends}"


#: Variables, beside speed and tilt, with which an amplitude may change: smallest range that says anything, and words.
_VARIABLES: dict[str, tuple[float, str]] = {
    "coils": (4.0, "as the coils warm from {low} to {high} °C"),
    "motor": (4.0, "as the motor's winding warms from {low} to {high} °C"),
    "magnets": (2.0, "as the motor's magnets warm from {low} to {high} °C"),
    "air": (0.1, "as the pressure of the air goes from {low} to {high} kPa"),
    "up": (0.5, "as the rig is turned from upside down to upright"),
    "time": (5.0, "from {low} to {high} s in the recording"),
}


def _variable_values(w: Windows, part: Part) -> dict[str, Array]:
    """Return what an amplitude may change with; the motor's warmth follows the plan, and matters to the motor alone."""
    values = {
        "coils": w.coil_temperature,
        "motor": w.motor_temperatures[:, 0],
        "magnets": w.motor_temperatures[:, 1],
        "air": w.air_pressure / 101325.0,
        "up": w.up,
        "time": w.middle,
    }
    if part.kind.rows[0].startswith("tilt"):
        del values["motor"], values["magnets"]
    return values


def _linear(name: str, part: Part, w: Windows, weight: Array) -> Iterator[tuple[str, _Change]]:
    """Yield a pattern whose amplitude is a straight line in a variable, for each variable; its gain is the whole."""
    p = _pattern(name, w, part.load)
    if not np.any(np.abs(p) > 0.0):
        return
    root = np.sqrt(weight)
    for variable, v in _variable_values(w, part).items():
        low, high = float(v.min()), float(v.max())
        if high - low < _VARIABLES[variable][0]:
            continue
        design = np.column_stack([p * root, p * (v - low) * root])
        if np.iscomplexobj(part.values):
            solution, *_ = np.linalg.lstsq(design.astype(complex), part.values * root, rcond=1e-9)
        else:
            solution, *_ = np.linalg.lstsq(design.real, part.values * root, rcond=1e-9)
        ends = np.array([solution[0], solution[0] + solution[1] * (high - low)])
        largest = complex(ends[int(np.argmax(np.abs(ends)))])
        unit = largest / abs(largest) if np.iscomplexobj(part.values) and abs(largest) > 0.0 else 1.0 + 0.0j
        at = np.real(ends * np.conj(unit))
        explained = float(np.sum(np.abs(design @ solution) ** 2))
        yield name, _Change(variable, low, high, float(at[0]), float(at[1]), unit, explained)


def _shown(name: str, value: float) -> str:
    if name in ("coils", "motor", "magnets"):
        return f"{value - 273.15:.0f}"
    return f"{value * 101.325:.0f}" if name == "air" else f"{value:.0f}"


def _along_variable(
    best: _Description, part: Part, w: Windows, weight: Array, speeds: Sequence[NDArray[np.int64]]
) -> _Change | None:
    """Return with which variable the amplitude changes at a given speed, where that explains much of the residual."""
    values = _variable_values(w, part)
    total = float(np.sum(part.squares))
    p = _pattern(best.pattern, w, part.load)
    mean = complex(np.sum(best.weight * best.amplitude))
    found: list[_Change] = []
    for name, v in values.items():
        least = _VARIABLES[name][0]
        if float(np.ptp(v)) < least:
            continue
        gain, slopes, weights, middle = 0.0, [], [], 0.0
        for index in speeds:
            g, q, r, x = weight[index], p[index], part.values[index], v[index]
            norm = g * np.abs(q) ** 2
            if norm.sum() == 0.0 or np.ptp(x) < 0.2 * least:
                continue
            x = x - np.sum(norm * x) / norm.sum()
            spread = float(np.sum(norm * x**2))
            if spread <= 0.0:
                continue
            slope = np.sum(g * x * r * np.conj(q)) / spread
            gain += abs(slope) ** 2 * spread
            slopes.append(slope)
            weights.append(spread)
        if not slopes:
            continue
        slope = complex(np.average(slopes, weights=weights))
        everywhere = weight * np.abs(p) ** 2
        middle = float(np.sum(everywhere * v) / everywhere.sum())
        low, high = float(v.min()), float(v.max())
        level = mean / float(np.sum(best.weight))
        along = slope if abs(slope) * (high - low) > abs(level) else level
        unit = along / abs(along) if abs(along) > 0.0 and np.iscomplexobj(part.values) else 1.0 + 0.0j
        base, rise = (level * np.conj(unit)).real, (slope * np.conj(unit)).real
        at_low, at_high = base + rise * (low - middle), base + rise * (high - middle)
        found.append(_Change(name, low, high, at_low, at_high, unit, gain))
    change = max(found, key=lambda c: c.gain, default=None)
    return change if change is not None and change.gain > 0.2 * total else None


def _exponent(speed: Array, sizes: Array, weight: Array) -> tuple[float, float] | None:
    """Return exponent and its error of a power law of the speed; None where that does not describe it."""
    if float(speed.max() / speed.min()) < 1.3:
        return None
    reference = float(np.exp(np.average(np.log(speed), weights=weight)))
    largest = float(np.abs(sizes).max())
    if largest == 0.0:
        return None
    sizes, weight = sizes / largest, weight * largest**2

    def law(x: Array, amplitude: float, n: float) -> Array:
        return np.asarray(amplitude * (x / reference) ** n)

    def slopes(x: Array, amplitude: float, n: float) -> Array:
        power = (x / reference) ** n
        return np.column_stack([power, amplitude * power * np.log(x / reference)])

    start = (float(np.average(sizes, weights=weight)), 1.0)
    try:
        found, _ = curve_fit(
            law, speed, sizes, p0=start, sigma=1.0 / np.sqrt(weight), jac=slopes, maxfev=2000
        )
    except RuntimeError:
        return None
    design = slopes(speed, *found)
    covariance = np.linalg.pinv(design.T @ (weight[:, None] * design), hermitian=True)
    left = float(np.sum(weight * (sizes - law(speed, *found)) ** 2))
    # where it scatters more than the noise says, it is as uncertain as it scatters
    error = float(np.sqrt(covariance[1, 1] * max(1.0, left / max(len(speed) - 2, 1))))
    if left > 0.05 * float(np.sum(weight * sizes**2)):
        return None
    return (float(found[1]), error) if error < 0.5 and abs(found[1]) < 6.0 else None
