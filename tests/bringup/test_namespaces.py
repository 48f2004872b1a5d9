"""Benches in namespaces: two of them in one domain, each with its own time, its recording and its verdict."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import gyrowheel as gw
from gyrowheel.graph.api import up as up_here
from gyrowheel.recordings.page import info_page
from gyrowheel.show.layout import plain_text
from gyrowheel_bringup.graph import Graph, require_free
from gyrowheel_bringup.viewers import foxglove_layout, viewer_names
from gyrowheel_core import namespaces, topics, wire
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import info
from gyrowheel_recording.bags.playback import Tape
from gyrowheel_recording.bags.salvage import salvage

from .helpers import Bystander

#: Enough for a verdict: three speeds, two tilts and upright at each.
PAIR = """\
schema: 1
name: pair
hold_s: 1.0
segments:
  - {label: "1500", spin_rpm: 1500, tilt_deg: [[0, 0], [2, 0], [0, 2]]}
  - {label: "2500", spin_rpm: 2500, tilt_deg: [[0, 0], [2, 0], [0, 2]]}
  - {label: "3500", spin_rpm: 3500, tilt_deg: [[0, 0], [2, 0], [0, 2]]}
"""
#: Enough for everything but a verdict, and longer than it takes to look for it on a busy machine.
BRIEF = """\
schema: 1
name: brief
hold_s: 3.0
segments:
  - {label: "2500", spin_rpm: 2500, tilt_deg: [[0, 0], [2, 0]]}
"""
GYROWHEEL = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()"]


@pytest.mark.parametrize(
    ("text", "namespace"),
    [("", ""), ("/", ""), ("bench2", "/bench2"), ("/lab/bench2/", "/lab/bench2"), ("_a/b_1", "/_a/b_1")],
)
def test_a_namespace_may_be_written_with_or_without_the_first_slash(text: str, namespace: str) -> None:
    assert namespaces.checked(text) == namespace


@pytest.mark.parametrize("text", ["bench 2", "2nd", "a//b", "//a", "a__b", "a-b", "~", "ä", "a/{b}", "a\n"])
def test_what_is_no_namespace_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^namespace: .*; allowed: names of letters, digits"):
        Graph(namespace=text)


@given(
    st.sampled_from(["", "/one", "/one/two", "/onetwo"]), st.sampled_from(["", "/one", "/one/two", "/two"])
)
def test_a_status_tells_whose_it_is(namespace: str, other: str) -> None:
    assert namespaces.is_of_another(namespaces.hardware_id(other), namespace) == (other != namespace)
    assert not namespaces.is_of_another("a camera", namespace)
    assert namespaces.local_name(namespaces.status_name(namespace, "plant"), namespace) == "plant"


def test_viewers_of_a_bench_in_a_namespace_find_its_topics() -> None:
    moved, usual = foxglove_layout("bench2"), foxglove_layout()
    assert '"/gyrowheel/measurement.tilt_x"' in usual
    assert '"/bench2/gyrowheel/measurement.tilt_x"' in moved
    assert '"/bench2/robot_description"' in moved
    assert '"/diagnostics"' in moved
    assert ("/tf", "/bench2/tf") in viewer_names("/bench2")
    assert viewer_names("") == []


def _joined(recordings: list[Path], target: Path) -> Path:
    """Write a bag of everything that is in some recordings, as `ros2 bag record -a` would beside them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with contextlib.ExitStack() as stack:
        writer = stack.enter_context(Writer(target, version=9, storage_plugin=StoragePlugin.MCAP))
        for recording in recordings:
            reader = stack.enter_context(AnyReader([recording]))
            store.register(reader.typestore.fielddefs)
            there = {c.topic: c for c in writer.connections}
            for connection in reader.connections:
                if connection.topic not in there:
                    there[connection.topic] = writer.add_connection(
                        connection.topic, connection.msgtype, typestore=reader.typestore
                    )
            for connection, stamp, data in reader.messages():
                writer.write(there[connection.topic], stamp, data)
    return target


@pytest.mark.graph
@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "shared"),
    [
        (BRIEF, False),
        pytest.param(BRIEF, True, marks=pytest.mark.study),
        pytest.param(PAIR, True, marks=pytest.mark.study),
    ],
    ids=("alone", "brief", "pair"),
)
def test_benches_in_namespaces_are_recorded_under_their_own_names(
    text: str, shared: bool, domain: int, bystander: Bystander, tmp_path: Path
) -> None:
    """One in a namespace; where the domain is `shared`, next to one without."""
    plan = tmp_path / "plan.yaml"
    plan.write_text(text, encoding="utf-8")
    one, two = tmp_path / "one", tmp_path / "two"
    up = subprocess.Popen(
        [
            *GYROWHEEL, "up", "--plan", str(plan), "--record", str(two), "--namespace", "bench2",
            "--effect", "aero_cross", "--domain", str(domain),
        ],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )  # fmt: skip
    said: set[tuple[str, str, str]] = set()
    bystander.listen(
        topics.DIAGNOSTICS,
        lambda message: said.update((s.name, s.hardware_id, p.value) for s in message.status for p in s.values
                                    if p.key == "surplus_publishers" or p.key == "state"),
    )  # fmt: skip
    troubles: list[tuple[str, str]] = []
    failed: list[BaseException] = []
    met = threading.Event()

    def run() -> None:
        try:
            with up_here(
                plan, record=one, domain=domain, on_trouble=lambda *text: troubles.append(text)
            ) as graph:
                met.wait(200.0)
                graph.run()
        except BaseException as error:
            failed.append(error)
        finally:
            met.set()

    thread = threading.Thread(target=run)
    if shared:
        thread.start()
    try:
        # both are there: each is refused a second time, by name, and a third one would not be
        wanted = {"bench2/plant", *(["plant"] if shared else [])}
        bystander.spin_until(lambda: failed or wanted <= set(bystander.diagnoses))
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("ROS_DOMAIN_ID", str(domain))
            with pytest.raises(InputError, match=r"has a bench already in the namespace /bench2 \(nodes \w"):
                require_free(namespace="/bench2", seconds=60.0)
            require_free(namespace="/bench3", seconds=1.0)
        met.set()
        bystander.spin_until(lambda: not thread.is_alive() and up.poll() is not None)
    finally:
        met.set()
        if shared:
            thread.join()
        if up.poll() is None:
            up.send_signal(signal.SIGINT)
        _, lines = up.communicate(timeout=60.0)
    assert not failed, failed
    assert up.returncode == 0, lines
    assert "published by others" not in lines
    assert not [text for _, text in troubles if "several publishers" in text]

    # an aggregator tells them apart, by name and by hardware
    named = {(name, hardware) for name, hardware, _ in said}
    nodes = ("plant", "controller", "conductor", "recorder", "drag_estimator")
    alone = {(f"bench2/{name}", "gyrowheel/bench2") for name in nodes}
    assert named == alone | {(name, "gyrowheel") for name in nodes if shared}

    # each recording holds the run of its own bench, to the bit, and its diagnoses alone
    hidden: dict[str, Any] = {"aero_cross": {}}
    runs = ((two, "/bench2", hidden), (one, "", dict[str, Any]()))
    for folder, namespace, effects in runs[: 2 if shared else 1]:
        with AnyReader([folder]) as reader:
            names = {c.topic for c in reader.connections}
            statuses = {
                status.hardware_id
                for c, _, raw in reader.messages()
                if c.topic == "/diagnostics"
                for status in deserialize_message(raw, DiagnosticArray).status
            }
        own = {topics.MEASUREMENT, topics.COMMAND, topics.SETPOINT, topics.ENVIRONMENT, topics.BENCH}
        assert {topic.within(namespace) for topic in own} <= names
        assert {name for name in names if not name.startswith(f"{namespace}/")} <= {"/diagnostics"}
        assert statuses == {f"gyrowheel{namespace}"}
        recording = gw.Recording.open(folder)
        expected = gw.simulate(plan, effects=effects).measurement
        assert np.array_equal(recording.measurement[: len(expected)], expected)
        found = info(folder)
        assert found.integrity.complete
        assert (found.namespace, found.bench) == (namespace, "gyrowheel")
        assert {p.node for p in found.publishers if p.topic.endswith("/measurement")} == {
            f"{namespace}/plant"
        }
        assert (f"namespace  {namespace}" in plain_text(info_page(found))) == bool(namespace)
        if text == BRIEF:
            continue
        verdict = gw.diagnose(recording, gw.Model("gyrowheel"))
        assert [effect.name for effect in verdict.effects] == list(effects)
        assert verdict.verdict == ("effect" if effects else "nothing_missing")

    # what one bench did in its namespace is read as any other: salvaged, joined, replayed elsewhere
    assert salvage(two, tmp_path / "saved").complete
    if shared:
        with pytest.raises(
            InputError, match=r"measurement of several benches, in the namespaces /, /bench2; allowed"
        ):
            gw.Recording.open(_joined([one, two], tmp_path / "both"))
    with Tape(two, only=["/gyrowheel/measurement"]) as tape:
        assert dict(tape.topics) == {topics.MEASUREMENT: info(two).integrity.samples}
    heard: list[int] = []
    measured = topics.MEASUREMENT
    bystander.node.create_subscription(
        measured.message_class,
        measured.within("/again"),
        lambda raw: heard.append(wire.MEASUREMENT.unpack(raw)[1]),
        measured.qos,
        raw=True,
    )
    replay = subprocess.Popen(
        [
            *GYROWHEEL, "replay", str(two), "--namespace", "/again", "--fast", "--to", "0.5", "--wait", "1",
            "--readers", "1",
        ],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    bystander.spin_until(lambda: replay.poll() is not None)
    bystander.spin_until(lambda: len(heard) >= 1001)
    assert (replay.returncode, heard) == (0, list(range(1001)))
