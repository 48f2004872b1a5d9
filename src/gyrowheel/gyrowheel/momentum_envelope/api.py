"""Which angular momentum a wheel can reach."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gyrowheel.catalogue.api import load_bench
from gyrowheel.models.api import Model
from gyrowheel.momentum_envelope.result import Momentum
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.mechanics.momentum import envelope

_MOST = 200  # spin rates


def momentum(
    bench: str | Path | Bench | Model = "gyrowheel", *, spin_rate: float | Sequence[float] | None = None
) -> Momentum:
    """Return the angular momentum that a wheel can reach: eqs (1) and (2), Figs 3 and 4 of Huo et al. 2016.

    Parameters
    ----------
    bench : str, Path, Bench or Model
        Shipped name, bench file, bench, or a model, of which the estimated inertias are used.
    spin_rate : float or sequence, optional
        Spin rates [rad/s]; the highest of the bench, its reference and one as far below if not given.

    Raises
    ------
    InputError
        If there is no such bench, or a spin rate is beyond its limits.
    """
    loaded = (
        bench.bench if isinstance(bench, Model) else bench if isinstance(bench, Bench) else load_bench(bench)
    )
    if spin_rate is None:
        return Momentum(envelope(loaded), loaded)
    rates = np.unique(np.atleast_1d(np.asarray(spin_rate, dtype=np.float64)))
    if not 1 <= rates.size <= _MOST:
        raise InputError(f"spin_rate: {rates.size} values are given; allowed: 1 .. {_MOST}")
    low, high = loaded.value("spin_rate_minimum"), loaded.value("spin_rate_maximum")
    for rate in rates:
        if not low * (1.0 - 1e-9) <= rate <= high * (1.0 + 1e-9):
            raise InputError(
                f"spin_rate: {rate / RPM:.6g} rpm is out of range; allowed: {low / RPM:.6g} .. {high / RPM:.6g} rpm"
            )
    return Momentum(envelope(loaded, rates), loaded)
