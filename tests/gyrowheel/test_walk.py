"""From the path of a recording to the printed verdict: every call leads down the house, and each folder in its turn."""

from __future__ import annotations

import importlib
import inspect
import sys
from pathlib import Path
from types import FrameType

import pytest

import gyrowheel as gw
from tools.house import HOUSE

#: Where the data goes through, in order; the result then stands in the text.
WAY = (
    "gyrowheel_recording.bags",
    "gyrowheel_analysis.reduction",
    "gyrowheel_analysis.balance",
    "gyrowheel_analysis.residuals",
    "gyrowheel.show",
)


def folder_of(frame: FrameType | None) -> str:
    """Return package and folder of the code of a frame; empty for code that is not ours."""
    name = "" if frame is None else str(frame.f_globals.get("__name__", ""))
    return ".".join(name.split(".")[:2]) if name.startswith("gyrowheel") else ""


class Walk:
    """Notes which folder calls which, and the order in which they are entered first."""

    def __init__(self) -> None:
        self.calls: dict[tuple[str, str], str] = {}
        self.entered: list[str] = []

    def __enter__(self) -> Walk:
        sys.setprofile(self._note)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)

    def _note(self, frame: FrameType, event: str, _: object) -> None:
        if event != "call" or frame.f_code.co_name == "<module>":
            return
        here, caller = folder_of(frame), folder_of(frame.f_back)
        if here and here != caller:
            if here not in self.entered:
                self.entered.append(here)
            # the base of results calls methods of the result that it is, and a page is advanced by what prints it
            base = frame.f_back is not None and frame.f_back.f_globals["__name__"] == "gyrowheel.show.result"
            if caller and not base and not frame.f_code.co_flags & inspect.CO_GENERATOR:
                self.calls.setdefault((caller, here), frame.f_code.co_qualname)


def height(folder: str) -> tuple[int, int]:
    """Return number of the package and of the floor."""
    name, _, part = folder.partition(".")
    number = next(k for k, package in enumerate(HOUSE) if package.name == name)
    return number, HOUSE[number].floor_of(part)


@pytest.mark.slow
@pytest.mark.study
def test_a_diagnosis_calls_the_folders_of_the_house_from_top_to_bottom(tmp_path: Path) -> None:
    gw.simulate("quick", effects={"windage": {}}, machine=6).save(tmp_path / "run")
    model = gw.Model("gyrowheel")
    recorded = tmp_path / "run"
    for module in (
        "gyrowheel_analysis.diagnosis.diagnose",
        "gyrowheel.diagnosis.api",
        "gyrowheel.diagnosis.page",
    ):
        importlib.import_module(module)  # what runs on import is no part of the walk
    with Walk() as walk:
        shown = str(gw.diagnose(recorded, model))
    assert "windage" in shown
    up = [
        f"{caller} calls {name} of {here}"
        for (caller, here), name in walk.calls.items()
        if height(here) >= height(caller)
    ]
    assert up == []
    assert [folder for folder in walk.entered if folder in WAY] == list(WAY)
