"""Efforts of the joints, as standard messages have them, and the voltages of the bench."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrowheel_core.errors import InputError
from gyrowheel_core.topics import JOINTS
from gyrowheel_sim.bench import Bench


class Efforts:
    """Turns efforts of the joints into voltages of coils and motor.

    Parameters
    ----------
    bench : Bench
        The bench as its file describes it: its constants are those of the conversion.
    meaning : str
        What an effort is: ``torque`` [N·m], or ``voltage`` [V].
    """

    def __init__(self, bench: Bench, meaning: str) -> None:
        self._voltage = meaning == "voltage"
        v = bench.value
        self._coil, self._motor, self._resistance = (
            v("coil_constant"),
            v("motor_constant"),
            v("motor_resistance"),
        )

    def voltages(self, efforts: Sequence[float], spin_rate: float) -> tuple[float, float, float]:
        """Return coil voltage x, coil voltage y and motor voltage [V].

        Parameters
        ----------
        efforts : sequence of 3 floats
            Of the joints, in the order of `gyrowheel_core.topics.JOINTS`.
        spin_rate : float
            Measured spin rate, whose voltage the motor must overcome [rad/s].
        """
        x, y, spin = efforts
        if self._voltage:
            return x, y, spin
        motor = self._motor * spin_rate + self._resistance * spin / self._motor
        return x / self._coil, y / self._coil, motor


def efforts_of(names: Sequence[str], values: Sequence[float]) -> tuple[float, float, float]:
    """Return the efforts in the order of their voltages from a message; other joints in it are left alone.

    Raises
    ------
    InputError
        If a joint is missing or named twice, or an effort is missing or no number.
    """
    if len(values) != len(names):
        raise InputError(f"effort: {len(values)} values for {len(names)} joints; allowed: one for each")
    found = dict(zip(names, values, strict=True))
    if missing := [joint for joint in JOINTS if joint not in found]:
        raise InputError(f"name: no joint {', '.join(missing)}; needed: {', '.join(JOINTS)}")
    if len(found) != len(names):
        raise InputError("name: a joint is named twice")
    for joint in JOINTS:
        if not math.isfinite(found[joint]):
            raise InputError(f"effort: {joint}: {found[joint]!r}; allowed: finite numbers")
    x, y, spin = (float(found[joint]) for joint in JOINTS)
    return x, y, spin
