"""What names and values of columns are taken for: of several languages, and of quantities that are no reading."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import gyrowheel as gw
from gyrowheel_recording.mapping.column_names import TEMPERATURE, meaning_of, unknown_unit

from .test_wrong_tables import RATE, N, Table

#: Names of columns, with the unit that the file states, and what they are: nothing where they are no reading.
NAMES: dict[tuple[str, str], str] = {
    ("tilt_rate_x", ""): "",
    ("Tilt rate X [deg/s]", ""): "",
    ("phi_x_dot", ""): "",
    ("Tilt rate", "deg/s"): "",
    ("high_rate/Tilt X", "deg"): "tilt_x",
    ("/joint_states.position.tilt_x", ""): "tilt_x",
    ("/joint_states.velocity.tilt_x", ""): "",
    ("/joint_states.effort.tilt_x", ""): "",
    ("/joint_states.position.rotor", ""): "spin_angle",
    ("/joint_states.velocity.rotor", ""): "spin_rate",
    ("/imu/data.angular_velocity.z", "rad/s"): "",
    ("Rate table speed [deg/s]", ""): "",
    ("Drehzahl Istwert [1/min]", ""): "spin_rate",
    ("Drehgeschwindigkeit [rad/s]", ""): "spin_rate",
    ("Vitesse rotor [tr/min]", ""): "spin_rate",
    ("Neigungswinkel X [Grad]", ""): "tilt_x",
    ("X轴倾角（°）", ""): "tilt_x",
    ("转速(rpm)", ""): "spin_rate",
    ("电机电压 [V]", ""): "motor_voltage",
    ("线圈X电流 [mA]", ""): "coil_current_x",
    ("环境温度（℃）", ""): "air_temperature",
    ("时间", "s"): "time",
    ("Température ambiante [°C]", ""): "air_temperature",
    ("Umgebungstemperatur [°C]", ""): "air_temperature",
    ("Spulentemperatur [°C]", ""): "coil_temperature",
    ("Air_Temp_C", ""): "air_temperature",
    ("Coil_Temp_C", ""): "coil_temperature",
    ("temp_c", ""): TEMPERATURE,
    ("Coil X temp [degC]", ""): "coil_temperature",
    ("drive/Coil temp", "degC"): "coil_temperature",
    ("Motor temperature [degC]", ""): "",
    ("Motor winding temp [degC]", ""): "",
    ("Bearing temp [degC]", ""): "",
    ("/imu/temperature.temperature", ""): "",
    ("/temperature.variance", ""): "",
    ("Supply voltage [V]", ""): "",
    ("Bus voltage", "V"): "",
    ("can_bus/Motor voltage", "V"): "motor_voltage",
    ("Motor 1 current [A]", ""): "motor_current",
    ("Encoder 1", "counts"): "spin_angle",
    ("Coil X resistance", ""): "",
    ("Coil torque X", ""): "",
    ("Motor PWM", "%"): "",
    ("Air supply pressure", "bar"): "",
}  # fmt: skip
#: What was asked for, and ends of a range: never taken for what was measured.
ASKED = [
    "Drehzahl Sollwert [1/min]", "Solldrehzahl [1/min]", "Consigne vitesse [tr/min]", "Speed limit [rpm]",
    "转速设定 [rpm]", "Max speed [rpm]",
]  # fmt: skip


@pytest.mark.parametrize(("name", "unit"), NAMES)
def test_field_of_a_column_name(name: str, unit: str) -> None:
    found = meaning_of(name, unit).fields
    clearest = max(found, key=lambda field: found[field], default="")
    assert clearest == NAMES[name, unit], found
    assert not meaning_of(name, unit).commanded


@pytest.mark.parametrize("name", ASKED)
def test_commanded_values_are_not_taken_for_measured_ones(name: str) -> None:
    assert meaning_of(name).commanded


@pytest.mark.parametrize("name", ["rev_per_min", "Time [min]", "Tilt X [deg]"])
def test_a_unit_in_a_name_is_not_read_as_a_limit_or_command(name: str) -> None:
    assert not meaning_of(name).commanded


def test_unit_of_another_quantity_is_reported() -> None:
    assert unknown_unit("Pressure", "W") == unknown_unit("P [W]") == "W"
    assert unknown_unit("Coil X", "mN·m") == "mN·m"
    for name, unit in (("Tilt (X)", ""), ("Speed [rpm]", ""), ("Encoder [-]", "none"), ("Hall (1)", "1")):
        assert unknown_unit(name, unit) == ""


def table(**others: Any) -> Any:
    """Return a right table with some columns changed, left out (None), or added."""
    own = Table()
    columns = {name: own.numbers(name) for name in own.columns} | others
    return pa.table({name: values for name, values in columns.items() if values is not None})


def told(found: gw.TableMap) -> str:
    return "\n".join(found.questions)


def test_two_columns_with_similar_names_are_asked_about() -> None:
    speed = Table().numbers("Speed [rpm]")
    found = gw.suggest_map(table(**{"Speed raw [rpm]": speed + 5.0}))
    assert "spin_rate: 'Speed [rpm]' is taken; 'Speed raw [rpm]' is named as clearly" in told(found)
    # of thermometers and pressures it is told
    found = gw.suggest_map(table(**{"Air pressure 2 [hPa]": np.full(N, 1013.0)}))
    assert found.settled, found.questions
    assert any("'Air pressure 2 [hPa]' is named as clearly" in remark for remark in found.remarks)


def test_several_unspecified_thermometers_are_asked_for() -> None:
    air = Table().numbers("Air temp [degC]")
    changed = {"Air temp [degC]": None, "Coil temp [degC]": None}
    one = gw.suggest_map(table(**changed, **{"T1 temp [degC]": air}))
    assert one.settled, one.questions
    two = gw.suggest_map(table(**changed, **{"Temp A [degC]": air, "Temp B [degC]": air + 1.0}))
    assert "the names do not state where the thermometers are" in told(two)


def test_the_voltage_of_a_supply_is_not_that_of_the_motor() -> None:
    """Whatever it is called, it goes neither with speed nor with current; here the speed changes."""
    rng = np.random.default_rng(3)
    time = np.arange(N) / RATE
    rate = 150.0 + 200.0 * np.clip((time - 0.7) / 0.6, 0.0, 1.0)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) / RATE)])
    changed = {
        "Encoder [deg]": np.degrees(np.mod(angle, 2.0 * math.pi)),
        "Speed [rpm]": rate * 30.0 / math.pi + rng.normal(0.0, 0.5, N),
        "Motor current [A]": None,
        "Motor voltage [V]": 28.0 + rng.normal(0.0, 0.05, N),
    }
    found = gw.suggest_map(table(**changed))
    assert "motor_voltage: " in told(found)
    assert "neither with the speed nor with the current" in told(found)


def test_a_time_that_may_be_ms_or_us_is_asked_for() -> None:
    ticks = 20.0 * np.arange(N)
    found = gw.suggest_map(table(**{"Time [s]": None, "Time": ticks}))
    assert "'Time' does not say its unit" in told(found)
    assert "in us 5e+04" in told(found)


def test_a_number_of_every_tenth_sample_is_no_sequence() -> None:
    for step, taken in ((1, True), (10, False)):
        found = gw.suggest_map(table(Sample=step * np.arange(N)))
        assert ("sequence" in found.content) == taken


@pytest.mark.parametrize("counts", [500, 1000, 1024, 2000, 2048, 3600, 4096, 8000, 8192, 65536])
@pytest.mark.parametrize("kind", ["of a turn", "on", "of 16 turns"])
def test_counts_per_turn_of_an_encoder_are_determined(counts: int, kind: str) -> None:
    """A counter of a turn shows them; the speed tells them of one that runs on, or restarts after several turns."""
    # not in step with the samples, so that nearly every count is seen
    turned = 250.013 * np.arange(N) / RATE / (2.0 * math.pi)
    values = np.floor(counts * turned)
    if kind == "of a turn":
        values = np.mod(values, counts)
    elif kind == "of 16 turns":
        values = np.mod(values, 16 * counts)
    found = gw.suggest_map(table(**{"Encoder [deg]": None, "Encoder [counts]": values}))
    source = found.content["columns"]["spin_angle"]
    assert (source["unit"], source["scale"]) == ("turn", pytest.approx(1.0 / counts, rel=1e-12))
    assert found.settled, found.questions


def test_a_counter_without_a_speed_is_asked_for() -> None:
    values = np.floor(4096 * 250.0 * np.arange(N) / RATE / (2.0 * math.pi))
    found = gw.suggest_map(table(**{"Encoder [deg]": None, "Speed [rpm]": None, "Encoder [counts]": values}))
    assert "how many counts there are a turn is not to be seen" in told(found)


def test_columns_numbered_from_zero_are_the_axes() -> None:
    own = Table()
    x, y = (own.numbers(f"Tilt {axis} [deg]") for axis in "XY")
    found = gw.suggest_map(
        table(**{"Tilt X [deg]": None, "Tilt Y [deg]": None, "Tilt 0 [deg]": x, "Tilt 1 [deg]": y})
    )
    columns = found.content["columns"]
    assert [columns[f"tilt_{axis}"]["column"] for axis in "xy"] == ["Tilt 0 [deg]", "Tilt 1 [deg]"]


def test_a_few_values_of_a_thermometer_are_used() -> None:
    few = np.where(np.arange(N) % 100 == 0, Table().numbers("Air temp [degC]"), np.nan)
    found = gw.suggest_map(table(**{"Air temp [degC]": few}))
    assert found.settled, found.questions
    assert found.content["columns"]["air_temperature"]["column"] == "Air temp [degC]"
