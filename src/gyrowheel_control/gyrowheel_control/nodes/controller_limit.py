"""The tilt limit that a plan needs, set in the controller before the plan starts."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from gyrowheel_core.errors import InputError
from gyrowheel_core.node import BenchNode, RepeatedRequest

#: Time for which the controller that takes the limit may be missing [s].
LIMIT_TIMEOUT = 10.0


class ControllerLimit:
    """Sets the tilt limit of each plan in the controller.

    Parameters
    ----------
    node : BenchNode
        The node that asks.
    controller : str
        Name of the node with the parameter ``tilt_limit``.
    answered : callable
        Called when the controller has answered.
    """

    def __init__(self, node: BenchNode, controller: str, answered: Callable[[], None]) -> None:
        self._node = node
        self._controller = controller
        self._answered = answered
        self._client = node.create_client(SetParameters, f"{controller.rstrip('/')}/set_parameters")
        self._plan, self._limit = "", 0.0
        self._since = 0.0  # by the clock of `time.monotonic`
        self._asked: RepeatedRequest | None = None

    def begin(self, plan: str, limit: float) -> None:
        """Set the limit [rad] of a plan, which is named in errors, from now on."""
        self._plan, self._limit = plan, limit
        self._since, self._asked = time.monotonic(), None

    def is_set(self, usual: float) -> bool:
        """Return whether the plan may start.

        Parameters
        ----------
        usual : float
            Limit up to which a controller need not be there [rad]: there may be another one, with its own limits.

        Raises
        ------
        InputError
            If the controller does not come, or refuses the limit.
        """
        if self._asked is None:
            if not self._client.service_is_ready():
                if self._limit <= usual:
                    return True
                if time.monotonic() > self._since + LIMIT_TIMEOUT:
                    raise InputError(
                        f"plan {self._plan} needs a tilt limit of {math.degrees(self._limit):.2f} deg, "
                        f"and there is no node '{self._controller}' to set it in"
                    )
                return False
            self._asked = RepeatedRequest(self._ask)
        answer = self._asked.answer()
        if answer is None:
            return False
        (result,) = answer.results
        if not result.successful:
            raise InputError(f"plan {self._plan}: the controller refuses its tilt limit: {result.reason}")
        return True

    def destroy(self) -> None:
        """Destroy the client."""
        self._node.destroy_client(self._client)

    def _ask(self) -> Any:
        wanted = Parameter("tilt_limit", value=self._limit).to_parameter_msg()
        future = self._client.call_async(SetParameters.Request(parameters=[wanted]))
        future.add_done_callback(lambda _: self._answered())
        return future
