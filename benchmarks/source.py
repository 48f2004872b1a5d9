"""A process that publishes measurements and commands alternately, at a constant rate.

``python -m benchmarks.source DOMAIN RATE SECONDS FILE`` starts when both topics have a subscriber, and stores in the
file how many pairs it has published, and for how long.
"""

from __future__ import annotations

import os
import struct
import sys
import time
from pathlib import Path
from typing import Final

import rclpy
from rclpy.duration import Duration

from gyrowheel_core import topics, wire
from gyrowheel_core.node import prepare_environment

PERIOD_NS: Final = 500_000
#: Content of the file: published pairs, and time since the first [s].
STATE: Final = struct.Struct("<Qd")
#: Largest delay that it catches up [s].
_LATEST: Final = 0.05


def state(file: Path) -> tuple[int, float]:
    """Return the number of pairs that a source has published so far, and the time [s]."""
    try:
        data = file.read_bytes()
    except FileNotFoundError:
        return 0, 0.0
    sent, seconds = STATE.unpack(data) if len(data) == STATE.size else (0, 0.0)
    return sent, seconds


def main(domain: int, rate: float, seconds: float, file: Path) -> None:
    """Publish at a rate of messages per second, of both topics together."""
    prepare_environment()
    rclpy.init(domain_id=domain)
    node = rclpy.create_node("source")
    publishers = [
        node.create_publisher(topic.message_class, topic.name, topic.qos)
        for topic in (topics.MEASUREMENT, topics.COMMAND)
    ]
    while any(publisher.get_subscription_count() < 1 for publisher in publishers):
        time.sleep(0.02)
    measurement, command = publishers
    sent, now, lag = 0, 0.0, 0.0
    begin = time.monotonic()
    with file.open("wb", buffering=0) as stream:
        while sent < int(seconds * rate / 2.0):
            now = time.monotonic() - begin
            due = min(int((now - lag) * rate / 2.0), int(seconds * rate / 2.0))
            if (
                late := (due - sent) / (rate / 2.0) - _LATEST
            ) > 0.0:  # avoids flooding the reader after a pause
                lag += late
                due = sent + int(_LATEST * rate / 2.0)
            for k in range(sent, due):
                measurement.publish(wire.MEASUREMENT.pack(k * PERIOD_NS, k, *[float(k)] * 11))
                command.publish(wire.COMMAND.pack(k * PERIOD_NS, k, 1.0, 2.0, 3.0))
            sent = due
            os.pwrite(stream.fileno(), STATE.pack(sent, now), 0)
            time.sleep(0.001)
        for publisher in publishers:
            publisher.wait_for_all_acked(Duration(seconds=10))
    # exit without cleanup: after the kill of a reader the middleware may hang there
    os._exit(0)


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4]))
