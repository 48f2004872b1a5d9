"""Tilt and spin loops, their limits, and the closed loop without ROS."""
