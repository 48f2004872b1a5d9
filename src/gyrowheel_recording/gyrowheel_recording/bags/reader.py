"""Reading of recordings: the topics of the bench as columns in memory."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from gyrowheel_core import topics, wire
from gyrowheel_core.arrays import block_extremes, by_blocks, picked
from gyrowheel_core.errors import InputError
from gyrowheel_core.readings import LARGEST, POSSIBLE, READINGS, Readings, possible
from gyrowheel_recording.bags.columns import STALL, columns, is_earlier, texts, wanted
from gyrowheel_recording.bags.mcap.batches import Want
from gyrowheel_recording.bags.mcap.records import load_walk
from gyrowheel_recording.bags.metadata import FileState, HashedFile, files_of, hashed, same
from gyrowheel_recording.bags.read_bag import read_bag
from gyrowheel_recording.bags.selection import WHOLE, AnyNamespace, bench_in, part_of, parted
from gyrowheel_recording.derived import Origin, origins_in
from gyrowheel_sim import environment as environments
from gyrowheel_sim.environment import Environment

_COLUMNS = (topics.MEASUREMENT, topics.COMMAND, topics.SETPOINT, topics.DRAG_ESTIMATE)
_TEXTS = (topics.ENVIRONMENT, topics.BENCH)
_ARRAYS = ("measurement", "command", "setpoint", "drag_estimate")
_OTHERS = ("environment", "bench_text")


@dataclass(frozen=True)
class Integrity:
    """Whether the samples of a recording are complete, by their sequence numbers."""

    samples: int  # different samples
    missing: int = 0  # samples missing between the recorded ones
    gaps: tuple[tuple[int, int], ...] = ()  # first sequence number and length of each gap, in order
    duplicates: int = 0  # further copies of a sample; they are dropped
    out_of_order: int = 0  # samples that follow a later one in the file; they are sorted
    #: Samples with a reading that is not a finite number, or no reading of any bench (`readings.POSSIBLE`).
    not_finite: int = 0
    #: Where the stamps go on much later although no sample is missing, so that the bench, or what samples it,
    #: stood still: start [s from the first sample] and length of each [s], in order.
    stalls: tuple[tuple[float, float], ...] = ()

    @property
    def complete(self) -> bool:
        """Whether no sample is missing and every reading is finite."""
        return self.missing == 0 and self.not_finite == 0


@dataclass(frozen=True)
class Recording:
    """A recording in memory. Arrays are in the order of stamps, SI units.

    Attributes
    ----------
    path : Path
        Where it was read from.
    topics : dict of str to int
        Number of messages of every topic in it.
    measurement : structured ndarray, shape (n,)
        ``stamp_ns`` and the fields of the Measurement message; n > 0, stamps and sequence strictly ascend. A value
        that can be no reading (`readings.POSSIBLE`) is NaN, in commands and setpoints, too.
    command, setpoint, drag_estimate : structured ndarray
        ``stamp_ns`` and the fields of these messages; of length 0 where the recording has none.
    environment : list of Environment
        Planned environment of the rig; times [s] from the start of the recording. Empty where unknown.
    bench_text : str
        The description of the bench; empty where the recording has none.
    unchecked : int
        Messages that no checksum covers.
    namespace : str
        Namespace in which the bench ran, such as ``/bench2``; empty for the root.
    part : (float, float)
        Between which times steady motion is looked for [s from the start]. All samples are kept, since what came before
        has warmed the machine.
    files : tuple of FileState
        The files that it was read from, in the states that they had then.
    extremes : dict of str to ndarray, shape (2, m)
        By reading, smallest and largest value of every `SPAN` samples, the last ones fewer: found while the samples
        were checked. Empty where a value can be no reading.
    """

    path: Path
    topics: dict[str, int]
    measurement: npt.NDArray[Any] = field(repr=False)
    command: npt.NDArray[Any] = field(repr=False)
    setpoint: npt.NDArray[Any] = field(repr=False)
    drag_estimate: npt.NDArray[Any] = field(repr=False)
    environment: list[Environment] = field(repr=False)
    bench_text: str = field(repr=False)
    _integrity: Integrity = field(repr=False)
    unchecked: int = 0
    namespace: str = ""
    part: tuple[float, float] = WHOLE
    files: tuple[FileState, ...] = field(default=(), repr=False)
    extremes: dict[str, NDArray[np.float64]] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def open(cls, directory: str | Path) -> Recording:
        """Read a recording.

        Parameters
        ----------
        directory : str or Path
            A rosbag2 directory of any storage, or one of its files. ``@from=20,until=110`` behind it means that part
            of it [s from its start].

        Raises
        ------
        InputError
            If it does not exist, is incomplete or damaged, has no measurements, or has no such part.
        """
        path, part = parted(directory)
        where = str(path)
        asked: dict[str, Want | None] = {topic.name: None for topic in _TEXTS}
        asked |= {topic.name: wanted(topic.layout) for topic in _COLUMNS if topic.layout}
        files = files_of(path)
        found = read_bag(path, AnyNamespace(asked))
        if not same(files, path):
            raise InputError(f"{path}: was changed while it was read")
        counts = {name: topic.count for name, topic in sorted(found.items())}
        namespace = bench_in(counts, where)
        used = {topic: found.get(topic.within(namespace)) for topic in (*_COLUMNS, *_TEXTS)}
        if is_earlier(used[topics.DRAG_ESTIMATE], wire.DRAG_ESTIMATE, where):
            used[topics.DRAG_ESTIMATE] = None  # the analysis needs no estimates, and makes its own
        read = {topic: columns(used[topic], topic.layout, where) for topic in _COLUMNS if topic.layout}
        if len(read[topics.MEASUREMENT]) == 0:
            others = ", ".join(name for name, count in counts.items() if count) or "none at all"
            raise InputError(f"{path}: no messages on {topics.MEASUREMENT.name}; there are: {others}")
        measurement, integrity, extremes = _in_order(read[topics.MEASUREMENT], where)
        start = int(measurement["stamp_ns"][0])
        descriptions = texts(used[topics.BENCH], where)
        whole = cls(
            path=path,
            topics=counts,
            namespace=namespace,
            measurement=measurement,
            command=_with_possible(_by_stamp(read[topics.COMMAND]), wire.COMMAND.fields),
            setpoint=_with_possible(_by_stamp(read[topics.SETPOINT]), wire.SETPOINT.fields),
            drag_estimate=_by_stamp(read[topics.DRAG_ESTIMATE]),
            environment=_environment(texts(used[topics.ENVIRONMENT], where), start, where),
            bench_text=descriptions[-1] if descriptions else "",
            _integrity=integrity,
            unchecked=sum(topic.unchecked for topic in found.values()),
            files=files,
            extremes=extremes,
        )
        return whole if part == WHOLE else replace(whole.within(*part), path=Path(directory))

    @staticmethod
    def machine_of(directory: str | Path) -> str:
        """Return the name of the machine of a recording without reading its samples.

        Raises
        ------
        InputError
            If it cannot be read.
        """
        where = str(directory)
        found = read_bag(parted(directory)[0], AnyNamespace({topics.ENVIRONMENT.name: None}))
        namespace = bench_in({name: topic.count for name, topic in found.items()}, where)
        return _machine(_environment(texts(found.get(topics.ENVIRONMENT.within(namespace)), where), 0, where))

    def within(self, begin: float, end: float) -> Recording:
        """Return a part of it [s from its start], which shares its arrays.

        Raises
        ------
        InputError
            If there is nothing of it between these times.
        """
        path, (first, last) = parted(self.path)
        part = max(begin, first), min(end, last)
        if not (part[0] < part[1] and part[0] < self.duration and part[1] > 0.0):
            where = part_of(path, (begin, end))
            raise InputError(f"{where}: lies outside the recording; allowed: 0 .. {self.duration:.1f} s")
        found = replace(self, path=part_of(path, part), part=part)
        vars(found)["time"] = self.time  # not computed again
        return found

    @property
    def name(self) -> str:
        """Name of the directory or file."""
        return self.path.absolute().name

    @property
    def start_ns(self) -> int:
        """Stamp of the first sample [ns]."""
        return int(self.measurement["stamp_ns"][0])

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.seconds(self.measurement["stamp_ns"][-1:])[0])

    @property
    def machine(self) -> str:
        """Name of the machine, as the environment states it; empty where unknown."""
        return _machine(self.environment)

    @cached_property
    def carried_bench(self) -> tuple[str, dict[str, float]] | None:
        """Name and parameters [SI] of the bench that the recording carries; None without a valid description."""
        try:
            content = json.loads(self.bench_text)
            name = content["name"]
            entries = {str(key): entry["value"] for key, entry in content["parameters"].items()}
            values = {key: float(value) for key, value in entries.items() if isinstance(value, int | float)}
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
            return None
        return (name, values) if isinstance(name, str) else None

    @cached_property
    def origins(self) -> dict[str, Origin]:
        """Origins of the readings that no instrument took, by reading."""
        return origins_in(self.bench_text)

    @cached_property
    def content(self) -> str:
        """Digest of everything that an analysis depends on: the same for a copy elsewhere, another after any change."""
        digest = hashlib.blake2b(digest_size=16)
        about = (self.part, self.environment, self.bench_text)
        digest.update(repr(about).encode("utf-8", "surrogatepass"))
        for rows in (self.measurement, self.command, self.setpoint):
            digest.update(f"{len(rows)} {rows.dtype}".encode())
            if len(rows):
                digest.update(np.ascontiguousarray(rows).view(np.uint8).data)
        return digest.hexdigest()

    @cached_property
    def time(self) -> npt.NDArray[np.float64]:
        """Times of the samples from the start of the recording [s], shape (n,)."""
        return self.seconds(self.measurement["stamp_ns"])

    @cached_property
    def given_commands(self) -> npt.NDArray[Any]:
        """The commands whose coil voltages are numbers; any other one changed nothing."""
        rows = self.command
        given = by_blocks(
            len(rows),
            lambda first, last: np.isfinite(
                rows["coil_voltage_x"][first:last] + rows["coil_voltage_y"][first:last]
            ),
        )
        return rows if all(block.all() for block in given) else rows[np.concatenate(given)]

    @cached_property
    def readings(self) -> Readings:
        """Readings [SI] with named columns; a view of `measurement`."""
        # every field has eight bytes, the readings are the last ones
        rows = np.ascontiguousarray(self.measurement).view(np.float64).reshape(len(self.measurement), -1)
        return Readings(rows[:, -len(READINGS) :])

    def seconds(self, stamp_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        """Return stamps [ns] as times from the start of the recording [s]."""
        start, times = self.start_ns, np.empty(len(stamp_ns))

        def put(first: int, last: int) -> None:
            np.multiply(stamp_ns[first:last] - start, 1e-9, out=times[first:last])

        by_blocks(len(times), put)
        return times

    def integrity(self) -> Integrity:
        """Return which samples are missing or faulty."""
        return self._integrity

    @property
    def is_changed(self) -> bool:
        """Whether a file that it was read from has been changed, exchanged or removed since."""
        return not same(self.files, parted(self.path)[0])

    def certified(self) -> tuple[HashedFile, ...]:
        """Return the files that it was read from with their hashes.

        Raises
        ------
        InputError
            If their content is no longer what was read.
        """
        place = parted(self.path)[0]
        files = files_of(place)
        if not set(self.files) <= set(files):
            try:
                again = Recording.open(self.path)
            except InputError as error:
                raise InputError(f"{self.path}: was changed after it was read: {error}") from None
            kept = all(getattr(self, name).tobytes() == getattr(again, name).tobytes() for name in _ARRAYS)
            if not kept or any(getattr(self, name) != getattr(again, name) for name in _OTHERS):
                raise InputError(f"{self.path}: was changed after it was read; read it again")
            files = again.files
        return hashed(files)


def load_loops() -> None:
    """Load the compiled loops that read large recordings, for a program that waits for its user anyway.

    Otherwise the first large recording is the later for it: some tenths of a second, or the seconds of compiling them
    where that was never done on this machine.
    """
    load_walk()
    for layout in (topic.layout for topic in _COLUMNS if topic.layout):
        one = layout.array(1)
        want = wanted(layout)
        want.take(memoryview(one.tobytes()), np.zeros(1, np.int64), np.zeros(1, want.row), True)


def _in_order(
    samples: npt.NDArray[Any], where: str
) -> tuple[npt.NDArray[Any], Integrity, dict[str, NDArray[np.float64]]]:
    """Return the samples sorted and without copies, what was found on the way, and their extremes."""
    total, late = len(samples), 0
    looked = _look(samples)
    if not all(look.ascending for look in looked):
        sequence = samples["sequence"].astype(np.int64)
        late = int(np.count_nonzero(sequence[1:] < np.maximum.accumulate(sequence)[:-1]))
        if np.any(np.diff(samples["stamp_ns"]) <= 0):
            samples = _without_copies(samples[np.lexsort((sequence, samples["stamp_ns"]))])
        _require_ascending(samples, where)
        looked = _look(samples)
    gaps = [gap for look in looked for gap in look.gaps]
    not_finite = sum(look.not_finite for look in looked)
    extremes = {}
    if not_finite:
        samples = _with_possible(samples, READINGS)
    else:
        extremes = dict(
            zip(READINGS, np.concatenate([look.extremes for look in looked], axis=2), strict=True)
        )
    integrity = Integrity(
        samples=len(samples),
        missing=sum(count for _, count in gaps),
        gaps=tuple(gaps),
        duplicates=total - len(samples),
        out_of_order=late,
        not_finite=not_finite,
        stalls=_stalls(samples, looked),
    )
    return samples, integrity, extremes


#: Samples whose extremes are found together.
SPAN: Final = 256
_LIMITS: Final = np.array([POSSIBLE.get(name, LARGEST) for name in READINGS])
#: Samples that are looked at together, with a copy of them: they fit the cache of a core.
_ROWS: Final = 1 << 13


@dataclass(frozen=True)
class _Look:
    """Findings in a block of samples and in the steps from each of them to the next one."""

    ascending: bool
    gaps: list[tuple[int, int]]
    shortest: int  # of the steps [ns]
    longest: int
    not_finite: int
    extremes: NDArray[np.float64]  # (readings, 2, m): of every `SPAN` samples; NaN where one is NaN

    @classmethod
    def at(cls, samples: npt.NDArray[Any], first: int, last: int) -> _Look:
        """Look at the samples from `first` to before `last`."""
        block = samples[first : last + 1]
        # every field has eight bytes, the readings are the last ones; column by column numpy is several times faster
        columns = np.ascontiguousarray(block.view(np.float64).reshape(len(block), -1).T)
        names = samples.dtype.names or ()
        sequence, stamps = (columns[names.index(name)].view(np.int64) for name in ("sequence", "stamp_ns"))
        steps, between = np.diff(sequence), np.diff(stamps)
        holes = np.flatnonzero(steps > 1)
        readings = columns[-len(READINGS) :, : last - first]
        found = block_extremes(readings, SPAN)
        not_finite = 0
        if not np.all(np.abs(found) <= _LIMITS[:, None, None]):
            not_finite = int(np.count_nonzero(~np.all(np.abs(readings) <= _LIMITS[:, None], axis=0)))
        return cls(
            ascending=bool(np.all(steps > 0) and np.all(between > 0)),
            gaps=list(zip((sequence[holes] + 1).tolist(), (steps[holes] - 1).tolist(), strict=True)),
            shortest=int(between.min(initial=np.iinfo(np.int64).max)),
            longest=int(between.max(initial=0)),
            not_finite=not_finite,
            extremes=found,
        )


def _look(samples: npt.NDArray[Any]) -> list[_Look]:
    samples = np.ascontiguousarray(samples)
    return by_blocks(len(samples), lambda first, last: _Look.at(samples, first, last), _ROWS)


def _require_ascending(samples: npt.NDArray[Any], where: str) -> None:
    steps = np.diff(samples["sequence"].astype(np.int64))
    wrong = np.flatnonzero((steps <= 0) | (np.diff(samples["stamp_ns"]) <= 0))
    if len(wrong):
        before, after = samples[wrong[0]], samples[wrong[0] + 1]
        was, then = (f"{row['sequence']} at {row['stamp_ns'] * 1e-9:.4f} s" for row in (before, after))
        raise InputError(
            f"{where}: {topics.MEASUREMENT.name}: sequence {was} is followed by {then}; both must ascend,"
            " as they do in a recording of one run"
        )


def _stalls(samples: npt.NDArray[Any], looked: Sequence[_Look]) -> tuple[tuple[float, float], ...]:
    """Return where the bench stood still; the samples ascend."""
    # the usual step is no shorter than the shortest one
    if max(look.longest for look in looked) <= STALL * min(look.shortest for look in looked):
        return ()
    stamps: npt.NDArray[np.int64] = samples["stamp_ns"].astype(np.int64)
    between, start = np.diff(stamps), int(stamps[0])
    period = float(np.median(between))
    stood = np.flatnonzero((np.diff(samples["sequence"].astype(np.int64)) == 1) & (between > STALL * period))
    return tuple(((int(stamps[k]) - start) * 1e-9, (float(between[k]) - period) * 1e-9) for k in stood)


def _by_stamp(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return messages in the order of their stamps, and of several that are the same to the byte one."""
    if not _any_step(rows, lambda steps: steps <= 0):
        return rows
    if _any_step(rows, lambda steps: steps < 0):
        rows = picked(rows, np.argsort(rows["stamp_ns"], kind="stable"))
    return _without_copies(rows)


def _with_possible(rows: npt.NDArray[Any], names: Sequence[str]) -> npt.NDArray[Any]:
    """Return rows with NaN in place of what can be no reading, written into them where that is allowed."""
    rows = rows if rows.flags.writeable else rows.copy()

    def put(first: int, last: int) -> None:
        for name in names:
            values = rows[name][first:last]
            good = possible(values, name)
            if not good.all():
                values[~good] = math.nan

    by_blocks(len(rows), put)
    return rows


def _without_copies(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return rows in the order of their stamps without those that repeat the one before."""
    if not _any_step(rows, lambda steps: steps == 0):
        return rows
    # compared as bytes, so that NaN equals itself
    own = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)
    return rows[np.r_[True, np.any(own[1:] != own[:-1], axis=1)]]


def _any_step(
    rows: npt.NDArray[Any], which: Callable[[npt.NDArray[np.int64]], npt.NDArray[np.bool_]]
) -> bool:
    """Whether there is such a step from one stamp to the next."""
    stamps = rows["stamp_ns"]
    return any(
        by_blocks(len(rows), lambda first, last: bool(np.any(which(np.diff(stamps[first : last + 1])))))
    )


def _machine(environment: Sequence[Environment]) -> str:
    """Return the name of the machine that an environment states last; empty where unknown."""
    names = [event.machine for event in environment if event.machine]
    return names[-1] if names else ""


def _environment(messages: list[str], start_ns: int, where: str) -> list[Environment]:
    """Return the environments that held, with times from the start of the recording.

    A later message replaces all that earlier ones planned from its first event on.
    """
    events: list[Environment] = []
    for text in messages:
        try:
            plan = environments.from_json(text)
        except InputError as error:
            raise InputError(f"{where}: {topics.ENVIRONMENT.name}: {error}") from None
        events = environments.merged(events, plan)
    start = start_ns * 1e-9
    before = [replace(event, time=0.0) for event in events if event.time <= start]
    return before[-1:] + [replace(event, time=event.time - start) for event in events if event.time > start]


#: A longer time without samples is a pause [s].
PAUSE: Final = 60.0
_STRIDE: Final = 1000  # samples between those that are looked at first


def pauses(time: NDArray[np.float64], longest: float = PAUSE) -> NDArray[np.float64]:
    """Return the pauses between samples: times of the last sample before and of the first one after each [s], (k, 2).

    Code whose time or memory grows with the length of a recording must leave them out: they may last for years.
    `time` (n,) ascends [s]; `longest` is the longest time without samples that is no pause [s].
    """
    # a pause lies between two of those that are looked at first
    few = np.append(time[::_STRIDE], time[-1:])
    found = []
    for k in (np.flatnonzero(np.diff(few) > longest) * _STRIDE).tolist():
        near = time[k : k + _STRIDE + 1]
        at = np.flatnonzero(np.diff(near) > longest)
        found.append(np.column_stack([near[at], near[at + 1]]))
    return np.concatenate(found) if found else np.zeros((0, 2))


#: Sampling periods that a recording of a wheel can have [s].
SHORTEST: Final = 5e-6
LONGEST: Final = 0.05
_LOOKED_AT: Final = 100_001  # samples


def usual_step(recording: Recording) -> float:
    """Return the usual time from one sample to the next [s], of two samples at least."""
    return 1e-9 * float(np.median(np.diff(recording.measurement["stamp_ns"][:_LOOKED_AT])))


def require_rate(recording: Recording) -> None:
    """Refuse a recording whose samples are too far apart, or too close, for any analysis.

    Raises
    ------
    InputError
        If they are.
    """
    if len(recording.measurement) < 2:
        return
    step = usual_step(recording)
    if not SHORTEST <= step <= LONGEST:
        raise InputError(
            f"{recording.path}: a sample every {1e3 * step:.6g} ms; allowed: {1e3 * SHORTEST:g} .. {1e3 * LONGEST:g} ms"
        )
