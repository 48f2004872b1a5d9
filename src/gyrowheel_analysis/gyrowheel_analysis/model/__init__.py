"""The model: a bench, estimates of its parameters from recordings, and added effects; with its file."""

from gyrowheel_analysis.model.model import Model, Override

__all__ = ["Model", "Override"]
