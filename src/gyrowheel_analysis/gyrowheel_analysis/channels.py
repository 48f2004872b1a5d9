"""The channels: every quantity that the balance predicts and the recording measures, declared once.

A channel has one row a window, or two where it is complex: the x and y parts of the mean torque, the real and imaginary
parts of an amplitude. The order of the rows, their drift, the lines of the error table and the words for a residual all
follow from the declarations in `CHANNELS`. Prediction, measurement and noise of a row are the physics of its
`quantity` in `balance.rows` and `fitting.variance`; a channel of an existing quantity is declared here alone.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass, replace
from typing import Literal

#: When a channel is evaluated: averaged over whole revolutions, once or twice a revolution, at the motor's ripple.
Group = Literal["average", "revolution", "ripple"]
#: Quantity of a channel: torque of the coils, torque or voltage of the motor, torque that accelerates the shaft,
#: voltage across the resistance of the winding, angle of the shaft relative to its steady growth.
Quantity = Literal[
    "coil_torque", "motor_torque", "motor_voltage", "shaft_torque", "winding_voltage", "encoder_angle"
]
#: The groups in the order of the rows.
GROUPS: tuple[Group, ...] = ("average", "revolution", "ripple")


@dataclass(frozen=True)
class Channel:
    """A measured and predicted quantity.

    Attributes
    ----------
    name : str
        Its name, as in the results' JSON.
    rows : tuple of str
        Names of its rows; two are the real and the imaginary part.
    title : str
        Short name for people.
    unit : str
        ``N·m``, ``V`` or ``rad``.
    group : Group
        When it is evaluated.
    quantity : Quantity
        Its quantity.
    order : int
        Multiple of the spin speed, for channels of the group ``revolution``.
    drift : str
        Reading whose slow drift it carries, ``coil_voltage``, ``motor_current`` or ``motor_voltage``; empty for an
        amplitude, which carries none. Channels of one reading share one scale of the drift.
    by_axis : bool
        Whether the error table lists its rows separately.
    subject : str
        The channel in a sentence about the part beyond the model.
    measured : str
        The channel in a sentence about the measurement.
    patterns : tuple of str
        Ways to depend on the motion that are tried on its residual, see `residuals.growth.pattern`.
    """

    name: str
    rows: tuple[str, ...]
    title: str
    unit: str
    group: Group
    quantity: Quantity
    subject: str
    measured: str
    patterns: tuple[str, ...]
    order: int = 0
    drift: str = ""
    by_axis: bool = False


_DECLARED = (
    Channel(
        "tilt", ("tilt_x", "tilt_y"), "tilt", "N·m", "average", "coil_torque",
        "coil torque", "the mean torque of the coils",
        ("tilt", "still", "cube", "rate", "load", "table", "room", "mirror"), drift="coil_voltage", by_axis=True,
    ),
    Channel(
        "spin", ("spin",), "spin", "N·m", "average", "motor_torque",
        "motor torque", "the mean torque of the motor",
        ("still", "square", "acceleration"), drift="motor_current",
    ),
    Channel(
        "tilt_1n", ("tilt_1n_x", "tilt_1n_y"), "tilt 1N", "N·m", "revolution", "coil_torque",
        "coil torque once a revolution", "the torque of the coils once a revolution",
        ("still", "tilt", "mirror"), order=1,
    ),
    Channel(
        "tilt_2n", ("tilt_2n_x", "tilt_2n_y"), "tilt 2N", "N·m", "revolution", "coil_torque",
        "coil torque twice a revolution", "the torque of the coils twice a revolution",
        ("mirror", "still", "tilt"), order=2,
    ),
    Channel(
        "angle_1n", ("angle_1n_x", "angle_1n_y"), "angle 1N", "rad", "revolution", "encoder_angle",
        "angle once a revolution", "the reading of the angle once a revolution", ("still", "tilt"), order=1,
    ),
    Channel(
        "angle_2n", ("angle_2n_x", "angle_2n_y"), "angle 2N", "rad", "revolution", "encoder_angle",
        "angle twice a revolution", "the reading of the angle twice a revolution", ("still", "tilt"), order=2,
    ),
    Channel(
        "spin_ripple", ("spin_ripple_x", "spin_ripple_y"), "spin ripple", "N·m", "ripple", "shaft_torque",
        "ripple of the motor torque", "the ripple of the motor's torque", ("still", "square"),
    ),
    Channel(
        "motor_voltage", ("motor_voltage",), "voltage", "V", "average", "motor_voltage",
        "motor voltage", "the mean voltage of the motor",
        ("still", "square", "acceleration"), drift="motor_voltage",
    ),
    Channel(
        "voltage_ripple", ("voltage_ripple_x", "voltage_ripple_y"), "voltage ripple", "V", "ripple", "winding_voltage",
        "ripple of the motor voltage", "the ripple of the motor's voltage", ("still",),
    ),
)  # fmt: skip

#: All channels by name, in the order in which they are shown.
CHANNELS: dict[str, Channel] = {channel.name: channel for channel in _DECLARED}
#: The channels as the error table lists them: those given `by_axis` row by row.
LISTED: dict[str, Channel] = {
    own.name: own
    for channel in _DECLARED
    for own in (
        [replace(channel, name=row, rows=(row,), title=f"{channel.title} {row[-1]}") for row in channel.rows]
        if channel.by_axis
        else [channel]
    )
}
#: The channel of the averaged torque of the coils; recordings without both coil voltages lack it.
COILS = "tilt"
#: Channels of averaged torques, and all others.
TORQUES = tuple(name for name, c in LISTED.items() if c.group == "average" and c.unit == "N·m")
FURTHER = tuple(name for name in LISTED if name not in TORQUES)
#: Readings whose drifts are scaled, each by one scale.
DRIFTS = tuple(dict.fromkeys(channel.drift for channel in _DECLARED if channel.drift))


def in_groups(*groups: Group) -> tuple[Channel, ...]:
    """Return the channels of some groups, in the order of their rows."""
    return tuple(
        channel for group in GROUPS if group in groups for channel in _DECLARED if channel.group == group
    )


def rows_of(*groups: Group) -> tuple[str, ...]:
    """Return the names of the rows of some groups, in their order."""
    return tuple(row for channel in in_groups(*groups) for row in channel.rows)


#: Rows of the averages, and all rows, in their order.
AVERAGE_ROWS = rows_of("average")
ALL_ROWS = rows_of(*GROUPS)

#: Unknown parts of an angle from a few pulses a turn: its course between pulses and, where pulses cannot be
#: distinguished, the position of the rotor within the turn (by order, and for the ripple of the motor).
WITHIN_TURN = "spin_angle within a turn"
_PHASE = "spin_angle {:g}N"
_RIPPLE = "spin_angle of the ripple"

#: Readings without which a quantity cannot be compared, besides those that name its rows.
_COMPARES: dict[Quantity, frozenset[str]] = {
    "coil_torque": frozenset(),
    "motor_torque": frozenset({"motor_current"}),
    "motor_voltage": frozenset({"motor_voltage"}),
    "shaft_torque": frozenset({"spin_angle", _RIPPLE, "spin_rate", "motor_current"}),
    "winding_voltage": frozenset({"spin_angle", _RIPPLE, "spin_rate", "motor_current", "motor_voltage"}),
    "encoder_angle": frozenset({"spin_angle", WITHIN_TURN}),
}
_COILS = frozenset({"coil_voltage_x", "coil_voltage_y"})


def measurable(channel: Channel, absent: Set[str]) -> tuple[str, ...]:
    """Return the rows of a channel that are measured where some readings are absent.

    The average torque of one coil needs its own voltage alone; harmonics need both voltages and the angle.
    """
    if _COMPARES[channel.quantity] & absent:
        return ()
    if channel.quantity != "coil_torque" or not absent:
        return channel.rows
    if channel.group == "average":
        return tuple(row for row in channel.rows if f"coil_voltage_{row[-1]}" not in absent)
    return () if absent & (_COILS | {"spin_angle", _PHASE.format(channel.order)}) else channel.rows


def unphased(pulses: int, ripple: float) -> frozenset[str]:
    """Return the unknown parts of an angle from equal pulses, in the words of `measurable`.

    With n `pulses` a turn it is known except for whole multiples of 2 pi / n. What happens a multiple of n times a turn
    has the same phase in each of them, anything else has an unknown one. `ripple` is the number of periods of the
    motor's ripple in a turn.
    """
    lost = {WITHIN_TURN, *(_PHASE.format(c.order) for c in CHANNELS.values() if c.order % pulses)}
    return frozenset(lost | ({_RIPPLE} if ripple % pulses else set()))
