"""The plant of a model in other programs: a Python module and an FMU that step as the bench's own plant."""

from __future__ import annotations

import ctypes
import sys
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from importlib import util
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel_sim.instruments import Reading
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


class Unit:
    """A functional mock-up unit, called by the C interface of FMI 2.0 (section 2.1), as any importer does."""

    def __init__(self, file: Path, folder: Path, **start: float) -> None:
        with zipfile.ZipFile(file) as packed:
            packed.extractall(folder)
        description = ElementTree.parse(folder / "modelDescription.xml").getroot()
        self._places = {
            v.get("name"): int(v.get("valueReference", "")) for v in description.iter("ScalarVariable")
        }
        kind = description.find("CoSimulation")
        assert kind is not None
        self._library = ctypes.CDLL(
            str(folder / "binaries" / "linux64" / f"{kind.get('modelIdentifier')}.so")
        )
        self._library.fmi2Instantiate.restype = ctypes.c_void_p
        c = ctypes.CDLL(None)
        functions = ctypes.c_void_p * 5
        # logger, allocate, free, step finished, environment
        self._callbacks = functions(
            *(ctypes.cast(f, ctypes.c_void_p).value for f in (c.abs, c.calloc, c.free)), None, None
        )
        self._unit = ctypes.c_void_p(
            self._library.fmi2Instantiate(
                b"wheel", 1, str(description.get("guid")).encode(), (folder / "resources").as_uri().encode(),
                ctypes.byref(self._callbacks), 0, 0,
            )
        )  # fmt: skip
        assert self._unit.value
        real = ctypes.c_double
        self._call("fmi2SetupExperiment", ctypes.c_int(0), real(0.0), real(0.0), ctypes.c_int(0), real(0.0))
        self._call("fmi2EnterInitializationMode")
        self.write(start)
        self._call("fmi2ExitInitializationMode")

    def _call(self, name: str, *arguments: object) -> None:
        assert getattr(self._library, name)(self._unit, *arguments) == 0, name

    def _numbers(self, names: Iterable[str]) -> tuple[object, object]:
        places = [self._places[name] for name in names]
        return (ctypes.c_uint * len(places))(*places), ctypes.c_size_t(len(places))

    def write(self, values: Mapping[str, float]) -> None:
        self._call("fmi2SetReal", *self._numbers(values), (ctypes.c_double * len(values))(*values.values()))

    def read(self, names: Sequence[str]) -> list[float]:
        values = (ctypes.c_double * len(names))()
        self._call("fmi2GetReal", *self._numbers(names), values)
        return list(values)

    def step(self, time: float, length: float) -> None:
        self._call("fmi2DoStep", ctypes.c_double(time), ctypes.c_double(length), ctypes.c_int(1))

    def end(self) -> None:
        self._call("fmi2Terminate")
        self._library.fmi2FreeInstance(self._unit)


@pytest.mark.skipif(sys.platform != "linux", reason="the library in the unit is that of Linux")
def test_fmu_steps_as_the_plant(model: Path, tmp_path: Path) -> None:
    own = gw.Model.load(model)
    own.export(tmp_path / "wheel.fmu")
    unit = Unit(tmp_path / "wheel.fmu", tmp_path / "unpacked", initial_spin_rate=SPIN)
    names = [f"reading_{reading.name}" for reading in Reading]
    found = [unit.read(names)]
    for k in range(STEPS):
        unit.write(dict(zip(("coil_voltage_x", "coil_voltage_y", "motor_voltage"), voltages(k), strict=True)))
        unit.step(k * own.bench.sample_period, own.bench.sample_period)
        found.append(unit.read(names))
    unit.end()
    np.testing.assert_allclose(found, of_the_bench(own), rtol=1e-9, atol=1e-12)


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
