"""A model of the air in the model file: sizes and exponents fitted from what the computation says, proven elsewhere."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from gyrowheel_air.surrogate import air_effects
from gyrowheel_analysis.add import add_effect
from gyrowheel_analysis.model import Model
from gyrowheel_core.errors import InputError

from .machines import hidden_machine, record


@pytest.mark.slow
def test_the_air_of_the_table_is_fitted_within_its_uncertainties_and_proven(tmp_path: Path) -> None:
    table = air_effects("table")
    # a wheel whose air is not quite what was computed
    factor = {"aero_restoring": 0.8, "aero_cross": 1.3, "windage": 0.92}
    truth = {
        name: {key: value * (factor[name] if key in "kcw" else 1.0) for key, value in own.items()}
        for name, own in table.values.items()
    }
    machine = hidden_machine(31, truth)
    fit = record(tmp_path, "fit", machine, "quick")
    unused = record(tmp_path, "unused", machine, "check", noise_seed=32)
    model = Model.new()
    added = add_effect(model, ["aero:table"], [fit], [unused])
    assert set(added.model.effects) == set(truth)
    for name, own in truth.items():
        for key, value in own.items():
            found, stated = added.coefficients[name][key], table.errors[name][key]
            assert abs(found.value - value) < 4.0 * found.standard_error, (name, key)
            assert 0.0 < found.standard_error <= stated * (1.0 + 1e-9)
    # density and speed show the cross torque and the drag far better than the computation knows them
    assert added.coefficients["aero_cross"]["c"].standard_error < 0.2 * table.errors["aero_cross"]["c"]
    assert added.error.before.chi2_per_n > 5.0
    assert added.error.after.chi2_per_n < 1.5
    assert added.error.validation_before is not None
    assert added.error.validation_after is not None
    assert added.error.validation_before.chi2_per_n > 5.0
    assert math.sqrt(added.error.validation_after.chi2_per_n) < 1.25
    assert added.model.history[-1]["what"] == "add aero:table"
    assert added.model.undone().to_mapping() == model.to_mapping()
    added.model.save(tmp_path / "model.yaml")
    assert Model.load(tmp_path / "model.yaml").to_mapping() == added.model.to_mapping()
    with pytest.raises(InputError, match=r"effects\.aero_restoring: the model has it already"):
        add_effect(added.model, ["aero:vorticity"], [fit])


def test_invalid_models_of_the_air_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="effect: 'windage' is given twice: aero:table has it"):
        add_effect(Model.new(), ["aero:table", "windage"], [])
    with pytest.raises(InputError, match="'tabel'"):
        add_effect(Model.new(), ["aero:tabel"], [])
    with pytest.raises(InputError, match="no effect given"):
        add_effect(Model.new(), [], [])
