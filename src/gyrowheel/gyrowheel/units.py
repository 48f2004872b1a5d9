"""Units of the laboratory in SI units: multiply to get SI, divide to show."""

from gyrowheel_core.units import DEG, RPM

__all__ = ["DEG", "RPM"]
