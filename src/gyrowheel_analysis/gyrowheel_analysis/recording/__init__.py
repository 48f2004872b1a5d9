"""Recordings: rosbag2 directories of the bench's topics, written and read as numpy columns. Needs no ROS."""

from gyrowheel_analysis.recording.info import RecordingInfo, info
from gyrowheel_analysis.recording.origins import Origin, described
from gyrowheel_analysis.recording.part import parted
from gyrowheel_analysis.recording.reader import Integrity, Recording, load_loops
from gyrowheel_analysis.recording.salvage import Loss, Salvaged, salvage
from gyrowheel_analysis.recording.writer import RecordingWriter, write_run

__all__ = [
    "Integrity",
    "Loss",
    "Origin",
    "Recording",
    "RecordingInfo",
    "RecordingWriter",
    "Salvaged",
    "described",
    "info",
    "load_loops",
    "parted",
    "salvage",
    "write_run",
]
