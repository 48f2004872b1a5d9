"""The model file: a bench, what has been learned about its parameters, the effects added, and how they came in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import write_text
from gyrowheel_core.yaml_text import read_yaml
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import (
    Effect,
    EffectValues,
    effect_from_mapping,
    effect_to_mapping,
    get,
    registry,
    validated,
)
from gyrowheel_sim.effects.user import check_name
from gyrowheel_sim.parameter import check_value

SCHEMA = 1


@dataclass(frozen=True)
class Override:
    """A bench parameter with a value learned from recordings.

    Attributes
    ----------
    value, standard_error : float
        Value and its standard error [SI].
    """

    value: float
    standard_error: float = 0.0


@dataclass(frozen=True)
class Model:
    """A bench with the effects and parameter values learned so far; immutable, every edit gives a new one.

    Attributes
    ----------
    stated_bench : Bench
        The bench as its file describes it.
    bench_source : str
        Shipped name or path of the bench file.
    overrides : dict of str to Override
        Parameters with values learned from recordings.
    effects : dict
        {effect: {coefficient: value}}.
    effect_errors : dict
        {effect: {coefficient: standard error}}.
    history : tuple of dict
        Every change: time, what, recordings, errors before and after; and what is needed to undo it.
    origin : str
        File it was read from.
    declared : dict of str to Effect
        Declarations of those effects that are not registered.
    """

    stated_bench: Bench
    bench_source: str = "gyrowheel"
    overrides: Mapping[str, Override] = field(default_factory=dict)
    effects: EffectValues = field(default_factory=dict)
    effect_errors: EffectValues = field(default_factory=dict)
    history: tuple[dict[str, Any], ...] = ()
    origin: str = "model"
    declared: Mapping[str, Effect] = field(default_factory=dict)

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
        """The bench with the values learned from recordings."""
        return self.stated_bench.with_values({name: o.value for name, o in self.overrides.items()})

    @property
    def reference_bench(self) -> Bench:
        """The bench as it is to be believed before a recording is looked at.

        It is the stated bench, except for what was calibrated, which counts with its standard error, and for
        parameters whose error was added to the model: the learned value is their new stated one, as uncertain as the
        old. All else that was fitted along stays with its recordings, which would otherwise count twice.
        """
        bench = self.stated_bench
        for index, entry in enumerate(self.history):
            for kind in ("calibrated", "restated"):
                where = f"{self.origin}: history.{index}.{kind}"
                learned = entry.get(kind, {})
                if not isinstance(learned, dict):
                    raise InputError(f"{where}: a mapping of parameters is expected")
                for name, given in learned.items():
                    value, error = _value_and_error(given, f"{where}.{name}")
                    bench = bench.with_values({name: value}, where=where)
                    p = bench.parameters[name]
                    if kind == "calibrated" and (error := _error(error, f"{where}.{name}")) > 0.0:
                        bench = replace(
                            bench, parameters={**bench.parameters, name: replace(p, uncertainty=error)}
                        )
        return bench

    @property
    def library(self) -> dict[str, Effect]:
        """Every effect that the model can have: the registered ones and those that it declares."""
        return {**self.declared, **registry()}

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Read a model file.

        Raises
        ------
        InputError
            If the file is missing, no YAML, or a field is missing, unknown or out of range; the message names it.
        """
        file = Path(path)
        try:
            text = file.read_text(encoding="utf-8")
        except OSError as error:
            raise InputError(f"model '{path}': cannot be read: {error.strerror}") from None
        except UnicodeDecodeError:
            raise InputError(f"model '{path}': not a text file") from None
        return cls.from_mapping(read_yaml(text, str(file)), str(file))

    @classmethod
    def from_mapping(cls, raw: Any, origin: str) -> Model:
        """Build a model from the content of a model file (see `load`)."""
        if not isinstance(raw, dict):
            raise InputError(f"{origin}: not a model file (a mapping with schema and bench is expected)")
        if unknown := sorted(
            str(k) for k in raw if k not in ("schema", "bench", "overrides", "effects", "history")
        ):
            raise InputError(
                f"{origin}: {unknown[0]}: no such field; allowed: schema, bench, overrides, effects, history"
            )
        if raw.get("schema") != SCHEMA:
            raise InputError(f"{origin}: schema: {raw.get('schema')!r} is not known; allowed: {SCHEMA}")
        source = raw.get("bench", "gyrowheel")
        if not isinstance(source, str):
            raise InputError(f"{origin}: bench: {source!r} is not a name or a path")
        path = Path(origin).parent / source
        bench = Bench.load(path if path.is_file() else source)
        overrides = {}
        for name, entry in _mapping(raw, "overrides", origin):
            if name not in bench.parameters:
                bench.with_values({name: 0.0}, where=f"{origin}: overrides")  # raises with the nearest name
            value, error = _value_and_error(entry, f"{origin}: overrides.{name}")
            number = check_value(name, value, f"{origin}: overrides")
            overrides[name] = Override(number, _error(error, f"{origin}: overrides.{name}"))
        effects: EffectValues = {}
        errors: EffectValues = {}
        declared: dict[str, Effect] = {}
        for name, entry in _mapping(raw, "effects", origin):
            where = f"{origin}: effects.{name}"
            if not isinstance(entry, dict):
                raise InputError(f"{where}: a mapping of coefficients is expected")
            if "declaration" in entry:
                check_name(name, where, registry())
                declared[name] = effect_from_mapping(name, entry["declaration"], f"{where}.declaration")
            get(name, where=f"{origin}: effects", declared=declared)
            pairs = {
                str(k): _value_and_error(v, f"{where}.{k}") for k, v in entry.items() if k != "declaration"
            }
            values = {k: v for k, (v, _) in pairs.items()}
            effects[name] = validated(name, values, where=f"{origin}: effects", declared=declared)
            errors[name] = {k: _error(e, f"{where}.{k}") for k, (_, e) in pairs.items()}
        history = [] if raw.get("history") is None else raw["history"]
        if not isinstance(history, list) or not all(isinstance(entry, dict) for entry in history):
            raise InputError(f"{origin}: history: a list of mappings is expected")
        return cls(bench, source, overrides, effects, errors, tuple(history), origin, declared)

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
        """Write the model file; it is whole or as it was before.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        text = yaml.safe_dump(
            self.to_mapping(), sort_keys=False, width=110, default_flow_style=None, allow_unicode=True
        )
        write_text(Path(path), text)

    def changed(
        self,
        entry: Mapping[str, Any],
        *,
        overrides: Mapping[str, Override],
        effects: EffectValues,
        effect_errors: EffectValues,
        declared: Mapping[str, Effect] | None = None,
    ) -> Model:
        """Return the model with other content and an entry in its history, which keeps what it needs to be undone.

        `declared` has declarations of effects that are new to it.
        """
        before = {key: value for key, value in self.to_mapping().items() if key in ("overrides", "effects")}
        return replace(
            self,
            overrides=dict(overrides),
            effects=effects,
            effect_errors=effect_errors,
            declared={k: v for k, v in {**self.declared, **(declared or {})}.items() if k in effects},
            history=(*self.history, {**entry, "undo": before}),
        )

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
        before = self.history[-1].get("undo")
        if not isinstance(before, dict):
            raise InputError(
                f"{self.origin}: history.{len(self.history) - 1}.undo: missing; cannot be undone"
            )
        content = {"schema": SCHEMA, "bench": self.bench_source, **before, "history": list(self.history[:-1])}
        return Model.from_mapping(content, self.origin)

    def diff(self, other: Model) -> list[str]:
        """Return the differences of `other` from this model, a line each."""
        lines = []
        old, new = dict(_flat(self.to_mapping())), dict(_flat(other.to_mapping()))
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


def _mapping(raw: Mapping[str, Any], key: str, origin: str) -> list[tuple[str, Any]]:
    content = {} if raw.get(key) is None else raw[key]
    if not isinstance(content, dict):
        raise InputError(f"{origin}: {key}: a mapping is expected")
    return [(str(name), entry) for name, entry in content.items()]


def _value_and_error(entry: Any, where: str) -> tuple[Any, Any]:
    if not isinstance(entry, dict):
        return entry, 0.0
    if "value" not in entry or set(entry) - {"value", "standard_error"}:
        raise InputError(f"{where}: a number, or a mapping with value and standard_error, is expected")
    return entry["value"], entry.get("standard_error", 0.0)


def _error(value: Any, where: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{where}.standard_error: {value!r} is not a number") from None
    if not 0.0 <= number < float("inf"):
        raise InputError(f"{where}.standard_error: {number:g} is out of range; allowed: >= 0")
    return number
