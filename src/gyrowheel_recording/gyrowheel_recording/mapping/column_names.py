"""Meaning of names and units of columns: which reading a column may be, in which unit."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from gyrowheel_core.errors import InputError
from gyrowheel_core.units import conversion
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_recording.mapping.map_file import READINGS

#: Fields that a table may have next to the readings.
TIME: Final = "time"
SEQUENCE: Final = "sequence"
#: A thermometer whose name does not say what it measures.
TEMPERATURE: Final = "temperature"
#: Current of a coil, in place of its voltage.
COIL_CURRENT: Final = ("coil_current_x", "coil_current_y")
UNITS: Final = {
    TIME: "s",
    **{name: reading.unit for name, reading in READINGS.items()},
    TEMPERATURE: "K",
    **dict.fromkeys(COIL_CURRENT, "A"),
}
_FILE: Final = Path(__file__).with_suffix(".yaml")
_DICTIONARY: Final[dict[str, Any]] = read_yaml(_FILE.read_text(encoding="utf-8"), str(_FILE))
_SPELLINGS: Final = {text: unit for unit, texts in _DICTIONARY["units"].items() for text in texts}
_WORDS: Final = {subject: frozenset(words) for subject, words in _DICTIONARY["words"].items()}
_DEGREES: Final[dict[str, str]] = _DICTIONARY["degrees"]
#: Names of the inputs of acquisition devices, which have numbers behind them.
INPUTS: Final = frozenset[str](_DICTIONARY["inputs"])
_WIDE: Final = str.maketrans(_DICTIONARY["wide"])
_IN_BRACKETS: Final = re.compile(r"[\[({<]\s*([^\[\](){}<>]*?)\s*[\])}>]")
_TOKENS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-zäöüéè]+|\d+|[°µμΩφϕθϑωα-β]")
_DIGITS: Final = frozenset(["1", "2", "one", "two"])
_ENCODERS: Final = frozenset(["enc", "encoder"])
#: Words for a motor, without the letter that may be one.
_MACHINES: Final = _WORDS["motor"] - {"m"}
#: Words into which a compound is split.
_KNOWN: Final = frozenset[str]().union(
    *(_WORDS[subject] for subject in (
        "x", "y", "tilt", "coil", "motor", "volt", "ampere", "speed", "angle", "wheel", "temperature", "air",
        "pressure", "time", "commanded", "measured", "winding",
    ))
)  # fmt: skip


@dataclass(frozen=True)
class Meaning:
    """Meaning of the name of a column."""

    fields: dict[str, int]  # fields that it may be, each with how clearly the name says so (1 .. 3)
    unit: str  # unit in the name or stated by the file, as pint knows it; empty where none is known
    commanded: bool  # whether it is a commanded or predicted value, and not a measured one


def known_unit(text: str) -> str:
    """Return a unit as pint knows it; empty where the text is no unit."""
    plain = text.strip().strip("[](){}").strip()
    if not plain or plain in ("-", "1"):
        return ""
    spelled = _SPELLINGS.get(plain.lower(), "")
    if spelled and plain not in ("MV", "U"):
        return spelled
    if any(_converts(plain, needed) for needed in ("s", "rad", "rad/s", "V", "A", "K", "Pa")):
        return plain
    return ""


def unknown_unit(name: str, unit: str = "") -> str:
    """Return the unit stated for a column, or in brackets after its name, if no field can have it; else empty."""
    texts = [unit.strip(), *_IN_BRACKETS.findall(_plain(name))]
    return next((text for text in texts if _resembles_unit(text) and not known_unit(text)), "")


def fits(unit: str, field: str) -> bool:
    """Whether a unit can be that of a field."""
    if field == SEQUENCE or unit == "count":
        return (field == SEQUENCE) == (unit in ("", "count")) or field == "spin_angle"
    return _converts(unit, UNITS[field])


def meaning_of(name: str, unit: str = "") -> Meaning:
    """Return the meaning of a column's name and of the unit that its file states.

    Of a path the last part counts most: where it clearly names a channel of an axis, or the path means nothing, it
    alone counts. Otherwise the folder may have the word that it lacks.
    """
    words, own = _words(name, unit)
    fields = _fields(words, own)
    path = _IN_BRACKETS.sub(" ", _plain(name)).strip()
    cut = max(path.rfind("/"), path.rfind("."))
    ends = words
    if 0 <= cut < len(path) - 1:
        ends, _ = _words(path[cut + 1 :], own)
        clear = _fields(ends, own)
        # in a structure the part before qualifies the last one: `velocity.tilt_x` is no tilt
        before, _ = _words(re.split(r"[/.]", path[:cut])[-1], own)
        other = path[cut] == "." and set(before) & (_WORDS["rate"] | _WORDS["torque"])
        whole = _has(set(ends), "x", "y", "volt", "ampere")
        if not other and (not fields or (whole and 3 in clear.values())):
            fields = clear
    every = set(words)
    if _has(set(ends), "other") or _has(every, "statistic"):
        fields = {}
    if every & _MACHINES or _has(every, "elsewhere"):  # a thermometer of something else
        fields = {field: clear for field, clear in fields.items() if field != TEMPERATURE}
    extreme = _has(every, "extreme") and not (_has(every, "time") or "per" in every)
    return Meaning(fields, own, _has(every, "commanded") or extreme)


def _has(own: set[str], *subjects: str) -> bool:
    """Whether one of the words belongs to one of the subjects."""
    return any(own & _WORDS[subject] for subject in subjects)


def _converts(unit: str, needed: str) -> bool:
    try:
        conversion(unit, needed)
    except InputError:
        return False
    return True


def _resembles_unit(text: str) -> bool:
    """Whether a text may be meant as a unit: neither an axis, nor a number, nor a word for no unit."""
    if text in _DICTIONARY["short_units"]:
        return True
    return (
        len(text) > 1
        and text[0].isalpha()
        and text.lower() not in _KNOWN
        and text.lower() not in _DICTIONARY["no_unit"]
    )


def _plain(text: str) -> str:
    """Return a name with known letters, brackets and words only: without accents, in Latin script."""
    text = text.translate(_WIDE)
    for own, other in _DICTIONARY["chinese"].items():
        text = text.replace(own, f" {other} ")
    bases = [unicodedata.normalize("NFD", letter)[0] for letter in text]
    return "".join(base if base.isascii() else letter for base, letter in zip(bases, text, strict=True))


def _words(name: str, unit: str) -> tuple[list[str], str]:
    """Return the words of a name, in lower case and split, and the unit in it or stated for it."""
    name = _plain(name)
    bracket = next((known_unit(found) for found in _IN_BRACKETS.findall(name) if known_unit(found)), "")
    plain = _IN_BRACKETS.sub(" ", name)
    greek = _DICTIONARY["greek"]
    words = [greek.get(word, word).lower() for word in _TOKENS.findall(plain)]
    own = known_unit(unit) or bracket
    last = re.split(r"[\s_.]+", plain.strip())[-1]
    if not own and len(words) > 1 and last.lower() not in _DICTIONARY["no_units_in_names"]:
        own = known_unit(last)
        if own:
            words = words[: -len(_TOKENS.findall(last))] + (["rpm"] if own == "rpm" else [])
    split = [part for word in words for part in _split(word)]
    if split and split[-1] in _DEGREES and _has(set(split[:-1]), "temperature"):  # air_temp_c
        own = own or _DEGREES[split[-1]]
        split = split[:-1]
    return split, own


def _split(word: str) -> list[str]:
    """Return a word, or the two known words of which it consists: ``ux``, ``tcoil``, ``motorstrom``."""
    if word in _KNOWN or not word.isalpha():
        return [word]
    for k in range(len(word) - 1, 0, -1):
        if word[:k] in _KNOWN and word[k:] in _KNOWN:
            return [word[:k], word[k:]]
    return [word]


def _axis(own: set[str]) -> str:
    """Return the axis that words name; empty where a number is that of one of several motors, encoders or sensors."""
    x, y = own & _WORDS["x"], own & _WORDS["y"]
    several = own & (_MACHINES | _ENCODERS) or _has(own, "wheel", "speed", "temperature", "pressure")
    if (x | y) <= _DIGITS and several and not _has(own, "tilt"):
        return ""
    return "x" if x and not y else "y" if y and not x else ""


@dataclass(frozen=True)
class _Name:
    """Words and unit of a name, and which physical quantities they allow."""

    own: set[str]
    unit: str
    axis: str
    volts: bool
    amperes: bool
    thermal: bool
    supplied: bool  # of what feeds the bench

    @classmethod
    def of(cls, words: list[str], unit: str) -> _Name:
        own = set(words)
        thermal = _has(own, "temperature") or (bool(unit) and fits(unit, "air_temperature"))
        return cls(
            own,
            unit,
            _axis(own),
            _has(own, "volt") or fits(unit, "motor_voltage"),
            _has(own, "ampere") or fits(unit, "motor_current"),
            thermal or (not unit and "t" in own and _has(own, "coil", "air")),
            _has(own, "supply") and not own & _MACHINES,
        )

    def has(self, *subjects: str) -> bool:
        return _has(self.own, *subjects)

    def stated_as(self, field: str) -> bool:
        """Whether a unit is stated, and fits a field."""
        return bool(self.unit) and fits(self.unit, field)


def _fields(words: list[str], unit: str) -> dict[str, int]:
    """Return the fields that words and unit may mean, each with how clearly (1 .. 3)."""
    name = _Name.of(words, unit)
    if name.has("torque") and not (name.volts or name.amperes):
        return {}
    found = _of_axis(name) if name.axis else _of_motor(name) | _of_spin(name) | _of_air(name)
    found |= _of_rows(name, words)
    # the unit that is stated rules out what has another one
    return {
        field: clear for field, clear in found.items() if not unit or field == SEQUENCE or fits(unit, field)
    }


def _of_axis(name: _Name) -> dict[str, int]:
    """Return tilt and coil of the axis that a name has."""
    found: dict[str, int] = {}
    axis, coil = name.axis, name.has("coil")
    if name.has("rate"):
        pass  # of a tilt, or of the case
    elif name.has("tilt"):
        found[f"tilt_{axis}"] = 3
    elif not name.has("coil", "volt", "ampere") and (
        name.own & (_WORDS["angle"] - _ENCODERS) or name.unit in ("deg", "mrad")
    ):
        found[f"tilt_{axis}"] = 1
    if not name.own & _MACHINES and not name.supplied:
        if coil and not name.amperes and not name.thermal:
            found[f"coil_voltage_{axis}"] = 3
        elif name.volts and name.has("volt", "coil"):
            found[f"coil_voltage_{axis}"] = 3 if coil else 2
        elif name.amperes and name.has("ampere", "coil"):
            found[f"coil_current_{axis}"] = 3 if coil else 2
    if name.thermal and coil:
        found["coil_temperature"] = 2
    return found


def _of_motor(name: _Name) -> dict[str, int]:
    found: dict[str, int] = {}
    if name.supplied:
        return found
    for subject, field, allowed, unclear in (
        ("volt", "motor_voltage", name.volts, 1),
        ("ampere", "motor_current", name.amperes, 2),
    ):
        named = name.has("motor", "wheel") and name.has(subject)
        if named or (name.own & _MACHINES and name.stated_as(field)):
            found[field] = 3
        elif name.has(subject) and allowed:
            found[field] = unclear
    return found


def _of_spin(name: _Name) -> dict[str, int]:
    found: dict[str, int] = {}
    speed = name.has("speed")
    if (speed or name.stated_as("spin_rate")) and not name.has("tilt", "turning"):
        found["spin_rate"] = 3 if name.has("wheel") or speed or name.unit == "rpm" else 1
    if name.has("angle") and not speed and not name.thermal:
        found["spin_angle"] = 3 if name.has("wheel") or name.own & _ENCODERS else 2
    return found


def _of_air(name: _Name) -> dict[str, int]:
    """Return the thermometer or barometer that a name has."""
    found: dict[str, int] = {}
    if name.thermal and (measured := _thermometer(name.own)):
        found[measured] = 3 if measured != TEMPERATURE else 2
    if not name.supplied and (name.has("pressure") or name.stated_as("air_pressure")):
        found["air_pressure"] = 3
    return found


def _of_rows(name: _Name, words: list[str]) -> dict[str, int]:
    """Return time and number of the rows."""
    found: dict[str, int] = {}
    if name.has("time") and not name.has("coil", "air", "motor") and (not name.unit or fits(name.unit, TIME)):
        found[TIME] = 3 if name.own & (_WORDS["time"] - {"t", "x"}) or words == ["t"] else 1
    elif name.stated_as(TIME):
        found[TIME] = 2
    if name.has("count") and not name.unit:
        found[SEQUENCE] = 2
    return found


def _thermometer(own: set[str]) -> str:
    """Return what a thermometer measures by the words of its name; empty where that is neither coils nor air."""
    elsewhere = own & _MACHINES or _has(own, "elsewhere")
    if own & (_WORDS["coil"] - {"c"}) or _has(own, "winding"):
        return "" if elsewhere else "coil_temperature"
    if _has(own, "air"):
        return "air_temperature"
    if elsewhere:
        return ""
    return "coil_temperature" if "c" in own else TEMPERATURE
