"""What names and units of columns say: which reading a column may be, in which unit."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from typing import Final

from gyrowheel_core.errors import InputError
from gyrowheel_core.units import conversion
from gyrowheel_recording.mapping.map_file import READINGS

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
    "°c": "degC", "℃": "degC", "degc": "degC", "celsius": "degC", "c": "degC",
    "deg c": "degC", "grad c": "degC", "k": "K", "kelvin": "K",
    "1/min": "rpm", "u/min": "rpm", "upm": "rpm", "min-1": "rpm", "min^-1": "rpm", "tr/min": "rpm", "r/min": "rpm",
    "rev/min": "rpm", "rpm": "rpm",
    "rps": "turn/s", "1/s": "turn/s", "rev/s": "turn/s", "hz": "turn/s", "u/s": "turn/s",
    "radps": "rad/s", "rads": "rad/s", "rad/sec": "rad/s", "rad s-1": "rad/s",
    "rev": "turn", "revs": "turn", "revolutions": "turn", "turns": "turn", "u": "turn",
    "counts": "count", "cnt": "count", "ticks": "count", "inc": "count", "lsb": "count", "steps": "count",
    "sec": "s", "secs": "s", "second": "s", "seconds": "s",
    "sek": "s", "msec": "ms", "usec": "us", "µs": "us", "μs": "us",
    "vdc": "V", "v dc": "V", "adc": "A", "a dc": "A",
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
#: Brackets and signs of other widths, and words of other scripts, by those that are known here.
_WIDE: Final = str.maketrans(
    {"（": "(", "）": ")", "［": "[", "］": "]", "【": "[", "】": "]", "　": " ", "℃": "°C"}
)
_CHINESE: Final = {
    "时间": "time", "转速": "speed", "角速度": "rate", "倾角": "tilt", "倾斜": "tilt", "转角": "angle", "角度": "angle",
    "电压": "voltage", "电流": "current", "温度": "temperature", "气温": "air temperature",
    "室温": "room temperature",
    "气压": "air pressure", "压力": "pressure", "压强": "pressure",
    "线圈": "coil", "力矩器": "torquer", "电机": "motor",
    "马达": "motor", "转子": "rotor", "环境": "ambient", "空气": "air", "编码器": "encoder", "设定": "setpoint",
    "给定": "setpoint", "指令": "command",
}  # fmt: skip
_X: Final = frozenset({"x", "1", "roll", "alpha", "one"})
_Y: Final = frozenset({"y", "2", "pitch", "beta", "two"})
# fmt: off
_TILTS: Final = frozenset(
    [
        "tilt", "tilts", "phi", "kipp", "kippung", "kippwinkel", "neigung", "inclination", "inclinaison",
        "gimbal", "roll", "pitch", "alpha", "beta", "flexure", "neigungs",
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
        "spd", "revs", "w", "geschwindigkeit", "vel",
    ]
)
_ANGLES: Final = frozenset(
    [
        "angle", "enc", "encoder", "theta", "winkel", "position", "pos", "phase", "counts", "azimuth",
        "rotorangle", "geber", "codeur", "resolver",
    ]
)
_WHEELS: Final = frozenset(["spin", "rotor", "wheel", "rad", "shaft", "rotation", "dreh"])
_TEMPERATURES: Final = frozenset([
        "temp", "temperature", "temperatur", "thermo", "tc", "pt100", "pt", "ntc", "temperatures",
    ])
_AIRS: Final = frozenset([
        "air", "luft", "ambient", "room", "raum", "env", "environment", "lab", "amb", "outside", "gas", "ambiante",
        "umgebung", "umgebungs",
    ])
_PRESSURES: Final = frozenset(["press", "pressure", "druck", "baro", "pression", "p", "barometer", "patm"])
_TIMES: Final = frozenset(
    [
        "t", "time", "zeit", "temps", "timestamp", "stamp", "timestamps", "datetime", "seconds", "sec",
        "clock", "uhrzeit", "zeitstempel", "horodatage",
    ]
)
_COUNTS: Final = frozenset([
        "seq", "sequence", "sample", "index", "idx", "nr", "no", "number", "count", "counter", "samples",
        "row", "id",
    ])
_ASKED: Final = frozenset(
    [
        "set", "setpoint", "cmd", "command", "soll", "target", "ref", "reference", "demand", "desired", "sp",
        "commanded", "stellwert", "asked", "sollwert", "vorgabe", "consigne", "goal", "wanted", "request", "requested",
        "nominal", "simulated", "sim", "predicted", "expected", "model", "modell",
    ]
)
#: Ends of a range beside what is measured, unless the word is that of a unit: revolutions per min.
_EXTREMES: Final = frozenset(["min", "max", "minimum", "maximum", "limit", "limits", "threshold", "grenzwert"])
#: What a rate of a tilt is called, which is no tilt.
_RATES: Final = frozenset(
    [
        "rate", "rates", "velocity", "vel", "speed", "dot", "gyro", "omega", "geschwindigkeit", "vitesse",
        "acceleration", "accel", "acc", "derivative",
    ]
)
#: Quantities that are no reading: where they are named last, and wherever they are named.
_OTHERS: Final = frozenset(
    [
        "power", "leistung", "puissance", "resistance", "widerstand", "inductance", "flux", "quality", "status",
        "state", "mode", "flag", "fault", "alarm", "error", "err", "valid", "enable", "enabled", "duty", "pwm",
        "vibration", "strain", "ok",
    ]
)
_STATISTICS: Final = frozenset(["variance", "covariance", "std", "stddev", "sigma", "stdabw"])
#: Torques, unless they are the word for a coil whose voltage or current is meant.
_TORQUES: Final = frozenset(["torque", "torques", "moment", "force", "effort", "drehmoment", "kraft", "couple"])
#: Voltages, currents and pressures of what feeds the bench.
_SUPPLIES: Final = frozenset(
    [
        "supply", "bus", "battery", "batt", "mains", "rail", "psu", "netz", "versorgung", "versorgungs", "speisung",
        "zwischenkreis", "link", "alimentation", "logic", "excitation", "sensor", "bearing", "lager", "palier", "tank",
        "line",
    ]
)
#: Places whose temperature is neither that of the coils nor that of the air.
_ELSEWHERE: Final = frozenset(
    [
        "bearing", "lager", "palier", "housing", "gehause", "case", "pcb", "board", "cpu", "chip", "electronics",
        "elektronik", "amplifier", "driver", "verstarker", "inverter", "controller", "sensor", "imu", "gyro", "oil",
        "water", "coolant", "cooling", "magnet", "stator", "encoder", "table", "base", "plate", "frame", "junction",
        "cjc", "rotor", "wheel", "shaft",
    ]
)
#: What turns beside the rotor.
_TURNING: Final = frozenset(["table", "drehtisch", "tisch", "platform", "earth", "imu", "gyro", "case", "base"])
_WINDINGS: Final = frozenset(["winding", "windings", "wicklung", "wicklungs", "enroulement"])
_MEASURED: Final = frozenset(["ist", "istwert", "actual", "measured"])
_DIGITS: Final = frozenset(["1", "2", "one", "two"])
# fmt: on
#: Words for a motor, and not a letter that may be one.
_MACHINES: Final = _MOTORS - {"m"}
#: What is no unit, units of other quantities in one letter, and degrees behind the name of a thermometer.
_NONE: Final = frozenset(["none", "n/a", "na", "unitless", "dimensionless", "null", "nan"])
_SHORT: Final = frozenset(["%", "‰", "Ω", "W", "N", "T", "H", "F", "J"])
_DEGREES: Final = {"c": "degC", "k": "K", "f": "degF"}
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
    _ASKED,
    _MEASURED,
    _WINDINGS,
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


def unknown_unit(name: str, unit: str = "") -> str:
    """Return what stands as a unit beside a column, or in brackets behind its name, and is none that can be meant.

    Empty where there is no such thing.
    """
    texts = [unit.strip(), *_IN_BRACKETS.findall(_plain(name))]
    return next((text for text in texts if _like_a_unit(text) and not known_unit(text)), "")


def _like_a_unit(text: str) -> bool:
    """Whether a text may be meant as a unit: neither an axis, nor a number, nor a word for none."""
    if text in _SHORT:
        return True
    return len(text) > 1 and text[0].isalpha() and text.lower() not in _KNOWN | _NONE


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
    path = _IN_BRACKETS.sub(" ", _plain(name)).strip()
    cut = max(path.rfind("/"), path.rfind("."))
    ends = words
    if 0 <= cut < len(path) - 1:
        ends, _ = _words(path[cut + 1 :], own)
        clear = _fields(ends, own)
        # of a structure the part before says what the last one is of: `velocity.tilt_x` is no tilt
        before, _ = _words(re.split(r"[/.]", path[:cut])[-1], own)
        other = path[cut] == "." and set(before) & (_RATES | _TORQUES)
        if not other and (not fields or (set(ends) & (_X | _Y) and 3 in clear.values())):
            fields = clear
    every = set(words)
    if set(ends) & _OTHERS or every & _STATISTICS:
        fields = {}
    if every & (_MACHINES | _ELSEWHERE):  # a thermometer of something else
        fields = {field: clear for field, clear in fields.items() if field != TEMPERATURE}
    ended = bool(every & _EXTREMES) and not every & (_TIMES | {"per"})
    return Named(fields, own, bool(_ASKED & every) or ended)


def _plain(text: str) -> str:
    """Return a name with the letters, brackets and words that are known here: without accents, in Latin script."""
    text = text.translate(_WIDE)
    for own, other in _CHINESE.items():
        text = text.replace(own, f" {other} ")
    bases = [unicodedata.normalize("NFD", letter)[0] for letter in text]
    return "".join(base if base.isascii() else letter for base, letter in zip(bases, text, strict=True))


def _words(name: str, unit: str) -> tuple[list[str], str]:
    """Return the words of a name, in lower case and taken apart, and the unit in it or beside it."""
    name = _plain(name)
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
    if split and split[-1] in _DEGREES and set(split[:-1]) & _TEMPERATURES:  # air_temp_c
        own = own or _DEGREES[split[-1]]
        split = split[:-1]
    return split, own


def _split(word: str) -> list[str]:
    """Return a word, or the two known words that it is made of: ``ux``, ``tcoil``, ``motorstrom``."""
    if word in _KNOWN or not word.isalpha():
        return [word]
    for k in range(len(word) - 1, 0, -1):
        if word[:k] in _KNOWN and word[k:] in _KNOWN:
            return [word[:k], word[k:]]
    return [word]


def _axis(own: set[str]) -> str:
    """Return the axis that words name; none where a number is that of one of several motors, encoders or sensors."""
    x, y = own & _X, own & _Y
    several = _MACHINES | _WHEELS | _SPEEDS | _TEMPERATURES | _PRESSURES | {"enc", "encoder"}
    if (x | y) <= _DIGITS and own & several and not own & _TILTS:
        return ""
    return "x" if x and not y else "y" if y and not x else ""


def _fields(words: list[str], unit: str) -> dict[str, int]:
    own = set(words)
    result: dict[str, int] = {}
    axis = _axis(own)
    volts, amps = (
        bool(own & _VOLTS) or fits(unit, "motor_voltage"),
        bool(own & _AMPS) or fits(unit, "motor_current"),
    )
    if own & _TORQUES and not (volts or amps):
        return {}
    thermal = bool(own & _TEMPERATURES) or (bool(unit) and fits(unit, "air_temperature"))
    thermal = thermal or (not unit and "t" in own and bool(own & (_COILS | _AIRS)))
    fed = bool(own & _SUPPLIES) and not own & _MACHINES
    if axis and own & _RATES:
        pass  # of a tilt, or of the case
    elif axis and own & _TILTS:
        result[f"tilt_{axis}"] = 3
    elif (
        axis
        and not (own & (_COILS | _VOLTS | _AMPS))
        and (own & (_ANGLES - {"enc", "encoder"}) or unit in ("deg", "mrad"))
    ):
        result[f"tilt_{axis}"] = 1
    if axis and not own & _MACHINES and not fed:
        if own & _COILS and not amps and not thermal:
            result[f"coil_voltage_{axis}"] = 3
        elif volts and own & (_VOLTS | _COILS):
            result[f"coil_voltage_{axis}"] = 3 if own & _COILS else 2
        elif amps and own & (_AMPS | _COILS):
            result[f"coil_current_{axis}"] = 3 if own & _COILS else 2
    if axis and thermal and own & _COILS:
        result["coil_temperature"] = 2
    if not axis and not fed:
        if (own & (_MOTORS | _WHEELS) and (own & _VOLTS)) or (
            own & _MACHINES and fits(unit, "motor_voltage") and unit
        ):
            result["motor_voltage"] = 3
        elif own & _VOLTS and volts:
            result["motor_voltage"] = 1
        if (own & (_MOTORS | _WHEELS) and (own & _AMPS)) or (
            own & _MACHINES and unit and fits(unit, "motor_current")
        ):
            result["motor_current"] = 3
        elif own & _AMPS and amps:
            result["motor_current"] = 2
    if not axis:
        if (own & _SPEEDS or (unit and fits(unit, "spin_rate"))) and not own & (_TILTS | _TURNING):
            result["spin_rate"] = 3 if own & _WHEELS or len(own & _SPEEDS) or unit == "rpm" else 1
        if own & _ANGLES and not (own & _SPEEDS) and not thermal:
            result["spin_angle"] = 3 if own & (_WHEELS | {"enc", "encoder"}) else 2
        if thermal and (what := _thermometer(own)):
            result[what] = 3 if what != TEMPERATURE else 2
        if not fed and (own & _PRESSURES or (unit and fits(unit, "air_pressure"))):
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


def _thermometer(own: set[str]) -> str:
    """Return what a thermometer measures by the words of its name; empty where that is neither coils nor air."""
    elsewhere = own & (_MACHINES | _ELSEWHERE)
    if own & (_COILS - {"c"} | _WINDINGS):
        return "" if elsewhere else "coil_temperature"
    if own & _AIRS:
        return "air_temperature"
    if elsewhere:
        return ""
    return "coil_temperature" if "c" in own else TEMPERATURE
