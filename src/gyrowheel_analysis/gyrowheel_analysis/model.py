"""A model: a bench, estimates of its parameters, added effects and their history; and its file.

An entry of the history keeps only the differences: with a copy of the whole model in every entry, the file would grow
with the square of the number of changes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, read_text, write_text
from gyrowheel_core.locks import changing
from gyrowheel_core.schema import Names, Number, Section, Text, check
from gyrowheel_core.yaml_text import LARGEST, read_yaml
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import (
    Effect,
    EffectValues,
    effect_from_mapping,
    effect_to_mapping,
    registry,
    validated,
)
from gyrowheel_sim.effects.user_defined import check_name


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Return the differences between the contents of two model files, a line each; histories are not compared.

    A line begins with ``+`` for an addition, ``-`` for a removal and ``~`` for a change.
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
            if "map" in entry.get("declaration", {}):
                recordings = ", ".join(entry["declaration"]["map"]["recordings"])
                yield f"{part}.{name}", f"map of {len(entry) - 1} coefficients, from {recordings}"
                continue
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
    """Return the changes that lead from a model file `after` a change back to the one `before` it.

    They are the former values of every override and effect that differs, null for absent ones, and the former order of
    a part whose order differs.
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
    # the order of names within an entry may differ too, and the file is to be restored exactly
    same = all(_order(again[part]) == _order(whole[part]) for part in PARTS)
    return result if again == whole and same else whole


def restored(after: Mapping[str, Any], undo: Any, where: str) -> dict[str, Any]:
    """Return overrides and effects as they were before a change of a model file, which has the content `after` it.

    `undo` is the result of `kept`, or overrides and effects as a whole, as earlier versions wrote them; `where` is its
    place, for the error.

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
        raise InputError(f"{where}: is no record of a change; cannot be undone")
    found = {}
    for part in PARTS:
        merged = _merged(after[part], back.get(part) or {})
        first = [name for name in order.get(part) or () if isinstance(name, str) and name in merged]
        found[part] = {name: merged[name] for name in [*first, *merged]}
    return found


def _entry(old: Mapping[str, Any] | None, new: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return the changed part of an entry; all of it if it is gone, None if it was absent."""
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
        else:  # left to the schema, which refuses it
            found[name] = entry
    return found


def _order(part: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    return [(name, list(entry)) for name, entry in part.items()]


SCHEMA = 1


def _with_its_error(value: Any) -> Any:
    return value if isinstance(value, Mapping | Estimate) else {"value": value}


def _or_none(value: Any) -> Any:
    return [] if value is None else value


class Estimate(Section):
    """A value with its standard error; the range of the value depends on the parameter or coefficient."""

    value: Any
    standard_error: Annotated[Number, Field(ge=0.0)] = 0.0


#: An `Estimate`, or a number alone.
ValueEntry = Annotated[Estimate, BeforeValidator(_with_its_error)]


class EffectEntry(BaseModel):
    """An effect: its coefficients by name, and its declaration if it is user-defined."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, ValueEntry]

    declaration: Any = None

    @property
    def coefficients(self) -> dict[str, Estimate]:
        """The coefficients in the file."""
        return dict(self.__pydantic_extra__)

    @property
    def is_declared(self) -> bool:
        """Whether the entry declares the effect."""
        return "declaration" in self.model_fields_set


class HistoryEntry(BaseModel):
    """A change of the model; its other entries are for the reader."""

    model_config = ConfigDict(extra="allow", frozen=True)

    calibrated: Names[ValueEntry] = Field(default_factory=dict)
    restated: Names[ValueEntry] = Field(default_factory=dict)


class ModelFile(Section):
    """A model file."""

    schema_: Literal[1] = Field(alias="schema")
    bench: Annotated[
        Text, Field(json_schema_extra={"allowed": "the name of a bench, or the path of its file"})
    ] = "gyrowheel"
    overrides: Names[ValueEntry] = Field(default_factory=dict)
    effects: Names[EffectEntry] = Field(default_factory=dict)
    history: Annotated[list[HistoryEntry], BeforeValidator(_or_none)] = Field(default_factory=list)


#: Checksums of the model files as last written by this process.
_WRITTEN: dict[Path, str] = {}


def _checksum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Override:
    """A bench parameter with a value estimated from recordings.

    `value` and `standard_error` are in SI units.
    """

    value: float
    standard_error: float = 0.0


@dataclass(frozen=True)
class Model:
    """A bench with added effects and estimated parameter values; immutable: every edit makes a new one.

    Attributes
    ----------
    stated_bench : Bench
        The bench as its file describes it.
    bench_source : str
        Shipped name or path of the bench file.
    overrides : dict of str to Override
        Parameters with values estimated from recordings.
    effects : dict
        {effect: {coefficient: value}}.
    effect_errors : dict
        {effect: {coefficient: standard error}}.
    history : tuple of dict
        Every change: time, description, recordings, errors before and after; and the data to undo it.
    origin : str
        File it was read from.
    declared : dict of str to Effect
        Declarations of those effects that are not registered.
    read : str or None
        Checksum of the file as it was read; None for a model that was not read from a file.
    """

    stated_bench: Bench
    bench_source: str = "gyrowheel"
    overrides: Mapping[str, Override] = field(default_factory=dict)
    effects: EffectValues = field(default_factory=dict)
    effect_errors: EffectValues = field(default_factory=dict)
    history: tuple[dict[str, Any], ...] = ()
    origin: str = "model"
    declared: Mapping[str, Effect] = field(default_factory=dict)
    read: str | None = field(default=None, compare=False, repr=False)

    @classmethod
    def new(cls, bench: str = "gyrowheel") -> Model:
        """Return a model with nothing added to a bench.

        Raises
        ------
        InputError
            If there is no such bench, or it has errors.
        """
        return cls(stated_bench=Bench.load(bench), bench_source=bench)

    @property
    def bench(self) -> Bench:
        """The bench with the values estimated from recordings."""
        return self.stated_bench.with_values({name: o.value for name, o in self.overrides.items()})

    @property
    def reference_bench(self) -> Bench:
        """The prior: the bench before a recording is analysed.

        It is the stated bench with two exceptions. A calibrated parameter has its calibrated value and standard error.
        A parameter whose error was added to the model has the estimated value, with the stated uncertainty. Other
        fitted parameters keep their stated values; otherwise their recordings would count twice.
        """
        bench = self.stated_bench
        for index, entry in enumerate(self.history):
            where = f"{self.origin}: history.{index}"
            learned = check(HistoryEntry, entry, where, separator=".")
            for name, estimate in learned.calibrated.items():
                bench = bench.with_values({name: estimate.value}, where=f"{where}.calibrated")
                if estimate.standard_error > 0.0:
                    known = replace(bench.parameters[name], uncertainty=estimate.standard_error)
                    bench = replace(bench, parameters={**bench.parameters, name: known})
            values = {name: estimate.value for name, estimate in learned.restated.items()}
            bench = bench.with_values(values, where=f"{where}.restated")
        return bench

    @property
    def library(self) -> dict[str, Effect]:
        """Every possible effect of the model: the registered ones and those that it declares."""
        return {**self.declared, **registry()}

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Read a model file.

        Raises
        ------
        InputError
            If the file is missing or is not YAML, or a field is missing, unknown or out of range; the message names it.
        """
        text = read_text(Path(path))
        return replace(cls.from_mapping(read_yaml(text, str(path)), str(path)), read=_checksum(text))

    @classmethod
    def from_mapping(cls, raw: Any, origin: str) -> Model:
        """Build a model from the content of a model file (see `load`)."""
        content = check(ModelFile, raw, origin, kind="model file")
        path = Path(origin).parent / content.bench
        own = content.bench not in Bench.shipped() and is_file(path)
        bench = Bench.load(path if own else content.bench)
        stated = {name: estimate.value for name, estimate in content.overrides.items()}
        values = bench.with_values(stated, where=f"{origin}: overrides").values()
        overrides = {
            name: Override(values[name], estimate.standard_error)
            for name, estimate in content.overrides.items()
        }
        history = tuple(raw.get("history") or ())  # unchanged: remarks of users are kept
        effects: EffectValues = {}
        errors: EffectValues = {}
        declared: dict[str, Effect] = {}
        for name, entry in content.effects.items():
            where = f"{origin}: effects.{name}"
            if entry.is_declared:
                check_name(name, where, registry())
                declared[name] = effect_from_mapping(name, entry.declaration, f"{where}.declaration")
            given = {key: estimate.value for key, estimate in entry.coefficients.items()}
            effects[name] = validated(name, given, where=f"{origin}: effects", declared=declared)
            errors[name] = {key: estimate.standard_error for key, estimate in entry.coefficients.items()}
        return cls(bench, content.bench, overrides, effects, errors, history, origin, declared)

    def to_mapping(self) -> dict[str, Any]:
        """Return the content of the model file."""
        return {
            "schema": SCHEMA,
            "bench": self.bench_source,
            "overrides": {
                name: {"value": float(o.value), "standard_error": float(o.standard_error)}
                for name, o in self.overrides.items()
            },
            "effects": {
                name: self._declaration(name)
                | {
                    key: {
                        "value": float(value),
                        "standard_error": float(self.effect_errors.get(name, {}).get(key, 0.0)),
                    }
                    for key, value in values.items()
                }
                for name, values in self.effects.items()
            },
            "history": list(self.history),
        }

    def _declaration(self, name: str) -> dict[str, Any]:
        return {"declaration": effect_to_mapping(self.declared[name])} if name in self.declared else {}

    def save(self, path: str | Path) -> None:
        """Write the model file, completely or not at all.

        Raises
        ------
        InputError
            If the file cannot be written, it would be too long to be read, or it is the one that the model was read
            from and somebody else has changed it since: their change would be lost.
        """
        file = Path(path).absolute()
        content = self.to_mapping() | {"bench": self._bench_beside(file)}
        text = yaml.safe_dump(
            content, sort_keys=False, width=110, default_flow_style=None, allow_unicode=True
        )
        if len(text) > LARGEST:
            raise InputError(
                f"{path}: the model would have {len(text)} characters; allowed: up to {LARGEST}; nothing was written: "
                "begin a new file, or take the oldest entries out of its history"
            )
        with changing(file):
            if self.read is not None and file == Path(self.origin).absolute() and file.exists():
                found = _checksum(read_text(file))
                if found not in (self.read, _WRITTEN.get(file)):
                    raise InputError(
                        f"{path}: somebody else has changed it since it was read; nothing was written: read it again, "
                        "or save under another name"
                    )
            write_text(file, text)
            _WRITTEN[file] = _checksum(text)

    def _bench_beside(self, file: Path) -> str:
        """Return a name of the bench for a model file that means the same bench to every reader."""
        place = Path(self.stated_bench.origin)
        if self.bench_source in Bench.shipped() or not place.is_file():
            return self.bench_source
        beside = file.parent / self.bench_source
        if beside.is_file() and beside.samefile(place):
            return self.bench_source
        place = place.absolute()
        return str(place.relative_to(file.parent) if place.is_relative_to(file.parent) else place)

    def changed(
        self,
        entry: Mapping[str, Any],
        *,
        overrides: Mapping[str, Override],
        effects: EffectValues,
        effect_errors: EffectValues,
        declared: Mapping[str, Effect] | None = None,
    ) -> Model:
        """Return the model with other content and an entry in its history, which has the data to undo the change.

        `declared` has declarations of effects that are new to it.
        """
        after = replace(
            self,
            overrides=dict(overrides),
            effects=effects,
            effect_errors=effect_errors,
            declared={k: v for k, v in {**self.declared, **(declared or {})}.items() if k in effects},
        )
        undo = kept(self.to_mapping(), after.to_mapping())
        return replace(after, history=(*self.history, {**entry, "undo": undo}))

    def removed(self, name: str, time: str) -> Model:
        """Return the model without one effect; `time` goes into the history.

        Raises
        ------
        InputError
            If the model has no such effect.
        """
        if name not in self.effects:
            held = ", ".join(self.effects) or "none"
            raise InputError(f"{self.origin}: effects.{name}: the model has no such effect; it has: {held}")
        return self.changed(
            {"time": time, "what": f"remove {name}"},
            overrides=self.overrides,
            effects={k: v for k, v in self.effects.items() if k != name},
            effect_errors={k: v for k, v in self.effect_errors.items() if k != name},
        )

    def undone(self) -> Model:
        """Return the model as it was before its last change.

        Raises
        ------
        InputError
            If there is nothing to undo.
        """
        if not self.history:
            raise InputError(f"{self.origin}: history: nothing to undo")
        where = f"{self.origin}: history.{len(self.history) - 1}.undo"
        before = restored(self.to_mapping(), self.history[-1].get("undo"), where)
        content = {"schema": SCHEMA, "bench": self.bench_source, **before, "history": list(self.history[:-1])}
        return replace(Model.from_mapping(content, self.origin), read=self.read)

    def diff(self, other: Model) -> list[str]:
        """Return the differences of `other` from this model, a line each."""
        return differences(self.to_mapping(), other.to_mapping())
