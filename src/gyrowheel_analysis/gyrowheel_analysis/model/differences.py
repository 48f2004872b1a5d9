"""What differs between two models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


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
