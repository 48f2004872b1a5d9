"""The simulated bench: a machine with its true parameters and effects, stepped one sample at a time."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind.outside import OUTSIDE
from gyrowheel_sim.effects.code import coefficient_arrays, compose
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.registry import EffectValues, registry
from gyrowheel_sim.environment import Environment
from gyrowheel_sim.plant.kernel import N_ENVIRONMENT, N_MEASUREMENT, N_NOISE, N_STATE
from gyrowheel_sim.plant.scenario import Scenario

#: Readings of one sample, in the order of the Measurement message.
MEASUREMENT_FIELDS = (
    "tilt_x",
    "tilt_y",
    "spin_angle",
    "spin_rate",
    "coil_voltage_x",
    "coil_voltage_y",
    "motor_voltage",
    "motor_current",
    "coil_temperature",
    "air_temperature",
    "air_pressure",
)
_NOISE_BLOCK = 2000


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

    @classmethod
    def of(cls, bench: Bench) -> PlantParameters:
        """Take the values from a bench."""
        return cls(*(bench.value(name) for name in cls._fields))


@functools.cache
def simulated_effects(declared: tuple[Effect, ...] = ()) -> tuple[Effect, ...]:
    """Return every effect that the plant can have: the registered ones, those for blind tests, and those declared."""
    names = {effect.name for effect in declared}
    return (*registry().values(), *(effect for effect in OUTSIDE if effect.name not in names), *declared)


@functools.cache
def plant_code(declared: tuple[Effect, ...] = ()) -> ModuleType:
    """Return the compiled plant with the laws of every effect that it can have."""
    return compose(simulated_effects(declared))


class Machine:
    """State and constant arrays of a simulated machine, as the compiled step takes them.

    Parameters
    ----------
    bench : Bench
        The bench as its file describes it.
    scenario : Scenario
        What the machine really is.
    initial_spin_rate : float
        Spin rate at the start [rad/s].
    effects : sequence of Effect, optional
        Effects compiled in; all registered ones and those that the scenario declares if not given.
    """

    def __init__(
        self,
        bench: Bench,
        scenario: Scenario,
        *,
        initial_spin_rate: float,
        effects: Sequence[Effect] | None = None,
    ) -> None:
        if not math.isfinite(initial_spin_rate) or not 0.0 <= initial_spin_rate <= 1.2 * bench.value(
            "spin_rate_maximum"
        ):
            raise InputError(
                f"initial_spin_rate: {initial_spin_rate:g} is out of range; "
                f"allowed: 0 .. {1.2 * bench.value('spin_rate_maximum'):.0f} rad/s"
            )
        true = bench.with_values(scenario.values, where="scenario.values")
        library = simulated_effects(tuple(scenario.declared.values())) if effects is None else tuple(effects)
        self.parameters = PlantParameters.of(true)
        self.coefficients, self.active = coefficient_arrays(
            library, _checked(scenario.effects, library), bench
        )
        self.state = np.zeros(N_STATE)
        self.state[5] = initial_spin_rate
        self.state[6] = true.value("air_temperature")
        self.state[7] = true.value("air_pressure")
        # the motor is cold at the start
        self.state[12] = self.state[13] = true.value("air_temperature")
        self.held = np.zeros(3)
        # the motor starts at the voltage that keeps the spin rate, so that a test does not begin with a jerk
        self.held[2] = true.value("motor_constant") * initial_spin_rate
        self.environment = np.zeros(N_ENVIRONMENT)
        self.ambient_pressure = true.value("air_pressure")
        self.set_environment(Environment())
        self._rng = np.random.Generator(np.random.PCG64(scenario.noise_seed))
        drift = self._rng.standard_normal(4)
        self.state[8:12] = drift * [
            self.parameters.coil_voltage_drift,
            self.parameters.coil_voltage_drift,
            self.parameters.motor_voltage_drift,
            self.parameters.motor_current_drift,
        ]

    def noise(self, samples: int) -> NDArray[np.float64]:
        """Return the next standard normal numbers, shape (samples, N_NOISE)."""
        return self._rng.standard_normal((samples, N_NOISE))

    def set_environment(self, environment: Environment) -> None:
        """Put the bench in another environment; pressure, heater and table follow with their time constants."""
        across, (first, second) = environment.up_across, environment.home
        self.environment[:] = (
            environment.up,
            across.real,
            across.imag,
            first.real,
            first.imag,
            second.real,
            second.imag,
            environment.air_density_ratio * self.ambient_pressure,
            environment.preheat,
            environment.table_rate,
        )


class Plant:
    """The simulated bench, sample by sample.

    Parameters are those of `Machine`. A command acts one sample after the sample that it answers.

    Examples
    --------
    >>> plant = Plant(Bench.load(), Scenario.nominal(), initial_spin_rate=300.0)
    >>> reading = plant.measure()
    >>> reading = plant.step(0.0, 0.0, 9.2)
    """

    def __init__(self, bench: Bench, scenario: Scenario, *, initial_spin_rate: float) -> None:
        self._code = plant_code(tuple(scenario.declared.values()))
        self.machine = Machine(bench, scenario, initial_spin_rate=initial_spin_rate)
        self._period_ns = round(bench.sample_period * 1e9)
        self._period = bench.sample_period
        self.sequence = 0
        self._out = np.zeros(N_MEASUREMENT)
        self._noise = self.machine.noise(_NOISE_BLOCK)
        self._row = 0
        self._events: list[Environment] = []

    @property
    def time_ns(self) -> int:
        """Time of the last sample [ns]."""
        return self.sequence * self._period_ns

    def measure(self) -> NDArray[np.float64]:
        """Return the first sample (order of `MEASUREMENT_FIELDS`); call once, before the first step."""
        m = self.machine
        self._apply_events()
        self._code.plant_measure(
            m.parameters,
            m.coefficients,
            m.active,
            m.environment,
            m.state,
            0.0,
            *m.held,
            self._next_noise(),
            self._out,
        )
        return self._out

    def step(self, coil_voltage_x: float, coil_voltage_y: float, motor_voltage: float) -> NDArray[np.float64]:
        """Advance by one sample and return its readings (the array is overwritten by the next call).

        Raises
        ------
        InputError
            If a voltage is not finite. Voltages beyond the limits of the bench are held at the limits.
        """
        if not (
            math.isfinite(coil_voltage_x) and math.isfinite(coil_voltage_y) and math.isfinite(motor_voltage)
        ):
            raise InputError(
                f"command for sample {self.sequence}: coil_voltage_x {coil_voltage_x}, coil_voltage_y "
                f"{coil_voltage_y}, motor_voltage {motor_voltage}: every voltage must be finite"
            )
        m = self.machine
        self._code.plant_advance(
            m.parameters, m.coefficients, m.active, m.environment, m.state, m.held,
            self.sequence * self._period, coil_voltage_x, coil_voltage_y, motor_voltage, self._next_noise(), self._out,
        )  # fmt: skip
        self.sequence += 1
        self._apply_events()
        return self._out

    def schedule(self, events: Sequence[Environment]) -> None:
        """Put the bench in other environments at the times given with them."""
        self._events = sorted(events, key=lambda event: event.time)
        self._apply_events()

    def truth(self) -> dict[str, Any]:
        """Return the true state: spin axis, rates, temperatures, drift (for `/gyrowheel/truth` and tests)."""
        names = [
            "n_x",
            "n_y",
            "n_x_rate",
            "n_y_rate",
            "spin_angle",
            "spin_rate",
            "coil_temperature",
            "air_pressure",
        ]
        return dict(zip(names, self.machine.state.tolist(), strict=False))

    def _apply_events(self) -> None:
        while self._events and round(self._events[0].time / self._period) <= self.sequence:
            self.machine.set_environment(self._events.pop(0))

    def _next_noise(self) -> NDArray[np.float64]:
        if self._row == len(self._noise):
            self._noise, self._row = self.machine.noise(_NOISE_BLOCK), 0
        self._row += 1
        return self._noise[self._row - 1]


def _checked(effects: EffectValues, library: Sequence[Effect]) -> EffectValues:
    known = {effect.name for effect in library}
    if stray := [name for name in effects if name not in known]:
        raise InputError(f"scenario.effects: '{stray[0]}' is not a known effect")
    return effects
