"""Base of the nodes: lifecycle, parameters, status, signals, exit codes.

A node derives from `BenchNode`, lists its parameters in one place, fills in the hooks it needs and is started
by `run_node`::

    class TickNode(BenchNode):
        '''Says tick.'''

        NODE_NAME = "tick"
        PARAMETERS = (
            Param("period", 1.0, "Time between two ticks [s, wall clock]", low=0.01, high=60.0),
            Param("word", "tick", "What to say", choices=("tick", "tock")),
        )

        def configure(self) -> None:
            self._word = self.parameter("word")

        def activate(self) -> None:
            self._timer = self.wall_timer(self.parameter("period"), self._tick)

        def deactivate(self) -> None:
            self.destroy_timer(self._timer)

        def diagnose(self) -> NodeStatus:
            return NodeStatus("ticking", values={"ticks": self._ticks})

    def main() -> int:
        return run_node(TickNode)

What this gives each node:

* the lifecycle of a managed node; with the parameter ``autostart`` (true unless set otherwise) it
  configures and activates itself, so that no lifecycle manager is needed;
* parameters with type, range and description. They can be set from outside until the node is configured; those
  declared as ``live`` also later, within what `BenchNode.check_tuning` allows. A bad value, an unreadable file or
  any other `InputError` of a hook ends an automatically started node with one line on stderr and exit code 2; under
  a lifecycle manager the transition fails, with the same line in the log, and can be tried again;
* a clean end on Ctrl-C (however often it arrives), SIGTERM and SIGHUP: the hooks `deactivate` and `cleanup`
  run, the exit code is 0;
* `BenchNode.fault`: ends the process with a named fault, logged, published on ``/diagnostics``, exit code 3;
* a watch over the publishers of what it reads (`PublisherWatch`): a topic with more than one is a warning on
  ``/diagnostics``, with the names of the nodes;
* ``/diagnostics`` once per second of wall time and at every `BenchNode.announce`, from `BenchNode.diagnose`, with the
  state of the lifecycle and the process id;
* ``--help`` with the table of the parameters.
"""

from gyrowheel_core.node.base import SURPLUS, WAITS_FOR, WARN, BenchNode, Fault, NodeStatus
from gyrowheel_core.node.endpoints import Inbox, Newcomers, RepeatedRequest
from gyrowheel_core.node.parameters import AUTOSTART, Param
from gyrowheel_core.node.priority import PRIORITY, is_refused
from gyrowheel_core.node.process import (
    TORN,
    ExitCode,
    StopSignals,
    make_executor,
    parameter_help,
    run_node,
    spin,
)
from gyrowheel_core.start_node import PARENT_VARIABLE
from gyrowheel_core.surroundings import prepare_environment

__all__ = [
    "AUTOSTART", "PARENT_VARIABLE", "PRIORITY", "SURPLUS", "TORN", "WAITS_FOR", "WARN", "BenchNode",
    "ExitCode", "Fault", "Inbox", "Newcomers", "NodeStatus", "Param", "RepeatedRequest", "StopSignals",
    "is_refused", "make_executor", "parameter_help", "prepare_environment", "run_node", "spin",
]  # fmt: skip
