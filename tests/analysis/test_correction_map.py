"""A torque that no law of the library and no formula describes: found as a map, added, and predicted elsewhere.

The torque is added to the readings as the loops would answer it, by a formula that shares nothing with the map.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_analysis.diagnosis.map_choice import best_map
from gyrowheel_analysis.diagnosis.map_fit import MapFit
from gyrowheel_analysis.fitting.preparation import Prepared, prepare
from gyrowheel_analysis.model import Model
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording, write_run
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.torque_map import TorqueMap
from gyrowheel_sim.environment import to_json
from gyrowheel_sim.instruments import Reading
from gyrowheel_sim.plant.scenario import Scenario

GRID = """
schema: 1
name: grid
title: Four speeds, nine tilts
description: A grid of holds.
hold_s: 1.6
segments:
  - label: grid
    spin_rpm: [3000, 1500, 3800, 2200]
    tilt_deg: [[0, 0], [3, 0], [-3, 0], [0, 3], [0, -3], [1.2, 1.2], [-1.2, -1.2], [-2, 2], [2, -2]]
"""
BETWEEN = """
schema: 1
name: between
title: Other speeds and tilts
description: Within the range of the grid.
hold_s: 1.6
segments:
  - label: grid
    spin_rpm: [2600, 1800]
    tilt_deg: [[0.5, 0.5], [2, 1], [-1, 2], [1, -2], [-2, -0.5]]
"""
FASTER = """
schema: 1
name: faster
title: A faster speed
description: Beyond the range of the grid.
hold_s: 1.6
segments:
  - {label: fast, spin_rpm: 4000, tilt_deg: [[0, 0], [2, 0], [0, 2]]}
  - {label: slow, spin_rpm: 3000, tilt_deg: [[0, 0], [2, 0], [0, 2]]}
"""
ROTOR_CHANNELS = ("tilt_x", "tilt_y")


def odd_torque(z: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return a torque on the rotor [N m] that depends on the direction of the tilt and on the speed."""
    x, y = z.real / 0.0524, z.imag / 0.0524
    wave = np.sin(1.2 * x + 1.0) * np.cos(0.8 * y - speed / 200.0)
    return 1.5e-4 * (wave + 1j * np.cos(1.1 * y + 0.7 * x - 0.4) * np.tanh(speed / 250.0 - 1.0))


def made(folder: Path, text: str, seed: int, *, odd: bool) -> Path:
    bench, plan = Bench.load(), Plan.load(text)
    run = simulate(bench, Scenario.nominal(noise_seed=seed), plan)
    rows = run.measurement
    if odd:
        tilt = np.tan(rows[:, Reading.tilt_x]) + 1j * np.tan(rows[:, Reading.tilt_y])
        volts = -odd_torque(tilt, rows[:, Reading.spin_rate]) / bench.value("coil_constant")
        rows[:, Reading.coil_voltage_x] += volts.real
        rows[:, Reading.coil_voltage_y] += volts.imag
    return write_run(
        folder / plan.name,
        rows,
        run.command,
        run.setpoints,
        to_json(run.environment),
        bench.describe(),
        sample_period=bench.sample_period,
        stamps=run.stamps,
    )


@dataclass(frozen=True)
class Recorded:
    grid: Path
    between: Path
    faster: Path
    plain: Path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("odd")
    odd = [made(folder, text, seed, odd=True) for seed, text in enumerate((GRID, BETWEEN, FASTER), 3)]
    plain = made(folder / "plain", GRID, 9, odd=False)
    return Recorded(odd[0], odd[1], odd[2], plain)


def map_of(path: Path) -> tuple[Prepared, MapFit | None]:
    with one_thread():
        prepared = prepare([Recording.open(path)], Model.new())
        problem = prepared.problem
        return prepared, best_map([(problem, problem.fit_within())], "map")


@pytest.mark.slow
def test_nothing_hidden_gives_no_map(recorded: Recorded) -> None:
    assert map_of(recorded.plain)[1] is None


@pytest.fixture(scope="module")
def found(recorded: Recorded) -> gw.Diagnosis:
    return gw.diagnose(recorded.grid, gw.Model(), validate=recorded.between)


def floors(row: object, name: str) -> float:
    return float(np.sqrt(row.channels[name].chi2_per_n))  # type: ignore[attr-defined]


@pytest.mark.slow
def test_map_takes_the_error_down_to_noise_at_other_speeds_and_tilts(found: gw.Diagnosis) -> None:
    assert found.verdict == "unknown"
    assert found.map is not None
    error = found.map.error
    for name in ROTOR_CHANNELS:
        assert floors(error.before, name) > 2.5
        assert floors(error.after, name) <= 1.3
        assert floors(error.validation_before, name) > 1.5
        assert floors(error.validation_after, name) <= 1.3
    assert found.map.targets == ("rotor_torque",)


@pytest.mark.slow
def test_map_depends_on_the_variables_of_the_torque(found: gw.Diagnosis) -> None:
    assert found.map is not None
    shares = {d.variable: d.share for d in found.map.dependence}
    assert shares["azimuth"] > 0.3
    assert shares["speed"] > 0.1
    assert shares["temperature"] < 0.02


@pytest.mark.slow
def test_map_is_the_torque_that_was_hidden(found: gw.Diagnosis) -> None:
    """Up to what the bench parameters explain as well: a constant and a part in proportion to the tilt."""
    assert found.map is not None
    side = np.linspace(-0.045, 0.045, 9)
    z = (side[:, None] + 1j * side).ravel()
    z = z[np.abs(z) < 0.045]
    speed = np.full(z.size, 280.0)
    own = found.map.at({"z": z, "Omega": speed, "T_coil": 294.0, "T_motor": 294.0})["rotor_torque"]
    plain = np.column_stack([np.ones(z.size), z, np.conj(z)])

    def left(torque: np.ndarray) -> np.ndarray:
        return torque - plain @ np.linalg.lstsq(plain, torque, rcond=None)[0]

    hidden = left(odd_torque(z, speed))
    assert np.linalg.norm(left(own) - hidden) < 0.35 * np.linalg.norm(hidden)


@pytest.mark.slow
def test_map_is_shown_drawn_and_in_the_json(found: gw.Diagnosis) -> None:
    assert "a map of the missing torque describes it" in found.sentence
    content = found.to_dict()["map"]
    assert content["nearest"]
    assert content["map"]["tilt"] == pytest.approx(found.map.effect.within.tilt)  # type: ignore[union-attr]
    assert any("falls in tilt x" in text for text in content["sentences"])
    assert len(found.plot_map().axes) == 5


@pytest.fixture(scope="module")
def better(recorded: Recorded, found: gw.Diagnosis) -> gw.Model:
    assert found.map is not None
    return gw.Model().add(found.map, fit=recorded.grid, validate=recorded.between)


@pytest.mark.slow
def test_added_map_predicts_the_other_recording(better: gw.Model) -> None:
    assert better.added is not None
    assert better.added.proof.proven
    assert better.added.error.validation_after is not None
    assert better.added.error.validation_after.chi2_per_n < 1.2


@pytest.mark.slow
def test_added_map_is_kept_in_the_file_and_can_be_undone(better: gw.Model, tmp_path: Path) -> None:
    better.save(tmp_path / "wheel.yaml")
    again = gw.Model.load(tmp_path / "wheel.yaml")
    assert isinstance(again.details.declared["map"], TorqueMap)
    assert again.details.effects["map"] == pytest.approx(better.details.effects["map"])
    assert again.undo().diff(gw.Model()) == []


@pytest.mark.slow
def test_model_with_a_map_finds_nothing_more_in_another_recording(
    better: gw.Model, recorded: Recorded
) -> None:
    compared = gw.compare(recorded.between, better)
    assert compared.error_before.chi2_per_n < 1.2


@pytest.mark.slow
def test_recording_beyond_the_range_of_a_map_is_refused(better: gw.Model, recorded: Recorded) -> None:
    with pytest.raises(InputError, match=r"speeds are 3000 \.\. 40\d\d rpm, outside of the range of 'map'"):
        gw.compare(recorded.faster, better)


@pytest.mark.slow
def test_map_is_added_alone(recorded: Recorded) -> None:
    with pytest.raises(InputError, match="add it alone"):
        gw.Model().add(["map", "windage"], fit=recorded.grid)
