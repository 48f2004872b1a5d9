"""Recordings: columns read per second, other readers, the recorder at 10 000 messages per second, and killed.

The recorder is the real node in a separate process; another process publishes.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader

from benchmarks.results import Bar, Figure, MeasurementError, Report
from benchmarks.source import PERIOD_NS, state
from benchmarks.timing import by_turns
from gyrowheel_core import topics, wire
from gyrowheel_recording.bags import Recording, RecordingWriter, Salvaged, salvage

Fraction = Callable[[float], None]

PAIRS = 150_000  # a measurement and a command each
ROUNDS = 2
RATE, SECONDS = 10_000.0, 30.0
KILLS = 20
LIMIT = 0.25  # s that a killed recorder may lose
#: Time limit for the start and discovery of a node [s].
PATIENCE = 60.0

_BEGUN = 20_000  # size of a file with more than its declarations [bytes]
_RECORDER = "from gyrowheel_recording.nodes.recorder import main; raise SystemExit(main())"


def write(directory: Path, pairs: int, *, compress: bool = False) -> Path:
    """Write a recording of random measurements and commands that alternate; return its file."""
    rng = np.random.default_rng(1)
    stamps = np.arange(pairs) * PERIOD_NS
    readings, commands = wire.MEASUREMENT.array(pairs), wire.COMMAND.array(pairs)
    for layout, rows, number in (
        (wire.MEASUREMENT, readings, "sequence"),
        (wire.COMMAND, commands, "measurement_sequence"),
    ):
        layout.set_stamps(rows, stamps)
        rows[number] = np.arange(pairs)
        for name in layout.fields:
            rows[name] = rng.normal(size=pairs)
    with RecordingWriter(directory) as writer:
        writer.write_columns([(topics.MEASUREMENT, stamps, readings), (topics.COMMAND, stamps, commands)])
    return directory / f"{directory.name}_0.mcap"


def _reading(progress: Fraction) -> Report:
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        directory = Path(name) / "run"
        file = write(directory, PAIRS)

        def ours() -> float:
            recording = Recording.open(directory)
            return float(recording.readings.tilt_x.sum() + recording.command["motor_voltage"].sum())

        def by_rosbags() -> float:
            total = 0.0
            with AnyReader([directory]) as reader:
                for connection, _, data in reader.messages():
                    message: Any = reader.deserialize(data, connection.msgtype)
                    total += (
                        message.tilt_x
                        if connection.topic == topics.MEASUREMENT.name
                        else message.motor_voltage
                    )
            return total

        def by_mcap_ros2() -> float:
            total = 0.0
            for item in read_ros2_messages(file):
                message = item.ros_msg
                total += (
                    message.tilt_x if item.channel.topic == topics.MEASUREMENT.name else message.motor_voltage
                )
            return total

        truth = ours()
        for other in (by_rosbags, by_mcap_ros2):
            if not np.isclose(other(), truth, rtol=1e-9):
                raise MeasurementError("the readers do not agree")
        progress(0.25)
        contestants: dict[str, Callable[[], object]] = {
            "ours": ours,
            "rosbags": by_rosbags,
            "mcap_ros2": by_mcap_ros2,
        }
        times = by_turns(contestants, ROUNDS, progress=lambda part: progress(0.25 + 0.75 * part))
        size = file.stat().st_size
    speed = {who: 2 * PAIRS / timing.best for who, timing in times.items()}
    return Report(
        "Reading a recording",
        [
            Figure("messages read", speed["ours"], "1/s", bar=Bar(">=", 1e6)),
            Figure(
                "messages read", speed["ours"], "1/s", "rosbags", speed["rosbags"], Bar(">=", 10.0, "ratio")
            ),
            Figure("messages read", speed["ours"], "1/s", "mcap_ros2", speed["mcap_ros2"]),
        ],
        notes=[
            f"{2 * PAIRS} messages of two topics that alternate in every chunk, {size / 1e6:.0f} MB, not compressed, "
            "in the cache of the system; by the processor's time. Ours ends with the columns of both topics and has "
            "checked every checksum and the sequence; the others decode every message and check nothing."
        ],
    )


class Recorder:
    """The recorder node and a source, each in a separate process.

    Parameters
    ----------
    directory : Path
        Folder of the recording.
    domain : int
        ROS domain of both.
    rate, seconds : float
        Messages per second of the source, and its duration [s].
    """

    def __init__(self, directory: Path, domain: int, rate: float, seconds: float = PATIENCE) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="gyrowheel-source-")
        self._file = Path(self._folder.name) / "state"
        self.words = tempfile.TemporaryFile("w+")  # noqa: SIM115
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        self.process = subprocess.Popen(
            [sys.executable, "-c", _RECORDER, "--ros-args", "-p", f"directory:={directory}"],
            env=environment,
            stderr=self.words,
        )
        given = [str(domain), str(rate), str(seconds), str(self._file)]
        self.source = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.source", *given],
            cwd=Path(__file__).parents[1],
            env=environment,
        )

    def __enter__(self) -> Recorder:
        end = time.monotonic() + PATIENCE
        while self.sent == 0:
            if self.process.poll() is not None or time.monotonic() > end:
                said = " ".join(self.said().split())
                self.__exit__()
                raise MeasurementError(f"the recorder does not start: {said}")
            time.sleep(0.02)
        return self

    def __exit__(self, *_: object) -> None:
        for process in (self.source, self.process):
            if process.poll() is None:
                process.kill()
            process.wait()
        self.words.close()
        self._folder.cleanup()

    @property
    def sent(self) -> int:
        """Pairs of a measurement and a command that were published."""
        return state(self._file)[0]

    @property
    def took(self) -> float:
        """Time in which they were [s]."""
        return state(self._file)[1]

    def said(self) -> str:
        """Return the stderr output of the node."""
        self.words.seek(0)
        return self.words.read()

    def processor_time(self) -> float:
        """Return the processor time of the node [s]."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        """End the node as by Ctrl-C, and wait for it."""
        self.process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout=PATIENCE)


def kill_once(directory: Path, domain: int, after: float, rate: float = 4000.0) -> tuple[float, Salvaged]:
    """Kill a recorder while it records, and salvage.

    Parameters
    ----------
    directory : Path
        Folder of the recording; the salvaged copy is written next to it.
    domain : int
        ROS domain.
    after : float
        Time from the first data on the disk to the kill [s].
    rate : float
        Messages per second, of both topics together.

    Returns
    -------
    lost : float
        Time from the last salvaged sample to the last published one [s].
    saved : Salvaged
        Result of the salvage.
    """
    with Recorder(directory, domain, rate) as recorder:
        end = time.monotonic() + PATIENCE
        while not any(file.stat().st_size > _BEGUN for file in directory.glob("*.mcap")):
            if time.monotonic() > end:
                raise MeasurementError(f"nothing is recorded: {recorder.said()}")
            time.sleep(0.01)
        time.sleep(after)
        sent = recorder.sent
        recorder.process.kill()
        recorder.process.wait()
    saved = salvage(directory, directory.with_name(f"{directory.name}_saved"))
    last = int(Recording.open(saved.target).measurement["sequence"][-1])
    # during publication: two messages per sample
    return (sent - 1 - last) / (rate / 2.0), saved


def _recording(progress: Fraction) -> Report:
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        directory = Path(name) / "run"
        with Recorder(directory, _domain(), RATE, SECONDS) as recorder:
            before = recorder.processor_time()
            while recorder.source.poll() is None:
                progress(min(recorder.took / SECONDS, 1.0))
                time.sleep(0.2)
            busy, sent, took = recorder.processor_time() - before, recorder.sent, recorder.took
            recorder.stop()
        recording = Recording.open(directory)
        came = len(recording.measurement) + len(recording.command)
        whole = recording.integrity().complete and bool(
            np.array_equal(recording.command["measurement_sequence"], np.arange(len(recording.command)))
        )
    return Report(
        "Recorder at 10 000 messages per second",
        [
            Figure("messages published", 2 * sent / took, "1/s", bar=Bar(">=", 0.99 * RATE)),
            Figure("messages lost", float(2 * sent - came), "", bar=Bar("<=", 0.0)),
            Figure("load of one core", 100.0 * busy / took, "%"),
        ],
        notes=[
            f"{2 * sent} messages, half of them measurements, published by another process in {took:.1f} s. "
            f"The recording is {'whole' if whole else 'NOT whole'}."
        ],
    )


def _killing(progress: Fraction) -> Report:
    rng = random.Random(1)
    losses, unsaved = [], 0
    for k in range(KILLS):
        with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
            lost, saved = kill_once(Path(name) / "run", _domain(k), rng.uniform(0.5, 2.5))
            losses.append(lost)
            unsaved += saved.integrity is None or not saved.integrity.complete
        progress((k + 1) / KILLS)
    return Report(
        "Recorder killed",
        [
            Figure("longest time lost", max(losses), "s", bar=Bar("<=", LIMIT)),
            Figure("time lost, mean", float(np.mean(losses)), "s"),
            Figure("salvaged with a gap", float(unsaved), "", bar=Bar("<=", 0.0)),
        ],
        notes=[
            f"Killed (signal 9) {KILLS} times at a random instant while it records a measurement and a command each "
            "0.5 ms. Lost is what was published after the last sample that gyrowheel salvage brings back."
        ],
    )


def _domain(k: int = 0) -> int:
    return 20 + (7 * os.getpid() + k) % 80


def measure(progress: Fraction) -> list[Report]:
    """Measure reading, recording and killing."""
    return [
        _reading(lambda part: progress(0.4 * part)),
        _recording(lambda part: progress(0.4 + 0.2 * part)),
        _killing(lambda part: progress(0.6 + 0.4 * part)),
    ]
