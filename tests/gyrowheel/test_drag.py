"""The verb `drag` and `gyrowheel.drag`, and the options --model and --truth."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv as pc
import pyarrow.parquet as pq
import pytest
from rosbags.highlevel import AnyReader

import gyrowheel as gw
from gyrowheel.drag_comparison.picture import air_increments
from gyrowheel_analysis.drag.agreement import agreement
from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_analysis.drag.stream import recorded_holds
from gyrowheel_analysis.model import Model
from gyrowheel_core import topics, wire
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.bags.columns import typestore

from .conftest import Wheel
from .helpers import DRAG_PLAN, Shell, write

MODEL = """\
schema: 1
bench: gyrowheel
overrides:
  coil_constant: {value: 0.0203, standard_error: 1.0e-4}
  motor_constant: {value: 0.03, standard_error: 1.0e-4}
effects:
  windage: {w: {value: 0.0013, standard_error: 1.0e-4}}
"""


def recorded(directory: Path) -> list[Any]:
    """Return the settled drag estimates of a recording, as rosbags reads them."""
    with AnyReader([directory], default_typestore=typestore()) as reader:
        chosen = [c for c in reader.connections if c.topic == topics.DRAG_ESTIMATE.name]
        every: list[Any] = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(chosen)]
    return [message for message in every if message.settled]


def assert_same(messages: list[Any], computed: list[dict[str, Any]]) -> None:
    assert len(messages) == len(computed) > 0
    for message, row in zip(messages, computed, strict=True):
        stamp = message.header.stamp
        assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(row["stamp"], abs=1e-9)
        assert row.keys() == {"stamp", *wire.DRAG_ESTIMATE.names}
        for name in wire.DRAG_ESTIMATE.names:
            values = np.atleast_1d(getattr(message, name)).astype(float)
            assert np.isfinite(values).all()
            assert values == pytest.approx(np.atleast_1d(row[name]).astype(float), rel=1e-9, abs=1e-9)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("model") / "wheel.yaml", MODEL)


@pytest.mark.slow
def test_recorded_estimates_are_those_of_drag(
    gyrowheel: Shell, wheel: Wheel, model: Path, tmp_path: Path
) -> None:
    plan = write(tmp_path / "plan.yaml", DRAG_PLAN)
    machine = ["--plan", plan, "--effect", "windage:w=0.0013", "--seed", 4]
    gyrowheel.good("simulate", *machine, "--model", model, "-o", tmp_path / "run")
    said = gyrowheel.good("drag", tmp_path / "run", "--model", model, "--json", "-").json
    assert said["model"] == str(model)
    (own,) = said["recordings"]
    assert own["recording"] == str(tmp_path / "run")
    assert all(row["calibrated"] for row in own["holds"])
    assert_same(recorded(tmp_path / "run"), own["holds"])
    # the belief changes no sample
    assert np.array_equal(
        gw.Recording.open(tmp_path / "run").measurement, gw.Recording.open(wheel.recording).measurement
    )
    # and from Python
    result = gw.drag(tmp_path / "run", gw.Model.load(model))
    assert json.loads(json.dumps(result.to_dict())) == said
    assert result.headline() == "8 holds; measured and simulated torques agree (calibrated constants)"
    columns = result.to_columns()
    assert columns["residual_motor"] == [row["residual"][2] for row in own["holds"]]
    assert "Drag estimates" in result._repr_html_()


def test_the_estimator_uses_the_model_not_the_truth(gyrowheel: Shell, model: Path, tmp_path: Path) -> None:
    plan = write(tmp_path / "plan.yaml", DRAG_PLAN)
    gyrowheel.good("simulate", "--plan", plan, "--truth", model, "-o", tmp_path / "run")
    messages = recorded(tmp_path / "run")
    # it believes the bench without effects, as `drag` does without a model
    assert_same(
        messages, gyrowheel.good("drag", tmp_path / "run", "--json", "-").json["recordings"][0]["holds"]
    )
    assert not any(message.calibrated for message in messages)
    assert not any(np.any(message.simulated_air_torque) for message in messages)
    # the machine has the windage of the file, which is what the motor holds beyond the belief
    fast = [message for message in messages if message.spin_rate > 360.0]
    for message in fast:
        error = np.hypot(message.measured_torque_std[2], message.constants_std[2])
        assert abs(message.residual[2] - 1.3e-3) < 3.0 * error + 0.1e-3


def test_a_model_without_truth_is_reported_as_a_belief(gyrowheel: Shell, model: Path, tmp_path: Path) -> None:
    plan = write(tmp_path / "plan.yaml", DRAG_PLAN)
    shown = gyrowheel.good("simulate", "--plan", plan, "--model", model, "-o", tmp_path / "a")
    assert "--truth" in shown.err
    shown = gyrowheel.good("simulate", "--plan", plan, "-o", tmp_path / "b")
    assert "--truth" not in shown.err
    a, b = (gw.Recording.open(tmp_path / name).measurement for name in "ab")
    assert np.array_equal(a, b)


def test_benches_of_belief_and_truth_must_agree(gyrowheel: Shell, model: Path, tmp_path: Path) -> None:
    Model.new("dtg").save(tmp_path / "dtg.yaml")
    options = ["--plan", "quick", "-o", tmp_path / "x", "--truth", tmp_path / "dtg.yaml", "--model", model]
    result = gyrowheel("simulate", *options)
    assert result.code == 2
    assert "model: the bench" in result.err
    assert "not that of truth" in result.err


def test_the_table_has_a_line_for_each_hold(gyrowheel: Shell, wheel: Wheel, model: Path) -> None:
    shown = gyrowheel.good("drag", wheel.recording, "--model", model).out
    lines = shown.splitlines()
    assert max(map(len, lines)) <= 80
    # hold, two tilts, speed, voltage, reference, two changes, three torques, two differences
    rows = [line for line in lines if re.fullmatch(r"\d+( +[−\d.]+){12}", line)]
    assert len(rows) == 3 * 8
    assert [line.split()[0] for line in rows] == 3 * [str(k) for k in range(8)]
    assert "are calibrated" in shown
    plain = gyrowheel.good("drag", wheel.recording).out
    assert "not calibrated" in plain
    assert "air" not in plain.replace("--", "").split("ref:")[0]


def test_holds_are_found_without_setpoints(wheel: Wheel) -> None:
    whole = Recording.open(wheel.recording)
    bare = dataclasses.replace(whole, setpoint=whole.setpoint[:0])
    wanted, found = recorded_holds(whole, Model.new()), recorded_holds(bare, Model.new())
    # the shortest stretches are found in part, or not at all
    assert len(found) >= sum(planned.duration > 0.5 for planned in wanted) == 6
    assert [own.segment for own in found] == sorted(own.segment for own in found)
    for own in found:
        planned = min(wanted, key=lambda each: abs(each.stamp_ns - own.stamp_ns))
        assert own.tilt_x == pytest.approx(planned.tilt_x, abs=1e-4)
        assert own.tilt_y == pytest.approx(planned.tilt_y, abs=1e-4)
        if planned.duration > 0.5:  # in the others the speed still settles
            error = np.hypot(own.dc_voltage_std, planned.dc_voltage_std)
            assert np.all(np.abs(own.dc_voltage - planned.dc_voltage) < 5.0 * error)


def test_a_recording_without_a_hold_is_refused(gyrowheel: Shell, tmp_path: Path) -> None:
    gw.simulate("schema: 1\nname: short\nhold_s: 0.3\nsegments: [{spin_rpm: 3000, tilt_deg: [[0, 0]]}]\n",
                folder=tmp_path / "run")  # fmt: skip
    result = gyrowheel("drag", tmp_path / "run")
    assert result.code == 2
    assert "no steady hold" in result.err


@pytest.mark.slow
def test_dc_voltages_are_means_of_the_filtered_signals(
    gyrowheel: Shell, wheel: Wheel, tmp_path: Path
) -> None:
    result = gw.drag(wheel.recording)
    (signals,) = result.signals
    names = ("coil_voltage_x", "coil_voltage_y", "motor_voltage")
    for estimate in result.holds[0]:
        stop = estimate.stamp_ns * 1e-9
        inside = (signals["stamp"] > stop - estimate.duration - 1e-6) & (signals["stamp"] < stop + 1e-6)
        means = [signals[f"notched_{name}"][inside].mean() for name in names]
        assert estimate.dc_voltage == pytest.approx(means, abs=1e-12)
    for suffix in (".csv", ".parquet"):
        file = tmp_path / f"signals{suffix}"
        for _ in range(2):  # an earlier output is replaced
            gyrowheel.good("drag", wheel.recording, "--columns", file)
        read = pc.read_csv(file) if suffix == ".csv" else pq.read_table(file)
        assert read.column_names == ["recording", *signals]
        assert np.array_equal(read["notched_motor_voltage"].to_numpy(), signals["notched_motor_voltage"])
    assert pq.read_schema(tmp_path / "signals.parquet").field("stamp").metadata == {b"unit": b"s"}
    wrong = gyrowheel("drag", wheel.recording, "--columns", tmp_path / "signals.xlsx")
    assert wrong.code == 2
    assert ".parquet" in wrong.err


@pytest.mark.slow
def test_the_picture_has_increments_with_and_without_air(
    gyrowheel: Shell, wheel: Wheel, model: Path, tmp_path: Path
) -> None:
    gyrowheel.good("drag", wheel.recording, "--model", model, "--picture", tmp_path / "drag.png")
    assert (tmp_path / "drag.png").read_bytes().startswith(b"\x89PNG")
    result = gw.drag(wheel.recording, gw.Model.load(model))
    none = gw.Model.load(model).remove("windage")
    without = gw.drag(wheel.recording, none)
    for place in range(3):
        difference = [
            float(a.simulated_voltage_increment[place] - b.simulated_voltage_increment[place])
            for a, b in zip(result.holds[0], without.holds[0], strict=True)
        ]
        assert air_increments(result, place) == pytest.approx(difference, abs=1e-4)
    assert "simulated without air" in [t.get_text() for t in result.plot().legends[0].get_texts()]
    assert "simulated without air" not in [t.get_text() for t in without.plot().legends[0].get_texts()]


def test_the_page_reports_whether_the_torques_agree(gyrowheel: Shell, wheel: Wheel, model: Path) -> None:
    with_air = " ".join(gyrowheel.good("drag", wheel.recording, "--model", model).out.split())
    assert with_air.count("Measured and simulated torque agree: χ²") == 3
    # the machine has windage that this model lacks
    lacking = write(model.with_name("lacking.yaml"), MODEL.partition("effects:")[0])
    without = " ".join(gyrowheel.good("drag", wheel.recording, "--model", lacking).out.split())
    assert "torque disagree: χ²" in without.partition("Drag estimates, motor")[2]


def test_errors_that_holds_share_do_not_hide_a_disagreement(wheel: Wheel) -> None:
    """Windage that the model lacks, and a bench whose every constant is badly known: no hold shows it alone."""
    plain = gw.Model.load(wheel.model)
    (coil_x, coil_y, motor), *_ = gw.drag(wheel.recording, plain, signals=False).agreements
    assert coil_x.agrees
    assert coil_y.agrees
    assert not motor.agrees
    assert "disagree in motor" in gw.drag(wheel.recording, plain, signals=False).headline()
    better = plain.add("windage", fit=wheel.recording)
    found = gw.drag(wheel.recording, better, signals=False)
    assert all(own.agrees for own in found.agreements[0])
    assert "simulated torques agree" in found.headline()
    said = found.to_dict()["recordings"][0]["agreement"]["motor"]
    assert said["agrees"]
    assert len(said["apart"]) == len(found.holds[0])


def test_a_hold_apart_from_the_others_is_found_within_large_shared_errors() -> None:
    """The joint covariance by hand: two holds share an error of 1, and differ by ten times their own noise."""
    bench = gw.Model().bench
    drift = bench.value("coil_constant") * bench.value("coil_voltage_drift")
    own = 1e-4

    def hold(residual: float, second: int) -> Estimate:
        zero = np.zeros(3)
        return Estimate(
            second * wire.SECOND, second, True, 1.0, 0.0, 0.0, 300.0, zero, zero, 0.0, 0.0, 0, zero, zero, zero,
            False, zero, np.full(3, np.hypot(own, drift)), np.full(3, 1e-2), zero, zero, np.full(3, residual),
            np.full((1, 3), 1e-2),
        )  # fmt: skip

    apart = agreement([hold(8e-3, 1), hold(8e-3 + 10 * own, 2)], 0, bench)
    assert not apart.agrees
    assert np.all(np.abs(apart.apart) > 3.0)
    same = agreement([hold(8e-3, 1), hold(8e-3, 2)], 0, bench)
    assert same.agrees
    assert same.chi2 == pytest.approx(0.64, rel=0.05)
    assert agreement([dataclasses.replace(hold(8e-3, 1), changes=np.zeros((0, 3)))], 0, bench).agrees


@pytest.mark.study
@pytest.mark.parametrize("seed", range(30))
def test_torques_of_complete_models_agree(seed: int) -> None:
    found = gw.drag(gw.simulate("quick", machine=seed, seed=seed), gw.Model(), signals=False)
    assert all(own.agrees for own in found.agreements[0])
