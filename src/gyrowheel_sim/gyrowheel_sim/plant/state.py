"""Layout of the arrays of the compiled plant: state, surroundings, parameters.

The state is one flat array: the indices of `State`, then the drifts of the instruments
(`gyrowheel_sim.instruments.readings.Drift`), then the outputs of the laws that are evaluated once a sample
(`gyrowheel_sim.effects.targets`), then the memory of the instruments (`gyrowheel_sim.instruments.readings.Past`).
"""

from __future__ import annotations

from collections import namedtuple

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.columns import Column
from gyrowheel_sim.effects.targets import HELD_OUTPUTS
from gyrowheel_sim.instruments.readings import N_MEMORY, Drift


class State(Column):
    """Indices into the state of the machine itself."""

    n_x = 0, "1", "spin axis: component along case x"
    n_y = 1, "1", "spin axis: component along case y"
    n_x_rate = 2, "1/s", "rate of n_x"
    n_y_rate = 3, "1/s", "rate of n_y"
    spin_angle = 4, "rad", "angle of the shaft, 0 .. 2 pi"
    spin_rate = 5, "rad/s", "spin rate of the shaft"
    coil_temperature = 6, "K", "temperature of the torque coils", "air_temperature"
    air_pressure = 7, "Pa", "air pressure in the case", "air_pressure"
    # the motor is cold at the start
    winding_temperature = 8, "K", "temperature of the motor's winding", "air_temperature"
    motor_temperature = 9, "K", "temperature of the motor's magnets", "air_temperature"
    table_rate = 10, "rad/s", "rate at which the table turns the case about the vertical"
    table_acceleration = 11, "rad/s^2", "rate of change of the same over the sample"
    coil_x = 12, "V", "voltage that the torque of coil x belongs to: it follows the coil's voltage with a lag"
    coil_y = 13, "V", "the same of coil y"
    motor_current = 14, "A", "current of the motor at the last sample"


class Surroundings(Column):
    """Indices into the array of the operator's settings, and of directions in case axes."""

    up = 0, "1", "component along case z of the unit vector that points up"
    up_x = 1, "1", "its component along case x"
    up_y = 2, "1", "its component along case y"
    home_xx = 3, "1", "component along case x of the first home axis"
    home_xy = 4, "1", "its component along case y"
    home_yx = 5, "1", "component along case x of the second home axis"
    home_yy = 6, "1", "its component along case y"
    pressure = 7, "Pa", "pressure to which the bell jar is set"
    heater = 8, "K", "temperature above the air to which the coils' heater is set; 0 = off"
    table_rate = 9, "rad/s", "rate to which the table is set"


#: First indices of the blocks of the state: drifts, outputs held from the last sample, memory of the instruments.
DRIFT_START = len(State)
HELD_START = DRIFT_START + len(Drift)
MEMORY_START = HELD_START + len(HELD_OUTPUTS)
N_STATE = MEMORY_START + N_MEMORY


#: The bench parameters that the compiled step uses [SI].
PlantParameters = namedtuple(
    "PlantParameters",
    "rotor_inertia_x rotor_inertia_y rotor_inertia_z gimbal_inertia_x gimbal_inertia_y gimbal_inertia_z shaft_inertia "
    "flexure_stiffness_x flexure_stiffness_y flexure_damping_x flexure_damping_y bearing_coulomb bearing_viscous "
    "coil_constant coil_voltage_limit coil_resistance coil_heat_capacity coil_thermal_resistance "
    "motor_constant motor_resistance winding_heat_capacity winding_thermal_resistance "
    "motor_heat_capacity motor_thermal_resistance supply_voltage fixed_torque_x fixed_torque_y "
    "tilt_bias_x tilt_bias_y tilt_scale sample_period "
    "tilt_noise spin_angle_noise spin_rate_noise coil_voltage_noise motor_voltage_noise motor_current_noise "
    "temperature_noise pressure_noise coil_voltage_drift motor_voltage_drift motor_current_drift drift_time "
    "temperature_bias pressure_bias air_temperature gas_constant "
    "tilt_delay spin_angle_delay coil_voltage_delay motor_voltage_delay motor_current_delay "
    "tilt_filter_time coil_voltage_filter_time motor_voltage_filter_time motor_current_filter_time "
    "tilt_filter_order coil_voltage_filter_order motor_voltage_filter_order motor_current_filter_order "
    "encoder_zero encoder_once_x encoder_once_y encoder_twice_x encoder_twice_y tilt_cubic tilt_cross_talk "
    "tilt_resolution spin_angle_resolution spin_rate_resolution coil_voltage_resolution motor_voltage_resolution "
    "motor_current_resolution temperature_resolution pressure_resolution "
    "tilt_hum coil_voltage_hum motor_voltage_hum motor_current_hum mains_frequency",
)


def plant_parameters(bench: Bench) -> PlantParameters:
    """Return the parameters of a bench that the compiled step uses."""
    return PlantParameters(*map(bench.value, PlantParameters._fields))
