"""Faults injected into the running graph: each has a name, leaves a readable recording, and nothing else behind."""

from __future__ import annotations

import math
import os
import re
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from gyrowheel_bringup.graph import EXECUTABLES, Graph, GraphError, Progress
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.topics import Topic
from gyrowheel_recording.bags import Recording, info
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario

from ..domains import next_domain
from .helpers import LONG_PLAN, PATIENCE, SHORT_PLAN, Bystander, NodeProcess, alive, wait_for

# ruff: noqa: PT012  (the graph is a context manager, and the error comes from within)
pytestmark = pytest.mark.graph

SHARED = Path("/dev/shm")
FAULTY = Topic("/faulty/command", topics.COMMAND.type_name, topics.COMMAND.depth, layout=wire.COMMAND)
#: The recorder does not hear what the controller says to the relay.
ALONE: dict[str, dict[str, object]] = {"controller": {"wait_for_subscribers": 1}}
#: A loaded computer keeps a process waiting for longer than a real bench allows: the loop must stand the delay.
PATIENT: dict[str, dict[str, object]] = {
    "plant": {"watchdog": 4.0, "oldest_command": 4.0, "spin_down_rate": 400.0},
    "controller": {"nutation_damping": 0.0, "tilt_bandwidth": 1.0, "tilt_integral": 0.5},
}
BRIEF = """\
schema: 1
name: brief
hold_s: 0.4
segments:
  - {label: level, spin_rpm: 2000, tilt_deg: [0, 0]}
  - {label: tilted, tilt_deg: [1.0, 0.5], hold_s: 1.0}
"""


def segments_of(pids: set[int]) -> set[str]:
    """Return the shared memory of the middleware that processes use."""
    found = set()
    for pid in pids:
        lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
        found |= {line.rpartition("/")[2] for line in lines if "/dev/shm/fast" in line}
    return found


class Watched:
    """Runs graphs and remembers what processes and shared memory they had."""

    def __init__(self) -> None:
        self.pids: set[int] = set()
        self.segments: set[str] = set()

    def note(self, pids: set[int]) -> None:
        self.pids |= pids
        self.segments |= segments_of({pid for pid in pids if alive(pid)} | {os.getpid()})

    def check(self) -> None:
        """Nothing is left of them."""
        assert not any(alive(pid) for pid in self.pids)
        # a port of a number that another graph on this computer uses now is not ours any more
        gone = self.segments - segments_of({os.getpid()})
        left = {name for name in gone if (SHARED / name).exists() and "_port" not in name}
        assert not left


@pytest.fixture
def watched() -> Iterator[Watched]:
    result = Watched()
    yield result
    result.check()


def diagnoses(directory: Path, name: str) -> list[dict[str, str]]:
    """Return what a node said on /diagnostics, as recorded."""
    found = []
    with AnyReader([directory]) as reader:
        for connection, _, raw in reader.messages(
            [c for c in reader.connections if c.topic == topics.DIAGNOSTICS.name]
        ):
            for status in reader.deserialize(raw, connection.msgtype).status:  # type: ignore[attr-defined]
                if status.name == name:
                    found.append({"message": status.message} | {v.key: v.value for v in status.values})
    return found


@pytest.mark.parametrize("node", ["controller", pytest.param("plant", marks=pytest.mark.study)])
def test_a_killed_node_is_named(node: str, tmp_path: Path, watched: Watched):
    directory = tmp_path / "recording"
    with (
        pytest.raises(GraphError) as caught,
        Graph(LONG_PLAN, record=directory, domain_id=next_domain(), without=["drag_estimator"]) as graph,
    ):

        def kill(progress: Progress) -> None:
            if progress.elapsed >= 1.0 and not watched.pids:
                watched.note(set(graph.pids.values()))
                os.kill(graph.pids[node], signal.SIGKILL)

        graph.run(progress=kill)
    assert (caught.value.fault, caught.value.node) == ("node_died", node)
    assert str(caught.value) == f"{node}: killed by SIGKILL"
    assert info(directory).integrity.missing == 0


class Stops:
    """Stops a node once in a plan that has come so far, for some seconds or for good."""

    def __init__(self, graph: Graph, node: str, after: float, seconds: float = math.inf) -> None:
        self._pid, self._after, self._seconds = graph.pids[node], after, seconds
        self.done = False

    def __call__(self, progress: Progress) -> None:
        if self.done or progress.elapsed < self._after:
            return
        self.done = True
        os.kill(self._pid, signal.SIGSTOP)
        if math.isfinite(self._seconds):
            threading.Timer(self._seconds, os.kill, (self._pid, signal.SIGCONT)).start()


@pytest.mark.study
@pytest.mark.parametrize("after", [0.0, 1.5])
@pytest.mark.parametrize("node", ["plant", "controller", "conductor", "recorder", "drag_estimator"])
def test_a_node_that_is_stopped_for_seconds_delays_lock_step(
    node: str, after: float, tmp_path: Path, watched: Watched
):
    with Graph(SHORT_PLAN, record=tmp_path / "recording", domain_id=next_domain()) as graph:
        watched.note(set(graph.pids.values()))
        stop = Stops(graph, node, after, 3.0)
        graph.run(progress=stop)
    assert stop.done
    assert info(tmp_path / "recording").integrity.complete


@pytest.mark.study
@pytest.mark.parametrize(
    ("node", "fault"),
    [("controller", "controller_silent"), ("conductor", "setpoint_lost"), ("plant", "clock_stands")],
)
def test_a_node_that_stays_stopped_is_named(node: str, fault: str, tmp_path: Path, watched: Watched):
    with (
        pytest.raises(GraphError) as caught,
        Graph(LONG_PLAN, record=tmp_path / "recording", domain_id=next_domain()) as graph,
    ):
        watched.note(set(graph.pids.values()))
        graph.run(progress=Stops(graph, node, 1.0))
    assert fault in str(caught.value)
    assert info(tmp_path / "recording").integrity.complete


@pytest.mark.study
def test_a_recorder_that_stays_stopped_is_named_and_completes_its_files(tmp_path: Path, watched: Watched):
    with (
        pytest.raises(GraphError, match="recorder: stopped by a signal"),
        Graph(BRIEF, record=tmp_path / "recording", domain_id=next_domain()) as graph,
    ):
        watched.note(set(graph.pids.values()))
        graph.run(progress=Stops(graph, "recorder", 1.0))
    assert info(tmp_path / "recording").integrity.samples > 1000


@pytest.mark.study  # test_guard.py has what the motor does
def test_in_real_time_the_motor_is_brought_down_when_the_controller_dies(tmp_path: Path, watched: Watched):
    """What the motor does then, sample by sample, is in test_guard.py."""
    directory = tmp_path / "recording"
    domain = next_domain()
    bystander = Bystander(domain)

    def commanded() -> bool:
        return bystander.values("plant").get("guard", "waiting") not in ("waiting", "stopped")

    try:
        with (
            pytest.raises(GraphError) as caught,
            Graph(
                LONG_PLAN,
                record=directory,
                realtime=True,
                parameters=PATIENT,
                without=["drag_estimator"],
                domain_id=domain,
            ) as graph,
        ):

            def kill(progress: Progress) -> None:
                if not watched.pids:
                    bystander.spin_until(commanded)  # before the first command nothing is lost
                    watched.note(set(graph.pids.values()))
                    os.kill(graph.pids["controller"], signal.SIGKILL)

            graph.run(progress=kill)
    finally:
        bystander.close()
    assert (caught.value.fault, caught.value.node) == ("node_died", "controller")
    said = diagnoses(directory, "plant")
    # a busy recorder may end before it hears that the plant has come to its end
    assert said[-1]["state"] in ("deactivating", "inactive")
    lost = [entry for entry in said if entry.get("guard") == "controller_lost"]
    # a computer that is busy for long may learn that the killed one is gone before the time for its commands is over
    silence = r"controller_lost: no (valid command for 8000|controller for 20000) samples.*; coils off"
    assert re.match(silence, lost[0]["message"])
    assert lost[-1]["outputs"] == "off"
    # what the recording shows of it
    measurement = Recording.open(directory).measurement
    assert abs(measurement["coil_voltage_x"][-100:].mean()) < 0.1
    assert abs(measurement["motor_voltage"][-100:].mean()) < 0.1


class Relay:
    """Stands between controller and plant and passes the commands on as a test wants.

    Parameters
    ----------
    domain : int
        ROS domain.
    change : callable
        Given the number and the bytes of a command, returns the commands to send instead.
    """

    REMAP: ClassVar[dict[str, dict[str, str]]] = {"controller": {topics.COMMAND.name: FAULTY.name}}

    def __init__(self, domain: int, change: Callable[[int, bytes], list[bytes]]) -> None:
        self._bystander = Bystander(domain)
        self._output = self._bystander.publisher(topics.COMMAND)
        self._change = change
        self._count = 0
        self._bystander.listen(FAULTY, self._pass, raw=True)
        self._running = True
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._running = False
        self._thread.join()
        self._bystander.close()

    def _spin(self) -> None:
        while self._running:
            self._bystander.executor.spin_once(timeout_sec=0.05)

    def _pass(self, raw: bytes) -> None:
        # like the controller itself: what is said before the plant listens is lost, and the plant waits for ever
        while self._running and not self._output.get_subscription_count():
            time.sleep(0.005)
        self._count += 1
        for command in self._change(self._count, raw):
            self._output.publish(command)


def with_voltages(raw: bytes, *voltages: float) -> bytes:
    stamp, sequence, *_ = wire.COMMAND.unpack(raw)
    return wire.COMMAND.pack(stamp, sequence, *voltages)


def fails(
    change: Callable[[int, bytes], list[bytes]], tmp_path: Path, watched: Watched, **plant: object
) -> GraphError:
    """Run a plan in lock-step over a line with a fault that ends it; return the error."""
    domain, directory = next_domain(), tmp_path / "recording"
    with (
        Relay(domain, change),
        pytest.raises(GraphError) as caught,
        Graph(
            LONG_PLAN,
            record=directory,
            remap=Relay.REMAP,
            without=["drag_estimator"],
            domain_id=domain,
            parameters={"plant": plant} | ALONE,
        ) as graph,
    ):
        watched.note(set(graph.pids.values()))
        graph.run()
    assert info(directory).integrity.missing == 0
    return caught.value


@pytest.mark.study  # test_plant_node.py shows it of the plant alone
def test_a_command_that_is_not_finite_ends_lock_step(tmp_path: Path, watched: Watched):
    error = fails(
        lambda count, raw: [with_voltages(raw, math.nan, 0.0, 5.0) if count == 1500 else raw],
        tmp_path,
        watched,
    )
    assert (error.fault, error.node) == ("command_not_finite", "plant")
    assert "command for sample 1499" in str(error)


@pytest.mark.study  # a command that is not finite ends it, too
def test_a_command_that_does_not_come_ends_lock_step(tmp_path: Path, watched: Watched):
    error = fails(
        lambda count, raw: [] if count == 1500 else [raw],
        tmp_path,
        watched,
        command_timeout=1.0,
    )
    assert (error.fault, error.node) == ("controller_silent", "plant"), error


def test_a_runaway_tilt_trips_the_hard_stop(tmp_path: Path, watched: Watched):
    def push(count: int, raw: bytes) -> list[bytes]:
        return [with_voltages(raw, 0.0, 9.0, 6.0) if count > 1500 else raw]

    error = fails(push, tmp_path, watched)
    assert (error.fault, error.node) == ("tilt_stop", "plant"), error
    assert "hard stop at 5.00 deg; coils off" in str(error)
    measurement = Recording.open(tmp_path / "recording").measurement
    tilt = np.degrees(np.hypot(measurement["tilt_x"], measurement["tilt_y"]))
    assert tilt.max() > 5.0
    assert any(entry.get("guard") == "tilt_stop" for entry in diagnoses(tmp_path / "recording", "plant"))


@pytest.mark.study  # test_conductor_node.py has the same without a plant
def test_a_wheel_that_does_not_follow_ends_the_plan(tmp_path: Path, watched: Watched):
    """With half of its voltage the motor does not reach the speed of the plan: no success is told."""
    plan = """\
schema: 1
name: too_much
segments:
  - {label: usual, spin_rpm: 3500, tilt_deg: [0, 0], hold_s: 0.5}
  - {label: beyond, spin_rpm: 4000, tilt_deg: [0, 0], hold_s: 100}
"""
    directory = tmp_path / "recording"
    with (
        pytest.raises(GraphError) as caught,
        Graph(
            plan,
            scenario=Scenario(values={"bearing_viscous": 1.4e-4}),
            record=directory,
            domain_id=next_domain(),
            without=["drag_estimator"],
            parameters={"plant": {"motor_voltage_limit": 0.5 * Bench.load().value("supply_voltage")}},
        ) as graph,
    ):
        watched.note(set(graph.pids.values()))
        graph.run()
    assert caught.value.fault == "tracking_lost"
    told = r"asked 0\.00 deg and 4000 rpm, got 0\.\d\d deg and 3[56]\d\d rpm for 3 s"
    assert re.search(told, str(caught.value)), caught.value
    assert info(directory).integrity.missing == 0


@pytest.mark.study  # test_guard.py has a clock that is set
def test_a_jump_of_the_clock_ends_the_plan(tmp_path: Path, watched: Watched):
    domain, directory = next_domain(), tmp_path / "recording"
    bystander = Bystander(domain)
    try:
        with (
            pytest.raises(GraphError) as caught,
            Graph(LONG_PLAN, record=directory, domain_id=domain, without=["drag_estimator"]) as graph,
        ):
            clock = bystander.publisher(topics.CLOCK)

            def jump(progress: Progress) -> None:
                if progress.elapsed >= 1.0:
                    watched.note(set(graph.pids.values()))
                    clock.publish(wire.CLOCK.pack(round((progress.elapsed + 100.0) * 1e9)))

            graph.run(progress=jump)
    finally:
        bystander.close()
    assert (caught.value.fault, caught.value.node) == ("clock_jump", "conductor")
    assert info(directory).integrity.missing == 0


@pytest.mark.study  # test_transitions.py has one that comes back
def test_an_estimator_that_starts_late_joins(
    domain: int,
    bystander: Bystander,
    start_node: Callable[..., NodeProcess],
    tmp_path: Path,
    watched: Watched,
):
    directory = tmp_path / "recording"
    options: dict[str, Any] = {"without": ["drag_estimator"], "hold_after_plan": True}
    with Graph(BRIEF, record=directory, domain_id=domain, **options) as graph:
        graph.run()
        estimator = start_node("drag_estimator")
        bystander.spin_until(lambda: int(bystander.values("drag_estimator").get("samples", 0)) > 0)
        watched.note({*graph.pids.values(), estimator.process.pid})
        heard: set[int] = set()
        bystander.listen(topics.DRAG_ESTIMATE, lambda message: heard.add(message.segment))
        graph.run(BRIEF)
        bystander.spin_until(lambda: 1 in heard)
        assert estimator.interrupt() == 0
    assert "joined late, at sample" in bystander.diagnoses["drag_estimator"].message or any(
        "joined late, at sample" in entry["message"] for entry in diagnoses(directory, "drag_estimator")
    )
    assert set(Recording.open(directory).drag_estimate["segment"]) >= {1}


@pytest.mark.study  # graphs of tests that run at the same time show it, too
def test_two_graphs_on_two_domains_do_not_meet(tmp_path: Path, watched: Watched):
    errors: list[BaseException] = []

    def run(number: int) -> None:
        try:
            scenario = Scenario.nominal(noise_seed=number)
            with Graph(
                BRIEF,
                scenario=scenario,
                record=tmp_path / f"{number}",
                without=["drag_estimator"],
                domain_id=domains[number],
            ) as graph:
                watched.note(set(graph.pids.values()))
                graph.run()
        except BaseException as error:
            errors.append(error)

    domains = [next_domain(), next_domain()]
    threads = [threading.Thread(target=run, args=(number,)) for number in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    plan = Plan.load(BRIEF)
    for number in range(2):
        expected = simulate(Bench.load(), Scenario.nominal(noise_seed=number), plan)
        readings = Recording.open(tmp_path / f"{number}").readings.array
        assert np.array_equal(readings[: len(expected.measurement)], expected.measurement)


def test_ctrl_c_twice_leaves_a_complete_recording(tmp_path: Path, watched: Watched):
    directory, plan = tmp_path / "recording", tmp_path / "plan.yaml"
    plan.write_text(LONG_PLAN, encoding="utf-8")
    command = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()", "up"]
    with subprocess.Popen(
        [*command, "--plan", str(plan), "--record", str(directory)],
        env=os.environ | {"ROS_DOMAIN_ID": str(next_domain())},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        pids = next(line for line in lines if line.startswith("plant ")).split()[1::2]
        assert len(pids) == len(EXECUTABLES)
        wait_for(
            lambda: (
                any(directory.rglob("*.mcap"))
                and max(f.stat().st_size for f in directory.rglob("*.mcap")) > 10**6
            )
        )
        watched.note({process.pid, *map(int, pids)})
        for _ in range(2):
            os.killpg(process.pid, signal.SIGINT)
        rest = process.stderr.read()
        assert process.wait(PATIENCE) == 130
    assert rest.strip().endswith("interrupted")
    assert "Traceback" not in rest
    assert info(directory).integrity.missing == 0


#: Moves the clock of the computer for one process and what it starts, by the nanoseconds in a file.
_MOVED_CLOCK = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>
#define GIGA 1000000000L
static long offset(void) {
    static volatile long *place;
    if (!place) place = mmap(0, sizeof(long), PROT_READ, MAP_SHARED, open(getenv("MOVED_CLOCK"), O_RDONLY), 0);
    return *place;
}
static struct timespec moved(const struct timespec *time, long by) {
    long sum = time->tv_sec * GIGA + time->tv_nsec + by;
    return (struct timespec){sum / GIGA, sum % GIGA};
}
int clock_gettime(clockid_t clock, struct timespec *time) {
    static int (*usual)(clockid_t, struct timespec *);
    if (!usual) usual = dlsym(RTLD_NEXT, "clock_gettime");
    int failed = usual(clock, time);
    if (!failed && clock == CLOCK_REALTIME) *time = moved(time, offset());
    return failed;
}
int pthread_cond_clockwait(pthread_cond_t *own, pthread_mutex_t *lock, clockid_t clock, const struct timespec *end) {
    static int (*usual)(pthread_cond_t *, pthread_mutex_t *, clockid_t, const struct timespec *);
    if (!usual) usual = dlsym(RTLD_NEXT, "pthread_cond_clockwait");
    struct timespec true_end = clock == CLOCK_REALTIME ? moved(end, -offset()) : *end;
    return usual(own, lock, clock, &true_end);
}
int pthread_cond_timedwait(pthread_cond_t *own, pthread_mutex_t *lock, const struct timespec *end) {
    static int (*usual)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!usual) usual = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    /* since the start of the computer, if it is less than thirty years */
    struct timespec true_end = end->tv_sec > GIGA ? moved(end, -offset()) : *end;
    return usual(own, lock, &true_end);
}
"""


@pytest.mark.study
@pytest.mark.parametrize("realtime", [False, True])
@pytest.mark.parametrize("seconds", [-3600, 3600])
def test_a_clock_that_is_set_during_a_plan_loses_no_sample(
    realtime: bool, seconds: int, tmp_path: Path, watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "clock.c").write_text(_MOVED_CLOCK)
    library, offset, recording = (tmp_path / name for name in ("clock.so", "offset", "recording"))
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, tmp_path / "clock.c"], check=True)
    offset.write_bytes(bytes(8))
    monkeypatch.setenv("LD_PRELOAD", str(library))
    monkeypatch.setenv("MOVED_CLOCK", str(offset))

    def set_clock(progress: Progress) -> None:
        if progress.elapsed > 1.0:
            with offset.open("r+b") as file:  # which is mapped: it must not be cut off
                file.write(struct.pack("<q", seconds * 10**9))

    with Graph(
        BRIEF.replace("hold_s: 1.0", "hold_s: 6.0"),
        record=recording,
        realtime=realtime,
        parameters=PATIENT if realtime else {},
        domain_id=next_domain(),
    ) as graph:
        watched.note(set(graph.pids.values()))
        graph.run(progress=set_clock)
    jumps = [float(own.get("clock_jump_s", 0.0)) for own in diagnoses(recording, "plant")]
    assert jumps[-1] == pytest.approx(seconds if realtime else 0.0, abs=0.1)
    assert info(recording).integrity.complete
