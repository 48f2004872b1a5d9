"""Investigations: which test comes next, when it ends, and what is kept."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gyrowheel.investigation import procedure as investigation
from gyrowheel.investigation.page import end_sentence
from gyrowheel.investigation.procedure import BROAD, Course, Step, learned, pursue
from gyrowheel_analysis.diagnosis.estimates import Estimate
from gyrowheel_analysis.diagnosis.experiment_design import Discrimination, PrecisionTest, relative_error
from gyrowheel_analysis.diagnosis.findings import NextTest, TieReport
from gyrowheel_analysis.diagnosis.result import Diagnosis
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError

from .conftest import Wheel
from .findings import AMBIGUOUS, UNKNOWN, diagnosis, finding, tie
from .helpers import DRAG_PLAN, Shell, write
from .pages import Page, check_numbers


class Silent:
    """A listener that keeps what it is told."""

    def __init__(self) -> None:
        self.begun: list[tuple[list[str], str]] = []
        self.steps: list[Step] = []

    def begin(self, number: int, plans: Sequence[str], why: str) -> None:
        self.begun.append((list(plans), why))

    @contextlib.contextmanager
    def working(self, title: str) -> Iterator[Callable[[str], None]]:
        yield lambda text: None

    @contextlib.contextmanager
    def advancing(self, title: str) -> Iterator[Callable[[float], None]]:
        yield lambda part: None

    def learned(self, step: Step) -> None:
        self.steps.append(step)


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., tuple[Course, Silent]]:
    """Return a function that investigates a machine whose diagnoses are given."""

    def go(
        answers: Sequence[Diagnosis], *, sharper: Any = None, plain: Diagnosis = NOTHING, **options: Any
    ) -> tuple[Course, Silent]:
        left = list(answers)
        monkeypatch.setattr("gyrowheel_recording.bags.Recording.open", lambda path: path)

        def diagnose(*_: Any, averages: bool = False, **__: Any) -> Diagnosis:
            # a look at averages alone, beside that at everything, is for the explanation
            return plain if averages and not begun.averages else left.pop(0)

        monkeypatch.setattr("gyrowheel_analysis.diagnosis.diagnose.diagnose", diagnose)
        monkeypatch.setattr(
            "gyrowheel_analysis.diagnosis.experiment_design.precision_test", lambda *_, **__: sharper
        )
        budget, averages = options.pop("budget", 15.0), options.pop("averages", False)
        begun, listener = Course("m.yaml", budget, averages=averages), Silent()
        plans = [Plan.load(name) for name in options.pop("plans", ["check"])]
        run = options.pop("run", lambda plan, path, number: path.mkdir(exist_ok=True))
        *_, done = pursue(begun, Model.new(), tmp_path, run, listener, plans=plans, **options)
        return done, listener

    return go


PRECISE = diagnosis("effect", finding("aero_cross"))
NOTHING = diagnosis("nothing_missing")
SEPARATING = replace(
    AMBIGUOUS, next_test=NextTest("air_density", 88.0, 1.2, separates=("aero_cross", "flexure_damping"))
)


def test_a_tie_is_settled_by_the_test_that_was_named(scripted: Any, tmp_path: Path):
    done, listener = scripted([SEPARATING, PRECISE])
    assert done.settled
    assert [list(step.plans) for step in done.steps] == [["check"], ["air_density"]]
    assert listener.begun[1] == (["air_density"], "separates aero_cross from flexure_damping")
    assert "flexure_damping would explain it as well" in done.steps[0].learned[0]
    assert done.steps[1].learned[-1] == "flexure_damping is ruled out."
    assert [path.name for path in done.recordings] == ["1-check", "2-air_density"]
    content = json.loads((tmp_path / "investigation.json").read_text())
    assert content["settled"] is True
    assert content["named"] == ["aero_cross"]
    assert [step["verdict"] for step in content["steps"]] == ["ambiguous", "effect"]
    assert [step["verdict_before"] for step in content["steps"]] == [None, "ambiguous"]
    assert [step["separated"] for step in content["steps"]] == [[], ["flexure_damping"]]
    left = [step["minutes_left"] for step in content["steps"]]
    assert left[-1] == pytest.approx(content["budget_minutes"] - content["minutes"])
    assert left[0] == pytest.approx(left[1] + content["steps"][1]["minutes"])
    assert "Settled after 1 min" in end_sentence(done)


def test_no_test_is_run_a_third_time(scripted: Any):
    done, _ = scripted([SEPARATING] * 3)
    assert not done.settled
    assert "run 2 times and have not" in done.reason
    assert [list(step.plans) for step in done.steps] == [["check"], ["air_density"], ["air_density"]]


def test_a_tie_without_a_separating_test_ends_unsettled(scripted: Any):
    stuck = diagnosis("ambiguous", finding("aero_cross", tie("flexure_damping", None)))
    done, _ = scripted([stuck])
    assert (done.settled, done.reason) == (False, "no test on this bench separates what is left")


def test_too_little_data_asks_for_more(scripted: Any):
    done, _ = scripted([diagnosis("insufficient_data"), NOTHING])
    assert [list(step.plans) for step in done.steps] == [["check"], [BROAD]]
    assert done.settled


def test_an_unknown_effect_leads_to_one_run_of_the_broad_plan(scripted: Any):
    done, _ = scripted([UNKNOWN, UNKNOWN])
    assert [list(step.plans) for step in done.steps] == [["check"], [BROAD]]
    assert done.settled
    assert "Proposed formula: rotor_torque = a*z^2" in done.steps[-1].learned[0]


def test_formulas_that_describe_the_same_lead_to_the_test_that_separates_them(scripted: Any):
    (form,) = UNKNOWN.free_form
    tied = replace(
        UNKNOWN,
        free_form=(
            replace(form, name="bump", ties=(TieReport("power", "", 3.0, "cone", 40.0, 0.5, form=form),)),
        ),
        next_test=NextTest("cone", 40.0, 0.5, separates=("bump", "power")),
    )
    done, listener = scripted([tied, tied, UNKNOWN])
    assert listener.begun[2] == (["cone"], "separates bump from power")
    assert done.settled
    done, _ = scripted([tied] * 4)
    assert [list(step.plans) for step in done.steps] == [["check"], [BROAD], ["cone"], ["cone"]]
    assert not done.settled
    assert "the tests do not separate the formulas" in done.reason


def test_an_uncertain_coefficient_leads_to_a_precision_test(scripted: Any):
    sharper = PrecisionTest("aero_cross", "cone", 0.25, 0.06, 0.55)
    done, listener = scripted([PRECISE, PRECISE, PRECISE], sharper=sharper)
    assert listener.begun[1] == (["cone"], "knows aero_cross to 6 % instead of 25 %")
    assert [list(step.plans) for step in done.steps] == [["check"], ["cone"], ["cone"]]
    assert done.settled


def test_thorough_continues_with_undetectable_effects(scripted: Any):
    more = replace(NOTHING, next_test=NextTest("inverted", 60.0, 0.7, reveals="gravity_offset"))
    assert len(scripted([more])[0].steps) == 1
    done, _ = scripted([more, NOTHING], thorough=True, plans=["quick"])
    assert [list(step.plans) for step in done.steps] == [["quick"], ["inverted"]]


def test_the_budget_is_kept(scripted: Any):
    done, _ = scripted([SEPARATING], budget=0.6)
    assert not done.settled
    assert "the time is spent: plan air_density" in done.reason
    assert done.minutes < 0.6
    with pytest.raises(InputError, match=r"budget: 0\.1 min is too short; the first plans take 0\.4 min"):
        scripted([SEPARATING], budget=0.1)
    with pytest.raises(InputError, match="no plan and no recording"):
        scripted([SEPARATING], plans=[])


def test_finished_steps_survive_an_interruption(scripted: Any, tmp_path: Path):
    def run(plan: Plan, path: Path, number: int) -> None:
        if number == 2:
            raise KeyboardInterrupt
        path.mkdir()

    with pytest.raises(KeyboardInterrupt):
        scripted([SEPARATING], run=run)
    content = json.loads((tmp_path / "investigation.json").read_text())
    assert [step["plans"] for step in content["steps"]] == [["check"]]
    assert (tmp_path / "1-check").is_dir()


def test_runs_are_numbered_after_existing_recordings(scripted: Any, tmp_path: Path):
    """What goes on from an earlier investigation must not run a plan with the noise of the first time."""
    at_hand = [tmp_path / "old" / "1-check", tmp_path / "old" / "2-air_density"]
    done, _ = scripted([SEPARATING, PRECISE], plans=[], at_hand=at_hand)
    assert [path.name for path in done.recordings] == ["3-air_density"]


def test_a_tie_of_averages_is_explained(scripted: Any, monkeypatch: pytest.MonkeyPatch):
    told = [Discrimination("tilt_2n", "the torque of the coils twice a revolution", 1990.0)]
    asked: list[tuple[str, str]] = []

    def telling(_recordings: Any, _model: Any, name: str, rival: str) -> list[Discrimination]:
        asked.append((name, rival))
        return told

    monkeypatch.setattr("gyrowheel_analysis.diagnosis.experiment_design.discriminating_channels", telling)
    done, _ = scripted([PRECISE], plain=SEPARATING)
    assert asked == [("aero_cross", "flexure_damping")]
    (said,) = (text for text in done.steps[0].learned if "Averages" in text)
    assert "would not separate aero_cross from flexure_damping" in said
    assert "the torque of the coils twice a revolution does (Δχ² 1990 against flexure_damping)" in said
    # where averages lead elsewhere, or tell as well, there is nothing to explain
    assert len(scripted([PRECISE], plain=PRECISE)[0].steps[0].learned) == 1
    assert (
        len(scripted([PRECISE], plain=diagnosis("ambiguous", finding("windage", tie("eddy_drag"))))[0].steps)
        == 1
    )
    # nor where one looks at averages alone
    assert len(scripted([PRECISE], averages=True)[0].steps[0].learned) == 1


def test_every_verdict_has_one_or_two_sentences():
    for found in (PRECISE, NOTHING, SEPARATING, UNKNOWN, diagnosis("insufficient_data")):
        sentences = learned(found, [])
        assert 1 <= len(sentences) <= 2
        assert all(text.endswith(".") and text[0].isupper() for text in sentences)


def test_the_error_of_a_finding_is_that_of_its_best_amplitude():
    both = finding("fixed_torque")
    both.coefficients.update(F_x=Estimate(1e-3, 1e-4, "N*m"), F_y=Estimate(1e-5, 1e-4, "N*m"))
    assert relative_error(both) == pytest.approx(0.1)
    # an exponent says nothing about the size
    air = finding("aero_cross")
    air.coefficients.update(c=Estimate(5e-3, 2.5e-3, "N*m/rad"), n=Estimate(2.0, 0.01, "1"))
    assert relative_error(air) == pytest.approx(0.5)


# ---- the verb

_GIMBAL = {"gimbal_inertia_x": 8e-6, "gimbal_inertia_y": 8e-6, "gimbal_inertia_z": 1.4e-5}
#: Beyond what the gimbal's stated uncertainty of a tenth explains: averages cannot find a smaller torque of the air. A
#: lighter gimbal is what the air is taken for; a heavier one would need an air that pushes the rotor away.
SECRETS = {
    "gimbal_inertia_error": {
        "values": {name: 0.35 * value for name, value in _GIMBAL.items()},
        "effects": {},
    },
    "aero_restoring": {"values": {}, "effects": {"aero_restoring": {"k": 0.09, "n": 2.02}}},
}


def settle(gyrowheel: Shell, tmp_path: Path, *arguments: object) -> Any:
    model = tmp_path / "model.yaml"
    gyrowheel.good("model", "new", "--model", model)
    before = model.read_bytes()
    options = ["--model", model, "--simulate", "-o", tmp_path / "run", "--json", "-", *arguments]
    result = gyrowheel.good("investigate", *options).json
    assert model.read_bytes() == before
    assert result == json.loads((tmp_path / "run" / "investigation.json").read_text())
    # it ends with a report, whose numbers are these
    page = Page((tmp_path / "run" / "report.html").read_text(encoding="utf-8"))
    assert check_numbers(page) > 50
    assert page.content["diagnosis"] == result["diagnosis"]
    assert page.content["investigation"] == {k: v for k, v in result.items() if k != "diagnosis"}
    assert "Step by step" in [e.text for e in page.elements if e.tag == "h2"]
    return result


@pytest.mark.study  # the next one tells these plans apart, the first ones how a tie is settled
@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["aero_restoring"])  # the other one is settled on the graph, by a study
def test_plans_of_the_paper_with_averages_are_ambiguous_until_a_test(
    gyrowheel: Shell, tmp_path: Path, hidden: str
):
    """At the exponent of the air the two are the same at every tilt and speed: only a change of the air tells."""
    write(tmp_path / "key.json", json.dumps(SECRETS[hidden]))
    plans = ["--plan", "paper_tilt", "--plan", "paper_speed", "--averages"]
    result = settle(gyrowheel, tmp_path, *plans, "--blind", tmp_path / "key.json")
    first, *others = result["steps"]
    (open_,) = first["effects"]
    assert first["verdict"] == "ambiguous"
    assert {open_["name"], *open_["ties"]} >= {"gimbal_inertia_error", "aero_restoring"}
    assert others[0]["plans"] == ["air_density"]
    assert result["settled"] is True
    assert result["named"] == [hidden]
    separated = {name for step in others for name in step["separated"]}
    assert {"gimbal_inertia_error", "aero_restoring"} - {hidden} <= separated


@pytest.mark.slow
@pytest.mark.parametrize(
    "hidden",
    [pytest.param(name, marks=pytest.mark.study) for name in ("gimbal_inertia_error", "aero_restoring")],
)
def test_harmonics_settle_the_plans_of_the_paper_at_once(gyrowheel: Shell, tmp_path: Path, hidden: str):
    write(tmp_path / "key.json", json.dumps(SECRETS[hidden]))
    plans = ["--plan", "paper_tilt", "--plan", "paper_speed"]
    result = settle(gyrowheel, tmp_path, *plans, "--blind", tmp_path / "key.json")
    assert result["settled"] is True
    assert result["named"] == [hidden]
    (first,) = result["steps"]
    assert first["plans"] == ["paper_tilt", "paper_speed"]
    # and it is said why: the gimbal's inertia makes a torque twice a revolution, the air none
    other = "aero_restoring" if hidden == "gimbal_inertia_error" else "gimbal_inertia_error"
    (why,) = (text for text in first["learned"] if "Averages" in text)
    assert "the torque of the coils twice a revolution does" in why
    assert other in why


@pytest.mark.study
def test_tilt_sweep_of_the_paper_is_ambiguous_until_a_test(gyrowheel: Shell, tmp_path: Path):
    """At one speed a restoring torque acts as a stiffness does, and as an offset of the centre of gravity."""
    hidden = ["--effect", "aero_restoring:k=0.04", "--machine", "5"]
    result = settle(gyrowheel, tmp_path, "--plan", "paper_tilt", "--budget", "6", *hidden)
    first, *others = result["steps"]
    (open_,) = first["effects"]
    assert first["verdict"] == "ambiguous"
    assert {open_["name"], *open_["ties"]} >= {"aero_restoring", "stiffness_error", "gravity_offset"}
    assert others
    assert result["settled"] is True
    assert result["named"] == ["aero_restoring"]
    assert result["minutes"] <= 6.0


@pytest.mark.study
def test_existing_recordings_are_diagnosed_first(gyrowheel: Shell, wheel: Wheel, tmp_path: Path):
    arguments = [wheel.recording, "--effect", "windage:w=0.0013", "--budget", 0]
    result = settle(gyrowheel, tmp_path, *arguments)
    assert result["steps"][0]["plans"] == []
    assert result["named"] == ["windage"]
    assert result["minutes"] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--budget", "0.1"], ["budget: 0.1"]),
        (["--budget", "-1"], ["--budget"]),
        (["--plan", "quik"], ["quik", "quick"]),
        (["--effect", "windge"], ["windge", "windage"]),
        (["--effect", "windage", "--blind", "key.json"], ["blind"]),
        (["nowhere"], ["nowhere"]),
        (["-o", "full"], ["full", "exists"]),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: list[str]
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    write(tmp_path / "full" / "file", "")
    gyrowheel.good("model", "new", "--model", "m.yaml")
    result = gyrowheel("investigate", "--model", "m.yaml", "--simulate", *arguments)
    assert result.code == 2
    assert result.out == ""
    (line,) = result.err.splitlines()
    assert all(word in line for word in words), line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full", "m.yaml"]


def test_ctrl_c_keeps_the_recordings(gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    plan = write(tmp_path / "plan.yaml", DRAG_PLAN)
    gyrowheel.good("model", "new", "--model", tmp_path / "m.yaml")
    monkeypatch.setattr("gyrowheel_analysis.diagnosis.diagnose.diagnose", interrupted)
    arguments = ["--model", tmp_path / "m.yaml", "--simulate", "--plan", plan, "-o", tmp_path / "run"]
    result = gyrowheel("investigate", *arguments)
    assert result.code == 130
    assert "interrupted" in result.out
    assert (tmp_path / "run" / "1-drag" / "metadata.yaml").exists()


def test_the_procedure_does_not_import_the_machine():
    source = Path(investigation.__file__).read_text(encoding="utf-8")
    for word in ("scenario", "blind", "gyrowheel_sim.plant.machine", "closed_loop"):
        assert word not in source
