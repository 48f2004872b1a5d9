"""What the operator changes on the bench between segments of a test: attitude of the rig, air, coil heater."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from gyrowheel_sim.errors import InputError

RIGS = ("upright", "inverted")


@dataclass(frozen=True)
class Environment:
    """The state in which the operator has put the bench from `time` on.

    Attributes
    ----------
    time : float
        From when on it holds [s since the start of the recording].
    rig : str
        ``"upright"`` or ``"inverted"`` (spin axis up or down).
    yaw : float
        Turn of the rig about the vertical from its home position [rad].
    air_density_ratio : float
        Air density over the ambient one, set by the pressure in the bell jar; in (0, 2].
    preheat : float
        How far the coil heater keeps the coils above the air [K]; 0 switches it off.
    """

    time: float = 0.0
    rig: str = "upright"
    yaw: float = 0.0
    air_density_ratio: float = 1.0
    preheat: float = 0.0

    def __post_init__(self) -> None:
        """Check every field."""
        if self.rig not in RIGS:
            raise InputError(f"environment.rig: {self.rig!r}; allowed: {', '.join(RIGS)}")
        for name, low, high in (
            ("time", 0.0, math.inf),
            ("yaw", -2 * math.pi, 2 * math.pi),
            ("air_density_ratio", 0.01, 2.0),
            ("preheat", 0.0, 60.0),
        ):
            value = getattr(self, name)
            if not isinstance(value, int | float) or not low <= value <= high or math.isnan(value):
                raise InputError(
                    f"environment.{name}: {value!r} is out of range; allowed: {low:g} .. {high:g}"
                )

    @property
    def up(self) -> float:
        """+1 upright, -1 inverted: the sign of gravity along the case's z axis."""
        return 1.0 if self.rig == "upright" else -1.0


def to_json(events: Iterable[Environment]) -> str:
    """Return a list of environments as the JSON text of the topic ``/gyrowheel/environment``."""
    return json.dumps([asdict(event) for event in events])


def from_json(text: str) -> list[Environment]:
    """Read what `to_json` wrote.

    Raises
    ------
    InputError
        If the text is no list of environments, or a value is out of range.
    """
    try:
        raw: Any = json.loads(text)
        return [Environment(**entry) for entry in raw]
    except (ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"environment: not a list of environments ({' '.join(str(error).split())})"
        ) from None
