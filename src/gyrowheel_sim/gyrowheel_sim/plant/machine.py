"""The simulated bench: a machine with its true parameters and effects, stepped one sample at a time."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import Effect, EffectValues
from gyrowheel_sim.effects.law_code import coefficient_arrays, memory_size
from gyrowheel_sim.effects.registry import registry
from gyrowheel_sim.environment import Environment
from gyrowheel_sim.instruments import DRIFT_SIZES, LONGEST, N_NOISE, Drift, Reading
from gyrowheel_sim.plant.compiled import (
    DRIFT_START,
    HELD_START,
    N_STATE,
    State,
    Surroundings,
    compiled_plant,
    further_addresses,
    plant_parameters,
)
from gyrowheel_sim.plant.scenario import UNREGISTERED, Scenario

_LARGEST = 0.4  # of a sampling period: no stamp overtakes another


class StampClock:
    """Stamps of the samples, one after the other.

    `period`: sampling period [s]; `rate_error`: relative error of the rate; `jitter`: standard deviation of
    the random errors [s]; `seed`: seed of the random errors; not that of the readings' noise, which stays as
    it is.
    """

    def __init__(self, period: float, rate_error: float, jitter: float, seed: int) -> None:
        self._period, self._rate, self._jitter = period, rate_error, jitter
        self._rng = np.random.default_rng([seed, 0x636C6F63])
        self._next = 0

    @property
    def perfect(self) -> bool:
        """Whether every stamp is the sampling instant itself."""
        return self._rate == 0.0 and self._jitter == 0.0

    def stamps(self, count: int) -> NDArray[np.int64]:
        """Return the stamps of the next samples [ns]."""
        sample = np.arange(self._next, self._next + count, dtype=np.int64)
        self._next += count
        stamps = sample * round(self._period * 1e9)
        if self.perfect:
            return stamps
        late = stamps * self._rate * 1e-9
        if self._jitter > 0.0:
            limit = _LARGEST * self._period
            late = late + np.clip(self._jitter * self._rng.standard_normal(count), -limit, limit)
        return np.maximum(stamps + np.round(late * 1e9).astype(np.int64), 0)


_NOISE_BLOCK = 2000
_TRUTH = tuple(State)[: State.air_pressure + 1]


def compiled_effects(declared: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """Return the effects that are compiled in the plant: registered ones, and those for blind tests.

    One for blind tests is not among them if a declared one has its name.
    """
    names = {effect.name for effect in declared}
    return (*registry().values(), *(effect for effect in UNREGISTERED if effect.name not in names))


def simulated_effects(declared: Sequence[Effect] = ()) -> tuple[Effect, ...]:
    """Return all effects of the plant: the compiled ones, and declared ones, which join by their addresses."""
    return (*compiled_effects(declared), *declared)


@functools.cache
def plant_code(effects: tuple[Effect, ...]) -> ModuleType:
    """Return the compiled plant with the laws of these effects."""
    return compiled_plant(effects)


class Machine:
    """State and constant arrays of a simulated machine, as the compiled step takes them.

    Parameters
    ----------
    bench : Bench
        The bench as its file describes it.
    scenario : Scenario
        The true machine.
    initial_spin_rate : float
        Spin rate at the start [rad/s].
    effects : sequence of Effect, optional
        Effects that are compiled in the plant, all that it has; `compiled_effects` if not given, and those that the
        scenario declares join.
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
        declared = tuple(scenario.declared.values())
        #: Effects that are compiled in the plant.
        self.compiled = compiled_effects(declared) if effects is None else tuple(effects)
        library = (*self.compiled, *declared) if effects is None else self.compiled
        _check_delays(true, scenario.effects)
        self.parameters = plant_parameters(true)
        coefficients, active = coefficient_arrays(library, _checked(scenario.effects, library), bench)
        #: Coefficients and flags of the effects, and the addresses of those that join (`Further`).
        self.laws = coefficients, active, further_addresses(library, len(self.compiled), active)
        self.state = np.zeros(N_STATE + memory_size(library))
        for place in State:
            start = place.initial
            self.state[place] = true.value(start) if isinstance(start, str) else start
        self.state[State.spin_rate] = initial_spin_rate
        self.held = np.zeros(3)
        # the motor starts at the voltage that keeps the spin rate, so that a test begins at a steady speed
        self.held[2] = true.value("motor_constant") * initial_spin_rate
        self.environment = np.zeros(len(Surroundings))
        self.ambient_pressure = true.value("air_pressure")
        self.set_environment(Environment())
        self.clock = StampClock(
            true.sample_period,
            true.value("clock_rate_error"),
            true.value("clock_jitter"),
            scenario.noise_seed,
        )
        self._rng = np.random.Generator(np.random.PCG64(scenario.noise_seed))
        drifts = self._rng.standard_normal(len(Drift))
        self.state[DRIFT_START:HELD_START] = drifts * [true.value(DRIFT_SIZES[drift]) for drift in Drift]

    def noise(self, samples: int) -> NDArray[np.float64]:
        """Return the next standard normal numbers, shape (samples, N_NOISE)."""
        return self._rng.standard_normal((samples, N_NOISE))

    def set_environment(self, environment: Environment) -> None:
        """Put the bench in another environment; pressure, heater and table follow with their time constants."""
        across, (first, second) = environment.up_across, environment.home
        values = {
            Surroundings.up: environment.up,
            Surroundings.up_x: across.real,
            Surroundings.up_y: across.imag,
            Surroundings.home_xx: first.real,
            Surroundings.home_xy: first.imag,
            Surroundings.home_yx: second.real,
            Surroundings.home_yy: second.imag,
            Surroundings.pressure: environment.air_density_ratio * self.ambient_pressure,
            Surroundings.heater: environment.preheat,
            Surroundings.table_rate: environment.table_rate,
        }
        for place, value in values.items():
            self.environment[place] = value


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
        self.machine = Machine(bench, scenario, initial_spin_rate=initial_spin_rate)
        self._code = plant_code(self.machine.compiled)
        self._period_ns = round(bench.sample_period * 1e9)
        self._period = bench.sample_period
        self.sequence = 0
        self._stamp_ns = 0
        self._out = np.zeros(len(Reading))
        self._noise = self.machine.noise(_NOISE_BLOCK)
        self._row = 0
        self._events: list[Environment] = []

    @property
    def time_ns(self) -> int:
        """Time of the last sample [ns]."""
        return self.sequence * self._period_ns

    @property
    def stamp_ns(self) -> int:
        """Stamp that the clock of the instruments gave the last sample [ns]; its time, if the clock is perfect."""
        return self._stamp_ns

    def measure(self) -> NDArray[np.float64]:
        """Return the first sample (order of `Reading`); call once, before the first step."""
        m = self.machine
        self._stamp_ns = int(m.clock.stamps(1)[0])
        self._apply_events()
        self._code.plant_measure(
            m.parameters, *m.laws, m.environment, m.state, 0.0, *m.held, m.held, self._next_noise(), self._out,
        )  # fmt: skip
        return self._out

    def step(self, coil_voltage_x: float, coil_voltage_y: float, motor_voltage: float) -> NDArray[np.float64]:
        """Advance by one sample and return its readings (the array is overwritten by the next call).

        Raises InputError if a voltage is not finite. Voltages beyond the limits of the bench are held at the
        limits.
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
            m.parameters, *m.laws, m.environment, m.state, m.held,
            self.sequence * self._period, coil_voltage_x, coil_voltage_y, motor_voltage, self._next_noise(), self._out,
        )  # fmt: skip
        self.sequence += 1
        self._stamp_ns = self.time_ns if m.clock.perfect else int(m.clock.stamps(1)[0])
        self._apply_events()
        return self._out

    def schedule(self, events: Sequence[Environment]) -> None:
        """Put the bench in other environments at the times given with them."""
        self._events = sorted(events, key=lambda event: event.time)
        self._apply_events()

    def truth(self) -> dict[str, Any]:
        """Return the true state: spin axis, rates, temperatures, drift (for `/gyrowheel/truth` and tests)."""
        return {place.name: float(self.machine.state[place]) for place in _TRUTH}

    def _apply_events(self) -> None:
        while self._events and round(self._events[0].time / self._period) <= self.sequence:
            self.machine.set_environment(self._events.pop(0))

    def _next_noise(self) -> NDArray[np.float64]:
        if self._row == len(self._noise):
            self._noise, self._row = self.machine.noise(_NOISE_BLOCK), 0
        self._row += 1
        return self._noise[self._row - 1]


def _check_delays(true: Bench, effects: EffectValues) -> None:
    """Refuse a delay that the memory of the instruments does not reach."""
    period = true.sample_period
    for name in (n for n in true.parameters if n.endswith("_delay")):
        delay = true.value(name) + effects.get(name, {}).get("d", 0.0)
        if not -1.000001 * period <= delay <= 1.000001 * LONGEST * period:
            raise InputError(
                f"scenario: {name}: {delay * 1e3:g} ms is out of range; allowed: {-period * 1e3:g} .. "
                f"{LONGEST * period * 1e3:g} ms, one sample ahead to {LONGEST} samples back"
            )


def _checked(effects: EffectValues, library: Sequence[Effect]) -> EffectValues:
    known = {effect.name for effect in library}
    if stray := [name for name in effects if name not in known]:
        raise InputError(f"scenario.effects: '{stray[0]}' is not a known effect")
    return effects
