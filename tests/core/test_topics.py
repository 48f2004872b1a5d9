"""Names, types and quality of service of the topics."""

import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from gyrowheel_core import topics
from gyrowheel_core.topics import TOPICS, Topic

EVERY = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)


def test_the_table_has_every_topic_once() -> None:
    declared = [value for value in vars(topics).values() if isinstance(value, Topic)]
    assert sorted(declared, key=id) == sorted(TOPICS, key=id)
    assert len({topic.name for topic in TOPICS}) == len(TOPICS)


@EVERY
def test_every_topic_type_is_installed_under_its_name(topic: Topic) -> None:
    package, _, name = topic.type_name.split("/")
    assert topic.message_class.__name__ == name
    assert topic.message_class.__module__.startswith(f"{package}.msg")


@EVERY
def test_delivery_is_reliable_and_latched_as_declared(topic: Topic) -> None:
    qos = topic.qos
    assert qos.reliability == ReliabilityPolicy.RELIABLE
    assert qos.depth == topic.depth
    assert (qos.durability == DurabilityPolicy.TRANSIENT_LOCAL) == topic.latched


def test_a_late_reader_learns_bench_and_environment() -> None:
    assert {topic.name for topic in TOPICS if topic.latched} == {"/gyrowheel/bench", "/gyrowheel/environment"}
