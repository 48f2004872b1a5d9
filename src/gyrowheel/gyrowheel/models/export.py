"""A model for other programs: as a Python module, and as a functional mock-up unit (FMI 2.0, co-simulation)."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from gyrowheel_core.errors import InputError
from gyrowheel_core.files import write_bytes, write_text

if TYPE_CHECKING:
    from gyrowheel_analysis.model import Model

FORMATS = {"python": ".py", "fmu": ".fmu"}
_SLAVE = '''\
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

import gyrowheel_plant as plant


class GyroWheel(Fmi2Slave):
    """The plant of a GyroWheel test bench, stepped at the rate of its samples."""

    description = "GyroWheel test bench: coil and motor voltages in, readings out"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.initial_spin_rate = plant.INITIAL_SPIN_RATE
        self.coil_voltage_x = self.coil_voltage_y = self.motor_voltage = 0.0
        self._wheel = plant.Wheel()
        for name, value in self._wheel.reading.items():
            setattr(self, f"reading_{name}", value)
        parameter = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
        self.register_variable(Real("initial_spin_rate", **parameter, description="rad/s"))
        for name in ("coil_voltage_x", "coil_voltage_y", "motor_voltage"):
            self.register_variable(Real(name, causality=Fmi2Causality.input, description="V"))
        for name, unit in plant.UNITS.items():
            self.register_variable(Real(f"reading_{name}", causality=Fmi2Causality.output, description=unit))

    def exit_initialization_mode(self):
        self._wheel = plant.Wheel(self.initial_spin_rate)
        self._show(self._wheel.reading)

    def do_step(self, current_time, step_size):
        period = plant.PARAMETERS.sample_period
        count = round(step_size / period)
        if count < 1 or abs(count * period - step_size) > 1e-6 * period:
            raise ValueError(f"step of {step_size:g} s; allowed: multiples of {period:g} s")
        for _ in range(count):
            reading = self._wheel.step(self.coil_voltage_x, self.coil_voltage_y, self.motor_voltage)
        self._show(reading)
        return True

    def _show(self, reading):
        for name, value in reading.items():
            setattr(self, f"reading_{name}", value)
'''


def export(model: Model, path: Path, form: str | None) -> None:
    """Write the plant of a model, without noise, in one of `FORMATS`; None: the one of the path's ending.

    Raises
    ------
    InputError
        If the format is not known, its package is not installed, or the file cannot be written.
    """
    from gyrowheel_sim.plant.export import python_module
    from gyrowheel_sim.plant.scenario import Scenario

    if form is not None and form not in FORMATS:
        raise InputError(f"format: {form!r} is not allowed; allowed: {', '.join(FORMATS)}")
    allowed = FORMATS if form is None else {form: FORMATS[form]}
    if path.suffix not in allowed.values():
        raise InputError(f"{path}: must end in {' or '.join(allowed.values())}")
    values = {name: override.value for name, override in model.overrides.items()}
    effects = {name: dict(given) for name, given in model.effects.items()}
    text = python_module(model.stated_bench, Scenario(values, effects, declared=dict(model.declared)))
    if path.suffix == FORMATS["python"]:
        write_text(path, text)
        return
    try:
        from pythonfmu import FmuBuilder
    except ImportError:
        raise InputError("format fmu: needs the package pythonfmu: pip install 'gyrowheel[fmu]'") from None
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        module, slave = folder / "gyrowheel_plant.py", folder / "gyrowheel_slave.py"
        module.write_text(text, encoding="utf-8")
        slave.write_text(_SLAVE, encoding="utf-8")
        made = FmuBuilder.build_FMU(slave, dest=folder, project_files=[module])
        write_bytes(path, made.read_bytes())
