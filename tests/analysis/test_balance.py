"""The quick ways to predict rows give what the whole computation gives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.criteria import MODEL_ABSOLUTE
from gyrowheel_analysis.fitting.fit import NUISANCE_GROUPS
from gyrowheel_analysis.fitting.noise import Noise
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_sim.effects import registry
from gyrowheel_sim.effects.targets import INSTRUMENT_PARAMETERS
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH, hidden_machine, record

#: One for each way in which an effect acts, and one that knows the warmth of the motor.
EFFECTS = (
    None, "aero_cross", "cubic_stiffness", "windage_tilt", "external_damping", "tilt_rotation", "inertia_anisotropy",
    "earth_rate", "coil_tilt", "coil_inductance", "commutation_ripple", "winding_heating", "supply_sag",
    "gravity_offset",
)  # fmt: skip


@pytest.fixture(scope="module")
def balance(tmp_path_factory: pytest.TempPathFactory) -> Balance:
    recording = record(tmp_path_factory.mktemp("run"), "run", hidden_machine(4, {}), "check")
    return Balance(reduce(samples_of(recording), BENCH), BENCH)


def drawn(rng: np.random.Generator) -> dict[str, float]:
    groups = BENCH.groups()
    values = BENCH.values()
    for group in NUISANCE_GROUPS:
        u = rng.normal()
        for p in groups.get(group, ()):
            values[p.name] = p.value + u * p.uncertainty
    return values


@pytest.mark.parametrize("name", EFFECTS)
def test_the_fast_update_of_a_bench_parameter_gives_the_same_rows(name: str | None, balance: Balance) -> None:
    rng = np.random.default_rng(3)
    effects = [] if name is None else [ActiveEffect(registry()[name], registry()[name].defaults())]
    values = drawn(rng)
    at = balance.instants(values, effects)
    rows, groups, quick = balance.rows_at(at, values), BENCH.groups(), 0
    for group in NUISANCE_GROUPS:
        after = dict(values)
        for p in groups.get(group, ()):
            after[p.name] += 0.5 * p.uncertainty
        found = balance.moved(at, values, after, effects)
        if found is None:
            continue
        quick += 1
        whole = balance.predicted(after, effects)
        change = np.abs(whole - rows).max()
        # what the error of an encoder does to the motion that goes in is far below the accuracy of the balance
        part, least = (1.0e-2, 0.2 * MODEL_ABSOLUTE) if group in INSTRUMENT_PARAMETERS else (1.0e-4, 1.0e-12)
        assert np.abs(found - whole).max() <= part * change + least, group
    assert quick >= 10


def test_parameters_of_the_motion_have_no_fast_update(balance: Balance) -> None:
    values = BENCH.values()
    at = balance.instants(values, [])
    for name in ("rotor_inertia_z", "gimbal_inertia_x", "motor_constant", "tilt_scale", "tilt_bias_x"):
        assert balance.moved(at, values, {**values, name: 1.01 * values[name] + 1.0e-6}, []) is None


def test_a_small_step_of_a_motion_parameter_is_right_to_first_order(balance: Balance) -> None:
    values = drawn(np.random.default_rng(4))
    at, groups, slow = balance.instants(values, []), BENCH.groups(), 0
    rows = balance.rows_at(at, values)
    for group in NUISANCE_GROUPS:
        after = dict(values)
        for p in groups.get(group, ()):
            after[p.name] += 0.1 * p.uncertainty
        if balance.moved(at, values, after, []) is not None:
            continue
        slow += 1
        whole = balance.predicted(after, [])
        found = balance.rows_at(balance.instants(after, [], at), after)
        assert np.abs(found - whole).max() <= 5.0e-3 * np.abs(whole - rows).max(), group
    assert slow >= 5


def test_results_do_not_depend_on_earlier_calls(balance: Balance) -> None:
    rng = np.random.default_rng(5)
    values = drawn(rng)
    rows = balance.predicted(values, [])
    balance.predicted(drawn(rng), [])
    assert np.array_equal(balance.predicted(values, []), rows)
    # nor where the search for the ripple began, but for some nN m: the balance itself is right to 4 uN m
    other = Balance(balance.windows, balance.bench, clean=False)
    other.predicted(drawn(rng), [])
    assert np.abs(other.predicted(values, []) - rows).max() < 1.0e-8


def test_motor_heating_has_no_fast_update_with_an_effect_of_temperature(balance: Balance) -> None:
    values = BENCH.values()
    after = {**values, "winding_heat_capacity": 1.1 * values["winding_heat_capacity"]}
    effect = registry()["winding_heating"]
    warm = [ActiveEffect(effect, effect.defaults())]
    assert balance.moved(balance.instants(values, warm), values, after, warm) is None
    assert balance.moved(balance.instants(values, []), values, after, []) is not None


@pytest.mark.slow
def test_torque_of_motion_below_the_noise_depends_on_the_machine(tmp_path: Path) -> None:
    """A rotor a quarter off resists a motion twice a revolution twice as much as the one that is stated."""
    machine = hidden_machine(8, {})
    changed = {**machine.values, "rotor_inertia_z": 0.75 * machine.values["rotor_inertia_z"]}
    machine = replace(machine, values=changed)
    recording = record(tmp_path, "run", machine, "check")
    windows = reduce(samples_of(recording), BENCH)
    balance = Balance(windows, BENCH)
    raw = Balance(windows, BENCH, clean=False)
    truth = BENCH.values()
    truth |= {name: value for name, value in machine.values.items() if name in truth}

    def mistaken() -> float:
        """By how much the measured rows miss what the truth predicts, but for noise that both see [N m]."""
        change = balance.measured - balance.predicted(truth, []) - raw.measured + raw.predicted(truth, [])
        return float(np.abs(change[balance.row("tilt_2n_x")]).max())

    assert mistaken() > 2.0e-5
    balance = balance.cleared(truth, [])
    assert mistaken() < 1.0e-12


@pytest.mark.slow
def test_errors_of_the_encoder_mix_the_orders_of_tilt_torque_and_angle(tmp_path: Path) -> None:
    """A hold against the torque twice a revolution shows, by a track that is not centred, one once a revolution."""
    track = {"encoder_zero": 0.04, "encoder_once_x": 0.015, "encoder_once_y": -0.01, "encoder_twice_y": 0.008}
    quiet = {p.name: 0.0 for p in BENCH.parameters.values() if p.name.endswith(("_noise", "_drift"))}
    machine = Scenario.nominal(noise_seed=1)
    recording = record(tmp_path, "run", replace(machine, values={**track, **quiet}), "check")
    balance = Balance(reduce(samples_of(recording), BENCH), BENCH)
    truth = {**BENCH.values(), **track}
    balance = balance.cleared(truth, [])
    deviation = Noise.stated([balance], [balance.predicted(truth, [])]).deviation()
    left = (balance.measured - balance.predicted(truth, [])) / deviation
    for row in balance.rows:
        assert np.abs(left[balance.row(row)]).max() < 0.3, row
