"""The graph of nodes: sessions that start the nodes of the bench, and what viewers need."""

from gyrowheel_core.surroundings import require_ros

__version__ = "0.1.0"

require_ros()  # before a module imports rclpy
