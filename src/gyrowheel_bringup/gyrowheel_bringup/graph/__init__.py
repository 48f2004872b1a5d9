"""Starts each node of the bench as a process, runs test plans in the graph, and ends the nodes again.

>>> with Graph("quick", record="run1") as graph:          # doctest: +SKIP
...     result = graph.run(progress=lambda p: print(f"{p.elapsed:.0f} of {p.duration:.0f} s"))
>>> result.recording, result.samples                      # doctest: +SKIP
"""

from __future__ import annotations

from gyrowheel_bringup.graph.foreign_nodes import require_free
from gyrowheel_bringup.graph.nodes import (
    EXECUTABLES,
    executables,
    find_executable,
    node_parameters,
    run_executable,
)
from gyrowheel_bringup.graph.results import GraphError, GraphResult, Progress
from gyrowheel_bringup.graph.session import Graph

__all__ = [
    "EXECUTABLES", "Graph", "GraphError", "GraphResult", "Progress", "executables", "find_executable",
    "node_parameters", "require_free", "run_executable",
]  # fmt: skip
