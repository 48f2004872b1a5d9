"""What an entry of the history keeps of the model before it: only what was different.

A copy of the whole model in every entry would let its file grow with the square of the number of changes, until it is
longer than any file that is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from gyrowheel_core.errors import InputError

#: The parts of a model file that a change may concern.
PARTS: Final = ("overrides", "effects")
_BACK, _ORDER = "back", "order"


def kept(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """Return what leads from a model back to the one before it.

    Of every override and effect that differs its values are kept, null for what was not there; and the order of a part
    where that is another one.

    Parameters
    ----------
    before, after : mapping
        Contents of two model files.
    """
    back: dict[str, Any] = {}
    order: dict[str, list[str]] = {}
    for part in PARTS:
        old, new = before[part], after[part]
        back[part] = {
            name: _entry(old.get(name), new.get(name))
            for name in {**old, **new}
            if old.get(name) != new.get(name)
        }
        if list(_merged(new, back[part])) != list(old):
            order[part] = list(old)
    result: dict[str, Any] = {_BACK: back} | ({_ORDER: order} if order else {})
    whole = {part: before[part] for part in PARTS}
    again = restored(after, result, "model")
    # names within an entry may have been in another order, and the file is to be as it was
    same = all(_order(again[part]) == _order(whole[part]) for part in PARTS)
    return result if again == whole and same else whole


def restored(after: Mapping[str, Any], undo: Any, where: str) -> dict[str, Any]:
    """Return overrides and effects as they were before a change, by what its entry has kept.

    Parameters
    ----------
    after : mapping
        The content of the model file with the change.
    undo : Any
        What was kept: that of `kept`, or overrides and effects as a whole, as earlier versions wrote them.
    where : str
        Where it stands, for the error.

    Raises
    ------
    InputError
        If it is missing, or is neither of the two.
    """
    if not isinstance(undo, Mapping):
        raise InputError(f"{where}: missing; cannot be undone")
    if _BACK not in undo:
        return dict(undo)
    back, order = undo[_BACK], undo.get(_ORDER) or {}
    if not all(
        isinstance(own, Mapping) and all(isinstance(own.get(part) or {}, kind) for part in PARTS)
        for own, kind in ((back, Mapping), (order, Mapping | list))
    ):
        raise InputError(f"{where}: is not what a change keeps; cannot be undone")
    found = {}
    for part in PARTS:
        merged = _merged(after[part], back.get(part) or {})
        first = [name for name in order.get(part) or () if isinstance(name, str) and name in merged]
        found[part] = {name: merged[name] for name in [*first, *merged]}
    return found


def _entry(old: Mapping[str, Any] | None, new: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return of an entry what has changed; all of it if it is gone, None if it was not there."""
    if old is None or new is None:
        return None if old is None else dict(old)
    return {key: old.get(key) for key in {**old, **new} if old.get(key) != new.get(key)}


def _merged(new: Mapping[str, Any], back: Mapping[str, Any]) -> dict[str, Any]:
    found = dict(new)
    for name, entry in back.items():
        if entry is None:
            found.pop(name, None)
        elif isinstance(entry, Mapping):
            own = {**found.get(name, {}), **entry}
            found[name] = {key: value for key, value in own.items() if value is not None}
        else:  # what is no entry is for the schema to refuse
            found[name] = entry
    return found


def _order(part: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    return [(name, list(entry)) for name, entry in part.items()]
