"""Errors on broken recordings name the cure; recordings print a page; a key file gets a name."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import gyrowheel as gw

from .helpers import SHORT_PLAN, Shell, write


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> gw.Recording:
    return gw.simulate(SHORT_PLAN, folder=tmp_path_factory.mktemp("words") / "short")


def test_an_error_on_a_broken_recording_names_the_cure(
    gyrowheel: Shell, short: gw.Recording, tmp_path: Path
) -> None:
    cut, begun = tmp_path / "cut", tmp_path / "begun"
    for folder in (cut, begun):
        shutil.copytree(short.path, folder)
    (file,) = cut.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-200])
    (begun / "metadata.yaml").unlink()
    for number, broken in enumerate((cut, file, begun)):
        result = gyrowheel("info", broken)
        assert result.code == 2
        assert f"gyrowheel salvage {broken} -o DIR saves what can be read" in result.err
        assert len(result.err.splitlines()) == 1
        # and so it does
        saved = tmp_path / f"saved{number}"
        gyrowheel.good("salvage", broken, "-o", saved)
        assert len(gw.Recording.open(saved)) > 100
    nothing = gyrowheel("info", tmp_path)
    assert nothing.code == 2
    assert "salvage" not in nothing.err


def test_a_recording_prints_its_page_and_has_a_repr_of_one_line(short: gw.Recording) -> None:
    page = str(short)
    for words in ("bench", "2000.0 Hz", "spin rate", "tilt", "Messages"):
        assert words in page
    assert repr(short) == f"<Recording: short, {short.duration:.2f} s, {len(short)} samples>"


def test_blind_without_a_file_makes_a_key(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = write(tmp_path / "plan.yaml", SHORT_PLAN)
    first = gyrowheel.good("simulate", "--plan", plan, "-o", "one", "--blind")
    assert "--blind: the key goes into key.json" in first.err
    second = gyrowheel.good("simulate", "--blind", "--plan", plan, "-o", "two")
    assert "--blind: the key goes into key-2.json" in second.err
    gyrowheel.good("simulate", "--plan", plan, "-o", "three", "--blind", "mine.json")
    assert {path.name for path in tmp_path.glob("*.json")} == {"key.json", "key-2.json", "mine.json"}
