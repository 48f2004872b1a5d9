"""Campaigns: what is hidden, who sees what, how answers are judged and counted, and who does the work."""

from __future__ import annotations

import ast
import functools
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrowheel.batches import workers
from gyrowheel.campaigns import hidden as hiding
from gyrowheel.campaigns.api import _move, run_case
from gyrowheel.campaigns.cases import Campaign, Case, cases
from gyrowheel.campaigns.hidden import LARGEST, Secret, Yardstick, hide, yardstick
from gyrowheel.campaigns.judge import Interval, Judged, judge
from gyrowheel.campaigns.page import campaign_page, campaign_report, case_line
from gyrowheel.campaigns.reality import declared, outside_forms
from gyrowheel.campaigns.summary import Rate, Summary, covered
from gyrowheel.show.layout import show
from gyrowheel_analysis.fitting.fit import ERRORS
from gyrowheel_control.loops.controller import Gains
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import json_text
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import KINDS
from gyrowheel_sim.effects import physical, registry
from gyrowheel_sim.effects.registry import for_bench
from gyrowheel_sim.plant.scenario import Scenario

from .findings import WINDAGE, delay_finding, diagnosis, finding, judged_case, tie
from .helpers import DRAG_PLAN, OTHER_PLAN, SHORT_PLAN, Shell, write
from .pages import Page, check_numbers

CAMPAIGN = Campaign(DRAG_PLAN, OTHER_PLAN, seed=5)


def case_of(kind: str, campaign: Campaign = CAMPAIGN, ordinal: int = 0) -> Case:
    return next(c for c in cases(campaign, 400) if c.kind == kind and c.ordinal == ordinal)


@pytest.fixture(scope="module")
def measure() -> Yardstick:
    return yardstick(CAMPAIGN.bench, CAMPAIGN.plan)


# ---- the cases


def test_kinds_have_their_shares_and_a_case_does_not_depend_on_the_number_of_cases():
    many = cases(CAMPAIGN, 200)
    counts = {kind: sum(c.kind == kind for c in many) for kind in KINDS}
    assert counts == {kind: round(200 * share) for kind, share in KINDS.items()}
    assert cases(CAMPAIGN, 30) == many[:30]
    assert [c.index for c in cases(CAMPAIGN, 30, [7, 3])] == [3, 7]
    assert {c.kind for c in cases(replace(CAMPAIGN, kinds=("none",)), 5)} == {"none"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seed": -1}, "seed: -1"),
        ({"kinds": ("nun",)}, "kinds: 'nun'"),
        ({"kinds": ()}, "kinds: none given"),
        ({"kinds": ("none", "none")}, "twice"),
        ({"drift": -1.0}, "drift: -1"),
        ({"noise": math.nan}, "noise: nan"),
        ({"gains": 9.0}, "gains: 9"),
        ({"lost": 0.5}, r"lost: 0\.5 is out of range; allowed: 0 \.\. 0\.2"),
        ({"plan": DRAG_PLAN.replace("3500", "9000")}, "9000 rpm"),
    ],
)
def test_bad_settings_are_refused(change: dict[str, Any], words: str):
    with pytest.raises(InputError, match=words):
        replace(CAMPAIGN, **change)


# ---- what is hidden


@pytest.mark.parametrize("kind", KINDS)
def test_a_secret_depends_on_its_case_alone(kind: str, measure: Yardstick):
    case = case_of(kind)
    assert hide(case, measure) == hide(case, measure)
    other = hide(replace(case, index=case.index + 1000), measure)
    assert other.scenario.values != hide(case, measure).scenario.values


def test_a_plan_without_steady_motion_is_refused() -> None:
    with pytest.raises(InputError, match="plan short: no steady motion in it; allowed: "):
        yardstick(CAMPAIGN.bench, SHORT_PLAN)


def test_machines_controllers_and_noise_vary(measure: Yardstick):
    secrets = [hide(c, measure) for c in cases(replace(CAMPAIGN, kinds=("none",), gains=2.0, drift=3.0), 40)]
    assert all(not s.truth and not s.scenario.effects for s in secrets)
    stated = CAMPAIGN.bench
    for name in ("rotor_inertia_z", "coil_constant", "tilt_bias_x"):
        p = stated.parameters[name]
        drawn = np.array([(s.scenario.values[name] - p.value) / p.uncertainty for s in secrets])
        assert 0.6 < drawn.std() < 1.4
    drifts = np.array([s.scenario.values["coil_voltage_drift"] for s in secrets])
    assert np.all((drifts >= 3.0e-3 / 1.41) & (drifts <= 3.0e-3 * 1.41))
    assert drifts.std() > 0.0
    spin = np.array([s.gains.spin_proportional for s in secrets]) / Gains().spin_proportional
    assert 1.5 < spin.min() < spin.max() < 2.6
    assert len({s.gains.tilt_bandwidth for s in secrets}) == 40


def test_effects_take_turns_and_are_as_large_as_limits_allow(measure: Yardstick):
    pool = [*physical(), *ERRORS]
    secrets = [hide(case_of("single", ordinal=k), measure) for k in range(len(pool))]
    assert {name for s in secrets for name in s.truth} == set(pool)
    for secret in secrets:
        ((name, values),) = secret.truth.items()
        size = secret.sizes[name]
        assert math.isnan(size) or 0.0 < size <= 1.001 * LARGEST, name
        if name in ERRORS:
            assert not secret.scenario.effects
        else:
            assert secret.scenario.effects == secret.truth
            for c in physical()[name].amplitudes:
                assert abs(values[c.name]) <= 1.001 * max(hiding.MOST_OF_USUAL * c.usual[1], 0.0)
            if (most := physical()[name].greatest) is not None:
                together = math.hypot(*(values[c.name] for c in physical()[name].amplitudes))
                assert together <= 1.001 * most, name
    assert sum(s.sizes[next(iter(s.truth))] >= 1.0 for s in secrets) > 0.5 * len(pool)


def test_effects_on_another_bench_have_its_sizes():
    bench = Bench.load("dtg")
    campaign = Campaign("dtg_check", "dtg_check", seed=5, bench=bench)
    measure = yardstick(bench, campaign.plan)
    for k in range(len(physical())):
        for name, values in hide(case_of("single", campaign, k), measure).truth.items():
            for c in for_bench(physical()[name], bench).amplitudes if name in physical() else ():
                most = min(hiding.MOST_OF_USUAL * c.usual[1], c.bounds[1])
                assert abs(values[c.name]) <= 1.001 * most, (name, c.name)


def test_sizes_are_proportional_and_agree_with_detection_limits(measure: Yardstick):
    once = measure.size("windage", {"w": 5e-4, "n": 1.48}, 1.0, {})
    assert measure.size("windage", {"w": 1e-3, "n": 1.48}, 1.0, {}) == pytest.approx(2.0 * once, rel=1e-3)
    assert measure.size("windage", {"w": 5e-4, "n": 1.48}, 3.0, {}) < once
    # what another hidden effect can explain is not taken for this one
    beside = {"bearing_viscous": {"b": 5e-6}}
    assert measure.size("windage", {"w": 5e-4, "n": 1.48}, 1.0, beside) < once


def test_the_error_of_a_parameter_is_hidden_in_the_parameter(measure: Yardstick):
    campaign = replace(CAMPAIGN, kinds=("single",))
    for case in cases(campaign, len(physical()) + len(ERRORS)):
        secret = hide(case, measure)
        if "coil_gain_error" in secret.truth:
            error = secret.truth["coil_gain_error"]["relative_error"]
            assert abs(error) > 0.1
            assert secret.scenario.values["coil_constant"] == pytest.approx(0.02 * (1.0 + error))
            return
    pytest.fail("no case hides coil_gain_error")


def test_forms_outside_the_library_are_simulated_but_not_registered(measure: Yardstick):
    names = {form.effect.name for form in outside_forms()}
    assert not names & set(registry())
    secrets = [hide(case_of("outside", ordinal=k), measure) for k in range(len(names))]
    assert {name for s in secrets for name in s.truth} == names
    for secret in secrets:
        own = set(secret.truth) & set(declared())
        assert set(secret.scenario.declared) == (set(declared()) if own else set())


def test_recordings_lose_samples_and_contain_no_truth(tmp_path: Path, measure: Yardstick):
    case = case_of("single", replace(CAMPAIGN, lost=0.05))
    secret = hide(case, measure)
    for part, name in enumerate(("a", "b")):
        hiding.record(case, secret, CAMPAIGN.validation_plan, part, tmp_path / name)
    first, second = (Recording.open(tmp_path / name) for name in ("a", "b"))
    lost = first.integrity().missing / (first.integrity().missing + first.integrity().samples)
    assert lost == pytest.approx(0.05, rel=0.1)
    assert not np.array_equal(first.measurement["sequence"], second.measurement["sequence"])
    content = b"".join(file.read_bytes() for file in (tmp_path / "a").iterdir())
    for word in (*secret.truth, "noise_seed", str(secret.scenario.noise_seed)):
        assert not re.search(rb"\b" + word.encode() + rb"\b", content), word


def test_the_finder_imports_recordings_and_the_model_only():
    folder = Path(hiding.__file__).parent
    tree = ast.parse((folder / "finder.py").read_text(encoding="utf-8"))
    modules = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module}
    modules |= {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    assert {m.split(".")[0] for m in modules} <= {
        "__future__",
        "pathlib",
        "gyrowheel_analysis",
        "gyrowheel_recording",
    }
    (function,) = (n for n in tree.body if isinstance(n, ast.FunctionDef))
    assert [a.arg for a in function.args.args] == ["recording", "unused", "model"]


# ---- judging


def secret_of(**truth: dict[str, float]) -> Secret:
    return Secret(Scenario.nominal(), truth, dict.fromkeys(truth, 3.0))


CROSS = {"c": 5e-3, "n": 2.0}


@pytest.mark.parametrize(
    ("kind", "truth", "answer", "outcome", "right"),
    [
        ("none", {}, diagnosis("nothing_missing"), "exact", True),
        ("none", {}, diagnosis("effect", finding("windage")), "misnamed", False),
        ("none", {}, diagnosis("unknown"), "unknown", False),
        ("single", {"windage": WINDAGE}, diagnosis("effect", finding("windage")), "exact", True),
        ("single", {"windage": WINDAGE}, diagnosis("nothing_missing"), "missed", False),
        ("single", {"windage": WINDAGE}, diagnosis("unknown"), "unknown", False),
        ("single", {"windage": WINDAGE}, diagnosis("effect", finding("aero_cross")), "misnamed", False),
        (
            "single",
            {"windage": WINDAGE},
            diagnosis("ambiguous", finding("bearing_viscous", tie("windage"))),
            "tied",
            True,
        ),
        (
            "single",
            {"windage": WINDAGE},
            diagnosis("ambiguous", finding("bearing_viscous", tie("windage", None))),
            "tied_without_test",
            False,
        ),
        (
            "single",
            {"coil_inductance": {"t_L": 2e-4}},
            diagnosis("ambiguous", instruments=(delay_finding(tie("coil_inductance")),)),
            "tied",
            True,
        ),
        (
            "single",
            {"windage": WINDAGE},
            diagnosis("ambiguous", instruments=(delay_finding(tie("coil_inductance")),)),
            "missed",
            False,
        ),
        (
            "pair",
            {"windage": WINDAGE, "aero_cross": CROSS},
            diagnosis("effect", finding("windage")),
            "partial",
            False,
        ),
        (
            "pair",
            {"windage": WINDAGE, "aero_cross": CROSS},
            diagnosis("effect", finding("windage"), finding("flexure_damping")),
            "misnamed",
            False,
        ),
        (
            "pair",
            {"windage": WINDAGE, "aero_cross": CROSS},
            diagnosis("ambiguous", finding("windage"), finding("flexure_damping", tie("aero_cross"))),
            "tied",
            True,
        ),
        ("outside", {"contact": {"A": 0.01, "p": 0.5}}, diagnosis("unknown"), "unknown", True),
        (
            "outside",
            {"contact": {"A": 0.01, "p": 0.5}},
            diagnosis("effect", finding("cubic_stiffness")),
            "misnamed",
            False,
        ),
    ],
)
def test_judge(kind: str, truth: dict[str, dict[str, float]], answer: Any, outcome: str, right: bool):
    judged = judge(case_of(kind), secret_of(**truth), answer)
    assert (judged.outcome, judged.right) == (outcome, right)
    json.dumps(judged.to_json())


def test_an_effect_below_its_limit_may_be_missed_but_not_misnamed():
    small = replace(secret_of(windage=WINDAGE), sizes={"windage": 1.2})
    assert judge(case_of("single"), small, diagnosis("nothing_missing")).right
    assert not judge(case_of("single"), small, diagnosis("effect", finding("aero_cross"))).right


def test_another_exponent_of_a_library_effect_is_named_right():
    secret = replace(secret_of(steep_windage={"w": 1e-3, "n": 1.55}), resembles=("windage", "n"))
    assert judge(case_of("outside"), secret, diagnosis("effect", finding("windage"))).outcome == "named_right"
    far = replace(secret, truth={"steep_windage": {"w": 1e-3, "n": 2.8}})
    assert judge(case_of("outside"), far, diagnosis("effect", finding("windage"))).outcome == "misnamed"


def test_intervals_are_of_rightly_named_effects():
    judged = judge(case_of("single"), secret_of(windage=WINDAGE), diagnosis("effect", finding("windage")))
    assert {i.name for i in judged.intervals} == {"windage.w", "windage.n"}
    assert judged.parameters
    assert judged.validation == pytest.approx(2.4e-5 / 2e-5)
    wrong = judge(case_of("single"), secret_of(windage=WINDAGE), diagnosis("effect", finding("aero_cross")))
    assert not wrong.intervals
    assert not wrong.parameters


# ---- counting


@settings(deadline=None)
@given(st.integers(1, 200).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_an_interval_contains_its_rate(counts: tuple[int, int]):
    rate = Rate(*counts)
    low, high = rate.interval
    assert 0.0 <= low <= rate.part <= high <= 1.0


def test_known_intervals():
    assert Rate(0, 100).interval == pytest.approx((0.0, 0.0362), abs=1e-4)
    assert Rate(5, 10).interval == pytest.approx((0.1871, 0.8129), abs=1e-4)
    assert math.isnan(Rate(0, 0).part)


def test_coverage_counts_intervals_that_contain_the_truth():
    rng = np.random.default_rng(3)
    sample = [Interval("x", float(v), 2.0, 5.0) for v in 5.0 + 2.0 * rng.standard_normal(4000)]
    for level in (0.5, 0.95):
        assert covered(sample, level).part == pytest.approx(level, abs=0.03)


def test_counts_of_the_summary():
    done = [
        judged_case(0, "none"),
        judged_case(1, "none", "misnamed", named=["windage"], verdict="effect"),
        judged_case(2, validation=1.1),
        judged_case(3, validation=1.3),
        judged_case(4, outcome="tied", named=["bearing_viscous"]),
        judged_case(5, outcome="misnamed", named=["aero_cross"]),
        judged_case(6, outcome="missed", detectable=False),
        judged_case(7, "outside", "unknown", validation=1.4),
        judged_case(8, "outside", "misnamed", named=["windage"]),
        judged_case(9, "pair", "partial"),
        judged_case(10, outcome="failed", error="ValueError: no"),
    ]
    summary = Summary.counted(5, 20, reversed(done))
    content = summary.to_json()
    assert content["cases"] == 11
    assert content["none"] == {"n": 2, "false_alarms": 1}
    single = content["single"]
    assert (single["n"], single["detectable"], single["exact"], single["tied"], single["wrong"]) == (
        6,
        5,
        2,
        1,
        2,
    )
    assert single["below"] == {"missed": 1}
    assert content["pair"]["wrong"] == 1
    outside = content["outside"]
    assert (outside["n"], outside["unknown"], outside["named_right"], outside["absorbed"]) == (2, 1, 0, 1)
    assert content["validated"] == {"n": 2, "within_1p2_floor": 1}
    assert content["median_seconds"] == 2.0
    assert content["confusion"]["windage"]["windage"] == 3
    assert content["confusion"]["none"] == {"nothing_missing": 1, "windage": 1}
    assert content["failed"] == [10]
    assert content["not_right"] == [1, 5, 8, 9, 10]


@pytest.mark.parametrize("width", [80, 110])
def test_the_page_fits_the_width_and_lists_every_wrong_answer(width: int):
    from rich.console import Console

    done = [
        judged_case(k, validation=1.0, intervals=[Interval("windage.w", 1.0, 0.1, 1.05)]) for k in range(5)
    ]
    done += [judged_case(5, outcome="misnamed", named=["flexure_hysteresis"], ties=[("windage_tilt", None)])]
    done += [judged_case(6, "none"), judged_case(7, "outside", "missed")]
    console = Console(width=width, highlight=False, color_system=None)
    with console.capture() as capture:
        show(console, campaign_page(Summary.counted(5, 9, done, "8 blind cases")))
    shown = capture.get()
    assert all(len(line) <= width for line in shown.splitlines())
    assert "interrupted: 8 of 9 cases" in shown
    assert "flexure_hysteresis or windage_tilt" in shown
    assert "…" not in shown
    assert case_line(done[5]) == "case 5: hidden windage (3.0); answered flexure_hysteresis or windage_tilt"
    with console.capture() as capture:
        show(console, campaign_page(Summary.counted(5, 9, [], "nothing done")))
    assert "0 of 9" in capture.get()


def test_the_report_has_the_numbers_of_the_json():
    done = [
        judged_case(k, validation=1.0, intervals=[Interval("windage.w", 1.0, 0.1, 1.05)]) for k in range(5)
    ]
    done += [judged_case(5, outcome="misnamed", named=["flexure_hysteresis"], ties=[("<b>windage", None)])]
    done += [judged_case(6, "none"), judged_case(7, "outside", "missed")]
    result = Summary.counted(5, 9, done, "8 blind cases <i>")
    page = Page(campaign_report(result, "gyrowheel campaign --plan <b>quick"))
    assert check_numbers(page) > 15
    assert page.content["campaign"] == json.loads(json_text(result.to_json()))
    assert [case["case"] for case in page.content["cases"]] == list(range(8))
    assert not [e for e in page.elements if e.tag in ("i", "b")]  # what is written there is text
    assert "flexure_hysteresis or <b>windage" in page.text.replace("&lt;", "<").replace("&gt;", ">")
    assert "nothing done" in campaign_report(Summary.counted(5, 9, [], "nothing done"), "")


# ---- the work


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Judged]]:
    """Two cases done in this process, everything kept."""
    folder = tmp_path_factory.mktemp("campaign")
    with workers.finished(functools.partial(run_case, str(folder)), cases(CAMPAIGN, 2), jobs=1) as results:
        return folder, list(results)


def timeless(done: list[Judged]) -> list[dict[str, Any]]:
    return [{**c.to_json(), "seconds": 0.0} for c in sorted(done, key=lambda c: c.index)]


@pytest.mark.slow
@pytest.mark.study  # the cluster below changes nothing either, and the verb's own test runs processes
def test_several_processes_give_the_same_cases(alone: tuple[Path, list[Judged]]):
    with workers.finished(functools.partial(run_case, None), cases(CAMPAIGN, 2), jobs=2) as results:
        assert timeless(list(results)) == timeless(alone[1])


@pytest.mark.study  # starts a cluster of Dask
@pytest.mark.slow
def test_a_cluster_gives_the_same_cases(alone: tuple[Path, list[Judged]]):
    distributed = pytest.importorskip("dask.distributed")
    options = {"host": "127.0.0.1", "dashboard_address": None, "protocol": "tcp", "threads_per_worker": 1}
    with (
        distributed.LocalCluster(n_workers=1, **options) as cluster,
        workers.finished(
            functools.partial(run_case, None), cases(CAMPAIGN, 1), jobs=1, dask=cluster.scheduler_address
        ) as results,
    ):
        assert timeless(list(results)) == timeless(alone[1][:1])


def test_a_missing_cluster_is_named(monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("dask.distributed")
    monkeypatch.setattr(workers, "_CONNECT", 0.5)
    with (
        pytest.raises(InputError, match=r"dask: no scheduler answers at tcp://127\.0\.0\.1:9"),
        workers.finished(
            functools.partial(run_case, None), cases(CAMPAIGN, 2), jobs=1, dask="tcp://127.0.0.1:9"
        ),
    ):
        pass


def test_a_failed_diagnosis_is_a_wrong_case(monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object) -> None:
        raise np.linalg.LinAlgError("singular matrix")

    monkeypatch.setattr("gyrowheel.campaigns.api.find", fail)
    judged = run_case(None, case_of("none"))
    assert (judged.outcome, judged.error, judged.right) == ("failed", "LinAlgError: singular matrix", False)


def test_lack_of_memory_ends_the_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The campaign ends, and can go on; the case is not counted as one in which the finder failed."""

    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("gyrowheel.campaigns.api.record", lambda *_: None)
    monkeypatch.setattr("gyrowheel.campaigns.api.find", fail)
    with pytest.raises(MemoryError):
        run_case(None, case_of("none"), scratch=str(tmp_path))
    assert not list(tmp_path.iterdir())


def test_a_killed_worker_is_reported_in_one_line():
    killed = pytest.importorskip("joblib.externals.loky.process_executor").TerminatedWorkerError
    with pytest.raises(InputError, match="jobs: a worker was killed"), workers._told():
        raise killed("a worker process was terminated")


def test_the_folder_of_a_case_appears_complete(tmp_path: Path):
    """In the place of what an interrupted campaign has kept of it; nothing is beside it."""
    made, kept = tmp_path / "made", tmp_path / "kept" / "case-0001"
    for folder, name in ((made, "new"), (kept, "old")):
        folder.mkdir(parents=True)
        (folder / name).write_text(name)
    _move(made, kept)
    assert [place.name for place in kept.iterdir()] == ["new"]
    assert [place.name for place in kept.parent.iterdir()] == ["case-0001"]


# ---- the verb

COUNTS = ("n", "detectable", "exact", "tied", "wrong")


@pytest.mark.slow
def test_the_verb_reports_keeps_the_json_contract_and_complete_cases(gyrowheel: Shell, tmp_path: Path):
    plan, other = write(tmp_path / "plan.yaml", DRAG_PLAN), write(tmp_path / "other.yaml", OTHER_PLAN)
    arguments = ["campaign", "--plan", plan, "--validation-plan", other, "--cases", 40, "--jobs", 1]
    arguments += [
        "--only",
        1,
        "--only",
        4,
        "--seed",
        5,
        "--list",
        tmp_path / "list.json",
        "-o",
        tmp_path / "kept",
        "--keep",
        tmp_path / "cases",
    ]
    shown = gyrowheel.good(*arguments, "--json", tmp_path / "out.json")
    assert "2 blind cases of plan drag, seed 5" in shown.out
    assert "false alarms: 0 of 1" in shown.out
    content = json.loads((tmp_path / "out.json").read_text(), parse_constant=pytest.fail)
    assert content["schema"] == 1
    assert (content["seed"], content["cases"]) == (5, 2)
    assert set(content["none"]) == {"n", "false_alarms"}
    assert set(content["single"]) >= set(COUNTS)
    assert set(content["pair"]) >= set(COUNTS)
    assert set(content["outside"]) >= {"n", "unknown", "named_right", "absorbed"}
    assert set(content["validated"]) == {"n", "within_1p2_floor"}
    assert set(content) >= {"coverage95", "median_seconds", "confusion"}
    listed = json.loads((tmp_path / "list.json").read_text())
    assert [c["case"] for c in listed] == [1, 4]
    for case in listed:
        kept = tmp_path / "cases" / f"case-{case['case']:04d}"
        assert {p.name for p in kept.iterdir()} == {"recording", "unused", "diagnosis.json", "key.json"}
        assert json.loads((kept / "key.json").read_text())["effects"] == case["truth"]
        assert json.loads((kept / "diagnosis.json").read_text())["verdict"] == case["verdict"]
        assert case["outcome"] != "failed", case["error"]
        assert case["validation"] is not None
    assert f"report: {tmp_path / 'kept' / 'report.html'}" in shown.err
    page = Page((tmp_path / "kept" / "report.html").read_text(encoding="utf-8"))
    assert page.content["campaign"] == content


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--plan", "quik"], ["quik", "quick"]),
        (["--kinds", "none,duble"], ["kinds", "duble", "allowed: none, single"]),
        (["--cases", "0"], ["cases: 0"]),
        (["--cases", "5", "--only", "5"], ["only: 5", "0 .. 4"]),
        (["--jobs", "0", "--plan", "quick"], ["jobs: 0"]),
        (["--lost", "1"], ["lost: 1"]),
        (["--keep", "file"], ["file"]),
    ],
)
def test_bad_input_is_one_line(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: list[str]
):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "file", "")
    result = gyrowheel("campaign", *arguments)
    assert result.code == 2
    assert result.out == ""
    assert all(word in result.err.splitlines()[-1] for word in words), result.err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_case_contains_plans_and_bench():
    # a worker elsewhere has none of the files
    text = Bench.load().describe()
    case = case_of("single")
    assert Plan.load(case.campaign.plan).name == "drag"
    assert case.campaign.bench.describe() == text
