"""Why the time of the bench went on by more than a second at once."""

from __future__ import annotations

import pytest

from gyrowheel_control.nodes.conductor import JUMP_NS, leap


@pytest.mark.parametrize("step", [JUMP_NS + 1, 3_000_000_000])
def test_a_busy_computer_is_not_called_a_jump_of_the_clock(step: int) -> None:
    """Nothing came for as long as the time went on."""
    busy = f"stood_still: no sample came for {step * 1e-9:.1f} s, as the computer was too busy"
    assert leap(step, step).startswith(busy)
    assert leap(step, 500_000) == "clock_jump: the time went"
