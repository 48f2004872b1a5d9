"""The ripple of the spin rate that belongs to the measured motor current.

The universal joint makes the spin rate ripple. The ripple follows from the measured current far more accurately than
from a reading of the speed: over a revolution the motor's torque must be that of its current.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrowheel_analysis.balance.motion import Motion, summed
from gyrowheel_analysis.balance.torques import Instants
from gyrowheel_analysis.reduction.windows import FORWARD, HARMONICS

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
    """Response of coils and motor to a small change of the ripple, about one state.

    Attributes
    ----------
    motion : Motion
        The measured motion.
    inertia : float
        Moment of inertia about the spin axis [kg m²].
    ripple : complex ndarray (n, harmonics, nodes)
        Ripple of the state [rad/s].
    responses : tuple of (ndarray, ndarray)
        Derivatives of the torques of coils and motor by each part of the ripple [N m s/rad].
    steps : ndarray (n, nodes, parts, parts)
        Change of the parts of the ripple that removes those of its error.
    """

    motion: Motion
    inertia: float
    ripple: Any
    responses: tuple[tuple[Any, Any], ...]
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
            responses.append(((moved.coil - at.coil) / _STEP, (moved.motor - at.motor) / _STEP))
        nothing = np.zeros_like(wanted)
        slopes = [_real_parts(-_error(motion, inertia, motor, nothing)) for _, motor in responses]
        return cls(motion, inertia, ripple, tuple(responses), np.linalg.inv(np.stack(slopes, axis=-1)))

    def solved(
        self, wanted: Any, torques: Callable[[Any], Instants], near: Instants | None = None
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
        coil, motor = at.coil, at.motor
        for index, (coil_response, motor_response) in enumerate(self.responses):
            part = parts[:, :, index, None]
            coil = coil + coil_response * part
            motor = motor + motor_response * part
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
