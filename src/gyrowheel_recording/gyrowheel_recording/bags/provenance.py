"""Where the readings of a recording come from, of those that no instrument of their own took.

A recording that was made of a table says so in the description of its bench, under ``readings``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from gyrowheel_core.units import DEG

#: Units of the readings for which a value may be assumed.
_UNITS: Final = {"air_pressure": "Pa", "air_temperature": "K", "coil_temperature": "K"}


@dataclass(frozen=True)
class Origin:
    """Where a reading comes from.

    Attributes
    ----------
    uncertainty : float
        How far off it may be throughout [SI, 1 sigma].
    pulses : int
        Pulses a turn by which an angle is known; 0 for a value that was assumed for all samples.
    """

    uncertainty: float
    pulses: int = 0


def described(bench: str, origins: Mapping[str, Origin]) -> str:
    """Return the description of a bench with what a recording says of its readings."""
    if not origins:
        return bench
    content = json.loads(bench)
    content["readings"] = {
        name: ({"pulses": own.pulses} if own.pulses else {"assumed": True}) | {"uncertainty": own.uncertainty}
        for name, own in origins.items()
    }
    return json.dumps(content, separators=(",", ":"))


def origins_in(bench: str) -> dict[str, Origin]:
    """Return what the description of a bench says of the readings, by reading; nothing where it is not valid."""
    try:
        entries = json.loads(bench)["readings"].items()
        found = {
            str(name): Origin(float(own["uncertainty"]), int(own.get("pulses", 0))) for name, own in entries
        }
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        return {}
    return {
        name: own
        for name, own in found.items()
        if math.isfinite(own.uncertainty) and own.uncertainty >= 0.0 and own.pulses >= 0
    }


def origins_in_words(origins: Mapping[str, Origin]) -> tuple[str, ...]:
    """Return what stands for readings that no instrument of their own took, and how far off it may be."""
    found = []
    for name, own in origins.items():
        if own.pulses:
            found.append(
                f"{name} (from {own.pulses} pulse{'s' * (own.pulses > 1)} a turn and the speed, "
                f"± {own.uncertainty / DEG:.2g} deg)"
            )
        else:
            found.append(f"{name} (a value is given, ± {own.uncertainty:g} {_UNITS.get(name, '')})")
    return tuple(found)
