"""Recordings whose files are whole and whose content is odd: clocks that jump, readings that fail, rows that go.

Every verb must answer, or refuse in one line; and whatever it answers, its numbers can be written as JSON.
"""

from __future__ import annotations

import random
import shutil
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import gyrowheel as gw
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import json_text
from gyrowheel_core.readings import READINGS
from gyrowheel_recording.bags import Recording, RecordingWriter
from gyrowheel_sim.environment import to_json

from .harness import Case, begin_again
from .recordings import drawn, machine_recordings

Rows = np.ndarray[Any, Any]
_LAYOUTS = {
    topics.MEASUREMENT: wire.MEASUREMENT,
    topics.COMMAND: wire.COMMAND,
    topics.SETPOINT: wire.SETPOINT,
}
_TOPICS = {topic.name.rsplit("/", 1)[-1]: topic for topic in _LAYOUTS}
_SECONDS = (1e-9, 1e-4, 5e-4, 1e-3, 0.1, 3.0, 100.0, 4e4, 1e8, 1.7e9)
_VALUES = (0.0, 1e-300, 1.0, -1.0, 1e3, 1e9, 1e300, -1e300, float("nan"), float("inf"))
_FACTORS = (-1.0, 0.0, 1e-6, 0.5, 0.99, 1.01, 2.0, 57.29578, 1e3, 1e12, 1e200)


def _part(rows: Rows, first: str, last: str) -> slice:
    """Return the rows between two parts of a recording."""
    low, high = sorted(round(float(end) * len(rows)) for end in (first, last))
    return slice(low, max(high, low + 1))


def _clock(rows: Rows, share: str, seconds: str) -> Rows:
    late = round(float(seconds) * 1e9)
    rows["stamp_ns"][round(float(share) * len(rows)) :] += late
    return rows


def _rate(rows: Rows, factor: str) -> Rows:
    rows["stamp_ns"] = (rows["stamp_ns"] * float(factor)).astype(np.int64)
    return rows


def _jitter(rows: Rows, seconds: str, seed: str) -> Rows:
    noise = np.random.default_rng(int(seed)).normal(size=len(rows))
    rows["stamp_ns"] += np.round(noise * float(seconds) * 1e9).astype(np.int64)
    return rows


def _set(rows: Rows, name: str, first: str, last: str, value: str) -> Rows:
    rows[name][_part(rows, first, last)] = float(value)
    return rows


def _times(rows: Rows, name: str, factor: str) -> Rows:
    with np.errstate(over="ignore", invalid="ignore"):
        rows[name] = rows[name] * float(factor)
    return rows


def _noise(rows: Rows, name: str, size: str, seed: str) -> Rows:
    rows[name] += float(size) * np.random.default_rng(int(seed)).normal(size=len(rows))
    return rows


def _mixed(rows: Rows, name: str, other: str) -> Rows:
    rows[name] = rows[other]
    return rows


def _drop(rows: Rows, first: str, last: str) -> Rows:
    part = _part(rows, first, last)
    return np.concatenate([rows[: part.start], rows[part.stop :]])


def _keep(rows: Rows, first: str, last: str) -> Rows:
    return rows[_part(rows, first, last)]


def _every(rows: Rows, step: str) -> Rows:
    return rows[:: int(step)]


def _twice(rows: Rows, first: str, last: str) -> Rows:
    part = _part(rows, first, last)
    return np.concatenate([rows[: part.stop], rows[part.start :]])


def _shuffled(rows: Rows, first: str, last: str, seed: str) -> Rows:
    part = _part(rows, first, last)
    np.random.default_rng(int(seed)).shuffle(rows[part])
    return rows


_CHANGES: dict[str, Callable[..., Rows]] = {
    "clock": _clock, "rate": _rate, "jitter": _jitter, "set": _set, "times": _times, "noise": _noise,
    "mixed": _mixed, "drop": _drop, "keep": _keep, "every": _every, "twice": _twice, "shuffled": _shuffled,
}  # fmt: skip


def _line(rng: random.Random) -> str:
    """Return one change as a line of text."""
    name = rng.choice(("measurement", "measurement", "measurement", "command", "setpoint"))
    columns = list(READINGS) if name == "measurement" else list(_LAYOUTS[_TOPICS[name]].fields)
    a, b = f"{rng.random():.3f}", f"{rng.random():.3f}"
    kind = rng.choice(list(_CHANGES))
    column, other = rng.choice(columns), rng.choice(columns)
    seconds = f"{rng.choice((1.0, -1.0)) * rng.choice(_SECONDS):g}"
    given: dict[str, tuple[str, ...]] = {
        "clock": (a, seconds),
        "rate": (f"{rng.choice((0.0, 0.1, 0.99, 1.001, 1.03, 3.0, 1e3)):g}",),
        "jitter": (seconds, "1"),
        "set": (column, a, rng.choice((a, b, "1.0")), repr(rng.choice(_VALUES))),
        "times": (column, f"{rng.choice(_FACTORS):g}"),
        "noise": (column, f"{rng.choice((1e-6, 1e-3, 1.0, 1e3)):g}", "1"),
        "mixed": (column, other),
        "drop": (a, b),
        "keep": (a, b),
        "every": (str(rng.choice((2, 7, 100, 3000))),),
        "twice": (a, b),
        "shuffled": (a, b, "1"),
    }
    # clocks of all that is recorded jump together, as a rule
    whose = "all" if kind in ("clock", "rate") and rng.random() < 0.7 else name
    return " ".join((whose, kind, *given[kind]))


def written(whole: Recording, lines: list[str], folder: Path) -> Path:
    """Write a recording with changes; lines that cannot be read are left out."""
    rows = {topic: getattr(whole, name).copy() for name, topic in _TOPICS.items()}
    times = {topic: own["stamp_ns"].copy() for topic, own in rows.items()}
    ordered = "by stamps" in lines
    for line in lines:
        if line.count(" ") < 2:
            continue
        whose, kind, *given = line.split()
        for name, topic in _TOPICS.items():
            if whose in (name, "all") and kind in _CHANGES and len(rows[topic]):
                try:
                    rows[topic] = _CHANGES[kind](rows[topic], *given)
                except (ValueError, TypeError, IndexError, OverflowError):
                    continue
    shutil.rmtree(folder, ignore_errors=True)
    first = np.zeros(1, dtype=np.int64)
    with RecordingWriter(folder) as writer:
        columns: list[Any] = [
            (topics.BENCH, first, [wire.pack_text(whole.bench_text)]),
            (topics.ENVIRONMENT, first, [wire.pack_text(to_json(whole.environment))]),
        ]
        for topic, own in rows.items():
            packed = _LAYOUTS[topic].array(len(own))
            stamps = np.clip(own["stamp_ns"], -(2**31) * 10**9, (2**31 - 1) * 10**9)
            _LAYOUTS[topic].set_stamps(packed, stamps)
            for name in own.dtype.names or ():
                if name != "stamp_ns":
                    packed[name] = own[name]
            # as they were received, whatever the stamps say, unless the order is that of the stamps
            usual = (
                np.sort(times[topic][: len(own)])
                if len(own) <= len(times[topic])
                else np.arange(len(own)) * 500_000
            )
            columns.append((topic, np.maximum(stamps, 0) if ordered else usual, packed))
        writer.write_columns(columns)
    return folder


def contents(rng: random.Random, folder: Path) -> Iterator[Case]:
    """Change what a recording of a machine holds, and ask a verb of it."""
    wholes = machine_recordings(folder / "whole")
    model = gw.Model("gyrowheel")
    verbs: dict[str, Callable[[gw.Recording], Any]] = {
        # where much is wrong at once, both look for all of it: half a minute
        "compare": lambda own: gw.compare(own, model, progress=lambda _: begin_again(6.0)).to_dict(),
        "diagnose": lambda own: gw.diagnose(own, model, progress=lambda _: begin_again(6.0)).to_dict(),
        "rate": lambda own: gw.rate(own, model).to_dict(),
        "torques": lambda own: gw.torques(own, model).to_dict(),
        "drag": lambda own: gw.drag(own, model).to_dict(),
        "info": lambda own: asdict(own.info),
    }

    def use(data: bytes, whole: Recording) -> str:
        verb, *lines = data.decode("utf-8", "replace").split("\n")
        if verb not in verbs:  # a part of an input, tried in its place
            return "nothing asked"
        path = written(whole, lines, folder / "run")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            try:
                json_text(verbs[verb](gw.Recording.open(path)))
            except InputError as error:
                if not str(error).isprintable():
                    raise
                return f"refused by {verb}"
        return f"{verb} answered"

    for ask in verbs.values():  # what a new cache makes first must not count as the time of an input
        for whole in wholes:
            ask(gw.Recording.open(whole.path))

    while True:
        verb = rng.choice((*verbs, "compare", "compare"))
        lines = [_line(rng) for _ in range(rng.choice((1, 1, 1, 2, 3)))]
        if rng.random() < 0.3:
            lines.append("by stamps")
        yield Case(verb, "\n".join([verb, *lines]).encode(), partial(use, whole=drawn(wholes, rng)))
