"""How often an answer about a model is right, where no campaign asks: ``python -m benchmarks.verdicts KIND``.

A case is a machine of `gyrowheel.campaigns.hidden` with one effect. Recordings of the plans quick and check are all
that the analysis gets. Finished cases are lines of a JSON file; a second run continues it. The kinds:

- ``wrong``: somebody adds another law that leaves a channel at 2 to 5 times its noise. Is it called consistent? And the
  law that the machine has: is it called inconsistent?
- ``right``: the latter alone, for effects of 1 to 10 times their detection limit.
- ``two``: the right law and a wrong one are compared. Which one is preferred?
- ``rough``, ``rough one``: noise with heavy tails, 1/f noise or bursts, with nothing hidden and with one effect.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyrowheel.campaigns.cases import Campaign, Case, CaseKind
from gyrowheel.campaigns.finder import find
from gyrowheel.campaigns.hidden import MOST_OF_USUAL, Secret, Yardstick, hide, record, yardstick
from gyrowheel.campaigns.judge import judge
from gyrowheel.catalogue.api import own_effect
from gyrowheel_analysis.add import Added, add_effect
from gyrowheel_analysis.compare_models import compare_models
from gyrowheel_analysis.diagnosis.explanation import Explanation, explained
from gyrowheel_analysis.fitting.fit import ERRORS
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect, registry
from gyrowheel_sim.effects.registry import for_bench
from gyrowheel_sim.instruments import Reading
from gyrowheel_sim.plant.machine import Machine

Array = NDArray[np.float64]
Kind = Literal["wrong", "right", "two", "rough", "rough one"]
Noise = Literal["student", "flicker", "bursts"]
NOISES: tuple[Noise, ...] = ("student", "flicker", "bursts")

#: Sizes of the channel that a wrong law leaves [times its noise].
LEFT = (2.0, 5.0)
#: Laws that somebody may write down; their coefficients are fitted.
LAWS = {
    "axial_torque": ("-k", "-k*r", "-k*r^1.5", "-k*r^2", "-k*r^3", "-k*r^2*abs(z)"),
    "rotor_torque": (
        "a + i*b",
        "-k*z",
        "-k*r*z",
        "-k*r^2*z",
        "i*k*z",
        "i*k*r*z",
        "i*k*r^2*z",
        "-k*abs(z)*z",
        "-k*z_rate",
        "k*conj(z)",
    ),
}
#: Most similar effects, among which a wrong one is drawn.
ALIKE = {"wrong": 6, "two": 3}
_SAME = 1e-3  # times the noise, of what one law leaves of another
_STEPS_OF_TIME = 4.0  # ratio of the time constants that together give 1/f
_TIMES = 1e-2 * _STEPS_OF_TIME ** np.arange(9.0)  # s


def wrong_law(case: Case, secret: Secret, measure: Yardstick, alike: int) -> str | Effect:
    """Return a wrong law: one of the `alike` effects most similar to the hidden one, or one of `LAWS`."""
    rng = np.random.default_rng([case.campaign.seed, case.index, 0x77726F6E])
    ((name, values),) = secret.truth.items()
    if rng.uniform() < 0.5:
        target = "axial_torque" if rng.uniform() < 0.4 else "rotor_torque"
        return own_effect(f"{target} = {rng.choice(LAWS[target])}", name="own")
    return str(rng.choice(measure.alike(name, values, secret.drift)[:alike]))


def noticeable(case: Case, secret: Secret, wrong: str | Effect, measure: Yardstick) -> Secret | None:
    """Return the secret with a size of its effect of which a wrong law and all bench parameters leave `LEFT`.

    None where no possible size does.
    """
    rng = np.random.default_rng([case.campaign.seed, case.index, 0x73697A65])
    ((name, values),) = secret.truth.items()
    left = max(measure.left(name, values, wrong, secret.drift).values())
    factor = math.sqrt(math.exp(rng.uniform(*np.log(LEFT))) ** 2 - 1.0) / max(left, 1e-9)
    if name in ERRORS:
        return None
    effect = for_bench(registry()[name], case.campaign.bench)
    sizes = {c.name for c in effect.amplitudes}
    scaled = {key: value * factor if key in sizes else value for key, value in values.items()}
    for c in effect.amplitudes:
        most = min(MOST_OF_USUAL * c.usual[1], c.bounds[1] if scaled[c.name] > 0.0 else -c.bounds[0])
        if abs(scaled[c.name]) > most:
            return None
    scenario = replace(secret.scenario, effects={**secret.scenario.effects, name: scaled})
    return replace(secret, scenario=scenario, truth={name: scaled})


class RoughNoise:
    """Standard normal numbers of a machine in which those of the readings are of another noise."""

    def __init__(self, kind: Noise, seed: int, period: float) -> None:
        self._kind, self._period = kind, period
        self._rng = np.random.default_rng([seed, 0x726F7567])
        self.corner = math.exp(self._rng.uniform(math.log(0.1), math.log(10.0)))  # Hz
        self.rate = math.exp(self._rng.uniform(math.log(0.03), math.log(0.3)))  # bursts a second and reading
        size = math.sqrt(2.0 * math.log(_STEPS_OF_TIME) * period * self.corner)
        self._states = size * self._rng.standard_normal((len(_TIMES), 1, len(Reading)))
        self._size = size

    def applied(self, normal: Array) -> Array:
        """Return the numbers of the next samples."""
        own = normal[:, : len(Reading)]
        count = len(own)
        if self._kind == "student":
            # of variance 1, as the stated noise
            own[:] = self._rng.standard_t(3.0, own.shape) / math.sqrt(3.0)
        elif self._kind == "flicker":
            for k, time in enumerate(_TIMES):
                keep = math.exp(-self._period / time)
                steps = self._size * math.sqrt(1.0 - keep**2) * self._rng.standard_normal(own.shape)
                part, self._states[k] = lfilter([1.0], [1.0, -keep], steps, axis=0, zi=keep * self._states[k])
                self._states[k] = part[-1:]
                own += part
        else:
            for column in own.T:
                for _ in range(self._rng.poisson(self.rate * count * self._period)):
                    begin, length = self._rng.integers(count), int(math.exp(self._rng.uniform(2.3, 5.3)))
                    column[begin : begin + length] *= math.exp(
                        self._rng.uniform(math.log(5.0), math.log(30.0))
                    )
        return normal


@contextlib.contextmanager
def rough(kind: Noise, seed: int, period: float) -> Iterator[None]:
    """Let the machines of this process have another noise."""
    noise, plain = RoughNoise(kind, seed, period), Machine.noise
    with mock.patch.object(Machine, "noise", lambda self, samples: noise.applied(plain(self, samples))):
        yield


@contextlib.contextmanager
def _explained_once() -> Iterator[None]:
    """Explain the recordings of a case once: what is already in them does not depend on the law that is added."""
    found: list[Explanation] = []

    def once(*arguments: Any) -> Explanation:
        if not found:
            found.append(explained(*arguments))
        return found[0]

    with mock.patch("gyrowheel_analysis.add.explained", once):
        yield


def _checked(added: Added) -> dict[str, Any]:
    proof, table = added.proof, added.error
    rows = [row for row in (table.after, table.validation_after) if row is not None]
    floors = {
        name: max(math.sqrt(row.channels[name].chi2_per_n) for row in rows if name in row.channels)
        for name in table.after.channels
    }
    return {
        "consistent": proof.proven,
        "reason": proof.reason,
        "causes": list(proof.causes),
        "chi2": proof.chi2_per_n,
        "allowed": proof.allowed,
        "floors": {name: round(size, 2) for name, size in floors.items()},
        "channels": {
            c.channel: [c.fitted, c.fitted_allowed, c.unseen, c.unseen_allowed] for c in proof.channels
        },
    }


def answered(kind: Kind, case: Case, folder: Path) -> dict[str, Any] | None:
    """Return truth and answer of a case; None where its draw is no case of the kind."""
    bench = case.campaign.bench
    measure = yardstick(bench, case.campaign.plan)
    secret = hide(case, measure)
    wrong: str | Effect = ""
    if kind == "two" and {*secret.truth} & {*ERRORS}:
        return None  # a wrong parameter of the bench, not an effect
    if kind in ("wrong", "two"):
        wrong = wrong_law(case, secret, measure, ALIKE[kind])
    if kind == "two":
        ((hidden, values),) = secret.truth.items()
        if max(measure.left(hidden, values, wrong, secret.drift).values()) < _SAME:
            return None  # the same law in another form
    if kind == "wrong":
        larger = noticeable(case, secret, wrong, measure)
        if larger is None:
            return None
        secret = larger
    noise = NOISES[case.index % len(NOISES)]
    rough_noise = rough(noise, case.campaign.seed + 1000003 * case.index, bench.sample_period)
    with rough_noise if kind.startswith("rough") else contextlib.nullcontext():
        for part, plan in enumerate((case.campaign.plan, case.campaign.validation_plan)):
            record(case, secret, plan, part, folder / str(part))
    result: dict[str, Any] = {"hidden": secret.truth, "sizes": secret.sizes}
    if kind.startswith("rough"):
        answer = find(folder / "0", folder / "1", Model(bench))
        judged = judge(case, secret, answer)
        return result | {
            "noise": noise,
            "drift": secret.drift,
            "right": judged.right,
            "outcome": judged.outcome,
            "detectable": judged.detectable,
            "verdict": judged.verdict,
            "named": judged.named,
            "ties": judged.ties,
            "events": [[e.channel, e.kind, e.time, e.gain, e.recording] for e in answer.events],
            "instruments": judged.instruments_named,
            "scales": dict(answer.drift_scales),
        }
    fit, unused = ([Recording.open(folder / str(part))] for part in range(2))
    (name,) = secret.truth
    right = [name]
    if kind == "right":
        return result | _checked(add_effect(Model(bench), right, fit, unused))
    result["wrong"] = wrong if isinstance(wrong, str) else str(wrong.laws[0].expression)
    if kind == "wrong":
        with _explained_once():
            laws = [_checked(add_effect(Model(bench), [law], fit, unused)) for law in (wrong, name)]
        return result | laws[0] | {"right": laws[1]}
    models = [add_effect(Model(bench), [law], fit).model for law in (name, wrong)]
    turned = case.index % 2 == 1
    first, second = models[::-1] if turned else models
    found = compare_models(first, second, fit)
    sides = (found.second, found.first) if turned else (found.first, found.second)
    preferred = {"none": "none", "first": ("right", "wrong")[turned], "second": ("wrong", "right")[turned]}
    return result | {
        "preferred": preferred[found.preferred],
        "evidence": -found.evidence if turned else found.evidence,
        "test": None if found.test is None else found.test.plan,
        "explains": [side.explains for side in sides],
        "chi2": [side.chi2_per_n for side in sides],
    }


def run(kind: Kind, seed: int, count: int, file: Path) -> None:
    """Answer the cases of a kind and seed that a file lacks, until it has as many as wanted."""
    hidden: tuple[CaseKind, ...] = ("none",) if kind == "rough" else ("single",)
    quick, check = (Plan.load(name).to_yaml() for name in ("quick", "check"))
    campaign = Campaign(quick, check, Bench.load(), seed=seed, kinds=hidden)
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    known = [json.loads(line) for line in lines]
    index = 1 + max((row["case"] for row in known), default=-1)
    made = sum("none" not in row for row in known)
    while made < count:
        row: dict[str, Any] = {"kind": kind, "seed": seed, "case": index}
        case = Case(campaign, index, hidden[0], index)
        with tempfile.TemporaryDirectory() as folder:
            try:
                found = answered(kind, case, Path(folder))
            except InputError as error:
                found = {"error": str(error)}
        row |= {"none": True} if found is None else found
        made += found is not None
        with file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row, default=float) + "\n")
        index += 1


def main() -> None:
    """Run the cases that the command asks for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("kind", choices=("wrong", "right", "two", "rough", "rough one"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cases", type=int, default=10)
    parser.add_argument("--to", type=Path, required=True, help="file of the finished cases")
    asked = parser.parse_args()
    run(asked.kind, asked.seed, asked.cases, asked.to)


if __name__ == "__main__":
    main()
