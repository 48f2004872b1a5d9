"""The table of channels: what follows from a declaration, and that a declaration alone adds a channel."""

from __future__ import annotations

import numpy as np
import pytest

from gyrowheel_analysis import channels
from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import ALL_ROWS, AVERAGE_ROWS, CHANNELS, DRIFTS, LISTED, TORQUES, Channel
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.reduction.segmentation import planned_windows
from gyrowheel_analysis.residuals.growth import pattern
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench

BENCH = Bench.load()


def test_rows_and_names_are_unique_and_the_contract_is_kept() -> None:
    assert len(set(ALL_ROWS)) == len(ALL_ROWS) == sum(len(c.rows) for c in CHANNELS.values())
    # names in the results' JSON
    assert TORQUES == ("tilt_x", "tilt_y", "spin")
    assert set(LISTED) - set(TORQUES) == {
        "tilt_1n", "tilt_2n", "angle_1n", "angle_2n", "spin_ripple", "motor_voltage", "voltage_ripple",
    }  # fmt: skip
    assert len({c.title for c in LISTED.values()}) == len(LISTED)
    # what carries a drift is an average, and the other way round
    assert tuple(row for c in channels.in_groups("average") for row in c.rows) == AVERAGE_ROWS
    assert {c.group for c in CHANNELS.values() if c.drift} == {"average"}
    assert all(c.drift for c in channels.in_groups("average"))


def test_every_channel_has_its_physics_and_its_patterns() -> None:
    balance = Balance(planned_windows(Plan.load("quick"), BENCH), BENCH)
    assert len(balance) == len(ALL_ROWS) * len(balance.windows)
    problem = Problem.of([balance], BENCH)
    assert np.all(problem.noise.deviation() > 0.0)
    assert set(problem.noise.scales) == set(DRIFTS)
    for channel in CHANNELS.values():
        load = np.ones(len(balance.windows))
        for name in channel.patterns:
            assert len(pattern(name, balance.windows, load)) == len(balance.windows)


def test_a_declaration_alone_adds_a_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    declared = Channel(
        "again", ("again_x", "again_y"), "tilt 1N again", "N·m", "revolution", "coil_torque",
        "coil torque once a revolution", "the torque of the coils once a revolution", ("still",), order=1,
    )  # fmt: skip
    windows = planned_windows(Plan.load("quick"), BENCH)
    before = Problem.of([Balance(windows, BENCH)], BENCH)
    monkeypatch.setattr(channels, "_DECLARED", (*CHANNELS.values(), declared))
    after = Problem.of([Balance(windows, BENCH)], BENCH)
    (old,), (new,) = before.balances, after.balances
    assert set(new.rows) - set(old.rows) == set(declared.rows)
    for row, source in zip(declared.rows, CHANNELS["tilt_1n"].rows, strict=True):
        assert np.array_equal(after.base[new.row(row)], before.base[old.row(source)])
        assert np.array_equal(
            after.noise.deviation()[new.row(row)], before.noise.deviation()[old.row(source)]
        )
        assert np.ptp(after.base_jacobian[new.row(row)]) > 0.0
    # the rows that were there stay as they are
    assert np.array_equal(after.base[new.row("voltage_ripple_y")], before.base[old.row("voltage_ripple_y")])
