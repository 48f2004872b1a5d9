"""What is possible and what is usual, as a fit is held to it."""

from __future__ import annotations

import numpy as np
import pytest

from gyrowheel_analysis.diagnosis.limits import is_possible
from gyrowheel_analysis.fitting.fit import Fit, Term
from gyrowheel_sim.effects import registry


def fitted(name: str, errors: float, **values: float) -> tuple[Fit, Term]:
    """Return a fit of one effect with the standard error `errors` on every coefficient."""
    effect = registry()[name]
    own = {c.name: values.get(c.name, c.null) for c in effect.coefficients}
    none = np.zeros(0)
    return (
        Fit(
            terms=(Term(name, effect),),
            nuisance=none,
            coefficients={name: own},
            chi2=0.0,
            chi2_rows=0.0,
            covariance=errors**2 * np.eye(len(own)),
            columns=[(name, key) for key in own],
            residual=none,
            pull=none,
            jacobian=np.zeros((0, len(own))),
        ),
        Term(name, effect),
    )


@pytest.mark.parametrize(
    ("name", "error", "values", "possible"),
    [
        ("earth_rate", 1e-6, {"E_x": 5e-5}, True),
        ("earth_rate", 1e-6, {"E_x": 5.4e-4}, False),
        # each component is one that the Earth can have, both together are not
        ("earth_rate", 1e-6, {"E_x": 6.5e-5, "E_y": 6.5e-5}, False),
        ("earth_rate", 3e-5, {"E_x": 6.5e-5, "E_y": 6.5e-5}, True),
        ("external_damping", 1e-4, {"D": 5e-3}, True),
        ("external_damping", 1e-4, {"D": -7.5e-3}, False),
        ("external_damping", 5e-3, {"D": -7.5e-3}, True),
        ("windage", 1e-5, {"w": -1e-3}, False),
        ("windage_tilt", 1e-5, {"w": -1e-3}, True),
        # driven to the end of the range that is searched
        ("supply_sag", 0.1, {"R_s": 5.0}, False),
    ],
)
def test_an_effect_is_possible_within_its_error(
    name: str, error: float, values: dict[str, float], possible: bool
) -> None:
    assert is_possible(*fitted(name, error, **values)) is possible
