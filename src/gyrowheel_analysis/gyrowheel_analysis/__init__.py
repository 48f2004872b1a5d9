"""Analysis of the gyrowheel test bench: recordings, torque balance, comparison with a model, discovery of effects."""

__version__ = "0.1.0"
