"""The tilt and spin controller of the bench."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel_control.loops.kernel import (
    CommandColumn,
    ControllerParameters,
    ControllerState,
    SetpointColumn,
)
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.instruments import Reading, source
from gyrowheel_sim.jit import compile_source, kernel_text
from gyrowheel_sim.parameter import Gains as Gains

if TYPE_CHECKING:
    from gyrowheel_sim.effects import Effect

_KERNEL = ("gyrowheel_control", "loops/kernel.py")


def controller_parameters(bench: Bench, gains: Gains) -> ControllerParameters:
    """Return the constants of the compiled update for a bench as its file describes it."""
    v = bench.value
    # one sample of delay and the hold of the voltage, and the lag of the derivative filter, at the nutation frequency
    lag = 2.0 * v("sample_period") + 1.0 / (2.0 * math.pi * gains.derivative_lowpass)
    transverse = bench.transverse_inertia
    return ControllerParameters(
        tilt_bandwidth=gains.tilt_bandwidth,
        tilt_integral=gains.tilt_integral,
        tilt_lowpass=gains.tilt_lowpass,
        nutation_damping=gains.nutation_damping * bench.precession_inertia * v("spin_rate_reference"),
        derivative_lowpass=gains.derivative_lowpass,
        phase_lead=bench.precession_inertia / transverse * lag,
        spin_proportional=gains.spin_proportional * bench.axial_inertia,
        spin_integral=gains.spin_integral * bench.axial_inertia,
        spin_lowpass=gains.spin_lowpass,
        stiffness=bench.flexure_stiffness,
        tuning_inertia=bench.tuning_inertia,
        spin_inertia=bench.precession_inertia,
        axial_inertia=bench.axial_inertia,
        spin_rate_reference=v("spin_rate_reference"),
        coil_constant=v("coil_constant"),
        coil_voltage_limit=v("coil_voltage_limit"),
        motor_constant=v("motor_constant"),
        motor_resistance=v("motor_resistance"),
        supply_voltage=v("supply_voltage"),
        friction_coulomb=v("bearing_coulomb"),
        friction_viscous=v("bearing_viscous"),
        sample_period=v("sample_period"),
        phase_locked=float(bench.spin_loop == "pll"),
    )


@functools.cache
def _code() -> ModuleType:
    """Return the compiled module of the controller alone, which its node needs without the plant."""
    text = f"{source(ControllerState)}\n\n{kernel_text(*_KERNEL)}"
    return compile_source(text, "the tilt and spin loops")


@functools.cache
def loop_code(effects: tuple[Effect, ...] | None = None) -> ModuleType:
    """Return the compiled module of plant, controller and closed loop with the laws of these effects.

    Those of `gyrowheel_sim.plant.machine.compiled_effects` if not given.
    """
    # the laws of the plant need SymPy, which takes long to load and which a controller alone does not need
    from gyrowheel_sim.plant.compiled import compiled_plant
    from gyrowheel_sim.plant.machine import compiled_effects

    return compiled_plant(
        compiled_effects() if effects is None else effects,
        (_KERNEL, ("gyrowheel_control", "loops/loop_kernel.py")),
        (ControllerState, SetpointColumn, CommandColumn),
    )


class Controller:
    """The tilt and spin loops, one sample at a time.

    `bench`: the bench as its file describes it: the controller knows nothing else; `gains`: gains of the
    loops; those of the bench file if not given.
    """

    def __init__(self, bench: Bench, gains: Gains | None = None) -> None:
        self._update: Any = _code().controller_update
        self._bench = bench
        self.tune(gains or bench.gains)
        self._state = np.zeros(len(ControllerState))
        # compiled code is loaded at its first call, which takes seconds: now rather than in a loop that is paced
        self.update((0.0,) * len(Reading), (0.0,) * 6, 0.0)
        self.reset()

    def tune(self, gains: Gains) -> None:
        """Change the gains from the next sample on; filters and integrals keep their state."""
        # the compiled module has a class of its own for the constants; the compiler tells the two apart
        self._parameters = _code().ControllerParameters(*controller_parameters(self._bench, gains))

    def reset(self) -> None:
        """Forget everything; the next sample starts the filters."""
        self._state[:] = 0.0

    def update(
        self, measurement: Sequence[float], setpoint: Sequence[float], age_s: float
    ) -> tuple[float, float, float]:
        """Return (coil voltage x, coil voltage y, motor voltage) [V] that answer one sample.

        `measurement`: the sample (`gyrowheel_sim.instruments.Reading`); `setpoint`: the setpoint
        (`gyrowheel_control.loops.kernel.SetpointColumn`); `age_s`: time of the sample minus time of the
        setpoint [s]; the setpoint is continued by its rates.
        """
        x, y, x_rate, y_rate, spin, acceleration = setpoint
        return self._update(
            self._parameters, self._state,
            measurement[Reading.tilt_x], measurement[Reading.tilt_y],
            measurement[Reading.spin_angle], measurement[Reading.spin_rate],
            x + x_rate * age_s, y + y_rate * age_s, x_rate, y_rate, spin + acceleration * age_s, acceleration,
        )  # fmt: skip
