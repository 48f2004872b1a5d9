"""The torque budget: the torque of coils and motor that each part of the bench and each effect requires.

At a given motion the required torques are linear in all parts: each flexure, each inertia, each law adds its share. The
shares therefore sum to the whole, in any order; the response of the motion to a part (a ripple of tilt or spin rate) is
part of the motion, and its torque belongs to the part that resists it. Of holds there are also the voltages and the
margins to saturation and, with a recording, the measured torques and the part that the model does not explain.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.balance.motion import mean
from gyrowheel_analysis.balance.torques import READING, Instants, required_torques
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_sim.effects.targets import INERTIAS, TORQUE_PARAMETERS

Array = NDArray[np.float64]

#: Parts of the bench: the parameters to which the torque is proportional. A tilted universal joint makes rotor and
#: shaft ripple twice a revolution against each other: in a hold their inertias need no other torque, so it is one part.
BENCH_PARTS: dict[str, tuple[str, ...]] = {
    "flexure_stiffness": ("flexure_stiffness_x", "flexure_stiffness_y"),
    "gimbal_inertia": ("gimbal_inertia_x", "gimbal_inertia_y", "gimbal_inertia_z"),
    "joint_ripple": ("shaft_inertia", "rotor_inertia_x", "rotor_inertia_y", "rotor_inertia_z"),
    "flexure_damping": ("flexure_damping_x", "flexure_damping_y"),
    "bearing": ("bearing_coulomb", "bearing_viscous"),
    "fixed_torque": ("fixed_torque_x", "fixed_torque_y"),
}


@dataclass(frozen=True)
class TorquePart:
    """Torque of coils and motor that one part of the machine requires, window by window.

    Attributes
    ----------
    name : str
        Part of the bench (`BENCH_PARTS`), or name of an effect.
    effect : bool
        Whether it is an effect.
    coil : complex ndarray (n,)
        Mean torque that the coils give for it, x + i y in case axes [N m].
    motor : ndarray (n,)
        Mean torque that the motor gives for it [N m].
    """

    name: str
    effect: bool
    coil: Any
    motor: Any


def torque_parts(
    balance: Balance, values: Mapping[str, float], effects: Sequence[ActiveEffect]
) -> list[TorquePart]:
    """Return the required torques part by part: the parts of the bench, then the effects.

    They sum to `Balance.required`; `values` are the bench parameters by name [SI].
    """
    whole = balance.instants(values, effects)
    reading = _readings(effects)
    acting = {*INERTIAS, *TORQUE_PARAMETERS}

    def at(kept: Sequence[str]) -> Instants:
        only = {name: value if name in kept or name not in acting else 0.0 for name, value in values.items()}
        return required_torques(whole.motion, only, reading, whole.ripple)

    nothing = at(())
    parts = [
        _part(name, at(parameters), nothing, whole, effect=False) for name, parameters in BENCH_PARTS.items()
    ]
    return [*parts, *effect_parts(balance, values, effects, whole, [e.effect.name for e in effects])]


def effect_parts(
    balance: Balance,
    values: Mapping[str, float],
    effects: Sequence[ActiveEffect],
    whole: Instants,
    names: Collection[str],
) -> list[TorquePart]:
    """Return the shares of the effects `names` in the required torques of a state `whole` with all effects."""
    if not names:
        return []
    # a law may also act through a part of the bench: a turning case through the inertias, a softening flexure
    reading = _readings(effects)
    bench = required_torques(whole.motion, values, reading, whole.ripple)
    return [
        _part(
            active.effect.name,
            required_torques(whole.motion, values, [*reading, _only(active, reading=False)], whole.ripple),
            bench,
            whole,
            effect=True,
        )
        for active in effects
        if active.effect.name in names
    ]


def _readings(effects: Sequence[ActiveEffect]) -> list[ActiveEffect]:
    """Return the errors of readings: they cause no torque, but the true motion follows only with them."""
    return [_only(active, reading=True) for active in effects]


def _part(name: str, state: Instants, less: Instants, whole: Instants, *, effect: bool) -> TorquePart:
    coil, motor = state.coil - less.coil, state.motor - less.motor
    return TorquePart(name, effect, mean(coil, whole.weights), mean(motor, whole.weights))


def _only(active: ActiveEffect, *, reading: bool) -> ActiveEffect:
    """Return an effect with only those of its laws that change a reading, or with all others."""
    laws = tuple(law for law in active.effect.laws if (law.target in READING) == reading)
    return replace(active, effect=replace(active.effect, laws=laws))


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

    Windows of recordings in one segment of a plan form one hold. The readings are `measured` unless the model itself
    simulated them.
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
    """Return the windows of each hold, and the weights (holds, windows) of its means over time."""
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
