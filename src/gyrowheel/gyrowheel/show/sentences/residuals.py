"""Residuals: the regions where a model fails, the variables they depend on, and the laws they follow."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from gyrowheel_analysis.channels import CHANNELS
from gyrowheel_core.quantities import listed, number, size, size_and_noise
from gyrowheel_core.units import RPM, unit_for

if TYPE_CHECKING:
    from gyrowheel_analysis.channels import Channel
    from gyrowheel_analysis.residuals.dependence import Dependence, PartDependence
    from gyrowheel_analysis.residuals.growth import Change, Growth, SpeedLaw
    from gyrowheel_analysis.residuals.maps import Region

#: Titles of the variables on which a residual may depend, in tables, sentences and pictures.
TITLES = {
    "speed": "spin rate",
    "tilt": "tilt magnitude",
    "azimuth": "tilt direction",
    "temperature": "coil temperature",
    "motor_temperature": "motor temperature",
    "air_pressure": "air pressure",
    "time": "time",
}
_CONDITIONS = {
    "cone": "cone",
    "low_pressure": "low pressure",
    "warm_coils": "warm coils",
    "inverted": "inverted",
}
_PATTERNS = {
    "tilt": "proportional to the tilt",
    "mirror": "proportional to the mirrored tilt",
    "square": "proportional to the square of the tilt",
    "cube": "proportional to the cube of the tilt",
    "rate": "proportional to the tilt rate",
    "load": "proportional to the coil torque itself",
    "acceleration": "proportional to the spin acceleration",
    "table": "proportional to the turn rate of the rate table",
    "room": "fixed in the room while the rig is turned",
    "still": "the same at every tilt",
}
_PER = {
    "tilt": "/rad", "mirror": "/rad", "square": "/rad²", "cube": "/rad³", "rate": " per rad/s",
    "acceleration": " per rad/s²", "table": " per rad/s",
}  # fmt: skip
_WITH_PHASE = ("tilt", "cube", "rate")
_CHANGES = {
    "coils": "as the coils warm from {low} to {high} °C",
    "motor": "as the motor winding warms from {low} to {high} °C",
    "magnets": "as the motor magnets warm from {low} to {high} °C",
    "air": "as the air pressure goes from {low} to {high} kPa",
    "up": "as the rig is turned from inverted to upright",
    "time": "between {low} and {high} s of the recording",
}


def region_name(region: Region) -> str:
    """Return which part of the data a region is: ``tilt, 3500 rpm, cone``."""
    return ", ".join(
        [
            CHANNELS[region.part].title,
            f"{region.spin_rate / RPM:.0f} rpm",
            *(_CONDITIONS[c] for c in region.conditions),
        ]
    )


def region_description(region: Region) -> str:
    """Return size and shape of the residual in a region."""
    kind, look = CHANNELS[region.part], region.look
    if look.form == "offset":
        side = " above the model" if look.value.real > 0 else " below the model"
        return f"{kind.subject} {size_and_noise(look.size, look.noise, kind.unit, side)}"
    text = f"residual {kind.subject} {size_and_noise(look.size, look.noise, kind.unit, ' rms')}"
    if look.form == "noise":
        return f"{text}; barely above the noise"
    if look.form == "tilt":
        return f"{text}; {_PATTERNS['tilt']}{_phase(look.value) if kind.rows[0] == 'tilt_x' else ''}"
    if look.form == "constant":
        return f"{text}; constant{_axes(look.value, kind)}"
    if look.form == "neither":
        return f"{text}; neither constant nor proportional to the tilt"
    return text


def dependence_sentences(found: Iterable[PartDependence]) -> list[str]:
    """Return the variables of the residual, a sentence for every part that is more than noise."""
    return [_dependence(part) for part in found]


def growth_sentence(law: Growth) -> str:
    """Return which law a part of the residual follows."""
    kind = CHANNELS[law.part]
    if law.amplitude is None:
        assert law.change is not None  # one of the two is always there
        ends = _ends(law.change, kind)
        if len(kind.rows) == 1 and law.pattern == "still":
            return f"the residual {kind.subject} goes {ends}"
        return f"{_subject(kind, law.pattern, law.change.direction)}; it goes {ends}"
    text = _amplitude(law, kind) + _with_speed(law.speed, kind, law.pattern)
    return text + (f"; it goes {_ends(law.change, kind)}" if law.change is not None else "")


def _dependence(found: PartDependence) -> str:
    title = CHANNELS[found.part].title
    mostly = _mostly(found.part) if found.mostly_plain else ""
    if found.stated:
        text = f"depends on the {listed([_named(d) for d in found.stated], 'and')}"
        text = f"{title}: {mostly}; beyond that it {text}" if mostly else f"{title}: {text}"
        if found.instead:
            others = listed([TITLES[name] for name in found.instead], "or")
            text += f"; or on the {others}, which varied along with it in these recordings"
        return text
    if found.larger:
        about = f"more than noise (χ²/N {number(found.whiteness.chi2_per_n)})"
        return f"{title}: {about}, {mostly or 'and no variable accounts for it'}"
    about = f"correlation {found.whiteness.correlation:.2f}, p {probability(found.whiteness.p_order)}"
    return f"{title}: no larger than noise, but neighbouring windows are correlated ({about})"


def _mostly(part: str) -> str:
    """Return the main component of a residual that depends on no variable."""
    return "mostly constant or proportional to the tilt" if part.startswith("tilt") else "mostly constant"


def _named(d: Dependence) -> str:
    # a residual proportional to the tilt is not yet a dependence on the tilt
    beyond = "not proportional, " if d.variable == "tilt" and d.part.startswith("tilt") else ""
    about = f"{beyond}{100.0 * d.share_beside:.0f} % of χ², p {probability(d.p_beside)}"
    return f"{TITLES[d.variable]} ({about})"


def probability(p: float) -> str:
    """Return a probability by chance, as it follows the letter p."""
    return "< 0.001" if p < 1e-3 else f"= {p:.1g}"


def _subject(kind: Channel, pattern: str, direction: complex) -> str:
    """Return how a residual depends on the motion."""
    words = _PATTERNS["tilt" if pattern == "mirror" and kind.rows[0] == "tilt_2n_x" else pattern]
    phase = _phase(direction) if kind.rows[0] == "tilt_x" and pattern in _WITH_PHASE else ""
    return f"the residual {kind.subject} is {words}{phase}"


def _amplitude(law: Growth, kind: Channel) -> str:
    """Return how a residual depends on the motion, and its size."""
    mean = law.amplitude or 0.0
    if len(kind.rows) == 1:
        if law.pattern == "still":
            side = "above" if mean.real > 0 else "below"
            return f"the {kind.subject} is {size(abs(mean), kind.unit)} {side} the model"
        (amount,), unit = _amounts([mean.real], kind, law.pattern, sign=True)
        return f"{_subject(kind, law.pattern, mean)}: {amount} {unit}"
    text = _subject(kind, law.pattern, mean)
    if law.pattern == "still" and kind.rows[0] == "tilt_x":
        return text + _axes(mean, kind)
    (amount,), unit = _amounts([abs(mean)], kind, law.pattern)
    sign = "−" if law.pattern == "load" and mean.real < 0.0 else ""
    return f"{text}: {sign}{amount} {unit}{'' if law.uniform else ' on average'}"


def _with_speed(law: SpeedLaw | None, kind: Channel, pattern: str) -> str:
    """Return how an amplitude depends on the spin rate."""
    if law is None:
        return ""
    if law.constant:
        return ", the same at every speed"
    if law.exponent is not None and law.exponent_error is not None:
        verb = "growing" if law.exponent > 0 else "falling"
        return f", {verb} as {_power(law.exponent, law.exponent_error)}"
    (a, b), unit = _amounts([law.at_low, law.at_high], kind, pattern)
    return f", from {a} to {b} {unit} between {law.low / RPM:.0f} and {law.high / RPM:.0f} rpm"


def _ends(change: Change, kind: Channel) -> str:
    """Return the sizes at both ends of a change, and the variable that changes."""
    (a, b), unit = _amounts([change.at_low, change.at_high], kind, change.pattern)
    low, high = (_value(change.variable, v) for v in (change.low, change.high))
    return f"from {a} to {b} {unit} {_CHANGES[change.variable].format(low=low, high=high)}"


def _amounts(
    values: Sequence[float], kind: Channel, pattern: str, *, sign: bool = False
) -> tuple[list[str], str]:
    """Return amplitudes of a pattern as numbers, and the unit of them all."""
    name, scale = ("%", 1e-2) if pattern == "load" else unit_for(max(abs(v) for v in values), kind.unit)
    signed = sign or min(values) < 0.0
    return [number(v / scale, sign=signed) for v in values], f"{name}{_PER.get(pattern, '')}"


def _power(value: float, error: float) -> str:
    """Return a power of the speed with its error: ``Ω^1.9±0.2``."""
    digits = 1 if error >= 0.1 else 2
    return f"Ω^{value:.{digits}f}±{max(error, 0.01):.{digits}f}".replace("-", "−")


def _phase(slope: complex) -> str:
    """Return the phase of a torque that is proportional to the tilt."""
    angle = math.degrees(math.atan2(slope.imag, slope.real))
    if abs(angle) < 20.0:
        return " and in phase with it"
    if abs(abs(angle) - 180.0) < 20.0:
        return " and opposed to it"
    side = "ahead of" if angle > 0 else "behind"
    return f" and {abs(angle):.0f}° {side} it"


def _axes(value: complex, kind: Channel) -> str:
    """Return the components of a constant, where its axes mean something to people."""
    if kind.rows[0] != "tilt_x":
        return " in the rotor" if kind.rows[0].startswith("tilt") else ""
    name, scale = unit_for(abs(value), kind.unit)
    x, y = (number(v / scale, sign=True) for v in (value.real, value.imag))
    return f": {x} {name} about x and {y} about y"


def _value(variable: str, value: float) -> str:
    if variable in ("coils", "motor", "magnets"):
        return f"{value - 273.15:.0f}"
    return f"{value * 101.325:.0f}" if variable == "air" else f"{value:.0f}"
