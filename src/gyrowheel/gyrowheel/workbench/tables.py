"""Tables of other programs: a map is suggested, corrected and tried; then the table becomes a recording."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gyrowheel.models.api import Model
from gyrowheel.recordings.api import Recording, wrong_setups
from gyrowheel.show.figure import png_bytes
from gyrowheel.show.sentences.setup import map_lines, problem
from gyrowheel.tables.api import read_table, suggest_map
from gyrowheel_core.errors import InputError
from gyrowheel_core.quantities import short
from gyrowheel_recording.mapping.map_file import READINGS

#: Largest table from a browser [bytes].
LARGEST = 256 << 20
_LONGEST_NAME = 120  # bytes
_TIME = "time"
#: Parts of a map that the form can correct.
PARTS = ("column", "unit", "scale")


@dataclass(frozen=True)
class Draft:
    """A table and its current map."""

    number: int  # of the reading, for the address of the picture
    name: str  # of the file
    file: Path  # its temporary place
    kind: str  # format
    columns: tuple[str, ...]
    content: Mapping[str, Any]  # the map
    reasons: Mapping[str, str] = field(default_factory=dict)  # of the suggested columns
    questions: tuple[str, ...] = ()  # to be answered by the user
    remarks: tuple[str, ...] = ()
    picture: bytes = b""  # the measured signals as PNG; empty if the table cannot be read

    def rows(self) -> list[dict[str, str]]:
        """Return the rows of the form: time and every reading."""
        rows = []
        for name in (_TIME, *READINGS):
            source = self.content.get(_TIME) if name == _TIME else self.content.get("columns", {}).get(name)
            given = source or {}
            constant = f"{short(given['value'])} {given.get('unit', '')}" if "value" in given else ""
            rows.append(
                {
                    "field": name,
                    "column": given.get("column", ""),
                    "unit": given.get("unit", "") if given.get("column") else "",
                    "scale": repr(given["scale"]) if "scale" in given else "",
                    "si": "s" if name == _TIME else READINGS[name].unit,
                    "reason": f"constant {constant}" if constant else self.reasons.get(name, ""),
                }
            )
        return rows


def file_name(text: str) -> str:
    """Return the name of an uploaded file as a safe file name; InputError if no character of it is allowed."""
    name = "".join(c if c.isalnum() or c in "._- " else "_" for c in Path(text).name)
    name = name.encode()[-_LONGEST_NAME:].decode(errors="ignore").strip(". ")
    if not name:
        raise InputError(f"name: {text[:40]!r} is no file name")
    return name


def looked(number: int, file: Path, model: Model) -> Draft:
    """Return a table with a suggested map, for the bench of a model."""
    try:
        found = suggest_map(file, bench=model.bench_source)
    except InputError as error:
        raise InputError(_said(error, file)) from None
    d = found.suggestion
    used = [name for own in d.proposals for name in (own.column, own.clock) if name]
    return Draft(
        number,
        file.name,
        file,
        d.kind,
        tuple(sorted({*used, *d.unused}, key=str.casefold)),
        found.content,
        {own.field: own.reason for own in d.proposals},
        tuple(_said(text, file) for text in found.questions),
        tuple(_said(text, file) for text in found.remarks),
        b"" if d.recording is None else png_bytes(found.plot()),
    )


def corrected(draft: Draft, given: Mapping[str, str]) -> dict[str, Any]:
    """Return the map of a table, corrected by its form: ``tilt_x.column``, ``.unit``, ``.scale``."""
    content = copy.deepcopy(dict(draft.content))
    columns = content.setdefault("columns", {})
    for name in (_TIME, *READINGS):
        if f"{name}.column" not in given:
            continue
        into = content if name == _TIME else columns
        column, unit, scale = (given.get(f"{name}.{part}", "").strip() for part in PARTS)
        before = into.get(name) or {}
        if not column:
            if "value" not in before:  # a constant is kept
                into.pop(name, None)
            continue
        source = dict(before) if before.get("column") == column else {"column": column}
        source["unit"] = unit
        source.pop("scale", None)
        if scale:
            try:
                source["scale"] = float(scale)
            except ValueError:
                raise InputError(f"{name}: scale: {scale[:40]!r} is no number") from None
        into[name] = source
    return content


def tried(draft: Draft, number: int, content: Mapping[str, Any], model: Model) -> Draft:
    """Read a table by a map, and return it with the picture and the contradictions to the physics of the wheel."""
    recording = made(draft, content, None)
    wrong = wrong_setups([recording], model.details)
    questions = []
    for own in wrong:
        lines = "; ".join(map_lines(own))
        questions.append(problem(own) + (f" In the map: {lines}." if lines else ""))
    return replace(
        draft,
        number=number,
        content=content,
        reasons={},
        questions=tuple(_said(text, draft.file) for text in questions),
        picture=png_bytes(recording.plot()),
    )


def made(draft: Draft, content: Mapping[str, Any], folder: Path | None) -> Recording:
    """Return the recording of a table read by a map, in a new folder or a temporary one."""
    try:
        return read_table(draft.file, content, folder)
    except InputError as error:
        raise InputError(_said(error, draft.file)) from None


def _said(what: object, file: Path) -> str:
    """Return a sentence with the name of the file instead of its temporary path."""
    return str(what).replace(str(file), file.name)
