"""A node that is not of the bench publishes on its topics: it is noticed whenever it comes, and everyone is told."""

from __future__ import annotations

import contextlib
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader

from gyrowheel.recordings.page import info_page
from gyrowheel.show.layout import plain_text
from gyrowheel_bringup.graph import Graph, GraphError, Progress
from gyrowheel_bringup.graph.foreign_nodes import Strangers
from gyrowheel_core import topics, wire
from gyrowheel_core.node import SURPLUS
from gyrowheel_core.node.endpoints import NAMELESS, PublisherWatch
from gyrowheel_recording.bags import Recording, info

from .helpers import SHORT_PLAN, Bystander, wait_for

pytestmark = pytest.mark.graph


class Intruder(Bystander):
    """Answers samples beside the controller, with a motor voltage that nothing else commands."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain)
        self.sent = 0
        self._end = threading.Event()
        self.spin_until(lambda: self.node.count_subscribers(topics.COMMAND.name) == 2)  # plant and recorder
        self._thread = threading.Thread(target=self._run, daemon=True)

    def come(self) -> None:
        if self._thread.ident is None:
            self._commands = self.publisher(topics.COMMAND)
            self.spin_until(lambda: self._commands.get_subscription_count() == 2)
            self.listen(topics.MEASUREMENT, self._answer, raw=True)
            self._thread.start()

    def is_told_of(self) -> bool:
        """Whether plant and recorder have named it: one that is gone before anybody looks has no name."""
        return all("/bystander" in self.values(name).get(SURPLUS, "") for name in ("plant", "recorder"))

    def leave(self) -> None:
        if self._thread.ident is not None and not self._end.is_set():
            self._end.set()
            self._thread.join()
            assert self._commands.wait_for_all_acked(Duration(seconds=10.0))
            self.close()

    def _answer(self, raw: bytes) -> None:
        stamp, sequence = wire.MEASUREMENT.unpack(raw)[:2]
        if (
            sequence % 8
        ):  # so few that its numbers never reach those of a controller that has no processor for a while
            return
        self._commands.publish(wire.COMMAND.pack(stamp, sequence, 0.5, -0.5, 10.0))
        self.sent += 1

    def _run(self) -> None:
        while not self._end.is_set():
            self.executor.spin_once(timeout_sec=0.02)


def test_a_stranger_that_comes_later_and_leaves_is_told_to_everyone(domain: int, tmp_path: Path) -> None:
    troubles: list[tuple[str, str]] = []

    def progress(now: Progress) -> None:
        if now.segment == 1:
            intruder.come()
        elif now.segment >= 2:
            wait_for(intruder.is_told_of)
            intruder.leave()

    record = tmp_path / "run"
    graph = Graph(SHORT_PLAN, record=record, domain_id=domain, on_trouble=lambda *said: troubles.append(said))
    with contextlib.ExitStack() as stack:
        error = stack.enter_context(pytest.raises(GraphError))
        stack.enter_context(graph)
        intruder = Intruder(domain)
        stack.callback(intruder.leave)
        graph.run(progress=progress)
    assert error.value.fault == "strangers", error.value.report
    text = str(error.value)
    # followed by what it was, where that could be seen: some may have come and gone
    assert text.startswith("/gyrowheel/command was also published by others: /bystander")
    assert "/controller" not in text
    assert text.endswith(f"the recording {record} is kept")

    # on /diagnostics, by the node that takes the commands and by the recorder
    told = {name for name, said in troubles if "several publishers of /gyrowheel/command: " in said}
    assert told >= {"plant", "recorder"}

    # the recording is whole, and knows who published what
    found = info(record)
    assert found.integrity.complete
    by_node = {p.node: p for p in found.publishers if p.topic == topics.COMMAND.name}
    assert set(by_node) == {"/controller", "/bystander"}
    assert len({p.gid for p in by_node.values()}) == 2
    assert all(len(p.gid) == 32 for p in by_node.values())
    own = Recording.open(record).command
    loud = own["motor_voltage"] == 10.0
    assert loud.sum() == intruder.sent
    # where a node is found only after its first message, it is not known whose the messages are: then none is counted
    counts = [by_node[name].messages for name in ("/bystander", "/controller")]
    assert counts in ([loud.sum(), (~loud).sum()], [None, None])
    assert {p.node for p in found.publishers if p.topic == topics.MEASUREMENT.name} == {"/plant"}
    page = plain_text(info_page(found))
    assert "/gyrowheel/command had 2: " in page
    assert by_node["/bystander"].gid in page.replace("\n", "").replace(" ", "")

    # also where the metadata is lost
    with AnyReader([record]) as reader:
        diagnoses = [
            status
            for connection, _, raw in reader.messages()
            if connection.topic == topics.DIAGNOSTICS.name
            for status in deserialize_message(raw, DiagnosticArray).status
        ]
    said = {
        value.value for status in diagnoses for value in status.values if value.key == "surplus_publishers"
    }
    assert any("/bystander" in text for text in said)


def test_a_node_with_another_publisher_is_no_stranger_and_its_namesake_is(
    domain: int, bystander: Bystander
) -> None:
    """As one that is configured anew, whose publisher of before is not known to have gone yet."""
    topic = topics.COMMAND
    watch = PublisherWatch(bystander.node)
    watch.add(topic, bystander.node.create_subscription(topic.message_class, topic.name, print, topic.qos))
    one, namesake = Bystander(domain), Bystander(domain)
    try:
        for _ in range(2):
            one.publisher(topic)
        wait_for(lambda: len(watch.publishers(topic)) == 2)
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            watch.look()
            assert watch.surplus() == {}
            time.sleep(0.02)
        namesake.publisher(topic)

        def surplus() -> dict[str, str]:
            watch.look()
            return watch.surplus()

        wait_for(surplus)
        assert set(watch.surplus()[topic.name].split(", ")) == {"/bystander"}
    finally:
        one.close()
        namesake.close()


def test_a_name_that_arrives_later_takes_the_place_of_none_and_stays() -> None:
    name = topics.JOINT_STATES.within("")
    there = [SimpleNamespace(node_name=node, node_namespace="/") for node in ("plant", "robot")]
    node: Any = SimpleNamespace(get_publishers_info_by_topic=lambda topic: there if topic == name else [])

    def after(*who: str, again: str = "") -> str:
        others = Strangers(node, ["plant"])
        others.note({SURPLUS: f"{name}: {', '.join(['/plant', *who])}"})
        others.look()
        if again:
            others.note({SURPLUS: f"{name}: /plant, {again}"})
        assert others.nameless == (NAMELESS in others.text())
        return others.text().removeprefix(f"{name} was also published by others: ")

    assert after(NAMELESS) == "/robot"
    assert after(NAMELESS, NAMELESS) == f"/robot, {NAMELESS}"
    assert after("/gone", NAMELESS, "2 more that came and went") == "/gone, 2 more that came and went, /robot"
    assert after("/gone") == "/gone"
    assert after(NAMELESS, again=NAMELESS) == "/robot"  # said by a node that does not know it yet
    assert after(NAMELESS, again=f"/robot, {NAMELESS}") == f"/robot, {NAMELESS}"


def test_a_bench_does_not_start_beside_a_stranger_on_its_topics(domain: int) -> None:
    """Such as a robot with joint states of its own, or a hand at `ros2 topic pub`."""
    robot = Bystander(domain)
    robot.publisher(topics.JOINT_STATES)
    try:
        with pytest.raises(GraphError) as error:
            Graph(domain_id=domain, without=["recorder", "drag_estimator"]).__enter__()
    finally:
        robot.close()
    assert error.value.fault == "strangers"
    wanted = "/joint_states was also published by others: /bystander: end those nodes, or choose another"
    assert str(error.value).startswith(wanted)
