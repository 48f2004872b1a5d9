"""The bench parameters that the compiled plant uses."""

from __future__ import annotations

from typing import NamedTuple

from gyrowheel_sim.bench import Bench


class PlantParameters(NamedTuple):
    """The bench parameters that the compiled step uses [SI]."""

    rotor_inertia_x: float
    rotor_inertia_y: float
    rotor_inertia_z: float
    gimbal_inertia_x: float
    gimbal_inertia_y: float
    gimbal_inertia_z: float
    shaft_inertia: float
    flexure_stiffness_x: float
    flexure_stiffness_y: float
    flexure_damping_x: float
    flexure_damping_y: float
    bearing_coulomb: float
    bearing_viscous: float
    coil_constant: float
    coil_voltage_limit: float
    coil_resistance: float
    coil_heat_capacity: float
    coil_thermal_resistance: float
    motor_constant: float
    motor_resistance: float
    winding_heat_capacity: float
    winding_thermal_resistance: float
    motor_heat_capacity: float
    motor_thermal_resistance: float
    supply_voltage: float
    fixed_torque_x: float
    fixed_torque_y: float
    tilt_bias_x: float
    tilt_bias_y: float
    tilt_scale: float
    sample_period: float
    tilt_noise: float
    spin_angle_noise: float
    spin_rate_noise: float
    coil_voltage_noise: float
    motor_voltage_noise: float
    motor_current_noise: float
    temperature_noise: float
    pressure_noise: float
    coil_voltage_drift: float
    motor_voltage_drift: float
    motor_current_drift: float
    drift_time: float
    temperature_bias: float
    pressure_bias: float
    air_temperature: float
    gas_constant: float
    tilt_delay: float
    spin_angle_delay: float
    coil_voltage_delay: float
    motor_voltage_delay: float
    motor_current_delay: float
    tilt_filter_time: float
    coil_voltage_filter_time: float
    motor_voltage_filter_time: float
    motor_current_filter_time: float
    tilt_filter_order: float
    coil_voltage_filter_order: float
    motor_voltage_filter_order: float
    motor_current_filter_order: float
    encoder_zero: float
    encoder_once_x: float
    encoder_once_y: float
    encoder_twice_x: float
    encoder_twice_y: float
    tilt_cubic: float
    tilt_cross_talk: float
    tilt_resolution: float
    spin_angle_resolution: float
    spin_rate_resolution: float
    coil_voltage_resolution: float
    motor_voltage_resolution: float
    motor_current_resolution: float
    temperature_resolution: float
    pressure_resolution: float
    tilt_hum: float
    coil_voltage_hum: float
    motor_voltage_hum: float
    motor_current_hum: float
    mains_frequency: float

    @classmethod
    def of(cls, bench: Bench) -> PlantParameters:
        """Take the values from a bench."""
        return cls(*(bench.value(name) for name in cls._fields))
