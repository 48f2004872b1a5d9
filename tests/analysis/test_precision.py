"""Which test would sharpen what was found."""

from __future__ import annotations

from pathlib import Path

import pytest

from gyrowheel_analysis.criteria import PRECISE
from gyrowheel_analysis.diagnosis.diagnose import diagnose
from gyrowheel_analysis.diagnosis.experiment_design import precision_test, relative_error
from gyrowheel_analysis.model import Model

from .machines import hidden_machine, record


@pytest.mark.study  # precision of every campaign is compared by benchmarks
@pytest.mark.slow
def test_the_proposed_test_improves_precision_as_predicted(tmp_path: Path):
    # just above its detection limit, so that its size is known badly
    machine = hidden_machine(17, {"windage": {"w": 0.0004, "n": 1.48}})
    recordings = [record(tmp_path, "fit", machine, "quick")]
    first = diagnose(recordings, Model.new())
    (found,) = first.effects
    assert relative_error(found) > PRECISE
    test = precision_test(recordings, Model.new(), first, wanted=0.05)
    assert test is not None
    assert test.now == pytest.approx(relative_error(found), rel=0.05)
    assert test.expected < 0.7 * test.now
    recordings.append(record(tmp_path, "more", machine, test.plan, noise_seed=171))
    (sharper,) = (e for e in diagnose(recordings, Model.new()).effects if e.name == found.name)
    assert relative_error(sharper) == pytest.approx(test.expected, rel=0.4)


@pytest.mark.study
def test_a_precise_finding_needs_no_test(tmp_path: Path):
    machine = hidden_machine(18, {"aero_cross": {"c": 0.006, "n": 1.98}})
    recordings = [record(tmp_path, "fit", machine, "quick")]
    found = diagnose(recordings, Model.new())
    assert [e.name for e in found.effects] == ["aero_cross"]
    assert precision_test(recordings, Model.new(), found) is None
    test = precision_test(recordings, Model.new(), found, wanted=1e-6)
    assert test is None or test.expected < 0.7 * test.now
