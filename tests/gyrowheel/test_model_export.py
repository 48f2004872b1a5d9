"""The plant of a model in other programs: a Python module and an FMU that step as the bench's own plant."""

from __future__ import annotations

import sys
from importlib import util
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_sim.instruments.readings import Reading
from gyrowheel_sim.plant.machine import Plant
from gyrowheel_sim.plant.scenario import Scenario

from .helpers import Shell

STEPS = 200
SPIN = 300.0


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a model file with two effects, one of them a formula, and a fitted bench parameter."""
    path = tmp_path_factory.mktemp("model") / "wheel.yaml"
    gw.Model().save(path)
    content = path.read_text().replace("effects: {}", "effects:\n  windage: {w: 0.001, n: 1.48}")
    content = content.replace(
        "overrides: {}", "overrides:\n  bearing_viscous: {value: 2.0e-6, standard_error: 1.0e-7}"
    )
    path.write_text(content)
    assert gw.Model.load(path).effects
    return path


def voltages(k: int) -> tuple[float, float, float]:
    return 0.3 * np.sin(0.05 * k), 0.2, 9.1


def of_the_bench(model: gw.Model) -> np.ndarray:
    """Return the readings without noise that the plant of the bench gives."""
    values = {name: own.value for name, own in model.parameters.items()}
    silent = {name: 0.0 for name in model.stated_bench.values() if name.endswith(("_noise", "_drift"))}
    scenario = Scenario({**values, **silent}, {name: dict(own) for name, own in model.effects.items()})
    plant = Plant(model.stated_bench, scenario, initial_spin_rate=SPIN)
    return np.array([plant.measure().copy(), *(plant.step(*voltages(k)).copy() for k in range(STEPS))])


def test_python_module_steps_as_the_plant(model: Path, gyrowheel: Shell, tmp_path: Path) -> None:
    file = tmp_path / "plant_of_wheel.py"
    gyrowheel.good("model", "export", "--model", model, "-o", file)
    spec = util.spec_from_file_location("plant_of_wheel", file)
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    wheel = module.Wheel(SPIN)
    found = [list(wheel.reading.values()), *(list(wheel.step(*voltages(k)).values()) for k in range(STEPS))]
    np.testing.assert_allclose(found, of_the_bench(gw.Model.load(model)), rtol=1e-12, atol=1e-15)
    assert "gyrowheel" not in {name.partition("_")[0] for name in vars(module) if not name.startswith("_")}


@pytest.mark.slow
def test_fmu_steps_as_the_plant(model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fmpy = pytest.importorskip("fmpy")
    own = gw.Model.load(model)
    file = tmp_path / "wheel.fmu"
    own.export(file)
    period = own.bench.sample_period
    time = np.arange(STEPS) * period
    given = np.array(
        [(t, *voltages(k)) for k, t in enumerate(time)],
        dtype=[(n, float) for n in ("time", "coil_voltage_x", "coil_voltage_y", "motor_voltage")],
    )
    names = [f"reading_{reading.name}" for reading in Reading]
    found = fmpy.simulate_fmu(
        str(file), stop_time=STEPS * period, step_size=period, output_interval=period, input=given, output=names,
        start_values={"initial_spin_rate": SPIN},
    )  # fmt: skip
    shown = np.array([found[name] for name in names]).T
    np.testing.assert_allclose(shown, of_the_bench(own)[: len(shown)], rtol=1e-9, atol=1e-12)
    assert len(shown) == STEPS + 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-o", "wheel.txt"], "wheel.txt: must end in .py or .fmu"),
        (["-o", "wheel.py", "--format", "fmu"], "wheel.py: must end in .fmu"),
        (
            ["-o", "wheel.mo", "--format", "modelica"],
            "format: 'modelica' is not allowed; allowed: python, fmu",
        ),
    ],
)
def test_other_formats_are_refused(model: Path, gyrowheel: Shell, words: list[str], message: str) -> None:
    refused = gyrowheel("model", "export", "--model", model, *words)
    assert refused.code == 2
    assert refused.err.endswith(f"error: {message}\n")


def test_a_missing_package_is_named(model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pythonfmu", None)
    with pytest.raises(gw.InputError, match=r"needs the package pythonfmu: pip install 'gyrowheel\[fmu\]'"):
        gw.Model.load(model).export(tmp_path / "wheel.fmu")
    assert not list(tmp_path.iterdir())
