"""Damaged files: recordings and YAML files with flipped, cut and swapped parts must be refused, or read exactly.

Nothing here is timed but how long a reader takes at most. ``python -m benchmarks mutations`` runs `COUNT` of each kind;
the tests run fewer, with another seed.
"""

from __future__ import annotations

import random
import re
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from benchmarks.results import Bar, Figure, Report
from gyrowheel_analysis.exchange import ColumnMap
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.recording import Recording, RecordingWriter, salvage, write_run
from gyrowheel_analysis.recording.columns import column_dtype
from gyrowheel_analysis.recording.definitions import typestore
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_sim.air.geometry import Geometry
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.environment import Environment, to_json
from gyrowheel_sim.parameter import INSTRUMENTS
from gyrowheel_sim.plant.scenario import Scenario

Fraction = Callable[[float], None]

COUNT = 2000
#: Time of the processor after which a reader is said to hang [s].
PATIENCE = 10.0
SAMPLES = 400
_PERIOD_NS = 500_000


class Hang(BaseException):
    """A reader took too long; no reader can catch it by mistake."""


@dataclass
class Tally:
    """What became of the damaged files.

    Attributes
    ----------
    outcomes : Counter of str
        How many were ``refused``, read ``exactly``, read ``unchecked`` (files whose format has no checksums), or
        ``accepted`` (YAML with other, allowed content).
    failures : list of str
        Tracebacks, hangs and wrong answers: kind, number and what happened.
    longest : float
        Longest time of the processor for one file [s].
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    longest: float = 0.0

    def count(self, what: str) -> int:
        """Return how many failures are of a kind: ``traceback``, ``hang`` or ``wrong``."""
        return sum(failure.startswith(what) for failure in self.failures)

    def take(self, name: str, check: Callable[[], str]) -> None:
        """Run one check and note its outcome."""
        begin = time.process_time()
        try:
            with _patience():
                outcome = check()
        except InputError as error:
            outcome = "refused"
            if "\n" in str(error) or not str(error):
                self.failures.append(f"wrong: {name}: the error is not one line: {error!r}")
        except Hang:
            outcome = "failed"
            self.failures.append(f"hang: {name}")
        except WrongAnswer as error:
            outcome = "failed"
            self.failures.append(f"wrong: {name}: {error}")
        except Exception as error:
            outcome = "failed"
            self.failures.append(f"traceback: {name}: {type(error).__name__}: {error}"[:300])
        self.outcomes[outcome] += 1
        self.longest = max(self.longest, time.process_time() - begin)


class WrongAnswer(Exception):
    """What was read is not what was written, and nothing says so."""


@contextmanager
def _patience() -> Iterator[None]:
    def give_up(number: int, frame: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGVTALRM, give_up)
    signal.setitimer(signal.ITIMER_VIRTUAL, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


# ---- recordings


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Return data with one to three parts of it changed."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        a = rng.randrange(len(data) + 1)
        b = min(a + int(2.0 ** rng.uniform(0.0, 13.0)), len(data))
        c = rng.randrange(len(data) + 1)
        d = min(c + b - a, len(data))
        kind = rng.randrange(10)
        if kind < 3 and a < len(data):
            data = data[:a] + bytes([data[a] ^ 1 << rng.randrange(8)]) + data[a + 1 :]
        elif kind == 3:
            data = data[:a]
        elif kind == 4:
            data = data[:a] + data[b:]
        elif kind == 5 and b <= c:
            data = data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]
        elif kind == 6:
            data = data[:a] + data[c:d] + data[a:]
        elif kind == 7:
            data = data[:a] + rng.randbytes(b - a) + data[b:]
        elif kind == 8:
            data = data[:a] + bytes([rng.choice((0, 255))]) * (b - a) + data[b:]
        else:
            data = data[:a] + rng.randbytes(min(b - a, 64)) + data[a:]
        if not data:
            break
    return data


@dataclass(frozen=True)
class _Original:
    """A small recording, and what it holds."""

    name: str
    folder: Path
    checked: bool
    measurement: npt.NDArray[Any]
    command: npt.NDArray[Any]


def originals(folder: Path) -> list[_Original]:
    """Write small recordings of all kinds that can be read."""
    rng = np.random.default_rng(1)
    setpoints = np.zeros(SAMPLES // 10, column_dtype(wire.SETPOINT))
    setpoints["stamp_ns"] = np.arange(len(setpoints)) * 10 * _PERIOD_NS
    readings, commands = rng.normal(size=(SAMPLES, 11)), rng.normal(size=(SAMPLES, 3))
    environment = to_json([Environment()])
    write_run(
        folder / "columns",
        readings,
        commands,
        setpoints,
        environment,
        "bench",
        sample_period=_PERIOD_NS * 1e-9,
    )
    messages = [
        (topic, k * _PERIOD_NS, layout.pack(k * _PERIOD_NS, k, *values.tolist()))
        for k in range(SAMPLES)
        for topic, layout, values in (
            (topics.MEASUREMENT, wire.MEASUREMENT, readings[k]),
            (topics.COMMAND, wire.COMMAND, commands[k]),
        )
    ]
    with RecordingWriter(folder / "live", chunk_size=6000, max_duration=0.15) as writer:
        for topic, stamp, data in messages:
            writer.write(topic, data, stamp)
    for plugin in StoragePlugin:
        for mode in (None, CompressionMode.FILE, CompressionMode.MESSAGE):
            name = f"{plugin.name.lower()} {mode.name.lower() if mode else 'plain'}"
            bag = Writer(folder / name, version=9, storage_plugin=plugin)
            if mode is not None:
                bag.set_compression(mode, CompressionFormat.ZSTD)
            with bag:
                connections = {
                    topic: bag.add_connection(topic.name, topic.type_name, typestore=typestore())
                    for topic in (topics.MEASUREMENT, topics.COMMAND)
                }
                for topic, stamp, data in messages:
                    bag.write(connections[topic], stamp, data)
    result = []
    for path in sorted(folder.iterdir()):
        recording = Recording.open(path)
        result.append(
            _Original(path.name, path, recording.unchecked == 0, recording.measurement, recording.command)
        )
    return result


def recordings(count: int, seed: int, progress: Fraction = lambda _: None) -> Tally:
    """Damage recordings and read them; those of MCAP are salvaged too.

    Half of the damaged recordings are the project's own, whose every byte is covered by a checksum.
    """
    rng = random.Random(seed)
    tally = Tally()
    with tempfile.TemporaryDirectory(prefix="gyrowheel-mutations-") as name:
        folder = Path(name)
        (folder / "originals").mkdir()
        bases = originals(folder / "originals")
        own, others = ([b for b in bases if b.checked is own] for own in (True, False))
        for k in range(count):
            base = rng.choice(own if rng.random() < 0.5 else others)
            path = folder / "damaged"
            shutil.copytree(base.folder, path)
            # the files proper; what is said of them in metadata.yaml is damaged with the YAML files, and at times here
            files = sorted(file for file in path.iterdir() if file.suffix != ".yaml" or rng.random() < 0.1)
            file = rng.choice(files)
            before = file.read_bytes()
            after = mutated(before, rng)
            file.write_bytes(after)
            where = f"{base.name} {k} (seed {seed})"
            if after != before:
                tally.take(where, lambda path=path, base=base: _read(path, base))  # type: ignore[misc]
                if any(file.name.endswith((".mcap", ".mcap.zstd")) for file in files):
                    saved = folder / "saved"
                    check = lambda p=path, s=saved, b=base: _saved(p, s, b)  # noqa: E731
                    again = Tally()
                    again.take(f"salvage of {where}", check)
                    tally.failures += again.failures
                    tally.longest = max(tally.longest, again.longest)
                    tally.outcomes.update({f"salvage {k}": n for k, n in again.outcomes.items()})
                    shutil.rmtree(saved, ignore_errors=True)
            shutil.rmtree(path)
            progress((k + 1) / count)
    return tally


def _read(path: Path, base: _Original) -> str:
    recording = Recording.open(path)
    if _same(recording.measurement, base.measurement) and _same(recording.command, base.command):
        return "exactly"
    if recording.unchecked == 0:
        raise WrongAnswer(f"{len(recording.measurement)} samples that are not those that were recorded")
    return "unchecked"


def _saved(path: Path, target: Path, base: _Original) -> str:
    found = salvage(path, target)
    try:
        recording = Recording.open(target)
    except InputError:
        # as it must be where no measurement is left, or the file had them twice
        if found.complete and base.checked:
            raise WrongAnswer("said to be complete, but cannot be read") from None
        return "saved unreadable"
    if found.unchecked:
        return "saved unchecked"
    for rows, original, key in (
        (recording.measurement, base.measurement, "sequence"),
        (recording.command, base.command, "measurement_sequence"),
    ):
        number = rows[key].astype(np.int64)
        if len(rows) and (
            number.min() < 0 or number.max() >= len(original) or not _same(rows, original[number])
        ):
            raise WrongAnswer("what was saved is not what was recorded")
    whole = len(recording.measurement) == len(base.measurement) and len(recording.command) == len(
        base.command
    )
    if found.complete and not whole:
        raise WrongAnswer(
            f"said to be complete with {len(recording.measurement)} of {len(base.measurement)} samples"
        )
    return "saved whole" if whole else "saved in part"


def _same(left: npt.NDArray[Any], right: npt.NDArray[Any]) -> bool:
    return len(left) == len(right) and left.tobytes() == right.tobytes()


# ---- YAML


_ODD = (
    "", "null", "true", "-1", "0", "1e400", "-.inf", ".nan", "1" * 5000, "0x7fffffffffffffffffff", "1e-320", "[]",
    "{}", "[1, [2, [3]]]", "{a: 1}", "'text'", "2001-13-45", "2001-01-01", "!!python/object:os.system x",
    "!!binary zz", "*gone", "&a [*a]", "<<: *x", "? x", "- - -", "\t", "\x00", "'" + "x" * 3000 + "'", "~", "1_000",
    "190:20:30", "0o17", "{[]: 1}", "&a [1,1,1,1,1]", "{<<: {a: 1}}", "é", "=", "%", "@", "`", "|", ">", "-", "1:1",
    "[" * 3000,
)  # fmt: skip
_BOMB = "&b0 [x,x,x,x,x,x,x,x,x,x]"


def mutated_text(text: str, rng: random.Random) -> str:
    """Return a text with one to three of its lines, values or characters changed."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        lines = text.split("\n")
        k, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        numbers = list(re.finditer(r"(?<=[:\[, ])[-+.\w]+(?=[,\]}\n ]|$)", text))
        kind = rng.randrange(11)
        if kind == 0:
            lines[k], lines[other] = lines[other], lines[k]
        elif kind == 1:
            del lines[k]
        elif kind == 2:
            lines.insert(other, lines[k])
        elif kind == 3:
            lines[k] = " " * rng.randrange(9) + lines[k].lstrip()
        elif kind in (4, 5, 6) and numbers:
            match = rng.choice(numbers)
            text = text[: match.start()] + rng.choice(_ODD) + text[match.end() :]
            continue
        elif kind == 7:
            text = text[: rng.randrange(len(text) + 1)]
            continue
        elif kind == 8 and text:
            place = rng.randrange(len(text))
            text = text[:place] + chr(ord(text[place]) ^ 1 << rng.randrange(8)) + text[place + 1 :]
            continue
        elif kind == 9:
            bomb = [f"b{n}: &b{n} [{', '.join([f'*b{n - 1}'] * 10)}]" for n in range(1, 12)]
            lines[:0] = [f"b0: {_BOMB}", *bomb]
            lines[-1:] = [f"{lines[-1].split(':')[0] or 'name'}: *b11"]
        else:
            lines[k] = lines[k].split(":")[0] + ": " + rng.choice(_ODD)
        text = "\n".join(lines)
    return text


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


@dataclass(frozen=True)
class _Kind:
    """A kind of text file: samples of it, and what reads and uses one."""

    name: str
    texts: list[str]
    use: Callable[[Path], None]


def _use_plan(file: Path) -> None:
    plan = Plan.load(file)
    if not 0.0 < plan.duration < float("inf"):
        raise WrongAnswer(f"a plan of {plan.duration} s")
    plan.check(Bench.load())


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


def _use_map(file: Path) -> None:
    ColumnMap.load(file)


def _use_geometry(file: Path) -> None:
    Geometry.load(file)


def _use_scenario(file: Path) -> None:
    scenario = Scenario.load(file, Bench.load())
    if not np.all(np.isfinite(list(scenario.values.values()))):
        raise WrongAnswer("a value of the scenario is not finite")


def kinds(folder: Path) -> list[_Kind]:
    """Return every kind of text file that users give, but for metadata of recordings."""

    def shipped(package: str, path: str, suffix: str = ".yaml") -> list[str]:
        place = resources.files(package).joinpath(path)
        return [
            f.read_text(encoding="utf-8")
            for f in place.iterdir()
            if f.name.endswith(suffix) and not f.name.startswith("dtg_")
        ]

    scenario = folder / "scenario.json"
    Scenario({"shaft_inertia": 1.1e-4}, {"windage": {"w": 0.001, "n": 1.5}}, 3).save(scenario)
    benches = [t for t in shipped("gyrowheel_sim", "config") if "parameters:" in t]
    geometries = [t for t in shipped("gyrowheel_sim", "air") if "lengths:" in t]
    return [
        _Kind("plan", shipped("gyrowheel_control", "plans"), _use_plan),
        _Kind("bench", benches, _use_bench),
        _Kind("model", [MODEL], _use_model),
        _Kind("map", [MAP], _use_map),
        *([_Kind("geometry", geometries, _use_geometry)] if geometries else []),
        _Kind("scenario", [scenario.read_text(encoding="utf-8")], _use_scenario),
    ]


def yaml_files(count: int, seed: int, progress: Fraction = lambda _: None) -> Tally:
    """Damage plans, benches, models, maps, geometries, scenarios and the metadata of recordings, and use them."""
    rng = random.Random(seed)
    tally = Tally()
    with tempfile.TemporaryDirectory(prefix="gyrowheel-mutations-") as name:
        folder = Path(name)
        (folder / "originals").mkdir()
        bases = originals(folder / "originals")
        every = kinds(folder)
        for kind in every:  # what is not damaged must pass, or nothing is shown
            for text in kind.texts:
                (folder / "file.yaml").write_text(text, encoding="utf-8")
                kind.use(folder / "file.yaml")
        for k in range(count):
            number = rng.randrange(len(every) + 1)
            if number == len(every):
                base = rng.choice(bases)
                file = base.folder / "metadata.yaml"
                text = file.read_text(encoding="utf-8")
                file.write_text(mutated_text(text, rng), encoding="utf-8", errors="surrogatepass")
                tally.take(f"metadata {k} (seed {seed})", lambda b=base: _read(b.folder, b))  # type: ignore[misc]
                file.write_text(text, encoding="utf-8")
            else:
                kind = every[number]
                file = folder / "file.yaml"
                file.write_text(
                    mutated_text(rng.choice(kind.texts), rng), encoding="utf-8", errors="surrogatepass"
                )
                tally.take(f"{kind.name} {k} (seed {seed})", lambda u=kind.use, f=file: _accepted(u, f))  # type: ignore[misc]
            progress((k + 1) / count)
    return tally


def _accepted(use: Callable[[Path], None], file: Path) -> str:
    use(file)
    return "accepted"


def measure(progress: Fraction, count: int = COUNT, seed: int = 0) -> list[Report]:
    """Damage `count` recordings and as many YAML files."""
    return [
        _report("Damaged recordings", recordings(count, seed, lambda part: progress(0.6 * part))),
        _report("Damaged YAML files", yaml_files(count, seed, lambda part: progress(0.6 + 0.4 * part))),
    ]


def _report(title: str, tally: Tally) -> Report:
    outcomes = ", ".join(f"{n} {what}" for what, n in sorted(tally.outcomes.items()))
    return Report(
        title,
        [
            Figure("tracebacks", tally.count("traceback"), "files", bar=Bar("<=", 0.0)),
            Figure("hangs", tally.count("hang"), "files", bar=Bar("<=", 0.0)),
            Figure("silent wrong answers", tally.count("wrong"), "files", bar=Bar("<=", 0.0)),
            Figure("longest time for one", tally.longest, "s", bar=Bar("<", PATIENCE)),
        ],
        notes=[f"{outcomes}.", *tally.failures[:5]],
    )
