"""Recordings: rosbag2 directories of the bench's topics, written and read as numpy columns. Needs no ROS."""

from gyrowheel_recording.bags.info import RecordingInfo, info
from gyrowheel_recording.bags.reader import Integrity, Recording, load_loops
from gyrowheel_recording.bags.salvage import Loss, Salvaged, salvage
from gyrowheel_recording.bags.selection import parted
from gyrowheel_recording.bags.writer import RecordingWriter, being_written, write_run
from gyrowheel_recording.derived import Origin, described

__all__ = [
    "Integrity", "Loss", "Origin", "Recording", "RecordingInfo", "RecordingWriter", "Salvaged",
    "being_written", "described",
    "info", "load_loops", "parted", "salvage", "write_run",
]  # fmt: skip
