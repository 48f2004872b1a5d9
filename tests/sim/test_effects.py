"""Every registered effect: declaration, compiled law, symmetries."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrowheel_analysis.fitting.fit import ERRORS
from gyrowheel_control.loops.controller import loop_code
from gyrowheel_core.units import unit_registry
from gyrowheel_sim.effects import Effect, registry
from gyrowheel_sim.effects.law_code import (
    FUNCTIONS,
    Instant,
    array_law,
    coefficient_arrays,
    memory_layout,
    memory_size,
)
from gyrowheel_sim.effects.quantities import REFERENCES, Omega
from gyrowheel_sim.effects.targets import TARGETS
from gyrowheel_sim.environment import RIGS, Environment
from gyrowheel_sim.instruments import N_NOISE
from gyrowheel_sim.plant.compiled import N_STATE, Further, State, Surroundings
from gyrowheel_sim.plant.machine import Machine, simulated_effects
from gyrowheel_sim.plant.scenario import THREE_LOBED, Scenario

from .helpers import BENCH, QUIET

REGISTERED = list(registry().values())
EACH = pytest.mark.parametrize("effect", REGISTERED, ids=lambda effect: effect.name)
EACH_SIMULATED = pytest.mark.parametrize("effect", simulated_effects(), ids=lambda effect: effect.name)
THOROUGH = settings(deadline=None, max_examples=20)


# --- declarations --------------------------------------------------------------------------------------------


@EACH
def test_declaration_is_complete(effect):
    for text in (effect.title, effect.sentence, effect.validity, effect.source):
        assert text.strip()
    assert effect.sentence.endswith(".")
    assert effect.laws
    assert effect.amplitudes, "an effect without an amplitude cannot be absent"
    assert registry()[effect.name] is effect


@EACH
def test_coefficients_have_valid_ranges(effect):
    for c in effect.coefficients:
        unit_registry().parse_units(c.unit)
        assert c.description.strip()
        assert c.source.strip()
        low, high = c.usual
        assert 0.0 < low < high
        assert c.bounds[0] <= low
        assert high <= c.bounds[1]
        assert c.bounds[0] <= c.null <= c.bounds[1]
        assert low <= c.default <= high
        if c.signed:
            assert c.bounds[0] <= -high
        # what is usual is possible, and a limit has its reason
        assert c.physical[0] <= (-high if c.signed else low)
        assert high <= c.physical[1]
        assert c.why_possible.strip() or c.physical == (-math.inf, math.inf)
        if c.shape is None:
            assert c.null == 0.0
        else:
            assert c.shape_uncertainty > 0.0


def test_earth_rate_is_bounded_by_its_true_rate():
    earth = registry()["earth_rate"]
    assert earth.greatest is not None
    per_hour = math.degrees(1.0) * 3600.0
    assert earth.greatest * per_hour == pytest.approx(15.04, abs=0.01)
    assert all(c.physical == (-earth.greatest, earth.greatest) for c in earth.amplitudes)


@EACH
def test_dissipative_coefficients_cannot_be_negative(effect):
    for c in effect.amplitudes:
        if not c.signed:
            assert c.physical[0] == 0.0


@EACH
def test_look_alikes_are_known_and_come_with_a_test(effect):
    for name, test in effect.look_alikes.items():
        assert name in registry() or name in ERRORS
        assert name != effect.name
        assert test.strip()


@EACH
def test_formula_shows_every_law_and_coefficient(effect):
    assert all(law.target in effect.formula for law in effect.laws)
    assert all(c.name in effect.formula for c in effect.coefficients)
    assert "\n" not in effect.formula
    assert "**" not in effect.formula


# --- compiled laws -------------------------------------------------------------------------------------------


def surroundings(rig: str = "upright", table_rate: float = 0.0, turn: complex = 1.0) -> np.ndarray:
    """Return the environment as the compiled code takes it (`Surroundings`), everything across the axis turned."""
    environment = Environment(rig=rig)
    across = [v * turn for v in (environment.up_across, *environment.home)]
    parts = [part for v in across for part in (v.real, v.imag)]
    return np.array([environment.up, *parts, 1e5, 0.0, table_rate])


class Law:
    """The compiled laws of one effect, by names."""

    def __init__(self, effect: Effect, values: Mapping[str, float]) -> None:
        self.arrays = coefficient_arrays(simulated_effects(), {effect.name: dict(values)}, BENCH)

    def __call__(self, q: Mapping[str, Any]) -> dict[str, complex]:
        around = surroundings(q["rig"])
        given = dict(q)
        for name in ("z", "z_rate"):
            given[name.replace("z", "zx")] = complex(q[name]).real
            given[name.replace("z", "zy")] = complex(q[name]).imag
        given |= {"Vx": q["V_coil"].real, "Vy": q["V_coil"].imag}
        given |= {place.name: around[place] for place in Surroundings}
        instant = Instant(*(given[name] for name in Instant._fields))
        outputs: dict[str, complex] = {}
        for function in compiled_laws():
            outputs |= function(*self.arrays, remembering_state(), instant)._asdict()
        return outputs


def remembering_state() -> np.ndarray:
    """Return a state of the plant in which the states of laws are numbers between 0 and 1."""
    state = np.zeros(N_STATE + memory_size(simulated_effects()))
    memory = state[N_STATE:]
    memory[:] = 0.3 + 0.6 * np.arange(len(memory)) / len(memory)
    return state


def remembered(effect: Effect) -> dict[str, complex]:
    """Return the states of a law in it by name."""
    places, memory = memory_layout(simulated_effects()), remembering_state()[N_STATE:]
    return {
        s.name: complex(*memory[list(places[effect.name, s.name])])
        if s.complex
        else memory[places[effect.name, s.name][0]]
        for s in effect.states
    }


@functools.cache
def compiled_laws() -> Any:
    return [numba.njit(getattr(loop_code(), name), error_model="numpy") for name in FUNCTIONS]


#: Which outputs of the compiled laws belong to a target.
BY_TARGET = {target.name: target.outputs for target in TARGETS.values()}
COMPLEX = [target.name for target in TARGETS.values() if target.complex]


def combined(outputs: Mapping[str, complex], target: str) -> complex:
    """Return an output as one number; of the two flexures the one about x."""
    names = BY_TARGET[target]
    return complex(outputs[names[0]], outputs[names[1]]) if target in COMPLEX else outputs[names[0]]


def declared(
    effect: Effect, values: Mapping[str, float], q: Mapping[str, Any], target: str, axis: float = 1.0
) -> complex:
    """Return the same from the declaration, by the array law that the analysis uses."""
    references = {name: BENCH.value(parameter) for name, parameter in REFERENCES.items()}
    environment = Environment(rig=q["rig"])
    turn = q.get("turn", 1.0)
    around = {
        "up": environment.up,
        "up_across": environment.up_across * turn,
        "home_x": environment.home[0] * turn,
        "home_y": environment.home[1] * turn,
        "axis": axis,
    }
    given = {
        **q,
        **remembered(effect),
        **around,
        **references,
        **values,
        "theta": q["theta_x"],
        "theta_rate": q["theta_x_rate"],
    }
    laws = [array_law(effect, k) for k, law in enumerate(effect.laws) if law.target == target]
    return complex(sum(law(given) for law in laws))


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


TILT = st.builds(lambda size, turn: size * np.exp(1j * turn), number(0.001, 0.09), number(0.0, 2.0 * math.pi))
INSTANT = st.fixed_dictionaries(
    {
        "z": TILT,
        "z_rate": st.builds(complex, number(-2.0, 2.0), number(-2.0, 2.0)),
        "Omega": number(100.0, 420.0),
        "theta_x": number(-0.09, 0.09),
        "theta_y": number(-0.09, 0.09),
        "theta_x_rate": number(-30.0, 30.0),
        "theta_y_rate": number(-30.0, 30.0),
        "theta_z": number(0.0, 2.0 * math.pi),
        "T_coil": number(280.0, 340.0),
        "T_air": number(285.0, 300.0),
        "T_winding": number(285.0, 360.0),
        "T_motor": number(285.0, 320.0),
        "rho": number(0.2, 1.4),
        "i_motor": number(-3.0, 3.0),
        "V_coil": st.builds(complex, number(-8.0, 8.0), number(-8.0, 8.0)),
        "rig": st.sampled_from(RIGS),
        "t": number(0.0, 300.0),
    }
)


@EACH_SIMULATED
def test_compiled_law_is_the_declared_law(effect):
    @THOROUGH
    @given(INSTANT, st.tuples(*(number(*c.usual) for c in effect.coefficients)))
    def check(q, coefficients):
        values = dict(zip((c.name for c in effect.coefficients), coefficients, strict=True))
        outputs = Law(effect, values)(q)
        targets = {law.target for law in effect.laws}
        for target in targets:
            expected = declared(effect, values, q, target)
            assert abs(combined(outputs, target) - expected) <= 1e-12 * abs(expected) + 1e-100
        if "flexure_torque" in targets:  # both flexures obey the same law
            other = {**q, "theta_x": q["theta_y"], "theta_x_rate": q["theta_y_rate"]}
            expected = declared(effect, values, other, "flexure_torque", axis=-1.0)
            assert abs(outputs["flexure_torque_y"] - expected) <= 1e-12 * abs(expected) + 1e-100
        own = {name for target in targets for name in BY_TARGET[target]}
        assert not any(value for name, value in outputs.items() if name not in own)

    check()


# --- the whole plant -----------------------------------------------------------------------------------------

STATE = st.fixed_dictionaries(
    {
        "z": TILT,
        "rate": st.builds(complex, number(-2.0, 2.0), number(-2.0, 2.0)),
        "angle": number(0.0, 2.0 * math.pi),
        "Omega": number(100.0, 420.0),
        "coils": st.builds(complex, number(-5.0, 5.0), number(-5.0, 5.0)),
        "motor": number(0.0, 20.0),
        "T_coil": number(285.0, 330.0),
        "T_winding": number(285.0, 360.0),
        "T_motor": number(285.0, 320.0),
        "pressure": number(3e4, 1.1e5),
        "rig": st.sampled_from(["upright", "inverted", "x_up"]),
        "table_rate": number(-0.3, 0.3),
    }
)


@functools.cache
def machine() -> Machine:
    return Machine(BENCH, Scenario(values=QUIET), initial_spin_rate=300.0)


def arrays(effects: Mapping[str, Mapping[str, float]]) -> Any:
    values = {k: dict(v) for k, v in effects.items()}
    return *coefficient_arrays(simulated_effects(), values, BENCH), np.zeros(len(Further), dtype=np.int64)


def state_of(s: Mapping[str, Any]) -> np.ndarray:
    """Return the state of the compiled plant, the table turning steadily."""
    n = -1j * s["z"] / math.sqrt(1.0 + abs(s["z"]) ** 2)
    state = np.zeros(N_STATE + memory_size(simulated_effects()))
    given = {
        State.n_x: n.real, State.n_y: n.imag, State.n_x_rate: s["rate"].real, State.n_y_rate: s["rate"].imag,
        State.spin_angle: s["angle"], State.spin_rate: s["Omega"], State.coil_temperature: s["T_coil"],
        State.air_pressure: s["pressure"], State.winding_temperature: s["T_winding"],
        State.motor_temperature: s["T_motor"], State.table_rate: s["table_rate"],
    }  # fmt: skip
    state[list(given)] = list(given.values())
    return state


def rates(effects: Mapping[str, Mapping[str, float]], s: Mapping[str, Any]) -> tuple[complex, float]:
    """Return (n_x'' + i n_y'', Omega') from the compiled plant; `rate` in the state is n_x' + i n_y'."""
    p, state = machine().parameters, state_of(s)
    rho = s["pressure"] / (p.gas_constant * p.air_temperature)
    environment = surroundings(s["rig"], s["table_rate"], s.get("turn", 1.0))
    x, y, spin = loop_code().plant_rates(
        p,
        *arrays(effects),
        environment,
        10.0,
        rho,
        state,
        s["coils"].real,
        s["coils"].imag,
        s["motor"],
        *state[:6],
    )
    return complex(x, y), spin


def advanced(effects: Mapping[str, Mapping[str, float]], s: Mapping[str, Any]) -> np.ndarray:
    """Return the state, without that of laws, and the readings after three samples under changing voltages."""
    state, out = state_of(s), np.zeros(11)
    held = np.array([s["coils"].real, s["coils"].imag, s["motor"]])
    environment = surroundings(s["rig"], s["table_rate"])
    for k in range(3):
        coils = -1j * (1.0 + 0.1 * k) * s["coils"]
        loop_code().plant_advance(
            machine().parameters, *arrays(effects), environment, state, held, 10.0 + k * BENCH.sample_period,
            coils.real, coils.imag, s["motor"] - k, np.zeros(N_NOISE), out,
        )  # fmt: skip
    return np.concatenate([state[:N_STATE], out])


@EACH
def test_amplitude_of_zero_changes_nothing(effect):
    """Not by a single bit, in the motion or in any reading."""

    @THOROUGH
    @given(STATE)
    def check(s):
        nothing = {effect.name: effect.nulls()}
        assert rates(nothing, s) == rates({}, s)
        np.testing.assert_array_equal(advanced(nothing, s), advanced({}, s))

    check()


@EACH
def test_usual_size_changes_motion_or_readings(effect):
    state = {
        "z": 0.05 + 0.02j, "rate": 0.3 + 0.1j, "angle": 0.7, "Omega": 300.0, "coils": 1.0 + 0.5j, "motor": 9.0,
        "T_coil": 310.0, "T_winding": 320.0, "T_motor": 300.0, "pressure": 9e4, "rig": "upright", "table_rate": 0.0,
    }  # fmt: skip
    usual, without = advanced({effect.name: effect.defaults()}, state), advanced({}, state)
    mechanical = [*range(6), *range(N_STATE, len(usual))]
    assert (usual[mechanical] != without[mechanical]).any()


#: How often the pair of coefficients name_x, name_y turns when the case turns once, with everything in it; a vector in
#: the case turns once, one that stands in the rotor or in the room not at all.
TURNS = {
    "static_imbalance": 0,
    "runout": 0,
    "target_flatness": 0,
    "earth_rate": 0,
    "coil_anisotropy": 2,
    "cogging": int(BENCH.value("motor_ripple_order")),
    "commutation_ripple": int(BENCH.value("motor_ripple_order")),
}
#: Pairs of which a mirror reverses the second coefficient; of torques and angles about axes it reverses the first.
MIRRORED_Y = ("coil_anisotropy", "cogging", "commutation_ripple")


def turned(effect: Effect, values: Mapping[str, float], turn: complex) -> dict[str, float]:
    """Return coefficients with those that come in pairs, name_x and name_y, turned about z (see `TURNS`)."""
    result, turn = dict(values), turn ** TURNS.get(effect.name, 1)
    for name in values:
        if name.endswith("_x") and (partner := f"{name[:-1]}y") in values:
            vector = complex(values[name], values[partner]) * turn
            result[name], result[partner] = vector.real, vector.imag
    return result


def has_fixed_direction(effect: Effect) -> bool:
    """Whether a declared law stays behind when the case turns about z, its vectors of coefficients turning along."""
    q: dict[str, Any] = {
        "z": 0.05 + 0.02j, "z_rate": 0.3 - 0.4j, "Omega": 300.0, "theta_x": 0.02, "theta_y": -0.03, "theta_z": 0.4,
        "theta_x_rate": 3.0, "theta_y_rate": -2.0, "T_coil": 310.0, "T_air": 293.0, "T_winding": 320.0,
        "T_motor": 300.0, "rho": 1.0, "i_motor": 0.4, "V_coil": 3.0 - 2.0j, "rig": "x_up", "t": 3.0,
    }  # fmt: skip
    values, turn = effect.defaults(), np.exp(0.7j)
    after = {
        **q,
        "z": q["z"] * turn,
        "z_rate": q["z_rate"] * turn,
        "V_coil": q["V_coil"] * turn,
        "theta_z": q["theta_z"] + 0.7,
        "turn": turn,
    }
    for target in {law.target for law in effect.laws}:
        # the mirrored part of the coils' torque turns twice
        times = 2 if target == "coil_anisotropy" else int(target in COMPLEX)
        expected = declared(effect, values, q, target) * turn**times
        if abs(declared(effect, turned(effect, values, turn), after, target) - expected) > 1e-9 * abs(
            expected
        ):
            return True
    return False


@EACH_SIMULATED
def test_turned_case_turns_the_torques(effect):
    """Nothing but a vector among the coefficients knows a direction of the case."""
    if has_fixed_direction(effect):
        pytest.skip("the law contains a fixed direction of the case")

    @THOROUGH
    @given(STATE, number(-math.pi, math.pi))
    def check(s, angle):
        values, turn = effect.defaults(), complex(math.cos(angle), math.sin(angle))
        after = {
            **s,
            "angle": s["angle"] + angle,
            "turn": turn,
            **{name: s[name] * turn for name in ("z", "rate", "coils")},
        }
        tilting, spinning = rates({effect.name: values}, s)
        tilting_after, spinning_after = rates({effect.name: turned(effect, values, turn)}, after)
        assert abs(tilting_after - tilting * turn) <= 1e-9 * max(abs(tilting), 100.0)
        assert abs(spinning_after - spinning) <= 1e-9 * max(abs(spinning), 100.0)

    check()


def test_a_fixed_direction_is_noticed():
    assert has_fixed_direction(THREE_LOBED)
    assert not has_fixed_direction(registry()["fixed_torque"])


def mirrored(s: Mapping[str, Any]) -> dict[str, Any]:
    """Return the state seen in a mirror in the plane of x and z: axial vectors change sign in that plane."""
    return {
        **s,
        "z": -s["z"].conjugate(),
        "rate": s["rate"].conjugate(),
        "coils": -s["coils"].conjugate(),
        "angle": -s["angle"],
        "Omega": -s["Omega"],
        "motor": -s["motor"],
        "table_rate": -s["table_rate"],
    }


def mirrored_vectors(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    """Return coefficients with one of each pair name_x, name_y reversed (see `MIRRORED_Y`)."""
    own, other = "yx" if effect.name in MIRRORED_Y else "xy"
    return {
        name: -value if name.endswith(f"_{own}") and f"{name[:-1]}{other}" in values else value
        for name, value in values.items()
    }


def forward_only(effect: Effect) -> bool:
    """Whether a law is for forward spin alone: the spin rate is declared positive, so its sign is not in any law."""
    along = ("axial_torque", "shaft_torque")
    return any(law.target in along or Omega in law.expression.free_symbols for law in effect.laws)


EITHER_WAY = [effect for effect in REGISTERED if not forward_only(effect)]


@pytest.mark.parametrize("effect", [None, *EITHER_WAY], ids=lambda e: e.name if e else "none")
def test_mirror_image_moves_like_a_mirror_image(effect):
    """A mirror turns the spin round; what does not depend on the spin obeys it with every effect."""
    values = effect.defaults() if effect else {}

    @THOROUGH
    @given(STATE)
    def check(s):
        plain = {effect.name: values} if effect else {}
        image = {effect.name: mirrored_vectors(effect, values)} if effect else {}
        tilting, spinning = rates(plain, s)
        tilting_image, spinning_image = rates(image, mirrored(s))
        assert abs(tilting_image - tilting.conjugate()) <= 1e-9 * max(abs(tilting), 100.0)
        assert abs(spinning_image + spinning) <= 1e-9 * max(abs(spinning), 100.0)

    check()
