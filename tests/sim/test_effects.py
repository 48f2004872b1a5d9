"""Every registered effect: declaration, compiled law, symmetries, and what it does to the torque balance."""

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

from gyrowheel_analysis.balance import CHANNELS, ActiveEffect, Balance
from gyrowheel_analysis.discovery.fit import ERRORS
from gyrowheel_analysis.reduction import Samples, reduce
from gyrowheel_control.controller import loop_code
from gyrowheel_control.plans import Plan
from gyrowheel_sim.bench import unit_registry
from gyrowheel_sim.effects import Coefficient, Effect, registry
from gyrowheel_sim.effects.code import array_law, coefficient_arrays
from gyrowheel_sim.effects.declaration import TARGETS
from gyrowheel_sim.effects.outside import THREE_LOBED
from gyrowheel_sim.effects.quantities import REFERENCES, Omega
from gyrowheel_sim.plant import Machine, simulated_effects
from gyrowheel_sim.scenario import Scenario

from .helpers import BENCH, QUIET, quiet_run

REGISTERED = list(registry().values())
EACH = pytest.mark.parametrize("effect", REGISTERED, ids=lambda effect: effect.name)
EACH_SIMULATED = pytest.mark.parametrize("effect", simulated_effects(), ids=lambda effect: effect.name)
THOROUGH = settings(deadline=None, max_examples=40)


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
def test_coefficients_are_sane(effect):
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
        if c.shape is None:
            assert c.null == 0.0
        else:
            assert c.shape_uncertainty > 0.0


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


class Law:
    """The compiled laws of one effect, by names."""

    outputs = ("Tx", "Ty", "axial", "shaft", "flex_x", "flex_y", "gain", "read_x", "read_y")

    def __init__(self, effect: Effect, values: Mapping[str, float]) -> None:
        self.arrays = coefficient_arrays(simulated_effects(), {effect.name: dict(values)}, BENCH)

    def __call__(self, q: Mapping[str, Any]) -> dict[str, complex]:
        z, z_rate = complex(q["z"]), complex(q["z_rate"])
        result = compiled_laws()(
            *self.arrays, z.real, z.imag, z_rate.real, z_rate.imag, q["Omega"], q["theta_x"], q["theta_y"],
            q["theta_x_rate"], q["theta_y_rate"], q["T_coil"], q["T_air"], q["rho"], q["up"], q["t"],
        )  # fmt: skip
        return dict(zip(self.outputs, result, strict=True))


@functools.cache
def compiled_laws() -> Any:
    return numba.njit(loop_code().evaluate_laws, error_model="numpy")


#: Which outputs of the compiled laws belong to a target.
OUTPUTS = {
    "rotor_torque": ("Tx", "Ty"),
    "axial_torque": ("axial",),
    "shaft_torque": ("shaft",),
    "flexure_torque": ("flex_x", "flex_y"),
    "coil_gain": ("gain",),
    "tilt_reading": ("read_x", "read_y"),
}
COMPLEX = [target for target, (_, two_axes, _) in TARGETS.items() if two_axes]


def combined(outputs: Mapping[str, complex], target: str) -> complex:
    """Return an output as one number; of the two flexures the one about x."""
    names = OUTPUTS[target]
    return complex(outputs[names[0]], outputs[names[1]]) if target in COMPLEX else outputs[names[0]]


def declared(effect: Effect, values: Mapping[str, float], q: Mapping[str, Any], target: str) -> complex:
    """Return the same from the declaration, by the array law that the analysis uses."""
    references = {name: BENCH.value(parameter) for name, parameter in REFERENCES.items()}
    given = {**q, **references, **values, "theta": q["theta_x"], "theta_rate": q["theta_x_rate"]}
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
        "T_coil": number(280.0, 340.0),
        "T_air": number(285.0, 300.0),
        "rho": number(0.2, 1.4),
        "up": st.sampled_from([1.0, -1.0]),
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
            expected = declared(effect, values, other, "flexure_torque")
            assert abs(outputs["flex_y"] - expected) <= 1e-12 * abs(expected) + 1e-100
        own = {name for target in targets for name in OUTPUTS[target]}
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
        "pressure": number(3e4, 1.1e5),
        "up": st.sampled_from([1.0, -1.0]),
    }
)


@functools.cache
def machine() -> Machine:
    return Machine(BENCH, Scenario(values=QUIET), initial_spin_rate=300.0)


def arrays(effects: Mapping[str, Mapping[str, float]]) -> Any:
    return coefficient_arrays(simulated_effects(), {k: dict(v) for k, v in effects.items()}, BENCH)


def rates(effects: Mapping[str, Mapping[str, float]], s: Mapping[str, Any]) -> tuple[complex, float]:
    """Return (n_x'' + i n_y'', Omega') from the compiled plant; `rate` in the state is n_x' + i n_y'."""
    p = machine().parameters
    n = -1j * s["z"] / math.sqrt(1.0 + abs(s["z"]) ** 2)
    rho = s["pressure"] / (p.gas_constant * p.air_temperature)
    x, y, spin = loop_code().plant_rates(
        p, *arrays(effects), s["up"], 10.0, rho, s["T_coil"], p.air_temperature, s["coils"].real,
        s["coils"].imag, s["motor"], n.real, n.imag, s["rate"].real, s["rate"].imag, s["angle"], s["Omega"],
    )  # fmt: skip
    return complex(x, y), spin


def readings(effects: Mapping[str, Mapping[str, float]], s: Mapping[str, Any]) -> np.ndarray:
    """Return one sample of every sensor."""
    p = machine().parameters
    n = -1j * s["z"] / math.sqrt(1.0 + abs(s["z"]) ** 2)
    state = np.array(
        [n.real, n.imag, s["rate"].real, s["rate"].imag, s["angle"], s["Omega"], s["T_coil"], s["pressure"]]
        + [0.0] * 4
    )
    out = np.zeros(11)
    environment = np.array([s["up"], s["pressure"], 0.0])
    loop_code().plant_measure(
        p, *arrays(effects), environment, state, 10.0, s["coils"].real, s["coils"].imag, s["motor"],
        np.zeros(15), out,
    )  # fmt: skip
    return out


@EACH
def test_amplitude_of_zero_changes_nothing(effect):
    """Not by a single bit, in the accelerations or in any reading."""

    @THOROUGH
    @given(STATE)
    def check(s):
        nothing = {effect.name: effect.nulls()}
        assert rates(nothing, s) == rates({}, s)
        np.testing.assert_array_equal(readings(nothing, s), readings({}, s))

    check()


@EACH
def test_usual_size_changes_something(effect):
    state = {
        "z": 0.05 + 0.02j, "rate": 0.3 + 0.1j, "angle": 0.7, "Omega": 300.0, "coils": 1.0 + 0.5j, "motor": 9.0,
        "T_coil": 310.0, "pressure": 9e4, "up": 1.0,
    }  # fmt: skip
    usual = {effect.name: effect.defaults()}
    changed = [a != b for a, b in zip(rates(usual, state), rates({}, state), strict=True)]
    assert any(changed) or (readings(usual, state) != readings({}, state)).any()


def turned(values: Mapping[str, float], turn: complex) -> dict[str, float]:
    """Return coefficients with those that come in pairs, name_x and name_y, turned as a vector about z."""
    result = dict(values)
    for name in values:
        if name.endswith("_x") and (partner := f"{name[:-1]}y") in values:
            vector = complex(values[name], values[partner]) * turn
            result[name], result[partner] = vector.real, vector.imag
    return result


def has_fixed_direction(effect: Effect) -> bool:
    """Whether a declared law stays behind when the case turns about z, its vectors of coefficients turning along."""
    q = {
        "z": 0.05 + 0.02j, "z_rate": 0.3 - 0.4j, "Omega": 300.0, "theta_x": 0.02, "theta_y": -0.03,
        "theta_x_rate": 3.0, "theta_y_rate": -2.0, "T_coil": 310.0, "T_air": 293.0, "rho": 1.0, "up": 1.0, "t": 3.0,
    }  # fmt: skip
    values, turn = effect.defaults(), np.exp(0.7j)
    after = {**q, "z": q["z"] * turn, "z_rate": q["z_rate"] * turn}
    for target in {law.target for law in effect.laws}:
        expected = declared(effect, values, q, target) * (turn if target in COMPLEX else 1.0)
        if abs(declared(effect, turned(values, turn), after, target) - expected) > 1e-9 * abs(expected):
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
            **{name: s[name] * turn for name in ("z", "rate", "coils")},
        }
        tilting, spinning = rates({effect.name: values}, s)
        tilting_after, spinning_after = rates({effect.name: turned(values, turn)}, after)
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
    }


def mirrored_vectors(values: Mapping[str, float]) -> dict[str, float]:
    """Return coefficients with the x component of torques and angles in pairs name_x, name_y reversed."""
    return {
        name: -value if name.endswith("_x") and f"{name[:-1]}y" in values else value
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
        image = {effect.name: mirrored_vectors(values)} if effect else {}
        tilting, spinning = rates(plain, s)
        tilting_image, spinning_image = rates(image, mirrored(s))
        assert abs(tilting_image - tilting.conjugate()) <= 1e-9 * max(abs(tilting), 100.0)
        assert abs(spinning_image + spinning) <= 1e-9 * max(abs(spinning), 100.0)

    check()


# --- regressors against the full simulation ------------------------------------------------------------------

#: Weights of the rows: the slow drift of the reading behind each, which is what limits a real recording.
DRIFT = {
    "tilt_x": BENCH.value("coil_constant") * BENCH.value("coil_voltage_drift"),
    "tilt_y": BENCH.value("coil_constant") * BENCH.value("coil_voltage_drift"),
    "spin": BENCH.value("motor_constant") * BENCH.value("motor_current_drift"),
    "motor_voltage": BENCH.value("motor_voltage_drift"),
}


@functools.cache
def simulated(name: str | None, values: tuple[tuple[str, float], ...] = ()) -> Balance:
    """Return the balance of a quick plan run without noise on a machine with an effect."""
    run = quiet_run(Plan.load("quick"), {name: dict(values)} if name else {})
    time = np.arange(len(run.measurement), dtype=np.float64) * BENCH.sample_period
    samples = Samples(time, run.measurement, run.setpoints["stamp_ns"] * 1e-9, run.setpoints, run.environment)
    return Balance(reduce(samples, BENCH), BENCH)


def residual(balance: Balance) -> np.ndarray:
    """Return the rows measured minus predicted by a model without any effect."""
    return balance.measured - balance.predicted(BENCH.values(), [])


def weighted(balance: Balance, rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows[balance.channel(name)] / DRIFT[name] for name in CHANNELS])


def cosine(a: np.ndarray, b: np.ndarray) -> float:
    return float(a @ b / math.sqrt((a @ a) * (b @ b)))


COEFFICIENTS = [(effect, c) for effect in REGISTERED for c in effect.coefficients]


@pytest.mark.parametrize(
    ("effect", "coefficient"), COEFFICIENTS, ids=[f"{effect.name}.{c.name}" for effect, c in COEFFICIENTS]
)
def test_regressor_is_what_the_simulation_shows(effect: Effect, coefficient: Coefficient) -> None:
    """What changes in the rows when a coefficient changes, by the balance's finite difference and by full simulation.

    An amplitude goes from zero to its usual size, alone; a shape from its usual value by its uncertainty, with the
    amplitudes at their usual size.
    """
    if coefficient.shape is None:
        start = effect.nulls()
        stop = {**start, coefficient.name: coefficient.default}
        before = simulated(None)
    else:
        start = effect.defaults()
        stop = {**start, coefficient.name: coefficient.shape + coefficient.shape_uncertainty}
        before = simulated(effect.name, tuple(start.items()))
    after = simulated(effect.name, tuple(stop.items()))
    shown = weighted(after, residual(after) - residual(before))
    # finite difference about the start, as the analysis takes it
    step = 1e-3 * (stop[coefficient.name] - start[coefficient.name])
    near = {**start, coefficient.name: start[coefficient.name] + step}
    rows = [before.predicted(BENCH.values(), [ActiveEffect(effect, v)]) for v in (start, near)]
    regressor = weighted(before, rows[1] - rows[0]) / 1e-3
    assert cosine(shown, regressor) >= 0.999
    # an effect of the usual size is also predicted in size, wherever it shows
    predicted = [
        b.predicted(BENCH.values(), [ActiveEffect(effect, v)]) for b, v in ((after, stop), (after, start))
    ]
    difference = weighted(after, predicted[0] - predicted[1])
    # the balance of a cone depends a little on the spin angle at which its windows begin
    allowed = np.where(after.windows.moving, 0.5, 0.05)
    n = len(after.windows)
    for channel in range(len(CHANNELS)):
        own = slice(channel * n, (channel + 1) * n)
        error = np.abs(shown[own] - difference[own])
        assert (error <= 0.02 * np.abs(difference[own]).max() + allowed).all()


def test_model_without_effects_meets_the_simulation():
    """What is left of the rows when nothing is missing: holds within 3.5e-6 N m, cones within 3e-5 N m."""
    balance = simulated(None)
    left, moving = residual(balance), balance.windows.moving
    for name in ("tilt_x", "tilt_y"):
        rows = np.abs(left[balance.channel(name)])
        assert rows[~moving].max() < 3.5e-6
        assert rows[moving].max() < 3e-5
    assert np.abs(left[balance.channel("spin")]).max() < 3e-5
