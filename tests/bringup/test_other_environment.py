"""Another ROS 2 environment sees the bench by the script that `make` writes, and nothing of its own is replaced."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
from gyrowheel_msgs.msg import Measurement

from gyrowheel_core.node import prepare_environment
from gyrowheel_recording.bags import Recording
from tools import ros_setup

ROOT = Path(__file__).resolve().parents[2]
LISTENER = """\
import os, time
import rclpy
from gyrowheel_msgs.msg import Measurement
import gyrowheel_core.topics

rclpy.init()
node = rclpy.create_node("stranger")
seen = []
node.create_subscription(Measurement, "/gyrowheel/measurement", lambda message: seen.append(message.sequence), 10)
until = time.monotonic() + 30.0
while not seen and time.monotonic() < until:
    rclpy.spin_once(node, timeout_sec=0.1)
print("heard", seen[0], "by", rclpy.__file__)
"""
#: A recorder of another make: it knows the messages by what the script shows of the bench, and keeps their bytes.
RECORDER = """\
import sys, time
from pathlib import Path
import rclpy
from ament_index_python.packages import get_package_share_directory
from gyrowheel_msgs.msg import Measurement
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

kind = "gyrowheel_msgs/msg/Measurement"
store = get_typestore(Stores.ROS2_JAZZY)
text = (Path(get_package_share_directory("gyrowheel_msgs")) / "msg" / "Measurement.msg").read_text()
store.register(get_types_from_msg(text, kind))
rclpy.init()
node = rclpy.create_node("recorder")
with Writer(Path(sys.argv[1]), version=9) as writer:
    topic = writer.add_connection("/gyrowheel/measurement", kind, typestore=store)
    kept = []

    def keep(raw):
        kept.append(raw)
        writer.write(topic, time.time_ns(), raw)

    node.create_subscription(Measurement, "/gyrowheel/measurement", keep, 100, raw=True)
    until = time.monotonic() + 30.0
    while len(kept) < 20 and time.monotonic() < until:
        rclpy.spin_once(node, timeout_sec=0.1)
print("kept", len(kept), "by", rclpy.__file__)
"""


#: Variables by which the environment of the tests finds its own libraries; the wheels of ROS set them once.
OURS = ("PYTHONPATH", "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")


def linked(source: Path, target: Path) -> None:
    """Link all in a folder that is not the bench's own."""
    for path in source.iterdir():
        own = path.name.startswith(("gyrowheel", "_editable", "__editable__", "libgyrowheel"))
        if not own and not (target / path.name).exists():
            (target / path.name).symlink_to(path)


@pytest.mark.graph
@pytest.mark.skipif(
    not list((ROOT / ".venv" / "lib").glob("libgyrowheel_msgs__*.so")), reason="not built by make"
)
@pytest.mark.parametrize(("program", "said"), [(LISTENER, "heard "), (RECORDER, "kept 20 by ")])
def test_a_tool_of_another_environment_hears_the_bench(
    domain: int, tmp_path: Path, program: str, said: str
) -> None:
    prefix, other = Path(sys.prefix), tmp_path / "other"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(other)], check=True)
    packages = Path("lib") / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    linked(prefix / packages, other / packages)
    linked(prefix / "lib", other / "lib")
    (other / "share").symlink_to(prefix / "share")
    script = tmp_path / "listener.py"
    script.write_text(program, encoding="utf-8")
    setup = ros_setup.write(prefix, ROOT / "src")
    env = {name: text for name, text in os.environ.items() if name not in OURS}
    env |= {"ROS_DOMAIN_ID": str(domain), "AMENT_PREFIX_PATH": str(other)}
    bare = subprocess.run(
        [str(other / "bin" / "python"), "-c", "import gyrowheel_msgs"],
        env=env,
        capture_output=True,
        check=False,
    )
    assert bare.returncode == 1
    listener = subprocess.Popen(
        ["sh", "-c", f". {setup}; exec {other}/bin/python {script} {tmp_path / 'bag'}"], env=env, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    prepare_environment()  # the first node of a process settles what the middleware reads
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        node = rclpy.create_node("bench", context=context)
        # a busy computer may keep the other process waiting
        publisher = node.create_publisher(Measurement, "/gyrowheel/measurement", 100)
        until = time.monotonic() + 40.0
        sent = Measurement()
        while publisher.get_subscription_count() == 0 and time.monotonic() < until:
            time.sleep(0.05)
        while listener.poll() is None and time.monotonic() < until:
            publisher.publish(sent)
            sent.sequence += 1
            sent.header.stamp.nanosec += 500_000
            time.sleep(0.02)
        out, err = listener.communicate(timeout=10)
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
        listener.kill()
    assert out.startswith(said), err
    assert str(other) in out  # its own rclpy
    if program == RECORDER:
        samples = Recording.open(tmp_path / "bag").measurement
        assert len(samples) == 20
        assert set(np.diff(samples["stamp_ns"])) == {500_000}
