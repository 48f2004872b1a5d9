"""Places in an array by name: the compiled code takes flat arrays, and nobody should count their columns."""

from __future__ import annotations

from enum import IntEnum


class Column(IntEnum):
    """A place in an array, with its unit, its meaning and, for a state, its value at the start.

    Subclasses list their members as ``name = (place, unit, description)`` or with a fourth item, the initial value: a
    number in SI units, or the name of a bench parameter.
    """

    unit: str
    description: str
    initial: float | str

    def __new__(cls, place: int, unit: str, description: str, initial: float | str = 0.0) -> Column:
        """Make the member of a place."""
        member = int.__new__(cls, place)
        member._value_ = place
        member.unit, member.description, member.initial = unit, description, initial
        return member


def names(columns: type[Column]) -> tuple[str, ...]:
    """Return the names of the places, in order.

    Raises
    ------
    ValueError
        If the places are not 0, 1, 2 ... in the order in which they are listed.
    """
    if [int(column) for column in columns] != list(range(len(columns))):
        raise ValueError(f"{columns.__name__}: the places are not 0 .. {len(columns) - 1} in order")
    return tuple(column.name for column in columns)


def source(columns: type[Column]) -> str:
    """Return the same places as source for compiled code, which takes names and numbers alone."""
    lines = [f"    {name} = {place}" for place, name in enumerate(names(columns))]
    return "\n".join([f"class {columns.__name__}(IntEnum):", *lines]) + "\n"
