"""A model: a bench, estimates of its parameters, added effects and their history; and its file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from gyrowheel_analysis.model.history import differences, kept, restored
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

SCHEMA = 1


def _with_its_error(value: Any) -> Any:
    return value if isinstance(value, Mapping | Estimate) else {"value": value}


def _or_none(value: Any) -> Any:
    return [] if value is None else value


class Estimate(Section):
    """A value with its standard error; what is allowed for the value depends on the parameter or coefficient."""

    value: Any
    standard_error: Annotated[Number, Field(ge=0.0)] = 0.0


#: An `Estimate`, or a number alone.
ValueEntry = Annotated[Estimate, BeforeValidator(_with_its_error)]


class EffectEntry(BaseModel):
    """An effect: its coefficients by name, and its declaration if it is a user's own."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, ValueEntry]

    declaration: Any = None

    @property
    def coefficients(self) -> dict[str, Estimate]:
        """The coefficients that the file gives."""
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


#: Checksums of the model files as this process wrote them last.
_WRITTEN: dict[Path, str] = {}


def _checksum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Override:
    """A bench parameter with a value estimated from recordings.

    Attributes
    ----------
    value, standard_error : float
        Value and its standard error [SI].
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
        Every change: time, what, recordings, errors before and after; and what is needed to undo it.
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
        """The prior: the bench as it is believed before a recording is analysed.

        It is the stated bench with two exceptions. A calibrated parameter has its calibrated value and standard
        error. A parameter whose error was added to the model has the estimated value, with the stated uncertainty.
        Other fitted parameters keep their stated values; otherwise their recordings would count twice.
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
        """Every effect that the model can have: the registered ones and those that it declares."""
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
        """Write the model file; it is whole or as it was before.

        Raises
        ------
        InputError
            If the file cannot be written, or it is the one that the model was read from and somebody else has changed
            it since: their change would be lost. If it would be longer than a file that is read.
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
        """Return the name of the bench in a model file, such that it means the same bench for every reader."""
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
        """Return the model with other content and an entry in its history, which keeps what it needs to be undone.

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
