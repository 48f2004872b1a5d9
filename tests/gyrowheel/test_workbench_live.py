"""The workbench with running benches: they appear, their holds arrive, they walk the next test."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import threading
from dataclasses import astuple
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import yaml

import gyrowheel as gw
from gyrowheel.workbench.benches import LiveBenches, Running
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.server import Server
from gyrowheel.workbench.session import Session
from gyrowheel.workbench.setpoints import Setpoint
from gyrowheel.workbench.trace import BIN_NS, KEPT, ROW, SETPOINTS, Trace
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core import topics, wire
from gyrowheel_core.surroundings import prepare_environment
from gyrowheel_core.units import DEG, RPM
from gyrowheel_core.wire import SECOND
from gyrowheel_sim.bench import Bench

from ..domains import next_domain
from .conftest import Wheel
from .helpers import SHORT_PLAN, ask, sample, wait_until, write


def test_the_trace_of_a_bench_keeps_the_extremes_of_each_bin_for_a_minute() -> None:
    trace, low, high = Trace(), ROW.index("low tilt_x"), ROW.index("high tilt_x")
    assert trace.since(-1)["rows"] == []
    trace.set(7 * BIN_NS, 0.0, 0.0, 100.0 * RPM)
    trace.take([sample(7 * BIN_NS, 2.0 * DEG), sample(7 * BIN_NS + 9, 5.0 * DEG), b"of another program"])
    trace.take([sample(7 * BIN_NS + 10, -1.0 * DEG), sample(9 * BIN_NS, float("nan"))])  # bin 8 is missing
    piece = trace.since(-1)
    assert (piece["first"], piece["next"]) == (7, 9)  # bin 9 may not be complete
    assert trace.latest() is None  # its only reading is no number
    assert [(row[low], row[high], row[-1]) for row in piece["rows"]] == [(-1.0, 5.0, 100.0), (None,) * 3]
    trace.take([sample(10 * BIN_NS, 0.0)])
    assert [row[low] for row in trace.since(9)["rows"]] == [None]
    size = trace._rows.nbytes
    trace.take([sample(k * BIN_NS, float(k)) for k in range(11, 2 * KEPT)])
    assert len(trace.since(-1)["rows"]) == KEPT - 1
    assert trace._rows.nbytes == size
    # a bench that begins again, at its time zero
    trace.take([sample(0, 3.0 * DEG), sample(BIN_NS, 0.0)])
    piece = trace.since(2 * KEPT - 1)
    assert (piece["first"], [row[low] for row in piece["rows"]]) == (0, [3.0])


@pytest.mark.slow
def test_running_benches_appear_and_their_holds_arrive(wheel: Wheel) -> None:
    rclpy = pytest.importorskip("rclpy", reason="ROS is not installed")
    from rclpy.context import Context

    (holds,) = gw.drag(wheel.recording, gw.Model.load(wheel.model)).holds
    domain = next_domain()
    session = Session(Library([wheel.recording.parent]), gw.Model.load(wheel.model), wheel.model)
    session.live = LiveBenches(session.changed, domain)
    prepare_environment()  # the first node of a process settles what the middleware reads
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    bench = rclpy.create_node("bench", context=context)
    try:
        with Server(session, port=0) as server, session.live as live:
            assert json.loads(ask(server, "/state")[1])["live"] == {}
            heard = threading.Event()
            session.watch(heard.set)
            for key, namespace in (("live", ""), ("live/bench2", "/bench2")):
                estimates, setpoints = (
                    bench.create_publisher(topic.message_class, topic.within(namespace), topic.qos)
                    for topic in (topics.DRAG_ESTIMATE, topics.SETPOINT)
                )

                def until(said: Any, so: Any) -> None:
                    """Say something until it is heard: who listens may have come late."""
                    for _ in range(1200):
                        said()
                        heard.clear()
                        if so() or (heard.wait(0.2) and so()):
                            return

                setpoint = wire.SETPOINT.pack(holds[0].stamp_ns, 3, 1, 0.05, 0.0, 0.0, 0.0, 366.5, 0.0)
                until(
                    partial(setpoints.publish, setpoint),
                    lambda key=key: key in live.runs and bool(live.runs[key].asked),
                )
                first = partial(estimates.publish, holds[0].serialized())
                until(first, lambda key=key: bool(live.runs[key].holds))
                for estimate in holds[1:]:
                    estimates.publish(estimate.serialized())
                until(lambda: None, lambda key=key: len(live.runs[key].holds) == len(holds))
                state, found = (json.loads(ask(server, path)[1]) for path in ("/state", "/heard"))
                title = f"running bench {namespace}".strip()
                assert state["live"][key]["title"] == title
                words = f"{len(holds)} holds; segment 3, hold: tilt 2.9, 0.0 °, 3500 rpm"
                assert words in state["live"][key]["words"]
                assert f"<b>{title}</b>" in state["parts"]["live"]
                own = found[key]
                assert own["hold"] == [e.segment for e in holds]
                assert own["actuators"][2]["torque"]["predicted"] == pytest.approx(
                    [1e3 * e.simulated_torque[2] for e in holds]
                )
            assert list(live.runs) == ["live", "live/bench2"]
            # its signals are received while somebody watches
            samples = bench.create_publisher(
                topics.MEASUREMENT.message_class, topics.MEASUREMENT.within("/bench2"), topics.MEASUREMENT.qos
            )
            assert ask(server, "/live?key=live/bench9")[0] == 422
            with live.watching("live/bench2") as trace:
                stamps = itertools.count(0, BIN_NS)
                until(
                    lambda: samples.publish(sample(next(stamps), 0.1)),
                    lambda: len(trace.since(-1)["rows"]) > 5,
                )
                assert trace.since(-1)["rows"][0][0] == pytest.approx(0.1 / DEG, rel=1e-5)
            until(lambda: None, lambda: not samples.get_subscription_count())
            assert not samples.get_subscription_count()
    finally:
        bench.destroy_node()
        context.try_shutdown()


SETPOINT = {"bench": "live", "tilt_x": "1.5", "tilt_y": "-0.5", "spin": "2600"}


def test_a_setpoint_is_checked_confirmed_and_sent_once(wheel: Wheel) -> None:
    session = Session(Library([wheel.recording.parent]), gw.Model.load(wheel.model), wheel.model)
    session.live._runs[""] = Running(0, SECOND)  # as if it was heard, which does not need ROS
    sent: list[tuple[str, Plan, Path | None]] = []

    def walk(key: str, plan: str, folder: Path | None, *_: Any) -> bool:
        sent.append((key, Plan.load(plan), folder))
        return True

    session.live.walk = walk  # type: ignore[method-assign,assignment]
    with Server(session, port=0) as server:

        def said(**given: str) -> str:
            status, body = ask(server, "/do/setpoint", SETPOINT | given)
            answer = json.loads(body)
            assert (status == 200) == ("said" in answer)
            return str(answer.get("said") or answer["error"])

        # where it is must be known
        assert "neither a setpoint nor a sample" in said()
        session.live._runs[""] = Running(0, SECOND, asked=(3, 1, 2.0 * DEG, 0.0, 3000.0 * RPM))
        for given, sentence in (
            ({"tilt_x": "4"}, "tilt about x: 4 deg is not allowed; allowed: -3 .. 3 deg"),
            ({"tilt_y": "nan"}, "tilt about y: nan deg is not allowed; allowed: -3 .. 3 deg"),
            (
                {"tilt_x": "2.5", "tilt_y": "2.5"},
                "tilt of both axes together: 3.53553 deg is not allowed; allowed: 0 .. 3 deg",
            ),
            ({"spin": "9000"}, "spin rate: 9000 rpm is not allowed; allowed: 1000 .. 4000 rpm"),
            ({"spin": "fast"}, "spin rate: 'fast' is no number"),
            ({"bench": "live/other"}, "bench: 'live/other' does not run"),
        ):
            assert said(**given, sure="yes") == sentence
        # it says what it would do; without a confirmation, and for a page of another site, nothing is sent
        words = "The running bench moves from tilt 2, 0°, 3000 rpm to tilt 1.5, -0.5°, 2600 rpm in "
        assert said().startswith(words)
        for headers in ({"Origin": "http://bench.example"}, {"Host": "bench.example:80"}):
            assert ask(server, "/do/setpoint", SETPOINT | {"sure": "yes"}, **headers)[0] == 403
        session.wait(10.0)
        assert sent == []
        assert said(sure="yes").startswith(words)
        session.wait(10.0)
        ((key, plan, folder),) = sent
        assert (key, folder, session.trouble) == ("live", None, None)
        plan.check(Bench.load())
        # from where it is to there, evenly: the setpoints make no step
        rows = plan.setpoints()
        tilt = (rows["tilt_x"] + 1j * rows["tilt_y"]) / DEG
        assert (tilt[0], rows["spin_rate"][0] / RPM) == pytest.approx((2.0, 3000.0))
        assert (tilt[-1], rows["spin_rate"][-1] / RPM) == pytest.approx((1.5 - 0.5j, 2600.0))
        assert np.abs(np.diff(tilt)).max() < 0.011  # 2 deg/s
        # the limits are those of the description that the bench publishes; no plan begins at standstill
        narrow = Bench.load("dtg")
        session.live._take_description("", wire.pack_text(narrow.describe()))
        top = narrow.value("spin_rate_maximum") / RPM
        assert f".. {top:.5g} rpm" in said(tilt_x="0", tilt_y="0", spin="90000")
        session.live._runs[""] = Running(0, SECOND, asked=(3, 1, 0.0, 0.0, 0.0))
        assert "bench: turns at 0 rpm" in said(sure="yes")
        assert len(sent) == 1


@pytest.mark.graph
@pytest.mark.slow
def test_a_running_bench_goes_to_setpoints_and_runs_the_next_test(wheel: Wheel, tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="ROS is not installed")
    from gyrowheel.graph.api import up

    plan = write(
        tmp_path / "short.yaml",
        yaml.safe_dump(
            {
                "schema": 1,
                "name": "short",
                "hold_s": 0.5,
                "segments": [{"spin_rpm": 3500, "tilt_deg": [[0, 0], [1, 0]]}],
            }
        ),
    )
    domain = next_domain()
    shutil.copytree(wheel.recording, tmp_path / "runs" / "drag")
    session = Session(Library([tmp_path / "runs"]), gw.Model.load(wheel.model))
    session.live = LiveBenches(session.changed, domain)
    session.open("0/drag", "fitted")
    session.wait(240.0)
    diagnosed: list[int] = []
    session.tests = lambda: [str(plan)]  # type: ignore[method-assign]
    session._diagnose = lambda at: diagnosed.append(len(session.used("fitted")))  # type: ignore[method-assign]
    with pytest.raises(gw.InputError, match="'live/bench9' does not run"):
        session.test(str(plan), "live/bench9")
    with pytest.raises(gw.InputError, match="'live/bench9' does not run"):
        session.walk("quick", "live/bench9")
    with pytest.raises(gw.InputError, match="is not known"):  # a shipped plan, and no file
        session.walk(str(plan), "live/bench9")
    key = "live/bench2"
    with up(None, domain=domain, namespace="bench2") as graph, session.live as live:
        wait_until(session, lambda: key in live.runs and live.runs[key].allowed is not None)
        with live.watching(key) as trace:
            # no setpoint yet, so that its time stands: from its first sample
            wait_until(session, lambda: trace.latest() is not None)

            def published(tilt: float, spin: float) -> bool:
                return astuple(live.setpoint_of(key)) == pytest.approx((tilt, 0.0, spin))

            for tilt, spin in ((1.0, 3400.0), (2.0, 3500.0)):
                session.setpoint(key, Setpoint(tilt, 0.0, spin), sure=True)
                session.wait(240.0)
                assert session.trouble is None
                # what was published last may arrive after the answer that the plan has ended
                wait_until(session, partial(published, tilt, spin))
            rows = trace.since(-1)["rows"]
        asked = [row[-len(SETPOINTS)] for row in rows]
        first = asked.index(1.0)
        # never back to the start of a plan
        assert min(own for own in asked[first:] if own is not None) == 1.0
        assert rows[-1][ROW.index("low tilt_x")] == pytest.approx(2.0, abs=0.1)
        parts: list[float] = []
        ends = session.watch(lambda: parts.append(session.job.part or 0.0) if session.job else None)
        session.test(str(plan), "live/bench2")
        session.wait(240.0)
        ends()
        assert session.trouble is None
        assert diagnosed == [2]  # after it was joined
        assert max(parts) > 0.0  # seen to go on
        made = next(own.recording for own in session.opened.values() if own.recording.name != "drag")
        assert made.data.namespace == "/bench2"
        assert made.integrity.missing == 0
        assert len(made.info.holds) >= 2
        # ended in the middle: the bench stops the plan, and goes on
        long = write(
            tmp_path / "long.yaml", plan.read_text().replace("0.5", "600.0").replace("short", "long")
        )
        session.tests = lambda: [str(long)]  # type: ignore[method-assign]
        session.test(str(long), "live/bench2")
        wait_until(session, lambda: session.job is not None and session.job.part is not None)
        session.end()
        session.wait(240.0)
        assert len(session.opened) == 2
        assert diagnosed == [2]
        assert set(graph.pids) == {"plant", "controller", "conductor", "recorder", "drag_estimator"}


@pytest.mark.graph
@pytest.mark.study  # one plan and two are run by other tests
def test_ten_plans_in_a_row_on_one_bench(tmp_path: Path) -> None:
    """Each is recorded completely by the same nodes, whose memory does not grow."""
    pytest.importorskip("rclpy", reason="ROS is not installed")
    from gyrowheel.graph.api import run_and_record, up

    plan, domain = Plan.load(SHORT_PLAN), next_domain()
    memory: list[int] = []
    with up(None, domain=domain) as graph:
        for number in range(10):
            assert run_and_record(plan, tmp_path / f"{number}", domain=domain)
            assert gw.Recording.open(tmp_path / f"{number}").integrity.missing == 0
            memory.append(sum(psutil.Process(own).memory_info().rss for own in graph.pids.values()))
        assert set(graph.pids) == {"plant", "controller", "conductor", "recorder", "drag_estimator"}
    assert memory[-1] - memory[2] < 20_000_000, memory


@pytest.mark.graph
@pytest.mark.study
def test_a_running_bench_that_is_killed_while_it_is_shown_is_reported(wheel: Wheel, tmp_path: Path) -> None:
    """Its test ends with a message, and the page is answered."""
    pytest.importorskip("rclpy", reason="ROS is not installed")
    from gyrowheel.graph.api import GraphError, up

    plan = write(tmp_path / "long.yaml", SHORT_PLAN.replace("0.3", "600.0"))
    domain = next_domain()
    shutil.copytree(wheel.recording, tmp_path / "runs" / "drag")
    session = Session(Library([tmp_path / "runs"]), gw.Model.load(wheel.model))
    session.live = LiveBenches(session.changed, domain)
    session.tests = lambda: [str(plan)]  # type: ignore[method-assign]

    def killed() -> None:
        with up(None, domain=domain) as graph:
            wait_until(session, lambda: "live" in session.live.runs)
            session.open("0/drag", "fitted")
            session.wait(240.0)
            session.test(str(plan), "live")
            wait_until(session, lambda: session.job is not None and bool(session.job.part))
            for own in graph.pids.values():
                os.kill(own, signal.SIGKILL)
            session.wait(240.0)

    with Server(session, port=0) as server, session.live:
        with pytest.raises(GraphError, match="killed by SIGKILL"):
            killed()
        assert "bench" in str(session.trouble)
        wait_until(session, lambda: session.live.runs["live"].silent)
        state = json.loads(ask(server, "/state")[1])
        assert "no more messages" in state["live"]["live"]["words"]
        assert ask(server, "/")[0] == 200
