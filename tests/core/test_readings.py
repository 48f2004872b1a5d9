"""Readings with named columns."""

import numpy as np
import pytest

from gyrowheel_core import wire
from gyrowheel_core.readings import READINGS, Readings


@pytest.fixture
def readings() -> Readings:
    return Readings(np.arange(5.0 * len(READINGS)).reshape(5, -1))


def test_columns_are_those_of_the_message_and_views(readings: Readings) -> None:
    assert wire.MEASUREMENT.fields == READINGS
    for place, name in enumerate(READINGS):
        for column in (getattr(readings, name), readings[name]):
            assert np.shares_memory(column, readings.array)
            assert column.tolist() == readings.array[:, place].tolist()
    assert Readings.columns(["spin_rate", "tilt_x"]) == [3, 0]


def test_a_column_of_a_copy_can_be_written(readings: Readings) -> None:
    copy = readings.copy()
    copy.motor_current[2:] = -1.0
    copy["tilt_y"][0] = 7.0
    assert copy.array[:, READINGS.index("motor_current")].tolist()[2:] == [-1.0] * 3
    assert copy.tilt_y[0] == 7.0
    assert (readings.array >= 0.0).all()
    assert readings.tilt_y[0] == 1.0


@pytest.mark.parametrize(
    "which", [slice(1, 3), np.array([1, 2]), np.array([False, True, True, False, False])]
)
def test_rows_are_readings_again(readings: Readings, which: slice | np.ndarray) -> None:
    some = readings[which]
    assert isinstance(some, Readings)
    assert len(some) == 2
    assert some.spin_angle.tolist() == readings.spin_angle.tolist()[1:3]


def test_a_slice_of_a_recording_is_not_copied() -> None:
    rows = np.zeros((4, 13))  # a recording has stamp and sequence in front
    readings = Readings(rows[:, 2:])
    assert np.shares_memory(readings[1:].air_pressure, rows)


@pytest.mark.parametrize("shape", [(11,), (3, 10), (3, 12), (1, 2, 11)])
def test_readings_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"must be \(n, 11\)"):
        Readings(np.zeros(shape))


def test_an_unknown_name_is_refused(readings: Readings) -> None:
    with pytest.raises(KeyError, match="spin"):
        readings["spin"]
