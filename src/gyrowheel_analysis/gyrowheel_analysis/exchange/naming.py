"""What names and units of columns say: which reading a column may be, in which unit."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from gyrowheel_analysis.exchange.fields import READINGS
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import conversion

#: Fields beside the readings that a table may have.
TIME: Final = "time"
SEQUENCE: Final = "sequence"
#: A thermometer of which the name does not say what it measures.
TEMPERATURE: Final = "temperature"
#: Current of a coil, in place of its voltage.
COIL_CURRENT: Final = ("coil_current_x", "coil_current_y")
UNITS: Final = {
    TIME: "s",
    **{name: reading.unit for name, reading in READINGS.items()},
    TEMPERATURE: "K",
    **dict.fromkeys(COIL_CURRENT, "A"),
}
#: Spellings of units, in lower case, as pint knows them.
_SPELLINGS: Final = {
    "°": "deg", "grad": "deg", "degree": "deg", "degrees": "deg", "degre": "deg", "deg.": "deg",
    "°/s": "deg/s", "dps": "deg/s", "grad/s": "deg/s", "degps": "deg/s",
    "°c": "degC", "degc": "degC", "celsius": "degC", "c": "degC",
    "deg c": "degC", "grad c": "degC", "k": "K", "kelvin": "K",
    "1/min": "rpm", "u/min": "rpm", "upm": "rpm", "min-1": "rpm", "min^-1": "rpm", "tr/min": "rpm", "r/min": "rpm",
    "rev/min": "rpm", "rpm": "rpm",
    "rps": "turn/s", "1/s": "turn/s", "rev/s": "turn/s", "hz": "turn/s", "u/s": "turn/s",
    "radps": "rad/s", "rads": "rad/s", "rad/sec": "rad/s", "rad s-1": "rad/s",
    "rev": "turn", "revs": "turn", "revolutions": "turn", "turns": "turn", "u": "turn",
    "counts": "count", "cnt": "count", "ticks": "count", "inc": "count", "lsb": "count", "steps": "count",
    "sec": "s", "secs": "s", "second": "s", "seconds": "s",
    "sek": "s", "msec": "ms", "usec": "us", "µs": "us", "μs": "us",
    "v": "V", "mv": "mV", "volt": "V", "volts": "V", "millivolt": "mV", "µv": "uV", "uv": "uV", "kv": "kV",
    "a": "A", "ma": "mA", "amp": "A", "amps": "A", "ampere": "A", "µa": "uA", "ua": "uA",
    "pa": "Pa", "hpa": "hPa", "kpa": "kPa", "mbar": "mbar", "bar": "bar", "mmhg": "mmHg", "torr": "torr",
    "rad": "rad", "mrad": "mrad", "urad": "urad", "µrad": "urad", "deg": "deg", "arcmin": "arcmin", "arcsec": "arcsec",
    "s": "s", "ms": "ms", "us": "us", "ns": "ns", "min": "min", "rad/s": "rad/s", "deg/s": "deg/s", "mrad/s": "mrad/s",
}  # fmt: skip
#: Spellings of units that are an axis, a machine or a quantity at the end of a name.
_NO_UNITS: Final = frozenset(["x", "y", "u", "c", "k", "t", "p", "n", "i", "w", "min"])
_IN_BRACKETS: Final = re.compile(r"[\[({<]\s*([^\[\](){}<>]*?)\s*[\])}>]")
_TOKENS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-zäöüéè]+|\d+|[°µμΩφϕθϑωα-β]")
_GREEK: Final = {
    "φ": "phi",
    "ϕ": "phi",
    "θ": "theta",
    "ϑ": "theta",
    "ω": "omega",
    "Ω": "omega",
    "α": "alpha",
    "β": "beta",
}
_X: Final = frozenset({"x", "1", "roll", "alpha", "one"})
_Y: Final = frozenset({"y", "2", "pitch", "beta", "two"})
# fmt: off
_TILTS: Final = frozenset(
    [
        "tilt", "tilts", "phi", "kipp", "kippung", "kippwinkel", "neigung", "inclination", "inclinaison",
        "gimbal", "roll", "pitch", "alpha", "beta", "flexure",
    ]
)
_COILS: Final = frozenset([
        "coil", "coils", "spule", "spulen", "torquer", "torquers", "tq", "bobine", "forcer", "c",
    ])
_MOTORS: Final = frozenset(["motor", "mot", "moteur", "drive", "spindle", "antrieb", "m", "bldc"])
_VOLTS: Final = frozenset(["u", "v", "volt", "volts", "voltage", "spannung", "tension", "voltages", "uv"])
_AMPS: Final = frozenset(["i", "current", "strom", "courant", "amp", "amps", "curr"])
_SPEEDS: Final = frozenset(
    [
        "speed", "rate", "omega", "rpm", "drehzahl", "velocity", "vitesse", "spinrate", "tacho", "tach", "n",
        "spd", "revs", "w",
    ]
)
_ANGLES: Final = frozenset(
    [
        "angle", "enc", "encoder", "theta", "winkel", "position", "pos", "phase", "counts", "azimuth",
        "rotorangle",
    ]
)
_WHEELS: Final = frozenset(["spin", "rotor", "wheel", "rad", "shaft", "rotation"])
_TEMPERATURES: Final = frozenset([
        "temp", "temperature", "temperatur", "thermo", "tc", "pt100", "pt", "ntc", "temperatures",
    ])
_AIRS: Final = frozenset([
        "air", "luft", "ambient", "room", "raum", "env", "environment", "lab", "amb", "outside", "gas",
    ])
_PRESSURES: Final = frozenset(["press", "pressure", "druck", "baro", "pression", "p", "barometer", "patm"])
_TIMES: Final = frozenset(
    [
        "t", "time", "zeit", "temps", "timestamp", "stamp", "timestamps", "datetime", "seconds", "sec",
        "clock", "uhrzeit",
    ]
)
_COUNTS: Final = frozenset([
        "seq", "sequence", "sample", "index", "idx", "nr", "no", "number", "count", "counter", "samples",
        "row", "id",
    ])
_ASKED: Final = frozenset(
    [
        "set", "setpoint", "cmd", "command", "soll", "target", "ref", "reference", "demand", "desired", "sp",
        "commanded", "stellwert", "asked",
    ]
)
# fmt: on
_KNOWN: Final = frozenset[str]().union(
    _X,
    _Y,
    _TILTS,
    _COILS,
    _MOTORS,
    _VOLTS,
    _AMPS,
    _SPEEDS,
    _ANGLES,
    _WHEELS,
    _TEMPERATURES,
    _AIRS,
    _PRESSURES,
    _TIMES,
)


@dataclass(frozen=True)
class Named:
    """What the name of a column says.

    Attributes
    ----------
    fields : dict of str to int
        Fields that it may be, each with how clearly the name says so (1 .. 3).
    unit : str
        Unit in it or beside it, as pint knows it; empty where none is known.
    asked : bool
        Whether it is what was asked for, not what was measured.
    """

    fields: dict[str, int]
    unit: str
    asked: bool


def known_unit(text: str) -> str:
    """Return a unit as pint knows it; empty where the text is none."""
    plain = text.strip().strip("[](){}").strip()
    if not plain or plain in ("-", "1"):
        return ""
    spelled = _SPELLINGS.get(plain.lower(), "")
    if spelled and plain not in ("MV", "U"):
        return spelled
    for needed in ("s", "rad", "rad/s", "V", "A", "K", "Pa"):
        try:
            conversion(plain, needed)
        except InputError:
            continue
        return plain
    return ""


def unknown_unit(name: str) -> str:
    """Return what stands in brackets behind a name as a unit, and is none; empty where there is no such thing."""
    texts = [text for text in _IN_BRACKETS.findall(name) if len(text) > 1 and text.lower() not in _KNOWN]
    return next((text for text in texts if text[0].isalpha() and not known_unit(text)), "")


def fits(unit: str, field: str) -> bool:
    """Whether a unit can be that of a field."""
    if field == SEQUENCE or unit == "count":
        return (field == SEQUENCE) == (unit in ("", "count")) or field == "spin_angle"
    try:
        conversion(unit, UNITS[field])
    except InputError:
        return False
    return True


def named(name: str, unit: str = "") -> Named:
    """Return what a name and the unit that a file states say of a column.

    Of a path the last part counts most: where it clearly names a channel of an axis, or the path says nothing, it
    alone counts. Otherwise the folder may hold the word that it lacks.
    """
    words, own = _words(name, unit)
    fields = _fields(words, own)
    last = name[max(name.rfind("/"), name.rfind(".")) + 1 :]
    if last and last != name:
        ends, _ = _words(last, own)
        clear = _fields(ends, own)
        if not fields or (set(ends) & (_X | _Y) and 3 in clear.values()):
            fields = clear
    return Named(fields, own, bool(_ASKED & set(words)))


def _words(name: str, unit: str) -> tuple[list[str], str]:
    """Return the words of a name, in lower case and taken apart, and the unit in it or beside it."""
    bracket = next((known_unit(found) for found in _IN_BRACKETS.findall(name) if known_unit(found)), "")
    plain = _IN_BRACKETS.sub(" ", name)
    words = [_GREEK.get(word, word).lower() for word in _TOKENS.findall(plain)]
    own = known_unit(unit) or bracket
    last = re.split(r"[\s_.]+", plain.strip())[-1]
    if not own and len(words) > 1 and last.lower() not in _NO_UNITS and known_unit(last):
        own = known_unit(last)
        gone = len(_TOKENS.findall(last))
        words = words[:-gone] + (["rpm"] if own == "rpm" else [])
    split: list[str] = []
    for word in words:
        split += _split(word)
    return split, own


def _split(word: str) -> list[str]:
    """Return a word, or the two known words that it is made of: ``ux``, ``tcoil``, ``motorstrom``."""
    if word in _KNOWN or not word.isalpha():
        return [word]
    for k in range(len(word) - 1, 0, -1):
        if word[:k] in _KNOWN and word[k:] in _KNOWN:
            return [word[:k], word[k:]]
    return [word]


def _fields(words: list[str], unit: str) -> dict[str, int]:
    own = set(words)
    result: dict[str, int] = {}
    axis = "x" if own & _X and not own & _Y else "y" if own & _Y and not own & _X else ""
    volts, amps = (
        bool(own & _VOLTS) or fits(unit, "motor_voltage"),
        bool(own & _AMPS) or fits(unit, "motor_current"),
    )
    thermal = bool(own & _TEMPERATURES) or (bool(unit) and fits(unit, "air_temperature"))
    thermal = thermal or (not unit and "t" in own and bool(own & (_COILS | _AIRS)))
    if axis and own & _TILTS:
        result[f"tilt_{axis}"] = 3
    elif (
        axis
        and not (own & (_COILS | _VOLTS | _AMPS))
        and (own & (_ANGLES - {"enc", "encoder"}) or unit in ("deg", "mrad"))
    ):
        result[f"tilt_{axis}"] = 1
    if axis and not own & (_MOTORS - {"m"}):
        if own & _COILS and not amps and not thermal:
            result[f"coil_voltage_{axis}"] = 3
        elif volts and own & (_VOLTS | _COILS):
            result[f"coil_voltage_{axis}"] = 3 if own & _COILS else 2
        elif amps and own & (_AMPS | _COILS):
            result[f"coil_current_{axis}"] = 3 if own & _COILS else 2
    if not axis:
        if (own & (_MOTORS | _WHEELS) and (own & _VOLTS)) or (
            own & (_MOTORS - {"m"}) and fits(unit, "motor_voltage") and unit
        ):
            result["motor_voltage"] = 3
        elif own & _VOLTS and volts:
            result["motor_voltage"] = 1
        if (own & (_MOTORS | _WHEELS) and (own & _AMPS)) or (
            own & (_MOTORS - {"m"}) and unit and fits(unit, "motor_current")
        ):
            result["motor_current"] = 3
        elif own & _AMPS and amps:
            result["motor_current"] = 2
        if own & _SPEEDS or (unit and fits(unit, "spin_rate")):
            result["spin_rate"] = 3 if own & _WHEELS or len(own & _SPEEDS) or unit == "rpm" else 1
        if own & _ANGLES and not (own & _SPEEDS):
            result["spin_angle"] = 3 if own & (_WHEELS | {"enc", "encoder"}) else 2
        if thermal:
            what = (
                "coil_temperature"
                if own & (_COILS | {"winding", "c"})
                else "air_temperature"
                if own & _AIRS
                else TEMPERATURE
            )
            result[what] = 3 if what != TEMPERATURE else 2
        if own & _PRESSURES or (unit and fits(unit, "air_pressure")):
            result["air_pressure"] = 3
    if own & _TIMES and not own & (_COILS | _AIRS | _MOTORS) and (not unit or fits(unit, TIME)):
        result[TIME] = 3 if own & (_TIMES - {"t", "x"}) or words == ["t"] else 1
    elif unit and fits(unit, TIME):
        result[TIME] = 2
    if own & _COUNTS and not unit:
        result[SEQUENCE] = 2
    # the unit that is stated rules out what has another one
    return {
        field: clear for field, clear in result.items() if not unit or field == SEQUENCE or fits(unit, field)
    }
