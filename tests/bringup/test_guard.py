"""The guard between the commands and the machine, and the clock that paces it; no ROS, no waiting."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant import real_time
from gyrowheel_sim.plant.machine import Plant
from gyrowheel_sim.plant.protection import (
    HELD_SHARE,
    NONSENSE,
    STOP_SAMPLES,
    Guard,
    GuardLimits,
    GuardState,
    Refusal,
)
from gyrowheel_sim.plant.real_time import Pacer, RealTime, Statistics
from gyrowheel_sim.plant.scenario import Scenario

LIMITS = GuardLimits(
    coil_voltage=10.0, motor_voltage=24.0, tilt_stop=math.radians(5.0), watchdog=8, oldest=3, spin_down=0.5
)


def started(limits: GuardLimits = LIMITS) -> Guard:
    guard = Guard(limits, motor_voltage=11.0)
    guard.start()
    return guard


def test_nothing_acts_before_the_start_and_after_the_stop():
    guard = Guard(LIMITS, motor_voltage=11.0)
    assert guard.report() is GuardState.STOPPED
    assert guard.output() == (0.0, 0.0, 0.0)
    guard.start()
    assert guard.report() is GuardState.WAITING
    assert guard.output() == (0.0, 0.0, 11.0)  # as the machine is found
    assert guard.take(0, 0, 1.0, 2.0, 12.0) is None
    assert guard.output() == (1.0, 2.0, 12.0)
    assert guard.report() is GuardState.NORMAL
    guard.stop()
    assert guard.off
    guard.take(1, 1, 1.0, 2.0, 12.0)
    assert guard.output() == (0.0, 0.0, 0.0)
    assert guard.report() is GuardState.STOPPED


@pytest.mark.parametrize(
    ("command", "why"),
    [
        ((5, 5, math.nan, 0.0, 1.0), Refusal.NOT_FINITE),
        ((5, 5, 0.0, -math.inf, 1.0), Refusal.NOT_FINITE),
        ((5, 5, 0.0, 0.0, 1e9), Refusal.OUT_OF_RANGE),
        ((5, 5, -20.1, 0.0, 1.0), Refusal.OUT_OF_RANGE),
        ((6, 5, 0.0, 0.0, 1.0), Refusal.AHEAD),
        ((4, 5, 0.0, 0.0, 1.0), Refusal.STALE),  # answered already
        ((1, 5, 0.0, 0.0, 1.0), Refusal.STALE),
        ((9, 13, 0.0, 0.0, 1.0), Refusal.STALE),  # too old
    ],
)
def test_commands_that_make_no_sense_are_refused_and_the_last_one_holds(
    command: tuple[int, int, float, float, float], why: Refusal
) -> None:
    guard = started()
    guard.take(4, 4, 1.0, -2.0, 9.0)
    guard.output()
    assert guard.take(*command) is why
    assert guard.refused[Refusal(why)] == 1
    assert guard.output() == (1.0, -2.0, 9.0)
    assert guard.held == 1
    assert guard.report() is GuardState.HOLDING
    assert guard.report() is GuardState.NORMAL  # nothing has happened since


def test_voltages_beyond_the_limits_are_held_at_them():
    guard = started()
    assert guard.take(0, 0, 10.5, -15.0, 30.0) is None
    assert guard.output() == (10.0, -10.0, 24.0)
    assert guard.limited == 1
    assert guard.report() is GuardState.VOLTAGE_LIMITED
    guard.limits = GuardLimits(coil_voltage=2.0, motor_voltage=5.0, tilt_stop=0.05)
    guard.take(1, 1, 3.0, 0.0, 4.0)
    assert guard.output() == (2.0, 0.0, 4.0)


@pytest.mark.parametrize(
    ("voltage", "state"),
    [
        (3.0, GuardState.HOLDING),
        (12.0, GuardState.VOLTAGE_LIMITED),
        (math.nan, GuardState.COMMAND_REFUSED),
    ],
)
def test_a_few_samples_that_were_held_hide_nothing_else(voltage: float, state: GuardState) -> None:
    guard, samples = started(), round(2.0 / HELD_SHARE)
    for newest in range(samples):
        if newest != 5:  # one of them has no command
            guard.take(newest, newest, voltage if newest == 7 else 1.0, 0.0, 1.0)
        guard.output()
    assert 0.0 < guard.held_share <= HELD_SHARE
    assert guard.report() is state


def test_late_and_missing_commands_are_counted_and_held():
    guard = started()
    for newest in range(10):
        if newest not in (3, 4, 7):
            guard.take(newest, newest, 0.1 * newest, 0.0, 1.0)
        if newest == 8:
            guard.take(7, 8, 9.0, 9.0, 9.0)  # after that of 8: of no use any more
        guard.output()
    assert (guard.taken, guard.missing, guard.held, guard.late) == (7, 3, 3, 0)
    assert guard.refused[Refusal.STALE] == 1
    guard.take(10, 12, 0.5, 0.0, 1.0)  # late, but the newest there is
    assert guard.late == 1
    assert guard.output() == (0.5, 0.0, 1.0)


def test_loss_of_the_controller_switches_the_coils_off_and_brings_the_motor_down():
    guard = started()
    guard.take(0, 0, 3.0, 4.0, 10.0)
    outputs = [guard.output() for _ in range(LIMITS.watchdog + 1)]
    assert outputs[:-1] == [(3.0, 4.0, 10.0)] * LIMITS.watchdog
    assert outputs[-1] == (0.0, 0.0, 10.0)
    assert guard.state is GuardState.CONTROLLER_LOST
    guard.take(9, 9, 3.0, 4.0, 10.0)  # too late: somebody must look first
    motor = [guard.output()[2] for _ in range(20)]
    assert motor == [pytest.approx(9.5 - 0.5 * k) for k in range(20)]
    assert guard.off
    guard.start()
    assert (guard.trip, guard.reason) == (None, "")
    guard.take(30, 30, 1.0, 1.0, 1.0)
    assert guard.output() == (1.0, 1.0, 1.0)


def test_the_loss_of_the_controller_tells_what_came_instead():
    guard = started()
    guard.take(0, 0, 3.0, 4.0, 10.0)
    guard.take(0, 0, 3.0, 4.0, 10.0)  # refused before the silence: not told
    guard.output()
    for newest in range(1, LIMITS.watchdog + 1):
        if newest < 4:
            guard.take(0, newest, 3.0, 4.0, 10.0)
        elif newest == 5:
            guard.take(5, newest, math.nan, 4.0, 10.0)
        guard.output()
    assert guard.trip is GuardState.CONTROLLER_LOST
    assert guard.reason == "no valid command for 8 samples: 4 came and were refused (1 not finite, 3 stale)"


def test_the_hard_stop_needs_more_than_one_wrong_reading():
    guard = started()
    guard.take(0, 0, 3.0, 4.0, 10.0)
    beyond = math.radians(5.1)
    for _ in range(5):
        for _ in range(STOP_SAMPLES - 1):
            guard.observe(beyond, 0.0)
        guard.observe(0.0, 0.0)
    assert guard.trip is None
    for _ in range(STOP_SAMPLES):
        guard.observe(math.radians(3.7), math.radians(-3.7))
    assert guard.state is GuardState.TILT_STOP
    assert guard.output()[:2] == (0.0, 0.0)
    assert guard.reason == "tilt 5.23 deg, hard stop at 5.00 deg"


def test_a_tilt_that_is_no_number_is_beyond_the_hard_stop():
    guard = started()
    for _ in range(STOP_SAMPLES):
        guard.observe(math.nan, 0.0)
    assert guard.trip is GuardState.TILT_STOP


@pytest.mark.parametrize(
    "wrong", [{"coil_voltage": 0.0}, {"motor_voltage": math.nan}, {"tilt_stop": -1.0}, {"watchdog": 0}]
)
def test_limits_are_checked(wrong):
    values = {"coil_voltage": 1.0, "motor_voltage": 1.0, "tilt_stop": 0.1} | wrong
    (name,) = wrong
    with pytest.raises(InputError, match=rf"guard\.{name}"):
        GuardLimits(**values)


class Machine(RuleBasedStateMachine):
    """Whatever comes, what leaves is within the limits, and a trip is final."""

    def __init__(self) -> None:
        super().__init__()
        self.guard = started()
        self.newest = 0
        self.last = self.guard.voltages

    @rule(
        back=st.integers(-2, 6),
        x=st.floats(),
        y=st.floats(-30.0, 30.0),
        motor=st.floats(-60.0, 60.0) | st.floats(),
    )
    def command(self, back: int, x: float, y: float, motor: float) -> None:
        before, state = self.guard.voltages, self.guard.trip
        answered = max(self.newest - back, 0)
        refusal = self.guard.take(answered, self.newest, x, y, motor)
        if refusal is not None or state is not None:
            assert self.guard.voltages == before
        if refusal is None:
            assert all(map(math.isfinite, (x, y, motor)))
            assert abs(motor) <= NONSENSE * LIMITS.motor_voltage
            assert answered <= self.newest <= answered + LIMITS.oldest

    @rule(tilt=st.floats(), times=st.integers(1, 6))
    def sample(self, tilt: float, times: int) -> None:
        for _ in range(times):
            tripped, before = self.guard.trip, self.guard.voltages
            out = self.guard.output()
            self.newest += 1
            self.guard.observe(tilt, 0.0)
            if tripped:
                assert out[:2] == (0.0, 0.0)
                assert abs(out[2]) <= max(abs(before[2]) - LIMITS.spin_down, 0.0)

    @precondition(lambda self: self.guard.trip is not None)
    @rule()
    def reset(self) -> None:
        self.guard.start()

    @invariant()
    def within_limits(self) -> None:
        x, y, motor = self.guard.voltages
        assert abs(x) <= LIMITS.coil_voltage
        assert abs(y) <= LIMITS.coil_voltage
        assert abs(motor) <= LIMITS.motor_voltage
        if self.guard.trip is not None:
            assert (x, y) == (0.0, 0.0)


TestAnything = Machine.TestCase


@pytest.mark.parametrize("tilt", [2.0, 4.5])
def test_a_wheel_without_its_controller_comes_to_rest(tilt):
    bench = Bench.load()
    plant = Plant(bench, Scenario.nominal(), initial_spin_rate=366.0)
    plant.machine.state[0] = math.sin(math.radians(tilt))  # the spin axis leans
    v = bench.value
    limits = GuardLimits(
        coil_voltage=v("coil_voltage_limit"),
        motor_voltage=v("supply_voltage"),
        tilt_stop=v("tilt_limit"),
        watchdog=500,
        spin_down=v("motor_constant") * 100.0 * v("sample_period"),
    )
    guard = Guard(limits, motor_voltage=v("motor_constant") * 366.0)
    guard.start()
    guard.take(0, 0, 0.0, 0.0, v("motor_constant") * 366.0)
    plant.measure()
    spin = [plant.step(*guard.output())[3] for _ in range(round(20.0 / v("sample_period")))]
    assert guard.trip is GuardState.CONTROLLER_LOST
    assert guard.off
    assert spin[400] == pytest.approx(366.0, abs=2.0)
    assert abs(spin[-1]) < 0.01 * 366.0


def test_a_sample_is_due_every_period():
    pacer = Pacer(500, 1_000)
    assert [pacer.due(now, 0, 9) for now in (1_000, 1_499, 1_500, 1_999, 2_000, 3_400)] == [0, 0, 1, 0, 1, 1]
    assert (pacer.late, pacer.behind_ns, pacer.displaced) == (1, 0, 0)
    assert pacer.worst_ns == 900
    assert pacer.patience_ns(3_400) == 1_000  # the sample of 3000 is due, too, and waits for an answer
    assert [pacer.due(3_450, 0, 9), pacer.due(3_450, 0, 9)] == [1, 0]
    assert pacer.patience_ns(3_450) == 50


def test_a_sample_that_is_due_waits_for_the_answer_to_the_last_one_for_two_periods():
    pacer = Pacer(500, 0)
    assert pacer.due(500, 1, 9) == 0  # sample 0 was made at 0
    assert pacer.patience_ns(600) == 400
    assert pacer.patience_ns(5_000) == 50  # the controller on the same core gets its turn all the same
    assert pacer.due(999, 1, 9) == 0
    assert pacer.due(999, 0, 9) == 1  # the answer is there
    assert pacer.due(1_500, 1, 9) == 0
    assert pacer.due(1_999, 1, 9) == 1  # it is waited for no longer
    assert (pacer.late, pacer.displaced) == (1, 0)
    assert pacer.due(3_300, 2, 9) == 1  # and this was not looked at before
    assert pacer.displaced == 1
    assert pacer.due(3_400, 4, 9) == 3  # nobody answers any longer


@pytest.mark.parametrize("unanswered", [0, 1, 4])
def test_a_controller_that_does_not_answer_every_sample_is_not_waited_for(unanswered):
    pacer = Pacer(500, 0)
    assert pacer.due(500, unanswered, 0) == 1
    assert pacer.due(1_600, unanswered, 4) == 2


@given(
    st.lists(st.tuples(st.integers(0, 5_000), st.integers(0, 8), st.integers(0, 8)), max_size=60),
    st.integers(1, 5),
)
def test_no_sample_is_lost_and_no_burst_is_longer_than_allowed(steps, burst):
    period = 500
    pacer = Pacer(period, 0, burst=burst)
    now = made = 0
    for step, unanswered, steady in steps:
        now += step
        count = pacer.due(now, unanswered, steady)
        assert 0 <= count <= burst
        made += count
        # what was made, what the bench stood still and what waits is the time that has gone by
        assert made * period + pacer.behind_ns == pacer.next_ns - period
        assert now - pacer.next_ns < burst * period
        assert pacer.late <= made


def test_after_a_stall_the_time_is_that_of_the_clock():
    pacer = Pacer(500, 0, burst=20)
    assert pacer.due(500, 0, 9) == 1
    assert (pacer.stalls, pacer.behind_ns) == (0, 0)
    now = 500 + 600 * 500  # as after a SIGSTOP of 600 samples
    assert pacer.due(now, 1, 9) == 1
    assert (pacer.stalls, pacer.behind_ns) == (1, 599 * 500)
    # stamps by the grid and the time that the bench stood still: the last one is now
    assert 2 * 500 + pacer.behind_ns == now


def test_statistics_are_those_of_the_time_since_the_last_report():
    statistics = Statistics()
    for value in (400_000, 600_000, 500_000):
        statistics.add(value)
    assert statistics.report("period") == {
        "period_mean_ms": "0.5000",
        "period_deviation_ms": "0.0816",
        "period_worst_ms": "0.6000",
    }
    assert statistics.report("period")["period_worst_ms"] == "0.0000"


def test_a_controller_that_leaves_in_order_is_waited_for():
    limits = GuardLimits(coil_voltage=10.0, motor_voltage=24.0, tilt_stop=0.1, watchdog=8, exchange=30)
    guard = started(limits)
    assert not guard.release()  # there was none yet
    guard.take(0, 0, 3.0, 4.0, 10.0)
    guard.output()
    assert guard.release()
    assert not guard.release()  # told once
    assert [guard.output() for _ in range(20)] == [(0.0, 0.0, 10.0)] * 20  # beyond the watchdog
    assert guard.report() is GuardState.RELEASED
    guard.take(21, 21, 1.0, 2.0, 11.0)
    assert guard.output() == (1.0, 2.0, 11.0)
    assert guard.trip is None
    assert guard.release()
    for _ in range(limits.exchange):
        guard.output()
    assert guard.state is GuardState.CONTROLLER_LOST
    assert guard.reason == "no controller for 30 samples"
    assert not guard.release()


class Surroundings:
    """What a plant is to its pace: controllers come and go as a test says."""

    def __init__(self) -> None:
        self.epoch = self.there = self.told = 0
        self.look: Callable[[], None] = lambda: None

    def step(self) -> None:
        raise AssertionError("no sample is due")

    def controllers(self) -> int:
        return self.there

    def announce(self) -> None:
        self.told += 1

    def get_logger(self) -> logging.Logger:
        return logging.getLogger("plant")

    def wall_timer(self, period: float, callback: Callable[[], None]) -> None:
        self.look = callback

    def destroy_timer(self, timer: object) -> None:
        pass


def test_a_controller_has_left_only_where_it_was_seen():
    """Its first command may be taken before the middleware counts it."""
    guard, bench = started(), Surroundings()
    pace = RealTime(bench, Plant(Bench.load(), Scenario(), initial_spin_rate=200.0), guard, 500_000)
    pace.watch()
    guard.take(0, 0, 3.0, 4.0, 10.0)
    bench.look()
    assert (guard.state, bench.told) == (GuardState.NORMAL, 0)
    bench.there = 1
    bench.look()
    bench.there = 0
    for _ in range(2):
        bench.look()
    assert (guard.state, bench.told) == (GuardState.RELEASED, 1)


def test_a_clock_that_is_set_is_told_and_a_late_sample_is_not_taken_for_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    apart = [1_000_000_000_000]
    monkeypatch.setattr(real_time, "clocks_apart", lambda: apart[0])
    pace = RealTime(
        Surroundings(), Plant(Bench.load(), Scenario(), initial_spin_rate=200.0), started(), 500_000
    )
    pace.start()
    assert pace.report()["clock_jump_s"] == "0.000"  # no sample is made, however long this takes
    apart[0] -= 130_000_000  # as a daemon of the network time sets it
    assert pace.report()["clock_jump_s"] == "-0.130"
    assert abs(pace.clock_jump) > real_time.CLOCK_JUMP
    pace.stop()
    pace.start()  # the stamps are those of the clock again
    pace.report()
    assert pace.clock_jump == 0.0
