"""Starts the nodes of the bench as processes of their own, runs a test plan in them and ends them again.

>>> with Graph("quick", record="run1") as graph:          # doctest: +SKIP
...     result = graph.run(progress=lambda p: print(f"{p.elapsed:.0f} of {p.duration:.0f} s"))
>>> result.recording, result.samples                      # doctest: +SKIP
"""

from __future__ import annotations

from gyrowheel_bringup.graph.nodes import EXECUTABLES, find_executable, node_parameters, run_executable
from gyrowheel_bringup.graph.results import GraphError, GraphResult, Progress
from gyrowheel_bringup.graph.session import Graph

__all__ = [
    "EXECUTABLES",
    "Graph",
    "GraphError",
    "GraphResult",
    "Progress",
    "find_executable",
    "node_parameters",
    "run_executable",
]
