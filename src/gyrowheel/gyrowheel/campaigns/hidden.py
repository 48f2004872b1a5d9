"""The secret of a case: a machine drawn at random, with effects scaled to the detection limits of a recording.

The finder uses only the recordings that `record` writes.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.campaigns.cases import Case
from gyrowheel.campaigns.reality import (
    STRANGE,
    HiddenEvent,
    OutsideForm,
    declared,
    draw_amounts,
    draw_event,
    draw_wrong,
    events,
    outside_forms,
    shape_of,
    strange_effect,
)
from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.criteria import ACCEPTED_GAIN, ERROR_LIMIT, EVENT_GAIN
from gyrowheel_analysis.diagnosis.channel_checks import places_of
from gyrowheel_analysis.diagnosis.event_scan import places, price
from gyrowheel_analysis.diagnosis.selection import threshold
from gyrowheel_analysis.fitting.fit import ERRORS, Term, Unknowns, candidate_terms, parameter_errors
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.loops.controller import Gains
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_core.readings import Readings
from gyrowheel_recording.bags import write_run
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import draw_effect, draw_machine
from gyrowheel_sim.effects import Effect, EffectValues, physical, remembering
from gyrowheel_sim.effects.registry import for_bench
from gyrowheel_sim.environment import to_json
from gyrowheel_sim.plant.scenario import Scenario

Array = NDArray[np.float64]

#: Range of the sizes, in detection limits.
SMALLEST, LARGEST = 1.0, 10.0
#: Smallest size outside the library, in detection limits: a smaller one could be taken for a library effect.
SMALLEST_OUTSIDE = 2.0
#: Sizes of a look-alike, in its detection limits, and the number of the most similar effects among which it is drawn.
ALIKE = (0.3, 1.0)
_MOST_ALIKE = 3
#: Largest size, in largest usual sizes, however little a recording shows of the effect.
MOST_OF_USUAL = 3.0
#: Largest relative error of a bench parameter.
MOST_RELATIVE = 0.5
_VARIATION = 1.4  # largest factor of noise and drift about the requested level
_GAIN_SPREAD = 0.2  # largest change of the logarithm of a gain
_VARIED_GAINS = tuple(item.name for item in fields(Gains))


@dataclass(frozen=True)
class Secret:
    """The hidden machine of a case."""

    scenario: Scenario
    truth: EffectValues = field(
        default_factory=dict
    )  # {effect or error of a bench parameter: {coefficient: value}}
    #: Size of each over its detection limit in a recording of this plan; NaN if the plan does not show it.
    sizes: dict[str, float] = field(default_factory=dict)
    #: Outside the library: the effect that is right with another exponent, and the exponent.
    resembles: tuple[str, str] | None = None
    gains: Gains = field(default_factory=Gains)  # of the controller
    lost: float = 0.0  # fraction of lost samples
    noise: float = 1.0  # white noise and slow drifts, as multiples of the stated ones
    drift: float = 1.0
    instruments: EffectValues = field(
        default_factory=dict
    )  # wrong instruments: {effect: {coefficient: value}}
    alike: EffectValues = field(default_factory=dict)  # a look-alike of the effect, below its limit
    event: HiddenEvent | None = None  # event in the first recording
    event_values: dict[str, float] = field(default_factory=dict)  # its coefficients

    def to_json(self) -> dict[str, Any]:
        """Return the content of the key file."""
        return {
            "values": dict(self.scenario.values),
            "effects": self.truth,
            "sizes_in_limits": self.sizes,
            "gains": asdict(self.gains),
            "lost": self.lost,
            "noise": self.noise,
            "drift": self.drift,
            "noise_seed": self.scenario.noise_seed,
            "instruments": self.instruments,
            "alike": self.alike,
            "event": None if self.event is None else {**asdict(self.event), **self.event_values},
        }


class Yardstick:
    """Detection limits of a plan on a bench.

    A recording of the stated bench is reduced once. The response of an effect is measured in units of the noise, after
    a fit of all bench parameters.
    """

    def __init__(self, bench: Bench, plan: Plan) -> None:
        run = simulate(bench, Scenario.nominal(noise_seed=1), plan)
        samples = Samples(
            time=np.arange(len(run.measurement), dtype=np.float64) * bench.sample_period,
            readings=Readings(run.measurement),
            setpoint_time=run.setpoints["stamp_ns"] * 1e-9,
            setpoint=run.setpoints,
            environment=run.environment,
        )
        outside = {form.effect.name: form.effect for form in outside_forms()} | events()
        balance = Balance(reduce(samples, bench), bench)
        if not len(balance.windows.start):
            raise InputError(f"plan {plan.name}: no steady motion in it; allowed: holds of a second and more")
        self._problem = Problem.of([balance], Unknowns(bench, declared=outside))
        self._places = places(self._problem)
        self._responses: dict[str, Array] = {}
        self.errors = parameter_errors(self._problem.bench)

    def size(self, name: str, values: dict[str, float], drift: float, beside: EffectValues) -> float:
        """Return the size of an effect, or an event, over its detection limit; NaN if the recording does not show it.

        `drift` is a multiple of the stated drifts. The part of the response that the other hidden effects in `beside`
        explain does not count.
        """
        others = [self._response(other, given) for other, given in beside.items()]
        left = self._left(np.column_stack([*others, self._response(name, values)]), drift)
        needed = self._asked_of_event(name) if name in events() else threshold(self._term(name), 1.0)
        return _over_limit(_apart(left[:, -1], left[:, :-1]), needed)

    def _asked_of_event(self, name: str) -> float:
        """Return the chi-squared that an event must gain, of unknown kind and time."""
        return EVENT_GAIN + price(shape_of(name), self._places)

    def alike(self, name: str, values: dict[str, float], drift: float) -> list[str]:
        """Return the other effects of the library, those first that explain most of the response of an effect."""
        terms = [t for t in candidate_terms(self._problem.bench) if t.effect is not None and t.name != name]
        columns = [self._columns(term) for term in terms]
        left = self._left(np.column_stack([*columns, self._response(name, values)]), drift)
        edges = np.cumsum([0, *(own.shape[1] for own in columns)])
        apart = [_apart(left[:, -1], left[:, a:b]) for a, b in itertools.pairwise(edges)]
        return [terms[k].name for k in np.argsort(apart, kind="stable")]

    def left(
        self, name: str, values: dict[str, float], other: str | Effect, drift: float
    ) -> dict[str, float]:
        """Return what another law leaves of the response of an effect, by channel [times the noise, RMS]."""
        term = Term(other.name, other) if isinstance(other, Effect) else self._term(other)
        columns = self._problem.term_jacobian(term, self._problem.unknowns.stated(), term.amplitudes)
        left = self._left(np.column_stack([columns, self._response(name, values)]), drift)
        rest = _unexplained(left[:, -1], left[:, :-1])
        return {
            channel: math.sqrt(float(np.mean(rest[rows] ** 2)))
            for channel, rows in places_of(self._problem.balances).items()
        }

    def size_outside(self, form: OutsideForm, values: dict[str, float], drift: float) -> float:
        """Return the same for an effect outside the library: the part that no single library effect explains counts."""
        terms = [self._columns(term) for term in candidate_terms(self._problem.bench)]
        problem, term = self._problem, Term(form.effect.name, form.effect)
        point = replace(problem.unknowns.stated({term.name: values}), terms=(term,))
        response = problem.predict(point) - problem.base
        left = self._left(np.column_stack([*terms, response]), drift)
        edges = np.cumsum([0, *(columns.shape[1] for columns in terms)])
        chi2 = min(_apart(left[:, -1], left[:, a:b]) for a, b in itertools.pairwise(edges))
        return _over_limit(chi2, ACCEPTED_GAIN)

    def error_limit(self, name: str, drift: float) -> float:
        """Return the smallest relative error of a bench parameter that is a finding."""
        problem = self._problem
        groups = ERRORS[name]
        stated = max(
            p.relative_uncertainty for group, ps in problem.unknowns.nuisances if group in groups for p in ps
        )
        keep = [group not in groups for group, _ in problem.unknowns.nuisances]
        keep += [True] * (problem.count - len(keep))
        left = self._left(self._response(name, {"relative_error": 1.0e-3})[:, None] * 1.0e3, drift, keep)
        size = float(np.linalg.norm(left))
        error = 1.0 / size if size > 0.0 else math.inf
        return max(ERROR_LIMIT * stated + 2.0 * error, math.sqrt(ACCEPTED_GAIN) * math.hypot(stated, error))

    def _term(self, name: str) -> Term:
        return Term(name, self._problem.unknowns.library.get(name))

    def _response(self, name: str, values: dict[str, float]) -> Array:
        return self._problem.predict(self._problem.unknowns.stated({name: values})) - self._problem.base

    def _columns(self, term: Term) -> Array:
        if term.name not in self._responses:
            jacobian = self._problem.term_jacobian(term, self._problem.unknowns.stated())
            self._responses[term.name] = jacobian[:, : len(term.amplitudes)]
        return self._responses[term.name]

    def _left(self, columns: Array, drift: float, parameters: list[bool] | None = None) -> Array:
        """Return the part of responses that bench parameters cannot explain, in units of the noise."""
        problem = self._problem
        # the diagnosis assumes no drift below the stated one
        noise = problem.noise.with_scales(dict.fromkeys(problem.noise.scales, max(drift, 1.0)))
        keep = np.array([True] * problem.count if parameters is None else parameters)
        free = problem.base_jacobian[:, keep]
        white = noise.whiten(np.column_stack([free, columns]))
        count = free.shape[1]
        design = np.vstack([white, np.eye(count, white.shape[1])])
        basis, _ = np.linalg.qr(design[:, :count] / np.linalg.norm(design[:, :count], axis=0))
        rest = design[:, count:]
        return rest - basis @ (basis.T @ rest)


def _unexplained(response: Array, others: Array) -> Array:
    """Return the part of a response that other columns cannot explain."""
    size = np.linalg.norm(others, axis=0)
    others = others[:, size > 1.0e-9 * max(size.max(initial=0.0), 1e-300)]
    if others.shape[1]:
        solution, *_ = np.linalg.lstsq(others / np.linalg.norm(others, axis=0), response, rcond=1e-9)
        response = response - (others / np.linalg.norm(others, axis=0)) @ solution
    return response


def _apart(response: Array, others: Array) -> float:
    """Return the chi-squared of a response that other columns cannot explain."""
    rest = _unexplained(response, others)
    return float(rest @ rest)


_made: dict[tuple[str, str], Yardstick] = {}


def yardstick(bench: Bench, plan: str) -> Yardstick:
    """Return the yardstick of a bench and a plan (text); made once per process."""
    key = (bench.describe(), plan)
    if key not in _made:
        with one_thread():  # as in the cases: a secret must be bitwise the same wherever it is drawn
            _made[key] = Yardstick(bench, Plan.load(plan))
    return _made[key]


def _over_limit(chi2: float, needed: float) -> float:
    return math.sqrt(chi2 / needed) if chi2 > 1.0e-9 else math.nan


def hide(case: Case, measure: Yardstick) -> Secret:
    """Draw the secret of a case, the same wherever it is drawn; `measure` has the detection limits of its plan."""
    campaign = case.campaign
    bench = campaign.bench
    rng = np.random.default_rng([campaign.seed, case.index, 0x68696465])
    values = draw_machine(bench, rng)
    noise, drift = (
        level * _VARIATION ** rng.uniform(-1.0, 1.0) for level in (campaign.noise, campaign.drift)
    )
    for p in bench.parameters.values():
        if p.name.endswith("_noise"):
            values[p.name] = p.value * noise
        elif p.name.endswith("_drift"):
            values[p.name] = p.value * drift
    truth: EffectValues = {}
    wrong: EffectValues = {}
    if campaign.reality:
        # a separate stream: the other draws do not depend on it
        apart = np.random.default_rng([campaign.seed, case.index, 0x7265616C])
        values |= draw_amounts(bench, apart)
        wrong = draw_wrong(
            bench,
            case.kind,
            values,
            apart,
            lambda names: _turn(names, campaign.seed, case.index, "instrument"),
        )
    resembles = None
    strange: dict[str, Effect] = {}
    if case.kind == "outside":
        pool = (*outside_forms(), *(STRANGE if campaign.reality else ()))
        chosen = _turn(pool, campaign.seed, case.ordinal, "outside")
        if isinstance(chosen, OutsideForm):
            form, drawn = chosen, draw_effect(chosen.effect, rng)
        else:
            effect, drawn = strange_effect(chosen, rng)
            form, strange = OutsideForm(effect), {effect.name: effect}
        factor = _log_uniform(rng, SMALLEST_OUTSIDE, LARGEST)
        truth[form.effect.name], size = _scaled(
            form.effect, drawn, factor, lambda v: measure.size_outside(form, v, drift), capped=False
        )
        sizes = {form.effect.name: size}
        resembles = (form.resembles, form.exponent) if form.resembles else None
    else:
        truth, sizes = _library(case, measure, drift, rng, wrong)
    alike = _alike(case.campaign.bench, measure, drift, rng, truth) if case.kind == "alike" else {}
    for name, coefficients in truth.items():
        for group, parameters in bench.groups().items():
            if group in ERRORS.get(name, ()):
                for p in parameters:
                    # a single group has exactly this error; several keep their own share of the uncertainty
                    drawn_part = values[p.name] if len(ERRORS[name]) > 1 else p.value
                    values[p.name] = drawn_part + p.value * coefficients["relative_error"]
    gains = _draw_gains(campaign.bench.gains, campaign.gains, rng)
    for name, given in wrong.items():
        others = {other: v for other, v in {**wrong, **truth}.items() if other != name}
        sizes[name] = measure.size(name, given, drift, others)
    event: HiddenEvent | None = None
    event_values: dict[str, float] = {}
    if case.kind == "event":
        event, event_values = _event(case, measure, drift, apart, wrong)
        sizes[event.name] = measure.size(event.name, event_values, drift, wrong)
    scenario = Scenario(
        values=values,
        effects={name: v for name, v in {**truth, **alike, **wrong}.items() if name not in ERRORS},
        noise_seed=int(rng.integers(2**32)),
        declared=strange or (declared() if set(truth) & set(declared()) else {}),
    )
    return Secret(
        scenario,
        truth,
        sizes,
        resembles,
        gains,
        campaign.lost,
        noise,
        drift,
        wrong,
        alike,
        event,
        event_values,
    )


def _event(
    case: Case, measure: Yardstick, drift: float, rng: np.random.Generator, wrong: EffectValues
) -> tuple[HiddenEvent, dict[str, float]]:
    """Draw an event, scaled to the detection limit."""
    bench, plan = case.campaign.bench, Plan.load(case.campaign.plan)
    name = _turn(tuple(events()), case.campaign.seed, case.ordinal, "event")
    event, drawn = draw_event(bench, name, plan.duration, rng)
    effect = for_bench(events()[name], bench)
    factor = _log_uniform(rng, SMALLEST, LARGEST)
    values, _ = _scaled(effect, drawn, factor, lambda v: measure.size(name, v, drift, wrong), capped=True)
    return event, values


def _alike(
    bench: Bench, measure: Yardstick, drift: float, rng: np.random.Generator, truth: EffectValues
) -> EffectValues:
    """Draw a look-alike of the hidden effect, below its detection limit next to it."""
    ((name, values),) = truth.items()
    other = str(rng.choice(measure.alike(name, values, drift)[:_MOST_ALIKE]))
    effect = for_bench(physical()[other], bench)
    drawn, _ = _scaled(
        effect,
        draw_effect(effect, rng),
        rng.uniform(*ALIKE),
        functools.partial(measure.size, other, drift=drift, beside=truth),
        capped=True,
    )
    return {other: drawn}


def _library(
    case: Case, measure: Yardstick, drift: float, rng: np.random.Generator, wrong: EffectValues
) -> tuple[EffectValues, dict[str, float]]:
    """Draw effects of the library, or errors of bench parameters, and their sizes."""
    seed = case.campaign.seed
    bench = case.campaign.bench
    known = {name: for_bench(own, bench) for name, own in {**physical(), **remembering()}.items()}
    chosen: list[str] = []
    if case.kind == "single":
        chosen = [_turn((*physical(), *measure.errors), seed, case.ordinal, "single")]
    elif case.kind == "alike":
        chosen = [_turn(tuple(physical()), seed, case.ordinal, "alike")]
    elif case.kind == "memory":
        chosen = [_turn(tuple(remembering()), seed, case.ordinal, "memory")]
    elif case.kind == "pair":
        first = _turn(tuple(physical()), seed, case.ordinal, "pair")
        chosen = [first, str(rng.choice([name for name in physical() if name != first]))]
    drawn = {name: draw_effect(known[name], rng) for name in chosen if name in known}
    truth: EffectValues = {}
    sizes: dict[str, float] = {}
    for name in chosen:
        factor = _log_uniform(rng, SMALLEST, LARGEST)
        if name in ERRORS:
            limit = measure.error_limit(name, drift)
            error = min(factor * limit, MOST_RELATIVE)
            truth[name] = {"relative_error": error * float(rng.choice((-1.0, 1.0)))}
            sizes[name] = error / limit
            continue
        beside = wrong | {other: values for other, values in drawn.items() if other != name}
        truth[name], sizes[name] = _scaled(
            known[name],
            drawn[name],
            factor,
            functools.partial(measure.size, name, drift=drift, beside=beside),
            capped=True,
        )
    return truth, sizes


def _scaled(
    effect: Effect, values: dict[str, float], factor: float, size: Any, *, capped: bool
) -> tuple[dict[str, float], float]:
    """Return an effect's coefficients, with its amplitudes scaled to a size, and the size.

    An effect that the recording does not show keeps the drawn size. With `capped` no amplitude exceeds a multiple of
    the largest usual size; none exceeds its bounds, and their sum not the largest possible one.
    """
    # largest possible size of all amplitudes together: the Earth does not turn faster
    most_together = math.inf if effect.greatest is None else effect.greatest
    together = math.hypot(*(values[c.name] for c in effect.amplitudes))
    now = size(values)
    part = 1.0 if math.isnan(now) else factor / now
    if together > 0.0:
        part = min(part, most_together / together)
    for c in effect.amplitudes:
        if values[c.name] == 0.0 or math.isnan(now):
            continue
        most = c.bounds[1] if values[c.name] > 0.0 else -c.bounds[0]
        if capped:
            most = min(most, MOST_OF_USUAL * c.usual[1])
        part = min(part, most / abs(values[c.name]))
    amplitudes = {c.name for c in effect.amplitudes}
    scaled = {key: value * part if key in amplitudes else value for key, value in values.items()}
    return scaled, size(scaled)


def _turn(pool: tuple[Any, ...], seed: int, ordinal: int, purpose: str) -> Any:
    """Return the next member of a pool: all in random order before any is repeated."""
    round_, place = divmod(ordinal, len(pool))
    rng = np.random.default_rng([seed, round_, *purpose.encode()])
    return pool[int(rng.permutation(len(pool))[place])]


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _draw_gains(usual: Gains, spin: float, rng: np.random.Generator) -> Gains:
    """Draw the gains of a controller about those of the bench, the spin gains about `spin` times those."""
    drawn = {
        name: getattr(usual, name) * math.exp(rng.uniform(-1.0, 1.0) * _GAIN_SPREAD) for name in _VARIED_GAINS
    }
    for name in ("spin_proportional", "spin_integral"):
        drawn[name] *= spin
    return Gains(**drawn)


def record(case: Case, secret: Secret, plan: str, part: int, directory: Path) -> None:
    """Run a plan (text) on the hidden machine and write the recording; each `part` has its own noise."""
    bench = case.campaign.bench
    seeds = np.random.SeedSequence([secret.scenario.noise_seed, part]).generate_state(2)
    scenario = replace(secret.scenario, noise_seed=int(seeds[0]))
    if secret.event is not None:
        # in the recording that is diagnosed only
        happens = {secret.event.name: secret.event_values} if part == 0 else {}
        scenario = replace(
            scenario, effects={**scenario.effects, **happens}, declared={**scenario.declared, **events()}
        )
    run = simulate(bench, scenario, Plan.load(plan), gains=secret.gains)
    arrived = np.random.default_rng(int(seeds[1])).random(len(run.measurement)) >= secret.lost
    write_run(
        directory,
        run.measurement,
        run.command,
        run.setpoints,
        to_json(run.environment),
        bench.describe(),
        sample_period=bench.sample_period,
        arrived=arrived,
        stamps=run.stamps,
    )
