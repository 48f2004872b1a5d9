"""What a simulated machine is, from what the user asks for."""

from __future__ import annotations

import pytest

from gyrowheel.simulation.scenario import scenario
from gyrowheel_air.surrogate import air_effects
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench

BENCH = Bench.load()


@pytest.mark.parametrize("model", ["correlation", "vorticity", "surrogate"])
def test_an_air_model_expands_to_its_effects(model: str) -> None:
    machine = scenario(BENCH, "quick", effects=[f"aero:{model}", "fixed_torque:F_x=0.001,F_y=0"], seed=1)
    expected = air_effects(model, bench=BENCH).values
    assert {name: machine.effects[name] for name in expected} == expected
    assert set(machine.effects) == {*expected, "fixed_torque"}
    assert expected, "every model says something"


def test_the_air_twice_or_of_an_unknown_model_is_refused() -> None:
    with pytest.raises(InputError, match="windage is given twice"):
        scenario(BENCH, "quick", effects=["aero:surrogate", "windage"], seed=1)
    with pytest.raises(InputError, match="'fluent' is not known; allowed: correlation"):
        scenario(BENCH, "quick", effects=["aero:fluent"], seed=1)


def test_a_torque_table_is_refused_as_the_air_of_a_machine() -> None:
    """The machine's air is a power law: it differs from the table's rows by what the fit leaves."""
    with pytest.raises(InputError, match=r"aero:table: the simulated air follows power laws.*aero:surrogate"):
        scenario(BENCH, "quick", effects=["aero:table"], seed=1)
    assert (
        scenario(BENCH, "quick", effects=["aero"], seed=1).effects
        == air_effects("surrogate", bench=BENCH).values
    )
