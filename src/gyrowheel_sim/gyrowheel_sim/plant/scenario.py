"""What a simulated machine really is: the truth behind a recording, which no analysis may see."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import json_text, write_text
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import (
    Effect,
    EffectValues,
    effect_from_mapping,
    effect_to_mapping,
    registry,
    validated,
)
from gyrowheel_sim.effects.user import check_name


@dataclass(frozen=True)
class Scenario:
    """The true parameters and effects of a simulated machine, and the seed of its noise.

    Attributes
    ----------
    values : dict of str to float
        Bench parameters that differ from the bench file [SI].
    effects : dict
        Active effects: {name: {coefficient: value}}.
    noise_seed : int
        Seed of sensor noise and drift.
    declared : dict of str to Effect
        Declarations of the effects that are not registered.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    effects: EffectValues = field(default_factory=dict)
    noise_seed: int = 0
    declared: Mapping[str, Effect] = field(default_factory=dict)

    @classmethod
    def nominal(cls, effects: EffectValues | None = None, *, noise_seed: int = 0) -> Scenario:
        """Return a machine exactly as its bench file says, with the given effects."""
        return cls(effects=dict(effects or {}), noise_seed=noise_seed)

    @classmethod
    def load(cls, path: str | Path, bench: Bench) -> Scenario:
        """Read a scenario file.

        Raises
        ------
        InputError
            If the file is missing or not a scenario, or a name or value is not allowed.
        """
        file = Path(path)
        try:
            raw = json.loads(file.read_text(encoding="utf-8"))
            values, effects, seed = raw["values"], raw["effects"], int(raw["noise_seed"])
            declared = {}
            for name, mapping in raw.get("declared", {}).items():
                check_name(name, f"{file}: declared", registry())
                declared[name] = effect_from_mapping(name, mapping, f"{file}: declared.{name}")
            known = {**registry(), **declared}
            checked = {
                # an effect for blind tests is not in the registry; the plant itself checks that it knows the name
                name: validated(name, given, where=f"{file}: effects", declared=declared)
                if name in known
                else dict(given)
                for name, given in effects.items()
            }
            bench.with_values(values, where=f"{file}: values")
        except InputError:
            raise
        except OSError as error:
            raise InputError(f"{file}: cannot be read: {error.strerror}") from None
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise InputError(f"{file}: not a scenario file ({error})") from None
        return cls({k: float(v) for k, v in values.items()}, checked, seed, declared)

    def save(self, path: str | Path) -> None:
        """Write a scenario file that is whole or as it was before; only its owner may read it."""
        content = {"values": dict(self.values), "effects": self.effects, "noise_seed": self.noise_seed}
        if self.declared:
            content["declared"] = {name: effect_to_mapping(effect) for name, effect in self.declared.items()}
        write_text(Path(path), json_text(content), private=True)
