"""Analysis of the gyrowheel test bench: recordings, torque balance, comparison, discovery of effects."""

__version__ = "0.1.0"
