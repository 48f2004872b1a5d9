"""The layout of the plant's state, and of what surrounds it.

The state is one flat array: the places of `State`, then the drifts of the instruments
(`gyrowheel_sim.instruments.readings.Drift`), then what the laws that are evaluated once a sample gave at the last
sample (`gyrowheel_sim.effects.targets`), then what instruments with delays and filters remember
(`gyrowheel_sim.instruments.memory`).
"""

from __future__ import annotations

from gyrowheel_sim.columns import Column
from gyrowheel_sim.effects.targets import HELD_OUTPUTS
from gyrowheel_sim.instruments.memory import N_MEMORY
from gyrowheel_sim.instruments.readings import Drift


class State(Column):
    """Places of the state of the machine itself."""

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
    """Places of the array of what the operator has set, and of directions in case axes."""

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


#: Where the drifts begin in the state, and where what is held from the last sample begins.
DRIFT_START = len(State)
HELD_START = DRIFT_START + len(Drift)
MEMORY_START = HELD_START + len(HELD_OUTPUTS)
N_STATE = MEMORY_START + N_MEMORY
