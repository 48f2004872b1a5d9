"""Drag estimates of holds of any length."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from dataclasses import replace
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
import pytest

import gyrowheel_analysis.drag.prediction
from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.drag.estimate import DragEstimator, Estimate
from gyrowheel_analysis.drag.stream import BLOCK, DragStream, drag_estimates
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_control.loops.closed_loop import Run, simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import wire
from gyrowheel_core.readings import Readings
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH

SETPOINT = ("tilt_x", "tilt_y", "tilt_rate_x", "tilt_rate_y", "spin_rate", "spin_acceleration")
LONG, SHORT = 25.0, 1.2


PLAN = f"""\
schema: 1
name: long
segments:
  - {{spin_rpm: 3000, tilt_deg: [[0, 0], [1, 0]], hold_s: {SHORT}}}
  - {{spin_rpm: 3000, tilt_deg: [[3, 0]], hold_s: {LONG}}}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run with two short holds and a long one."""
    file = tmp_path_factory.mktemp("plan") / "plan.yaml"
    file.write_text(PLAN)
    return simulate(BENCH, Scenario.nominal(noise_seed=3), Plan.load(file))


def estimates(run: Run) -> Iterator[Estimate]:
    estimator = DragEstimator(Model.new())
    for row in run.setpoints:
        values = [float(row[name]) for name in SETPOINT]
        estimator.setpoint(int(row["stamp_ns"]), int(row["segment"]), int(row["phase"]), values)
    stamps = np.arange(len(run.measurement), dtype=np.int64) * 500_000
    for start in range(0, len(stamps), 100):
        yield from estimator.add_block(
            stamps[start : start + 100], Readings(run.measurement[start : start + 100])
        )
    yield from estimator.finish()


@pytest.mark.slow
def test_a_long_hold_is_estimated_as_a_whole(run: Run) -> None:
    last = list(estimates(run))[-1]
    assert last.settled
    assert last.duration == pytest.approx(LONG, abs=1.0)
    time = np.arange(len(run.measurement), dtype=np.float64) * BENCH.sample_period
    stop = last.stamp_ns * 1e-9
    inside = (time >= stop - last.duration) & (time <= stop)
    assert last.spin_rate == pytest.approx(Readings(run.measurement).spin_rate[inside].mean(), rel=1e-7)
    np.testing.assert_allclose(last.dc_voltage, run.measurement[inside, 4:7].mean(axis=0), atol=3e-4)
    # all its windows, reduced in one go
    setpoint = run.setpoints
    samples = Samples(time, Readings(run.measurement), setpoint["stamp_ns"] * 1e-9, setpoint)
    windows = reduce(samples, BENCH)
    within = windows.segment == last.segment
    coil, motor = Balance(windows, BENCH, clean=False).required(BENCH.values(), [])
    weight = windows.duration * within / np.sum(windows.duration[within])
    expected = [coil.real @ weight, coil.imag @ weight, motor @ weight]
    np.testing.assert_allclose(last.simulated_torque, expected, atol=2e-6)


@pytest.mark.slow
def test_settled_holds_have_the_same_estimates_alone_as_among_all(run: Run) -> None:
    late = run.setpoints[-1:].copy()
    late["stamp_ns"] += 3_600_000_000_000  # begins after the last sample
    longer = replace(run, setpoints=np.concatenate([run.setpoints, late]))
    stamps = np.arange(len(run.measurement), dtype=np.int64) * 500_000
    alone = drag_estimates(stamps, Readings(run.measurement), longer.setpoints, Model.new(), settled=True)
    for one, other in zip(alone, (each for each in estimates(longer) if each.settled), strict=True):
        for name, value in vars(one).items():
            np.testing.assert_allclose(value, getattr(other, name), rtol=1e-9, atol=1e-15, err_msg=name)


@pytest.mark.slow
def test_work_for_a_hold_is_linear_in_its_length(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    lengths = []

    def counting(data: Samples, *rest: Any, **options: Any) -> Any:
        lengths.append(len(data.time))
        return reduce(data, *rest, **options)

    monkeypatch.setattr(gyrowheel_analysis.drag.prediction, "reduce", counting)
    found = list(estimates(run))
    assert sum(lengths) < 4 * len(run.measurement)
    assert max(lengths) * BENCH.sample_period < 3.0
    # often at first, and never silent for long
    times = (
        np.array([estimate.stamp_ns for estimate in found if estimate.segment == found[-1].segment]) * 1e-9
    )
    assert np.diff(times)[0] == pytest.approx(0.5, abs=0.1)
    assert np.diff(times).max() < 5.1


def serialized(run: Run, seconds: float) -> tuple[list[bytes], list[bytes]]:
    """Return the samples and the setpoints of the first seconds of a run."""
    samples = [
        wire.MEASUREMENT.pack(500_000 * k, k, *row)
        for k, row in enumerate(run.measurement[: round(seconds * 2000)])
    ]
    setpoints = [
        wire.SETPOINT.pack(int(row["stamp_ns"]), row["segment"], row["phase"], *(row[n] for n in SETPOINT))
        for row in run.setpoints
        if row["stamp_ns"] < seconds * 1e9
    ]
    return samples, setpoints


@pytest.mark.slow
def test_environment_is_taken_from_the_topic(run: Run) -> None:
    model = replace(Model.new(), effects={"gravity_offset": {"G": 6.0e-3}})
    samples, setpoints = serialized(run, 5.0)

    def simulated(*messages: str, twice: bool = False) -> list[Any]:
        stream = DragStream(model)
        for text in messages:
            stream.take_environment(wire.pack_text(text))
        found = [e for raw in setpoints for e in stream.take_setpoint(raw)]
        found += [e for raw in samples for e in stream.take_measurement(raw)] + stream.finish()
        assert stream.malformed == 0
        if twice:  # the environment outlives the run, as on a topic that is latched
            again = [e for raw in setpoints for e in stream.take_setpoint(raw)]
            again += [e for raw in samples for e in stream.take_measurement(raw)] + stream.finish()
            assert told(again) == told(found)
        return [e.simulated_torque[0] for e in found if e.settled]

    home, turned = '[{"time": 0.0}]', '[{"time": 0.0, "rig": "inverted"}]'
    later = '[{"time": 0.0}, {"time": 2.5, "rig": "inverted"}]'
    weight = 2.0 * 6.0e-3 * np.tan(np.radians([0.0, 1.0, 3.0]))
    upright = np.array(simulated(home))
    assert len(upright) == 3
    assert simulated() == list(upright)
    assert simulated(turned, twice=True) - upright == pytest.approx(weight, abs=1e-5)
    # a later message replaces what was planned from its first event on
    assert simulated(turned, home) == list(upright)
    assert simulated(home, later) - upright == pytest.approx([0.0, 0.0, weight[2]], abs=1e-5)


def test_a_malformed_environment_is_counted() -> None:
    stream = DragStream(Model.new())
    for raw in (b"", wire.pack_text("upright"), wire.pack_text('[{"rig": "sideways"}]')):
        stream.take_environment(raw)
    assert stream.malformed == 3


def told(found: list[Estimate]) -> list[tuple[Any, ...]]:
    return [
        (e.stamp_ns, e.segment, e.settled, e.spin_rate, *e.dc_voltage, *e.simulated_torque) for e in found
    ]


@pytest.mark.slow
def test_estimates_do_not_depend_on_how_the_topics_interleave(run: Run) -> None:
    samples, setpoints = serialized(run, 3.0)
    late, early = DragStream(Model.new()), DragStream(Model.new())
    one = []
    for k, raw in enumerate(samples):  # the setpoints come half a second after their samples
        one += late.take_measurement(raw)
        if k % 10 == 0 and k >= 1000:
            one += late.take_setpoint(setpoints[(k - 1000) // 10])
            one += late.estimates()
    for raw in setpoints[(len(samples) - 1000) // 10 :]:
        one += late.take_setpoint(raw)
    one += late.estimates() + late.finish()
    other = [e for raw in setpoints for e in early.take_setpoint(raw)]
    for raw in samples:
        other += early.take_measurement(raw) + early.estimates()
    other += early.finish()
    assert len(one) > 3
    assert told(one) == told(other)


def test_a_restarted_run_ends_the_previous_one(run: Run) -> None:
    samples, setpoints = serialized(run, 2.0)
    again, alone = DragStream(Model.new()), DragStream(Model.new())
    for stream in (again, alone):
        for raw in setpoints:
            stream.take_setpoint(raw)
        for raw in samples:
            stream.take_measurement(raw)
    ended = alone.finish()
    assert any(e.settled for e in ended)
    assert told(again.take_measurement(samples[0])) == told(ended)
    assert (again.samples, again.first) == (0, -1)


def test_missing_and_malformed_messages_are_counted(run: Run) -> None:
    samples, setpoints = serialized(run, 0.5)
    stream = DragStream(Model.new())
    for raw in (b"", samples[0][:-1], setpoints[0]):
        assert stream.take_measurement(raw) == []
    assert stream.take_setpoint(samples[0]) == []
    for raw in setpoints:
        stream.take_setpoint(raw)
    for raw in (*samples[7:50], *samples[53:]):
        stream.take_measurement(raw)
    stream.estimates()
    assert (stream.first, stream.missing, stream.malformed) == (7, 3, 4)
    assert 0 < stream.samples <= len(samples)
    assert stream.samples % BLOCK == 0


@pytest.mark.slow
def test_memory_does_not_grow_with_the_run(run: Run) -> None:
    """The same holds again and again, and a hold that lasts: as many objects as at first, and arrays as long."""
    samples, setpoints = serialized(run, 4.6)
    stream = DragStream(Model.new())
    shift = len(samples) * 500_000

    def once_more(turn: int) -> int:
        for raw in setpoints:
            stamp, segment, *rest = wire.SETPOINT.unpack(raw)
            stream.take_setpoint(wire.SETPOINT.pack(stamp + turn * shift, 3 * turn + segment, *rest))
        for k, raw in enumerate(samples):
            stamp, _, *rest = wire.MEASUREMENT.unpack(raw)
            number = turn * len(samples) + k
            stream.take_measurement(wire.MEASUREMENT.pack(stamp + turn * shift, number, *rest))
        stream.estimates()
        return size(stream)

    sizes = [once_more(turn) for turn in range(4)]
    assert sizes[3] - sizes[1] < 200  # one settled hold takes more
    # what an estimate was computed with goes at once, and does not wait for the collector
    gc.collect()
    # what others keep in this process, as the tests planned for a bench, is not of this stream
    before = windows()
    gc.disable()
    try:
        once_more(4)
        kept = {id(thing) for thing in before}
        assert not [thing for thing in windows() if id(thing) not in kept]
    finally:
        gc.enable()


def windows() -> list[Windows]:
    """Return the tables of windows that live in this process."""
    return [thing for thing in gc.get_objects() if isinstance(thing, Windows)]


def size(thing: object) -> int:
    """Return the memory of all that an object refers to, but for code and types [bytes]."""
    seen: dict[int, object] = {}
    waiting = [thing]
    while waiting:
        found = waiting.pop()
        if id(found) not in seen and not isinstance(found, type | ModuleType | FunctionType | CodeType):
            seen[id(found)] = found
            waiting += gc.get_referents(found)
    return sum(map(sys.getsizeof, seen.values()))
