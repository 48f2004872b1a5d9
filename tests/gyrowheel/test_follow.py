"""The diagnosis of a recording while it is written."""

from __future__ import annotations

import threading
from collections.abc import Generator
from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel.workbench import views
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.session import Session
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags.live import LiveRecording
from gyrowheel_recording.bags.playback import Tape

from ..shared import made_once
from .conftest import Wheel
from .helpers import Shell


@pytest.fixture(scope="module")
def whole(wheel: Wheel, tmp_path_factory: pytest.TempPathFactory) -> gw.Diagnosis:
    """Return the diagnosis of the whole recording, as it is without being followed."""
    return made_once(
        tmp_path_factory, "whole", lambda _: gw.diagnose(wheel.recording, gw.Model.load(wheel.model))
    )


@pytest.fixture
def growing(wheel: Wheel, tmp_path: Path) -> tuple[Path, Generator[None]]:
    """Return a recording in progress, and an iterator that writes its first 12 s, and then the rest."""
    place = tmp_path / "monday"

    def writing() -> Generator[None]:
        live, half = LiveRecording(str(place)), False
        with Tape(wheel.recording) as tape:
            for due, topic, data, *_ in tape.messages():
                live.take(topic, data)
                if not half and tape.seconds(due) > 12.0:
                    half = True
                    yield
        live.close()
        yield

    return place, writing()


@pytest.mark.slow
def test_a_recording_is_diagnosed_while_it_is_written_and_at_its_end(
    growing: tuple[Path, Generator[None]], wheel: Wheel, whole: gw.Diagnosis
) -> None:
    place, write = growing
    model = gw.Model.load(wheel.model)
    next(write)
    looks = gw.follow(place, model)
    first = next(looks)
    assert (first.number, first.complete, first.settled) == (1, False, False)
    assert first.recording.duration == pytest.approx(12.0, abs=0.5)
    assert first.recording.path == place
    next(write)
    last = next(looks)
    assert (last.number, last.complete) == (2, True)
    assert last.diagnosis.windows > first.diagnosis.windows
    assert last.diagnosis.effects == whole.effects
    # both name windage, and it gains much
    assert last.settled
    assert next(looks, None) is None


@pytest.mark.slow
def test_the_workbench_renews_its_verdict_while_a_recording_is_written(
    growing: tuple[Path, Generator[None]], wheel: Wheel, whole: gw.Diagnosis
) -> None:
    place, write = growing
    next(write)
    session = Session(Library([place.parent]), gw.Model.load(wheel.model))
    assert "Diagnose as it is written" in views.state(session)["parts"]["recordings"]
    session.follow("0/monday")
    changed = threading.Event()
    session.watch(changed.set)
    while session.step.diagnosis is None:
        assert changed.wait(240.0)
        changed.clear()
        assert session.trouble is None
    first = session.step.diagnosis
    assert session.opened["0/monday"].recording.duration == pytest.approx(12.0, abs=0.5)
    next(write)
    session.wait(240.0)
    assert session.trouble is None
    assert session.step.diagnosis.windows > first.windows
    assert session.step.diagnosis.effects == whole.effects
    assert session.step.holds
    assert "Diagnose as it is written" not in views.state(session)["parts"]["recordings"]
    with pytest.raises(InputError, match="diagnosed alone"):
        session.follow(session.library.take(wheel.other))


def test_the_verb_shows_each_look_and_the_page_of_the_last(
    gyrowheel: Shell, wheel: Wheel, whole: gw.Diagnosis
) -> None:
    shown = gyrowheel.good("diagnose", "--follow", wheel.recording, "--model", wheel.model)
    (line,) = (own for own in shown.err.splitlines() if " windows " in own)
    assert " windows  whole " in line
    assert "windage" in line
    assert whole.sentence in " ".join(shown.out.split())
    assert "Next" in shown.out  # as on the page of a diagnosis


def test_a_recording_that_broke_off_or_is_missing_is_refused(
    growing: tuple[Path, Generator[None]], wheel: Wheel
) -> None:
    place, write = growing
    next(write)
    write.close()  # as a process that is killed: the recording has no end
    with pytest.raises(InputError, match="the recording was not completed; gyrowheel salvage"):
        next(gw.follow(place, gw.Model.load(wheel.model)))
    with pytest.raises(InputError, match="no such"):
        next(gw.follow(place.parent / "tuesday", gw.Model.load(wheel.model)))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--until", "settled"], "--until: needs --follow"),
        (["--follow", "--until", "noon"], "--until: 'noon' is not allowed; allowed: settled"),
        (["--follow", "--mixed"], "--follow: allowed: one recording"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    options: list[str], words: str, gyrowheel: Shell, wheel: Wheel
) -> None:
    refused = gyrowheel("diagnose", wheel.recording, "--model", wheel.model, *options)
    assert refused.code == 2
    assert words in refused.err
