"""Our bench for the benchmarks: the only module with the arguments of the compiled step."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gyrowheel_control.loops.controller import Controller, loop_code
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.compiled import PlantParameters
from gyrowheel_sim.plant.machine import Machine, Plant
from gyrowheel_sim.plant.scenario import Scenario

#: n_x, n_y, their rates, shaft angle and spin rate: the part of the state that every integrator has.
MECHANICAL = 6


@functools.cache
def bench() -> Bench:
    """Return the default bench."""
    return Bench.load()


def quiet() -> Scenario:
    """Return a machine without noise and drift, exactly as in its bench file."""
    return Scenario(values={name: 0.0 for name in bench().values() if name.endswith(("_noise", "_drift"))})


class Held(NamedTuple):
    """Record of the closed loop: a state, and the voltages that act from then on.

    Attributes
    ----------
    machine : Machine
        The machine; its state is that at the end of the record.
    state : ndarray
        State of the compiled step at the start of the record.
    voltages : ndarray (n, 3)
        Voltages of the coils and the motor, each held for one sample [V].
    readings : ndarray (n, 11)
        The samples that these voltages answer, one sample earlier.
    """

    machine: Machine
    state: NDArray[np.float64]
    voltages: NDArray[np.float64]
    readings: NDArray[np.float64]


def hold(scenario: Scenario, tilt: float, spin_rate: float, settle: float, record: float) -> Held:
    """Hold a tilt about case x in the closed loop, and record the voltages that hold it.

    Parameters
    ----------
    scenario : Scenario
        Definition of the machine.
    tilt : float
        Tilt [rad].
    spin_rate : float
        Spin rate [rad/s].
    settle, record : float
        Time before the record, and its length [s].
    """
    plant = Plant(bench(), scenario, initial_spin_rate=spin_rate)
    plant.machine.state[1] = -np.sin(tilt)
    controller, setpoint = Controller(bench()), (tilt, 0.0, 0.0, 0.0, spin_rate, 0.0)
    first, samples = (round(time / bench().sample_period) for time in (settle, record))
    voltages, readings = np.empty((samples, 3)), np.empty((samples, 11))
    state = plant.machine.state.copy()
    reading = plant.measure()
    for k in range(first + samples):
        if k == first:
            state = plant.machine.state.copy()
        command = controller.update(reading.tolist(), setpoint, 0.0)
        if k >= first:
            voltages[k - first], readings[k - first] = plant.machine.held, reading
        reading = plant.step(*command)
    return Held(plant.machine, state, voltages, readings)


def parameters(machine: Machine, substeps: int) -> PlantParameters:
    """Return the constants of a machine for a step that is the sample period over `substeps`."""
    return machine.parameters._replace(sample_period=bench().sample_period / substeps)


def steps(
    machine: Machine, start: NDArray[np.float64], voltages: NDArray[np.float64], substeps: int = 1
) -> Callable[[], NDArray[np.float64]]:
    """Return a function that steps the plant from `start` under held voltages and gives its motion, shape (n, 6).

    Parameters
    ----------
    machine : Machine
        The machine, with its effects.
    start : ndarray
        State of the compiled step.
    voltages : ndarray (n, 3)
        Voltages, each held for one sample [V].
    substeps : int
        Steps per sample.
    """
    run, constants = _open_loop(), parameters(machine, substeps)
    states = np.empty((len(voltages), MECHANICAL))

    def go() -> NDArray[np.float64]:
        m = machine
        run(
            constants, *m.laws, m.environment, start.copy(), voltages, substeps, states,
        )  # fmt: skip
        return states

    return go


@functools.cache
def _open_loop() -> Any:
    step = loop_code().plant_step

    @njit(error_model="numpy")
    def run(
        p: Any, coef: Any, active: Any, further: Any, env: Any, state: Any, voltages: Any, substeps: int,
        states: Any,
    ) -> None:  # fmt: skip
        t = 0.0
        for k in range(len(voltages)):
            for _ in range(substeps):
                step(p, coef, active, further, env, state, t, voltages[k, 0], voltages[k, 1], voltages[k, 2])
                t += p.sample_period
            for i in range(MECHANICAL):
                states[k, i] = state[i]

    return run


def sampled_loop(tilt: float, spin_rate: float, seconds: float, substeps: int) -> NDArray[np.float64]:
    """Return the voltages (n, 3) with which the noise-free closed loop holds a tilt, with `substeps` per sample.

    The controller answers every sample; only the plant between two samples is integrated with other steps.
    """
    code = loop_code()
    machine = Machine(bench(), quiet(), initial_spin_rate=spin_rate)
    machine.state[1] = -np.sin(tilt)
    fine = parameters(machine, substeps)
    controller, setpoint = Controller(bench()), (tilt, 0.0, 0.0, 0.0, spin_rate, 0.0)
    reading, silence = np.zeros(11), machine.noise(1)[0]
    silence[:] = 0.0
    m = machine
    constant = (*m.laws, m.environment, m.state, 0.0)
    voltages = np.empty((round(seconds / bench().sample_period), 3))
    for k in range(len(voltages)):
        voltages[k] = machine.held
        code.plant_measure(machine.parameters, *constant, *machine.held, machine.held, silence, reading)
        for _ in range(substeps):
            code.plant_step(fine, *constant, *machine.held)
        machine.held[:] = controller.update(reading.tolist(), setpoint, 0.0)
    return voltages
