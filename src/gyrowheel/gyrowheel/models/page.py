"""A model file as text: effects, parameters, history; and a fit of chosen parameters: estimates, correlations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from gyrowheel.show.error_table import error_table
from gyrowheel.show.formulas import is_pure, pretty
from gyrowheel.show.layout import figures_table, heading, indented, sentences, words_table
from gyrowheel.show.sentences.correction import range_text
from gyrowheel.show.sentences.diagnosis import conflict_sentences, error_sentences, prior_sentences
from gyrowheel.show.sentences.findings import event_sentences
from gyrowheel.show.sentences.proof import doubt_sentence, proof_line
from gyrowheel_analysis.channels import LISTED
from gyrowheel_core.quantities import decimal, fixed, short, with_error
from gyrowheel_core.units import Unit, unit_for
from gyrowheel_sim.effects.torque_map import TorqueMap

if TYPE_CHECKING:
    from gyrowheel_analysis.estimation.result import Estimation, Parameter
if TYPE_CHECKING:
    from gyrowheel_analysis.add import Added
    from gyrowheel_analysis.model import Model


_MOVED = 0.5  # stated uncertainties by which a parameter must move to be named


def model_page(model: Model) -> Iterator[RenderableType]:
    """Yield a model: its effects, its parameters and its history."""
    yield Text.assemble((model.origin, "bold cyan"), f"  bench {model.bench_source}")
    yield from _effects_section(model)
    yield heading("Bench parameters fitted to recordings")
    yield indented(_overrides(model, model.overrides) if model.overrides else Text("none", style="dim"))
    yield heading("History")
    history = words_table("time", "what", "χ²/N", "recordings", whole=(0, 2))
    for entry in model.history:
        time = str(entry.get("time", "")).replace("T", " ").removesuffix("+00:00")
        words = (Text(text, overflow="fold") for text in (str(entry.get("what", "")), _recordings(entry)))
        what, recordings = words
        history.add_row(time.rpartition(":")[0], what, _fall(entry), recordings)
    yield indented(history if model.history else Text("none", style="dim"))


def _effects_section(model: Model) -> Iterator[RenderableType]:
    yield heading("Effects")
    yield indented(_effects(model) if model.effects else Text("none", style="dim"))


def addition_page(added: Added) -> Iterator[RenderableType]:
    """Yield the model after a fit: its effects, parameters far from the bench file, errors, warnings and proof."""
    yield from changes(added.model)
    yield heading("Error")
    yield error_table(added.error)
    yield from sentences(addition_notes(added))
    yield proof_line(added.proof, added.error)


def addition_notes(added: Added) -> tuple[str, ...]:
    """Return errors and priors of the estimates, events of the recordings, and doubts about the fit."""
    priors = (
        text
        for name, own in added.coefficients.items()
        for text in (*error_sentences(name, own), *prior_sentences(name, own), *conflict_sentences(name, own))
    )
    return (*priors, *event_sentences(added.events, several=True), *map(doubt_sentence, added.doubts))


def changes(model: Model) -> Iterator[RenderableType]:
    """Yield the effects of a model, and the parameters far from the bench file."""
    yield from _effects_section(model)
    stated = model.stated_bench.parameters
    far = [
        name
        for name, override in model.overrides.items()
        if abs(override.value - stated[name].value) > stated[name].uncertainty
    ]
    if far:
        yield heading("Bench parameters that moved by more than their stated uncertainty")
        yield indented(_overrides(model, far))


def difference(old: Model, new: Model) -> Iterator[RenderableType]:
    """Yield the differences of two models, coloured as a diff: effects, then the parameters that have moved."""
    if not old.diff(new):
        yield Text("no difference", style="dim")
        return
    if old.bench_source != new.bench_source:
        yield Text(f"~ bench  {old.bench_source} → {new.bench_source}", style="yellow")
    for name in [*old.effects, *(n for n in new.effects if n not in old.effects)]:
        yield from _changed_effect(name, old, new)
    moved, rest = _moved_parameters(old, new)
    if moved:
        table = words_table("parameter", "before", "after", "", whole=(0, 1, 2, 3))
        for row in moved:
            table.add_row(*row)
        yield Text()
        yield table
    if rest:
        more = "more parameters" if moved else "parameters"
        yield Text(
            f"{rest} {more} of the bench refitted, by less than half their stated uncertainty", style="dim"
        )


def _changed_effect(name: str, old: Model, new: Model) -> Iterator[Text]:
    if name in old.effects and name in new.effects:
        before, after = _coefficients(old, name), _coefficients(new, name)
        for key in after:
            if before.get(key) != after[key]:
                yield Text(f"~ {name} {key}  {before.get(key, '–')} → {after[key]}", style="yellow")
        if old.library[name].formula != new.library[name].formula:
            yield Text(f"~ {name} law  {pretty(new.library[name].formula)}", style="yellow")
        return
    model, sign, style = (old, "−", "red") if name in old.effects else (new, "+", "green")
    yield Text(f"{sign} {name}  {model.library[name].title}", style=style)
    for key, text in _coefficients(model, name).items():
        yield Text(f"{sign}   {key}  {text}", style=style)


def _coefficients(model: Model, name: str) -> dict[str, str]:
    """Return the coefficients of an effect with their errors, for people; of a map what they are."""
    effect = model.library[name]
    if isinstance(effect, TorqueMap):
        return {"range": range_text(effect), "coefficients": str(len(model.effects[name]))}
    units = {c.name: (c.unit, c.shape is not None) for c in model.library[name].coefficients}
    errors = model.effect_errors.get(name, {})
    return {
        key: with_error(value, errors.get(key, 0.0), units[key][0], pure=units[key][1])
        for key, value in model.effects[name].items()
    }


def _moved_parameters(old: Model, new: Model) -> tuple[list[tuple[str, str, str, str]], int]:
    """Return the parameters that moved by half their stated uncertainty, as rows, and how many others moved."""
    rows, rest = [], 0
    for name, p in new.stated_bench.parameters.items():
        stated = old.stated_bench.parameters.get(name, p)
        before, after = old.overrides.get(name), new.overrides.get(name)
        if before == after and stated.value == p.value:
            continue
        was = stated.value if before is None else before.value
        now = p.value if after is None else after.value
        uncertainty = p.uncertainty or abs(p.value)
        if abs(now - was) < _MOVED * uncertainty:
            rest += 1
            continue
        shown = (
            "as stated" if value is None else with_error(value.value, value.standard_error, p.unit, pure=True)
            for value in (before, after)
        )
        rows.append((name, *shown, f"{decimal((now - was) / uncertainty, 1, sign=True)} σ"))
    return rows, rest  # type: ignore[return-value]


def _effects(model: Model) -> RenderableType:
    table = words_table("", "", "")
    for name, values in model.effects.items():
        effect = model.library[name]
        if isinstance(effect, TorqueMap):
            table.add_row(Text(name, style="cyan"), "range", range_text(effect))
            made = ", ".join(Path(path).name for path in effect.recordings)
            table.add_row("", "made from", f"{made}; {len(values)} coefficients")
            continue
        units = {c.name: (c.unit, c.shape is not None) for c in effect.coefficients}
        first = Text(name, style="cyan")
        for key, value in values.items():
            unit, pure = units[key]
            error = model.effect_errors.get(name, {}).get(key, 0.0)
            table.add_row(first, key, with_error(value, error, unit, pure=pure))
            first = Text()
        table.add_row("", "law", pretty(effect.formula))
    return table


def _overrides(model: Model, names: Iterable[str]) -> RenderableType:
    table = words_table("parameter", "fitted", "stated", whole=(0, 1, 2))
    for name in names:
        override = model.overrides[name]
        p = model.stated_bench.parameters[name]
        table.add_row(
            Text(name, style="cyan"),
            with_error(override.value, override.standard_error, p.unit, pure=True),
            with_error(p.value, p.uncertainty, p.unit, pure=True),
        )
    return table


def _fall(entry: Mapping[str, Any]) -> str:
    """Return the fall of the error with a change: on fitted and on validation recordings."""
    error = entry.get("error")
    lines = []
    for before, after in (("before", "after"), ("validation_before", "validation_after")):
        try:
            pair = [float(error[key]["chi2_per_n"]) for key in (before, after)]  # type: ignore[index]
        except (KeyError, TypeError, ValueError):
            continue
        lines.append(f"{fixed(pair[0])} → {fixed(pair[1])}")
    return "\n".join(lines)


def _recordings(entry: Mapping[str, Any]) -> str:
    parts = []
    for key, words in (("fit", "fitted on"), ("validate", "validated on")):
        paths = entry.get(key)
        if isinstance(paths, list) and paths:
            parts.append(f"{words} {', '.join(Path(str(path)).name for path in paths)}")
    return "\n".join(parts)


_INDENT = (0, 0, 0, 2)
#: Correlation from which on a pair is named, pairs and fixed parameters that are named at most.
CORRELATED = 0.8
_MOST_PAIRS = 5
_MOST_FIXED = 6


def fit_page(fit: Estimation) -> Iterator[RenderableType]:
    """Yield the estimates with their priors, the channels, the criteria and the strongest correlations."""
    effects = [name for name in fit.names if "." in name]
    bench = [name for name in fit.names if "." not in name]
    if effects:
        yield heading("Coefficients")
        table = words_table("", "estimate", "from the data alone", "prior", whole=(0, 1, 2, 3))
        for name in effects:
            own = fit.parameters[name]
            table.add_row(Text(name, style="cyan"), estimate_of(own), alone_of(own), stated_of(own))
        yield Padding(table, _INDENT)
    if bench:
        yield heading("Bench parameters")
        table = words_table("", "estimate", "prior", whole=(0, 1, 2))
        for name in bench:
            own = fit.parameters[name]
            table.add_row(Text(name, style="cyan"), estimate_of(own), stated_of(own))
        yield Padding(table, _INDENT)
    if fixed := [name for name, own in fit.parameters.items() if not own.free]:
        what = ", ".join(fixed) if len(fixed) <= _MOST_FIXED else f"{len(fixed)} parameters"
        yield Padding(Text(f"fixed at the model's values: {what}", style="dim"), _INDENT)
    yield heading("Channels")
    channels = figures_table("", "χ²/N", "N")
    for name, (chi2, n) in fit.channels.items():
        channels.add_row(LISTED[name].title, decimal(chi2 / n, 2), str(n))
    yield Padding(channels, _INDENT)
    yield heading("Fit")
    yield from sentences(_facts(fit))


def _facts(fit: Estimation) -> Iterator[str]:
    yield (
        f"χ² {decimal(fit.chi2, 1)} with {fit.degrees_of_freedom} degrees of freedom: {fit.rows} rows, "
        f"{len(fit.names)} free parameters, {sum(fit.parameters[n].prior is not None for n in fit.names)} of them "
        "with a prior"
    )
    yield (
        f"log likelihood {decimal(fit.log_likelihood, 2)}, log evidence {decimal(fit.log_evidence, 2)}, "
        f"AIC {decimal(fit.aic, 1)}, BIC {decimal(fit.bic, 1)}"
    )
    if fit.loss != "linear":
        yield f"large residuals weighted by the loss {fit.loss}"
    for name in fit.names:
        if fit.parameters[name].at_bound:
            low, high = fit.parameters[name].bounds
            yield f"{name} lies at a bound ({short(low, 3)} .. {short(high, 3)}); its standard error means little"
    for first, second, r in islice(strongest_pairs(fit), _MOST_PAIRS):
        if abs(r) >= CORRELATED:
            yield f"correlation of {first} and {second}: {decimal(r, 3, sign=True)}"


def strongest_pairs(fit: Estimation) -> Iterator[tuple[str, str, float]]:
    """Yield all pairs of free parameters with their correlation, the strongest first."""
    values = fit.correlation.values
    pairs = np.triu_indices(len(values), 1)
    for k in np.argsort(-np.abs(values[pairs])):
        i, j = pairs[0][k], pairs[1][k]
        yield fit.names[i], fit.names[j], float(values[i, j])


def estimate_of(own: Parameter) -> str:
    """Return an estimate with its standard error and unit."""
    return _value(own, own.value, own.standard_error)


def _value(own: Parameter, value: float, error: float) -> str:
    """Return a value of a parameter with its error, in the unit in which people read it."""
    return with_error(value, error, own.unit, pure=_is_pure(own))


def unit_of(own: Parameter) -> Unit:
    """Return the unit in which people read an estimate."""
    return unit_for(max(abs(own.value), own.standard_error), own.unit, pure=_is_pure(own))


def _is_pure(own: Parameter) -> bool:
    effect, _, key = own.name.partition(".")
    return is_pure(effect, key) if key else True


def stated_of(own: Parameter) -> str:
    """Return the prior of a parameter, which is its stated value."""
    return "–" if own.prior is None else _value(own, own.prior.mean, own.prior.deviation)


def alone_of(own: Parameter, without_prior: str = "the same") -> str:
    """Return what the recordings alone determine; `without_prior` where that is the estimate itself."""
    if own.prior is None:
        return without_prior
    return "not determined" if own.data is None else _value(own, *own.data)
