"""Repeated diagnoses of a recording that grows: when a finding is settled although the bench still runs.

Whoever looks often enough sees chance exceed any fixed threshold. Look number k may therefore spend the part
1 / (k (k + 1)) of the probability of a false alarm; these parts add up to one, however many looks there are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from gyrowheel_analysis.criteria import ACCEPTED_GAIN
from gyrowheel_analysis.diagnosis.result import Diagnosis


def required_gain(look: int) -> float:
    """Return the gain that a finding needs at look number `look`, 1 or more, to be settled."""
    return ACCEPTED_GAIN + 2.0 * math.log(look * (look + 1))


@dataclass(frozen=True)
class Settlement:
    """What the looks so far have found.

    Attributes
    ----------
    looks : int
        How often the recording was looked at.
    gains : dict of str to float
        The findings of the last look with their gains, where its verdict was ``effect``.
    settled : bool
        Whether the last two looks name the same findings without a tie, and each gains enough for this look.
    """

    looks: int = 0
    gains: Mapping[str, float] | None = None
    settled: bool = False

    def after(self, found: Diagnosis) -> Settlement:
        """Return the settlement after one more look."""
        look = self.looks + 1
        gains = None
        if found.verdict == "effect" and not found.events:
            gains = {f.name: f.delta_chi2 for f in found.effects}
            gains |= {f.name: f.delta_chi2 for f in found.instruments}
        return Settlement(
            look,
            gains,
            gains is not None
            and self.gains is not None
            and set(gains) == set(self.gains)
            and min(gains.values()) >= required_gain(look),
        )
