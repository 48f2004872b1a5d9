"""Analysis of the gyrowheel test bench: reduction, torque balance, comparison, identification of missing effects."""

__version__ = "0.1.0"
