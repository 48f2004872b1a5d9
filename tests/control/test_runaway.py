"""A simulated machine that diverges ends the run with its time."""

from __future__ import annotations

import pytest

from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario

_PLAN = """\
schema: 1
name: short
hold_s: 0.3
segments:
  - {spin_rpm: 3000, tilt_deg: [[0, 0], [0.5, 0]]}
"""


@pytest.mark.parametrize("stiffness", [1.0e5, 1.0e300])
def test_a_machine_that_diverges_is_refused_with_the_time(stiffness: float) -> None:
    """Too stiff for its sample period: readings would be no numbers."""
    bench = Bench.load()
    values = dict.fromkeys(("flexure_stiffness_x", "flexure_stiffness_y"), stiffness)
    machine = Scenario(values=bench.with_values(values).values())
    with pytest.raises(
        InputError, match=r"plan short: the simulated machine runs away: .* at 0\.0\d+ s; allowed: "
    ):
        simulate(bench, machine, Plan.load(_PLAN))
