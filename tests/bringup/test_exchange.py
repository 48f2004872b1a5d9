"""One controller in the place of another while the bench runs, and every node through its lifecycle during a plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

from gyrowheel_bringup.graph import Graph, GraphError, Progress
from gyrowheel_bringup.graph.nodes import REALTIME_PRIORITY
from gyrowheel_core import topics
from gyrowheel_recording.bags import Recording, info

from .helpers import SHORT_PLAN, Bystander, NodeProcess

pytestmark = pytest.mark.graph

#: Transitions of a node during a plan.
BACK = ("deactivate", "activate")
ANEW = ("deactivate", "cleanup", "configure", "activate")


class Lifecycles:
    """Changes the states of nodes by their services, as `ros2 lifecycle set` does."""

    def __init__(self, bystander: Bystander, *names: str) -> None:
        self._bystander = bystander
        self._clients = {
            name: bystander.node.create_client(ChangeState, f"/{name}/change_state") for name in names
        }

    def change(self, name: str, label: str) -> bool:
        request = ChangeState.Request(transition=Transition(label=label))
        return bool(self._bystander.call(self._clients[name], request).success)


@pytest.mark.study  # test_transitions.py and test_nodes.py change the states of single nodes
@pytest.mark.parametrize("realtime", [False, True])
def test_a_controller_takes_the_place_of_another_during_a_plan(
    realtime: bool,
    domain: int,
    bystander: Bystander,
    start_node: Callable[..., NodeProcess],
    tmp_path: Path,
) -> None:
    lifecycles = Lifecycles(bystander, "controller", "stiff")
    priority = {"priority": REALTIME_PRIORITY if realtime else 0}  # as those of the graph have
    start_node("controller", **priority)
    start_node("controller", renamed="stiff", autostart=False, tilt_bandwidth=14.0, **priority)
    exchanged = False

    def progress(now: Progress) -> None:
        nonlocal exchanged
        if now.segment == 1 and not exchanged:
            exchanged = True
            assert lifecycles.change("controller", "deactivate")
            if realtime:  # longer than the watchdog
                # a diagnosis that tells of a stall comes in between, if there was one
                bystander.spin_until(
                    lambda: bystander.said("plant").startswith("released: the controller has left")
                )
                assert bystander.values("plant")["guard"] == "released"
            assert lifecycles.change("stiff", "activate")
            bystander.spin_until(lambda: int(bystander.values("stiff").get("commands", 0)) > 0)

    # a guard that is slow to act: the computer of a test may be
    patient = {"plant": {"watchdog": 20.0, "oldest_command": 5.0, "exchange_time": 120.0}}
    with Graph(
        SHORT_PLAN,
        record=tmp_path / "run",
        domain_id=domain,
        without=["controller"],
        realtime=realtime,
        parameters=patient,
    ) as graph:
        lifecycles.change("stiff", "configure")
        result = graph.run(progress=progress)
    assert exchanged
    assert result.segments == 4
    found = info(tmp_path / "run")
    assert found.integrity.missing == 0
    by_node = {p.node for p in found.publishers if p.topic == topics.COMMAND.name}
    assert by_node == {"/controller", "/stiff"}
    # the wheel is where the plan has it
    recording = Recording.open(tmp_path / "run")
    assert abs(recording.measurement[-1]["spin_rate"] - recording.setpoint[-1]["spin_rate"]) < 5.0


@pytest.mark.study  # with test_transitions.py; below are those that end a bench
def test_every_transition_of_a_node_during_a_plan_ends_as_told(
    domain: int, bystander: Bystander, tmp_path: Path
) -> None:
    """Nodes that nobody waits for come and go during a plan; the plant and the conductor end it by their own names."""
    # in lock-step the time stands while a node is away, and these are how long it may
    patient = {"plant": {"command_timeout": 100.0, "exchange_time": 200.0}}
    names = ("plant", "controller", "conductor", "recorder", "drag_estimator")
    lifecycles = Lifecycles(bystander, *names)
    seen: list[tuple[str, str]] = []

    def go(node: str, labels: Sequence[str]) -> Callable[[Progress], None]:
        done: list[str] = []

        def progress(now: Progress) -> None:
            if now.segment == 1 and not done:
                for label in labels:
                    done.append(label)
                    assert lifecycles.change(node, label)

        return progress

    def ends(node: str = "", labels: Sequence[str] = BACK) -> str:
        """Return how a plan ends in which a node goes through transitions; without a node, how a plan ends."""
        try:
            return f"{graph.run(progress=go(node, labels) if node else None).segments} segments"
        except GraphError as error:
            return error.fault

    with Graph(
        SHORT_PLAN,
        record=tmp_path / "run",
        domain_id=domain,
        hold_after_plan=True,
        parameters=patient,
        on_trouble=lambda *said: seen.append(said),
    ) as graph:
        # the time stands while plant or controller do, and the plan goes on with it
        assert ends("controller") == "4 segments"
        assert ends("plant") == "4 segments"
        assert ends("conductor") == "plan_aborted"
        # and the next plan runs at once; a node that is configured anew knows nothing: it is told the time, the sample
        # and the setpoints
        assert ends("controller", ANEW) == "4 segments"
        assert ends("drag_estimator", ANEW) == "4 segments"
        assert ends("conductor", ANEW) == "plan_aborted"
        assert ends() == "4 segments"
        # the recording ends with the recorder, and is complete; it then waits for its service
        assert ends("recorder") == "4 segments"
        bystander.spin_until(lambda: bystander.said("recorder").startswith(str(tmp_path / "run")))
        # without what was asked for no plan runs
        assert ends() == "not_recorded"
    assert not [text for _, text in seen if "controller_lost" in text or "tilt_stop" in text]
    assert info(tmp_path / "run").integrity.missing == 0


@pytest.mark.study
def test_a_bench_without_a_conductor_ends_by_the_name_of_what_is_missing(
    domain: int, bystander: Bystander
) -> None:
    lifecycles = Lifecycles(bystander, "conductor")
    # the controller tells once a second what it waits for
    patient = {"plant": {"command_timeout": 4.0, "exchange_time": 4.0}}
    options: dict[str, Any] = {"without": ["recorder", "drag_estimator"], "hold_after_plan": True}

    def run() -> None:
        with Graph(SHORT_PLAN, domain_id=domain, parameters=patient, **options) as graph:
            graph.run()
            assert lifecycles.change("conductor", "deactivate")
            graph.wait()

    with pytest.raises(GraphError) as ended:
        run()
    assert (ended.value.fault, ended.value.node) == ("setpoint_lost", "plant")
    assert "the controller has no setpoint; the conductor is gone or inactive" in str(ended.value)


@pytest.mark.study
def test_a_plant_that_is_configured_anew_ends_plan_and_recording(
    domain: int, bystander: Bystander, tmp_path: Path
) -> None:
    lifecycles = Lifecycles(bystander, "plant")
    done: list[str] = []

    def progress(now: Progress) -> None:
        if now.segment == 1 and not done:
            for label in ANEW:
                done.append(label)
                assert lifecycles.change("plant", label)

    seen: list[tuple[str, str]] = []
    with Graph(
        SHORT_PLAN,
        record=tmp_path / "run",
        domain_id=domain,
        hold_after_plan=True,
        on_trouble=lambda *said: seen.append(said),
    ) as graph:
        with pytest.raises(GraphError) as ended:
            graph.run(progress=progress)
        assert ended.value.fault == "clock_jump"
        # whoever asked for a recording is not left without one unawares
        with pytest.raises(GraphError) as refused:
            graph.run()
        assert refused.value.fault == "not_recorded"
        assert "the plant was started again" in str(refused.value)
        # the last answer of a node that is shut down arrives
        assert lifecycles.change("plant", "deactivate")
        assert lifecycles.change("plant", "shutdown")
    assert any(name == "recorder" and "the plant was started again" in text for name, text in seen)
    assert info(tmp_path / "run").integrity.missing == 0
