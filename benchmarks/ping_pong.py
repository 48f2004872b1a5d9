"""Two minimal processes that exchange the bytes of a sample and of a command: the upper limit of rclpy.

``python ping_pong.py pong`` answers; ``python ping_pong.py ping SECONDS`` asks, and prints the rounds in every
second, and finally its processor time per round [s]. Both have topics, quality of service and executor of the real
nodes, and do nothing else.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import rclpy
from rclpy.node import Node

from gyrowheel_core import topics, wire
from gyrowheel_core.node import StopSignals, make_executor, prepare_environment

_SAMPLE = wire.MEASUREMENT.pack(0, 0, *[0.0] * len(wire.MEASUREMENT.fields))
_COMMAND = wire.COMMAND.pack(0, 0, *[0.0] * len(wire.COMMAND.fields))


def _spin(role: str, seconds: float) -> None:
    stop = StopSignals()
    prepare_environment()
    rclpy.init(args=[])
    node = Node(role, enable_rosout=False)
    executor = make_executor()
    executor.add_node(node)
    sends, takes, data = (
        (topics.MEASUREMENT, topics.COMMAND, _SAMPLE)
        if role == "ping"
        else (topics.COMMAND, topics.MEASUREMENT, _COMMAND)
    )
    publisher = node.create_publisher(sends.message_class, sends.name, sends.qos)
    rounds = 0

    def answer(raw: bytes) -> None:
        nonlocal rounds
        rounds += 1
        publisher.publish(data)

    node.create_subscription(takes.message_class, takes.name, answer, takes.qos, raw=True)
    if role == "ping":
        while not stop.received and not (
            publisher.get_subscription_count() and node.count_publishers(takes.name)
        ):
            executor.spin_once(timeout_sec=0.1)
        executor.spin_once(timeout_sec=0.1)
        publisher.publish(data)
        begun, end = (rounds, time.process_time()), time.perf_counter() + seconds
        while not stop.received and (now := time.perf_counter()) < end:
            counted, until = rounds, now + 1.0
            while time.perf_counter() < until and not stop.received:
                executor.spin_once(timeout_sec=0.1)
            print((rounds - counted) / (time.perf_counter() - now), flush=True)
        print((time.process_time() - begun[1]) / max(rounds - begun[0], 1), flush=True)
    while role == "pong" and not stop.received:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


def _main(arguments: list[Any]) -> None:
    role, *rest = arguments
    _spin(role, float(rest[0]) if rest else 0.0)


if __name__ == "__main__":
    _main(sys.argv[1:])
