"""The balance of torques and voltages: rows predicted by the model for the measured motion, and measured rows.

No controller enters. For every window the torque that the measured motion needs is computed by exact inverse dynamics
at several instants and spin angles and averaged. The means over a revolution of the flexures, of the gimbal's inertia
and of rectified harmonics follow from that for every effect alike.

The universal joint makes the spin rate ripple. The ripple follows from the measured current far more accurately than
from a reading of the speed: over a revolution the motor's torque must be that of its current.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.history import History
from gyrowheel_analysis.balance.instruments import Instruments
from gyrowheel_analysis.balance.motion import Motion, mean, summed
from gyrowheel_analysis.balance.rows import measured_rows, predicted_rows
from gyrowheel_analysis.balance.torques import (
    AFTER,
    AT_REST,
    INSTRUMENT,
    OF_MOTION,
    TORQUES,
    ActiveEffect,
    Instants,
    Kinematics,
    Laws,
    Torques,
    bench_torques,
    depend_on_motor_temperature,
    depends_on_coil_voltage,
    difference,
    evaluated,
    kinematics,
    kinematics_key,
    law_torques,
    laws_on,
    pushed,
    replaced,
    required_torques,
    torques_along,
)
from gyrowheel_analysis.channels import GROUPS, in_groups, measurable
from gyrowheel_analysis.reduction.motor_temperature import MOTOR_THERMAL
from gyrowheel_analysis.reduction.windows import FORWARD, HARMONICS, Windows, without_noise
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.targets import INSTRUMENT_PARAMETERS, TORQUE_PARAMETERS, added

__all__ = ["ActiveEffect", "Balance", "Instants"]

Array = NDArray[np.float64]

#: Error of the ripple that is corrected to first order [rad/s]. The coils' response to a ripple depends on the inertia,
#: which is known to a part in a hundred at worst: the remaining error is some nN m.
_ACCURACY = 3.0e-5
_REPETITIONS = 4
_FIRST_REPETITIONS = 3
_STEP = 1e-3  # rad/s, of the derivatives by a part of the ripple
#: Places of the amplitudes of a ripple, a real quantity: each harmonic and its conjugate; see `HARMONICS`.
_PAIRS = tuple((HARMONICS.index(-order), HARMONICS.index(order)) for order in FORWARD)
_MIRRORS, _PLACES = (list(places) for places in zip(*_PAIRS, strict=True))
_PARTS = tuple((place, unit) for _, place in _PAIRS for unit in (1.0, 1j))


@dataclass(frozen=True)
class RippleResponse:
    """Response of coils and motor to a small change of the ripple, about one state of the motion.

    `inertia` is that about the spin axis [kg m²], `ripple` (n, harmonics, nodes) that of the state [rad/s]; `responses`
    are the derivatives of the torques of coils, two numbers each, and motor by each part of the ripple, next to each
    other (n, nodes, 3 phases) [N m s/rad]; `steps` (n, nodes, parts, parts) are the changes of the parts of the ripple
    that remove those of its error.
    """

    motion: Motion
    inertia: float
    ripple: Any
    responses: tuple[Any, ...]
    steps: Any

    @classmethod
    def about(
        cls, motion: Motion, inertia: float, wanted: Any, torques: Callable[[Any], Instants]
    ) -> RippleResponse:
        """Return the response about a state whose motor torque has the amplitudes `wanted` (n, harmonics, nodes).

        `torques` gives the state for a ripple; the other arguments are the attributes.
        """
        ripple = np.zeros_like(wanted)
        for _ in range(_FIRST_REPETITIONS):
            ripple = ripple + _error(motion, inertia, torques(ripple).motor, wanted)
        at = torques(ripple)
        responses = []
        for part in range(len(_PARTS)):
            moved = torques(ripple + _STEP * _amplitudes(np.eye(len(_PARTS))[part : part + 1]))
            coil = np.ascontiguousarray((moved.coil - at.coil) / _STEP)
            responses.append(np.concatenate([coil.view(float), (moved.motor - at.motor) / _STEP], axis=2))
        nothing = np.zeros_like(wanted)
        slopes = [
            _real_parts(-_error(motion, inertia, own[..., -motion.shape[2] :], nothing)) for own in responses
        ]
        return cls(motion, inertia, ripple, tuple(responses), np.linalg.inv(np.stack(slopes, axis=-1)))

    def solved(
        self,
        wanted: Any,
        torques: Callable[[Any], Instants],
        near: Instants | None = None,
    ) -> Instants:
        """Return the state whose motor torque has the amplitudes `wanted` (n, harmonics, nodes) [N m].

        `torques` gives the state for a ripple. The search begins at `ripple`, or at the state `near`: that is only the
        step of a derivative away, and its ripple suffices.
        """
        ripple = self.ripple if near is None else near.ripple
        for _ in range(_REPETITIONS):
            at = torques(ripple)
            parts = self._missing(at.motor, wanted)
            if near is not None or np.abs(parts).max(initial=0.0) < _ACCURACY:
                break
            ripple = ripple + _amplitudes(parts)
        return self.corrected(at, wanted)

    def corrected(self, at: Instants, wanted: Any) -> Instants:
        """Return a state with the ripple at which its motor torque has the amplitudes `wanted`, to first order."""
        parts = self._missing(at.motor, wanted)
        more: Any = 0.0
        for index, response in enumerate(self.responses):
            more = more + response * parts[:, :, index, None]
        coil = at.coil + more[..., : -self.motion.shape[2]].view(complex)
        motor = at.motor + more[..., -self.motion.shape[2] :]
        change = _amplitudes(parts)
        rate = at.rate + summed(change, self.motion.wave).real
        # a spin angle that passes quickly has a small share of the time
        weights = at.weights * at.rate / rate
        weights = weights / weights.sum(axis=(1, 2), keepdims=True)
        return replace(at, ripple=at.ripple + change, coil=coil, motor=motor, rate=rate, weights=weights)

    def _missing(self, motor: Any, wanted: Any) -> Any:
        """Return the change of the ripple, to first order, in the parts of `_real_parts`."""
        error = _real_parts(_error(self.motion, self.inertia, motor, wanted))
        return (self.steps @ error[..., None])[..., 0]


def _error(motion: Motion, inertia: float, motor: Any, wanted: Any) -> Any:
    """Return the ripple that the motor's lack of torque gives a free shaft."""
    left = wanted - motion.harmonics_of(motor)
    return left / (inertia * motion.orders[None, :, None] * motion.spin[:, None, :, 0])


def _real_parts(amplitudes: Any) -> Any:
    """Return real and imaginary parts of the amplitudes (n, harmonics, nodes) of a ripple: (n, nodes, parts)."""
    parts = [amplitudes[:, p].real if unit == 1.0 else amplitudes[:, p].imag for p, unit in _PARTS]
    return np.stack(parts, axis=-1)


def _amplitudes(parts: Any) -> Any:
    """Return the amplitudes (..., harmonics, nodes) of a ripple with these parts (..., nodes, parts)."""
    result = np.zeros((*parts.shape[:-2], len(HARMONICS), *parts.shape[-2:-1]), dtype=complex)
    # real and imaginary parts are next to each other, as in complex numbers
    values = np.swapaxes(np.ascontiguousarray(parts).view(complex), -1, -2)
    result[..., _PLACES, :], result[..., _MIRRORS, :] = values, np.conj(values)
    return result


#: Bench parameters that leave the motion unchanged: those that act as a torque, those that turn torques into readings,
#: the motor's heat, which acts at most through effects that depend on its temperature, and most of the instruments'.
_QUICK = {*TORQUE_PARAMETERS, "coil_constant", "motor_resistance", *MOTOR_THERMAL, *INSTRUMENT_PARAMETERS}
_EXACT_STEP = 1.0e-3  # of the reference tilt: step of a derivative by a parameter that is stated as exact


class Balance:
    """Predicted and measured rows of a set of windows.

    Rows are ordered by channel (`channels.in_groups`), each for every window.

    Parameters
    ----------
    windows : Windows
        The reduced recording(s).
    bench : Bench
        The model's bench; its coil and motor constants convert voltages and currents to N m.
    clean : bool
        Whether to predict from the motion without the harmonics and accelerations that are noise
        (`reduction.without_noise`); the torques that those need on the bench as stated are then subtracted from the
        measured rows.
    harmonics : bool
        Whether there are rows of harmonics within a revolution, or of the averages alone.
    absent : set of str
        Readings that were never taken; channels that compare them have no rows (`channels.measurable`).
    assumed : mapping of str to float
        Temperatures and pressure that were never taken: the static errors of their instruments are those of the assumed
        values, by the part that each has of them (`Motion`).
    phase_error : float
        Uncertainty of the angle from window to window [rad].
    history : History, optional
        The whole motion of the recording, for laws with a memory; without it what lies between the windows is taken as
        straight.

    Attributes
    ----------
    windows : Windows
        The windows from which it predicts.
    motion : Motion
        Their motion, instant by instant.
    rows : tuple of str
        Names of the rows, in their order.
    """

    def __init__(
        self,
        windows: Windows,
        bench: Bench,
        *,
        clean: bool = True,
        harmonics: bool = True,
        absent: Set[str] = frozenset(),
        assumed: Mapping[str, float] | None = None,
        phase_error: float = 0.0,
        history: History | None = None,
    ) -> None:
        self.bench = bench
        self.windows = without_noise(windows) if clean else windows
        self._uncleaned = windows if clean else None
        self.harmonics, self.absent, self.assumed = harmonics, frozenset(absent), dict(assumed or {})
        self.phase_error = phase_error
        every = in_groups(*(GROUPS if harmonics else ("average",)))
        self._channels = tuple(channel for channel in every if measurable(channel, absent))
        self.rows = tuple(row for channel in self._channels for row in measurable(channel, absent))
        self._kept = frozenset(self.rows)
        self.motion = Motion(self.windows, bench, self.assumed, history)
        self._response: RippleResponse | None = None
        #: The last kinematics, and what they follow from: most derivatives by the coefficients of a law share one.
        self._kinematics: tuple[Any, Kinematics] | None = None
        self._derivatives: dict[str, Array] = {}

    @cached_property
    def measured(self) -> Array:
        """The measured rows (N,) [N m, V]; never needed, and not computed, for a planned test."""
        rows = measured_rows(self.windows, self.bench, self._channels, self._kept)
        return self._without_noise(rows, self.bench.values(), [])

    def cleared(self, values: Mapping[str, float], effects: Sequence[ActiveEffect]) -> Balance:
        """Return the balance with the torques that noise in the motion needs, on a given machine, subtracted.

        The prediction leaves out harmonics and accelerations that do not exceed the noise. Some of them are real, and
        the torque that they need depends on the machine: its bench parameters `values` [SI] and its `effects`. Until
        these are known, the stated bench gives an estimate.
        """
        result = copy(self)
        result.measured = self._without_noise(self.measured, values, effects)
        return result

    def by_parameter(self, name: str) -> Array:
        """Return the derivative of the predicted rows (N,) by a parameter of the bench, with everything as stated."""
        if name not in self._derivatives:
            values = self.bench.values()
            step = self.bench.parameters[name].uncertainty or _EXACT_STEP * self.bench.value("tilt_reference")
            at = self.instants(values, [])
            moved = {**values, name: values[name] + step}
            there = self.rows_at(self.instants(moved, [], at), moved)
            self._derivatives[name] = (there - self.rows_at(at, values)) / step
        return self._derivatives[name]

    def with_measured(self, rows: Array) -> Balance:
        """Return the balance with other measured rows (N,)."""
        result = copy(self)
        result.measured = rows
        return result

    def _without_noise(
        self, rows: Array, values: Mapping[str, float], effects: Sequence[ActiveEffect]
    ) -> Array:
        """Return measured rows less the torques of noise in the motion, if the prediction leaves that out."""
        if self._uncleaned is None or not len(self.windows):
            return rows
        raw = Balance(
            self._uncleaned,
            self.bench,
            clean=False,
            harmonics=self.harmonics,
            absent=self.absent,
            assumed=self.assumed,
            history=self.motion.history,
        )
        return raw.measured - raw.predicted(values, effects) + self.predicted(values, effects)

    def __len__(self) -> int:
        """Return the number of rows, over all windows."""
        return len(self.rows) * len(self.windows)

    def row(self, name: str) -> slice:
        """Return where one row is, for all windows."""
        n, index = len(self.windows), self.rows.index(name)
        return slice(index * n, (index + 1) * n)

    def required(self, values: Mapping[str, float], effects: Sequence[ActiveEffect]) -> tuple[Any, Any]:
        """Return the mean torques that coils (complex, x + i y) and motor must give [N m], arrays (n,).

        Changes of the coils' gain are left out here, see `predicted`.
        """
        at = self.instants(values, effects)
        return mean(at.coil, at.weights), mean(at.motor, at.weights)

    def predicted(self, values: Mapping[str, float], effects: Sequence[ActiveEffect]) -> Array:
        """Return the predicted rows for bench parameters [SI] and effects.

        Returns
        -------
        ndarray (N,)
            The expected readings: voltages of the coils and current of the motor converted with the constants of the
            model's bench [N m], and the motor's voltage [V]; then the amplitudes.
        """
        return self.rows_at(self.instants(values, effects), values)

    def rows_at(self, at: Instants, values: Mapping[str, float]) -> Array:
        """Return the predicted rows of a state (see `predicted`)."""
        return predicted_rows(at, values, self.windows, self.bench, self._channels, self._kept)

    def motion_at(self, values: Mapping[str, float], effects: Sequence[ActiveEffect]) -> Motion:
        """Return the true motion for bench parameters and effects, without the errors of the instruments."""
        own: Laws = {}
        if any(laws_on(effects, INSTRUMENT)):
            known = self.motion.quantities_at(self.motion.spin, values) | AT_REST
            own = evaluated(effects, self.motion, known, INSTRUMENT)
        return self.motion.undone(Instruments.of(values, own))

    def instants(
        self,
        values: Mapping[str, float],
        effects: Sequence[ActiveEffect],
        near: Instants | None = None,
    ) -> Instants:
        """Return the state of the balance for bench parameters [SI] and effects.

        The search for the ripple of the spin rate begins at that of the first state: for a clean balance the bench as
        stated. `near` is a state from which this one is only the step of a derivative away.
        """
        if self._response is None:
            clean = self._uncleaned is not None
            first = self._needs(self.bench.values(), []) if clean else self._needs(values, effects)
            self._response = RippleResponse.about(first[0], self.bench.axial_inertia, *first[1:])
        motion, wanted, torques = self._needs(values, effects)
        if near is None:
            return self._response.solved(wanted, torques)

        def nearby(ripple: Any) -> Instants:
            return torques_along(self._known_kinematics(motion, values, effects, ripple), values, effects)

        return self._response.solved(wanted, nearby, near)

    def _known_kinematics(
        self, motion: Motion, values: Mapping[str, float], effects: Sequence[ActiveEffect], ripple: Any
    ) -> Kinematics:
        """Return the motion for a ripple, the last one where nothing differs that it follows from."""
        key = kinematics_key(values, effects)
        if self._kinematics is not None:
            known, last = self._kinematics
            if last.motion is motion and last.ripple is ripple and known == key:
                return last
        found = kinematics(motion, values, effects, ripple)
        self._kinematics = key, found
        return found

    def _needs(
        self, values: Mapping[str, float], effects: Sequence[ActiveEffect]
    ) -> tuple[Motion, Any, Callable[[Any], Instants]]:
        """Return the true motion, the amplitudes that the motor's torque must have, and a function for the torques."""
        motion = self.motion_at(values, effects)

        def torques(ripple: Any) -> Instants:
            return required_torques(motion, values, effects, ripple)

        return motion, values["motor_constant"] * motion.current, torques

    def changed(
        self,
        at: Instants,
        values: Mapping[str, float],
        effect: Effect,
        before: Mapping[str, float] | None,
        after: Mapping[str, float],
    ) -> Array | None:
        """Return the predicted rows of a state `at` in which one effect has other coefficients.

        The effect has the coefficients `before` in the state, None where it is absent, and `values` are the bench
        parameters of the state. Returns None if the effect changes the motion itself, so that the state must be
        computed again.
        """
        targets = {law.target for law in effect.laws}
        if targets & OF_MOTION or at.by_voltage or depends_on_coil_voltage(effect):
            return None
        new, old = (
            {}
            if given is None
            else evaluated(
                [ActiveEffect(effect, given)], at.motion, at.quantities, AFTER | INSTRUMENT, at.joint
            )
            for given in (after, before)
        )
        state = replace(at, laws=replaced(at.laws, new, old))
        if targets & INSTRUMENT:
            other = self._read_by(state, Instruments.of(values, state.laws), values)
            if other is None:
                return None
            state = other
        if targets & TORQUES:
            state = self._pushed(state, law_torques(difference(new, old), values))
        return self.rows_at(state, values)

    def pushed(self, at: Instants, values: Mapping[str, float], laws: Laws) -> Array:
        """Return the predicted rows of a state `at` with further torques: laws on targets that are torques."""
        return self.rows_at(self._pushed(at, law_torques(laws, values)), values)

    def moved(
        self,
        at: Instants,
        before: Mapping[str, float],
        after: Mapping[str, float],
        effects: Sequence[ActiveEffect],
    ) -> Array | None:
        """Return the predicted rows of a state `at` with `effects` for other bench parameters.

        The state has the bench parameters `before`, the result `after`: all of them by name [SI]. Returns None if the
        parameters change the motion itself, so that the state must be computed again.
        """
        by = {name: after[name] - value for name, value in before.items() if after[name] != value}
        if at.by_voltage or not by.keys() <= _QUICK:
            return None
        if by.keys() & set(INSTRUMENT_PARAMETERS):
            other = self._read_by(at, Instruments.of(after, at.laws), after)
            if other is None:
                return None
            at = other
        if by.keys() & set(MOTOR_THERMAL) and depend_on_motor_temperature(effects):
            return None
        if by.keys() & set(TORQUE_PARAMETERS):
            # torques are proportional to them, so their changes act like them
            changes = {
                name: by.get(name, 0.0) * added(at.laws, before, "relative", name, start=1.0)
                for name in TORQUE_PARAMETERS
            }
            at = self._pushed(at, bench_torques(changes, at.quantities["Omega"], at.joint))
        return self.rows_at(at, after)

    def _read_by(
        self, at: Instants, instruments: Instruments, values: Mapping[str, float]
    ) -> Instants | None:
        """Return a state with other instruments; None if the true motion then differs."""
        assert self._response is not None  # the state was found with it
        harmonics = bool(np.any(self.windows.tilt_harmonics))
        if at.motion.instruments.turns_motion(instruments, harmonics=harmonics):
            return None
        motion = at.motion.current_read_by(instruments)
        if motion.current is at.motion.current:
            return replace(at, motion=motion)
        wanted = self.motion.harmonics_of(at.motor) + values["motor_constant"] * (
            motion.current - at.motion.current
        )
        return self._response.corrected(replace(at, motion=motion), wanted)

    def _pushed(self, at: Instants, torques: Torques) -> Instants:
        """Return a state in which further torques act, with the ripple that belongs to them."""
        assert self._response is not None  # the state was found with it
        # the state's motor torque is settled: only the change needs another ripple
        return self._response.corrected(pushed(self.motion, at, torques), self.motion.harmonics_of(at.motor))
