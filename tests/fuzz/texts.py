"""Text files that people write: plans, benches, models, column maps, geometries, scenarios and formulas."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from gyrowheel_air.geometry import Geometry
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags.selection import parted
from gyrowheel_recording.mapping import ColumnMap
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import registry
from gyrowheel_sim.effects.law_code import laws_source
from gyrowheel_sim.effects.user_defined_line import effect_to_line, typed_effect
from gyrowheel_sim.parameter import INSTRUMENTS
from gyrowheel_sim.plant.scenario import Scenario

from .damage import mutated_text, mutated_words
from .harness import Case, WrongAnswer

MODEL = """schema: 1
bench: gyrowheel
overrides:
  shaft_inertia: {value: 1.1e-4, standard_error: 2.0e-6}
effects:
  windage:
    w: {value: 0.001, standard_error: 1.0e-5}
    n: 1.5
  stator_pull:
    declaration:
      torque: -k*r*z
      coefficients:
        k: {unit: N*m/rad, usual: [0.01, 0.05]}
    k: {value: 0.02, standard_error: 0.001}
history:
- time: '2026-11-21T10:01:25+00:00'
  what: add windage
  fit: [runs/quick]
  validate: [runs/check]
  error:
    unit: N·m
    before:
      rms: {tilt_x: 1.3e-4, tilt_y: 1.3e-4, spin: 8.7e-5}
      chi2_per_n: 12.07
    after:
      rms: {tilt_x: 2.2e-5, tilt_y: 2.6e-5, spin: 8.3e-5}
      chi2_per_n: 1.05
  undo:
    overrides: {}
    effects: {}
"""
MAP = """schema: 1
bench: gyrowheel
time: {column: t_ms, unit: ms}
columns:
  tilt_x: {column: TiltX, unit: deg}
  tilt_y: {column: TiltY, unit: deg, scale: -1}
  spin_angle: {column: Angle, unit: deg}
  spin_rate: {column: Speed, unit: rpm}
  coil_voltage_x: {column: Ux, unit: V}
  coil_voltage_y: {column: Uy, unit: V, offset: 0.01}
  motor_voltage: {column: Um, unit: V}
  motor_current: {column: Im, unit: mA}
  coil_temperature: {value: 25, unit: degC}
  air_temperature: {value: 22, unit: degC}
  air_pressure: {value: 1013, unit: hPa}
environment:
- {time_s: 0, rig: upright}
csv: {delimiter: ",", decimal: ".", skip_lines: 0}
"""


class TextKind(NamedTuple):
    """A kind of text file: samples of it, and what reads and uses one."""

    name: str
    texts: list[str]
    use: Callable[[Path], None]


def _use_plan(file: Path) -> None:
    plan = Plan.load(file)
    if not 0.0 < plan.duration < float("inf"):
        raise WrongAnswer(f"a plan of {plan.duration} s")
    plan.check(Bench.load())
    if plan.duration < 3600.0 and not all(
        np.all(np.isfinite(plan.setpoints()[n])) for n in ("tilt_x", "spin_rate")
    ):
        raise WrongAnswer("a setpoint that is not finite")


def _use_bench(file: Path) -> None:
    bench = Bench.load(file)
    stated = yaml.safe_load(file.read_text(encoding="utf-8"))["parameters"]
    for name, value in bench.values().items():
        given = stated[name]["value"] if name in stated else INSTRUMENTS[name]
        if not np.isfinite(value) or value != float(given):
            raise WrongAnswer(f"{name} is {given} in the file and {value} in the bench")
    bench.describe()


def _use_model(file: Path) -> None:
    model = Model.load(file)
    numbers = [c for effect in model.effects.values() for c in effect.values()]
    numbers += [override.value for override in model.overrides.values()]
    if not np.all(np.isfinite(numbers)):
        raise WrongAnswer("a number of the model is not finite")
    model.save(file.with_name("again.yaml"))
    if Model.load(file.with_name("again.yaml")).effects != model.effects:
        raise WrongAnswer("saved and loaded it is another model")


def _use_scenario(file: Path) -> None:
    scenario = Scenario.load(file, Bench.load())
    if not np.all(np.isfinite(list(scenario.values.values()))):
        raise WrongAnswer("a value of the scenario is not finite")


def text_kinds(folder: Path) -> list[TextKind]:
    """Return every kind of text file that users give, but for metadata of recordings."""

    def shipped(package: str, path: str, having: str = "") -> list[str]:
        files = resources.files(package).joinpath(path).iterdir()
        texts = [f.read_text(encoding="utf-8") for f in files if f.name.endswith(".yaml")]
        return [text for text in texts if having in text]

    scenario = folder / "scenario.json"
    Scenario({"shaft_inertia": 1.1e-4}, {"windage": {"w": 0.001, "n": 1.5}}, 3).save(scenario)
    return [
        TextKind("plan", shipped("gyrowheel_control", "plans"), _use_plan),
        TextKind("bench", shipped("gyrowheel_sim", "config", "parameters:"), _use_bench),
        TextKind("model", [MODEL], _use_model),
        TextKind("map", [MAP], lambda file: void(ColumnMap.load(file))),
        TextKind(
            "geometry", shipped("gyrowheel_air", "", "lengths:"), lambda file: void(Geometry.load(file))
        ),
        TextKind("scenario", [scenario.read_text(encoding="utf-8")], _use_scenario),
    ]


def void(_: object) -> None:
    """Take what is not looked at."""


def files(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage text files and use them."""
    every = [kind for kind in text_kinds(folder) if kind.texts]
    file = folder / "file.yaml"
    for kind in every:
        for text in list(kind.texts):
            file.write_text(text, encoding="utf-8")
            try:
                kind.use(file)
            except InputError:  # a plan of another bench
                kind.texts.remove(text)
        if not kind.texts:  # what is not damaged must pass, or nothing is shown
            raise AssertionError(kind.name)
    while True:
        kind = rng.choice(every)

        def use(data: bytes, kind: TextKind = kind) -> str:
            file.write_bytes(data)
            kind.use(file)
            return "accepted"

        text = mutated_text(rng.choice(kind.texts), rng)
        yield Case(kind.name, text.encode("utf-8", "surrogatepass"), use)


_TYPED = (
    "stator_pull: torque = -k*r^2*z; k = 0.02 [N*m/rad]",
    "gain: coil_gain = k*abs(z)^p; k [1]; p = 0.6 +- 0.05 [1]",
    "two: torque = i*k*z_rate; coil_gain = c*(1 + 0.1*sin(theta_z)); k [N*m*s/rad]; c [1]",
    "-k*z*max(0, 1 - abs(z)/a); k [N*m/rad]; a = 0.1 +- 0.01 [rad]",
    "-k*r*z",
)


def formulas(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage declarations of effects in one line, and generate code of what is accepted."""
    texts = [*_TYPED, *(f"own: {effect_to_line(effect)}" for effect in registry().values())]
    for text in texts:
        _use_formula(text.encode())
    while True:
        text = mutated_words(rng.choice(texts), rng)
        yield Case("formula", text.encode("utf-8", "surrogatepass"), _use_formula)


def _use_formula(data: bytes) -> str:
    effect = typed_effect(data.decode("utf-8", "surrogatepass"), otherwise="own")
    compile(laws_source([effect]), "laws", "exec")
    again = typed_effect(effect_to_line(effect), name=effect.name)
    if {law.target for law in again.laws} != {law.target for law in effect.laws}:
        raise WrongAnswer("printed and read again it is another effect")
    return "accepted"


_WORDS: tuple[tuple[str, Callable[[str], object]], ...] = (
    ("quick@rig=inverted,spin_ratio=0.5", Plan.load),
    ("cone@hold_s=3", Plan.load),
    ("check@spin_ratio=0.8,tilt_ratio=0.5", Plan.load),
    ("runs/monday@from=20,until=110", parted),
    ("gyrowheel", Bench.load),
)


def words(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage what is typed in the place of a file: plans with a variation, parts of recordings, names of benches."""
    while True:
        text, read = rng.choice(_WORDS)

        def use(data: bytes, read: Callable[[str], object] = read) -> str:
            text = data.decode("utf-8", "surrogatepass")
            if "/dev/" in text:
                raise InputError("not tried")
            read(text)
            return "accepted"

        yield Case(read.__qualname__, mutated_words(text, rng).encode("utf-8", "surrogatepass"), use)
