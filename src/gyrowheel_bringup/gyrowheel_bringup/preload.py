"""What the nodes of the bench share and takes long to load, without ROS: loaded once, by the launcher of a graph."""

from __future__ import annotations

import inspect
import sys

import gyrowheel_sim.plant.machine
import gyrowheel_sim.plant.real_time  # noqa: F401
from gyrowheel_sim.jit import load_tables

load_tables()
inspect.getframeinfo(
    sys._getframe()
)  # the first line of rclpy's logger looks for its caller among all modules
