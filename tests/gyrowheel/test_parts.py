"""Parts of recordings, named behind their path, and what a diagnosis says of an event."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel.diagnosis.api import Diagnosis
from gyrowheel.show.layout import plain_text
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.fitting.preparation import samples_of
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("parts") / "quick"
    gw.simulate("quick", machine=3, seed=3).save(place)
    return place


@pytest.mark.slow
def test_part_has_the_windows_that_lie_in_it(folder):
    bench = Bench.load()
    whole, part = (
        reduce(samples_of(Recording.open(path)), bench) for path in (folder, f"{folder}@from=10,until=30")
    )
    inside = (whole.start >= 10.0) & (whole.start + whole.duration <= 30.0)
    assert 3 < inside.sum() < len(whole)
    assert part.start.min() >= 9.99
    assert (part.start + part.duration).max() <= 30.01
    # what came before has warmed the motor, in the part as in the whole
    same = np.isin(whole.start.round(3), part.start.round(3))
    np.testing.assert_allclose(
        whole.motor_temperatures[same],
        part.motor_temperatures[np.isin(part.start.round(3), whole.start.round(3))],
    )


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ("until=x", "until: 'x' is out of range"),
        ("from=200", "lies outside the recording"),
        ("from=20,until=10", "until: 10 s is out of range"),
        ("start=3", "'start' is no limit of a part"),
        ("from=3,from=4", "from is given twice"),
    ],
)
def test_an_impossible_part_is_refused_in_one_line(folder, part, words):
    with pytest.raises(gw.InputError, match=words) as caught:
        gw.Recording.open(f"{folder}@{part}")
    assert "\n" not in str(caught.value)


def test_parts_of_one_recording_may_not_overlap(folder):
    model = gw.Model("gyrowheel")
    with pytest.raises(gw.InputError, match="cannot validate the fit"):
        gw.diagnose(f"{folder}@until=30", model, validate=f"{folder}@from=20")
    with pytest.raises(gw.InputError, match="given twice"):
        gw.compare([folder, f"{folder}@from=20"], model)


@pytest.mark.slow
def test_an_event_is_reported_first_with_the_parts_before_and_after_it(folder):
    recording = Recording.open(folder)
    measurement = recording.measurement.copy()
    measurement["coil_voltage_x"] -= 0.02 * (recording.time > 25.0)
    found = Diagnosis.of(
        diagnose([replace(recording, measurement=measurement)], gw.Model("gyrowheel").details)
    )
    (event,) = json.loads(json.dumps(found.to_dict()))["events"]
    assert (event["kind"], event["unit"], event["recording"]) == ("step", "V", str(folder))
    assert event["time"] == pytest.approx(25.0, abs=0.3)
    assert event["size"] == pytest.approx(-0.02, abs=5.0 * event["standard_error"])
    assert found.sentence.startswith("At 25.0") or found.sentence.startswith("At 24.9")
    assert " mV in the reading of coil voltage x appeared and stayed. " in found.sentence
    assert found.parts == (f"{folder}@until={event['time']:.1f}", f"{folder}@from={event['time']:.1f}")
    for width in (80, 120):
        assert "could also be a torque about case x: these" in " ".join(
            plain_text(found.page(), width).split()
        )
    # each part is a recording like any other
    for part in found.parts:
        assert gw.Recording.open(part).name == part.rpartition("/")[2]
