"""Units: SI in the code, units of the laboratory for people, from one table."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from gyrowheel_core.errors import InputError, one_line

if TYPE_CHECKING:
    import pint

RPM: Final = 2.0 * math.pi / 60.0  #: one revolution per minute [rad/s]
DEG: Final = math.pi / 180.0  #: one degree [rad]


class Unit(NamedTuple):
    """A unit in which people read values: its label, and its size in the SI unit."""

    label: str
    size: float


#: Units for people by SI unit, largest first, each with the smallest magnitude that is shown in it (in SI).
#: An unlisted SI unit is kept.
_SHOWN: Final[dict[str, tuple[tuple[Unit, float], ...]]] = {
    "N*m": ((Unit("mN·m", 1e-3), 5e-5), (Unit("µN·m", 1e-6), 0.0)),
    "N*m*s": ((Unit("N·m·s", 1.0), 0.1), (Unit("mN·m·s", 1e-3), 0.0)),
    "V": ((Unit("V", 1.0), 0.5), (Unit("mV", 1e-3), 5e-5), (Unit("µV", 1e-6), 0.0)),
    "N*m/rad": ((Unit("mN·m/rad", 1e-3), 0.0),),
    "N*m*s/rad": ((Unit("µN·m·s/rad", 1e-6), 0.0),),
    "N*m/K": ((Unit("µN·m/K", 1e-6), 0.0),),
    "N*m/V": ((Unit("mN·m/V", 1e-3), 0.0),),
    "N*m/A": ((Unit("mN·m/A", 1e-3), 0.0),),
    "kg*m^2": ((Unit("mg·m²", 1e-6), 0.0),),
    "rad": ((Unit("deg", DEG), 2e-5), (Unit("µrad", 1e-6), 0.0)),
    "rad/s": ((Unit("rpm", RPM), 0.01), (Unit("deg/h", DEG / 3600.0), 0.0)),
    "s": ((Unit("s", 1.0), 0.01), (Unit("ms", 1e-3), 0.0)),
    "1/K": ((Unit("%/K", 1e-2), 0.0),),
    "1": ((Unit("%", 1e-2), 0.0),),
    "ohm": ((Unit("Ω", 1.0), 0.0),),
}
_COARSE: Final = (
    2e-3  # the smallest value of a column, in the column's unit: two digits behind the point still show it
)
#: A product of units, and the names in it that are known without a library.
_PRODUCT: Final = re.compile(r"(?:1|[A-Za-z]+(?:\^\d)?)(?:[*/][A-Za-z]+(?:\^\d)?)*")
#: A sign that is not that of an exponent.
_SIGNED: Final = re.compile(r"(?<!\^)(?<!\^\()(?<!\*\*)(?<!\*\*\()[+-]")
_NAMES: Final = re.compile(r"[A-Za-z]+")
_SI: Final = frozenset({"A", "K", "N", "Pa", "V", "kg", "m", "ohm", "rad", "s"})
#: Spellings of units in formulas and in texts.
_PLAIN: Final = str.maketrans({"·": "*", "²": "^2", "³": "^3"})


def unit_for(value: float, unit: str, *, pure: bool = False) -> Unit:
    """Return the unit in which people read a value.

    Parameters
    ----------
    value : float
        The value [SI]; a small one may get a smaller unit. Zero gets the largest.
    unit : str
        Its SI unit, with ``*`` or ``·`` between the factors; ``1`` or nothing for a number without unit.
    pure : bool
        Whether a number without unit is a pure number (an exponent), not a fraction that is read in per cent.
    """
    plain = unit.translate(_PLAIN) or "1"
    if plain == "1" and pure:
        return Unit("", 1.0)
    shown = _SHOWN.get(plain)
    if shown is None:
        return Unit(pretty(plain), 1.0)
    return next((u for u, least in shown if value == 0.0 or not abs(value) < least), shown[-1][0])


def column_unit(values: Iterable[float], unit: str) -> Unit:
    """Return the unit for a column of a table whose smallest magnitudes are these [SI]."""
    smallest = min((abs(value) for value in values), default=math.inf)
    shown = [u for u, _ in _SHOWN[unit.translate(_PLAIN)]]
    return next((u for u in shown if not smallest < _COARSE * u.size), shown[-1])


def pretty(unit: str) -> str:
    """Return an SI unit as texts spell it: ``N·m/rad³``."""
    return unit.replace("^2", "²").replace("^3", "³").replace("*", "·")


@functools.cache
def unit_registry() -> pint.UnitRegistry[Any]:
    """Return the one registry of units of the project."""
    import pint  # takes a while, and most commands convert nothing

    return pint.UnitRegistry()


def _parsed(unit: str) -> Any:
    """Return a unit of the library, which would pass over signs: +g is no unit."""
    if _SIGNED.search(unit):
        raise InputError("a unit has no sign")
    return unit_registry().parse_units(unit)


def require_unit(unit: str) -> None:
    """Refuse a text that is not a unit. Products of SI units, as the project writes them, need no library.

    Raises
    ------
    pint.PintError or InputError
        If it is not a unit.
    """
    if not (_PRODUCT.fullmatch(unit) and {*_NAMES.findall(unit)} <= _SI):
        _parsed(unit)


@functools.cache
def conversion(unit: str, needed: str) -> tuple[float, float]:
    """Return offset and factor that take values in a unit of a user to an SI unit: needed = factor * given + offset.

    Raises
    ------
    InputError
        If the unit is unknown, or of another kind. The message names no place.
    """
    if unit == needed:
        return 0.0, 1.0
    units = unit_registry()
    try:
        own, other = _parsed(unit), units.parse_units(needed)
    except Exception as error:  # pint raises several unrelated classes for a bad unit
        raise InputError(
            f"{unit!r} is no unit ({one_line(error)}); allowed: units such as {needed}"
        ) from None
    # a frequency counts revolutions to people, but radians to the library of units
    names = {
        name
        for part in dict(units.Quantity(1.0, own).unit_items())
        for _, name, _ in units.parse_unit_name(part)
    }
    if "hertz" in names and "rad" in needed:
        raise InputError(f"{unit!r} can be meant in two ways; allowed: units such as {needed}, rpm, turn/s")
    if own.dimensionality != other.dimensionality or "hertz" in names:
        raise InputError(f"{unit!r} cannot be converted; allowed: units such as {needed}")
    zero = float(units.Quantity(0.0, own).to(other).magnitude)
    return zero, float(units.Quantity(1.0, own).to(other).magnitude) - zero
