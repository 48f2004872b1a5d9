"""Readings of a slower instrument, repeated row by row: named with their rows before anything is concluded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import gyrowheel as gw
from gyrowheel.show.sentences.findings import reading_sentence
from gyrowheel.show.sentences.setup import problem
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.reduction.instrument_readings import look, reading_findings
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_core.errors import InputError
from gyrowheel_core.readings import READINGS
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mislabelled import Fix, correct, corrected
from gyrowheel_recording.mislabelled.blocks import NAMES
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_recording.mislabelled.held import rows_a_value
from gyrowheel_sim.bench import Bench

Array = np.ndarray

PLAN = """\
schema: 1
name: held
hold_s: 1.0
segments:
  - {spin_rpm: 2400, tilt_deg: [[0, 0], [3, 0], [0, 3], [-2, 1]]}
"""


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    plan = tmp_path_factory.mktemp("held") / "plan.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    return gw.simulate(plan, machine=11, seed=3).data


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench.load()


def held(values: Array, rows: float, late: int = 0) -> Array:
    """Return values of which each is repeated over so many rows."""
    count = np.arange(len(values))
    begun = np.ceil(np.floor((count + late) / rows) * rows - late).astype(int)
    return values[np.clip(begun, 0, count)]


def spoilt(recording: Recording, change: Callable[[np.ndarray], None]) -> Recording:
    samples = recording.measurement.copy()
    change(samples)
    return replace(recording, measurement=samples)


@pytest.mark.parametrize("rows", [2, 3, 7, 16, 40, 1.5, 6.67])
@pytest.mark.parametrize("name", NAMES)
def test_a_held_reading_is_named_with_its_rows(right: Recording, name: str, rows: float) -> None:
    samples = right.measurement
    kept = np.random.default_rng(7).random(len(samples)) > 0.002  # some samples are lost, too
    values = held(samples[name], rows, late=1)[kept]
    assert rows_a_value(values, samples["sequence"][kept].astype(np.int64)) == pytest.approx(rows, rel=0.02)


@pytest.mark.parametrize("rows", [2, 3, 5])
def test_a_coarse_reading_is_held_where_it_changes_in_even_rows_only(right: Recording, rows: int) -> None:
    values = right.measurement["coil_voltage_x"]
    step = 0.7 * float(np.median(np.abs(np.diff(values))))
    assert rows_a_value(held(np.round(values / step) * step, rows)) == rows


@pytest.mark.parametrize("digits", [4, 5, 7, 9])
@pytest.mark.parametrize("name", NAMES)
def test_a_converter_of_few_bits_written_with_few_digits_is_not_questioned(
    right: Recording, name: str, digits: int
) -> None:
    values = right.measurement[name][:40_000]
    usual = float(np.median(np.abs(np.diff(values))))
    smooth = np.convolve(values, np.full(30, 1 / 30), mode="same") if name != "spin_angle" else values
    for part in (0.1, 0.7, 3.0):
        for own in (values, smooth):
            shown = np.char.mod(f"%.{digits}g", 57.3 * np.round(own / (part * usual)) * part * usual)
            assert rows_a_value(shown.astype(np.float64)) == 1.0


@pytest.mark.parametrize("name", NAMES)
def test_readings_that_repeat_for_other_reasons_are_not_questioned(right: Recording, name: str) -> None:
    values = right.measurement[name]
    usual = float(np.median(np.abs(np.diff(values))))
    smooth = np.convolve(values, np.full(50, 0.02), mode="same")
    for part in (0.01, 0.3, 1.0, 3.0, 30.0):  # converters of few bits, of a noisy and of a filtered reading
        for own in (values, smooth):
            assert rows_a_value(np.round(own / (part * usual)) * part * usual) == 1.0
    at_rest, clipped = values.copy(), np.clip(values, *np.percentile(values, (30.0, 70.0)))
    at_rest[len(values) // 3 : len(values) // 2] = 0.0
    assert rows_a_value(at_rest) == rows_a_value(clipped) == rows_a_value(np.full(1000, 2.5)) == 1.0


def test_the_cure_takes_rows_with_new_values_alone(right: Recording, bench: Bench) -> None:
    def change(samples: np.ndarray) -> None:
        for name in ("coil_voltage_x", "coil_voltage_y"):
            samples[name] = held(samples[name], 4, late=2)

    wrong = spoilt(right, change)
    (found,) = wrong_setups([wrong], bench)
    assert (found.kind, found.columns, found.value) == ("held", ("coil_voltage_x", "coil_voltage_y"), 4.0)
    assert found.cure.every == 4
    mended = corrected(wrong.measurement, found.cure)
    rows = np.isin(right.measurement["stamp_ns"], mended["stamp_ns"])
    assert mended["coil_voltage_x"] == pytest.approx(right.measurement["coil_voltage_x"][rows])
    assert np.all(np.diff(mended["sequence"].astype(int)) == 1)
    assert not wrong_setups([replace(right, measurement=mended)], bench)
    assert "leave out coil_voltage_x and coil_voltage_y instead" in problem(found)


def test_rows_of_readings_that_are_not_held_are_refused(right: Recording) -> None:
    for every in (2, 6.67):
        with pytest.raises(InputError, match=rf"every: {every}: no reading is new"):
            corrected(right.measurement, Fix(every=every))
    table = pd.DataFrame({"time": 1e-9 * right.measurement["stamp_ns"]} | {
        name: right.measurement[name] for name in READINGS
    })  # fmt: skip
    asked = gw.suggest_map(table)
    with pytest.raises(InputError, match="every: 4: no reading is new"):
        gw.read_table(table, asked.content | {"every": 4})


def test_the_cure_takes_new_values_at_a_distance_that_is_no_whole_number_of_samples(
    right: Recording, bench: Bench, tmp_path: Path
) -> None:
    lost = np.random.default_rng(5).random(len(right.measurement)) < 0.001
    kept = replace(right, measurement=right.measurement[~lost])
    wrong = spoilt(kept, lambda samples: samples.__setitem__("tilt_x", held(samples["tilt_x"], 20 / 3)))
    (found,) = wrong_setups([wrong], bench)
    assert found.cure.every == pytest.approx(20 / 3, rel=0.01)
    mended = corrected(wrong.measurement, found.cure)
    rows = np.isin(right.measurement["stamp_ns"], mended["stamp_ns"])
    assert np.mean(mended["tilt_x"] == right.measurement["tilt_x"][rows]) > 0.98
    assert np.mean(np.diff(mended["sequence"].astype(int)) == 1) > 0.99
    assert not wrong_setups([replace(right, measurement=mended)], bench)

    table = pd.DataFrame({"time": 1e-9 * wrong.measurement["stamp_ns"]} | {
        name: wrong.measurement[name] for name in READINGS
    })  # fmt: skip
    asked = gw.suggest_map(table)
    (question,) = asked.questions
    assert "tilt_x is new in every 6.7th sample only" in question
    assert "In the map: every: 6.67." in question
    read = gw.read_table(table, asked.content | {"every": 6.67})
    assert len(read.measurement) == pytest.approx(len(mended), rel=0.001)
    assert not wrong_setups([read.data], bench)


def test_held_voltages_are_left_out_where_too_few_samples_are_new(right: Recording, bench: Bench) -> None:
    def change(samples: np.ndarray) -> None:
        samples["coil_voltage_x"] = held(samples["coil_voltage_x"], 40)

    (found,) = wrong_setups([spoilt(right, change)], bench)
    assert (found.cure.every, found.cure.without) == (1, ("coil_voltage_x",))
    (found,) = wrong_setups(
        [spoilt(right, lambda own: own.__setitem__("tilt_x", held(own["tilt_x"], 40)))], bench
    )
    assert not found.cure


def test_readings_that_are_new_in_different_samples_have_no_common_ones(
    right: Recording, bench: Bench
) -> None:
    def change(samples: np.ndarray) -> None:
        samples["tilt_x"], samples["tilt_y"] = held(samples["tilt_x"], 4), held(samples["tilt_y"], 4, late=2)

    (found,) = wrong_setups([spoilt(right, change)], bench)
    assert not found.cure


def test_an_angle_that_is_held_for_most_of_a_turn_is_named_at_the_import(right: Recording) -> None:
    angle = held(right.measurement["spin_angle"], 31)
    table = pd.DataFrame({"time": 1e-9 * right.measurement["stamp_ns"]} | {
        name: right.measurement[name] for name in READINGS
    })  # fmt: skip
    (question,) = gw.suggest_map(table.assign(spin_angle=angle)).questions
    assert "spin_angle is new in every 31st sample only" in question
    assert "leave out columns.spin_angle" in question


def test_a_held_speed_is_left_out_where_the_angle_shows_it(right: Recording, bench: Bench) -> None:
    wrong = spoilt(right, lambda samples: samples.__setitem__("spin_rate", held(samples["spin_rate"], 40)))
    (found,) = wrong_setups([wrong], bench)
    assert (found.columns, found.value, found.cure.without) == (("spin_rate",), 40.0, ("spin_rate",))
    mended = corrected(wrong.measurement, found.cure)
    assert np.isnan(mended["spin_rate"]).all()
    assert not wrong_setups([replace(right, measurement=mended)], bench)


def test_held_tilts_are_no_degrees(right: Recording, bench: Bench) -> None:
    def change(samples: np.ndarray) -> None:
        for name in ("tilt_x", "tilt_y"):
            samples[name] = held(samples[name], 5)

    (found,) = wrong_setups([spoilt(right, change)], bench)
    assert (found.kind, found.value) == ("held", 5.0)


def test_voltages_that_are_new_with_the_loop_are_as_they_should_be(right: Recording) -> None:
    slow = Bench.load()
    period = replace(slow.parameters["sample_period"], value=2.0 * slow.sample_period)
    slow = replace(slow, parameters={**slow.parameters, "sample_period": period})

    def change(samples: np.ndarray) -> None:
        for name in ("coil_voltage_x", "coil_voltage_y", "motor_voltage"):
            samples[name] = held(samples[name], 2)

    assert not [own for own in wrong_setups([spoilt(right, change)], slow) if own.kind == "held"]


def test_a_diagnosis_names_the_instrument_before_anything_else(right: Recording, tmp_path) -> None:
    def change(samples: np.ndarray) -> None:
        samples["tilt_x"] = held(samples["tilt_x"], 2)

    from gyrowheel_recording.mislabelled import Fix

    wrong = spoilt(right, change)
    correct(wrong, Fix(scale={"tilt_y": 1.0 + 1e-12}), tmp_path / "held")
    found = gw.diagnose(tmp_path / "held", gw.Model("gyrowheel"))
    assert found.verdict == "insufficient_data"
    assert not found.effects
    assert not found.events
    assert "tilt_x is new in every 2nd sample only" in str(found)
    assert "--every 2" in str(found)


def test_a_held_thermometer_is_named_and_changes_no_verdict(right: Recording, bench: Bench) -> None:
    def change(samples: np.ndarray) -> None:
        samples["air_temperature"] = held(samples["air_temperature"], 20)

    wrong = spoilt(right, change)
    assert not wrong_setups([wrong], bench)
    samples = samples_of(wrong)
    (found,) = (
        own
        for own in reading_findings([look(samples, reduce(samples, bench), bench)], ["a"], bench).found
        if own.quantity == "held"
    )
    assert (found.channel, found.value) == ("air_temperature", 20.0)
    assert reading_sentence(found) == "The air temperature is new in every 20th sample only."
