"""The controller compiled alone, as its node has it, and with the plant, as the closed loop has it, are one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrowheel_control.loops.controller import Controller, controller_parameters, loop_code
from gyrowheel_control.loops.kernel import ControllerState, SetpointColumn
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.instruments import Reading


@pytest.mark.parametrize("spin_loop", ["pi", "pll"])
@pytest.mark.parametrize("name", Bench.shipped())
def test_controller_alone_and_in_the_loop_give_identical_commands(name: str, spin_loop: str) -> None:
    bench = replace(Bench.load(name), spin_loop=spin_loop)  # type: ignore[arg-type]
    draw = np.random.default_rng(1)
    samples = np.zeros((2000, len(Reading)))
    samples[:, [Reading.tilt_x, Reading.tilt_y]] = draw.normal(0.0, 0.05, (2000, 2))
    samples[:, Reading.spin_angle] = draw.uniform(-np.pi, np.pi, 2000)
    samples[:, Reading.spin_rate] = draw.uniform(0.0, bench.value("spin_rate_maximum"), 2000)
    setpoints = draw.normal(0.0, 0.1, (2000, len(SetpointColumn)))
    setpoints[:, SetpointColumn.spin_rate] = samples[::-1, Reading.spin_rate]

    code = loop_code()
    constants = code.ControllerParameters(*controller_parameters(bench, bench.gains))
    state = np.zeros(len(ControllerState))
    together = [
        code.controller_update(
            constants, state,
            *(sample[k] for k in (Reading.tilt_x, Reading.tilt_y, Reading.spin_angle, Reading.spin_rate)),
            x, y, x_rate, y_rate, spin, acceleration,
        )
        for sample, (x, y, x_rate, y_rate, spin, acceleration) in zip(samples, setpoints, strict=True)
    ]  # fmt: skip
    controller = Controller(bench)
    alone = [
        controller.update(sample, setpoint, 0.0)
        for sample, setpoint in zip(samples.tolist(), setpoints.tolist(), strict=True)
    ]
    assert np.array(alone).tobytes() == np.array(together).tobytes()
    assert np.isfinite(alone).all()
