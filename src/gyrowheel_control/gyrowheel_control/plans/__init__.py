"""Test plans: their format, their variations, and those that are shipped."""

from gyrowheel_control.plans.plan import Plan

__all__ = ["Plan"]
