"""The table of docs/graph.md: every node through every transition while a plan runs, in both clocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrowheel_bringup.graph import Graph, GraphError, Progress
from gyrowheel_recording.bags import Recording, info
from gyrowheel_sim.bench import Bench

from .helpers import SHORT_PLAN, Bystander
from .test_exchange import ANEW, BACK, Lifecycles

SHUTDOWN = ("shutdown",)
WHOLE = "4 segments"
DIED = {"node_died"}
#: How a plan ends during which a node goes through transitions, in lock-step and in real time, and how the next one
#: does. In real time a plant that is away for a second ends the plan; how long it takes is the computer's affair.
TABLE: dict[tuple[str, Sequence[str]], tuple[set[str], set[str], str]] = {
    ("plant", BACK): ({WHOLE}, {WHOLE, "plant_stopped"}, WHOLE),
    ("plant", ANEW): ({"clock_jump"}, {WHOLE, "plant_stopped", "clock_jump"}, "not_recorded"),
    ("plant", SHUTDOWN): (DIED, DIED, ""),
    ("controller", BACK): ({WHOLE}, {WHOLE}, WHOLE),
    ("controller", ANEW): ({WHOLE}, {WHOLE}, WHOLE),
    ("controller", SHUTDOWN): (DIED, DIED, ""),
    ("conductor", BACK): ({"plan_aborted"}, {"plan_aborted"}, WHOLE),
    ("conductor", ANEW): ({"plan_aborted"}, {"plan_aborted"}, WHOLE),
    ("conductor", SHUTDOWN): (DIED, DIED, ""),
    ("recorder", BACK): ({WHOLE}, {WHOLE}, "not_recorded"),
    ("recorder", ANEW): ({WHOLE}, {WHOLE}, "not_active"),
    ("recorder", SHUTDOWN): (DIED, DIED, ""),
    ("drag_estimator", BACK): ({WHOLE}, {WHOLE}, WHOLE),
    ("drag_estimator", ANEW): ({WHOLE}, {WHOLE}, WHOLE),
    ("drag_estimator", SHUTDOWN): (DIED, DIED, ""),
}


def test_the_page_has_a_row_a_node_and_a_column_a_transition() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "graph.md").read_text(encoding="utf-8")
    head = "| | deactivate, activate | deactivate, cleanup, configure, activate | shutdown |\n"
    rows = page.partition(head)[2].partition("\n\n")[0].splitlines()[1:]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [row[0].replace(" ", "_") for row in cells] == [node for node, labels in TABLE if labels == BACK]
    for name, *said in cells:
        node = name.replace(" ", "_")
        for labels, text in zip((BACK, ANEW, SHUTDOWN), said, strict=True):
            first, _, following = TABLE[node, labels]
            # what it says by name is what the test below sees
            assert all(fault in text for fault in first - {WHOLE} if text != "the same")
            assert following in ("", WHOLE) or following in text


@pytest.mark.study
@pytest.mark.slow
@pytest.mark.graph
@pytest.mark.parametrize("realtime", [False, True], ids=["lockstep", "realtime"])
@pytest.mark.parametrize(
    ("node", "labels"), TABLE, ids=lambda part: part if isinstance(part, str) else "-".join(part)
)
def test_a_transition_during_a_plan_ends_as_told(
    node: str, labels: Sequence[str], realtime: bool, domain: int, bystander: Bystander, tmp_path: Path
) -> None:
    """Nothing is called ``controller_lost`` for something else's sake, no limit is exceeded, the recording is whole."""
    in_lockstep, in_real_time, following = TABLE[node, labels]
    # a guard that is slow to act: the computer may be; whoever is shut down does not come back
    patient: dict[str, Any] = {"watchdog": 20.0, "oldest_command": 5.0, "command_timeout": 100.0}
    patient["exchange_time"] = 2.0 if labels == SHUTDOWN else 200.0
    lifecycles = Lifecycles(bystander, node)
    troubles: list[tuple[str, str]] = []
    done: list[str] = []
    fault, why = "", ""

    def progress(now: Progress) -> None:
        if now.segment == 1 and not done:
            for label in labels:
                done.append(label)
                # a recorder that is configured anew finds its folder full
                assert lifecycles.change(node, label) or (node, label) == ("recorder", "activate")

    def end(progress: Callable[[Progress], None] | None = None) -> str:
        try:
            return f"{graph.run(progress=progress).segments} segments"
        except GraphError as error:
            return error.fault

    try:
        with Graph(
            SHORT_PLAN,
            record=tmp_path / "run",
            domain_id=domain,
            hold_after_plan=True,
            realtime=realtime,
            parameters={"plant": patient},
            on_trouble=lambda *said: troubles.append(said),
        ) as graph:
            assert end(progress) in (in_real_time if realtime else in_lockstep)
            assert not following or end() == following
    except GraphError as error:  # the end of a node that was shut down is told at the end, too
        fault, why = error.fault, str(error)
    assert fault in (("", "node_died") if labels == SHUTDOWN else ("",)), why
    assert done == list(labels)
    names = ("tilt_stop",) if (node, labels) == ("controller", SHUTDOWN) else ("controller_lost", "tilt_stop")
    assert not [text for _, text in troubles if any(name in text for name in names)]

    assert info(tmp_path / "run").integrity.missing == 0
    measurement, v = Recording.open(tmp_path / "run").measurement, Bench.load().value
    assert np.hypot(measurement["tilt_x"], measurement["tilt_y"]).max() < v("tilt_limit")
    for name, limit in (
        ("coil_voltage_x", "coil_voltage_limit"),
        ("coil_voltage_y", "coil_voltage_limit"),
        ("motor_voltage", "supply_voltage"),
    ):
        assert np.abs(measurement[name]).max() < 1.02 * v(limit)
