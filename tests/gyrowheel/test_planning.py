"""User-defined plan files, from the command line and from Python."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import gyrowheel as gw

from .helpers import TOO_FAST_PLAN, Shell, write

SHORT_HOLD = (
    "schema: 1\nname: brief\nsegments:\n  - {label: brief, spin_rpm: 3000, tilt_deg: [1, 0], hold_s: 0.4}\n"
)


def test_a_new_plan_is_good_and_is_not_overwritten(gyrowheel: Shell, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    shown = gyrowheel.good("plans", "--new", file).out
    assert f"gyrowheel plans --check {file}" in shown
    page = gyrowheel.good("plans", "--check", file).out
    for text in (
        "Nothing is wrong: the bench gyrowheel can run it",
        "3 speeds, 1500 .. 3500 rpm",
        "windows of whole",
    ):
        assert text in page
    found = gyrowheel.good("plans", "--check", file, "--json", "-").json
    assert (found["good"], found["wrong"]) == (True, [])
    assert found == json.loads(json.dumps(gw.check_plan(file).to_dict()))
    assert 0.0 < found["outlook"]["coil_share"] < 0.75
    again = gyrowheel("plans", "--new", file)
    assert (again.code, "exists" in again.err) == (2, True)
    # of another bench it is refused there, and one for that bench is not
    assert gyrowheel("plans", "--check", file, "--bench", "dtg").code == 2
    gyrowheel.good("plans", "--new", tmp_path / "small.yaml", "--bench", "dtg")
    gyrowheel.good("plans", "--check", tmp_path / "small.yaml", "--bench", "dtg")


def test_one_page_shows_all_errors_of_a_plan_file(gyrowheel: Shell, tmp_path: Path) -> None:
    file = write(tmp_path / "mine.yaml", TOO_FAST_PLAN.replace("name: too_fast", "name: too_fast\nholds: 2"))
    shown = gyrowheel("plans", "--check", file)
    assert shown.code == 2
    assert "2 things are wrong for the bench gyrowheel" in shown.out
    assert "did you mean hold_s?" in " ".join(shown.out.split())
    assert "1000 .. 4000 rpm" in shown.out
    found = gw.check_plan(file)
    assert not found.good
    assert found.headline() == f"{file}: 2 errors, bench gyrowheel"
    assert list(found.to_columns()["line"]) == [3, 5]
    wide = write(tmp_path / "wide.yaml", SHORT_HOLD.replace("[1, 0]", "[4, 0]"))
    (wrong,) = gw.check_plan(wide).wrong
    assert wrong.place == "tilt_limit_deg"
    assert "a plan that needs more says so by tilt_limit_deg, up to 4.75" in wrong.said


def test_a_hold_without_a_window_is_reported(tmp_path: Path) -> None:
    found = gw.check_plan(write(tmp_path / "brief.yaml", SHORT_HOLD))
    assert found.good
    assert found.outlook is not None
    assert found.outlook.windows == 0
    assert "No window: segment 0 (brief), 0.4 s steady" in " ".join(str(found).split())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--new", "a.yaml", "--schema"], "--new: cannot be combined with --schema"),
        (["quick", "--check", "a.yaml"], "--check: cannot be combined with 'quick'"),
        (["--check", "none.yaml"], "none.yaml"),
    ],
)
def test_invalid_options_are_refused(gyrowheel: Shell, arguments: list[str], said: str) -> None:
    result = gyrowheel("plans", *arguments)
    assert result.code == 2
    assert said in result.err


def test_the_schema_is_json(gyrowheel: Shell) -> None:
    schema = gyrowheel.good("plans", "--schema").json
    assert {"schema", "name", "segments"} <= set(schema["properties"])
    assert schema["required"] == ["schema", "name", "segments"]
