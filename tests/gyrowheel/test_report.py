"""The report: its numbers are those of the diagnosis, it needs nothing but itself, and nothing in it runs."""

from __future__ import annotations

import base64
import getpass
import hashlib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import gyrowheel as gw
from gyrowheel.diagnosis.api import Diagnosis
from gyrowheel.report import api
from gyrowheel.report import page as report_page
from gyrowheel.report.decision import decision
from gyrowheel.report.page import Picture
from gyrowheel.report.sections import error_rows
from gyrowheel.report.verb import _is_report
from gyrowheel.show.html import Cells
from gyrowheel_analysis.diagnosis.findings import TieReport
from gyrowheel_analysis.reduction.instrument_readings import ReadingFinding
from gyrowheel_analysis.reduction.windows import Coverage

from .conftest import Wheel
from .findings import diagnosis, finding
from .helpers import Shell, write
from .pages import Page, check_numbers


@pytest.fixture(scope="module")
def made(wheel: Wheel) -> gw.Report:
    return gw.Report.of(wheel.recording, gw.Model.load(wheel.model), validate=wheel.other)


@pytest.fixture(scope="module")
def page(made: gw.Report) -> Page:
    return Page(made.html())


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what takes the time of a page: the drawing of its pictures, not their titles."""
    monkeypatch.setattr(report_page, "picture", lambda _, title: Picture("data:image/svg+xml;base64,", title))


@pytest.mark.slow
def test_every_number_agrees_with_the_diagnosis(gyrowheel: Shell, wheel: Wheel, page: Page) -> None:
    asked = ("diagnose", wheel.recording, "--model", wheel.model, "--validate", wheel.other, "--json", "-")
    assert page.content["diagnosis"] == gyrowheel.good(*asked).json
    assert check_numbers(page) > 100
    # what was found is there in numbers
    marks = [e.attributes.get("data-field", "") for e in page.elements]
    for name in (
        "effects.0.coefficients.w.value",
        "error.validation_after.chi2_per_n",
        "where.0.share_of_chi2",
    ):
        assert f"diagnosis.{name}" in marks


def test_the_check_sees_a_wrong_number(page: Page) -> None:
    text = page.text
    mark = re.search(r'data-field="diagnosis.effects.0.coefficients.w.value"[^>]*>([0-9.]+)<', text)
    assert mark is not None
    start, end = mark.span(1)
    wrong = f"{float(mark[1]) * 1.01:.{len(mark[1].partition('.')[2])}f}"
    with pytest.raises(AssertionError):
        check_numbers(Page(text[:start] + wrong + text[end:]))


def test_sections_begin_with_the_result_and_end_with_sources(made: gw.Report, page: Page) -> None:
    (headline,) = [e for e in page.elements if e.tag == "h1"]
    assert headline.text == made.diagnosis.sentence
    order = [
        e.attributes["id"] for e in page.elements if e.tag in ("header", "section") and "id" in e.attributes
    ]
    assert order == [
        "result",
        "missing",
        "error",
        "where",
        "limits",
        "symbols",
        "model",
        "recordings",
        "repeat",
    ]


def test_page_one_has_what_was_found_how_sure_what_it_means_and_what_to_do(
    made: gw.Report, page: Page
) -> None:
    lines = {
        part["asked"]: " ".join(map(str, part["lines"])) for part in decision(made, Cells(made.to_dict()))
    }
    assert list(lines) == ["What was found", "How sure", "What it means", "What to do"]
    assert ": w = " in lines["What was found"]
    assert "No other known effect" in lines["How sure"]
    # the error of the motor's torque, as power at the fastest spin
    error = made.diagnosis.error
    assert error is not None
    power = error.before.rms["spin"] * made.fitted[0].info.spin_rate[1]
    assert f"rpm that is {power:.3g} W" in lines["What it means"]
    assert lines["What to do"].startswith("Add windage to the model")
    text = next(e for e in page.elements if e.attributes.get("id") == "result").text
    for said in ("What was found", "How sure", "Consistent with other", "What it means", "What to do"):
        assert said in text
    assert "the model predicts the data of “other”, which were not used to fit, to within the noise" in text
    # nothing failed, or a tie: no finding is to be added
    nothing = replace(made, diagnosis=Diagnosis.of(diagnosis("nothing_missing")))
    assert "use the model as it is" in str(decision(nothing, Cells(nothing.to_dict()))[3]["lines"])
    tie = TieReport("eddy_drag", "", 2.0, "survey", 30.0, 3.0)
    tied = replace(made, diagnosis=Diagnosis.of(diagnosis("ambiguous", finding("windage", tie))))
    lines = {
        part["asked"]: " ".join(map(str, part["lines"])) for part in decision(tied, Cells(tied.to_dict()))
    }
    assert "cannot tell windage from eddy_drag" in lines["How sure"]
    assert "Add windage" not in lines["What to do"]


def test_tables_and_figures_are_numbered_and_symbols_and_provenance_are_there(page: Page) -> None:
    tables = [e for e in page.elements if e.tag == "table"]
    captions = [e.text for e in page.elements if e.tag == "caption"]
    assert len(captions) == len(tables) == len(set(captions))
    about = next(e for e in page.elements if e.attributes.get("id") == "symbols").text
    assert "spin rate" in about  # of the law of windage
    assert page.content["made_by"] == getpass.getuser()
    assert page.content["model"]["sha256"] in page.text


def test_an_error_that_did_not_fall_is_not_shown_as_a_success(made: gw.Report) -> None:
    rows = error_rows(Cells(made.to_dict()), "diagnosis.error")
    assert rows is not None
    moods = {row["name"]: row["parts"][0]["mood"] for row in rows["rows"]}
    assert moods["spin"] == "good"
    assert moods["tilt 1N"] == ""  # at its noise before and after


def test_the_page_is_self_contained(made: gw.Report, page: Page) -> None:
    assert len(page.text.encode()) < 5e6
    for element in page.elements:
        for name in ("src", "href"):
            assert element.attributes.get(name, "#").startswith(("#", "data:image/")), element
        assert not any(name.startswith("on") for name in element.attributes)
    kinds = [e.attributes.get("type", "") for e in page.elements if e.tag == "script"]
    assert kinds == ["application/json", "application/json", ""]
    # it may run the one script that draws the signals, and nothing else
    (script,) = (e for e in page.elements if e.tag == "script" and "type" not in e.attributes)
    digest = base64.b64encode(hashlib.sha256(script.text.encode()).digest()).decode()
    policy = next(e for e in page.elements if e.attributes.get("http-equiv") == "Content-Security-Policy")
    assert policy.attributes["content"].startswith("default-src 'none'")
    assert policy.attributes["content"].endswith(f"script-src 'sha256-{digest}'")
    assert all(e.attributes["alt"] for e in page.elements if e.tag == "img")


def test_charts_have_the_samples_of_the_recording(wheel: Wheel, page: Page) -> None:
    (own,) = (e for e in page.elements if e.attributes.get("id") == "charts")
    chart = json.loads(own.text)["recordings.0"]
    samples = gw.Recording.open(wheel.recording)
    tilt = np.frombuffer(base64.b64decode(chart["panels"][0]["lines"][0]["values"]), "<f4")
    time = np.frombuffer(base64.b64decode(chart["time"]), "<f4")
    assert len(tilt) == len(time) <= 4000
    assert chart["pairs"] is True
    assert tilt.max() == pytest.approx(np.degrees(samples.measurement["tilt_x"]).max())  # nothing is lost
    assert time[-1] == pytest.approx(samples.duration, rel=1e-2)
    shown = {e.attributes["data-chart"] for e in page.elements if "data-chart" in e.attributes}
    assert shown == set(json.loads(own.text))


def test_recordings_have_hashes_and_the_commands_repeat_the_result(
    gyrowheel: Shell, wheel: Wheel, page: Page
) -> None:
    (storage,) = wheel.recording.glob("*.mcap")
    assert hashlib.sha256(storage.read_bytes()).hexdigest() in page.text
    (command,) = page.content["commands"]
    assert command == f"gyrowheel diagnose {wheel.recording} --model {wheel.model} --validate {wheel.other}"
    assert page.content["next"].startswith("gyrowheel model add windage")
    assert [own["role"] for own in page.content["recordings"]] == ["fitted", "not used to fit"]


@pytest.mark.usefixtures("undrawn")
def test_text_of_a_user_is_escaped(wheel: Wheel, made: gw.Report, tmp_path: Path) -> None:
    evil = "``` </script><script>alert(1)</script>\"'><img src=x onerror=alert(1)>"
    content = yaml.safe_load(wheel.model.read_text(encoding="utf-8"))
    content["history"] = [
        {"time": "2026-01-01T00:00:00+00:00", "what": evil, "fit": [evil], "error": {"before": 1}}
    ]
    model = gw.Model.load(write(tmp_path / "<b>wheel.yaml", yaml.safe_dump(content)))
    place = tmp_path / "<img src=x onerror=alert(1)>"
    shutil.copytree(wheel.recording, place)
    report = replace(
        made,
        model=model,
        fitted=(gw.Recording.open(place),),
        unused=(),
        comparison=None,
        commands=(evil,),
        next_command=evil,
    )
    page = Page(report.html())
    assert len([e for e in page.elements if e.tag == "script"]) == 3
    assert page.content["commands"] == [evil]
    assert place.name in "".join(text for text, _ in page.pieces)
    assert evil in "".join(text for text, _ in page.pieces)
    outside = re.sub(r"^(`{3,})\n.*?^\1$", "", report.markdown(), flags=re.MULTILINE | re.DOTALL)
    assert "Versions" in outside
    assert "<img" not in outside


@pytest.mark.usefixtures("undrawn")
def test_coverage_and_properties_of_readings_are_on_the_page(made: gw.Report) -> None:
    clock = ReadingFinding("clock_rate", "clock", "rate_error", 2e-5, 1e-6, 0.0, "1", 400.0, "drag")
    part = Coverage(60.0, 30.0, {"of a kind": 10.0}, ("air_pressure: that of the bench",))
    details = replace(made.diagnosis, readings=(clock,), coverage=part)
    page = Page(replace(made, diagnosis=details).html())
    assert check_numbers(page) > 100
    said = "".join(text for text, _ in page.pieces)
    assert "ppm fast against the count of the samples" in said
    assert "30 of 40 s of steady motion take part" in said
    assert "not measured: air_pressure: that of the bench" in said


@pytest.mark.study  # test_the_verb_writes_a_page_or_markdown has the other formats
def test_a_report_is_printed_by_a_browser(made: gw.Report, tmp_path: Path) -> None:
    if api.browser() is None:
        with pytest.raises(gw.InputError, match="needs Chromium"):
            made.save(tmp_path / "drag.pdf")
    else:
        made.save(tmp_path / "drag.pdf")
        assert (tmp_path / "drag.pdf").read_bytes().startswith(b"%PDF")
        assert (tmp_path / "drag.pdf").stat().st_size < 5e6
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(api, "browser", lambda: "/bin/false")
            with pytest.raises(gw.InputError, match="printed nothing"):
                made.save(tmp_path / "drag.pdf")
        assert _is_report(tmp_path / "drag.pdf")  # as it was


@pytest.mark.usefixtures("undrawn")
@pytest.mark.slow
def test_the_verb_writes_a_page_or_markdown(
    gyrowheel: Shell, wheel: Wheel, made: gw.Report, page: Page, tmp_path: Path
) -> None:
    asked = ("report", wheel.recording, "--model", wheel.model)
    target = tmp_path / "drag.html"
    write(target, page.text)  # an earlier report is replaced
    said = gyrowheel.good(*asked, "-o", target)
    assert "An effect is missing" in said.out
    assert "report: " in said.out
    check_numbers(Page(target.read_text(encoding="utf-8")))
    made.save(tmp_path / "drag.md")
    text = (tmp_path / "drag.md").read_text(encoding="utf-8")
    assert f"# {made.diagnosis.sentence}" in text
    assert all(own["sha256"] in text for r in made.to_dict()["recordings"] for own in r["files"])
    other = write(tmp_path / "mine.html", "<p>mine</p>")
    for name, words in (
        (other, "exists and is not an earlier report"),
        (tmp_path / "a.txt", "allowed: .html, .md, .pdf"),
    ):
        refused = gyrowheel(*asked, "-o", name)
        assert refused.code == 2
        assert words in refused.err
    assert other.read_text(encoding="utf-8") == "<p>mine</p>"
