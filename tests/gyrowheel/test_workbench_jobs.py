"""Whole jobs in the workbench, in a real browser: look, where, what, proof; by keyboard, and without scrolling."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

import gyrowheel as gw
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.server import Server
from gyrowheel.workbench.session import Session

from .browser import faults, needs_browser, opened_browser, press, reached_by_tab
from .conftest import Wheel
from .helpers import write
from .lab_tables import lab_table

EVIL = "<img src=x onerror=alert(1)></script><script>alert(2)</script>"

#: Elements of a page that are wider than their place, or lie beyond the right edge.
CUT_OFF = """() => [...document.querySelectorAll('main *')].filter((own) => {
  if (own.closest('svg, math') || !own.getClientRects().length) return false;
  const wide = document.documentElement.clientWidth;
  const inline = getComputedStyle(own).display === 'inline';
  return own.getBoundingClientRect().right > wide + 1 || (!inline && own.scrollWidth > own.clientWidth + 1);
}).map((own) => `${own.tagName} ${own.className}: ${own.textContent.slice(0, 40)}`)"""


@pytest.mark.slow
@needs_browser
def test_the_whole_loop_by_keyboard(wheel: Wheel, tmp_path: Path) -> None:
    from playwright.sync_api import expect

    shutil.copytree(wheel.recording, tmp_path / "runs" / "drag")
    shutil.copytree(wheel.other, tmp_path / "runs" / "other<img src=x onerror=alert(3)>")
    content = yaml.safe_load(wheel.model.read_text(encoding="utf-8"))
    content["history"] = [{"time": "2026-01-01T00:00:00+00:00", "what": EVIL, "fit": [EVIL]}]
    file = write(tmp_path / "wheel.yaml", yaml.safe_dump(content))
    session = Session(Library([tmp_path / "runs"]), gw.Model.load(file), file)
    said: list[str] = []
    asked: list[str] = []
    with Server(session, port=0) as server, opened_browser() as browser:
        window = browser.new_context(viewport={"width": 1400, "height": 900})

        def page() -> Any:
            new = window.new_page()
            new.set_default_timeout(240_000)
            new.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
            new.on("pageerror", lambda error: said.append(str(error)))
            new.on("dialog", lambda dialog: said.append("a script ran"))
            new.on("request", lambda request: asked.append(request.url))
            new.goto(server.url)
            return new

        first, second = page(), page()
        expect.set_options(timeout=240_000)

        def library(name: str) -> Any:
            return first.locator("#part-recordings li").filter(has=first.locator("b", has_text=name))

        def go(step: str) -> None:
            press(first.locator(f"#steps [data-step={step}]"))

        def in_sight(target: Any) -> bool:
            box = target.bounding_box()
            return box is not None and box["y"] >= 0.0 and box["y"] + 40.0 <= 900.0

        def enabled(target: Any) -> Any:
            expect(target).to_be_enabled()
            return target

        press(library("drag").get_by_role("button", name="fit"))
        expect(first.locator("#tabs button")).to_have_count(1)
        press(enabled(library("other").get_by_role("button", name="only predict")))
        expect(first.locator("#tabs button")).to_have_count(2)
        expect(second.locator("#tabs button")).to_have_count(2)  # two pages agree
        # signals: all of it, then every sample
        expect(first.locator("#span")).to_contain_text("no spike is lost")
        first.keyboard.press("+")  # nothing: the keys are for the picture in focus
        first.locator("#plots").focus()
        for _ in range(7):
            first.keyboard.press("+")
        expect(first.locator("#span")).to_contain_text("every one")
        # the raw sample at the cursor, by keyboard
        first.keyboard.press(".")
        expect(first.locator("#readout")).to_contain_text("sample ")
        # ranges: dragged, or typed; the page and the list say what each is for, and undo takes them back
        press(first.locator("#range-mark"))
        first.bring_to_front()  # a page at the back draws nothing, and takes no drag
        ends = ["", ""]
        for _ in range(50):  # the picture makes room for the fields first
            box = first.locator("#plots").bounding_box()
            for move, share in ((first.mouse.down, 0.4), (first.mouse.up, 0.6)):
                first.mouse.move(box["x"] + share * box["width"], box["y"] + 0.3 * box["height"], steps=4)
                move()
            ends = [first.locator(f"#range-{end}").input_value() for end in ("from", "until")]
            if ends[1]:
                break
        assert float(ends[0]) < float(ends[1])
        first.locator("#range-from").fill("2")
        first.locator("#range-until").fill("1")
        press(first.locator("#range [value='left out']"))
        expect(library("drag").locator(".ranges")).to_contain_text("1 … 2 s left out")  # in either order
        expect(second.locator("#part-recordings .ranges")).to_contain_text("left out")
        assert len(session.used("fitted")) == 2
        first.locator("#plots").focus()
        first.keyboard.press("]")  # ends one at the cursor
        expect(first.locator("#range-until")).not_to_have_value("")
        first.locator("#plots").focus()
        first.keyboard.press("Escape")
        expect(first.locator("#range-until")).to_have_value("")
        press(enabled(first.locator("[data-do=undo]")))
        expect(first.locator("#part-recordings .ranges")).to_have_count(0)
        # a channel by a formula, whose unit is shown while it is typed
        press(first.locator("#derive-show"))
        first.locator("#derive").fill("V_x*abs(Omgea)")
        expect(first.locator("[data-trouble=derive]")).to_contain_text("Omgea")
        first.locator("#derive").fill("V_x*abs(z)")
        expect(first.locator("#derive-said")).to_contain_text("V")
        press(enabled(first.locator("#derive-add")))
        expect(first.locator("#plots canvas")).not_to_have_count(0)
        expect(second.locator("#derived button")).to_have_count(1)
        assert faults(first) == []
        press(first.locator("#derived button"))
        expect(first.locator("#derived button")).to_have_count(0)
        press(first.locator("#derive-show"))
        press(first.locator("#range-mark"))
        # where, and what is missing
        press(enabled(first.locator("#part-verdict button[data-do=diagnose]")))
        expect(first.locator("[data-verdict=effect]")).to_contain_text("windage")
        expect(second.locator("[data-verdict=effect]")).to_contain_text("windage")
        second.close()  # it would draw whatever is done from here on
        expect(first.locator("#pane-missing .ranks")).to_contain_text("without windage")
        assert "falls" not in first.locator("#pane-error").inner_text()  # nothing is added yet
        go("where")
        expect(first.locator("#where canvas").first).to_be_visible()
        # the picture shows at once what is hidden: windage, in the torque of the motor, over the spin rate
        expect(first.locator("#where")).to_have_attribute("data-drawn", "spin speed")
        # a cell of the map shows its windows, and what is said of them
        expect(first.locator("#job button")).to_have_count(0)
        press(first.locator(".map button[tabindex='0']"), "ArrowDown", *["ArrowRight"] * 3, "Enter")
        expect(first.locator("#chosen")).to_contain_text("windows chosen")
        expect(first.locator(".map button[aria-pressed]")).to_have_count(1)
        expect(first.locator("#chosen .said")).to_contain_text("residual")
        for place in (
            ".map button[aria-pressed]",
            "#plots",
            "#chosen .said",
            "#part-verdict",
            "[data-do=undo]",
        ):
            assert in_sight(first.locator(place)), f"{place} is not on the screen with the selection"
        # and so do windows that are chosen one by one, from the worst on
        press(first.locator("#where"), "Home")
        expect(first.locator("#chosen")).to_contain_text("1 of ")
        expect(first.locator(".map button[aria-pressed]")).to_have_count(0)
        worst = first.locator("#chosen table").last.locator("tbody tr").inner_text()
        first.keyboard.press("ArrowDown")
        expect(first.locator("#chosen table").last.locator("tbody tr")).not_to_have_text(worst)
        first.keyboard.press("Shift+ArrowUp")
        expect(first.locator("#chosen")).to_contain_text("2 of ")
        expect(first.locator("#chosen table").last.locator("tbody tr").first).to_have_text(
            worst, use_inner_text=True
        )
        first.keyboard.press("Escape")
        expect(first.locator("#chosen")).to_be_empty()
        assert faults(first) == []
        # every arrangement: the page does not scroll
        for step, *widths in (
            ("look", 1400, 900),
            ("what", 900, 2560),
            ("proof", 2560, 900),
            ("where", 900, 2560, 1400),
        ):
            go(step)
            for width in widths:
                first.set_viewport_size({"width": width, "height": 900})
                first.wait_for_function(
                    "() => document.documentElement.scrollWidth <= innerWidth"
                    " && document.documentElement.scrollHeight <= innerHeight"
                )
        # the Tab key reaches every part of the page
        places = reached_by_tab(first)
        assert {"steps", "plots", "where", "aside-border"} <= set(places), places
        # a pane is moved by keyboard, a border too, and a reload keeps both
        press(first.locator("#tab-map"), "Tab", "Enter")
        press(first.get_by_role("button", name="Move to a new column at the left"))
        expect(first.locator(".column")).to_have_count(3)
        press(first.locator("#aside-border"), "ArrowRight")
        kept = first.evaluate("document.getElementById('aside').clientWidth")
        first.reload()
        expect(first.locator(".column").first).to_contain_text("Map")
        assert first.evaluate("document.getElementById('aside').clientWidth") == kept
        press(first.locator("#tab-map"), "Tab", "Enter")
        press(first.get_by_role("button", name="Restore this step's arrangement"))
        expect(first.locator(".column")).to_have_count(2)
        go("look")
        expect(first.locator("#rotor-said")).to_contain_text("mN·m")
        press(first.locator("#rotor-flow summary"))
        press(first.locator("[data-flow=axial]"))
        assert (
            first.locator("#rotor-flow img").evaluate("(own) => own.decode().then(() => own.naturalWidth)")
            > 900
        )
        assert faults(first) == []
        go("what")
        press(enabled(first.get_by_role("button", name="Write the report")))
        expect(first.get_by_role("link", name="Open the report")).to_be_visible()
        assert session.report is not None
        kept = write(tmp_path / "report.html", session.report)
        third = window.new_page()
        third.set_default_timeout(240_000)
        third.on("dialog", lambda dialog: said.append("a script ran"))
        third.goto(f"{server.url}report")
        assert faults(third) == []
        # the report draws its signals, with the values at the cursor, by keyboard
        expect(third.locator("canvas")).to_have_count(2)
        third.locator("canvas").first.focus()
        third.keyboard.press("ArrowRight")
        expect(third.locator(".readout").first).to_contain_text("tilt about x")
        # printed, on A4 and on letter, in a dark theme too: nothing is cut off, and closed parts are open
        third.emulate_media(media="print", color_scheme="dark")
        for paper in (680, 702):  # px between the margins
            third.set_viewport_size({"width": paper, "height": 900})
            assert third.evaluate(CUT_OFF) == []
            assert third.evaluate(
                "[...document.querySelectorAll('details')].every((d) => d.offsetHeight > 100)"
            )
        third.close()
        # kept on the disk, it opens without a network
        alone = browser.new_context(offline=True).new_page()
        alone.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        alone.goto(kept.as_uri())
        expect(alone.locator("canvas")).to_have_count(2)
        alone.close()
        # holds, measured next to predicted; each shows its samples, by keyboard too
        go("look")
        expect(first.locator("#predicted canvas").first).to_be_visible()
        press(first.locator("#holds summary"))
        shown = first.locator("#span").inner_text()
        press(first.locator("#holds button").nth(1))
        expect(first.locator("#span")).not_to_have_text(shown)
        expect(first.locator("#predicted-said")).to_contain_text("holds")
        # all parameters: stated, from the recordings, and both, of the model with what was found
        go("what")
        press(first.locator("#tab-missing"), "ArrowRight")
        press(enabled(first.locator("[data-do=estimate]")))
        expect(first.locator("#coefficients-of")).to_contain_text("windage, found and not yet added")
        expect(first.locator("#coefficients-words")).to_contain_text("Strongest correlation")
        expect(first.locator("#coefficient-said")).to_contain_text("The recordings alone")
        first.locator("#coefficient").select_option("windage.n")
        expect(first.locator("#coefficient-said")).to_contain_text("Stated 1.480 ± 0.030")
        # an own formula is checked as it is typed
        press(first.locator("#tab-coefficients"), "ArrowRight")
        first.locator("#formula").fill("mine: torque = -k*Omgea*z")
        expect(first.locator("[data-trouble=formula]")).to_contain_text("Omgea")
        expect(first.locator("#formula-form button")).to_be_disabled()
        first.locator("#formula").fill("mine: torque = -k*Omega*z")
        expect(first.locator("#formula-said")).to_contain_text("mine")
        expect(first.locator("#formula-form button")).to_be_enabled()
        assert faults(first) == []
        # add: the error on the unused recording falls to its noise
        press(enabled(first.locator("#part-verdict button[data-do=add_all]")))
        expect(first.locator("#part-model .card")).to_contain_text("windage")
        expect(first.locator("#residual-others")).to_contain_text("no effects: χ²/N")  # drawn over it
        press(first.locator("#residual-slide"), "Home")
        expect(first.locator("#residual-slid")).to_contain_text("0 % of the change")
        go("proof")
        expect(first.locator("#fall canvas").first).to_be_visible()
        assert in_sight(first.locator("#fall"))
        row = first.locator("#part-error tr.total td.figure")
        before, after = (float(row.nth(k).inner_text()) for k in (3, 4))
        assert after < 1.3**2 < before
        added = session.step.model.added
        assert added is not None
        assert added.error.validation_after is not None
        assert after == pytest.approx(added.error.validation_after.chi2_per_n, rel=5e-3)
        # the spectrum by order of the rotation, from the samples, says what is measured and what is residual
        press(first.locator("[data-view=order]"))
        expect(first.locator("#residual-said")).to_contain_text("blocks of 8 turns in all")
        expect(first.locator("#residual canvas").first).to_be_visible()
        assert faults(first) == []
        press(first.locator("[data-view=over]"))
        # a reload keeps all, undo brings the model back
        first.reload()
        expect(first.locator("#part-model .card")).to_contain_text("windage")
        expect(first.locator("#fall canvas").first).to_be_visible()
        # the model is kept under a name
        first.locator("#save-name").fill("better.yaml")
        press(enabled(first.locator("form[data-do=save] button")))
        expect(first.locator("form[data-do=save] [role=status]")).to_have_text("saved")
        assert "windage" in gw.Model.load(tmp_path / "better.yaml").effects
        press(enabled(first.locator("button[data-do=undo]")))
        expect(first.locator("#part-model .card")).to_have_count(0)
        expect(first.locator("#part-model")).to_contain_text(EVIL)  # as text
        assert session.step.model.effects == {}
        press(enabled(first.locator("button[data-do=redo]")))
        expect(first.locator("#part-model .card")).to_contain_text("windage")
        press(enabled(first.locator("#part-model button[data-do=remove]")))
        expect(first.locator("#part-model .card")).to_have_count(0)
        # a table: what it seems to hold is shown, and a wrong unit of it is corrected
        samples = gw.Recording.open(wheel.recording).measurement[:8000]
        first.locator("#table-file").set_input_files(lab_table(tmp_path / "lab.csv", samples))
        expect(first.locator(".asked")).to_contain_text("tilt_y")
        assert faults(first) == []
        press(first.locator("#map-tilt_y-unit"), "Control+a", *"deg", "Enter")
        expect(first.locator("#part-table .told")).to_contain_text("No open questions")
        expect(first.locator("#part-table img")).to_be_visible()
        press(enabled(first.locator("button[name=take]")))
        expect(first.locator("#tab-table")).to_have_count(0)
        expect(first.locator("#tabs button")).to_have_count(3)
    assert said == []
    assert [url for url in asked if not url.startswith((server.url, "data:", "blob:"))] == []


#: Hidden effects of further whole jobs.
JOBS: dict[str, list[Any]] = {
    "two effects": ["aero_cross", "windage"],
    "three lobes": [gw.own_effect("mine: torque = k*conj(z)^2*r")],
}


@pytest.mark.slow
@pytest.mark.study  # the whole loop by keyboard is a job with one effect
@needs_browser
@pytest.mark.parametrize("job", JOBS)
def test_a_whole_job_without_scrolling_the_page(job: str, tmp_path: Path) -> None:
    from playwright.sync_api import expect

    for plan in ("quick", "check"):
        gw.simulate(plan, effects=JOBS[job], machine=6, folder=tmp_path / "runs" / plan)
    session = Session(Library([tmp_path / "runs"]), gw.Model())
    expect.set_options(timeout=240_000)
    with Server(session, port=0) as server, opened_browser() as browser:
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(240_000)
        page.goto(server.url)

        def done() -> None:
            expect(page.locator("#job button")).to_have_count(0)

        def in_sight(*places: str) -> None:
            page.wait_for_function(
                "(places) => document.documentElement.scrollHeight <= innerHeight && places.every((place) => {"
                " const box = document.querySelector(place)?.getBoundingClientRect();"
                " return box && box.height && box.top >= 0 && box.top + 40 <= innerHeight; })",
                arg=list(places),
            )

        for plan, use in (("quick", "fit"), ("check", "only predict")):
            row = page.locator("#part-recordings li").filter(has=page.locator("b", has_text=plan))
            row.get_by_role("button", name=use).click()
            expect(page.locator(f"#tabs button:has-text('{plan}')")).to_be_visible()
            done()
        page.locator("#part-verdict button[data-do=diagnose]").click()
        expect(page.locator("#part-verdict button[data-do=add_all]")).to_be_visible()
        done()
        page.locator("#steps [data-step=where]").click()
        page.locator(".map button").nth(3).click()
        expect(page.locator("#chosen")).to_contain_text("windows chosen")
        in_sight("#part-verdict", "#where", "#plots", "#chosen .said")
        page.locator("#part-verdict button[data-do=add_all]").click()
        expect(page.locator("#part-model .card").first).to_be_visible()
        done()
        page.locator("#steps [data-step=proof]").click()
        in_sight("#part-verdict", "#fall", "#residual", "[data-do=undo]")
        added = session.step.model.added
        assert added is not None
        assert added.error.validation_before is not None
        assert added.error.validation_after is not None
        assert added.error.validation_after.chi2_per_n < 1.3**2 < added.error.validation_before.chi2_per_n
        assert added.proof.proven
        names = list(session.step.model.effects)
        assert set(names) == ({"aero_cross", "windage"} if job == "two effects" else {"lobes"})
        page.locator("[data-do=undo]").click()
        expect(page.locator("#part-model .card")).to_have_count(0)
        page.locator("[data-do=redo]").click()
        expect(page.locator("#part-model .card")).to_have_count(len(names))
        page.locator("#save-name").fill("better.yaml")
        page.locator("form[data-do=save] button").click()
        expect(page.locator("form[data-do=save] [role=status]")).to_have_text("saved")
        page.reload()
        expect(page.locator("#steps [data-step=proof]")).to_have_attribute("aria-pressed", "true")
        in_sight("#part-verdict", "#fall", "#residual")
        assert list(gw.Model.load(tmp_path / "runs" / "better.yaml").effects) == names
