"""Named indices into flat arrays, as compiled code takes them."""

from __future__ import annotations

from enum import IntEnum


class Column(IntEnum):
    """An index into an array, with unit, meaning and, for a state, initial value.

    Subclasses list their members as ``name = (index, unit, description)`` or with a fourth item, the initial value: a
    number in SI units, or the name of a bench parameter.
    """

    unit: str
    description: str
    initial: float | str

    def __new__(cls, place: int, unit: str, description: str, initial: float | str = 0.0) -> Column:
        """Make the member of an index."""
        member = int.__new__(cls, place)
        member._value_ = place
        member.unit, member.description, member.initial = unit, description, initial
        return member


def names(columns: type[Column]) -> tuple[str, ...]:
    """Return the names of the indices, in order.

    Raises
    ------
    ValueError
        If the indices are not 0, 1, 2 ... in the order of their declaration.
    """
    if [int(column) for column in columns] != list(range(len(columns))):
        raise ValueError(f"{columns.__name__}: the indices are not 0 .. {len(columns) - 1} in order")
    return tuple(column.name for column in columns)


def source(columns: type[Column]) -> str:
    """Return the indices as source for compiled code, which takes only names and numbers."""
    lines = [f"    {name} = {place}" for place, name in enumerate(names(columns))]
    return "\n".join([f"class {columns.__name__}(IntEnum):", *lines]) + "\n"
