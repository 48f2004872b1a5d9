"""The true state of a simulated machine, and effects for blind tests: no analysis may see either."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import sympy as sp
from pydantic import BaseModel, ConfigDict, Field

from gyrowheel_core.files import json_text, read_json, write_text
from gyrowheel_core.schema import Name, Names, Number, Section, Text, Whole, check
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import (
    Effect,
    EffectValues,
    effect_from_mapping,
    effect_to_mapping,
    registry,
    validated,
)
from gyrowheel_sim.effects.declaration import Coefficient, Law
from gyrowheel_sim.effects.quantities import Omega, Omega_ref, z, z_ref
from gyrowheel_sim.effects.user_defined import check_name


class KeyFile(BaseModel):
    """A key file: the hidden values and effects of a machine; a campaign adds entries for readers."""

    model_config = ConfigDict(frozen=True)

    values: dict[Name, Number]
    effects: dict[Name, dict[Name, Number]]
    machine: Text = ""


class ScenarioFile(Section):
    """A scenario file: the machine that the plant node simulates."""

    values: dict[Name, Number]
    effects: dict[Name, dict[Name, Number]]
    noise_seed: Whole
    declared: Names[Any] = Field(default_factory=dict)
    machine: Text = ""


@dataclass(frozen=True)
class Scenario:
    """True parameters and effects of a simulated machine, and the seed of its noise."""

    #: Bench parameters that differ from the bench file [SI].
    values: Mapping[str, float] = field(default_factory=dict)
    effects: EffectValues = field(default_factory=dict)  # active effects: {name: {coefficient: value}}
    noise_seed: int = 0  # seed of sensor noise and drift
    #: Declarations of the effects that are not registered.
    declared: Mapping[str, Effect] = field(default_factory=dict)
    #: Name of the machine, which reveals nothing about it; empty for the name that `identity` makes.
    machine: str = ""

    def identity(self, bench: Bench) -> str:
        """Return the name of the machine in its recordings, the same for every run of it.

        Four digits of a digest: they distinguish two machines, and are too few to reveal one.
        """
        if self.machine:
            return self.machine
        parameters = {name: float(value) for name, value in (bench.values() | dict(self.values)).items()}
        effects = {name: dict(values) for name, values in self.effects.items()}
        declared = {name: effect_to_mapping(effect) for name, effect in self.declared.items()}
        content = {"bench": parameters, "effects": effects, "declared": declared}
        text = json.dumps(content, sort_keys=True, default=float)
        return hashlib.blake2b(text.encode(), digest_size=2, person=b"gyrowheel").hexdigest()

    @classmethod
    def nominal(cls, effects: EffectValues | None = None, *, noise_seed: int = 0) -> Scenario:
        """Return a machine with the parameters of its bench file and the given effects."""
        return cls(effects=dict(effects or {}), noise_seed=noise_seed)

    @classmethod
    def load(cls, path: str | Path, bench: Bench) -> Scenario:
        """Read a scenario file.

        Raises
        ------
        InputError
            If the file is missing or not a scenario, or a name or value is not allowed.
        """
        content = check(ScenarioFile, read_json(Path(path)), str(path), kind="scenario file")
        declared = {}
        for name, mapping in content.declared.items():
            check_name(name, f"{path}: declared", registry())
            declared[name] = effect_from_mapping(name, mapping, f"{path}: declared.{name}")
        known = {**registry(), **declared}
        effects = {
            # an effect for blind tests is not in the registry; the plant itself checks that it knows the name
            name: validated(name, given, where=f"{path}: effects", declared=declared)
            if name in known
            else given
            for name, given in content.effects.items()
        }
        bench.with_values(content.values, where=f"{path}: values")
        return cls(content.values, effects, content.noise_seed, declared, content.machine)

    def save(self, path: str | Path) -> None:
        """Write a scenario file atomically; only its owner may read it."""
        content: dict[str, Any] = {
            "values": dict(self.values),
            "effects": self.effects,
            "noise_seed": self.noise_seed,
        }
        if self.machine:
            content["machine"] = self.machine
        if self.declared:
            content["declared"] = {name: effect_to_mapping(effect) for name, effect in self.declared.items()}
        write_text(Path(path), json_text(content), private=True)


_A, _p, _w = (sp.Symbol(name, real=True) for name in ("A", "p", "w"))
_size = sp.sqrt(z * sp.conjugate(z))


def _amplitude(unit: str, low: float, high: float, *, signed: bool = True) -> Coefficient:
    return Coefficient("A", unit, "size", (low, high), (-1.0, 1.0), "assumed", signed=signed)


def _shape(name: str, low: float, high: float, description: str) -> Coefficient:
    middle, spread = 0.5 * (low + high), 0.5 * (high - low)
    return Coefficient(
        name, "1", description, (low, high), (0.0, 10.0), "assumed", shape=middle, shape_uncertainty=spread
    )


SPEED_BUMP = Effect(
    name="speed_bump",
    title="resonance of the structure at one speed",
    category="other",
    sentence="Near one speed the mount resonates and adds a torque in proportion to the tilt.",
    laws=(Law("rotor_torque", _A * sp.exp(-(((Omega / Omega_ref - _p) / _w) ** 2)) * z),),
    coefficients=(
        _amplitude("N*m/rad", 0.02, 0.06),
        _shape("p", 0.45, 0.95, "speed"),
        _shape("w", 0.08, 0.15, "width"),
    ),
    validity="blind tests",
    source="assumed",
)
THREE_LOBED = Effect(
    name="three_lobed",
    title="three-lobed torque",
    category="other",
    sentence="A field of three lobes fixed in the case turns the rotor towards the nearest lobe.",
    laws=(Law("rotor_torque", _A * sp.conjugate(z) ** 2 / z_ref**2),),
    coefficients=(_amplitude("N*m", 0.0015, 0.005),),
    validity="blind tests",
    source="assumed",
)
CONTACT = Effect(
    name="contact",
    title="contact beyond a tilt",
    category="other",
    sentence="Beyond some tilt the rotor touches a lead that pushes it back.",
    laws=(Law("rotor_torque", -_A * sp.Max(_size / z_ref - _p, 0) * z / (_size + sp.Float(1e-9))),),
    coefficients=(
        _amplitude("N*m", 0.006, 0.02, signed=False),
        _shape("p", 0.4, 0.55, "tilt where it begins"),
    ),
    validity="blind tests",
    source="assumed",
)

UNREGISTERED: tuple[Effect, ...] = (SPEED_BUMP, THREE_LOBED, CONTACT)
