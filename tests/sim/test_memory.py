"""Laws with a memory: how they are typed, what is refused, and what the plant makes of them."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
import sympy as sp

from gyrowheel.show.formulas import plain, pretty, typeset
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect, effect_from_mapping, effect_to_mapping
from gyrowheel_sim.effects.declaration import Coefficient, Law, LawState
from gyrowheel_sim.effects.quantities import z
from gyrowheel_sim.effects.user_defined_line import effect_to_line, typed_effect
from gyrowheel_sim.plant.export import python_module
from gyrowheel_sim.plant.scenario import Scenario

BENCH = Bench.load()
LAG = "-k*s; d(s)/dt = (z - s)/tau; s(0) = z; tau = 5 +- 3 [s]"
CABLE = "-F*s; d(s)/dt = (z_rate - s*abs(z_rate))/b; b = 0.03 +- 0.01 [rad]"
COILS = "coil_gain = -a*s; s' = (T_coil - T_air - s)/tau; tau = 20 +- 15 [s]"
FLEXURE = "flexure_torque = -F*s; d(s)/dt = (theta_rate - s*abs(theta_rate))/b; b = 0.03 +- 0.01 [rad]"
LARGEST = "k*m/z_ref*z; d(m)/dt = max(0, abs(z) - m)/t_m; t_m = 0.05 +- 0.02 [s]"
RUN_IN = "shaft_torque = -f*s; d(s)/dt = -s*r/tau; s(0) = 1; s [1]; tau = 30 +- 15 [s]"
OFFSET = "-k*s; d(s)/dt = (z - s)/tau; s(0) = a; tau = 5 +- 3 [s]; a = 0 +- 0.01 [rad]"
TWO = "-k*q; d(s)/dt = (z - s)/tau; d(q)/dt = (s - q)/tau; tau = 2 +- 1 [s]"


def own(text: str) -> Effect:
    return typed_effect(text, name="own")


@pytest.mark.parametrize(
    ("text", "states"),
    [
        (LAG, {"s": ("rad", True)}),
        (CABLE, {"s": ("1", True)}),
        (COILS, {"s": ("K", False)}),
        (FLEXURE, {"s": ("1", False)}),
        (LARGEST, {"m": ("rad", False)}),
        (RUN_IN, {"s": ("1", False)}),
        (TWO, {"s": ("rad", True), "q": ("rad", True)}),
    ],
)
def test_unit_and_kind_of_a_state_follow_from_its_rate(
    text: str, states: dict[str, tuple[str, bool]]
) -> None:
    assert {s.name: (s.unit, s.complex) for s in own(text).states} == states


@pytest.mark.parametrize("text", [LAG, CABLE, COILS, FLEXURE, LARGEST, RUN_IN, OFFSET, TWO])
def test_a_law_with_a_memory_is_read_back_as_it_is_written(text: str) -> None:
    effect = own(text)
    assert effect_from_mapping("own", effect_to_mapping(effect)) == effect
    shapes = "".join(f"; {c.name} = {c.shape} +- {c.shape_uncertainty} [{c.unit}]" for c in effect.shapes)
    units = "".join(f"; {s.name} [{s.unit}]" for s in effect.states)
    for line in (effect_to_line(effect), plain(pretty(effect.formula)) + shapes + units):
        again = own(line)
        assert (again.laws, again.states) == (effect.laws, effect.states)
    assert "<mfrac>" in typeset(effect.formula)


def test_a_start_value_may_be_fitted() -> None:
    assert [c.name for c in own(OFFSET).shapes] == ["tau", "a"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("-k*s; d(s)/dt = (z - zz)/tau; tau = 5 +- 3 [s]", "own.states.s.rate: column 6: 'zz' is neither"),
        (
            "-k*s; d(s)/dt = (z - s)/tau; s(0) = s; tau = 5 +- 3 [s]",
            "own.states.s.start: column 1: 's' is neither",
        ),
        ("-k*z; d(s)/dt = (z - s)/tau; tau = 5 +- 3 [s]", "own.states.s: not used in any law"),
        ("-k*s; d(s)/dt = (z - s)/tau; d(q)/dt = s - q/tau; q [m]; tau = 5 +- 3 [s]", "rad"),
        ("-k*s; d(s)/dt = (z - s)/tau; tau = 5 +- 3 [m]", "rad/s is needed"),
        ("-k*s; d(s)/dt = (z - s)/tau; s(0) = t; tau = 5 +- 3 [s]", "rad is needed"),
        ("-k*s; d(s)/dt = -s/tau; tau = 5 +- 3 [s]", "own.states.s.unit: missing"),
        ("-k*s; s(0) = z", "s(0) has no rate"),
        ("-k*s; d(s)/dt = (z - s)/tau; s = 1 [rad]; tau = 5 +- 3 [s]", "s(0) = 1"),
        ("-k*s; d(s)/dt = z/tau; d(s)/dt = z/tau; tau = 5 +- 3 [s]", "given twice"),
        ("-k*s; d(s)/dt = c*z; c [1/s]; s [rad]", "own.coefficients.c"),
        ("-k*s; d(s)/dt = (z - s)/tau; tau = 1e-4 +- 1e-5 [s]", "within a sample"),
        ("-k*s; d(s)/dt = (s + z)/tau; tau = 0.5 +- 0.1 [s]", "grows without limit"),
        ("-k*s; d(s)/dt = z/(1 s); s [rad]", "column 6"),
        ("-k*s; d(s)/dt = z/t; s [rad]", "is not finite at rest"),
        ("-k*s; d(s)/dt = (theta - s)/tau; tau = 5 +- 3 [s]", "only flexure_torque"),
        ("coil_gain = k*s; d(s)/dt = (z - s)/tau; tau = 5 +- 3 [s]", "coil_gain is real"),
        ("tilt_delay = k*s; d(s)/dt = (abs(z) - s)/tau; tau = 5 +- 3 [s]", "cannot depend on a state"),
        ("flexure_torque = -k*s; -c*s; d(s)/dt = (theta - s)/tau; tau = 5 +- 3 [s]", "neither a law"),
        (
            "flexure_torque = -k*s; torque = -c*z; d(s)/dt = (theta - s)/tau; tau = 5 +- 3 [s]",
            "declare the other law as another effect",
        ),
        (
            "flexure_torque = -k*abs(s); d(s)/dt = (z - s)/tau; tau = 5 +- 3 [s]",
            "the state of a flexure is real",
        ),
        ("-k*Omega*z; d(Omega)/dt = r/tau; tau = 5 +- 3 [s]", "the name Omega is taken"),
        ("-s_x*s; d(s)/dt = (z - s)/tau; s_x [N*m/rad]; tau = 5 +- 3 [s]", "the name s_x is taken"),
    ],
)
def test_what_cannot_be_integrated_is_refused_in_one_line(text: str, words: str) -> None:
    with pytest.raises(InputError) as error:
        own(text)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("states", "words"),
    [
        ("s", "mapping"),
        ({"s": {"unit": "rad"}}, "rate"),
        ({"s": {"rate": "(z - s)/tau", "unit": "mrad"}}, "unit"),
        ({"s": {"rate": 3}}, "a text is expected"),
        ({"s x": {"rate": "z"}}, "no name of a state"),
        ({f"s{k}": {"rate": "z"} for k in range(5)}, "up to 4"),
    ],
)
def test_a_wrong_declaration_names_its_field(states: Any, words: str) -> None:
    mapping = {
        "torque": "-k*s",
        "states": states,
        "coefficients": {"k": "N*m/rad", "tau": {"unit": "s", "value": 5, "uncertainty": 3}},
    }
    with pytest.raises(InputError, match=words) as error:
        effect_from_mapping("own", mapping, "effects.own.declaration")
    assert str(error.value).startswith("effects.own.declaration")


K = Coefficient("k", "N*m/rad", "", (0.01, 0.02), (-1.0, 1.0), "")
REAL, COMPLEX, OTHER = sp.Symbol("s", real=True), sp.Symbol("s", complex=True), sp.Symbol("k_x", real=True)


@pytest.mark.parametrize(
    ("laws", "state", "words"),
    [
        ({"rotor_torque": REAL}, LawState("k", "rad", REAL), "k, which is taken"),
        ({"rotor_torque": REAL}, LawState("s", "rad", OTHER), "unknown symbols"),
        ({"rotor_torque": REAL}, LawState("s", "rad", z - REAL), "rate or start is complex"),
        (
            {"flexure_torque": sp.Abs(COMPLEX)},
            LawState("s", "rad", z - COMPLEX, complex=True),
            "flexure is real",
        ),
        ({"flexure_torque": REAL, "shaft_torque": REAL}, LawState("s", "rad", -REAL), "cannot share a state"),
    ],
)
def test_a_declaration_in_python_that_contradicts_itself_is_refused(
    laws: dict[str, sp.Expr], state: LawState, words: str
) -> None:
    declared = tuple(Law(target, K.symbol * expression) for target, expression in laws.items())
    with pytest.raises(ValueError, match=words):
        Effect("own", "", "other", "", declared, (K,), "", "", states=(state,))


def wheel(*effects: Effect, **values: float) -> Any:
    """Return a machine with effects, as the exported module has it: the source that the plant compiles, uncompiled."""
    given = {e.name: e.defaults() | {k: v for k, v in values.items() if k in e.defaults()} for e in effects}
    scenario = Scenario({}, given, 0, {e.name: e for e in effects})
    space: dict[str, Any] = {}
    exec(compile(python_module(BENCH, scenario), "<wheel>", "exec"), space)
    return space["Wheel"](spin_rate=300.0), space["LAW_MEMORY"]


def test_the_plant_integrates_a_state_from_its_start_value() -> None:
    effect = own("shaft_torque = -f*s; d(s)/dt = (b - s)/tau; s(0) = a; s [1]; f = 1e-9 [N*m]; tau = 0.1 +- 0.05 [s]; "
                 "a = 3 +- 1 [1]; b = 1 +- 0.5 [1]")  # fmt: skip
    machine, place = wheel(effect)
    assert machine.state[place] == 3.0
    for _ in range(400):
        machine.step(0.0, 0.0, 9.0)
    assert machine.state[place] == pytest.approx(1.0 + 2.0 * math.exp(-2.0), rel=1e-5)


def test_each_flexure_has_its_own_state_in_the_plant() -> None:
    """Against an integration by hand along the motion that the plant had."""
    machine, place = wheel(own(FLEXURE), F=1e-4, b=0.002)
    states = [machine.state[:6].copy()]
    for step in range(300):
        machine.step(0.3 * math.cos(0.02 * step), 0.2, 9.0)
        states.append(machine.state[:6].copy())
    motion = np.array(states)
    turn = motion[:, 4]
    across = (motion[:, 0] + 1j * motion[:, 1]) * np.exp(-1j * turn)  # the spin axis in motor axes
    theta = np.arcsin(-across.imag / np.sqrt(1.0 - across.real**2)), np.arcsin(across.real)
    for side in (0, 1):
        rate, s = np.gradient(theta[side], 5e-4), 0.0
        assert np.abs(theta[side]).max() > 5e-4
        for before, after in itertools.pairwise(rate):
            middle = 0.5 * (before + after)
            first = (middle - s * abs(middle)) / 0.002
            s += 5e-4 * (middle - (s + 2.5e-4 * first) * abs(middle)) / 0.002
        assert abs(s) > 0.1
        assert machine.state[place + side] == pytest.approx(s, abs=0.02)


def test_a_law_feels_its_state() -> None:
    """A torque that remembers the first tilt for ever is a spring about it."""
    plain_machine, _ = wheel(own("-k*z; k = 0.02 [N*m/rad]"))
    lagging, _ = wheel(
        own("-k*s; d(s)/dt = (z - s)/tau; tau = 0.002 +- 0.001 [s]; k = 0.02 [N*m/rad]"), k=0.02
    )
    frozen, _ = wheel(own("-k*s; d(s)/dt = (z - s)/tau; tau = 1e6 +- 1 [s]; k = 0.02 [N*m/rad]"), k=0.02)
    tilts = []
    for machine in (plain_machine, lagging, frozen):
        for _ in range(300):
            machine.step(0.3, 0.0, 9.0)
        tilts.append(complex(machine.reading["tilt_x"], machine.reading["tilt_y"]))
    assert abs(tilts[1] - tilts[0]) < 0.2 * abs(tilts[2] - tilts[0])
