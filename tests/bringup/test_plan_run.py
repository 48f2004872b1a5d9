"""How a client of the conductor waits for a plan: an answer that is lost is asked for again, a plan can be ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS is not installed")

from gyrowheel_bringup.graph import GraphError, Progress, plan_client
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.node import endpoints

DONE = SimpleNamespace(result=SimpleNamespace(success=True, message="plan check completed"))
CANCELLED = SimpleNamespace(result=SimpleNamespace(success=False, message="cancelled"))


class Answer:
    """What comes of a request, once it has come."""

    def __init__(self, value: Any = None) -> None:
        self.value = value

    def done(self) -> bool:
        return self.value is not None

    def result(self) -> Any:
        return self.value


@dataclass
class Conductor:
    """Takes one plan; answers as a test wants."""

    accepted: bool = True
    unanswered: int = 0  # requests for the plan that it does not answer
    runs_unanswered: bool = False  # although it runs the plan
    requests: int = 0
    lost: int = 0  # answers about the end that never come
    feedback: int = 0  # signs of progress that come at first
    asked: list[Answer] = field(default_factory=list)
    cancelled: bool = False
    tell: Callable[[Any], None] | None = None

    def send_goal_async(self, goal: Any, feedback_callback: Callable[[Any], None], goal_uuid: Any) -> Answer:
        self.requests += 1
        if self.requests <= self.unanswered:
            if self.runs_unanswered:
                self.tell, self.accepted = feedback_callback, False
            return Answer()
        self.tell = self.tell or feedback_callback
        return Answer(self)

    def _get_result_async(self, goal: Any) -> Answer:
        """Answer the handle of a goal."""
        return self.get_result_async()

    def get_result_async(self) -> Answer:
        self.asked.append(Answer())
        return self.asked[-1]

    def cancel_goal_async(self) -> Answer:
        self.cancelled = True
        return Answer(self)

    def spin(self) -> None:
        """Serve the client for a moment."""
        if self.feedback:
            self.feedback -= 1
            assert self.tell is not None
            self.tell(
                SimpleNamespace(
                    feedback=SimpleNamespace(segment=0, segments=1, label="level", elapsed=0.0, duration=9.0)
                )
            )
        elif self.cancelled:
            self.asked[-1].value = CANCELLED
        elif len(self.asked) > self.lost:
            self.asked[-1].value = DONE

    def run(self, patience: float = 60.0, **options: Any) -> Any:
        return plan_client.run_plan(
            self,
            Plan.load("check"),
            spin=self.spin,
            stalled=lambda what: GraphError("stalled", what),
            patience=patience,
            **options,
        )


def test_an_answer_that_is_lost_is_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endpoints, "ASK_AGAIN", 0.0)
    conductor = Conductor(lost=2)
    assert conductor.run().success
    assert [answer.done() for answer in conductor.asked[:2]] == [False, False]


def test_a_plan_whose_acceptance_is_lost_is_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endpoints, "ASK_AGAIN", 0.0)
    conductor = Conductor(unanswered=2)
    assert conductor.run().success
    assert conductor.requests == 3


def with_late_feedback(conductor: Conductor) -> Callable[[], None]:
    """Serve the client; the first feedback comes after the plan was refused."""
    turns = iter(range(1000))

    def spin() -> None:
        if next(turns) == 5:
            conductor.feedback = 1
        if conductor.feedback or conductor.asked:
            Conductor.spin(conductor)

    return spin


def test_feedback_shows_that_a_plan_runs_although_its_acceptance_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At a repeated request the conductor refuses the plan, since it runs it."""
    monkeypatch.setattr(endpoints, "ASK_AGAIN", 0.0)
    conductor = Conductor(unanswered=1, runs_unanswered=True)
    monkeypatch.setattr(conductor, "spin", with_late_feedback(conductor))
    assert conductor.run().success
    assert conductor.requests > 1


def test_what_progress_raises_ends_the_plan_and_comes_back() -> None:
    conductor = Conductor(lost=99, feedback=2)

    def fail(progress: Progress) -> None:
        raise ZeroDivisionError(progress.label)

    with pytest.raises(ZeroDivisionError, match="level"):
        conductor.run(progress=fail)
    assert conductor.cancelled


def test_a_plan_is_ended_on_request() -> None:
    conductor, asked = Conductor(lost=99), iter([False, False, True])
    assert conductor.run(ended=lambda: next(asked, True)) is None
    assert conductor.cancelled


def test_no_progress_is_an_error() -> None:
    with pytest.raises(GraphError, match="plan check makes no progress for 0 s") as caught:
        Conductor(lost=99).run(patience=0.0)
    assert caught.value.fault == "stalled"


def test_a_plan_may_be_refused() -> None:
    with pytest.raises(GraphError, match="refused") as caught:
        Conductor(accepted=False).run()
    assert caught.value.fault == "plan_refused"


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        (
            "aborted: clock_stands: the time of the bench has stood at 0.200 s for 20 s: it is gone",
            "clock_stands",
        ),
        ("aborted: plant: tilt_stop: tilt 5.02 deg, hard stop at 5.00 deg; coils off", "tilt_stop"),
        ("aborted: controller: tracking_lost: the wheel does not follow: asked 0.00 deg", "tracking_lost"),
        ("aborted: plant: running", "plan_aborted"),
        ("aborted: the conductor was stopped", "plan_aborted"),
        ("plan wide needs a tilt limit of 4.00 deg: there is no node", "plan_aborted"),
        ("", "plan_aborted"),
    ],
)
def test_the_fault_of_a_plan_is_that_of_what_ended_it(message: str, fault: str) -> None:
    assert plan_client.fault_of(message) == fault
