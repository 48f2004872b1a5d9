"""What the reduction makes of readings that are noisier than stated, clipped, spiked, lost, or of unsettled motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.channels import CHANNELS, LISTED
from gyrowheel_analysis.fitting.preparation import prepare, samples_of
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.fitting.variance import average_covariance
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.hum import Line
from gyrowheel_analysis.reduction.instrument_readings import Shown
from gyrowheel_analysis.reduction.quality import READING_NOISES, reading_noise
from gyrowheel_analysis.reduction.samples import Commanded, Samples
from gyrowheel_analysis.reduction.segmentation import planned_windows, reduce, reduce_and_account
from gyrowheel_analysis.reduction.windows import RISE, Coverage, Windows, without_noise
from gyrowheel_control.loops.controller import Gains
from gyrowheel_control.plans.plan import Plan
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.plant.scenario import Scenario

from .machines import BENCH, assert_same_means, hidden_machine, record

STATED = np.array([BENCH.value(name) for name in READING_NOISES])
CONES = """\
schema: 1
name: cones
hold_s: 1.0
segments:
  - {spin_rpm: 1500, tilt_deg: [[1.5, 0], [0, 0]]}
  - {spin_rpm: 1500, cone_radius_deg: 1.5, cone_period_s: 1.0, cone_turns: 8}
  - {spin_rpm: 3500, tilt_deg: [[1.5, 0], [0, 0]]}
  - {spin_rpm: 3500, cone_radius_deg: 1.5, cone_period_s: 1.0, cone_turns: 8}
"""
#: Without commands, what the controller makes of the tilt's noise hides that of the coils' voltages.
JUDGED = [name != "coil_voltage_noise" for name in READING_NOISES]


def noisier(machine: Scenario, factor: float) -> Scenario:
    values = {name: BENCH.value(name) * factor for name in BENCH.values() if name.endswith("_noise")}
    return replace(machine, values={**machine.values, **values})


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Samples:
    machine = hidden_machine(3, {"cogging": {"C_x": 0.008, "C_y": 0.002}})
    return samples_of(record(tmp_path_factory.mktemp("run"), "run", machine, "check"))


@pytest.fixture(scope="module")
def windows(samples: Samples) -> Windows:
    return reduce(samples, BENCH)


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.6])
def test_noise_is_estimated_from_the_recording(factor: float, tmp_path: Path) -> None:
    machine = noisier(hidden_machine(8, {"commutation_ripple": {"C_x": 0.02, "C_y": 0.01}}), factor)
    data = samples_of(record(tmp_path, "run", machine, "check"))
    found = reading_noise(data, BENCH) / STATED
    assert found == pytest.approx(factor, rel=0.03)
    uncommanded = reading_noise(replace(data, commanded=None), BENCH) / STATED
    assert uncommanded[JUDGED] == pytest.approx(found[JUDGED])
    assert uncommanded[READING_NOISES.index("coil_voltage_noise")] == 1.0
    kept = np.random.default_rng(1).random(len(data.time)) > 0.03
    assert data.commanded is not None
    lossy = replace(data, time=data.time[kept], readings=data.readings[kept], commanded=data.commanded[kept])
    assert (reading_noise(lossy, BENCH) / STATED) == pytest.approx(factor, rel=0.1)


def test_few_samples_have_the_stated_noise(samples: Samples) -> None:
    assert samples.commanded is not None
    few = replace(
        samples,
        time=samples.time[:300],
        readings=samples.readings[:300],
        commanded=samples.commanded[:300],
    )
    assert reading_noise(few, BENCH) == pytest.approx(STATED)


@pytest.mark.parametrize("first", [2**63 - 5000, 2**64 - 5000])
def test_large_numbers_of_samples_find_the_same_commands(first: int, tmp_path: Path) -> None:
    """Numbers of 64 bits need not fit into a signed integer, and begin again at 0."""
    usual = record(tmp_path, "run", hidden_machine(3, {}), "check")
    measurement, command = usual.measurement.copy(), usual.command.copy()
    measurement["sequence"] += np.uint64(first)
    command["measurement_sequence"] += np.uint64(first)
    found = samples_of(replace(usual, measurement=measurement, command=command)).commanded
    expected = samples_of(usual).commanded
    assert found is not None
    assert expected is not None
    assert np.array_equal(found.places, expected.places)


def test_noise_estimate_ignores_samples_before_the_first_command(samples: Samples) -> None:
    """Before its first command nothing but the sensor is in the voltages, and rounding in what counts as commanded."""
    assert samples.commanded is not None
    late, rng = 3000, np.random.default_rng(2)
    readings, x, y = samples.readings.copy(), *(samples.commanded.at(slice(None), axis) for axis in (0, 1))
    x[:late], y[:late] = 0.137, -0.2
    commanded = Commanded((x, y), np.arange(len(x)))
    for name in ("coil_voltage_x", "coil_voltage_y"):
        readings[name][:late] = rng.normal(scale=BENCH.value("coil_voltage_noise"), size=late)
    found = reading_noise(replace(samples, readings=readings, commanded=commanded), BENCH)
    assert found == pytest.approx(reading_noise(samples, BENCH), rel=0.03)


@pytest.mark.parametrize("what", ["stamps", "instants"])
def test_jitter_of_stamps_and_of_instants_changes_no_window(
    what: str, samples: Samples, windows: Windows
) -> None:
    """An error of 5 µs in a stamp looks like 2 mrad of angle at 4000 rpm, twice the noise of the encoder."""
    rng = np.random.default_rng(5)
    late = 5.0e-6 * rng.standard_normal(len(samples.time))
    readings = samples.readings.copy()
    if what == "instants":  # the rotor has turned on until the sample is really taken
        readings["spin_angle"][:] += late * samples.readings.spin_rate
    found = reduce(replace(samples, time=samples.time + late, readings=readings), BENCH)
    assert len(found) == len(windows)
    noise = windows.noise("spin_angle_noise") / np.sqrt(windows.samples)
    off = np.abs(found.angle_harmonics - windows.angle_harmonics) / noise[:, None]
    assert np.sqrt(np.mean(off**2)) < 0.1


def test_motion_at_the_edge_of_a_window_is_no_spike(samples: Samples) -> None:
    """Commands that come late push the tilt at any time: its change from end to end is right, or the window goes."""
    rng = np.random.default_rng(7)
    time, noise = samples.time, BENCH.value("tilt_noise")
    momentum = BENCH.precession_inertia * samples.readings.spin_rate
    off = []
    for _ in range(6):
        motion = np.zeros(len(time), dtype=complex)
        for begin in np.arange(time[0], time[-1], 1.5) + 1.5 * rng.random():
            size = 10.0 ** rng.uniform(-5.0, -3.0) * np.exp(2j * np.pi * rng.random())
            lasts, age = 0.02 + rng.exponential(0.01), time - begin
            back = np.exp(-12.0 * np.maximum(age - lasts, 0.0))  # the tilt loop's
            motion += size * np.where(age < lasts, np.maximum(age, 0.0) / lasts, back)
        readings = samples.readings.copy()
        readings["tilt_x"][:] = motion.real + noise * rng.standard_normal(len(time))
        readings["tilt_y"][:] = motion.imag + noise * rng.standard_normal(len(time))
        # the coils hold the torque that the motion to the next sample takes
        rate = np.diff(motion, prepend=motion[0]) / BENCH.sample_period
        torque = BENCH.value("flexure_stiffness_x") * motion - 1j * momentum * rate
        for axis, part in (("x", torque.real), ("y", torque.imag)):
            dither = BENCH.value("coil_voltage_noise") * rng.standard_normal(len(time))
            readings[f"coil_voltage_{axis}"][:] = part / BENCH.value("coil_constant") + dither
        found = reduce(replace(samples, readings=readings), BENCH)
        moved = found.tilt @ RISE[: found.tilt.shape[1]]
        begin, end = (np.interp(found.start + part * found.duration, time, motion) for part in (0, 1))
        off.append((moved - (end - begin)) / (found.duration * np.sqrt(found.tilt_rate_variance)))
    sizes = np.abs(np.concatenate(off))
    assert len(sizes) > 100
    assert np.sqrt(np.mean(sizes**2) / 2.0) == pytest.approx(1.0, abs=0.15)
    assert np.mean(sizes > 4.5) < 0.01


@pytest.mark.slow
def test_loops_that_answer_a_noisy_tilt_reading_add_no_noise_to_the_averages(tmp_path: Path) -> None:
    noisy = BENCH.with_values({"tilt_noise": 5.0 * BENCH.value("tilt_noise")})
    values = noisy.values() | {"coil_voltage_drift": 0.0}
    squares: list[np.ndarray] = []
    for seed in (1, 2, 3):
        machine = Scenario(values=values, effects={}, noise_seed=seed)
        data = samples_of(record(tmp_path, f"run_{seed}", machine, "quick", bench=noisy))
        problem = Problem.of([Balance(reduce(data, noisy), noisy)], noisy)
        (balance,) = problem.balances
        for row in CHANNELS["tilt"].rows:
            variance = average_covariance(balance, problem.base, CHANNELS["tilt"], row).diagonal
            squares.append((problem.measured - problem.base)[balance.row(row)] ** 2 / variance)
    # 264 values of chi-squared: 1.00 +- 0.09; a part of the variance is the accuracy of the balance
    assert 0.7 < np.mean(squares) < 1.2


@pytest.mark.parametrize("absent", ["motor_voltage", "motor_current"])
def test_the_motor_of_a_speed_that_settles_or_trembles_has_no_other_torque(
    absent: str, samples: Samples, windows: Windows
) -> None:
    """A fast spin loop answers the noise of its readings: current and acceleration of a window belong together."""
    rng = np.random.default_rng(5)
    time, n = samples.time, len(samples.time)
    step = float(np.median(np.diff(time)))
    constant, resistance = BENCH.value("motor_constant"), BENCH.value("motor_resistance")
    short = np.abs(windows.duration - 0.49) < 0.02  # right after a change of the speed
    off: list[float] = []
    moved: list[float] = []
    for _ in range(4):
        rate, sign = np.full(n, 320.0), 1.0 if rng.random() < 0.5 else -1.0
        for start in windows.start[short] - 0.3:
            age = np.maximum(time - start, 0.0)
            rate += sign * rng.uniform(0.1, 0.6) * np.exp(-age / rng.uniform(0.2, 0.6))
        for hertz in rng.uniform(2.0, 9.0, 30):
            rate += 0.006 * np.sin(2.0 * np.pi * (hertz * time + rng.random()))
        current = BENCH.axial_inertia / constant * np.gradient(rate, step)
        readings = samples.readings.copy()
        for name, values in (
            ("spin_angle", np.cumsum(rate) * step),
            ("spin_rate", rate),
            ("motor_current", current),
            ("motor_voltage", resistance * current + constant * rate),
        ):
            readings[name][:] = values + BENCH.value(f"{name}_noise") * rng.standard_normal(n)
        readings[absent][:] = 0.0
        found = reduce(replace(samples, readings=readings, absent=frozenset({absent})), BENCH)
        if absent == "motor_voltage":
            torque, name = constant * found.motor_current, "motor_current_noise"
        else:
            torque = constant / resistance * (found.motor_voltage - constant * found.mean_spin)
            name = "motor_voltage_noise"
        wrong = torque - BENCH.axial_inertia * found.mean_spin_acceleration
        per_unit = constant if absent == "motor_voltage" else constant / resistance
        noise = (per_unit * found.noise(name)) ** 2 / found.samples
        noise += BENCH.axial_inertia**2 * found.spin_acceleration_variance
        off.extend(wrong / np.sqrt(noise))
        moved.extend(torque / np.sqrt(noise))
    assert len(off) > 60
    assert np.sqrt(np.mean(np.square(moved))) > 3.0
    assert abs(np.mean(off)) < 3.0 / np.sqrt(len(off))
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.25)


#: Sizes of spikes [SI], by the reading that they are in.
SPIKES = {
    "tilt_x": 0.02,
    "spin_rate": 50.0,
    "coil_voltage_x": 5.0,
    "motor_voltage": 8.0,
    "motor_current": 3.0,
    "coil_temperature": 40.0,
}


def test_spikes_do_not_move_a_window(samples: Samples, windows: Windows) -> None:
    rng = np.random.default_rng(2)
    readings = samples.readings.copy()
    for name, size in SPIKES.items():
        hit = rng.choice(len(readings), len(readings) // 2000, replace=False)
        readings[name][hit] += size * rng.choice((-1.0, 1.0), len(hit))
    spiked = reduce(replace(samples, readings=readings), BENCH)
    assert_same_means(spiked, windows)
    # the mean of a coil's voltage knows no better than what the controller makes of the tilt's noise
    assert np.abs(spiked.coil_voltage - windows.coil_voltage).max() < 2.0e-3
    assert np.abs(spiked.coil_temperature - windows.coil_temperature).max() < 0.02


def test_a_burst_of_noise_counts_in_its_window_alone(samples: Samples, windows: Windows) -> None:
    rng = np.random.default_rng(4)
    readings = samples.readings.copy()
    hit = 3
    noise = {"tilt_noise": "tilt_x", "spin_angle_noise": "spin_angle", "motor_current_noise": "motor_current"}
    begin = int(np.searchsorted(samples.time, windows.middle[hit]))
    for name, reading in noise.items():
        readings[reading][begin : begin + 60] += 20.0 * BENCH.value(name) * rng.standard_normal(60)
    found = reduce(replace(samples, readings=readings), BENCH)
    added = 60.0 * 20.0**2 / windows.samples[hit]
    for name in noise:
        factor = (found.noise(name) / windows.noise(name)) ** 2
        share = 0.5 if name == "tilt_noise" else 1.0  # one of two axes
        assert factor[hit] == pytest.approx(1.0 + share * added, rel=0.5)
        assert np.delete(factor, hit) == pytest.approx(1.0, abs=0.05)


def test_a_burst_counts_more_in_a_change_at_the_end_of_a_window(samples: Samples, windows: Windows) -> None:
    """One in the last samples would look like a motion that begins there, and end the window earlier."""
    rng = np.random.default_rng(5)
    hit, length, last = 3, 60, 40
    begin, end = np.searchsorted(samples.time, windows.start[hit] + np.array([0.0, windows.duration[hit]]))
    raised = []
    for place in ((begin + end - length) // 2, end - length - last):
        readings = samples.readings.copy()
        for reading in ("tilt_x", "tilt_y"):
            readings[reading][place : place + length] += (
                6.0 * BENCH.value("tilt_noise") * rng.standard_normal(length)
            )
        found = reduce(replace(samples, readings=readings), BENCH)
        assert found.duration[hit] == windows.duration[hit]
        raised.append(found.tilt_rate_variance[hit] / windows.tilt_rate_variance[hit])
    assert raised[1] > 3.0 * raised[0]


def test_a_burst_that_fills_most_of_a_window_counts(samples: Samples, windows: Windows) -> None:
    rng = np.random.default_rng(6)
    hit = 3
    begin, end = np.searchsorted(
        samples.time, windows.start[hit] + np.array([0.1, 0.8]) * windows.duration[hit]
    )
    readings = samples.readings.copy()
    readings["motor_current"][begin:end] += (
        20.0 * BENCH.value("motor_current_noise") * rng.standard_normal(end - begin)
    )
    found = reduce(replace(samples, readings=readings), BENCH)
    factor = (found.noise("motor_current_noise") / windows.noise("motor_current_noise"))[hit] ** 2
    assert factor == pytest.approx(1.0 + 0.7 * 20.0**2, rel=0.3)


def test_a_voltage_that_answers_noise_is_no_spike(samples: Samples, windows: Windows) -> None:
    assert samples.commanded is not None
    places = np.searchsorted(samples.time, windows.start[3]) + np.arange(100, 700, 40)
    readings, voltages = samples.readings.copy(), samples.commanded.voltages[0].copy()
    readings["coil_voltage_x"][places] += 5.0
    answered = voltages.copy()
    answered[samples.commanded.places[places]] += 5.0
    for commands, moved in ((voltages, 0.0), (answered, 5.0 * len(places) / windows.samples[3])):
        commanded = replace(samples.commanded, voltages=(commands, samples.commanded.voltages[1]))
        found = reduce(replace(samples, readings=readings, commanded=commanded), BENCH)
        assert (found.coil_voltage - windows.coil_voltage)[3].real == pytest.approx(moved, abs=2.0e-3)


def test_a_clipped_reading_is_left_out(samples: Samples, windows: Windows) -> None:
    readings = samples.readings.copy()
    limit = 0.6 * float(np.abs(readings.tilt_x).max())
    readings.tilt_x[:] = np.clip(readings.tilt_x, -limit, limit)
    left = reduce(replace(samples, readings=readings), BENCH)
    assert 0 < len(left) < len(windows)
    assert np.abs(left.mean_tilt.real).max() < limit
    # what was not clipped is as it was
    same = np.isin(windows.start, left.start)
    assert windows.mean_tilt[same] == pytest.approx(left.mean_tilt)


def test_motion_that_has_not_settled_is_left_out_or_begins_later(samples: Samples, windows: Windows) -> None:
    holds = np.flatnonzero(windows.duration > 0.9)
    restless, late = windows.select(holds[2:3]), windows.select(holds[5:6])
    readings = samples.readings.copy()
    t = samples.time
    shaken = (t >= restless.start) & (t <= restless.start + restless.duration)
    readings.tilt_x[shaken] += 1.0e-3 * np.sin(40.0 * t[shaken])
    ringing = t >= late.start - 0.5
    readings.tilt_x[ringing] += 2.0e-3 * np.exp(-(t[ringing] - late.start) / 0.06) * np.sin(60.0 * t[ringing])
    left = reduce(replace(samples, readings=readings), BENCH)
    assert not np.any(np.isclose(left.middle, restless.middle, atol=0.05))
    (same,) = np.flatnonzero(np.isclose(left.start + left.duration, late.start + late.duration, atol=0.05))
    assert left.start[same] > late.start + 0.1
    assert np.abs(left.mean_tilt[same] - late.mean_tilt) < 2.0e-5


@pytest.mark.parametrize("late", [0.012, 0.05])
def test_a_window_ends_before_the_next_motion_begins(late: float, samples: Samples, windows: Windows) -> None:
    """A clock that is off by 50 ppm makes setpoints late by 12 ms in 4 min: the coils push, the tilt hardly moves."""
    found, coverage = reduce_and_account(replace(samples, setpoint_time=samples.setpoint_time + late), BENCH)
    assert len(found) >= len(windows) - 1
    assert 0.7 * coverage.steady < coverage.used < coverage.steady
    balance = Balance(found, BENCH)
    problem = Problem.of([balance], BENCH)
    white = problem.noise.whiten(problem.fit(()).residual)
    averages = np.concatenate([white[balance.row(row)] for row in ("tilt_x", "tilt_y", "spin")])
    assert np.abs(averages).max() < 4.0


def test_a_failing_supply_leaves_windows_out(samples: Samples, windows: Windows) -> None:
    readings = samples.readings.copy()
    readings.motor_current[:] += 0.5 * np.where(np.arange(len(readings)) % 2, 1.0, -1.0)
    holds = int(np.sum(windows.duration > 0.9))
    assert len(reduce(replace(samples, readings=readings), BENCH)) < holds / 4


def test_coverage_counts_what_is_left_out(samples: Samples, windows: Windows) -> None:
    found, whole = reduce_and_account(samples, BENCH)
    assert len(found) == len(windows)
    assert whole.complete
    assert whole.recorded == pytest.approx(samples.time[-1] - samples.time[0], abs=0.001)
    # windows end with a whole revolution
    assert whole.used == pytest.approx(windows.duration.sum(), rel=0.06)
    assert whole.sentence().startswith(f"All {whole.used:.0f} s of steady motion take part")

    readings = samples.readings.copy()
    limit = 0.6 * float(np.abs(readings.tilt_x).max())
    readings.tilt_x[:] = np.clip(readings.tilt_x, -limit, limit)
    lost = samples.time < samples.time[0] + 0.3 * whole.recorded
    clipped = replace(samples, readings=readings)
    _, part = reduce_and_account(clipped, BENCH)
    assert part.steady == pytest.approx(whole.steady)
    assert not part.complete
    assert "with a reading at the end of its range" in part.left_out
    assert "s with a reading at the end of its range" in part.sentence()
    # three of four samples missing in the first part
    thin = ~lost | (np.arange(len(lost)) % 4 == 0)
    fewer = replace(clipped, time=samples.time[thin], readings=readings[thin])
    _, both = reduce_and_account(fewer, BENCH)
    assert both.left_out["with too few samples or revolutions"] > 0.1 * whole.steady
    assert both.steady == pytest.approx(whole.steady, rel=0.01)
    together = Coverage.of([whole, both])
    assert together.used == pytest.approx(whole.used + both.used)
    assert together.left_out == both.left_out


def test_parts_of_a_cone_have_whole_revolutions_at_the_final_speed(tmp_path: Path) -> None:
    gains = Gains(spin_proportional=3.0, spin_integral=20.0)  # which overshoots
    data = samples_of(record(tmp_path, "run", hidden_machine(5, {}), Plan.load(CONES), gains=gains))
    found = reduce(data, BENCH)
    cones = found.select(found.moving)
    slow, fast = 1500.0 * 2.0 * np.pi / 60.0, 3500.0 * 2.0 * np.pi / 60.0
    assert np.all(np.minimum(abs(cones.mean_spin / slow - 1.0), abs(cones.mean_spin / fast - 1.0)) < 0.011)
    for speed in (slow, fast):
        own = cones.select(abs(cones.mean_spin / speed - 1.0) < 0.02)
        assert len(own) > 10
        assert np.all(own.mean_spin * own.duration / (2.0 * np.pi) > 3.9)


@pytest.mark.parametrize("seed", [1, 3])
def test_bench_parameters_come_out_right_from_noisy_cones(seed: int, tmp_path: Path) -> None:
    machine = noisier(hidden_machine(seed, {}), 4.0)
    problem = prepare([record(tmp_path, "run", machine, Plan.load(CONES))], Model.new()).problem
    fit = problem.fit(())
    for k, (name, (first, *_)) in enumerate(problem.unknowns.nuisances):
        truth = (machine.values.get(first.name, first.value) - first.value) / first.uncertainty
        assert abs(fit.nuisance[k] - truth) < 4.0 * np.sqrt(fit.covariance[k, k]), name


def test_no_parameter_is_fitted_to_the_noise_of_an_acceleration(tmp_path: Path) -> None:
    """Errors in variables would make the moment of inertia come out too small."""
    data = samples_of(record(tmp_path, "run", hidden_machine(5, {}), Plan.load(CONES)))
    windows = reduce(data, BENCH)
    windows = windows.select(windows.moving)
    noise = np.sqrt(windows.spin_acceleration_variance)
    spin = windows.spin.copy()
    spin[:, 1] += 0.5 * windows.duration * noise
    assert np.sum(np.abs(windows.mean_spin_acceleration) < 9.0 * noise) > 0.9 * len(windows)
    quiet = np.abs(windows.mean_spin_acceleration) < 9.0 * noise
    stated = BENCH.values()
    other = {**stated, "rotor_inertia_z": 1.1 * stated["rotor_inertia_z"]}
    rows, residuals = [], []
    for own in (windows, replace(windows, spin=spin)):
        balance = Balance(own, BENCH)
        spin_rows = balance.row("spin")
        predicted = balance.predicted(stated, [])
        rows.append((balance.predicted(other, []) - predicted)[spin_rows][quiet])
        residuals.append((balance.measured - predicted)[spin_rows][quiet])
    torque = (BENCH.axial_inertia * noise)[quiet]
    assert np.abs(rows[1] - rows[0]) == pytest.approx(0.0, abs=1.0e-3 * torque.max())
    assert residuals[0] - residuals[1] == pytest.approx(torque, rel=0.02)  # it stays in what was measured


def test_no_parameter_is_fitted_to_the_noise_of_repeated_holds(windows: Windows) -> None:
    """A hold that is repeated hundreds of times is one motion, but where it differs by more than noise."""
    rng = np.random.default_rng(1)
    (hold,) = np.flatnonzero(~windows.moving & (np.abs(windows.mean_tilt) > 0.03))[:1]
    many = windows.select(np.full(100, hold))
    noise = many.noise("tilt_noise") / np.sqrt(many.samples)
    harmonics = many.tilt_harmonics.copy()
    harmonics[:, :, 0] += noise[:, None] * (rng.normal(size=(100, 4)) + 1j * rng.normal(size=(100, 4)))
    moved = replace(many, tilt_harmonics=harmonics)
    kept = without_noise(moved).tilt_harmonics
    clear = np.any(kept[0] != 0.0, axis=1)
    assert clear.any()
    assert np.all(kept == kept[0])
    mean = harmonics.mean(axis=0)
    assert kept[0, clear] == pytest.approx(mean[clear], rel=1e-9)
    # what was left out stays in what was measured, and a parameter moves all holds alike
    balance, stated = Balance(moved, BENCH), BENCH.values()
    other = {**stated, "rotor_inertia_x": 1.01 * stated["rotor_inertia_x"]}
    for row in ("tilt_2n_x", "tilt_2n_y"):
        rows = balance.row(row)
        moves = (balance.predicted(other, []) - balance.predicted(stated, []))[rows]
        assert np.ptp(moves) == pytest.approx(0.0, abs=1e-6 * np.abs(moves).max() + 1e-15)
        assert np.std(balance.measured[rows]) > 1e-9
    harmonics[7, np.flatnonzero(clear)[0], 0] += 30.0 * noise[7]
    found = without_noise(replace(many, tilt_harmonics=harmonics)).tilt_harmonics[7]
    assert found[clear][0] == pytest.approx(harmonics[7][clear][0])


def test_no_parameter_is_fitted_to_the_noise_of_a_tilt_rate(windows: Windows) -> None:
    hold = windows.select(np.flatnonzero(~windows.moving)[:1])
    for size, left in ((2.0, 0.0), (50.0, 1.0)):
        rate = size * np.sqrt(hold.tilt_rate_variance)
        tilt = hold.tilt.copy()
        tilt[:, 1] += 0.5 * hold.duration * (rate - hold.mean_tilt_rate)
        kept = without_noise(replace(hold, tilt=tilt))
        assert kept.mean_tilt_rate == pytest.approx(left * rate, abs=1e-12)
        assert kept.mean_tilt == pytest.approx(hold.mean_tilt)


def test_hum_found_in_another_recording_counts_where_the_speed_conceals_it() -> None:
    # half of the plan turns at the frequency of the mains: there hum looks like an imbalance
    windows = planned_windows(Plan.load("check"), BENCH)
    line = Line(50.0, 1, 50.0, 0.01, {"tilt": (8.0e-6, 1.0e-7)}, frozenset({"tilt"}))
    covered = np.abs(windows.mean_spin / (2.0 * np.pi) - 50.0) < 0.1
    assert not Shown().weighed(windows).hum_variance.any()
    hum = Shown().weighed(windows, [Shown(lines=(line,))]).hum_variance[:, 0, 0]
    assert hum[covered].min() >= 0.5 * 8.0e-6**2
    assert hum[~covered].max() < 0.05 * hum[covered].min()
    # the recording's own hum is the better one
    own = replace(line, amplitudes={"tilt": (4.0e-6, 1.0e-7)})
    both = Shown(lines=(own,)).weighed(windows, [Shown(lines=(line,))]).hum_variance
    np.testing.assert_array_equal(both, Shown(lines=(own,)).weighed(windows).hum_variance)


def test_in_a_cone_what_happens_twice_a_revolution_turns_with_the_tilt(tmp_path: Path) -> None:
    """At 100 revolutions a second all windows of a cone begin at one angle of the rotor, so that errors add up."""
    bench = Bench.load("dtg")
    quiet = {name: 1e-3 * bench.value(name) for name in bench.values() if name.endswith(("_noise", "_drift"))}
    recording = record(tmp_path, "run", Scenario(values=quiet), "dtg_quick", bench=bench)
    problem = prepare([recording], Model.new("dtg")).problem
    (balance,) = problem.balances
    residual = problem.fit(()).residual
    torque, angle = (
        np.hypot(*(residual[balance.row(row)] for row in rows))
        for rows in (("tilt_x", "tilt_y"), LISTED["angle_2n"].rows)
    )
    cones = np.abs(balance.windows.mean_tilt_rate) > np.radians(0.5)
    assert cones.sum() > 20
    # none of it is left in the mean torque
    assert torque[cones].max() < 3.0e-7
    # the joint turns the shaft by up to an eighth of the square of the tilt
    assert (angle / np.abs(balance.windows.mean_tilt) ** 2)[cones].max() < 5.0e-4
