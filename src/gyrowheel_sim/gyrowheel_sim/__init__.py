"""The gyrowheel test bench as physics: what it is, how it moves and what its sensors read."""

__version__ = "0.1.0"
