"""Control of the gyrowheel test bench: tilt and spin loops, test plans, and the closed loop as one computation."""

__version__ = "0.1.0"
