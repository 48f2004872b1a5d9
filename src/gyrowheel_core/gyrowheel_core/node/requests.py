"""Requests to services and actions that are repeated if the answer is lost."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

#: Time of silence after which a request is made again [s].
ASK_AGAIN = 2.0


class RepeatedRequest:
    """A request that is repeated if no answer comes.

    The answer of a node that does not know its client yet is lost, and so may be one whose sender or receiver shares
    memory with a process that was killed.

    Parameters
    ----------
    ask : callable
        Makes the request and returns the future of its answer; called at once, and again after `ASK_AGAIN`.
    """

    def __init__(self, ask: Callable[[], Any]) -> None:
        self._ask = ask
        self._futures = [ask()]
        self._asked = time.monotonic()

    @property
    def times(self) -> int:
        """Number of requests."""
        return len(self._futures)

    def answer(self, heard: float = 0.0) -> Any:
        """Return the answer, None until it comes; to be called repeatedly.

        Parameters
        ----------
        heard : float
            Time of the last sign that the answer is still to come [s, by `time.monotonic`].
        """
        found = self._chosen([future.result() for future in self._futures if future.done()])
        if found is None and time.monotonic() - max(self._asked, heard) > ASK_AGAIN:
            self._futures.append(self._ask())
            self._asked = time.monotonic()
        return found

    def _chosen(self, answers: list[Any]) -> Any:
        """Return the valid one of the answers so far; None to wait for another."""
        return answers[0] if answers else None
