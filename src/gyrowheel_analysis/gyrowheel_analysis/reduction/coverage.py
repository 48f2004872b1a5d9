"""The share of a recording that the analysis uses, and the reasons for the rest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

from gyrowheel_analysis.criteria import NEARLY_ALL

_SHOWN = 0.05  # s


@dataclass(frozen=True)
class Coverage:
    """Use of the steady motion in recordings. Steady is all but ramps and the settling after them.

    Attributes
    ----------
    recorded : float
        Length of the recordings [s].
    used : float
        Steady motion that lies in windows [s].
    left_out : dict of str to float
        Steady motion outside of windows [s], by reason.
    assumed : tuple of str
        Quantities that were never measured, and what is assumed instead.
    """

    recorded: float = 0.0
    used: float = 0.0
    left_out: dict[str, float] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()

    @property
    def steady(self) -> float:
        """Steady motion [s]."""
        return self.used + sum(self.left_out.values())

    @property
    def complete(self) -> bool:
        """Whether nearly all of the steady motion is used, and nothing had to be assumed."""
        return not self.assumed and self.used >= NEARLY_ALL * self.steady

    @classmethod
    def of(cls, parts: Iterable[Coverage]) -> Coverage:
        """Return the coverage of several recordings together."""
        parts = list(parts)
        recorded, used, left_out = 0.0, 0.0, dict[str, float]()
        for part in parts:
            recorded, used = recorded + part.recorded, used + part.used
            for why, length in part.left_out.items():
                left_out[why] = left_out.get(why, 0.0) + length
        # each once, in order
        assumed = dict.fromkeys(what for part in parts for what in part.assumed)
        return cls(recorded, used, left_out, tuple(assumed))

    def sentence(self) -> str:
        """Return it in one sentence."""
        reasons = [
            f"{length:.1f} s {why}"
            for why, length in sorted(self.left_out.items(), key=lambda item: -item[1])
            if length >= _SHOWN
        ]
        never = f"; not measured: {', '.join(self.assumed)}" if self.assumed else ""
        if not reasons:
            return (
                f"All {self.used:.0f} s of steady motion take part (of {self.recorded:.0f} s recorded){never}"
            )
        return (
            f"{self.used:.0f} of {self.steady:.0f} s of steady motion take part (of {self.recorded:.0f} s recorded); "
            f"left out: {', '.join(reasons)}{never}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return it as a JSON object; all in seconds."""
        return asdict(self) | {"steady": self.steady}
