"""The torque budget of holds: the torque of every part, the voltages, and the margins to saturation.

With a recording, the measured torques follow, and the part that the model does not explain.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.balance.parts import TorquePart, torque_parts
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.windows import Windows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HoldTorques:
    """Torques of holds, a row each (n,).

    Attributes
    ----------
    tilt : complex ndarray
        Tilt phi_x + i phi_y [rad].
    spin_rate : ndarray
        Spin rate [rad/s].
    parts : tuple of TorquePart
        Torque of coils and motor that every part of the machine requires [N m]; `predicted_coil` and `predicted_motor`
        less the errors of actuators and readings.
    predicted_coil, predicted_motor : ndarray
        Predicted readings of coils (complex, x + i y) and motor [N m by the model's constants].
    measured_coil, measured_motor : ndarray or None
        Measured readings; None without a recording.
    coil_voltage : complex ndarray
        Mean voltage of the coils [V]; by the model without a recording.
    motor_voltage : ndarray
        Mean voltage of the motor [V]; by the model without a recording.
    coil_margin, motor_margin, tilt_margin : ndarray
        Margin to the limit of the coils, of the supply and of the tilt, as a share of it.
    model : str
        Origin of the model: its file, or ``model``.
    recordings : tuple of str
        Paths of the recordings; empty if the holds were simulated.
    orbit : bool
        Whether they were simulated in orbit: without air, weight and the rate of the Earth.
    """

    tilt: Any
    spin_rate: Array
    parts: tuple[TorquePart, ...]
    predicted_coil: Any
    predicted_motor: Array
    measured_coil: Any | None
    measured_motor: Array | None
    coil_voltage: Any
    motor_voltage: Array
    coil_margin: Array
    motor_margin: Array
    tilt_margin: Array
    model: str = ""
    recordings: tuple[str, ...] = ()
    orbit: bool = False

    def __len__(self) -> int:
        """Return the number of holds."""
        return len(self.spin_rate)

    @property
    def coil(self) -> Any:
        """Torque of the coils, the sum of all parts [N m], complex (n,)."""
        return sum((part.coil for part in self.parts), np.zeros(len(self), dtype=complex))

    @property
    def motor(self) -> Any:
        """Torque of the motor, the sum of all parts [N m], (n,)."""
        return sum((part.motor for part in self.parts), np.zeros(len(self)))

    @property
    def remainder_coil(self) -> Any:
        """Measured less predicted torque of the coils [N m], complex (n,); None without a recording."""
        return None if self.measured_coil is None else self.measured_coil - self.predicted_coil

    @property
    def remainder_motor(self) -> Any:
        """Measured less predicted torque of the motor [N m], (n,); None without a recording."""
        return None if self.measured_motor is None else self.measured_motor - self.predicted_motor

    @classmethod
    def joined(cls, rows: Iterable[HoldTorques], **labels: Any) -> HoldTorques:
        """Return holds of one model one after the other, labelled with model, recordings and orbit."""
        every = list(rows)
        first = every[0]
        parts = tuple(
            TorquePart(
                part.name,
                part.effect,
                np.concatenate([own.parts[k].coil for own in every]),
                np.concatenate([own.parts[k].motor for own in every]),
            )
            for k, part in enumerate(first.parts)
        )
        fields: dict[str, Any] = {
            name: None if value is None else np.concatenate([getattr(own, name) for own in every])
            for name, value in vars(first).items()
            if name not in ("parts", "model", "recordings", "orbit")
        }
        return cls(parts=parts, **fields, **labels)


def hold_torques(windows: Windows, model: Model, *, measured: bool = True) -> HoldTorques:
    """Return the torques of the holds in some windows; windows in which tilt or speed change are left out.

    Parameters
    ----------
    windows : Windows
        Windows of recordings; those of one segment of a plan become one hold.
    model : Model
        The model.
    measured : bool
        Whether the readings count as measured; not where they were simulated by the model itself.
    """
    windows = windows.select(~windows.moving)
    bench = model.bench
    effects = [ActiveEffect(model.library[name], values) for name, values in model.effects.items()]
    balance = Balance(windows, bench, clean=False, harmonics=False)
    groups, shares = _holds(windows)

    def hold(values: Any) -> Any:
        return shares @ values if len(groups) else np.zeros(0)

    rows = balance.predicted(bench.values(), effects)

    def complex_row(content: Array) -> Any:
        return hold(content[balance.row("tilt_x")] + 1j * content[balance.row("tilt_y")])

    coil, motor = complex_row(rows), hold(rows[balance.row("spin")])
    volts = coil / bench.value("coil_constant")
    motor_volts = hold(rows[balance.row("motor_voltage")])
    if measured:
        volts, motor_volts = hold(windows.coil_voltage), hold(windows.motor_voltage)
    tilt = hold(windows.mean_tilt)
    return HoldTorques(
        tilt=tilt,
        spin_rate=hold(windows.mean_spin),
        parts=tuple(
            TorquePart(part.name, part.effect, hold(part.coil), hold(part.motor))
            for part in torque_parts(balance, bench.values(), effects)
        ),
        predicted_coil=coil,
        predicted_motor=motor,
        measured_coil=complex_row(balance.measured) if measured else None,
        measured_motor=hold(balance.measured[balance.row("spin")]) if measured else None,
        coil_voltage=volts,
        motor_voltage=motor_volts,
        coil_margin=1.0
        - np.maximum(np.abs(np.real(volts)), np.abs(np.imag(volts))) / bench.value("coil_voltage_limit"),
        motor_margin=1.0 - np.abs(motor_volts) / bench.value("supply_voltage"),
        tilt_margin=1.0 - np.abs(tilt) / bench.value("tilt_limit"),
    )


def _holds(windows: Windows) -> tuple[list[Array], Array]:
    """Return the places of the windows of each hold, and the weights (holds, windows) of its means over time."""
    groups: list[list[int]] = []
    for index, segment in enumerate(windows.segment):
        if groups and segment >= 0 and windows.segment[groups[-1][-1]] == segment:
            groups[-1].append(index)
        else:
            groups.append([index])
    shares = np.zeros((len(groups), len(windows)))
    for row, group in enumerate(groups):
        shares[row, group] = windows.duration[group] / windows.duration[group].sum()
    return [np.array(group) for group in groups], shares
