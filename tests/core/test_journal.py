"""What long work has finished, whole or not at all, and what may go on in its folder."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import pytest

from gyrowheel_core.errors import InputError
from gyrowheel_core.journal import FINISHED, SETTINGS, Work, begun, journal

WORK = Work(
    kind="campaign", settings={"seed": 3, "plan": "a\nb"}, contents={"model": "1"}, versions={"numpy": "2.0"}
)


def test_finished_parts_are_read_back(tmp_path: Path):
    content = {"number": 1.0 / 3.0, "texts": ["a", "nan"], "not finite": [math.nan, math.inf, -math.inf]}
    with journal(tmp_path / "a" / "b", WORK) as kept:
        assert kept.finished() == {}
        kept.finish("one", content)
        kept.finish("two", None)
    with journal(tmp_path / "a" / "b", WORK, resume=True) as kept:
        back = kept.finished()
    assert back == {"one": {**content, "not finite": ["nan", "inf", "-inf"]}, "two": None}
    assert [float(text) for text in back["one"]["not finite"][1:]] == [math.inf, -math.inf]
    for path in tmp_path.rglob("*.json"):
        json.loads(path.read_text(), parse_constant=pytest.fail)
    assert begun(tmp_path / "a" / "b", "campaign") == WORK


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"settings": {"seed": 4, "plan": "a\nb"}},
            "seed: 4 is not that of the campaign in {}, 3; leave it out",
        ),
        ({"settings": {"plan": "a\nb"}}, "seed: none is not that of the campaign in {}, 3"),
        ({"settings": {"seed": 3, "plan": "a\nc"}}, "plan: is another one than that of the campaign in {};"),
        ({"settings": {**WORK.settings, "new": [1]}}, "new: [1] is not that of the campaign in {}, none"),
        ({"contents": {"model": "2"}}, "model: has changed since the campaign in {} was begun"),
        ({"versions": {"numpy": "2.1"}}, "numpy: the campaign in {} was begun with 2.0, and this is 2.1"),
        ({"kind": "sweep"}, "{}: holds a campaign, not a sweep"),
        ({"kind": "investigation"}, "{}: holds a campaign, not an investigation"),
    ],
)
def test_a_folder_of_other_work_is_refused_unchanged(tmp_path: Path, change: dict[str, object], words: str):
    with journal(tmp_path, WORK) as kept:
        kept.finish("one", 1)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.json")}
    with pytest.raises(InputError) as refused, journal(tmp_path, WORK.model_copy(update=change), resume=True):
        pass
    assert str(refused.value).startswith(words.format(tmp_path))
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.json")} == before


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": 1}', '{"schema": 2, "kind": "campaign"}'])
def test_damaged_settings_are_named(tmp_path: Path, text: str):
    (tmp_path / SETTINGS).write_text(text)
    with pytest.raises(InputError, match=SETTINGS), journal(tmp_path, WORK, resume=True):
        pass


def test_edited_settings_are_refused(tmp_path: Path):
    with journal(tmp_path, WORK) as kept:
        kept.finish("one", 1)
    settings = tmp_path / SETTINGS
    settings.write_text(settings.read_text().replace('"seed": 3', '"seed": "3"'))
    with pytest.raises(
        InputError, match=r"settings\.json: was edited or damaged since the campaign was begun"
    ):
        begun(tmp_path, "campaign")


def test_a_pipe_or_an_oversized_text_is_no_finished_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("gyrowheel_core.files.LONGEST_TEXT", 1000)
    with journal(tmp_path, WORK) as kept:
        kept.finish("one", 1)
        os.mkfifo(tmp_path / FINISHED / "two.json")
        (tmp_path / FINISHED / "three.json").symlink_to("/dev/zero")
        assert kept.finished() == {"one": 1}


@pytest.mark.parametrize("text", ["", "[]", "null", "[" * 100_000, '{"of": 1, "content": 2}', "\udcff"])
def test_a_damaged_part_is_not_finished(tmp_path: Path, text: str):
    with journal(tmp_path, WORK) as kept:
        kept.finish("one", 1)
        (tmp_path / FINISHED / "two.json").write_bytes(text.encode("utf-8", "surrogateescape"))
        assert kept.finished() == {"one": 1}


def test_work_refused_before_its_start_leaves_no_files(tmp_path: Path):
    with pytest.raises(InputError, match="no"), journal(tmp_path / "a" / "b", WORK):
        raise InputError("no")
    assert not any(tmp_path.iterdir())


def test_finished_and_interrupted_work_is_kept(tmp_path: Path):
    def work(folder: Path, error: BaseException) -> None:
        with journal(folder, WORK) as kept:
            if isinstance(error, InputError):
                kept.finish("one", 1)
            raise error

    for name, error, finished in (("a", InputError("full"), {"one": 1}), ("b", KeyboardInterrupt(), {})):
        with pytest.raises(type(error)):
            work(tmp_path / name, error)
        with journal(tmp_path / name, WORK, resume=True) as kept:
            assert kept.finished() == finished


def test_a_kill_before_the_beginning_leaves_a_folder_that_can_be_used(tmp_path: Path):
    (tmp_path / ".lock").touch()
    (tmp_path / f".{SETTINGS}.012345").write_text("{")
    with journal(tmp_path, WORK) as kept:
        kept.finish("one", 1)
    assert begun(tmp_path, "campaign") == WORK


def test_a_folder_in_use_is_refused(tmp_path: Path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(InputError, match="a campaign needs a new directory"), journal(tmp_path, WORK):
        pass
    refused = pytest.raises(InputError, match="another campaign works in this folder")
    with journal(tmp_path / "new", WORK), refused, journal(tmp_path / "new", WORK, resume=True):
        pass
    assert not (tmp_path / "new" / ".lock").exists()


def test_a_name_with_undecodable_bytes(tmp_path: Path):
    """As the shell may give one: it is kept as it is, and gone on with."""
    work = WORK.model_copy(update={"settings": {"model": os.fsdecode(b"wheel \xff.yaml")}})
    with journal(tmp_path, work) as kept:
        kept.finish("one", 1)
    assert begun(tmp_path, "campaign") == work
    with journal(tmp_path, work, resume=True) as kept:
        assert kept.finished() == {"one": 1}
