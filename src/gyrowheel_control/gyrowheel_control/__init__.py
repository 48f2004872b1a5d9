"""Control of the gyrowheel test bench: tilt and spin loops, test plans, the closed loop computed in one go."""

__version__ = "0.1.0"
