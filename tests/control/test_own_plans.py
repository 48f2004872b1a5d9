"""User plan files: all problems at once, a template, a schema for editors; shipped plans on any bench."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from gyrowheel_control.plans import demands
from gyrowheel_control.plans.adaptation import adapted, plan_for, plan_from_hold, plan_template
from gyrowheel_control.plans.inspection import inspect
from gyrowheel_control.plans.plan import Block, Plan, PlanFile, json_schema
from gyrowheel_core.errors import InputError
from gyrowheel_core.schema import keys
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench

DEFAULT, DTG = Bench.load(), Bench.load("dtg")
WRITTEN = [name for name in Plan.shipped() if Plan.load(name).written_for == "gyrowheel"]


def like(base: Bench = DEFAULT, **factors: float) -> Bench:
    """Return a bench whose parameters are some times those of another."""
    return base.with_values({name: factor * base.value(name) for name, factor in factors.items()})


#: Machines unlike the default one, each in another way.
OTHERS = {
    "twice the inertia": like(rotor_inertia_x=2, rotor_inertia_y=2, rotor_inertia_z=2, shaft_inertia=2),
    "ten times the inertia": like(rotor_inertia_x=10, rotor_inertia_y=10, rotor_inertia_z=10),
    "weak coils": like(coil_constant=0.2),
    "stiff flexures": like(flexure_stiffness_x=30, flexure_stiffness_y=30),
    "weak motor": like(supply_voltage=0.3),
    "slow": like(spin_rate_minimum=0.1, spin_rate_maximum=0.1, spin_rate_reference=0.1),
    "fast": like(spin_rate_minimum=3, spin_rate_maximum=3, spin_rate_reference=3, supply_voltage=3),
    "a tenth of the tilt": like(tilt_limit=0.1, tilt_reference=0.1),
    "reference beyond the range": like(spin_rate_reference=3),
    "dtg, twice as heavy": like(DTG, rotor_inertia_x=2, rotor_inertia_y=2, rotor_inertia_z=2),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_a_shipped_plan_is_unchanged_on_its_own_bench(name: str) -> None:
    plan = Plan.load(name)
    assert plan_for(plan, DEFAULT) is plan
    assert adapted(plan, DEFAULT) is plan
    assert plan_for(name, like(coil_constant=1.01)).to_yaml() == plan.to_yaml()


@pytest.mark.parametrize("bench", OTHERS.values(), ids=OTHERS)
def test_every_shipped_plan_fits_every_bench(bench: Bench) -> None:
    """What it shows stays: as many segments, speeds and directions, within the limits, and written down alike."""
    for name in WRITTEN:
        check_fitting(name, bench)


def check_fitting(name: str, bench: Bench) -> None:
    written, plan = Plan.load(name), plan_for(name, bench)
    if bench.name == "dtg" and f"dtg_{name}" in Plan.shipped():
        written = Plan.load(f"dtg_{name}")
    assert not list(demands.excesses(plan.segments, bench))
    assert len(plan.segments) == len(written.segments)
    assert len({s.spin for s in plan.segments}) == len({s.spin for s in written.segments})
    for own, was in zip(plan.segments, written.segments, strict=True):
        assert (own.cone_rate == 0.0) == (was.cone_rate == 0.0)
        assert own.environment.air_density_ratio == was.environment.air_density_ratio
        if was.cone_rate == 0.0 and abs(was.tilt) > 0.0:
            assert own.tilt / abs(own.tilt) == pytest.approx(was.tilt / abs(was.tilt), abs=0.02)
    again = Plan.load(plan.to_yaml())
    assert (again.name, again.segments) == (plan.name, plan.segments)
    assert plan_for(plan, bench).segments == plan.segments
    if plan.fitting:
        assert bench.name in plan.title
        assert all(text in plan.description for text in plan.fitting)


def test_changes_of_an_adapted_plan_are_listed_with_numbers() -> None:
    heavy = plan_for("quick", OTHERS["twice the inertia"])
    assert [s.spin for s in heavy.segments] == [s.spin for s in Plan.load("quick").segments]
    said = "; ".join(heavy.fitting)
    assert re.fullmatch(r"tilt rate 8 → [\d.]+ deg/s; acceleration 1000 → \d+ rpm/s; cones slower", said)
    fast = plan_for("coast_down", OTHERS["fast"])
    assert fast.fitting[0] == "speeds 1200 .. 4000 → 3600 .. 12000 rpm"
    small = plan_for("quick", OTHERS["a tenth of the tilt"])
    assert small.tilt_limit == pytest.approx(0.36 * DEG)
    assert [s.label for s in small.segments if s.cone_rate][:2] == ["cone at 0.12 deg", "cone at 0.36 deg"]
    slow = plan_for("paper_speed", OTHERS["slow"])
    assert slow.segments[0].spin == pytest.approx(100 * RPM)
    assert slow.segments[0].hold == pytest.approx(10 * Plan.load("paper_speed").segments[0].hold)


def test_a_plan_name_selects_the_plan_of_the_bench() -> None:
    assert plan_for("quick", DTG).called == "dtg_quick"
    assert plan_for("check@rig=inverted", DTG).called == "dtg_check@rig=inverted"
    assert plan_for("survey", DTG).fitting
    tall = plan_for("quick@tilt_ratio=0.5", OTHERS["twice the inertia"])
    assert tall.called == "quick@tilt_ratio=0.5"
    assert max(abs(s.tilt) for s in tall.segments) == pytest.approx(1.8 * DEG)


@pytest.mark.parametrize(
    ("bench", "plan", "said"),
    [
        (DEFAULT, "quick@spin_ratio=2", "plan 'quick@spin_ratio=2': segment 0 (3500 rpm): spin 7000 rpm"),
        (OTHERS["fast"], "quick@spin_ratio=2", "rpm is beyond the bench; allowed: 3000 .. 12000 rpm"),
        (like(supply_voltage=0.01), "quick", "supply_voltage: 0.28 V bring the motor to 76 rpm"),
        (
            OTHERS["twice the inertia"],
            "schema: 1\nname: own\nsegments:\n  - {spin_rpm: 4000, tilt_deg: [[0, 0], [3, 0]]}\n",
            "slewing at 8.0 deg/s and 4000 rpm needs",
        ),
    ],
)
def test_plans_that_no_lower_rate_makes_possible_are_refused(bench: Bench, plan: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        plan_for(plan, bench)
    assert said in str(caught.value)
    assert "allowed: " in str(caught.value)


# --- a file of one's own -------------------------------------------------------------------------------------


@pytest.mark.parametrize("bench", [DEFAULT, DTG, *OTHERS.values()], ids=["default", "dtg", *OTHERS])
def test_the_plan_template_runs_including_its_commented_blocks(bench: Bench) -> None:
    text = plan_template(bench, "1. My plan")
    plan, wrong = inspect(text, "FILE", bench)
    assert wrong == []
    assert plan is not None
    assert plan.name == "plan_1_my_plan"
    assert {bool(s.cone_rate) for s in plan.segments} == {True, False}
    more = re.sub(r"^(\s*)# (- \{|tilt_limit_deg)", r"\1\2", text, flags=re.MULTILINE)
    plan, wrong = inspect(more, "FILE", bench)
    assert wrong == []
    assert plan is not None
    assert {s.environment.rig for s in plan.segments} == {"upright", "inverted"}


MISTAKES = """\
schema: 1
name: Bad Name
holds: 1.5
tilt_rate_deg_s: 40
segments:
  - {spin_rpn: 3500, tilt_deg: [[0, 0]]}
  - spin_rpm: [3500, 9000]
    tilt_deg: [[0, 0], [7, 0], [8, 0]]
  - {cone_radius_deg: 3}
  - {rig: sideways, hold_s: soon,
     cone_turns: 0}
"""


def test_all_problems_are_listed_with_their_lines() -> None:
    plan, wrong = inspect(MISTAKES, "FILE", DEFAULT)
    assert plan is None
    assert [(item.line, item.place) for item in wrong] == [
        (2, "name"),
        (3, "holds"),
        (6, "segments.0.spin_rpn"),
        (7, "segments.1.spin_rpm"),
        (8, "segments.1.tilt_deg"),
        (9, "segments.2"),
        (10, "segments.3.rig"),
        (10, "segments.3.hold_s"),
        (11, "segments.3.cone_turns"),
    ]
    said = {item.place: item.said for item in wrong}
    assert said["holds"] == "no such field; did you mean hold_s?"
    assert said["segments.0.spin_rpn"] == "no such field; did you mean spin_rpm?"
    assert said["segments.1.spin_rpm"].endswith("allowed: 1000 .. 4000 rpm")
    assert "a cone needs both" in said["segments.2"]
    assert said["segments.3.hold_s"] == "'soon' is not a number; allowed: 0.001 .. 3600"


@pytest.mark.parametrize(
    ("block", "place", "said"),
    [
        (
            "tilt_deg: [[0, 0], [3, 0]], tilt_rate_deg_s: 40",
            "tilt_rate_deg_s",
            r"so up to 1\d\.\d deg/s here$",
        ),
        ("tilt_deg: [0, 0], sweep_to_rpm: 1000, hold_s: 0.1", "sweep_to_rpm", r"so up to \d+ rpm/s here$"),
        ("cone_radius_deg: 3, cone_period_s: 0.2", "cone_period_s", "of the coils; allowed: 7.5 V, so up to"),
        ("tilt_deg: [6, 0]", "tilt_deg", "allowed: up to 5.00 deg$"),
    ],
)
def test_each_excess_is_listed_once_with_the_possible_value(block: str, place: str, said: str) -> None:
    text = f"schema: 1\nname: own\nsegments:\n  - {{spin_rpm: 3500, {block}}}\n"
    plan, (wrong,) = inspect(text, "FILE", DEFAULT)
    assert plan is not None
    assert (wrong.line, wrong.place) == (4, f"segments.0.{place}")
    assert re.search(said, wrong.said), wrong.said


def test_problems_of_the_whole_plan_are_reported_with_their_line() -> None:
    _, (wrong,) = inspect("schema: 1\nname: own\nsegments:\n  - {tilt_deg: [0, 0]}\n", "FILE", DEFAULT)
    assert wrong == (4, "segments.0.spin_rpm", "the first segment must give a speed")
    _, (wrong,) = inspect("schema: 1\nname: own\nsegments: []\n", "FILE", DEFAULT)
    assert (wrong.line, wrong.place) == (3, "segments")
    for text, said in (("", "not a plan"), ("- 1\n", "not a plan"), ("a: [", "not valid YAML")):
        with pytest.raises(InputError, match=said):
            inspect(text, "FILE", DEFAULT)


# --- the format ----------------------------------------------------------------------------------------------


def test_a_name_of_a_file_with_a_line_break_is_no_text_of_a_plan(tmp_path: Path) -> None:
    text = Plan.load("check").to_yaml()
    place = tmp_path / "my\nplan.yaml"
    place.write_text(text, encoding="utf-8")
    assert Plan.load(str(place)).to_yaml() == Plan.load(text).to_yaml()


def test_every_key_has_a_description() -> None:
    for section in (PlanFile, Block):
        for key in keys(section):
            assert key.about
            suffix = re.search(r"_(rpm_s|deg_s|rpm|deg|s|k)$", key.name)
            unit = {"rpm_s": "rpm/s", "deg_s": "deg/s", "k": "K"}.get(suffix[1], suffix[1]) if suffix else ""
            assert key.unit == unit, key.name


def test_the_schema_accepts_and_refuses_the_same_plans_as_the_program() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    schema = json_schema()
    jsonschema.Draft7Validator.check_schema(schema)
    validator = jsonschema.Draft7Validator(schema)

    def content(text: str) -> Mapping[str, Any]:
        return yaml.safe_load(text)

    for name in Plan.shipped():
        validator.validate(content(Plan.load(name).to_yaml()))
    validator.validate(content(plan_template(DEFAULT, "mine")))
    found = {".".join(map(str, e.absolute_path)) for e in validator.iter_errors(content(MISTAKES))}
    assert {"name", "", "segments.0", "segments.3.rig", "segments.3.hold_s", "segments.3.cone_turns"} <= found
    hold = schema["definitions"]["Block"]["properties"]["hold_s"]
    assert hold["description"].startswith("[s] ")


@pytest.mark.parametrize("name", WRITTEN)
def test_a_plan_from_a_held_state_differs_in_its_first_ramp_alone(name: str) -> None:
    plan = plan_for(name, DEFAULT)
    tilt, spin = complex(0.04, -0.05), 0.9 * DEFAULT.value("spin_rate_maximum")
    begun = plan_from_hold(plan, DEFAULT, tilt, spin)
    first, before = begun.segments[0], plan.segments[0]
    assert (first.tilt_from, first.spin_from) == (tilt, spin)
    assert (first.tilt, first.spin, first.hold) == (before.tilt, before.spin, before.hold)
    longer = first.ramp - before.ramp
    assert begun.duration == pytest.approx(plan.duration + longer)
    assert [s.start - longer for s in begun.segments[1:]] == pytest.approx(
        [s.start for s in plan.segments[1:]]
    )
    assert [s.tilt for s in begun.segments] == [s.tilt for s in plan.segments]
    row = begun.setpoints()[0]
    assert (row["tilt_x"], row["tilt_y"], row["spin_rate"]) == (tilt.real, tilt.imag, spin)
    same = plan_from_hold(plan, DEFAULT, before.tilt_from, before.spin_from)
    assert same.segments == plan.segments


@pytest.mark.parametrize("bench", [DEFAULT, DTG, *OTHERS.values()], ids=["default", "dtg", *OTHERS])
def test_the_ramp_from_a_held_state_is_one_that_the_bench_can_follow(bench: Bench) -> None:
    """Also where the plan states the time of its first ramp, which is for its own start."""
    survey = plan_for("survey", bench)
    speeds, tilts = {s.spin for s in survey.segments}, [s.tilt for s in survey.segments]
    sudden = f"{{spin_rpm: {min(speeds) / RPM:.9g}, tilt_deg: [0, 0], ramp_s: 0.05}}"
    short = Plan.load(f"schema: 1\nname: short\nsegments:\n  - {sudden}\n")
    for plan in (survey, plan_for(short, bench)):
        begun = plan_from_hold(plan, bench, max(tilts, key=abs), max(speeds))
        assert not list(demands.excesses(begun.segments[:1], bench))
