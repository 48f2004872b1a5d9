"""The angle of a shaft from pulses: where their edges are, and what the angle is between them."""

from gyrowheel_recording.mapping.pulses.edges import Edges, edges_of_count, edges_of_level, edges_of_times
from gyrowheel_recording.mapping.pulses.turning import PulseError, Turned, turned

__all__ = [
    "Edges",
    "PulseError",
    "Turned",
    "edges_of_count",
    "edges_of_level",
    "edges_of_times",
    "turned",
]
