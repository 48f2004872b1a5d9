"""Cases: hidden effects, their size in detection limits, the verdict, and its correctness."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.independent.loop import Run, run
from benchmarks.independent.machine import COEFFICIENTS, ERRORS, Secret, bench_file
from benchmarks.independent.sequence import (
    References,
    long_sequence,
    references,
    short_sequence,
)
from gyrowheel.show.sentences.diagnosis import verdict_sentence
from gyrowheel_analysis.criteria import ACCEPTED_GAIN, ERROR_LIMIT
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.diagnosis.selection import threshold
from gyrowheel_analysis.fitting.fit import Term
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.model import Model
from gyrowheel_core.arrays import one_thread
from gyrowheel_recording.bags import Recording, write_run
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]
Kind = Literal["none", "single", "pair"]
Effects = dict[str, dict[str, float]]

#: Kinds of cases, in turn.
TURNS: tuple[Kind, ...] = ("single", "pair", "none", "single")
SEQUENCES = {"long": long_sequence, "short": short_sequence}
#: Exponents that are drawn, not scaled: ranges of the literature on air drag.
_EXPONENTS = {
    "aero_restoring": (2.0, 2.1),
    "aero_cross": (1.9, 2.06),
    "windage": (1.45, 1.55),
    "windage_tilt": (1.45, 1.55),
}
#: Largest amplitudes of a machine: a few times the usual size.
_LARGEST = {
    "aero_restoring": 0.12, "aero_cross": 0.03, "windage": 4e-3, "windage_tilt": 1.8e-3, "eddy_drag": 3e-5,
    "bearing_coulomb": 9e-3, "bearing_viscous": 3e-5, "cubic_stiffness": 12.0, "flexure_damping": 6e-5,
    "flexure_hysteresis": 0.015, "external_damping": 0.03, "fixed_torque": 9e-3, "stiffness_anisotropy": 0.045,
    "static_imbalance": 6e-4, "cogging": 0.02, "coil_tilt": 0.3, "coil_heating": 0.012, "coil_anisotropy": 0.15,
    "tilt_bias": 0.018, "tilt_rotation": 0.09, "runout": 1.5e-3,
}  # fmt: skip
_MOST_WRONG = 0.5  # of a bench parameter
SMALLEST, LARGEST = 1.0, 10.0
#: Smallest size of an effect that counts, in detection limits.
DETECTABLE = 2.0
#: Effects that turn with the tilt or the case may have either sign.
_EITHER_SIGN = ("windage_tilt", "cubic_stiffness", "coil_tilt", "tilt_rotation", "stiffness_anisotropy")
_SETPOINT = np.dtype(
    [
        ("stamp_ns", np.int64), ("segment", np.uint32), ("phase", np.uint8), ("tilt_x", float), ("tilt_y", float),
        ("tilt_rate_x", float), ("tilt_rate_y", float), ("spin_rate", float), ("spin_acceleration", float),
    ]
)  # fmt: skip
_EVERY = 10  # samples per setpoint


@dataclass(frozen=True)
class Case:
    """A case: hidden effects and result.

    Attributes
    ----------
    number : int
        Number of the case.
    kind : str
        ``none``, ``single`` or ``pair``.
    effects : dict
        {effect: {coefficient: value}}.
    sizes : dict of str to float
        Size of each in detection limits.
    verdict : str
        Verdict of the diagnosis.
    named : dict of str to list of str
        Named effects, each with its ties that have a separating test.
    outcome : str
        ``right``, ``tied``, ``missed``, ``partial``, ``unknown`` or ``wrong``.
    summary : str
        Sentence of the diagnosis.
    """

    number: int
    kind: Kind
    effects: Effects
    sizes: dict[str, float]
    verdict: str = ""
    named: dict[str, list[str]] = field(default_factory=dict)
    outcome: str = ""
    summary: str = ""

    @property
    def detectable(self) -> bool:
        """Whether every hidden effect is at least twice its detection limit."""
        return all(size >= DETECTABLE for size in self.sizes.values())

    @property
    def good(self) -> bool:
        """Whether the answer is right."""
        return self.outcome in ("right", "tied")


class Limits:
    """Detection limits of effects in a recording of the sequence, computed with the model of the bench.

    Parameters
    ----------
    sequence : str
        Name of the sequence.
    """

    def __init__(self, sequence: str) -> None:
        asked = _asked(sequence)
        taken = run(Secret.stated(), asked, np.random.default_rng(0))
        with tempfile.TemporaryDirectory() as folder, one_thread():
            recording = record(Path(folder) / "nothing", taken, asked)
            self._problem = prepare([recording], Model(Bench.load())).problem

    def size(self, name: str, effects: Effects, drift: float) -> float:
        """Return the size of an effect in detection limits, given the other effects and the bench parameters."""
        problem = self._problem
        if name in ERRORS:
            return abs(effects[name]["relative_error"]) / self._error_limit(name, drift)
        others = [self._response(other, effects[other]) for other in effects if other != name]
        left = self._left(np.column_stack([*others, self._response(name, effects[name])]), drift)
        own, rest = left[:, -1], left[:, :-1]
        if rest.shape[1]:
            length = np.linalg.norm(rest, axis=0)
            own = own - (rest / length) @ np.linalg.lstsq(rest / length, own, rcond=1e-9)[0]
        needed = threshold(Term(name, problem.unknowns.library[name]), 1.0)
        return math.sqrt(float(own @ own) / needed)

    def _error_limit(self, name: str, drift: float) -> float:
        problem, lines = self._problem, bench_file()
        groups = {lines[parameter].group for parameter in ERRORS[name]}
        stated = max(lines[p].uncertainty / lines[p].value for p in ERRORS[name])
        keep = [group not in groups for group, _ in problem.unknowns.nuisances]
        left = self._left(self._response(name, {"relative_error": 1e-3})[:, None] * 1e3, drift, keep)
        error = 1.0 / float(np.linalg.norm(left))
        return max(ERROR_LIMIT * stated + 2.0 * error, math.sqrt(ACCEPTED_GAIN) * math.hypot(stated, error))

    def _response(self, name: str, values: Mapping[str, float]) -> Array:
        return self._problem.predict(self._problem.unknowns.stated({name: dict(values)})) - self._problem.base

    def _left(self, columns: Array, drift: float, keep: list[bool] | None = None) -> Array:
        """Return the part of responses that the bench parameters cannot explain, in units of the noise."""
        problem = self._problem
        noise = problem.noise.with_scales(dict.fromkeys(problem.noise.scales, max(drift, 1.0)))
        free = problem.base_jacobian[:, np.array(keep or [True] * problem.count)]
        white = noise.whiten(np.column_stack([free, columns]))
        count = free.shape[1]
        design = np.vstack([white, np.eye(count, white.shape[1])])
        basis, _ = np.linalg.qr(design[:, :count] / np.linalg.norm(design[:, :count], axis=0))
        rest = design[:, count:]
        return np.asarray(rest - basis @ (basis.T @ rest))


@cache
def limits(sequence: str) -> Limits:
    """Return the detection limits of a sequence; computed once per process."""
    return Limits(sequence)


@cache
def _asked(sequence: str) -> References:
    return references(SEQUENCES[sequence](), bench_file()["sample_period"].value)


def record(folder: Path, taken: Run, asked: References, *, setpoints: bool = True) -> Recording:
    """Write readings as a recording, and open it.

    Parameters
    ----------
    folder : Path
        Folder to create.
    taken : Run
        Readings and commands.
    asked : References
        Setpoints.
    setpoints : bool
        Whether the recording has the setpoints.
    """
    period = bench_file()["sample_period"].value
    rows = np.arange(0, len(asked.spin), _EVERY)
    table = np.zeros(len(rows) if setpoints else 0, _SETPOINT)
    if setpoints:
        table["stamp_ns"] = np.round(rows * period * 1e9).astype(np.int64)
        table["segment"], table["phase"] = asked.step[rows], asked.steady[rows]
        table["tilt_x"], table["tilt_y"] = asked.tilt[rows].real, asked.tilt[rows].imag
        table["tilt_rate_x"], table["tilt_rate_y"] = asked.tilt_rate[rows].real, asked.tilt_rate[rows].imag
        table["spin_rate"], table["spin_acceleration"] = asked.spin[rows], asked.spin_rate[rows]
    write_run(
        folder, taken.readings, taken.commands, table, "[]", "", sample_period=period, stamps=taken.stamps
    )
    return Recording.open(folder)


def draw(
    seed: int, number: int, sequence: str, kind: Kind | None = None
) -> tuple[Case, Secret, dict[str, Any]]:
    """Draw a case: hidden effects, machine, and recording.

    Parameters
    ----------
    seed, number : int
        Seed of all cases, and number of this one.
    sequence : str
        Name of the sequence, for the sizes.
    kind : str, optional
        Kind of the case; default: in turn.
    """
    rng = np.random.default_rng([seed, number, 0x696E64])
    kind = kind or TURNS[number % len(TURNS)]
    manner = {
        "gain": math.exp(rng.uniform(-0.2, 0.2)),
        "noise": math.exp(rng.uniform(-0.3, 0.3)),
        "drift": math.exp(rng.uniform(-0.3, 0.3)),
    }
    names = [*_LARGEST, *ERRORS]
    # every effect occurs once before one occurs again
    turn = number // len(TURNS) * TURNS.count("single") + TURNS[: number % len(TURNS)].count("single")
    first = names[
        int(np.random.default_rng([seed, turn // len(names)]).permutation(len(names))[turn % len(names)])
    ]
    if kind == "none":
        chosen = []
    elif kind == "single":
        chosen = [first]
    else:
        chosen = [str(name) for name in rng.choice(list(_LARGEST), 2, replace=False)]
    effects = {name: _unit(name, rng) for name in chosen}
    measure = limits(sequence)
    for name in chosen:
        wanted = math.exp(rng.uniform(math.log(SMALLEST), math.log(LARGEST)))
        now = measure.size(name, effects, manner["drift"])
        biggest = _MOST_WRONG if name in ERRORS else _LARGEST[name]
        largest = max(abs(value) for key, value in effects[name].items() if key != "n")
        factor = min(wanted / now, biggest / largest)
        effects[name] = {key: value if key == "n" else value * factor for key, value in effects[name].items()}
    sizes = {name: measure.size(name, effects, manner["drift"]) for name in chosen}
    return Case(number, kind, effects, sizes), Secret.drawn(rng, effects), {**manner, "rng": rng}


def _unit(name: str, rng: np.random.Generator) -> dict[str, float]:
    """Return an effect of a small size with a direction drawn at random."""
    sign = float(rng.choice((-1.0, 1.0)))
    if name in ERRORS:
        return {"relative_error": 0.01 * sign}
    keys = [key for effect, key in COEFFICIENTS if effect == name and key != "n"]
    if len(keys) == 2:
        turn = rng.uniform(0.0, 2.0 * math.pi)
        size = 0.1 * _LARGEST[name]
        result = {keys[0]: size * math.cos(turn), keys[1]: size * math.sin(turn)}
    else:
        result = {keys[0]: 0.1 * _LARGEST[name] * (sign if name in _EITHER_SIGN else 1.0)}
    if name in _EXPONENTS:
        result["n"] = float(rng.uniform(*_EXPONENTS[name]))
    return result


def solve(
    seed: int, number: int, sequence: str = "long", kind: Kind | None = None, *, setpoints: bool = True
) -> Case:
    """Draw a case, record it, diagnose it, and judge the verdict.

    Parameters
    ----------
    seed, number, sequence, kind
        See `draw`.
    setpoints : bool
        Whether the recording has the setpoints.
    """
    case, secret, manner = draw(seed, number, sequence, kind)
    asked = _asked(sequence)
    taken = run(secret, asked, **manner)
    with tempfile.TemporaryDirectory() as folder:
        # the diagnosis gets only the recording and the bench file
        recording = record(Path(folder) / "recording", taken, asked, setpoints=setpoints)
        answer = diagnose([recording], Model(Bench.load()))
    return judged(case, answer)


def judged(case: Case, answer: Diagnosis) -> Case:
    """Return a case with its verdict and outcome."""
    named = {
        finding.name: [tie.name for tie in finding.ties if tie.separating_plan] for finding in answer.effects
    }
    left = set(case.effects)
    outcome = "right"
    if answer.verdict == "unknown":
        outcome = "unknown"
    else:
        for name in sorted(named, key=lambda n: n not in left):
            if name in left:
                left.discard(name)
            elif found := left.intersection(named[name]):
                left -= {sorted(found)[0]}
                outcome = "tied"
            else:
                outcome = "wrong"
                break
        if left and outcome != "wrong":
            outcome = "partial" if len(left) < len(case.effects) else "missed"
    return Case(
        case.number,
        case.kind,
        case.effects,
        case.sizes,
        answer.verdict,
        named,
        outcome,
        verdict_sentence(answer),
    )
