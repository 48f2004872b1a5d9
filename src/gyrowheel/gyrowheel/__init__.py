"""The front door: Python API and command line of the gyrowheel test bench."""

__version__ = "0.1.0"
