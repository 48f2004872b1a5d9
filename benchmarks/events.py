"""Events hidden in recordings at random: how many are found and dated, and how often there is a false alarm.

``python -m benchmarks.events --cases 100 --plan survey`` draws machines with drifts of 0.5 to 3 times the stated size,
most of them with an effect, adds a step, a trend or a burst to a recorded reading in three of four, and diagnoses.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gyrowheel.show.layout import plain_text, words_table
from gyrowheel_analysis.criteria import EVENT_GAIN
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.event_scan import places, price
from gyrowheel_analysis.diagnosis.evidence import Evidence, Profiles
from gyrowheel_analysis.diagnosis.selection import select
from gyrowheel_analysis.fitting.events import QUANTITIES, Event
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.model import Model
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.arrays import one_thread
from gyrowheel_recording.bags import Recording, write_run
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import draw
from gyrowheel_sim.environment import to_json

_DRIFTS = ("coil_voltage_drift", "motor_current_drift", "motor_voltage_drift")
_READINGS = ("coil_voltage_x", "coil_voltage_y", "motor_current", "motor_voltage")
_CHANNELS = {"coil_voltage_x": "torque_x", "coil_voltage_y": "torque_y"}
_WITHIN = 2.0  # s
_CLEAR = 2.0  # detection limits


@dataclass(frozen=True)
class Case:
    """A case: the truth, and the findings.

    Attributes
    ----------
    seed : int
        Its seed.
    drift : float
        Size of the drifts over the stated one.
    effects : tuple of str
        Effects in the machine.
    event : Event or None
        The event.
    limits : float
        Size of the event in detection limits.
    off : float or None
        Time from the true to the estimated edge [s]; None if no event of that reading was found.
    others : int
        Number of other events that were found.
    findings : tuple of str
        Effects that the diagnosis named.
    """

    seed: int
    drift: float
    effects: tuple[str, ...]
    event: Event | None
    limits: float
    off: float | None
    others: int
    findings: tuple[str, ...]


def run(seed: int, plan: str, folder: Path) -> Case:
    """Draw a case and diagnose it."""
    bench = Bench.load()
    rng = np.random.default_rng([seed, 0x6576656E])
    machine = draw(bench, seed, kinds=("none", "single"))
    drift = float(rng.choice((0.5, 1.0, 2.0, 3.0)))
    machine = replace(
        machine, values={**machine.values, **{name: drift * bench.value(name) for name in _DRIFTS}}
    )
    made = simulate(bench, machine, Plan.load(plan))
    write_run(
        folder / str(seed), made.measurement, made.command, made.setpoints, to_json(made.environment),
        bench.describe(), sample_period=bench.sample_period,
    )  # fmt: skip
    recording = Recording.open(folder / str(seed))
    reading = str(rng.choice(_READINGS))
    begin, long = rng.uniform(0.1, 0.85) * recording.duration, rng.uniform(0.1, 0.3) * recording.duration
    kind = str(rng.choice(("none", "step", "trend", "burst")))
    size = float(np.exp(rng.uniform(np.log(0.1), np.log(1.0)))) * float(rng.choice((-1.0, 1.0)))
    model = Model(bench)
    event, limits = None, 0.0
    if kind != "none":
        end = min(begin + long, 0.97 * recording.duration)
        event = Event(0, _CHANNELS.get(reading, reading), kind, begin, np.inf if kind == "step" else end)  # type: ignore[arg-type]
        # in units of a torque of 1 mN·m, for any reading
        unit = {
            "coil": 1e-3 / bench.value("coil_constant"),
            "motor_current": 1e-3 / bench.value("motor_constant"),
        }
        per = unit["coil"] if reading in _CHANNELS else unit["motor_current"]
        if reading == "motor_voltage":
            per *= bench.value("motor_resistance")
        measurement = recording.measurement.copy()
        course = event.profile(recording.time - 1e-6, np.full(len(recording.time), 1e-6))
        measurement[reading] += size * per * course
        limits = _limits(recording, model, event, size * 1e-3 if reading in _CHANNELS else size * per)
        recording = replace(recording, measurement=measurement)
    found = diagnose([recording], model)
    own = [e for e in found.events if event and e.channel == event.quantity]
    off = min((abs(e.time - event.time) for e in own), default=None) if event else None
    return Case(
        seed, drift, tuple(machine.effects), event, limits, off,
        len(found.events) - len(own) + len(found.drift_shapes),
        (*(f.name for f in found.effects), *(f.formula for f in found.free_form)),
    )  # fmt: skip


def _limits(recording: Recording, model: Model, event: Event, size: float) -> float:
    """Return the size of an event in detection limits; at 1, the expected gain equals the threshold."""
    with one_thread():
        problem = prepare([recording], model).problem
        evidence = Evidence(problem, select(problem).best)
        w = problem.balances[0].windows
        profiles = Profiles(event.kind, [event.edges], np.array([event.profile(w.start, w.duration)]))
        needed = EVENT_GAIN + price(event.kind, places(problem))
        large = QUANTITIES[event.quantity].width(problem.bench)
        return abs(size) / (large * evidence.limit((event.quantity,), 0, profiles, needed))


def shown(cases: Sequence[Case]) -> str:
    """Return the table of results."""
    table = words_table("", "cases", "found", f"within {_WITHIN:g} s", "others told")
    groups: dict[str, list[Case]] = {"no event": [c for c in cases if c.event is None]}
    for kind in ("step", "trend", "burst"):
        of_kind = [c for c in cases if c.event is not None and c.event.kind == kind]
        groups[f"{kind}, above {_CLEAR:g} limits"] = [c for c in of_kind if c.limits >= _CLEAR]
        groups[f"{kind}, below"] = [c for c in of_kind if c.limits < _CLEAR]
    for name, own in groups.items():
        found = [c for c in own if c.off is not None]
        dated = [c for c in found if c.off is not None and c.off <= _WITHIN]
        table.add_row(name, str(len(own)), str(len(found)), str(len(dated)), str(sum(c.others for c in own)))
    return plain_text([table])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.events", description=__doc__)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="the cases have this seed and the following ones")
    parser.add_argument("--plan", default="survey")
    asked = parser.parse_args(arguments)
    cases = []
    for seed in range(asked.seed, asked.seed + asked.cases):
        with tempfile.TemporaryDirectory() as folder:
            cases.append(run(seed, asked.plan, Path(folder)))
        print(cases[-1], flush=True)
    print(shown(cases))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
