"""The command line: what every verb promises, and what it says to bad input."""

from __future__ import annotations

import json
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import psutil
import pytest
import typer
from typer.testing import CliRunner

from gyrowheel.cli.app import app
from gyrowheel.simulation.scenario import noise_seed
from gyrowheel_analysis.diagnosis import diagnose as kept_diagnosis
from gyrowheel_analysis.diagnosis import explanation, kept_explanation
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench

from .conftest import Wheel
from .helpers import DRAG_PLAN, SHORT_PLAN, TOO_FAST_PLAN, Result, Shell, write

#: The rest of an addition to a model.
ADD = ["--model", "new.yaml", "--fit", "x"]
COMMAND: Any = typer.main.get_command(app)


def verbs(command: Any = COMMAND, before: str = "") -> Iterator[tuple[str, Any]]:
    """Go through all verbs, those of groups too: what one types, and the command."""
    for name, verb in command.commands.items():
        if hasattr(verb, "commands"):
            yield from verbs(verb, f"{before}{name} ")
        else:
            yield before + name, verb


VERBS = dict(verbs())


# ---- help


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_every_verb_has_help_with_an_example(gyrowheel: Shell, verb: str):
    shown = gyrowheel.good(*verb.split(), "--help").out
    assert f"Example: gyrowheel {verb}" in shown


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_help_shows_the_whole_text_of_an_option(gyrowheel: Shell, verb: str):
    shown = "".join(gyrowheel.good(*verb.split(), "--help").out.replace("│", " ").split())
    for option in VERBS[verb].params:
        if not option.hidden:
            assert "".join((option.help or "").split()) in shown, option.name


def test_run_lists_packages_and_executables(gyrowheel: Shell):
    everything = gyrowheel.good("run").out.splitlines()
    assert {"gyrowheel_sim", "  plant_node", "gyrowheel_recording", "  recorder_node"} <= set(everything)
    assert gyrowheel.good("run", "gyrowheel_sim").out.splitlines() == ["gyrowheel_sim", "  plant_node"]
    unknown = gyrowheel("run", "gyrowheel_simm")
    assert unknown.code == 2
    assert "gyrowheel_simm" in unknown.err


def test_help_lists_every_verb(gyrowheel: Shell):
    shown = gyrowheel.good().out
    assert all(f" {verb} " in shown for verb in COMMAND.commands)


def test_help_imports_no_heavy_module():
    code = (
        "import sys; from gyrowheel.cli.app import app; from gyrowheel.cli.console import run; run(app, ['--help']);"
        "print('heavy:', sorted({'numba', 'scipy', 'sympy', 'matplotlib', 'rclpy', 'numpy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("heavy: []\n")


# ---- bad input


def assert_refused(result: Result, *words: str) -> None:
    """Check for exit 2 and one line."""
    assert result.code == 2
    assert result.out == ""
    (line,) = result.err.splitlines()
    assert line.startswith("error: ")
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nosuch"], ["nosuch"]),
        (["--nosuch"], ["--nosuch"]),
        (["simulate", "-o", "x"], ["--plan", "gyrowheel simulate --help"]),
        (["simulate", "--plan", "quick"], ["--output"]),
        (["simulate", "--plan", "quik", "-o", "x"], ["quik", "quick"]),
        (["simulate", "--plan", "quick", "-o", "x", "--seed", "-1"], ["seed", "-1"]),
        (["simulate", "--plan", "quick", "-o", "x", "--seed", "one"], ["--seed"]),
        (["simulate", "--plan", "quick", "-o", "x", "--machine", "-1"], ["machine", "-1"]),
        (["simulate", "--plan", "quick", "-o", "x", "--bench", "nosuch"], ["nosuch"]),
        (["simulate", "--plan", "quick", "-o", "x", "--effect", "windge"], ["windge", "windage"]),
        (
            ["simulate", "--plan", "quick", "-o", "x", "--effect", "windage:w=7"],
            ["windage.w", "7", "allowed"],
        ),
        (["simulate", "--plan", "quick", "-o", "x", "--effect", "windage:q=1"], ["windage.q", "w, n"]),
        (["simulate", "--plan", "quick", "-o", "x", "--effect", "windage", "--effect", "windage"], ["twice"]),
        (["simulate", "--plan", "quick", "-o", "x", "--effect", "windage", "--blind", "key"], ["blind"]),
        (["simulate", "--plan", "quick", "-o", "x", "--model", "none.yaml"], ["none.yaml"]),
        (["simulate", "--plan", "quick", "-o", "x", "--truth", "none.yaml"], ["none.yaml"]),
        (["simulate", "--plan", "quick", "-o", "x", "--truth", "new.yaml", "--blind", "key"], ["blind"]),
        (["simulate", "--plan", "quick", "-o", "x", "--truth", "new.yaml", "--effect", "windge"], ["windge"]),
        (["simulate", "--plan", "quick", "-o", "x", "--machine", "1.5"], ["--machine", "1.5", "whole"]),
        (
            ["simulate", "--plan", "quick", "-o", "x", "--effect", "windage:w=0.001,w=0.002"],
            ["w is given twice"],
        ),
        (["simulate", "--plan", "quick", "-o", "x", "--effect", "windage:"], ["'windage:'", "COEF=VALUE"]),
        (["simulate", "--plan", "quick@hold_s=1e9", "-o", "x"], ["hold_s", "1e9", "3600"]),
        (["simulate", "--plan", "survey@hold_s=3600", "-o", "x"], ["long", "allowed: up to 86400 s"]),
        (
            ["simulate", "--plan", "quick", "-o", "x", "--blind", "new.yaml"],
            ["new.yaml", "not valid JSON", "name a new file"],
        ),
        (["investigate", "--model", "new.yaml", "--budget", "-1"], ["--budget", "-1", ">= 0"]),
        (["compare", "x", "--model", "new.yaml", "--fail-above", "-1"], ["--fail-above", "-1", ">= 0"]),
        (["info", "new.yaml"], ["new.yaml", "not a recording"]),
        (["demo", "-o", "new.yaml/demo"], ["new.yaml/demo", "cannot be written"]),
        (["up", "--plan", "quik", "--record", "x"], ["quik"]),
        (["up", "--plan", "quick", "--record", "x", "--model", "none.yaml"], ["none.yaml"]),
        (["info", "x"], ["x", "no such recording"]),
        (["compare", "x", "--model", "none.yaml"], ["none.yaml"]),
        (["diagnose", "x"], ["--model"]),
        (["model", "show", "--model", "none.yaml"], ["none.yaml"]),
        (["model", "add", "windge", "--model", "new.yaml", "--fit", "x"], ["windge", "windage"]),
        (["model", "add", "--model", "new.yaml", "--fit", "x"], ["nothing to add"]),
        (["model", "add", *ADD, "--formula", "-k*Omgea*z"], ["own.rotor_torque: column 4", "Omega"]),
        (
            ["model", "add", *ADD, "--formula", "-k*z; k [N*m*s]"],
            ["own.rotor_torque: column 1", "N*m is needed"],
        ),
        (["model", "add", *ADD, "--formula", "k*__import__('os')"], ["own.rotor_torque: column 3"]),
        (["model", "add", *ADD, "--formula", "(" * 10_000], ["--formula", "10000"]),
        (["model", "add", *ADD, "--formula", "windage: shaft_torque = -w*r"], ["'windage' already"]),
        (["model", "add", *ADD, "--formula", "-k*z", "--name", "a b"], ["--formula", "'a b'"]),
        (["model", "add", *ADD, "--formula", "-k*z", "--target", "rotor"], ["'rotor'", "rotor_torque"]),
        (["model", "add", *ADD, "--formula", "-k*z", "--formula", "-k*r*z", "--name", "a"], ["--name", "2"]),
        (["model", "add", "windage", *ADD, "--target", "shaft_torque"], ["--target", "--formula"]),
        (["effects", "windge"], ["windge", "windage"]),
        (["effects", "windage", "--json", "new.yaml/file"], ["cannot be written"]),
        (["plans", "quik"], ["quik", "quick"]),
        (["run", "gyrowheel_sim", "nosuch_node"], ["nosuch_node"]),
        (["demo", "--seed", "-1"], ["--seed"]),
    ],
    ids=lambda value: " ".join(value) if value and value[0].islower() and len(value) > 1 else "-",
)
def test_bad_input_is_one_line_and_exit_2(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: list[str]
):
    monkeypatch.chdir(tmp_path)
    gyrowheel.good("model", "new", "--model", "new.yaml")
    assert_refused(gyrowheel(*arguments), *words)
    assert [path.name for path in tmp_path.iterdir()] == ["new.yaml"]


@pytest.mark.parametrize("verb", ["simulate", "up"])
def test_a_plan_beyond_the_bench_is_refused_before_anything_is_written(
    gyrowheel: Shell, tmp_path: Path, verb: str
):
    plan = write(tmp_path / "plan.yaml", TOO_FAST_PLAN)
    output = "--output" if verb == "simulate" else "--record"
    result = gyrowheel(verb, "--plan", plan, output, tmp_path / "run", "--blind", tmp_path / "key.json")
    assert_refused(result, "plan.yaml", "9000 rpm", "1000 .. 4000 rpm")
    assert list(tmp_path.iterdir()) == [plan]


def test_a_run_that_would_not_fit_the_memory_is_refused(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    text = "schema: 1\nname: long\nsegments:\n  - {spin_rpm: 3000, tilt_deg: [[0, 0]], hold_s: 3600}\n"
    plan = write(tmp_path / "plan.yaml", text)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=1e9))
    result = gyrowheel("simulate", "--plan", plan, "-o", tmp_path / "run")
    assert_refused(result, "plan long: 3600 s", "1.3 GB", "allowed: 1 GB", "gyrowheel up")
    assert list(tmp_path.iterdir()) == [plan]


@pytest.mark.parametrize("verb", ["compare", "diagnose"])
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("effects: {windge: {w: 0.001}}", ["effects", "windge", "windage"]),
        ("effects: {windage: {w: 5.0}}", ["effects.windage.w", "5", "-0.1 .. 0.1"]),
        ("effects: {windage: {w: .nan}}", ["effects.windage.w", "nan"]),
        ("overrides: {coil_constant: -1.0}", ["overrides.coil_constant", "-1"]),
        ("nosuch: 1", ["nosuch"]),
        ("effects: [", ["YAML"]),
    ],
)
def test_a_bad_model_is_refused(
    gyrowheel: Shell, wheel: Wheel, tmp_path: Path, verb: str, text: str, words: list[str]
):
    model = write(tmp_path / "model.yaml", f"schema: 1\nbench: gyrowheel\n{text}\n")
    assert_refused(gyrowheel(verb, wheel.recording, "--model", model), "model.yaml", *words)


@pytest.mark.parametrize("verb", ["info", "compare", "diagnose", "add"])
def test_a_truncated_recording_is_refused(gyrowheel: Shell, wheel: Wheel, tmp_path: Path, verb: str):
    damaged = tmp_path / "damaged"
    shutil.copytree(wheel.recording, damaged)
    (file,) = damaged.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    model = tmp_path / "model.yaml"
    shutil.copy(wheel.model, model)
    arguments = {
        "info": ["info", damaged],
        "add": ["model", "add", "windage", "--model", model, "--fit", damaged],
    }.get(verb, [verb, damaged, "--model", model])
    result = gyrowheel(*arguments)
    assert_refused(result, str(file))
    assert model.read_bytes() == wheel.model.read_bytes()


def test_a_recording_is_not_overwritten(gyrowheel: Shell, wheel: Wheel):
    before = sorted(path.stat().st_mtime_ns for path in wheel.recording.iterdir())
    assert_refused(gyrowheel("simulate", "--plan", "quick", "-o", wheel.recording), "exists")
    assert_refused(gyrowheel("up", "--plan", "quick", "--record", wheel.recording), "exists")
    assert sorted(path.stat().st_mtime_ns for path in wheel.recording.iterdir()) == before


def test_a_recording_given_twice_is_refused(gyrowheel: Shell, wheel: Wheel):
    again = wheel.recording.parent / "." / wheel.recording.name
    assert_refused(gyrowheel("compare", wheel.recording, again, "--model", wheel.model), "twice")
    arguments = ["--model", wheel.model, "--fit", wheel.recording, "--validate", wheel.recording]
    assert_refused(gyrowheel("model", "add", "windage", *arguments), "cannot validate")


def test_interruption_is_exit_130_and_leaves_nothing(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(directory: Path, *rest: object, **options: object) -> None:
        directory.mkdir()
        (directory / "half.mcap").write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr("gyrowheel.simulation.api.write_run", interrupted)
    plan = write(tmp_path / "plan.yaml", SHORT_PLAN)
    assert gyrowheel("simulate", "--plan", plan, "-o", tmp_path / "run").code == 130
    assert list(tmp_path.iterdir()) == [plan]


# ---- running


def test_simulate_records_the_run_and_nothing_of_the_truth(gyrowheel: Shell, tmp_path: Path):
    plan = write(tmp_path / "plan.yaml", SHORT_PLAN)
    run = tmp_path / "run"
    arguments = ["--plan", plan, "-o", run, "--effect", "windage:w=0.00123", "--seed", 987654, "--json", "-"]
    result = gyrowheel.good("simulate", *arguments).json
    assert result["plan"] == "short"
    assert result["recording"] == str(run)
    assert result["ratio"] == pytest.approx(result["simulated_seconds"] / result["wall_seconds"])
    content = b"".join(path.read_bytes() for path in run.iterdir())
    assert b"windage" not in content
    assert b"987654" not in content
    assert sorted(path.name for path in run.iterdir()) == ["metadata.yaml", "run_0.mcap"]
    found = gyrowheel.good("info", run, "--json", "-").json
    assert (found["bench"], found["integrity"]["missing"]) == ("gyrowheel", 0)
    assert found["topics"]["/gyrowheel/measurement"] == round(result["simulated_seconds"] / 0.0005)


def test_the_same_seed_gives_the_same_recording(gyrowheel: Shell, tmp_path: Path):
    plan = write(tmp_path / "plan.yaml", SHORT_PLAN)
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        gyrowheel.good("simulate", "--plan", plan, "-o", tmp_path / folder / "run", "--seed", seed)
    a, b, c = (Recording.open(tmp_path / folder / "run") for folder in "abc")
    for topic in ("measurement", "command", "setpoint", "drag_estimate"):
        # compared field by field: what is no number equals itself here
        assert repr(getattr(a, topic).tolist()) == repr(getattr(b, topic).tolist())
    assert not np.array_equal(a.readings.array, c.readings.array)


def test_noise_differs_between_seeds_and_between_plans():
    seeds = {noise_seed(seed, plan) for seed in range(50) for plan in ("quick", "check", "survey")}
    assert len(seeds) == 150
    with pytest.raises(InputError, match="seed"):
        noise_seed(-1, "quick")


def test_a_key_is_drawn_once_and_used_again(gyrowheel: Shell, tmp_path: Path):
    plan, key = write(tmp_path / "plan.yaml", SHORT_PLAN), tmp_path / "key.json"
    gyrowheel.good("simulate", "--plan", plan, "-o", tmp_path / "a", "--blind", key, "--seed", 3)
    drawn = key.read_text()
    assert set(json.loads(drawn)) == {"values", "effects", "machine"}
    gyrowheel.good("simulate", "--plan", plan, "-o", tmp_path / "b", "--blind", key, "--seed", 4)
    assert key.read_text() == drawn


# ---- comparing and diagnosing

RMS = {"tilt_x": float, "tilt_y": float, "spin": float}
ROW = {"rms": RMS, "chi2_per_n": float}


def assert_shape(value: object, shape: object, place: str = "") -> None:
    """Check that a JSON value has the fields and types of a shape; further fields are allowed."""
    if isinstance(shape, dict):
        assert isinstance(value, dict), place
        for key, inner in shape.items():
            if key is str:  # any key
                for name, entry in value.items():
                    assert_shape(entry, inner, f"{place}.{name}")
            else:
                assert key in value, f"{place}.{key}"
                assert_shape(value[key], inner, f"{place}.{key}")
    elif isinstance(shape, list):
        assert isinstance(value, list), place
        for index, entry in enumerate(value):
            assert_shape(entry, shape[0], f"{place}.{index}")
    elif shape is float:
        assert isinstance(value, float | int), place
        assert not isinstance(value, bool), place
    else:
        assert isinstance(value, shape), place  # type: ignore[arg-type]


def test_compare(gyrowheel: Shell, wheel: Wheel):
    shown = gyrowheel.good("compare", wheel.recording, "--model", wheel.model)
    assert "Where the model fails" in shown.out
    assert all(len(line) <= 80 and not line.endswith(" ") for line in shown.out.splitlines())
    result = gyrowheel.good("compare", wheel.recording, "--model", wheel.model, "--json", "-").json
    metrics = dict.fromkeys(
        ["rms", "fit_percent", "theil", "theil_bias", "theil_variance", "theil_covariance"], float
    )
    assert_shape(
        result,
        {
            "schema": int,
            "error": {"unit": str, "before": ROW},
            "where": [{"region": str, "share_of_chi2": float, "description": str}],
            "channels": {name: {**metrics, "chi2_per_n": float} for name in RMS},
        },
    )


def test_compare_fails_a_script_above_its_limit(gyrowheel: Shell, wheel: Wheel):
    arguments = ["compare", wheel.recording, "--model", wheel.model]
    assert gyrowheel(*arguments, "--fail-above", 1.5).code == 1
    assert gyrowheel(*arguments, "--fail-above", 1e6).code == 0


@pytest.mark.slow
def test_diagnose_keeps_the_json_contract(gyrowheel: Shell, wheel: Wheel, tmp_path: Path):
    file = tmp_path / "diagnosis.json"
    arguments = [
        "diagnose",
        wheel.recording,
        "--model",
        wheel.model,
        "--validate",
        wheel.other,
        "--json",
        file,
    ]
    shown = gyrowheel(*arguments, "--fail-on-finding")
    assert shown.code == 1
    assert "drag of the air on the spin" in shown.out
    assert "Detection limits: what these recordings could not show" in shown.out
    assert f"gyrowheel model add windage --model {wheel.model} --fit {wheel.recording}" in shown.out
    result = json.loads(file.read_text())
    coefficient = {"value": float, "standard_error": float, "unit": str, "parts": dict, "interval": [float]}
    assert_shape(
        result,
        {
            "schema": int,
            "verdict": str,
            "effects": [
                {
                    "name": str,
                    "coefficients": {str: coefficient},
                    "delta_chi2": float,
                    "formula": str,
                    "ties": [{"name": str, "delta_chi2": float}],
                }
            ],
            "free_form": [{"formula": str, "delta_chi2": float, "coefficients": dict}],
            "error": {
                "unit": str,
                "before": ROW,
                "after": ROW,
                "validation_before": ROW,
                "validation_after": ROW,
                "noise_floor": {"rms": RMS},
            },
            "where": [{"region": str, "share_of_chi2": float, "description": str}],
            "nuisance": {
                str: {
                    "value": float,
                    "standard_error": float,
                    "prior_value": float,
                    "prior_uncertainty": float,
                }
            },
            "recordings": [str],
            "model": str,
            "versions": {str: str},
        },
    )
    assert "next_test" in result
    assert result["schema"] == 1
    assert [effect["name"] for effect in result["effects"]] == ["windage"]


@pytest.mark.slow
def test_ctrl_c_ends_a_search_with_what_it_has(
    gyrowheel: Shell, wheel: Wheel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any) -> None:
        signal.raise_signal(signal.SIGINT)

    # no search of another test
    for module in (kept_explanation, kept_diagnosis):
        monkeypatch.setattr(module, "_key", lambda *_: f"key_of_{tmp_path.name}")
    monkeypatch.setattr(explanation, "_explained", interrupted)
    shown = gyrowheel("diagnose", wheel.recording, "--model", wheel.model)
    assert shown.code == 130
    assert "drag of the air on the spin" in shown.out
    assert "The search ended early" in shown.out
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# ---- the model file


def test_a_file_of_another_kind_is_named(gyrowheel: Shell, tmp_path: Path) -> None:
    model, bench, plan = (tmp_path / f"{name}.yaml" for name in ("model", "bench", "plan"))
    gyrowheel.good("model", "new", "--model", model)
    gyrowheel.good("bench", "--new", bench)
    plan.write_text("schema: 1\nname: own\nsegments: []\n", encoding="utf-8")
    assert_refused(
        gyrowheel("model", "show", "--model", bench), f"{bench}: is a bench file; allowed: a model file"
    )
    assert_refused(gyrowheel("bench", "--bench", model), f"{model}: is a model file; allowed: a bench file")
    assert_refused(gyrowheel("bench", "--bench", plan), f"{plan}: is a plan; allowed: a bench file")
    assert_refused(gyrowheel("plans", model), f"{model}: is a model file; allowed: a plan")


@pytest.mark.slow
def test_model_verbs_in_sequence(gyrowheel: Shell, wheel: Wheel, tmp_path: Path):
    model, first = tmp_path / "model.yaml", tmp_path / "first.yaml"
    gyrowheel.good("model", "new", "--model", model)
    assert_refused(gyrowheel("model", "new", "--model", model), "exists")
    shutil.copy(model, first)
    arguments = ["--model", model, "--fit", wheel.recording, "--validate", wheel.other]
    added = gyrowheel.good("model", "add", "windage", *arguments)
    assert "validation" in added.out
    content = gyrowheel.good("model", "show", "--model", model, "--json", "-").json
    assert content["effects"]["windage"]["w"]["value"] == pytest.approx(1.3e-3, rel=0.2)
    assert "add windage" in gyrowheel.good("model", "show", "--model", model).out
    different = gyrowheel.good("model", "diff", first, model, "--json", "-").json["differences"]
    assert any(line.startswith("+ effects.windage.w") for line in different)
    gyrowheel.good("model", "add", "windage", *arguments)
    assert "fit again windage" in gyrowheel.good("model", "show", "--model", model).out
    gyrowheel.good("model", "remove", "windage", "--model", model)
    assert "windage" not in gyrowheel.good("model", "show", "--model", model, "--json", "-").json["effects"]
    for _ in ("remove", "fit again", "add"):
        gyrowheel.good("model", "undo", "--model", model)
    assert gyrowheel.good("model", "diff", first, model).out == "no difference\n"
    assert_refused(gyrowheel("model", "undo", "--model", model), "nothing to undo")


def test_add_of_several_effects(gyrowheel: Shell, wheel: Wheel, tmp_path: Path):
    model = tmp_path / "model.yaml"
    shutil.copy(wheel.model, model)
    arguments = ["windage", "aero_cross", "--model", model, "--fit", wheel.recording, "--json", "-"]
    result = gyrowheel.good("model", "add", *arguments).json
    assert set(result["effects"]) == {"windage", "aero_cross"}
    assert_shape(result["error"], {"unit": str, "before": ROW, "after": ROW, "noise_floor": ROW})


@pytest.mark.study  # tests/test_recipes.py does the same
def test_a_formula_is_added_and_is_the_truth_of_a_machine(gyrowheel: Shell, wheel: Wheel, tmp_path: Path):
    model, plan = tmp_path / "model.yaml", write(tmp_path / "plan.yaml", SHORT_PLAN)
    shutil.copy(wheel.model, model)
    arguments = ["--model", model, "--fit", wheel.recording, "--validate", wheel.other, "--json", "-"]
    formula = ["--formula", "-w*r^1.48", "--target", "axial_torque", "--name", "drag"]
    added = gyrowheel.good("model", "add", *formula, *arguments).json
    # the recording has windage of 1.3 mN·m with this exponent
    assert added["effects"]["drag"]["w"]["value"] == pytest.approx(1.3e-3, rel=0.1)
    after, before = (added["error"][f"validation_{when}"]["rms"]["spin"] for when in ("after", "before"))
    assert after < 0.2 * before
    shown = gyrowheel.good("model", "show", "--model", model).out
    assert "torque along the spin axis = −w·" in shown
    # a second formula gets a name of its own, a third another
    gyrowheel.good("model", "add", "--formula", "-k*r*z", *arguments[:4])
    both = gyrowheel.good("model", "add", "--formula", "c*z", "--formula", "i*c*r*z", *arguments).json
    assert list(both["effects"]) == ["drag", "own", "own_2", "own_3"]
    gyrowheel.good("model", "undo", "--model", model)
    gyrowheel.good("model", "undo", "--model", model)
    # the machine of the model: its effect and its learned parameters, an effect beside them
    runs = {
        "stated": [],
        "learned": ["--truth", model],
        "more": ["--truth", model, "--effect", "fixed_torque"],
    }
    rows = {}
    for name, options in runs.items():
        gyrowheel.good("simulate", "--plan", plan, "-o", tmp_path / name, *options)
        recording = Recording.open(tmp_path / name)
        assert b"drag" not in (tmp_path / name / f"{name}_0.mcap").read_bytes().replace(b"drag_estimate", b"")
        rows[name] = recording.readings.array
    assert not np.array_equal(rows["stated"], rows["learned"])
    assert not np.array_equal(rows["learned"], rows["more"])
    twice = gyrowheel("simulate", "--plan", plan, "-o", tmp_path / "x", *runs["learned"], "--effect", "drag")
    assert_refused(twice, "drag", "model.yaml", "already")


@pytest.mark.slow
def test_the_machine_of_a_model_is_explained_by_it(
    gyrowheel: Shell, wheel: Wheel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A round trip: what the model says is simulated, and the model then lacks nothing."""
    model = tmp_path / "model.yaml"
    content = {
        "schema": 1,
        "bench": "gyrowheel",
        "overrides": {"coil_constant": 0.0208, "fixed_torque_x": 2e-4},
        "effects": {
            "pull": {
                "declaration": {"torque": "-k*r*z", "coefficients": {"k": {"unit": "N*m/rad"}}},
                "k": {"value": 0.03, "standard_error": 0.001},
            }
        },
    }
    write(model, json.dumps(content))
    plan = write(tmp_path / "plan.yaml", DRAG_PLAN)
    gyrowheel.good("simulate", "--plan", plan, "-o", tmp_path / "run", "--truth", model)
    raw = gyrowheel.good("compare", tmp_path / "run", "--model", model, "--json", "-").json
    for channel in raw["channels"].values():
        assert channel["chi2_per_n"] < 2.0
    # nothing fitted: the file alone predicts the recording, and what another one lacks is not searched
    monkeypatch.setattr(kept_explanation, "explained", lambda first, *_: explanation.unexplained(first))
    other = gyrowheel.good("compare", tmp_path / "run", "--model", wheel.model, "--json", "-").json
    for channel in ("tilt_x", "tilt_y"):
        assert raw["error"]["raw"]["rms"][channel] < 0.1 * other["error"]["raw"]["rms"][channel]


@pytest.mark.study  # test_model_file.py adds a proposal to a model
@pytest.mark.slow
def test_the_proposed_formula_is_valid_input(gyrowheel: Shell, tmp_path: Path):
    key = write(tmp_path / "key.json", '{"values": {}, "effects": {"contact": {"A": 0.02, "p": 0.45}}}')
    for name in ("quick", "check"):
        gyrowheel.good("simulate", "--plan", name, "-o", tmp_path / name, "--blind", key)
    models = [tmp_path / name for name in ("a.yaml", "b.yaml")]
    for model in models:
        gyrowheel.good("model", "new", "--model", model)
    file = tmp_path / "diagnosis.json"
    options = [tmp_path / "quick", "--model", models[0], "--validate", tmp_path / "check", "--json", file]
    shown = gyrowheel.good("diagnose", *options).out
    found = json.loads(file.read_text())
    assert found["verdict"] == "unknown"
    (form,) = found["free_form"]

    # the command that is shown
    command = shlex.split(shown.splitlines()[-1])
    assert command[:3] == ["gyrowheel", "model", "add"]
    gyrowheel.good(*command[1:])
    # the formula of the JSON
    fit = ["--fit", tmp_path / "quick"]
    gyrowheel.good("model", "add", "--formula", form["formula"], "--model", models[1], *fit)

    contents = [
        gyrowheel.good("model", "show", "--model", model, "--json", "-").json["effects"] for model in models
    ]
    assert [list(content) for content in contents] == [[form["name"]], ["own"]]
    first, second = (next(iter(content.values())) for content in contents)
    assert second["a"]["value"] == pytest.approx(first["a"]["value"], rel=1e-3)
    # what was found, with its edge, and not where the fit of the family began
    for name, estimate in form["coefficients"].items():
        error = estimate["standard_error"]
        # each fit estimates the drift again, which moves a zero amplitude more than a real one
        allowed = 0.5 if abs(estimate["value"]) > 5.0 * error else 3.0
        assert abs(first[name]["value"] - estimate["value"]) < allowed * error
    edge = form["coefficients"]["p"]["value"]
    assert f"p = {edge:.6g} +- " in shown.splitlines()[-1]
    assert form["declaration"]["coefficients"]["p"]["value"] == pytest.approx(edge, rel=1e-5)
    error = gyrowheel.good("model", "show", "--model", models[0], "--json", "-").json["history"][0]["error"]
    assert error["validation_after"]["chi2_per_n"] < 0.5 * error["validation_before"]["chi2_per_n"]


# ---- the catalogue


def test_catalogue_as_json(gyrowheel: Shell):
    effects = gyrowheel.good("effects", "--json", "-").json["effects"]
    assert "windage" in [effect["name"] for effect in effects]
    effect = gyrowheel.good("effects", "windage", "--json", "-").json
    assert set(effect["coefficients"]) == {"w", "n"}
    assert set(effect["look_alikes"]) == {"bearing_viscous", "bearing_coulomb"}
    error = gyrowheel.good("effects", "coil_gain_error", "--json", "-").json
    assert error["parameters"]["coil_constant"]["value"] == Bench.load().parameters["coil_constant"].value
    assert "coil_heating" in error["look_alikes"]
    plans = gyrowheel.good("plans", "--json", "-").json["plans"]
    assert {"quick", "check"} <= {plan["name"] for plan in plans}
    plan = gyrowheel.good("plans", "quick", "--json", "-").json
    assert plan["segments"][-1]["start"] < plan["duration"] <= 60.0
    bench = gyrowheel.good("bench", "--json", "-").json
    assert set(bench["parameters"]) == set(Bench.load().parameters)


def test_catalogue_as_text(gyrowheel: Shell):
    for arguments in (["effects"], ["effects", "windage"], ["plans"], ["plans", "quick"], ["bench"]):
        shown = gyrowheel.good(*arguments).out
        assert all(len(line) <= 80 for line in shown.splitlines()), arguments
    shown = gyrowheel.good("effects", "windage").out
    assert "0.8 .. 1.3 mN·m" in shown
    assert "assumed: usual size" in shown
    assert "Confounders" in shown


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("gyrowheel dia", "diagnose"),
        ("gyrowheel model sh", "show"),
        ("gyrowheel diagnose --va", "--validate"),
    ],
)
def test_a_shell_completes_verbs_and_options(words: str, wanted: str) -> None:
    asked = {
        "_GYROWHEEL_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    assert CliRunner().invoke(app, [], prog_name="gyrowheel", env=asked).output.split() == [wanted]
