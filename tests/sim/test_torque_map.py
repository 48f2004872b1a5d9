"""The map of a torque: one definition for arrays and for the compiled plant, and its place in a model file."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects import effect_from_mapping, effect_to_mapping
from gyrowheel_sim.effects.complex_parts import COMPONENTS, split
from gyrowheel_sim.effects.law_code import array_law
from gyrowheel_sim.effects.quantities import Omega, T_coil, T_motor, z
from gyrowheel_sim.effects.torque_map import MapRange, MapTerm, TorqueMap, torque_map

WITHIN = MapRange((150.0, 400.0), 0.07, (293.0, 303.0), (293.0, 310.0))
TERMS = (
    MapTerm("rotor_torque", 1, 0, 0, 0),
    MapTerm("rotor_torque", 0, 2, 1, 3),
    MapTerm("rotor_torque", 2, 1, 0, 1, 1),
    MapTerm("shaft_torque", 0, 0, 0, 2),
    MapTerm("shaft_torque", 2, 1, 0, 1),
)


@pytest.fixture(scope="module")
def made() -> TorqueMap:
    count = sum(len(term.names) for term in TERMS)
    modes = np.random.default_rng(1).normal(0.0, 1e-5, (3, count))
    return torque_map("map", TERMS, WITHIN, modes=modes.tolist(), recordings=("monday",))


def values_of(made: TorqueMap) -> dict[str, float]:
    drawn = np.random.default_rng(2).normal(0.0, 1e-3, len(made.coefficients))
    return {c.name: float(value) for c, value in zip(made.coefficients, drawn, strict=True)}


def at(tilt: complex, speed: float, warmer: float = 0.0) -> dict[str, object]:
    return {"z": np.array(tilt), "Omega": speed, "T_coil": 296.0 + warmer, "T_motor": 299.0 + warmer}


def test_compiled_law_and_array_law_agree(made: TorqueMap) -> None:
    values = values_of(made)
    numbers = {sp.Symbol(name, real=True): value for name, value in values.items()}
    for index, law in enumerate(made.laws):
        symbols = [*COMPONENTS[z], Omega, T_coil, T_motor]
        compiled = sp.lambdify(symbols, [part.subs(numbers) for part in split(law.expression)], "math")
        for tilt, speed in ((0.03 - 0.02j, 200.0), (0.0j, 300.0), (-0.08 + 0.05j, 500.0)):
            x, y = compiled(tilt.real, tilt.imag, speed, 296.0, 299.0)
            array = complex(array_law(made, index)({**at(tilt, speed), **values}))
            assert complex(x, y) == pytest.approx(array, rel=1e-9, abs=1e-15)


def test_beyond_its_range_it_keeps_the_torque_at_the_edge(made: TorqueMap) -> None:
    values = values_of(made)
    law = array_law(made, 0)
    inside = law({**at(0.07j, 400.0), **values})
    assert law({**at(0.11j, 700.0), **values}) == pytest.approx(inside)


def test_declaration_reads_back(made: TorqueMap) -> None:
    again = effect_from_mapping("map", effect_to_mapping(made))
    assert isinstance(again, TorqueMap)
    assert again == made
    assert np.array(again.modes) == pytest.approx(np.array(made.modes), rel=1e-2)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("speed", [400.0, 150.0], "map.speed: .* is no range"),
        ("tilt", -1.0, "map.tilt: -1.0 is out of range"),
        ("terms", {"rotor_torque": [[1, 0, 0, 99, 0]]}, "is out of range"),
        ("terms", {"rotor_torque": []}, "map.terms: empty"),
        ("terms", {"case_rate": [[1, 0, 0, 0, 0]]}, "case_rate"),
        ("modes", ["1e-5 2e-5"], "map.modes.0: 2 numbers; allowed: 9"),
        ("modes", ["one two"], "not a number"),
        ("curve", 1, "no such field"),
    ],
)
def test_wrong_field_of_a_declaration_is_refused_by_name(
    made: TorqueMap, field: str, value: object, message: str
) -> None:
    mapping = effect_to_mapping(made)
    mapping["map"][field] = value
    with pytest.raises(InputError, match=message):
        effect_from_mapping("map", mapping, "wheel.yaml: effects.map.declaration")
