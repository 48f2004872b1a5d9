"""Hidden machines of blind tests: parameters within the stated uncertainties, and effects drawn at random.

Only the key file contains the draw; a recording of the machine does not.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import json_text, read_json, write_text
from gyrowheel_core.schema import check
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Effect, EffectValues
from gyrowheel_sim.effects.registry import for_bench, physical, validated
from gyrowheel_sim.parameter import INSTRUMENTS
from gyrowheel_sim.plant.scenario import UNREGISTERED, KeyFile, Scenario

Kind = Literal["none", "single", "pair", "outside"]
#: Probability of each kind.
KINDS: dict[Kind, float] = {"none": 0.2, "single": 0.5, "pair": 0.2, "outside": 0.1}


def draw_machine(bench: Bench, rng: np.random.Generator) -> dict[str, float]:
    """Draw the true bench parameters within their standard uncertainties; a group varies by one factor.

    Instruments use a separate random stream: a seed draws the same machine whatever a bench states about them.
    """
    (apart,) = rng.spawn(1)
    values: dict[str, float] = {}
    for group in bench.groups().values():
        own = apart if group[0].name in INSTRUMENTS else rng
        factor = float(np.clip(own.standard_normal(), -2.5, 2.5))
        for p in group:
            value = p.value + factor * p.uncertainty
            # no filter is faster than none
            values[p.name] = max(value, 0.0) if p.name.endswith("_filter_time") else value
    return values


def draw_effect(effect: Effect, rng: np.random.Generator) -> dict[str, float]:
    """Draw coefficients of an effect within their usual sizes (log-uniform; shapes within their uncertainty)."""
    values = {}
    for c in effect.coefficients:
        if c.shape is not None:
            values[c.name] = float(np.clip(rng.normal(c.shape, c.shape_uncertainty), *c.usual))
        else:
            size = math.exp(rng.uniform(math.log(c.usual[0]), math.log(c.usual[1])))
            values[c.name] = size * (float(rng.choice((-1.0, 1.0))) if c.signed else 1.0)
    return values


def draw(bench: Bench, seed: int, *, kinds: Sequence[Kind] = tuple(KINDS)) -> Scenario:
    """Draw a hidden machine.

    Parameters
    ----------
    bench : Bench
        The bench as its file describes it.
    seed : int
        Seed of machine, effects and noise; not negative.
    kinds : sequence of str
        Kinds that may be drawn: ``none``, ``single``, ``pair`` (of the physical effects; instruments that are not as
        stated are hidden by a campaign of their own), ``outside`` (an effect that no declaration contains).
    """
    if seed < 0:
        raise InputError(f"seed: {seed} is out of range; allowed: >= 0")
    rng = np.random.default_rng([seed, 0x6779726F])
    values = draw_machine(bench, rng)
    weights = np.array([KINDS[kind] for kind in kinds])
    kind = kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))]
    pool = [for_bench(e, bench) for e in (UNREGISTERED if kind == "outside" else physical().values())]
    count = {"none": 0, "single": 1, "pair": 2, "outside": 1}[kind]
    chosen = [pool[int(i)] for i in rng.choice(len(pool), size=count, replace=False)]
    effects: EffectValues = {effect.name: draw_effect(effect, rng) for effect in chosen}
    return Scenario(values=values, effects=effects, noise_seed=seed)


def reuse_or_draw(bench: Bench, key: Path, seed: int, *, kinds: Sequence[Kind] = tuple(KINDS)) -> Scenario:
    """Return the machine of a key file, or draw one and write the key file; the noise takes `seed` in both cases.

    Raises
    ------
    InputError
        If the file exists and is not a key file.
    """
    if key.exists():
        try:
            return replace(read_key(bench, key), noise_seed=seed)
        except InputError as error:
            raise InputError(f"{error}; or name a new file, to have a key drawn") from None
    # the name must reveal nothing about the machine, not even its seed
    scenario = replace(draw(bench, seed, kinds=kinds), machine=secrets.token_hex(2))
    content = {"values": dict(scenario.values), "effects": scenario.effects, "machine": scenario.machine}
    write_text(key, json_text(content), private=True)
    return replace(scenario, noise_seed=seed)


def read_key(bench: Bench, key: Path) -> Scenario:
    """Return the machine of a key file.

    Raises
    ------
    InputError
        If the file is missing, is not a key file, or does not fit the bench.
    """
    content = check(KeyFile, read_json(key), str(key), kind="key file")
    bench.with_values(content.values, where=f"{key}: values")
    outside = {effect.name: effect for effect in UNREGISTERED}
    effects = {
        name: validated(name, given, where=f"{key}: effects", declared=outside, bench=bench)
        for name, given in content.effects.items()
    }
    return Scenario(values=content.values, effects=effects, machine=content.machine)
