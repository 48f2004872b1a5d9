"""The simulated machine of a run, as the user describes it; the same for the graph of nodes and the simulation."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import KINDS, Kind, draw_machine, reuse_or_draw
from gyrowheel_sim.effects import Effect, parse_option, registry, validated
from gyrowheel_sim.effects.user_defined import check_name
from gyrowheel_sim.plant.scenario import Scenario

if TYPE_CHECKING:
    from gyrowheel_analysis.model import Model

#: Stands for all effects of an air model, as in ``aero:surrogate``.
AIR = "aero"


def noise_seed(seed: int, plan: str) -> int:
    """Return the noise seed of a run, which differs for every seed (not negative) and every name of a plan."""
    if seed < 0:
        raise InputError(f"seed: {seed} is out of range; allowed: >= 0")
    sequence = np.random.SeedSequence([seed, zlib.crc32(plan.encode())])
    return int(sequence.generate_state(1)[0])


def scenario(
    bench: Bench,
    plan: str,
    *,
    effects: Mapping[str, Mapping[str, float]] | Sequence[str | Effect] = (),
    truth: Model | None = None,
    blind: Path | None = None,
    kinds: Sequence[Kind] = tuple(KINDS),
    seed: int = 0,
    machine: int | None = None,
) -> Scenario:
    """Return the machine for a run.

    Parameters
    ----------
    bench : Bench
        The bench as its file describes it.
    plan : str
        Name of the plan.
    effects : mapping or sequence
        {effect: {coefficient: value}}, or effects as ``NAME``, as ``NAME:COEF=VALUE,...`` or as `Effect`; coefficients
        that are not given take their usual size. ``aero:MODEL`` stands for all effects of an air model
        (`gyrowheel_air.surrogate.MODELS`) but ``table``: the simulated air follows power laws.
    truth : Model, optional
        A model whose effects and estimated parameters the machine has, in addition to `effects`.
    blind : Path, optional
        Key file of a hidden machine: used if it exists, else drawn and written.
    kinds : sequence of str
        What may be drawn into a new key file.
    seed : int
        Seed of the noise, and of what is drawn into a new key file.
    machine : int, optional
        Draw the true bench parameters within their uncertainties with this seed; without it they are as stated.
        Parameters that `truth` has estimated keep their values in both cases.

    Raises
    ------
    InputError
        If an effect is unknown or out of range, an effect is given twice, `blind` is not a key file, or `blind` is
        combined with `effects`, `model` or `machine`.
    """
    noise = noise_seed(seed, plan)
    if blind is not None:
        if effects or machine is not None or truth is not None:
            raise InputError(
                "blind: cannot be combined with effects, truth or machine: the key file holds all of it"
            )
        return replace(reuse_or_draw(bench, blind, seed, kinds=kinds), noise_seed=noise)
    if machine is not None and machine < 0:
        raise InputError(f"machine: {machine} is out of range; allowed: >= 0")
    declared = {} if truth is None else dict(truth.declared)
    chosen = {} if truth is None else {name: dict(values) for name, values in truth.effects.items()}
    items: Iterable[Item] = effects.items() if isinstance(effects, Mapping) else _sequence(effects)
    for item in items:
        for name, coefficients in _effects_of(item, declared, bench):
            if truth is not None and name in truth.effects:
                raise InputError(f"effects: {name} is in {truth.origin} already")
            if name in chosen:
                raise InputError(f"effects: {name} is given twice")
            chosen[name] = coefficients
    values = {} if machine is None else draw_machine(bench, np.random.default_rng(machine))
    if truth is not None:
        values |= {name: override.value for name, override in truth.overrides.items()}
    return Scenario(values=values, effects=chosen, noise_seed=noise, declared=declared)


def simulated_bench(bench: str | Path | None, truth: Model | None, belief: Model | None) -> tuple[str, Bench]:
    """Return name or path of the bench of a run, and the bench as its file describes it.

    Without a name it is the bench of `truth`, else that of `belief`, else ``gyrowheel``. InputError for an unknown
    bench, or if it is not that of both models.
    """
    given = [model for model in (truth, belief) if model is not None]
    if bench is not None or not given:
        source = str(bench or "gyrowheel")
        loaded = Bench.load(source)
    else:
        source, loaded = given[0].bench_source, given[0].stated_bench
        file = Path(given[0].origin).parent / source
        source = str(file) if file.is_file() else source
    for model in given:
        if model.stated_bench.parameters == loaded.parameters:
            continue
        of = f"of {model.origin}, {model.bench_source}"
        if bench is not None:
            raise InputError(f"bench: {bench} is not the bench {of}; leave it out")
        raise InputError(f"model: the bench {of}, is not that of truth, {source}")
    return source, loaded


#: An effect as it may be given to `scenario`.
Item: TypeAlias = "str | Effect | tuple[str, Mapping[str, float]]"


def _sequence(effects: Sequence[str | Effect]) -> Sequence[str | Effect]:
    return [effects] if isinstance(effects, str) else effects


def _effects_of(item: Item, declared: dict[str, Effect], bench: Bench) -> list[tuple[str, dict[str, float]]]:
    """Return the effects of an item, with their coefficients; a declaration is added to `declared`."""
    if isinstance(item, Effect):
        check_name(item.name, "effects", registry())
        declared[item.name] = item
        return [(item.name, item.defaults())]
    text, given = (item, None) if isinstance(item, str) else item
    if given is not None and text.partition(":")[0].strip() != AIR:
        return [(text, validated(text, given, where="effects", declared=declared, bench=bench))]
    first, _, rest = text.partition(":")
    if first.strip() != AIR:
        return [parse_option(text, declared, bench)]
    from gyrowheel_air.surrogate import air_effects

    model = rest.strip() or "surrogate"
    if model == "table":
        raise InputError(
            f"--effect: {AIR}:table: the simulated air follows power laws, not the rows of a table; "
            f"{AIR}:surrogate takes the power laws fitted to the table"
        )
    return list(air_effects(model, bench=bench).values.items())
