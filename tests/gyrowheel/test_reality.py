"""Campaigns with imperfect instruments and events: what is hidden, and how answers are judged and counted."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrowheel.campaigns import judge
from gyrowheel.campaigns.api import run_case
from gyrowheel.campaigns.cases import Campaign, Case, cases
from gyrowheel.campaigns.hidden import Secret, Yardstick, hide, record, yardstick
from gyrowheel.campaigns.page import campaign_page
from gyrowheel.campaigns.reality import HiddenEvent, events
from gyrowheel.campaigns.summary import Summary
from gyrowheel.show.layout import plain_text
from gyrowheel_analysis.diagnosis.findings import TieReport
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.effects import registry
from gyrowheel_sim.parameter import INSTRUMENTS
from gyrowheel_sim.plant.scenario import Scenario

from .findings import diagnosis, finding, tie
from .helpers import DRAG_PLAN, OTHER_PLAN, Shell

CAMPAIGN = Campaign(DRAG_PLAN, OTHER_PLAN, seed=5, kinds=("none", "single", "event"), reality=True)


@pytest.fixture(scope="module")
def measure() -> Yardstick:
    return yardstick(CAMPAIGN.bench, CAMPAIGN.plan)


@pytest.mark.study
def test_a_law_with_a_state_is_named_no_effect_that_predicts_nothing() -> None:
    """Windage described a part of a torque on the spin that lags, and no other recording."""
    campaign = Campaign("survey", "check", seed=6001, kinds=("outside",), reality=True)
    (case,) = cases(campaign, 24, only=[10])
    found = run_case(None, case)
    assert list(found.truth) == ["strange_shaft_state"]
    assert found.verdict == "unknown"
    assert not found.named


def test_events_need_reality(gyrowheel: Shell) -> None:
    with pytest.raises(InputError, match=r"kinds: 'event' is not known; allowed: .*; events need --reality"):
        replace(CAMPAIGN, reality=False)
    assert gyrowheel("campaign", "--kinds", "event", "--cases", "1").code == 2


def test_a_secret_depends_on_its_case_alone_and_instruments_change_nothing_else(measure: Yardstick) -> None:
    for case in cases(replace(CAMPAIGN, kinds=("none", "single")), 6):
        secret = hide(case, measure)
        assert secret == hide(case, measure)
        without = hide(
            Case(replace(case.campaign, reality=False), case.index, case.kind, case.ordinal), measure
        )
        own = {n: v for n, v in without.scenario.values.items() if n not in INSTRUMENTS}
        assert own.items() <= secret.scenario.values.items()
        assert secret.truth.keys() == without.truth.keys()
        assert secret.gains == without.gains
        assert secret.instruments or case.kind == "single"


def test_wrong_instruments_take_turns_within_their_bounds(measure: Yardstick) -> None:
    secrets = [hide(case, measure) for case in cases(replace(CAMPAIGN, kinds=("none",)), 40)]
    seen = {name for secret in secrets for name in secret.instruments}
    assert seen == {name for name, e in registry().items() if e.category == "instrument"}
    assert {len(secret.instruments) for secret in secrets} == {1, 2, 3}
    period = CAMPAIGN.bench.sample_period
    for secret in secrets:
        for name, values in secret.instruments.items():
            if "d" in values:
                assert values["d"] + secret.scenario.values[name] >= -period - 1e-12
        assert all(
            secret.scenario.values[n] >= 0.0 for n in INSTRUMENTS if n.endswith(("_resolution", "_hum"))
        )


@pytest.mark.study  # tests/analysis/test_events.py finds and dates events
@pytest.mark.parametrize("name", events())
def test_an_event_happens_once_at_its_time(name: str, measure: Yardstick, tmp_path: Path) -> None:
    quiet = {n: 0.0 for n in CAMPAIGN.bench.parameters if n.endswith(("_noise", "_drift"))}
    shape: Any = name.rpartition("_")[2]
    event = HiddenEvent(name, shape, 9.0, 12.0)
    values = {"t_0": 9.0} | ({} if shape == "step" else {"t_1": 12.0})
    values |= {"A": 5e-4} if "friction" in name else {"A_x": 5e-4, "A_y": -3e-4}
    case = cases(CAMPAIGN, 1)[0]
    secret = Secret(Scenario(values=quiet), sizes={name: 3.0}, event=event, event_values=values)
    nothing = replace(secret, event_values={key: 0.0 if key[0] == "A" else v for key, v in values.items()})
    readings = []
    for number, (given, part) in enumerate(((secret, 0), (secret, 1), (nothing, 0))):
        record(case, given, CAMPAIGN.plan, part, tmp_path / str(number))
        readings.append(Recording.open(tmp_path / str(number)))
    happened, unused, without = readings
    columns = ("tilt_x", "coil_voltage_x", "motor_current")
    change = sum(np.abs(happened.measurement[c] - without.measurement[c]) for c in columns)
    time = happened.time - happened.time[0]
    assert not change[time < 8.99].any()
    assert change[(time > 9.0) & (time < 9.5)].max() > 1e-5
    np.testing.assert_array_equal(unused.measurement["coil_voltage_x"], without.measurement["coil_voltage_x"])
    assert measure.size(name, values, 1.0, {}) > 0.1


# ---- judgement


@dataclass(frozen=True)
class Named:
    """What a verdict says of an instrument."""

    name: str
    ties: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class Told:
    """What a verdict says of an event."""

    time: float
    time_error: float = 0.3


def judged(secret: Secret, *, kind: str = "none", **answer: Any) -> judge.Judged:
    told = diagnosis("effect", *answer.pop("effects", ()), **answer)
    case = next(c for c in cases(CAMPAIGN, 9) if c.kind == kind)
    return judge.judge(case, secret, told)


LATE = Secret(Scenario(), sizes={"coil_voltage_delay": 8.0}, instruments={"coil_voltage_delay": {"d": 3e-4}})


def test_a_wrong_instrument_is_named_tied_or_missed() -> None:
    how: dict[str, dict[str, Any]] = {
        "named": {"instruments": [Named("coil_voltage_delay")]},
        "tied": {"instruments": [Named("coil_voltage_filter", [tie("coil_voltage_delay", None)])]},
        "missed": {},
    }
    for expected, answer in how.items():
        case = judged(LATE, **answer)
        assert [item.found for item in case.instruments] == [expected]
        assert case.right
        assert not case.instruments_wrong
    # of an alternative of two, both must be hidden
    pair = TieReport("coil_voltage_delay + tilt_delay", "", -19.0, None, None, None)
    for ties in ([], [pair]):
        other = judged(LATE, instruments=[Named("encoder_zero", ties)])
        assert other.instruments_wrong == ["encoder_zero"]
        assert [item.found for item in other.instruments] == ["missed"]
        assert not other.right


def test_an_effect_named_for_an_instrument_is_a_false_alarm_unless_tied() -> None:
    alarm = judged(LATE, effects=[finding("coil_inductance")])
    assert alarm.outcome == "misnamed"
    assert not alarm.right
    honest = judged(LATE, effects=[finding("coil_inductance", tie("coil_voltage_delay"))])
    assert honest.outcome == "tied"
    assert [item.found for item in honest.instruments] == ["tied"]
    assert Summary.counted(1, 2, [alarm, replace(honest, index=1)]).false_alarms.count == 1


def test_an_effect_next_to_a_wrong_instrument_is_judged_alone() -> None:
    secret = replace(
        LATE, truth={"coil_inductance": {"t_L": 3e-4}}, sizes={**LATE.sizes, "coil_inductance": 5.0}
    )
    both = judged(
        secret, kind="single",
        effects=[finding("coil_inductance")], instruments=[Named("coil_voltage_delay")],
    )  # fmt: skip
    assert both.outcome == "exact"
    imitated = judged(
        secret, kind="single",
        instruments=[Named("coil_voltage_delay", [tie("coil_inductance", "survey")])],
    )  # fmt: skip
    assert imitated.outcome == "tied"
    assert judged(secret, kind="single", instruments=[Named("coil_voltage_delay")]).outcome == "missed"


@pytest.mark.parametrize(
    ("shape", "told", "dated"),
    [
        ("step", [Told(41.5)], True),
        ("step", [Told(12.0), Told(38.5)], True),
        ("step", [Told(42.5, 5.0)], False),
        ("trend", [Told(45.0, 2.0)], True),
        ("burst", [], False),
    ],
)
def test_an_event_must_be_dated(shape: Any, told: list[Told], dated: bool) -> None:
    name = f"torque_{shape}"
    secret = Secret(Scenario(), sizes={name: 4.0}, event=HiddenEvent(name, shape, 40.0, 60.0))
    case = judged(secret, kind="event", events=told)
    assert case.event is not None
    assert case.event.dated is dated
    assert case.right is dated
    swallowed = judged(secret, kind="event", events=told, effects=[finding("windage")])
    assert not swallowed.right
    content = Summary.counted(1, 1, [case]).to_json()
    assert content["event"] == {"n": 1, "detectable": 1, "dated": int(dated), "missed": int(not dated)}
    assert "instrument" not in content
    page = plain_text(campaign_page(Summary.counted(1, 1, [case], "title")))
    assert "dated within 2 s" in page


def test_counts_of_instruments() -> None:
    found = judged(LATE, instruments=[Named("coil_voltage_delay"), Named("encoder_zero")])
    small = judged(replace(LATE, sizes={"coil_voltage_delay": 1.0}))
    content = Summary.counted(1, 2, [found, replace(small, index=1)]).to_json()["instrument"]
    assert content == {"n": 2, "detectable": 1, "named": 1, "tied": 0, "wrong": 0, "named_falsely": 1}
