"""What looks like events and is none: laws of the motion, offsets, and one change that is found twice."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gyrowheel.show.sentences.findings import law_sentence
from gyrowheel_analysis.diagnosis.dated_changes import MissingLaw
from gyrowheel_analysis.diagnosis.event_dating import Found, _determined
from gyrowheel_analysis.diagnosis.event_scan import Candidate
from gyrowheel_analysis.diagnosis.event_search import _merged
from gyrowheel_analysis.diagnosis.motion_laws import courses, on_commands
from gyrowheel_analysis.fitting.events import Event, Kind
from gyrowheel_core.units import DEG, RPM


def plan_of_windows() -> Any:
    """Return the motion of windows of two seconds: three speeds, and at each of them four tilts."""
    start = 2.2 * np.arange(12.0)
    return WindowsOfPlan(
        start=start,
        duration=np.full(12, 2.0),
        middle=start + 1.0,
        mean_spin=np.repeat([3000.0, 1500.0, 4000.0], 4) * RPM,
        mean_tilt=np.tile([0.0, 3.0, -3.0, 2.0j], 3) * DEG,
        # a cone in the last but one window; held tilts have noise alone
        mean_tilt_rate=np.r_[np.full(10, 0.1), 40.0j, 0.1] * DEG,
        coil_temperature=np.linspace(293.0, 303.0, 12),
        motor_temperatures=np.full((12, 2), 293.0),
    )


class WindowsOfPlan(SimpleNamespace):
    def __len__(self) -> int:
        return len(self.start)


def test_courses_follow_the_motion_and_are_at_most_one() -> None:
    found = list(courses(plan_of_windows()))
    assert {variable for variable, _ in found} == {
        "offset", "speed", "tilt", "direction", "rate", "temperature", "time", "history"
    }  # fmt: skip
    assert all(np.abs(course).max() == pytest.approx(1.0) for _, course in found)
    # a narrow resonance at the second speed is there, whatever its width
    there = np.repeat([0.0, 1.0, 0.0], 4)
    assert any(variable == "speed" and np.allclose(course, there, atol=1e-3) for variable, course in found)
    # what acts in a cone alone is no burst
    cone = np.r_[np.zeros(10), 1.0, 0.0]
    assert any(variable == "rate" and np.allclose(course, cone) for variable, course in found)
    # and the direction of the last change of the speed
    past = np.repeat([0.0, -1.0, 1.0], 4)
    assert any(variable == "history" and np.allclose(course, past) for variable, course in found)


@pytest.mark.parametrize(
    ("edges", "commanded"), [((8.7,), True), ((9.9,), True), ((13.0,), False), ((8.7, 13.0), False)]
)
def test_event_lies_on_commands_if_all_its_edges_do(edges: tuple[float, ...], commanded: bool) -> None:
    kind: Kind = "step" if len(edges) == 1 else "burst"
    assert on_commands(plan_of_windows(), Event(0, "torque_x", kind, *edges)) == commanded


def found_at(time: float, *quantities: str, gain: float = 50.0) -> Found:
    return Found(tuple(Event(0, name, "step", time) for name in quantities), (0.1,), gain)


def test_two_channels_of_one_instant_are_one_event() -> None:
    both, alone = found_at(60.0, "torque_x", "torque_y", gain=90.0), found_at(60.4, "torque_x")
    (merged,) = _merged([alone, both])
    assert merged.events == both.events
    (merged,) = _merged([found_at(60.0, "torque_y"), found_at(60.4, "torque_x", gain=90.0)])
    assert [event.quantity for event in merged.events] == ["torque_x", "torque_y"]
    assert merged.event.time == 60.4
    apart = [both, found_at(70.0, "torque_x"), found_at(60.0, "spin_torque")]
    assert len(_merged(apart)) == 3


@pytest.mark.parametrize(
    ("quantity", "edges", "kept"),
    [
        ("tilt_reading_y", (8.6, 11.1), True),  # the window from 8.8 to 10.8 is whole
        ("tilt_reading_y", (9.0, 10.9), False),  # it begins within that window, which then has no weight
        ("torque_y", (9.0, 10.9), True),
    ],
)
def test_burst_of_a_tilt_reading_has_a_whole_window(
    quantity: str, edges: tuple[float, float], kept: bool
) -> None:
    candidate = Candidate((Event(0, quantity, "burst", 8.7, 10.9),), 60.0, 40.0, ((6.5, 8.7), (10.9, 13.1)))
    dated = Found((Event(0, quantity, "burst", *edges),), (0.1, 0.1), 55.0)
    found = _determined(dated, candidate, plan_of_windows())
    assert found.event.edges == (edges if kept else (8.7, 10.9))


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (
            MissingLaw("monday", "speed", ("torque_along_tilt",), 40.0),
            "There is a torque along the tilt, in proportion to it, that depends on the speed: it begins and ends "
            "with the commands, no event.",
        ),
        (
            MissingLaw("monday", "temperature", ("torque_along_tilt",), 40.0),
            "There is a torque along the tilt, in proportion to it, that depends on the temperature of coils, motor or "
            "air: a law, not an event or a drift.",
        ),
        (
            MissingLaw("monday", "offset", ("torque_x", "torque_y"), 40.0),
            "From the start there are a torque about case x and a torque about case y: an offset, no event.",
        ),
    ],
)
def test_law_that_looks_like_events_is_stated_with_its_variable(law: MissingLaw, said: str) -> None:
    assert law_sentence(law) == said
