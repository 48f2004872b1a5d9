"""When a finding is settled although the recording still grows."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gyrowheel_analysis.criteria import ACCEPTED_GAIN
from gyrowheel_analysis.diagnosis.looks import Settlement, required_gain
from gyrowheel_analysis.diagnosis.result import Diagnosis

from ..gyrowheel.findings import diagnosis, finding


def test_all_looks_together_cause_no_more_false_alarms_than_one_diagnosis() -> None:
    """The probability of a gain by chance falls with exp(-gain / 2)."""
    parts = [math.exp(-0.5 * (required_gain(look) - ACCEPTED_GAIN)) for look in range(1, 100_000)]
    assert sum(parts) == pytest.approx(1.0, abs=1e-4)
    assert sum(parts) <= 1.0


def named(name: str, gain: float = 1000.0, verdict: str = "effect") -> Diagnosis:
    return diagnosis(verdict, replace(finding(name), delta_chi2=gain))


def test_an_effect_is_settled_once_two_looks_name_it_without_a_tie() -> None:
    once = Settlement().after(named("windage"))
    assert not once.settled
    assert once.after(named("windage")).settled
    assert not once.after(named("eddy_drag")).settled
    assert not once.after(named("windage", verdict="ambiguous")).settled
    # later looks ask for more
    gain = required_gain(10)
    assert replace(once, looks=9).after(named("windage", gain)).settled
    assert not replace(once, looks=10).after(named("windage", gain)).settled


@pytest.mark.parametrize("verdict", ["nothing_missing", "unknown", "insufficient_data"])
def test_what_names_no_effect_is_never_settled(verdict: str) -> None:
    found = diagnosis(verdict)
    assert not Settlement().after(found).after(found).settled
