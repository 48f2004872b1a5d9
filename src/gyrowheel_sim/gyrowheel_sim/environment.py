"""The operator's settings between segments of a test: attitude of the rig, air density, coil heater, rate table."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Final, Literal, get_args

from pydantic import Field

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.schema import Number

#: Attitudes of the rig: case z up, case z down (turned about x), case x up, case y up.
Rig = Literal["upright", "inverted", "x_up", "y_up"]
#: Characters in the name of a machine.
LONGEST_NAME: Final = 64
RIGS: Final[tuple[Rig, ...]] = get_args(Rig)
#: An attitude without weight and without the Earth's rate. No rig has it, so no plan file can state it.
ORBIT: Final = "orbit"
#: Types of fields in files: yaw [deg], air density over the ambient one, preheat [K], rate of the table [deg/s].
Yaw = Annotated[Number, Field(ge=-360.0, le=360.0)]
AirDensityRatio = Annotated[Number, Field(ge=0.0, le=2.0)]
Preheat = Annotated[Number, Field(ge=0.0, le=60.0)]
TableRate = Annotated[Number, Field(ge=-50.0, le=50.0)]
#: Largest time [s]: stamps count nanoseconds in 63 bits.
_LATEST = 9.2e9
#: Home axes (two horizontal ones and the vertical) by the case axes that lie along them, without yaw: the columns
#: of the rotation from case axes to home axes.
_TURNS = {
    "upright": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "inverted": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "x_up": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
    "y_up": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    ORBIT: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
}


@dataclass(frozen=True)
class Environment:
    """The operator's settings of the bench from `time` on."""

    time: float = 0.0  # time from which it holds [s since the start of the recording]
    #: ``"upright"`` or ``"inverted"`` (spin axis up or down), ``"x_up"`` or ``"y_up"`` (that axis of the case
    #: up, the spin axis horizontal); or `ORBIT`.
    rig: str = "upright"
    yaw: float = 0.0  # turn of the rig about the vertical from its home position [rad]
    #: Air density over the ambient one, set by the pressure in the bell jar; 0 is a vacuum, at most 2.
    air_density_ratio: float = 1.0
    #: Temperature of the coils above that of the air, kept by the coil heater [K]; 0 switches it off.
    preheat: float = 0.0
    table_rate: float = 0.0  # rate at which a rate table turns the rig about the vertical [rad/s]
    #: Name of the machine on the rig, by which recordings of two machines are told apart; empty where
    #: unknown.
    machine: str = ""

    def __post_init__(self) -> None:
        """Check every field."""
        if self.rig not in _TURNS:
            raise InputError(f"environment.rig: {self.rig!r}; allowed: {', '.join(RIGS)}")
        named = self.machine
        if not isinstance(named, str) or len(named) > LONGEST_NAME or not named.isprintable():
            raise InputError(
                f"environment.machine: {named!r} is no name; allowed: up to {LONGEST_NAME} printable characters"
            )
        for name, low, high in (
            ("time", 0.0, _LATEST),
            ("yaw", -2 * math.pi, 2 * math.pi),
            ("air_density_ratio", 0.0, 2.0),
            ("preheat", 0.0, 60.0),
            ("table_rate", -1.0, 1.0),
        ):
            value = getattr(self, name)
            if not isinstance(value, int | float) or not low <= value <= high or math.isnan(value):
                raise InputError(
                    f"environment.{name}: {value!r} is out of range; allowed: {low:g} .. {high:g}"
                )

    def in_case(self, home: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return the case components of a vector given in home axes.

        Home axes are those along which the case lies with the rig upright and not yawed: z up.
        """
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        # the rig turns by the yaw, so a fixed vector turns back in the case
        x, y, z = c * home[0] + s * home[1], -s * home[0] + c * home[1], home[2]
        a, b, d = (axis[0] * x + axis[1] * y + axis[2] * z for axis in _TURNS[self.rig])
        return a, b, d

    @property
    def up(self) -> float:
        """Component along case z of the unit vector that points up: +1 upright, -1 inverted."""
        return self.in_case((0.0, 0.0, 1.0))[2]

    @property
    def up_across(self) -> complex:
        """Components across case z of the unit vector that points up, x + i y."""
        x, y, _ = self.in_case((0.0, 0.0, 1.0))
        return complex(x, y)

    @property
    def home(self) -> tuple[complex, complex]:
        """Components across case z, x + i y, of the home axes x and y."""
        first, second = self.in_case((1.0, 0.0, 0.0)), self.in_case((0.0, 1.0, 0.0))
        return complex(*first[:2]), complex(*second[:2])


def merged(known: Sequence[Environment], later: Sequence[Environment]) -> list[Environment]:
    """Return the events after a later message, which replaces all known ones from its first event on."""
    if not later:
        return list(known)
    return [event for event in known if event.time < later[0].time] + list(later)


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
    except InputError:
        raise
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(f"environment: not a list of environments ({one_line(error)})") from None
