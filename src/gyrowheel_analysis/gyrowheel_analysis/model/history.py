"""The history of a model: differences between two models, and what an entry keeps of the model before it.

An entry keeps only what was different: a copy of the whole model in every entry would let its file grow with the square
of the number of changes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from gyrowheel_core.errors import InputError


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Return what differs between the contents of two model files, a line each; histories are not compared.

    A line begins with ``+`` for what is new, ``-`` for what is gone and ``~`` for what has changed.
    """
    lines = []
    old, new = dict(_flat(before)), dict(_flat(after))
    for key in [*old, *(k for k in new if k not in old)]:
        if key not in new:
            lines.append(f"- {key}: {old[key]}")
        elif key not in old:
            lines.append(f"+ {key}: {new[key]}")
        elif old[key] != new[key]:
            lines.append(f"~ {key}: {old[key]} -> {new[key]}")
    return lines


def _flat(content: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield "bench", str(content["bench"])
    for part in ("overrides", "effects"):
        for name, entry in content[part].items():
            if "declaration" in entry:
                for key, value in _flat_declaration(entry["declaration"]):
                    yield f"{part}.{name}.{key}", value
                entry = {key: value for key, value in entry.items() if key != "declaration"}
            items = {"": entry} if "value" in entry else {f".{key}": value for key, value in entry.items()}
            for key, value in items.items():
                yield f"{part}.{name}{key}", f"{value['value']:.6g} ± {value['standard_error']:.2g}"


def _flat_declaration(content: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        if isinstance(value, dict):
            for inner, text in _flat_declaration(value):
                yield f"{key}.{inner}", text
        else:
            yield key, str(value)


#: The parts of a model file that a change may concern.
PARTS: Final = ("overrides", "effects")
_BACK, _ORDER = "back", "order"


def kept(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """Return the changes that lead from a model back to the one before it.

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
        Result of `kept`, or overrides and effects as a whole, as earlier versions wrote them.
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
