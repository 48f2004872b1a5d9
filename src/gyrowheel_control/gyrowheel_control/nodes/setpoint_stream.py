"""The stream of setpoints that the conductor publishes ahead of the time of the bench."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_control.plans.plan import HOLD, SETPOINT_PERIOD, Plan
from gyrowheel_core import wire

SETPOINT_PERIOD_NS = round(SETPOINT_PERIOD * 1e9)
_MOTION = ("tilt_rate_x", "tilt_rate_y", "spin_acceleration")


def at_rest(setpoint: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of one setpoint, shape (1,), as a hold with zero rates."""
    held = setpoint.copy()
    held["phase"] = HOLD
    for name in _MOTION:
        held[name] = 0.0
    return held


def final_hold(setpoints: NDArray[Any], plan: Plan) -> NDArray[Any]:
    """Return the setpoint, shape (1,), that holds the final state of a plan."""
    held = at_rest(setpoints[-1:])
    held["spin_rate"] = plan.segments[-1].spin_end
    return held


class SetpointStream:
    """Publishes setpoints, one each `SETPOINT_PERIOD`.

    Parameters
    ----------
    publish : callable
        Publishes one message, as bytes.

    Attributes
    ----------
    next : int
        Stamp of the next setpoint [ns].
    """

    def __init__(self, publish: Callable[[bytes], None]) -> None:
        self._publish = publish
        self.next = 0

    def send(self, rows: NDArray[Any]) -> None:
        """Publish setpoints, the first of them at the next stamp."""
        messages = wire.SETPOINT.array(len(rows))
        wire.SETPOINT.set_stamps(messages, self.next + np.arange(len(rows)) * SETPOINT_PERIOD_NS)
        for name in (*wire.SETPOINT.integers, *wire.SETPOINT.fields):
            messages[name] = rows[name]
        data, size = messages.tobytes(), wire.SETPOINT.size
        for place in range(0, len(data), size):
            self._publish(data[place : place + size])
        self.next += len(rows) * SETPOINT_PERIOD_NS

    def hold(self, setpoint: NDArray[Any], until: int) -> None:
        """Publish one setpoint, shape (1,), again and again up to, not including, a stamp [ns]."""
        count = (until - self.next) // SETPOINT_PERIOD_NS
        if count > 0:
            self.send(np.repeat(setpoint, count))

    def resend(self, rows: NDArray[Any], since: int) -> None:
        """Publish setpoints that were published before, the first of them at the stamp `since` [ns]."""
        if len(rows):
            self.next = since
            self.send(rows)
