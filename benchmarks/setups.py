"""Wrong setups: how many kinds are found, and whether there are false alarms on correct recordings.

``python -m benchmarks.setups --right 100 --wrong 1`` draws machines of both benches with hidden effects, imperfect or
wrong instruments, and events, records them by plans of all kinds, and checks their setups; then it applies every
mistake of `WRONG` to the recordings and checks them again.
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.campaigns.reality import draw_amounts, draw_event, draw_wrong, events
from gyrowheel.show.layout import plain_text, words_table
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_recording.bags import Recording, write_run
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import draw
from gyrowheel_sim.environment import to_json

Samples = NDArray[Any]
Spoil = Callable[[Samples], None]

TILT, COIL = ("tilt_x", "tilt_y"), ("coil_voltage_x", "coil_voltage_y")
TURN = 2.0 * math.pi
_PERIOD = 5.0e-4  # s, of the default bench
#: Plans of the right recordings, by bench; each in its turn.
PLANS = {
    "gyrowheel": (
        "quick", "check", "cone", "preheat", "coast_down", "inverted", "yaw", "air_density", "rate_table",
        "paper_tilt", "paper_speed", "survey",
    ),
    "dtg": ("dtg_quick", "dtg_check", "dtg_cone", "dtg_coast_down", "dtg_inverted", "dtg_preheat"),
}  # fmt: skip
_SLOWEST = 10.0  # s


def scaled(*names: str, by: float) -> Spoil:
    """Return a function that multiplies columns."""

    def spoil(samples: Samples) -> None:
        for name in names:
            samples[name] *= by
            if name == "spin_angle" and abs(by) <= 2.0:
                samples[name] = np.mod(samples[name], TURN)

    return spoil


def exchanged(*pairs: tuple[str, str]) -> Spoil:
    """Return a function that exchanges columns."""

    def spoil(samples: Samples) -> None:
        for one, other in pairs:
            samples[one], samples[other] = samples[other].copy(), samples[one].copy()

    return spoil


def late(*names: str, by: float) -> Spoil:
    """Return a function that shifts columns to later times [s], cyclically."""

    def spoil(samples: Samples) -> None:
        for name in names:
            samples[name] = np.roll(samples[name], round(by / _PERIOD))

    return spoil


def geared(samples: Samples) -> None:
    """Double the angle."""
    samples["spin_angle"] = np.mod(2.0 * np.unwrap(samples["spin_angle"]), TURN)


def reversed_wheel(samples: Samples) -> None:
    """Mirror the machine: the readings of a wheel that turns the other way."""
    scaled("spin_angle", "spin_rate", "motor_voltage", "motor_current", "tilt_y", COIL[1], by=-1.0)(samples)


def celsius(samples: Samples) -> None:
    """Convert the temperatures to degrees Celsius."""
    for name in ("coil_temperature", "air_temperature"):
        samples[name] -= 273.15


#: What is wrong, how, and what must be named: kind and columns.
WRONG: list[tuple[str, Spoil, str, tuple[str, ...]]] = [
    ("tilts exchanged", exchanged(TILT), "exchanged", TILT),
    ("coils exchanged", exchanged(COIL), "exchanged", COIL),
    ("both exchanged", exchanged(TILT, COIL), "exchanged", (*TILT, *COIL)),
    *(
        (f"sign of {name}", scaled(name, by=-1.0), "sign", (name,))
        for name in (*TILT, *COIL, "motor_voltage", "motor_current", "spin_rate", "spin_angle")
    ),
    ("sign of both tilts", scaled(*TILT, by=-1.0), "sign", TILT),
    ("sign of both coils", scaled(*COIL, by=-1.0), "sign", COIL),
    ("tilts in degrees", scaled(*TILT, by=180.0 / math.pi), "unit", TILT),
    ("angle in degrees", scaled("spin_angle", by=180.0 / math.pi), "unit", ("spin_angle",)),
    ("speed in rpm", scaled("spin_rate", by=30.0 / math.pi), "unit", ("spin_rate",)),
    ("speed in Hz", scaled("spin_rate", by=0.5 / math.pi), "unit", ("spin_rate",)),
    ("coils in mV", scaled(*COIL, by=1e3), "unit", COIL),
    ("mV of the coils read as µV", scaled(*COIL, by=1e-3), "unit", COIL),
    ("motor in mV", scaled("motor_voltage", by=1e3), "unit", ("motor_voltage",)),
    ("current in mA", scaled("motor_current", by=1e3), "unit", ("motor_current",)),
    ("pressure in hPa", scaled("air_pressure", by=0.01), "unit", ("air_pressure",)),
    ("temperatures in °C", celsius, "unit", ("coil_temperature", "air_temperature")),
    (
        "wheel turns the other way",
        reversed_wheel,
        "reversed",
        ("spin_angle", "spin_rate", "motor_voltage", "motor_current"),
    ),
    ("tilts halved", scaled(*TILT, by=0.5), "scale", TILT),
    ("tilts doubled", scaled(*TILT, by=2.0), "scale", TILT),
    ("one tilt halved", scaled("tilt_y", by=0.5), "scale", ("tilt_y",)),
    ("one coil doubled", scaled("coil_voltage_x", by=2.0), "scale", ("coil_voltage_x",)),
    ("gear of 2", geared, "scale", ("spin_angle",)),
    ("tilts late", late(*TILT, by=3.0), "shifted", TILT),
    ("tilts and coils late", late(*TILT, *COIL, by=3.0), "shifted", (*TILT, *COIL)),
    ("speed late", late("spin_rate", by=3.0), "shifted", ("spin_rate",)),
    (
        "voltage and current exchanged",
        exchanged(("motor_voltage", "motor_current")),
        "exchanged",
        ("motor_voltage", "motor_current"),
    ),
]


def spoilt(recording: Recording, spoil: Spoil) -> Recording:
    """Return a recording with other samples."""
    samples = recording.measurement.copy()
    spoil(samples)
    return replace(recording, measurement=samples)


@dataclass(frozen=True)
class Outcome:
    """Result for one recording: its kind, the findings, and the processor time [s]."""

    name: str
    right: bool
    found: str
    seconds: float


def machine(seed: int, bench_name: str, plan: str, folder: Path) -> tuple[Recording, Bench]:
    """Record a random machine: effects, imperfect and wrong instruments, in one of three cases an event."""
    bench = Bench.load(bench_name)
    rng = np.random.default_rng([seed, 0x73657475])
    drawn = draw(bench, seed, kinds=("none", "single", "pair"))
    values = {**drawn.values, **draw_amounts(bench, rng)}
    wrong = draw_wrong(bench, "none", values, rng, lambda names: names[int(rng.integers(len(names)))])
    effects = {**drawn.effects, **wrong}
    asked = Plan.load(plan)
    if seed % 3 == 0:
        name = str(rng.choice(list(events())))
        _, effects[name] = draw_event(bench, name, asked.duration, rng)
    run = simulate(bench, replace(drawn, values=values, effects=effects, declared=events()), asked)
    target = folder / str(seed)
    write_run(
        target, run.measurement, run.command, run.setpoints, to_json(run.environment), bench.describe(),
        sample_period=bench.sample_period,
    )  # fmt: skip
    return Recording.open(target), bench


def _asked(name: str, recording: Recording, bench: Bench) -> tuple[str, tuple[str, ...], Outcome]:
    began = time.process_time()
    found = wrong_setups([recording], bench)
    seconds = time.process_time() - began
    said = "; ".join(f"{f.kind} {' '.join(f.columns)}" for f in found)
    first = found[0] if len(found) == 1 else None
    kind, columns = (first.kind, first.columns) if first else ("", ())
    return kind, columns, Outcome(name, not found, said, seconds)


def right_recordings(seed: int, count: int) -> list[Outcome]:
    """Return the results for correct recordings; `Outcome.right` is true without a false alarm."""
    result = []
    for k in range(count):
        bench = "dtg" if k % 4 == 3 else "gyrowheel"
        plan = PLANS[bench][(k // 4 if bench == "dtg" else k - k // 4) % len(PLANS[bench])]
        with tempfile.TemporaryDirectory() as folder:
            recording, own = machine(seed + k, bench, plan, Path(folder))
        outcome = _asked(f"{seed + k} {plan}", recording, own)[2]
        print(outcome, flush=True)
        result.append(outcome)
    return result


def wrong_recordings(seed: int, count: int) -> list[Outcome]:
    """Return the results for wrong setups; `Outcome.right` is true if exactly kind and columns are named."""
    result = []
    for k in range(count):
        with tempfile.TemporaryDirectory() as folder:
            recording, bench = machine(seed + k, "gyrowheel", ("quick", "survey")[k % 2], Path(folder))
        for name, spoil, kind, columns in WRONG:
            said, which, outcome = _asked(name, spoilt(recording, spoil), bench)
            outcome = replace(outcome, right=(said, which) == (kind, columns))
            print(seed + k, outcome, flush=True)
            result.append(outcome)
    return result


def shown(right: Sequence[Outcome], wrong: Sequence[Outcome]) -> str:
    """Return the table of results."""
    table = words_table("", "recordings", "right", "s of the processor, median", "slowest")
    for name, own in (("right setups left alone", right), ("wrong setups named", wrong)):
        if own:
            seconds = [o.seconds for o in own]
            table.add_row(
                name,
                str(len(own)),
                str(sum(o.right for o in own)),
                f"{statistics.median(seconds):.2f}",
                f"{max(seconds):.2f} (bar {_SLOWEST:g})",
            )
    failed = [f"{o.name}: {o.found or 'not named'}" for o in (*right, *wrong) if not o.right]
    return "\n".join([plain_text([table]), f"{len({o.name for o in wrong})} kinds of wrong setups", *failed])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.setups", description=__doc__)
    parser.add_argument("--right", type=int, default=100, help="right recordings")
    parser.add_argument("--wrong", type=int, default=1, help="machines on which every mistake is made")
    parser.add_argument(
        "--seed", type=int, default=0, help="the machines have this seed and the following ones"
    )
    asked = parser.parse_args(arguments)
    right = right_recordings(asked.seed, asked.right)
    wrong = wrong_recordings(asked.seed + asked.right, asked.wrong)
    print(shown(right, wrong))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
