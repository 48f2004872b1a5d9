"""Damaged recordings: refused or read exactly, and what salvage makes of them holds nothing that was not recorded.

`stored` damages files: MCAP and sqlite3, plain and compressed, ours and those of others, and what ``metadata.yaml``
says of them. `recorded` damages messages in files that are whole. `compared` and `diagnosed` damage a recording of a
machine and salvage it: the verb must say of it what it says of the same samples cut from the whole one.
"""

from __future__ import annotations

import hashlib
import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

import gyrowheel as gw
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import json_text
from gyrowheel_recording.bags import Recording, RecordingWriter, salvage, write_run
from gyrowheel_recording.bags.columns import column_dtype, typestore
from gyrowheel_recording.bags.mcap import reader
from gyrowheel_sim.environment import Environment, to_json

from .damage import mutated, mutated_text
from .harness import Case, WrongAnswer, begin_again

SAMPLES = 400
PERIOD_NS = 500_000


@dataclass(frozen=True)
class Original:
    """A small recording, and what it holds."""

    folder: Path
    checked: bool
    measurement: npt.NDArray[Any]
    command: npt.NDArray[Any]


def messages(samples: int = SAMPLES) -> list[tuple[topics.Topic, int, bytes]]:
    """Return measurements and commands of random numbers, in the order of time."""
    rng = np.random.default_rng(1)
    return [
        (topic, k * PERIOD_NS, layout.pack(k * PERIOD_NS, k, *rng.normal(size=width).tolist()))
        for k in range(samples)
        for topic, layout, width in (
            (topics.MEASUREMENT, wire.MEASUREMENT, 11),
            (topics.COMMAND, wire.COMMAND, 3),
        )
    ]


def originals(folder: Path) -> list[Original]:
    """Write small recordings of all kinds that can be read."""
    folder.mkdir()
    rng = np.random.default_rng(1)
    setpoints = np.zeros(SAMPLES // 10, column_dtype(wire.SETPOINT))
    setpoints["stamp_ns"] = np.arange(len(setpoints)) * 10 * PERIOD_NS
    write_run(
        folder / "columns",
        rng.normal(size=(SAMPLES, 11)),
        rng.normal(size=(SAMPLES, 3)),
        setpoints,
        to_json([Environment()]),
        "bench",
        sample_period=PERIOD_NS * 1e-9,
    )
    with RecordingWriter(folder / "live", chunk_size=6000, max_duration=0.15) as writer:
        for topic, stamp, data in messages():
            writer.write(topic, data, stamp)
    for plugin in StoragePlugin:
        for mode in (None, CompressionMode.FILE, CompressionMode.MESSAGE):
            bag = Writer(
                folder / f"{plugin.name.lower()} {mode.name.lower() if mode else 'plain'}",
                version=9,
                storage_plugin=plugin,
            )
            if mode is not None:
                bag.set_compression(mode, CompressionFormat.ZSTD)
            with bag:
                connections = {
                    topic: bag.add_connection(topic.name, topic.type_name, typestore=typestore())
                    for topic in (topics.MEASUREMENT, topics.COMMAND)
                }
                for topic, stamp, data in messages():
                    bag.write(connections[topic], stamp, data)
    result = []
    for path in sorted(folder.iterdir()):
        recording = Recording.open(path)
        result.append(Original(path, recording.unchecked == 0, recording.measurement, recording.command))
    return result


def stored(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage a file of a recording, and read and salvage the recording.

    Half of the recordings are the project's own, whose every byte is covered by a checksum.
    """
    bases = originals(folder / "originals")
    own, others = ([base for base in bases if base.checked is own] for own in (True, False))
    while True:
        base = rng.choice(own if rng.random() < 0.5 else others)
        files = sorted(file for file in base.folder.iterdir() if file.suffix != ".yaml" or rng.random() < 0.2)
        file = rng.choice(files)
        if file.suffix == ".yaml":
            text = mutated_text(file.read_text(encoding="utf-8"), rng)
            data = text.encode("utf-8", "surrogatepass")
        else:
            data = mutated(file.read_bytes(), rng)

        def use(data: bytes, base: Original = base, file: Path = file) -> str:
            with _damaged(base.folder, file.name, data, folder / "damaged") as path:
                return _read_and_saved(path, folder / "saved", base)

        yield Case(f"{base.folder.name}/{file.name}", data, use)


class _damaged:
    """A copy of a recording with one file exchanged, as long as the block lasts."""

    def __init__(self, folder: Path, name: str, data: bytes, copy: Path) -> None:
        self._copy = copy
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(folder, copy)
        (copy / name).write_bytes(data)

    def __enter__(self) -> Path:
        return self._copy

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._copy, ignore_errors=True)


def _read_and_saved(path: Path, target: Path, base: Original) -> str:
    """Read a recording and salvage it; return what became of it."""
    read = _outcome(lambda: _read_both_ways(path, base))
    if not any(".mcap" in file.name for file in path.iterdir()):
        return read
    try:
        saved = _outcome(lambda: _saved(path, target, base))
    finally:
        shutil.rmtree(target, ignore_errors=True)
    return f"{read}, {saved}"


def _outcome(check: Any) -> str:
    try:
        return str(check())
    except InputError as error:
        if not str(error).isprintable():
            raise WrongAnswer(f"the error is not one line of text: {str(error)[:80]!r}") from None
        return "refused"


def _read_both_ways(path: Path, base: Original) -> str:
    """Read a recording, and again with the compiled loops of large files: it must come to the same."""
    said: list[str | InputError] = []
    usual = reader.worth_compiled
    for compiled in (False, True):
        reader.worth_compiled = lambda _, compiled=compiled: compiled  # type: ignore[misc]
        try:
            said.append(_read(path, base))
        except InputError as error:
            said.append(error)
        finally:
            reader.worth_compiled = usual
    first, second = said
    if str(first) != str(second):
        raise WrongAnswer(f"{first}, and with compiled loops {second}")
    if isinstance(first, InputError):
        raise first
    return first


def _read(path: Path, base: Original) -> str:
    recording = Recording.open(path)
    if _same(recording.measurement, base.measurement) and _same(recording.command, base.command):
        return "exact"
    if recording.unchecked == 0:
        raise WrongAnswer(f"{len(recording.measurement)} samples that are not those that were recorded")
    return "unchecked"


def _saved(path: Path, target: Path, base: Original) -> str:
    found = salvage(path, target)
    try:
        recording = Recording.open(target)
    except InputError:
        # as it must be where no measurement is left, or the file had them twice
        if found.complete and base.checked:
            raise WrongAnswer("said to be complete, but cannot be read") from None
        return "saved without samples"
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
    """Whether rows are the same to the bit; the gaps between their fields do not count."""
    return len(left) == len(right) and all(
        left[name].tobytes() == right[name].tobytes() for name in left.dtype.names or ()
    )


# ---- messages in a file that is whole

_LAYOUTS = {
    topics.MEASUREMENT: wire.MEASUREMENT,
    topics.COMMAND: wire.COMMAND,
    topics.SETPOINT: wire.SETPOINT,
    topics.DRAG_ESTIMATE: wire.DRAG_ESTIMATE,
}


def one_of_each(stamp_ns: int = 10 * PERIOD_NS) -> dict[topics.Topic, bytes]:
    """Return a valid message of every topic that the bench reads."""
    found = {}
    for topic, layout in _LAYOUTS.items():
        row = layout.array(1)
        layout.set_stamps(row, stamp_ns)
        row[layout.integers[0]] = stamp_ns // PERIOD_NS
        found[topic] = row.tobytes()
    plan = [Environment(), Environment(time=0.1, rig="inverted")]
    found[topics.ENVIRONMENT] = wire.pack_text(to_json(plan))
    found[topics.BENCH] = wire.pack_text(
        json_text({"name": "gyrowheel", "parameters": {"x": {"value": 1.0}}})
    )
    return found


def mutated_message(data: bytes, rng: random.Random) -> bytes:
    """Return a message with bytes changed, or with words of its text if it has one."""
    if data[4:8] == (len(data) - 8).to_bytes(4, "little") and rng.random() < 0.7:
        return wire.pack_text(mutated_text(wire.unpack_text(data), rng).replace("\ud800", ""))
    return mutated(data, rng)


def recorded(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage one message of a recording in a file whose checksums are right, and read it as every verb does."""
    usual = messages(60)
    valid = one_of_each()
    while True:
        topic = rng.choice(list(valid))
        data = mutated_message(valid[topic], rng)
        at = rng.randrange(len(usual))

        def use(data: bytes, topic: topics.Topic = topic, at: int = at) -> str:
            shutil.rmtree(folder / "run", ignore_errors=True)
            with RecordingWriter(folder / "run") as writer:
                for k, (other, stamp, message) in enumerate(usual):
                    if k == at:
                        writer.write(topic, data, stamp)
                    writer.write(other, message, stamp)
            recording = Recording.open(folder / "run")
            _ = recording.carried_bench, recording.machine, recording.time, recording.readings
            if recording.measurement["sequence"].astype(np.uint64).max() < 59:
                raise WrongAnswer("samples that are whole are missing")
            return "read"

        yield Case(topic.name, data, use)


# ---- salvaged, and compared with a model

#: Seven holds, one more than a comparison needs: what a lost part does to a verb does not depend on the length.
_PLAN = """\
schema: 1
name: short
hold_s: 1.0
segments:
  - {spin_rpm: 3000, tilt_deg: [[0, 0], [2, 0], [0, 2], [-2, 0]]}
  - {spin_rpm: 2900, tilt_deg: [[0, 0], [2, 0], [0, 2]]}
"""
#: Share of the recordings of machines that have something that their model lacks; the search for it is long.
_LACKING = 0.25
#: Of 256 contents, those of which a verb is asked twice though nothing that it can know differs.
_TWICE = 13


def machine_recording(folder: Path, *, lacking: bool) -> Recording:
    """Record a machine that is as its model or has something that its model lacks, and return the recording."""
    gw.simulate(_PLAN, effects={"aero_cross": {}} if lacking else {}, machine=6, folder=folder)
    return Recording.open(folder)


def machine_recordings(folder: Path) -> tuple[Recording, Recording]:
    """Record a machine that is as its model, and one with something that its model lacks."""
    same = machine_recording(folder / "same", lacking=False)
    return same, machine_recording(folder / "lacking", lacking=True)


def drawn(pair: tuple[Recording, Recording], rng: random.Random) -> Recording:
    """Return the recording of one of the two machines."""
    return pair[rng.random() < _LACKING]


def cut(whole: Recording, kept: Recording) -> Recording:
    """Return of the whole recording the messages that another one has, by their stamps and numbers."""

    def rows(of: npt.NDArray[Any], like: npt.NDArray[Any], name: str) -> npt.NDArray[Any]:
        return of[np.isin(of[name], like[name])]

    return replace(
        whole,
        path=kept.path,
        topics=kept.topics,
        measurement=rows(whole.measurement, kept.measurement, "sequence"),
        command=rows(whole.command, kept.command, "measurement_sequence"),
        setpoint=rows(whole.setpoint, kept.setpoint, "stamp_ns"),
        drag_estimate=rows(whole.drag_estimate, kept.drag_estimate, "stamp_ns"),
        environment=kept.environment,
        bench_text=kept.bench_text,
        _integrity=kept.integrity(),
    )


def require_cut(whole: Recording, kept: Recording) -> Recording:
    """Return the same samples cut from the whole recording; `WrongAnswer` where one differs in a bit."""
    same = cut(whole, kept)
    for name in ("measurement", "command", "setpoint", "drag_estimate"):
        if not _same(getattr(kept, name), getattr(same, name)):
            raise WrongAnswer(f"{name}: what was saved is not what was recorded")
    if kept.bench_text not in ("", whole.bench_text):
        raise WrongAnswer("another description of the bench")
    return same


def _digest(recording: Recording) -> str:
    """Return a digest of all that a verb can know of a recording, but for where it is."""
    arrays = (recording.measurement, recording.command, recording.setpoint, recording.drag_estimate)
    known = recording.environment, recording.integrity(), recording.unchecked, recording.part
    found = hashlib.sha256(f"{recording.bench_text}\0{known}".encode("utf-8", "surrogatepass"))
    for rows in arrays:
        for name in rows.dtype.names or ():  # not the gaps between them
            found.update(rows[name].tobytes())
    return found.hexdigest()


def compared(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage the recording of a machine, salvage it, and compare it with a model."""
    return _asked(gw.compare, rng, folder)


def diagnosed(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage the recording of a machine, salvage it, and diagnose it."""
    return _asked(gw.diagnose, rng, folder)


def _asked(verb: Callable[..., Any], rng: random.Random, folder: Path) -> Iterator[Case]:
    """Damage the recording of a machine, salvage it, and ask a verb of it.

    What was saved must be samples of the whole recording, to the bit. The verb is asked of the same samples of the
    whole recording, too, where anything that it can know differs, and of a share of the others. Other damage often
    leaves the same samples; of those the verb is asked once.
    """
    wholes = machine_recordings(folder / "whole")
    model = gw.Model("gyrowheel")
    known: dict[str, str] = {}

    def said(recording: Recording) -> str:
        """Return what the verb says of a recording, whatever it is called."""
        try:
            return json_text(verb(gw.Recording(Path("run"), recording), model).to_dict())
        except InputError as error:
            return f"refused: {error}"

    for whole in wholes:  # what a new cache makes first must not count as the time of an input
        said(whole)

    while True:
        whole = drawn(wholes, rng)
        file = next(whole.path.glob("*.mcap"))

        def use(data: bytes, whole: Recording = whole, file: Path = file) -> str:
            with _damaged(whole.path, file.name, data, folder / "damaged") as path:
                shutil.rmtree(folder / "saved", ignore_errors=True)
                salvage(path, folder / "saved")
            kept = Recording.open(folder / "saved")
            same = require_cut(whole, kept)
            content = _digest(kept)
            if content not in known:
                found = said(kept)
                begin_again()
                again = _digest(same) != content or int(content[:2], 16) < _TWICE
                if again and found != said(same):
                    raise WrongAnswer(
                        f"{verb.__name__} says something else of the same samples of the whole recording"
                    )
                known[content] = (
                    f"refused by {verb.__name__}" if found.startswith("refused") else f"{verb.__name__}d"
                )
            return known[content]

        yield Case(verb.__name__, mutated(file.read_bytes(), rng), use)
