"""The compiled plant: layout of its arrays, and its module of laws, mechanics and instruments."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Sequence
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.law_code import cached_laws_source, entries_source
from gyrowheel_sim.effects.targets import HELD_OUTPUTS
from gyrowheel_sim.instruments import (
    FILTERS,
    N_FILTER,
    N_MEMORY,
    N_ROWS,
    ROWS,
    WIDTH,
    Chain,
    Column,
    Drift,
    Past,
    Reading,
    source,
)
from gyrowheel_sim.jit import compile_source, kernel_text


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


class Further(Column):
    """Indices into the addresses of the functions of laws that are not compiled in the plant; 0 for no function."""

    evaluate_laws = 0, "1", "laws at an instant"
    evaluate_samples = 1, "1", "laws that are evaluated once a sample"
    law_rates = 2, "1", "rates of the states of effects"
    law_starts = 3, "1", "start values of the states"


#: First indices of the blocks of the state: drifts, outputs held from the last sample, memory of the instruments.
DRIFT_START = len(State)
HELD_START = DRIFT_START + len(Drift)
MEMORY_START = HELD_START + len(HELD_OUTPUTS)
#: Length of the state without the states of effects, which follow (`law_code.memory_size`).
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


_TEMPLATE = """\
# ---- indices into the arrays, and their blocks
{indices}
DRIFT_START, MEMORY_START = {drift_start}, {memory_start}
N_ROWS, N_FILTER, FILTERS, ROWS, WIDTH = {memory_sizes}

# ---- equations of motion
{mechanics}
# ---- inputs and outputs of the laws of the effects
{law_interface}
# ---- the laws, generated from the declarations
{laws}
# ---- the places at which the laws enter the kernels, generated from the law targets
{law_entries}
# ---- instruments
{instruments}
# ---- plant
{plant}
# ---- further kernels
{further}
"""


def compiled_plant(
    effects: Sequence[Effect], extra: Sequence[tuple[str, str]] = (), layouts: Sequence[type[Column]] = ()
) -> ModuleType:
    """Return the compiled module of the plant with these effects, as `plant_source`; cached on disk by content."""
    text = plant_source(effects, extra, layouts)
    return compile_source(text, "the laws of the effects and the kernels of the bench")


def further_addresses(effects: Sequence[Effect], first: int, active: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the addresses (`Further`) of the laws of the effects from number `first` on, if one of them is active.

    `effects` are all effects of the plant, which make the layout of its arrays; `active` has a flag for each.
    """
    result = np.zeros(len(Further), dtype=np.int64)
    if any(active[first:]):
        code = compile_source(
            cached_laws_source(tuple(effects), N_STATE, first), "the laws of further effects"
        )
        for place in Further:
            function = getattr(code, place.name, None)
            result[place] = 0 if function is None else function.address
    return result


def plant_source(
    effects: Sequence[Effect], extra: Sequence[tuple[str, str]] = (), layouts: Sequence[type[Column]] = ()
) -> str:
    """Return the source of the plant with these effects.

    Parameters
    ----------
    effects : sequence of Effect
        Effects whose laws are compiled in; each acts only where its flag is set.
    extra : sequence of (package, file name)
        Further kernel files that are appended (a controller, a closed loop); see `gyrowheel_sim.jit`.
    layouts : sequence of Column
        Array indices that those files use.
    """
    indices: tuple[type[Column], ...] = (State, Surroundings, Further, Reading, Drift, Past, Chain, *layouts)
    return _TEMPLATE.format(
        indices="\n".join(map(source, indices)),
        drift_start=DRIFT_START,
        memory_start=MEMORY_START,
        memory_sizes=(N_ROWS, N_FILTER, FILTERS, ROWS, WIDTH),
        mechanics=kernel_text("gyrowheel_sim", "mechanics/dynamics.py"),
        law_interface=kernel_text("gyrowheel_sim", "effects/law_code.py"),
        laws=cached_laws_source(tuple(effects), N_STATE),
        law_entries=entries_source(PlantParameters._fields, HELD_START),
        instruments=kernel_text("gyrowheel_sim", "instruments/kernel.py"),
        plant=kernel_text("gyrowheel_sim", "plant/kernel.py"),
        further="\n".join(kernel_text(package, name) for package, name in extra),
    )
