"""Result of a replay."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text

from gyrowheel.drag_comparison.page import drag_page
from gyrowheel.show.layout import sentences

if TYPE_CHECKING:
    from gyrowheel_bringup.replay_session import Outcome

_MEASUREMENT = "/gyrowheel/measurement"


def replay_page(outcome: Outcome, duration: float) -> Iterator[RenderableType]:
    """Yield the parts of the result; `duration` is the length of the range [s]."""
    total, samples = sum(outcome.counts.values()), outcome.counts.get(_MEASUREMENT, 0)
    pace = ""
    if outcome.wall > 0.0 and outcome.complete:
        pace = f", {outcome.rounds * duration / outcome.wall:.2f} times real time"
    yield Text(f"{total} messages replayed, {samples} of them samples, in {outcome.wall:.1f} s{pace}")
    yield from sentences(f"{name} left out: {why}" for name, why in outcome.left_out.items())
    yield from drag_page(outcome.estimates)
