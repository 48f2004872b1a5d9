"""The gyrowheel command, and what starts the nodes of the bench."""

__version__ = "0.1.0"
