"""The plant of a model as a Python module that needs NumPy alone."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.instruments import N_NOISE, Reading
from gyrowheel_sim.plant.compiled import DRIFT_START, HELD_START, PlantParameters, State, plant_source
from gyrowheel_sim.plant.machine import Machine, simulated_effects
from gyrowheel_sim.plant.scenario import Scenario

_HEADER = '''\
"""{title}

The bench {bench} with the effects {effects}: rotor on its flexures, coils, motor, thermal states and readings without
noise. Generated; needs Python 3.11 and NumPy. SI units.

    wheel = Wheel(spin_rate=300.0)
    reading = wheel.step(coil_voltage_x=0.1, coil_voltage_y=0.0, motor_voltage=9.2)  # after one sample
    reading["tilt_x"]

A voltage acts one sample after the step that has it, as on a computer that writes its outputs at the next tick.
"""

import math
from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np


def njit(function=None, **options):
    """Leave a function as it is."""
    return (lambda own: own) if function is None else function


register_jitable = njit


def call_laws(address, coef, active, state, q, sums):
    """Return the sums of the laws: every law is in this module."""
    return sums
'''
_WHEEL = '''
PlantParameters = namedtuple("PlantParameters", {fields})
PARAMETERS = PlantParameters(*{parameters})
COEFFICIENTS = np.array({coefficients})
ACTIVE = np.array({active}, dtype=np.uint8)
FURTHER = np.zeros({further}, dtype=np.int64)
SURROUNDINGS = np.array({environment})
START = {state}
INITIAL_SPIN_RATE = {spin_rate}  # rad/s
#: Readings of a sample and their units.
UNITS = {units}


class Wheel:
    """The bench, one sample after the other, from rest of the tilt at a spin rate [rad/s]."""

    def __init__(self, spin_rate=INITIAL_SPIN_RATE):
        self.state, self.time = np.array(START), 0.0
        self.state[State.spin_rate] = spin_rate
        self.held = np.array([0.0, 0.0, PARAMETERS.motor_constant * spin_rate])
        self._noise, self._out = np.zeros({noise}), np.zeros(len(UNITS))
        plant_measure(
            PARAMETERS, COEFFICIENTS, ACTIVE, FURTHER, SURROUNDINGS, self.state, 0.0, *self.held, self.held,
            self._noise, self._out,
        )

    @property
    def reading(self):
        """The readings of the last sample, by name."""
        return dict(zip(UNITS, self._out.tolist(), strict=True))

    def step(self, coil_voltage_x, coil_voltage_y, motor_voltage):
        """Advance by one sample and return its readings, by name."""
        plant_advance(
            PARAMETERS, COEFFICIENTS, ACTIVE, FURTHER, SURROUNDINGS, self.state, self.held, self.time,
            coil_voltage_x, coil_voltage_y, motor_voltage, self._noise, self._out,
        )
        self.time += PARAMETERS.sample_period
        return self.reading
'''


def python_module(bench: Bench, scenario: Scenario) -> str:
    """Return the source of a Python module with the class ``Wheel``: a machine without noise.

    Parameters
    ----------
    bench : Bench
        The bench as its file describes it.
    scenario : Scenario
        Parameters and effects of the machine.
    """
    names = list(scenario.effects)
    every = simulated_effects(tuple(scenario.declared.values()))
    library = [effect for effect in every if effect.name in scenario.effects]
    spin = bench.value("spin_rate_reference")
    machine = Machine(bench, scenario, initial_spin_rate=spin, effects=library)
    coefficients, active, further = machine.laws
    machine.state[State.spin_rate] = 0.0
    machine.state[DRIFT_START:HELD_START] = 0.0
    header = _HEADER.format(
        title="The plant of a GyroWheel test bench.", bench=bench.name, effects=", ".join(names) or "(none)"
    )
    wheel = _WHEEL.format(
        fields=list(PlantParameters._fields),
        parameters=_numbers(machine.parameters),
        coefficients=_numbers(coefficients),
        active=active.tolist(),
        further=len(further),
        environment=_numbers(machine.environment),
        state=_numbers(machine.state),
        units=json.dumps({place.name: place.unit for place in Reading}),
        spin_rate=repr(float(spin)),
        noise=N_NOISE,
    )
    return f"{header}\n{plant_source(library)}\n{wheel}"


def _numbers(values: Any) -> list[float]:
    """Return numbers as Python has them, to the last digit."""
    return [float(value) for value in np.asarray(values, dtype=np.float64)]
