"""Means over a window: three Gauss nodes in time, equally spaced spin angles, harmonics between the two."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Nodes in x, the time from the middle of a window over half its duration, and their weights.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(3)
_ENDS = np.polynomial.polynomial.polyvander([1.0, -1.0], 2) @ np.linalg.inv(
    np.polynomial.polynomial.polyvander(NODES, 2)
)
#: Difference between the ends of a window of what is known at the nodes.
ACROSS = _ENDS[0] - _ENDS[1]


def at_nodes(polynomial: Any, half: Any, derivative: int = 0) -> Any:
    """Return polynomials in x, or a time derivative of them, at the nodes.

    Parameters
    ----------
    polynomial : ndarray (n, ..., terms)
        Coefficients over the last axis.
    half : ndarray (n, 1)
        Half the duration of each window [s].
    derivative : int
        Order of the derivative.

    Returns
    -------
    ndarray (n, ..., nodes)
    """
    order = np.arange(polynomial.shape[-1])
    factor = np.ones(polynomial.shape[-1])
    for d in range(derivative):
        factor = factor * (order - d)
    powers = factor[:, None] * NODES ** np.maximum(order - derivative, 0)[:, None]
    return polynomial @ powers / (half if polynomial.ndim == 2 else half[:, :, None]) ** derivative


def summed(amplitudes: Any, wave: Any) -> Any:
    """Return the sum (n, nodes, phases) of waves (harmonics, phases) with amplitudes (n, harmonics, nodes)."""
    return np.swapaxes(amplitudes, 1, 2) @ wave


def mean(values: Any, weights: Any) -> Any:
    """Return the sum (n,) of values times weights of their own, both (n, nodes, phases)."""
    return (values * weights).sum(axis=(1, 2))


def amplitude(values: Any, weights: Any) -> Any:
    """Return the sum (n,) of values (n, nodes, phases), or what broadcasts to it, times weights (nodes, phases)."""
    if np.ndim(values) == 0:
        return values * weights.sum() if values else 0.0
    nodes, phases = weights.shape
    values = np.broadcast_to(values, (len(values), nodes, phases))
    return values.reshape(len(values), nodes * phases) @ weights.reshape(-1)
