"""What the nodes of the bench share and takes long to load, without ROS: loaded once, by the launcher of a graph."""

from __future__ import annotations

import inspect
import sys
from importlib import import_module

for _module in (
    "gyrowheel_sim.plant.machine",
    "gyrowheel_sim.plant.real_time",
    "gyrowheel_control.loops.controller",
    "gyrowheel_control.plans.adaptation",
    "gyrowheel_recording.bags",
    "gyrowheel_analysis.drag.prediction",
    "gyrowheel_analysis.drag.stream",
):
    import_module(_module)
# the first line of rclpy's logger looks for its caller among all modules
inspect.getframeinfo(sys._getframe())
