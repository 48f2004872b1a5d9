"""The finder on recordings of another make, and that they are of another make."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import benchmarks.independent as package
from benchmarks.independent.cases import solve
from benchmarks.independent.instruments import WRONG, Instruments, is_instrument
from benchmarks.independent.loop import run
from benchmarks.independent.machine import COEFFICIENTS, ERRORS, Secret, bench_file
from benchmarks.independent.sequence import Step, long_sequence, references, short_sequence
from gyrowheel_analysis.fitting.fit import ERRORS as KNOWN_ERRORS
from gyrowheel_sim.effects import registry
from gyrowheel_sim.instruments import held_response, smooth_response
from gyrowheel_sim.parameter import INSTRUMENTS

Array = NDArray[np.float64]
MNM = 1e3 * 0.02  # mN m of a coil a volt


def holds(steps: list[Step], effects: dict[str, dict[str, float]] | None = None, substeps: int = 4) -> Array:
    """Mean readings of every step over whole revolutions of its second half, without noise."""
    asked = references(steps, 5e-4)
    readings = run(Secret.stated(effects), asked, None, substeps=substeps).readings
    means = []
    for number in range(len(steps)):
        rows = np.flatnonzero((asked.step == number) & asked.steady)
        rows = rows[len(rows) // 2 :]
        angle = np.unwrap(readings[rows, 2])
        turns = math.floor((angle[-1] - angle[0]) / (2 * math.pi))
        means.append(readings[rows[: np.searchsorted(angle, angle[0] + 2 * math.pi * turns)]].mean(axis=0))
    return np.array(means)


def test_machine_controller_and_sequence_share_nothing_with_the_project() -> None:
    folder = Path(package.__file__).parent
    for name in ("machine", "controller", "instruments", "sequence", "loop"):
        tree = ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [n for n in names if n.startswith("gyrowheel")], name
    assert {effect for effect, _ in COEFFICIENTS} <= registry().keys()
    for effect, key in COEFFICIENTS:
        assert key in registry()[effect].defaults(), effect
    assert ERRORS.keys() == KNOWN_ERRORS.keys()
    instruments = {name: e for name, e in registry().items() if e.category == "instrument"}
    assert {name: set(lines) for name, lines in WRONG.items()} == {
        n: set(e.defaults()) for n, e in instruments.items()
    }
    assert {line for line in bench_file() if is_instrument(line)} == set(INSTRUMENTS)


@pytest.mark.parametrize(
    ("delay", "time", "order"),
    [(0.0, 0.0, 1), (2.7e-4, 0.0, 1), (1.25e-3, 0.0, 1), (0.0, 1e-4, 1), (3e-4, 3e-4, 1), (1e-4, 1.5e-4, 3)],
)
def test_both_implementations_of_the_instruments_agree(delay: float, time: float, order: int) -> None:
    """A tilt that turns and voltages that do, once and twice a turn: amplitudes and phases of the readings."""
    channels = ("tilt", "coil_voltage", "motor_voltage", "motor_current", "spin_angle")
    wrong = {f"{name}_delay": {"d": delay} for name in channels}
    wrong |= {f"{name}_filter": {"t_f": time} for name in channels[:-1]}
    numbers = Secret.stated(wrong).numbers
    numbers |= {f"{name}_filter_order": float(order) for name in channels[:-1]}
    period, substeps = numbers["sample_period"], 4
    for omega in (366.5, 733.0):
        eyes = Instruments(numbers, substeps)
        eyes.start((1.0, 0.0), 0.0, omega, (1.0, 0.0, 0.0))
        readings = []
        for k in range(1, 200):
            held = np.exp(1j * omega * period * k)
            for part in range(1, substeps + 1):
                turn = omega * period * (k - 1 + part / substeps)
                eyes.note((math.cos(turn), math.sin(turn)), turn, omega, (held.real, held.imag, 0.0))
            after = np.exp(1j * omega * period * (k + 1))
            readings.append(eyes.read((after.real, after.imag, 0.0)))
        x, y, angle, coil_x, coil_y = np.array(readings)[60:, :5].T
        true = np.exp(1j * omega * period * np.arange(61, 200))
        tilt, coil = (x + 1j * y) / true, (coil_x + 1j * coil_y) / true
        np.testing.assert_allclose(tilt, smooth_response(omega, delay, time, order), atol=6e-4)
        np.testing.assert_allclose(coil, held_response(omega, delay, time, order, period=period), atol=6e-4)
        np.testing.assert_allclose(np.exp(1j * angle) / true, np.exp(-1j * omega * delay), atol=1e-9)


@pytest.mark.slow
@pytest.mark.study
def test_voltages_of_the_independent_loop_belong_to_the_interval_that_ends_at_the_sample() -> None:
    asked = references([Step(2000.0, 1 + 0j, hold=0.3)], 5e-4)
    for delay, older, newer in ((0.0, 2, 2), (-5e-4, 1, 1), (5e-4, 3, 3), (2.5e-4, 3, 2)):
        taken = run(Secret.stated({"coil_voltage_delay": {"d": delay}}), asked, None)
        volts, k = taken.commands[:, 0], np.arange(10, len(taken.commands))
        np.testing.assert_allclose(
            taken.readings[k, 4], 0.5 * (volts[k - older] + volts[k - newer]), atol=1e-12
        )


def test_encoder_steps_and_clock_of_the_independent_bench() -> None:
    asked = references([Step(2000.0, 1 + 0j, hold=0.3)], 5e-4)
    wrong = Secret.stated({"encoder_zero": {"E_0": 0.02}, "encoder_once": {"E_x": 3e-3, "E_y": 1e-3}})
    wrong.numbers["motor_voltage_resolution"], wrong.numbers["clock_rate_error"] = 0.05, 1e-4
    plain, taken = run(Secret.stated(), asked, None), run(wrong, asked, None)
    angle = plain.readings[:, 2]
    error = np.angle(np.exp(1j * (taken.readings[:, 2] - angle)))
    np.testing.assert_allclose(error, 0.02 + 3e-3 * np.cos(angle) + 1e-3 * np.sin(angle), atol=1e-9)
    steps = taken.readings[:, 6] / 0.05
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    np.testing.assert_allclose(taken.stamps, plain.stamps * (1.0 + 1e-4), atol=1.0)


@pytest.mark.study  # the effects are compared below
@pytest.mark.slow
def test_holding_torques_agree_with_the_bench() -> None:
    steps = [Step(rpm, 3 + 0j, hold=4.0) for rpm in (1000.0, 3500.0, 4000.0)]
    found = holds(steps)
    assert found[:, 4] * MNM == pytest.approx([6.42, -0.49, -2.79], abs=0.01)
    assert found[:, 6] == pytest.approx([3.17, 11.04, 12.61], abs=0.006)
    assert holds(steps, substeps=8)[:, 4:6] * MNM == pytest.approx(found[:, 4:6] * MNM, abs=0.0012)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "in_phase", "across", "drag"),
    [
        # torques of the coils at 3.2 degrees along the tilt and a quarter turn ahead, and of the motor [mN m]
        ({"aero_restoring": {"k": 0.02, "n": 2.0}}, 20.0 * 0.0559, 0.0, 0.0),
        pytest.param(
            {"aero_cross": {"c": 0.005, "n": 2.0}},
            0.0,
            -5.0 * 0.0559,
            -5.0 * 0.0559**2,
            marks=pytest.mark.study,
        ),
        ({"windage": {"w": 1e-3, "n": 1.5}}, 0.0, -0.5 * 0.0559, 1.0),
        pytest.param(
            {"flexure_damping": {"C": 1e-5}}, 0.0, -0.01 * 366.52 * 0.0559, 0.0, marks=pytest.mark.study
        ),
        pytest.param({"flexure_hysteresis": {"h": 3e-3}}, 0.0, -3.0 * 0.0559, 0.0, marks=pytest.mark.study),
        pytest.param(
            {"cubic_stiffness": {"q": 4.0}}, 0.75 * 4e3 * 0.0559**3, 0.0, 0.0, marks=pytest.mark.study
        ),
        pytest.param(
            {"fixed_torque": {"F_x": 1e-3, "F_y": -5e-4}}, -1.0, 0.5, 0.5 * 0.0559, marks=pytest.mark.study
        ),
        pytest.param({"bearing_coulomb": {"T": 2e-3}}, 0.0, 0.0, 2.0, marks=pytest.mark.study),
    ],
)
def test_effects_agree_with_their_formulas(
    effects: dict[str, dict[str, float]], in_phase: float, across: float, drag: float
) -> None:
    steps = [Step(3500.0, 3.2 + 0j, hold=3.0)]
    less, more = holds(steps)[0], holds(steps, effects)[0]
    change = more - less
    assert change[4] * MNM == pytest.approx(in_phase, abs=0.005 + 0.01 * abs(in_phase))
    assert change[5] * MNM == pytest.approx(across, abs=0.005 + 0.02 * abs(across))
    # of a torque across the tilted rotor a part acts on the shaft, and all but a little of one along it
    assert change[7] * 30.0 == pytest.approx(drag, abs=0.002 + 0.005 * abs(drag))


def test_sequences_stay_within_the_bench() -> None:
    stated = {name: line.value for name, line in bench_file().items()}
    for steps in (long_sequence(), short_sequence()):
        asked = references(steps, 5e-4)
        assert np.abs(asked.tilt).max() < stated["tilt_limit"]
        assert stated["spin_rate_minimum"] < asked.spin.min()
        assert asked.spin.max() < stated["spin_rate_maximum"] * (1 + 1e-9)
        # what is asked for has no jumps
        assert np.abs(np.diff(asked.tilt)).max() < 2e-4
        assert np.abs(np.diff(asked.tilt) / 5e-4 - asked.tilt_rate[:-1]).max() < 0.02


# three cases of the many that `python -m benchmarks.independent` tries; each draws machine, noise, controller and sizes


@pytest.mark.study
def test_nothing_is_found_without_a_hidden_effect() -> None:
    case = solve(70, 2, "short", "none")
    assert case.verdict == "nothing_missing"
    assert case.outcome == "right"


@pytest.mark.study  # a minute of steps of the other simulation
@pytest.mark.slow
def test_one_effect_is_found() -> None:
    case = solve(70, 4, "short", "single")
    assert case.detectable
    assert case.effects.keys() == {"tilt_rotation"}
    assert case.good, case


@pytest.mark.study
def test_two_effects_are_found() -> None:
    case = solve(70, 4, "short", "pair")
    assert case.detectable
    assert case.effects.keys() == {"aero_cross", "coil_heating"}
    assert case.good, case
