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
    assumed : tuple of str
        What was never measured, and what was taken in its place.
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
        """Whether nearly all of the steady motion takes part, and nothing had to be assumed in place of readings."""
        return not self.assumed and self.used >= _NEARLY_ALL * self.steady

    @classmethod
    def of(cls, parts: Iterable[Coverage]) -> Coverage:
        """Return that of several recordings."""
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
