"""How much of a recording takes part in what is said of it, and why the rest does not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

_NEARLY_ALL = 0.9
_SHOWN = 0.05  # s


@dataclass(frozen=True)
class Coverage:
    """What became of the steady motion in recordings: what is neither a ramp nor the settling after one.

    Attributes
    ----------
    recorded : float
        Length of the recordings [s].
    used : float
        What lies in windows [s].
    left_out : dict of str to float
        Steady motion that lies in none, by reason [s].
    """

    recorded: float = 0.0
    used: float = 0.0
    left_out: dict[str, float] = field(default_factory=dict)

    @property
    def steady(self) -> float:
        """Steady motion [s]."""
        return self.used + sum(self.left_out.values())

    @property
    def complete(self) -> bool:
        """Whether nearly all of the steady motion takes part."""
        return self.used >= _NEARLY_ALL * self.steady

    @classmethod
    def of(cls, parts: Iterable[Coverage]) -> Coverage:
        """Return that of several recordings."""
        recorded, used, left_out = 0.0, 0.0, dict[str, float]()
        for part in parts:
            recorded, used = recorded + part.recorded, used + part.used
            for why, length in part.left_out.items():
                left_out[why] = left_out.get(why, 0.0) + length
        return cls(recorded, used, left_out)

    def sentence(self) -> str:
        """Return it in one sentence."""
        reasons = [
            f"{length:.1f} s {why}"
            for why, length in sorted(self.left_out.items(), key=lambda item: -item[1])
            if length >= _SHOWN
        ]
        if not reasons:
            return f"All {self.used:.0f} s of steady motion take part (of {self.recorded:.0f} s recorded)"
        return (
            f"{self.used:.0f} of {self.steady:.0f} s of steady motion take part (of {self.recorded:.0f} s recorded); "
            f"left out: {', '.join(reasons)}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return it as a JSON object; all in seconds."""
        return asdict(self) | {"steady": self.steady}
