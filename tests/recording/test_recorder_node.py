"""The recorder: what it does with messages, and the node in a graph."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tracemalloc
from pathlib import Path

import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from gyrowheel_msgs.srv import SplitRecording, StartRecording, StopRecording
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.stream_reader import StreamReader
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rosbags.highlevel import AnyReader

from benchmarks.recording import Recorder
from gyrowheel_core import topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_core.node import prepare_environment
from gyrowheel_recording.bags import Recording, salvage
from gyrowheel_recording.bags.live import LiveRecording, SampleCount
from gyrowheel_recording.bags.mcap.writer import McapWriter
from gyrowheel_recording.nodes.recorder import SERVICES

from ..bringup.helpers import end_process
from ..domains import next_domain

PERIOD_NS = 500_000
#: How long something may take that happens at once on an idle machine [s].
PATIENCE = 240.0


def measurement(k):
    return wire.MEASUREMENT.pack(k * PERIOD_NS, k, *[float(k)] * 11)


@pytest.mark.parametrize(
    ("sequences", "samples", "missing"),
    [
        ([], 0, 0),
        ([0, 1, 2], 3, 0),
        ([7, 8], 2, 0),
        ([0, 1, 5], 3, 3),
        ([3, 5, 4, 6], 4, 0),
        ([1, 4, 2], 3, 1),
    ],
)
def test_count_of_samples(sequences, samples, missing):
    count = SampleCount()
    assert all(count.add(sequence) for sequence in sequences)
    assert (count.samples, count.missing) == (samples, missing)


def test_samples_of_another_run_are_detected(tmp_path):
    session = LiveRecording(str(tmp_path / "run"))
    assert all(session.take(topics.MEASUREMENT, measurement(k)) for k in range(5))
    assert not session.take(topics.MEASUREMENT, measurement(0))
    session.close()
    assert len(Recording.open(tmp_path / "run").measurement) == 5


def test_messages_are_logged_at_bench_time(tmp_path):
    """Stamped ones at their own, others at the latest measurement; what came first waits for one."""
    session = LiveRecording(str(tmp_path / "run"))
    session.take(topics.BENCH, wire.pack_text("the bench"))
    session.take(topics.SETPOINT, wire.SETPOINT.pack(9_000_000, 0, 0, *[0.0] * 6))
    session.take(topics.MEASUREMENT, measurement(10))
    session.take(topics.COMMAND, wire.COMMAND.pack(5_000_000, 10, 0.0, 0.0, 0.0))
    session.take(topics.MEASUREMENT, measurement(11))
    session.take(topics.ENVIRONMENT, wire.pack_text("[]"))
    session.take(topics.DIAGNOSTICS, b"\0\1\0\0")
    session.take(topics.MEASUREMENT, measurement(14))
    session.close()
    assert session.report() == f"{tmp_path / 'run'}: 8 messages, 3 samples, 2 missing"

    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        times = [(c.topic, m.log_time) for _, c, m in make_reader(stream).iter_messages(log_time_order=False)]
    assert times == [
        ("/gyrowheel/setpoint", 9_000_000),
        ("/gyrowheel/bench", 5_000_000),
        ("/gyrowheel/measurement", 5_000_000),
        ("/gyrowheel/command", 5_000_000),
        ("/gyrowheel/measurement", 5_500_000),
        ("/gyrowheel/environment", 5_500_000),
        ("/diagnostics", 5_500_000),
        ("/gyrowheel/measurement", 7_000_000),
    ]


def test_measurements_of_another_frame_are_recorded(tmp_path):
    """They cannot be counted on the way; reading them can."""
    session = LiveRecording(str(tmp_path / "run"))
    for k in range(3):
        session.take(topics.MEASUREMENT, measurement(k).replace(b"case\0", b"cage\0"))
    session.close()
    assert session.count.samples == 0
    recording = Recording.open(tmp_path / "run")
    assert recording.measurement["sequence"].tolist() == [0, 1, 2]


def test_recording_without_any_measurement(tmp_path):
    session = LiveRecording(str(tmp_path / "run"))
    session.take(topics.BENCH, wire.pack_text("the bench"))
    session.close()
    with pytest.raises(InputError, match="there are: /gyrowheel/bench"):
        Recording.open(tmp_path / "run")


# ---- splitting, and what the disk does


def take(session, first, last):
    for k in range(first, last):
        session.take(topics.MEASUREMENT, measurement(k))
        session.take(topics.COMMAND, wire.COMMAND.pack(k * PERIOD_NS, k, 1.0, 2.0, 3.0))


def count(path):
    recording = Recording.open(path)
    assert recording.integrity().complete
    return len(recording.measurement), len(recording.command)


def test_split_by_time_of_the_bench(tmp_path):
    session = LiveRecording(str(tmp_path / "run"), max_duration=0.2)
    take(session, 0, 1000)
    session.close()
    assert len(list((tmp_path / "run").glob("run_*.mcap"))) == 3
    assert count(tmp_path / "run") == (1000, 1000)
    assert len(Recording.open(tmp_path / "run" / "run_1.mcap").measurement) == 400


def test_split_by_size(tmp_path):
    session = LiveRecording(str(tmp_path / "run"), max_size=100_000)
    take(session, 0, 1000)
    session.close()
    files = list((tmp_path / "run").glob("run_*.mcap"))
    assert len(files) == 3
    assert all(file.stat().st_size < 125_000 for file in files)  # with the summary
    assert count(tmp_path / "run") == (1000, 1000)
    with AnyReader([tmp_path / "run"]) as reader:
        assert sum(1 for _ in reader.messages()) == 2000


def test_lost_samples_are_counted_in_the_metadata(tmp_path):
    session = LiveRecording(str(tmp_path / "run"))
    take(session, 0, 10)
    take(session, 14, 20)
    session.close()
    metadata = yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())
    assert metadata["rosbag2_bagfile_information"]["custom_data"] == {
        "gyrowheel.samples": "16",
        "gyrowheel.missing_samples": "4",
        "gyrowheel.surplus_samples": "0",
        "gyrowheel.surplus_commands": "0",
        "gyrowheel.stalls": "0",
    }


def test_no_more_than_a_quarter_of_a_second_of_the_bench_is_kept_back(tmp_path):
    """However slowly the messages come, and without any flush."""
    for period_ns in (50_000, 500_000, 20_000_000):
        folder = tmp_path / str(period_ns)
        session = LiveRecording(str(folder))
        for k in range(2000):
            session.take(topics.MEASUREMENT, wire.MEASUREMENT.pack(k * period_ns, k, *[0.0] * 11))
        session.writer.abort()
        kept = Recording.open(salvage(folder, tmp_path / f"saved{period_ns}").target).measurement
        assert (1999 - int(kept["sequence"][-1])) * period_ns <= 0.1e9


@pytest.fixture
def small_disk(tmp_path):
    """Give a file system of one megabyte."""
    folder = tmp_path / "small"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("file systems cannot be mounted here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fill(session):
    """Record until the disk takes no more; return how many samples it was asked to take."""
    for k in range(100_000):
        try:
            take(session, k, k + 1)
        except InputError as error:
            return k, str(error)
    raise AssertionError("the disk took everything")


def test_full_disk_leaves_a_complete_recording(small_disk):
    session = LiveRecording(str(small_disk / "run"))
    samples, error = fill(session)
    assert error == f"{small_disk / 'run'}: cannot be written: No space left on device"
    assert "run is complete up to there" in session.give_up()
    assert (samples - count(small_disk / "run")[0]) * PERIOD_NS <= 0.25e9
    assert sorted(file.name for file in (small_disk / "run").iterdir()) == ["metadata.yaml", "run_0.mcap"]
    with AnyReader([small_disk / "run"]) as reader:
        assert sum(1 for _ in reader.messages()) == sum(count(small_disk / "run"))


@pytest.mark.slow
def test_file_that_may_not_grow_is_left_for_salvage(tmp_path):
    """A limit of the file itself: not even its end can be written."""
    code = (
        "import resource, signal, sys\n"
        "from tests.recording.test_recorder_node import LiveRecording, fill\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"session = LiveRecording({str(tmp_path / 'run')!r})\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, resource.RLIM_INFINITY))\n"
        "samples, error = fill(session)\n"
        "size = next(session.writer.path.glob('*.mcap')).stat().st_size\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, resource.RLIM_INFINITY))\n"
        "print(samples, error, session.give_up(), sep='|')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[2],
    )
    samples, error, fate = done.stdout.strip().split("|")
    assert error.endswith("cannot be written: File too large")
    assert f"gyrowheel salvage {tmp_path / 'run'} -o DIR brings it back" in fate
    saved = salvage(tmp_path / "run", tmp_path / "saved")
    assert saved.broken_off
    assert not saved.losses  # the file ends with a whole chunk
    assert (int(samples) - count(tmp_path / "saved")[0]) * PERIOD_NS <= 0.25e9


def test_chunks_that_become_full_are_not_cut(tmp_path):
    """The recorder sends to the disk what waits; that makes no second chunk of what goes there anyway."""
    session = LiveRecording(str(tmp_path / "run"))
    file = tmp_path / "run" / "run_0.mcap"
    for k in range(10):  # 0.11 s of samples each: somewhere in it a chunk becomes full
        take(session, 220 * k, 220 * (k + 1))
        session.writer.flush_old()
    size = file.stat().st_size
    session.writer.flush_old()  # nothing has come since: what waits goes now
    assert file.stat().st_size > size
    session.close()
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.chunk_count == 11
    assert count(tmp_path / "run") == (2200, 2200)


def test_the_index_of_a_long_recording_is_small_in_memory(tmp_path):
    """An hour has 36 000 chunks; what is kept of each is written behind the last of them."""
    writer = McapWriter(tmp_path / "run.mcap", chunk_size=1)  # a chunk for each message
    channels = [writer.add_channel(f"/{k}", "std_msgs/msg/Empty", "", {}) for k in range(4)]
    number = 5000
    tracemalloc.start()
    for k in range(number):
        writer.append(channels[k % 4], k * PERIOD_NS, b"x" * (k % 100))
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    writer.finish("")
    assert grown / number < 50.0
    with (tmp_path / "run.mcap").open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
        stream.seek(0)
        found = [item for item in StreamReader(stream).records if isinstance(item, ChunkIndex)]
    assert summary is not None
    assert summary.statistics is not None
    starts = [index.message_start_time for index in summary.chunk_indexes]
    assert sorted(starts) == [k * PERIOD_NS for k in range(number)]
    assert [index.message_start_time for index in found] == [k * PERIOD_NS for k in range(number)]
    assert summary.statistics.chunk_count == number


@pytest.mark.parametrize("fate", ["deleted", "moved", "replaced"])
def test_folder_that_goes_away(tmp_path, fate):
    session = LiveRecording(str(tmp_path / "run"))
    take(session, 0, 500)
    session.writer.flush()
    if fate == "deleted":
        shutil.rmtree(tmp_path / "run")
    else:
        (tmp_path / "run").rename(tmp_path / "elsewhere")
    if fate == "replaced":
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "run_0.mcap").write_text("something else")
    take(session, 500, 520)
    with pytest.raises(InputError, match=r"run_0.mcap: was moved or deleted while it was recorded"):
        session.writer.flush()
    assert "is not complete" in session.give_up()
    if fate != "deleted":
        salvage(tmp_path / "elsewhere", tmp_path / "saved")
        assert count(tmp_path / "saved") == (520, 520)


@pytest.mark.parametrize(("change", "said"), [("cut", "cut it off"), ("grown", "written into it")])
def test_file_that_another_process_changes(tmp_path, change, said):
    """A cut file would go on behind a hole of zeros; it is noticed with the next chunk, and without one too."""
    session = LiveRecording(str(tmp_path / "run"))
    take(session, 0, 500)
    session.writer.flush()
    file = tmp_path / "run" / "run_0.mcap"
    size = file.stat().st_size
    os.truncate(file, size // 2 if change == "cut" else size + 50)
    with pytest.raises(InputError, match=rf"run_0.mcap: cannot be written: another process has {said}"):
        session.writer.flush()
    with pytest.raises(InputError, match=rf"run: cannot be written: another process has {said}"):
        take(session, 500, 1000)
    assert "is not complete" in session.give_up()
    kept = count(salvage(tmp_path / "run", tmp_path / "saved").target)[0]
    assert kept == 500 if change == "grown" else 0 < kept < 300


def test_second_recorder_on_the_same_folder(tmp_path):
    session = LiveRecording(str(tmp_path / "run"))
    take(session, 0, 500)
    with pytest.raises(InputError, match="run: another recorder is writing into it; a recording needs a new"):
        LiveRecording(str(tmp_path / "run"))
    take(session, 500, 600)
    session.close()
    assert count(tmp_path / "run") == (600, 600)
    with pytest.raises(InputError, match="run: exists; a recording needs a new directory"):
        LiveRecording(str(tmp_path / "run"))


@pytest.mark.graph
def test_full_disk_is_a_named_fault_of_the_node(small_disk):
    with Recorder(small_disk / "run", next_domain(), 8000.0) as recorder:
        assert recorder.process.wait(timeout=PATIENCE) == 3
        last = recorder.said().splitlines()[-1]
    assert re.fullmatch(
        r"recorder: recording_failed: \S+/run: cannot be written: No space left on device;"
        r" \S+/run is complete up to there, \d+ of \d+ messages",
        last,
    )
    assert count(small_disk / "run")[0] > 1000


class Graph:
    """A node of the test beside a recorder in a process of its own, on a domain of their own."""

    def __init__(self, *parameters):
        prepare_environment()
        domain = next_domain()
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node("test", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.publishers = {
            topic: self.node.create_publisher(topic.message_class, topic.name, topic.qos)
            for topic in (topics.MEASUREMENT, topics.COMMAND, topics.BENCH, topics.TRUTH, topics.CLOCK)
        }
        self.clock = "record_clock:=true" in parameters
        self.diagnosis: dict[str, str] = {}  # the values that the recorder publishes of itself
        self.node.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS.name, self.on_diagnostics, topics.DIAGNOSTICS.qos
        )
        code = "from gyrowheel_recording.nodes.recorder import main; raise SystemExit(main())"
        arguments = [part for parameter in parameters for part in ("-p", parameter)]
        self.words = tempfile.TemporaryFile("w+")  # noqa: SIM115
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, "--ros-args", *arguments],
            env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
            stderr=self.words,
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        end_process(self.process)
        self.words.close()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def wait_for(self, condition, seconds=PATIENCE):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, "it did not happen"
            assert self.process.poll() is None, self.said()
            self.executor.spin_once(timeout_sec=0.01)

    def publish(self, first, last):
        """Publish samples, once the recorder listens."""
        for topic in (topics.MEASUREMENT, topics.COMMAND, *([topics.CLOCK] if self.clock else [])):
            self.wait_for(lambda topic=topic: self.publishers[topic].get_subscription_count() == 1)
        for k in range(first, last):
            self.publishers[topics.MEASUREMENT].publish(measurement(k))
            self.publishers[topics.COMMAND].publish(wire.COMMAND.pack(k * PERIOD_NS, k, 1.0, 2.0, 3.0))
            self.publishers[topics.TRUTH].publish(wire.pack_text("{}"))
            if k % 20 == 0:
                self.publishers[topics.CLOCK].publish(wire.CLOCK.pack(k * PERIOD_NS))
        for publisher in self.publishers.values():
            assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))

    def call(self, kind, name, **fields):
        client = self.node.create_client(kind, f"{SERVICES}/{name}")
        self.wait_for(client.service_is_ready)
        future = client.call_async(kind.Request(**fields))
        self.wait_for(future.done)
        self.node.destroy_client(client)
        return future.result()

    def on_diagnostics(self, message):
        self.diagnosis = {entry.key: entry.value for status in message.status for entry in status.values}

    def said(self):
        """Return what the node has written to stderr."""
        self.words.seek(0)
        return self.words.read()

    def end(self, number):
        """Send a signal twice, as a terminal may; return the exit code."""
        self.process.send_signal(number)
        self.process.send_signal(number)
        return self.process.wait(timeout=PATIENCE)


@pytest.mark.graph
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_recorder_from_start_to_signal(tmp_path, number):
    with Graph(f"directory:={tmp_path / 'run'}") as graph:
        graph.publishers[topics.BENCH].publish(wire.pack_text("the bench"))
        graph.publish(0, 1500)
        graph.publish(1510, 3000)
        assert graph.end(number) == 0
        assert re.search(rf"{tmp_path / 'run'}: \d+ messages, 2990 samples, 10 missing", graph.said())
    recording = Recording.open(tmp_path / "run")
    assert recording.integrity().gaps == ((1500, 10),)
    assert len(recording.command) == 2990
    assert recording.bench_text == "the bench"
    assert not {topics.TRUTH.name, topics.CLOCK.name} & recording.topics.keys()


@pytest.mark.graph
def test_every_message_of_a_topic_with_a_small_publisher_queue_is_recorded(tmp_path):
    topic = topics.JOINT_STATES
    with Graph(f"directory:={tmp_path / 'run'}") as graph:
        qos = topic.qos
        qos.depth = 1000
        states = graph.node.create_publisher(topic.message_class, topic.name, qos)
        graph.wait_for(lambda: states.get_subscription_count() == 1)
        for _ in range(1000):
            states.publish(topic.message_class())
        assert states.wait_for_all_acked(Duration(seconds=PATIENCE))
        graph.publish(0, 100)
        assert graph.end(signal.SIGINT) == 0
    assert Recording.open(tmp_path / "run").topics[topic.name] == 1000


@pytest.mark.graph
def test_killed_recorder_loses_two_flush_periods_at_most(tmp_path):
    """Of what it had taken; the benchmark `recording` kills it at random instants of the clock."""
    with Graph(f"directory:={tmp_path / 'run'}") as graph:
        graph.publish(0, 4321)
        graph.wait_for(lambda: graph.diagnosis.get("samples") == "4321")
        graph.process.kill()
        graph.process.wait()
    saved = salvage(tmp_path / "run", tmp_path / "saved")
    assert saved.broken_off
    assert saved.integrity is not None
    assert saved.integrity.complete
    samples = count(saved.target)[0]
    assert (4321 - samples) * PERIOD_NS <= 0.25e9
    assert samples == saved.messages[topics.MEASUREMENT.name]


@pytest.mark.graph
def test_recorder_services(tmp_path):
    with Graph("record_clock:=true") as graph:
        assert graph.call(StopRecording, "stop").message == "not recording"
        assert graph.call(SplitRecording, "split").message == "not recording"
        assert not graph.call(StartRecording, "start").success
        reply = graph.call(StartRecording, "start", directory=str(tmp_path))
        assert (reply.success, reply.message) == (True, f"recording into {tmp_path}")
        again = graph.call(StartRecording, "start", directory=str(tmp_path / "other"))
        assert (again.success, again.message) == (False, f"already recording into {tmp_path}")
        graph.publish(0, 100)
        assert graph.call(SplitRecording, "split").success
        graph.publish(100, 300)
        graph.wait_for(lambda: graph.diagnosis.get("samples") == "300")
        assert graph.diagnosis["missing_samples"] == "0"
        stopped = graph.call(StopRecording, "stop")
        assert stopped.success
        assert "300 samples, none missing" in stopped.message
        refused = graph.call(StartRecording, "start", directory=str(tmp_path))
        assert (refused.success, "exists" in refused.message) == (False, True)
        assert graph.end(signal.SIGINT) == 0
    assert len(list(tmp_path.glob("*.mcap"))) == 2
    recording = Recording.open(tmp_path)
    assert sum(recording.topics.values()) == stopped.messages
    assert recording.topics[topics.MEASUREMENT.name] == 300
    assert recording.topics[topics.CLOCK.name] == 15


@pytest.mark.graph
def test_directory_that_exists(tmp_path):
    (tmp_path / "file").write_text("")
    with Graph(f"directory:={tmp_path}") as graph:
        assert graph.process.wait(timeout=PATIENCE) == 2
        last = graph.said().splitlines()[-1]
    assert last == f"recorder: {tmp_path}: exists; a recording needs a new directory"
