"""The Python API, by what a user sees of it."""

from __future__ import annotations

import ast
import json
import pkgutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import gyrowheel as gw

from .conftest import Wheel
from .helpers import DRAG_PLAN, OTHER_PLAN, SHORT_PLAN, Shell

ROOT = Path(__file__).resolve().parents[2]
CLI = ROOT / "src" / "gyrowheel" / "gyrowheel" / "cli"


class Page(HTMLParser):
    """Reads HTML strictly: every tag that opens is closed in its place."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.words = ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag != "br":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data


@pytest.fixture(scope="module")
def drag() -> gw.Recording:
    return gw.simulate(DRAG_PLAN, effects={"windage": {"w": 0.0013}}, seed=4)


@pytest.fixture(scope="module")
def other() -> gw.Recording:
    return gw.simulate(OTHER_PLAN, effects=["windage:w=0.0013"], seed=4)


@pytest.fixture(scope="module")
def found(drag: gw.Recording, other: gw.Recording) -> gw.Diagnosis:
    return gw.diagnose(drag, gw.Model(), validate=other)


@pytest.fixture(scope="module")
def better(drag: gw.Recording, other: gw.Recording) -> gw.Model:
    return gw.Model().add("windage", fit=drag, validate=[other])


def test_importing_is_cheap_and_changes_nothing() -> None:
    code = (
        "import sys, gyrowheel\n"
        "print([m for m in ('numpy', 'scipy', 'sympy', 'matplotlib', 'rich', 'numba') if m in sys.modules])"
    )
    seen = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert seen.stdout.strip() == "[]"
    assert seen.stderr == ""


def test_every_public_name_exists_and_is_documented() -> None:
    assert dir(gw) == sorted(gw.__all__)
    for name in gw.__all__:
        value = getattr(gw, name)
        assert name == "__version__" or value.__doc__
    with pytest.raises(AttributeError, match="compere"):
        gw.compere  # type: ignore[attr-defined]  # noqa: B018


def test_the_stub_names_every_public_name_once() -> None:
    """The stub is what type checkers read, and the table of `__getattr__`."""
    tree = ast.parse(Path(gw.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    names = [alias for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert all(alias.asname == alias.name for alias in names)
    assert sorted([*(alias.name for alias in names), "__version__"]) == gw.__all__


def test_all_recordings_of_a_folder_are_read_and_nothing_else(drag: gw.Recording, tmp_path: Path) -> None:
    for name in ("two", "one"):
        drag.save(tmp_path / "runs" / name)
    (tmp_path / "runs" / "notes").mkdir()
    (tmp_path / "runs" / "wheel.yaml").touch()
    assert [recording.name for recording in gw.Recording.all(tmp_path / "runs")] == ["one", "two"]
    with pytest.raises(gw.InputError, match="no such folder"):
        gw.Recording.all(tmp_path / "none")


def test_public_functions_stay_functions_when_every_module_is_imported() -> None:
    """A module of the same name, once imported, would take the place of a function."""
    modules = {module.name for module in pkgutil.iter_modules(gw.__path__)}
    assert {"comparison", "diagnosis"} <= modules
    assert not modules & set(gw.__all__)


def test_simulated_recording_equals_the_one_of_the_command_line(
    wheel: Wheel, drag: gw.Recording, tmp_path: Path
) -> None:
    same = gw.Recording.open(wheel.recording)
    assert np.array_equal(same.measurement, drag.measurement)
    assert np.array_equal(same.setpoints, drag.setpoints)
    assert same.environment == drag.environment
    copy = drag.save(tmp_path / "copy")
    assert np.array_equal(copy.measurement, drag.measurement)
    assert copy.path == tmp_path / "copy"
    with pytest.raises(gw.InputError, match="exists"):
        drag.save(tmp_path / "copy")


def test_temporary_folder_goes_with_the_recording() -> None:
    recording = gw.simulate(SHORT_PLAN)
    folder = recording.path
    assert folder.is_dir()
    del recording
    assert not folder.exists()


def test_recording_has_columns_in_si_units_that_cannot_be_changed(drag: gw.Recording) -> None:
    columns = drag.to_columns()
    assert {"time", "tilt_x", "spin_rate", "coil_voltage_x", "air_pressure"} <= set(columns)
    assert {len(column) for column in columns.values()} == {len(drag)}
    assert columns["time"][-1] == pytest.approx(drag.duration)
    assert 3500.0 * np.pi / 30.0 == pytest.approx(columns["spin_rate"][:100].mean(), rel=1e-2)
    with pytest.raises(ValueError, match="read-only"):
        drag.measurement["tilt_x"][0] = 1.0
    assert drag.info.bench == "gyrowheel"
    assert drag.to_dict()["integrity"]["missing"] == 0


@pytest.mark.slow
def test_results_are_what_the_command_line_writes(gyrowheel: Shell, wheel: Wheel, tmp_path: Path) -> None:
    model = gw.Model.load(wheel.model)
    compared = gyrowheel("compare", wheel.recording, "--model", wheel.model, "--json", "-")
    result = gw.compare(wheel.recording, model)
    result.save(tmp_path / "compare.json")
    assert json.loads((tmp_path / "compare.json").read_text(encoding="utf-8")) == compared.json
    added = gyrowheel(
        *("model", "add", "windage", "--model", wheel.model, "--fit", wheel.recording),
        *("--validate", wheel.other, "--json", "-"),
    )
    by_hand = model.add("windage", fit=wheel.recording, validate=wheel.other)
    assert by_hand.added is not None
    by_hand.added.save(tmp_path / "added.json")
    assert json.loads((tmp_path / "added.json").read_text(encoding="utf-8")) == added.json
    saved = gw.Model.load(wheel.model)
    assert saved.effects == by_hand.effects
    gyrowheel("model", "undo", "--model", wheel.model)


@pytest.mark.slow
def test_diagnosis_names_what_is_missing(found: gw.Diagnosis, drag: gw.Recording) -> None:
    assert found.verdict == "effect"
    assert [f.name for f in found.effects] == ["windage"]
    assert "An effect is missing: drag of the air on the spin (windage)." in str(found)
    assert repr(found) == "<Diagnosis: An effect is missing: drag of the air on the spin (windage).>"
    assert found.to_dict()["effects"][0]["name"] == "windage"
    assert found.recordings == (str(drag.path),)
    assert found.limits


def test_add_leaves_the_model_unchanged(found: gw.Diagnosis, drag: gw.Recording, other: gw.Recording) -> None:
    model = gw.Model("gyrowheel")
    better = model.add(found, fit=drag, validate=other)
    assert not model.effects
    assert not model.history
    assert better.effects["windage"]["w"] == pytest.approx(0.0013, rel=0.1)
    assert len(better.history) == 1
    assert better.added is not None
    error = better.added.error
    assert error.validation_before is not None
    assert error.validation_after is not None
    assert error.validation_after.chi2_per_n < 0.5 * error.validation_before.chi2_per_n
    assert better.undo().to_dict() == model.to_dict()
    assert better.remove("windage").effects == {}
    assert any(line.startswith("+ effects.windage.w") for line in model.diff(better))


def test_a_saved_model_is_read_back(better: gw.Model, tmp_path: Path) -> None:
    better.save(tmp_path / "wheel.yaml")
    loaded = gw.Model.load(tmp_path / "wheel.yaml")
    assert loaded.effects == better.effects
    assert loaded.added is None
    with pytest.raises(gw.InputError, match="was not made by add"):
        loaded.plot()


def test_results_cannot_be_changed(found: gw.Diagnosis, drag: gw.Recording) -> None:
    with pytest.raises(AttributeError):
        found.effects = ()  # type: ignore[misc]
    with pytest.raises(AttributeError):
        found.verdict = "unknown"  # type: ignore[misc]
    compared = gw.compare(drag, gw.Model())
    with pytest.raises(TypeError):
        compared.channels["spin"] = None  # type: ignore[index]


def test_notebook_page_is_whole_html_with_the_verdict(
    found: gw.Diagnosis, better: gw.Model, drag: gw.Recording
) -> None:
    assert better.added is not None
    for result, words in (
        (found, "An effect is missing"),
        (gw.compare(drag, gw.Model()), "The model fails"),
        (better, "windage"),
        (better.added, "Error"),
        (drag, "spin rate"),
    ):
        page = Page(result._repr_html_())
        assert "table" in page.tags
        assert words in page.words


def test_notebook_page_escapes_what_users_wrote(tmp_path: Path) -> None:
    file = tmp_path / "<b>wheel&.yaml"
    gw.Model().save(file)
    html = gw.Model.load(file)._repr_html_()
    assert "<b>" not in html
    assert "&lt;b&gt;wheel&amp;" in html
    Page(html)


@pytest.mark.slow
def test_results_draw_themselves_without_pyplot_or_global_settings(
    found: gw.Diagnosis, better: gw.Model, drag: gw.Recording
) -> None:
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    for result in (found, better, drag, gw.compare(drag, gw.Model())):
        figure = result.plot()
        assert isinstance(figure, Figure)
        assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]
    assert dict(mpl.rcParams) == before
    code = (
        "import sys, gyrowheel as gw\n"
        "gw.simulate(sys.argv[1]).plot()\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, SHORT_PLAN], check=True)


def test_columns_have_a_row_for_each_coefficient(found: gw.Diagnosis, better: gw.Model) -> None:
    columns = found.to_columns()
    assert list(columns["coefficient"]) == ["w", "n"]
    assert set(columns["effect"]) == {"windage"}
    assert better.to_columns()["value"] == list(better.effects["windage"].values())


def test_frame_has_the_columns(found: gw.Diagnosis, drag: gw.Recording) -> None:
    frame = drag.to_frame()
    assert list(frame.columns) == list(drag.to_columns())
    assert len(frame) == len(drag)
    assert np.array_equal(frame["tilt_x"], drag.measurement["tilt_x"])
    assert list(found.to_frame()["coefficient"]) == ["w", "n"]


def test_frame_needs_pandas(found: gw.Diagnosis, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(gw.InputError, match="pip install pandas"):
        found.to_frame()


def test_nothing_is_printed_or_written(
    drag: gw.Recording, capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    gw.compare(drag, gw.Model(), progress=said.append)
    gw.Model().add("windage", fit=drag)
    assert said
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir())


def test_a_user_defined_effect_is_added_and_simulated(drag: gw.Recording) -> None:
    pull = gw.own_effect("axial_torque = -k*r", name="pull")
    model = gw.Model().add(pull, fit=drag)
    assert model.effects["pull"]["k"] > 0.0
    machine = gw.simulate(SHORT_PLAN, effects=[pull])
    assert len(machine)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: gw.Recording.open("nowhere"), "nowhere"),
        (lambda: gw.Model("nowhere"), "nowhere"),
        (lambda: gw.Model.load("nowhere.yaml"), "nowhere.yaml"),
        (lambda: gw.simulate("qick"), "did you mean quick"),
        (lambda: gw.simulate("quick", effects={"windge": {}}), "windage"),
        (lambda: gw.simulate("quick", effects={"windage": {"v": 1.0}}), "effects.windage.v"),
        (lambda: gw.simulate("quick", machine=-1), "machine: -1"),
        (lambda: gw.simulate("quick", seed=-1), "seed: -1"),
        (lambda: gw.effects["windge"], "did you mean windage"),
        (lambda: gw.plans["qick"], "did you mean quick"),
        (lambda: gw.benches["wheel"], "gyrowheel"),
    ],
)
def test_bad_input_is_one_line(call: Any, message: str) -> None:
    with pytest.raises(gw.InputError) as caught:
        call()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_recordings_to_fit_and_to_validate_are_different(drag: gw.Recording) -> None:
    with pytest.raises(gw.InputError, match="given twice"):
        gw.compare([drag, drag], gw.Model())
    with pytest.raises(gw.InputError, match="cannot validate the fit"):
        gw.diagnose(drag, gw.Model(), validate=drag.path)


def test_catalogues_list_all_shipped_items() -> None:
    assert gw.effects["windage"].name == "windage"
    assert "quick" in gw.plans
    assert gw.plans["quick"].duration > 10.0
    assert set(gw.benches) == {"gyrowheel", "dtg"}


def test_export_and_import_return_the_recording(drag: gw.Recording, tmp_path: Path) -> None:
    columns = gw.write_table(drag, tmp_path / "drag.parquet", column_map=tmp_path / "map.yaml")
    assert "tilt_x" in columns
    again = gw.read_table(tmp_path / "drag.parquet", tmp_path / "map.yaml")
    for name in ("tilt_x", "spin_rate", "coil_voltage_y"):
        assert np.array_equal(again.measurement[name], drag.measurement[name])


@pytest.mark.study  # test_investigate.py has the verb
@pytest.mark.slow
def test_investigation_ends_with_a_diagnosis_and_keeps_its_recordings(tmp_path: Path) -> None:
    said: list[str] = []
    done = gw.investigate(
        gw.Model(),
        plans=[DRAG_PLAN],
        budget=1.0,
        effects={"windage": {"w": 0.0013}},
        folder=tmp_path / "all",
        progress=said.append,
    )
    assert done.steps
    assert done.diagnosis is not None
    assert [f.name for f in done.diagnosis.effects] == ["windage"]
    assert done.to_dict()["named"] == ["windage"]
    assert gw.Recording.open(done.recordings[0]).duration > 1.0
    assert said
    assert done.reason in str(done)
    assert "windage" in Page(done._repr_html_()).words


@pytest.mark.study  # test_campaign.py has the verb
@pytest.mark.slow
def test_campaign_counts_its_cases(tmp_path: Path) -> None:
    told: list[int] = []
    result = gw.campaign(
        DRAG_PLAN,
        cases=2,
        only=[0],
        kinds=["none", "single"],
        validation_plan=OTHER_PLAN,
        progress=lambda done, total: told.append(len(done)),
    )
    assert told == [0, 1]
    assert result.to_dict()["cases"] == 1
    assert len(result.to_columns()["case"]) == 1
    assert not result.interrupted
    with pytest.raises(gw.InputError, match="kinds: 'double'"):
        gw.campaign(kinds=["double"])
