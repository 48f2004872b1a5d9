"""The workbench in a real browser: accessibility, connections, and jobs and signals in progress."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import gyrowheel as gw
from gyrowheel.campaigns.page import campaign_report
from gyrowheel.campaigns.summary import Summary
from gyrowheel.workbench.benches import Running
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.server import Server
from gyrowheel.workbench.session import Session
from gyrowheel.workbench.trace import BIN_NS
from gyrowheel_core.wire import SECOND

from .browser import faults, needs_browser, opened_browser, press
from .conftest import Wheel
from .findings import judged_case
from .helpers import sample, wait_until, write


@pytest.mark.slow
@needs_browser
def test_pages_have_no_serious_accessibility_violation(wheel: Wheel, tmp_path: Path) -> None:
    cases = [judged_case(k, validation=1.0) for k in range(3)]
    cases += [judged_case(3, outcome="misnamed", named=["flexure_hysteresis"]), judged_case(4, "none")]
    (tmp_path / "none").mkdir()
    gw.paper(tmp_path / "paper", only=["fig-7", "fig-8-growth"])
    campaign = write(
        tmp_path / "campaign.html",
        campaign_report(Summary.counted(5, 9, cases, "5 blind cases"), "gyrowheel campaign"),
    )
    empty = Session(Library([tmp_path / "none"]), gw.Model())
    with (
        Server(empty, port=0) as server,
        Server(Session(Library([wheel.recording]), gw.Model()), port=0, token=True) as guarded,
        opened_browser() as browser,
    ):
        page = browser.new_page()
        page.set_default_timeout(240_000)
        for url, shown in (
            (server.url, "[data-do=demonstrate]"),
            (f"{server.url}help", "#import"),
            *((f"{server.url}help/effect/{name}", ".law") for name in ("windage", "bearing_coulomb")),
            (guarded.url, "#token"),
            (campaign.as_uri(), "#wrong"),
            ((tmp_path / "paper" / "index.html").as_uri(), "#fig-7 img"),
        ):
            page.goto(url)
            page.wait_for_selector(shown)
            assert faults(page) == []


@pytest.mark.slow
@needs_browser
def test_a_page_reconnects_and_asks_for_the_token(wheel: Wheel) -> None:
    from playwright.sync_api import expect

    def serving(port: int = 0, *, token: bool = False) -> Server:
        return Server(Session(Library([wheel.recording.parent]), gw.Model()), port=port, token=token)

    formula = "mine: torque = -k*Omega*z"
    expect.set_options(timeout=240_000)
    with opened_browser() as browser:
        page = browser.new_page()
        page.set_default_timeout(240_000)
        with serving() as server:
            page.goto(server.url)
            expect(page.locator("#part-recordings")).to_contain_text("drag")
            page.locator("#steps [data-step=what]").click()
            page.locator("#tab-formula").click()
            page.locator("#formula").fill(formula)
            expect(page.locator("#formula-said")).to_contain_text("mine")
        expect(page.locator("#lost")).to_be_visible()
        with serving(server.port):
            expect(page.locator("#lost")).to_be_hidden()
            page.reload()
            expect(page.locator("#formula-said")).to_contain_text("mine")
            expect(page.locator("#formula")).to_have_value(formula)
        expect(page.locator("#lost")).to_be_visible()
        with serving(server.port, token=True) as guarded:
            page.locator("#token").fill("guess")
            page.locator("#token").press("Enter")
            expect(page.locator("form")).to_contain_text("not the token")
            page.locator("#token").fill(guarded.access.token)
            page.locator("#token").press("Enter")
            expect(page.locator("#part-recordings")).to_contain_text("drag")
            assert guarded.access.token not in page.url


@pytest.mark.slow
@needs_browser
def test_the_signals_of_a_running_bench_are_drawn_as_they_arrive(wheel: Wheel) -> None:
    from playwright.sync_api import expect

    expect.set_options(timeout=240_000)
    session = Session(Library([wheel.recording.parent]), gw.Model())
    session.live._runs[""] = Running(0, SECOND)  # as if it was heard, which does not need ROS
    walked: list[tuple[str, str]] = []
    session.walk = lambda *given: walked.append(given)  # type: ignore[method-assign]
    sent: list[str] = []

    def go(key: str, *_: Any) -> bool:
        sent.append(key)
        return True

    session.live.walk = go  # type: ignore[method-assign,assignment]
    with Server(session, port=0) as server, opened_browser() as browser:
        page = browser.new_page()
        page.set_default_timeout(240_000)
        page.goto(server.url)
        press(page.get_by_role("button", name="Watch it"))
        expect(page.locator("#live")).to_be_visible()
        bench = itertools.count(1)

        def feed(bins: int) -> None:
            if (trace := session.live._traces.get("")) is not None:
                for k in itertools.islice(bench, bins):
                    trace.set(k * BIN_NS, 0.05, 0.0, 366.5)
                    trace.take([sample(k * BIN_NS, 0.05 + 1e-4 * (k % 3))])
            page.wait_for_timeout(50)

        while page.evaluate("import('/files/live.js').then(({ seen }) => seen.bins)") < 300:
            feed(20)
        expect(page.locator("#live-said")).to_contain_text("tilt 2.8")
        assert page.evaluate("import('/files/live.js').then(({ seen }) => seen.frames)") > 3
        assert faults(page) == []
        # a plan moves the machine: it is confirmed, or not
        press(page.locator("#live-run button"))
        expect(page.locator("#live-sure")).to_contain_text("moves")
        press(page.locator("#live-not"))
        expect(page.locator("#live-sure")).to_be_hidden()
        assert walked == []
        page.locator("#live-plan").select_option("quick")
        press(page.locator("#live-run button"))
        press(page.locator("#live-sure .main"))
        expect(page.locator("#live-sure")).to_be_hidden()
        wait_until(session, lambda: bool(walked))
        assert walked == [("quick", "live")]
        # so is a setpoint, once its values are allowed
        session.live._runs[""] = Running(0, SECOND, asked=(0, 1, 0.05, 0.0, 366.5))
        expect(page.locator("#live-allowed")).to_contain_text("spin rates from 1000 to 4000 rpm")
        page.set_viewport_size({"width": 900, "height": 900})  # the pane is lower than what is in it
        page.locator("#live-x").fill("9")
        press(page.locator("#live-setpoint button"))
        expect(page.locator("[data-trouble=setpoint]")).to_have_text(
            "tilt about x: 9 deg is not allowed; allowed: -3 .. 3 deg"
        )
        expect(page.locator("[data-trouble=setpoint]")).to_be_in_viewport()
        page.locator("#live-x").fill("1.5")
        for answer in ("#live-not", "#live-sure .main"):
            assert sent == []
            press(page.locator("#live-setpoint button"))
            expect(page.locator("#live-sure")).to_contain_text("to tilt 1.5, 0°, 2500 rpm")
            assert faults(page) == []
            press(page.locator(answer))
            expect(page.locator("#live-sure")).to_be_hidden()
        wait_until(session, lambda: bool(sent))
        assert sent == ["live"]
        # out of sight, nothing is received
        press(page.locator("#tab-live"), "ArrowLeft")
        while session.live._traces:
            feed(1)


@pytest.mark.slow
@needs_browser
def test_pictures_that_are_replaced_leave_nothing_in_the_page(wheel: Wheel) -> None:
    """A change of the theme draws every picture again."""
    session = Session(Library([wheel.recording.parent]), gw.Model())
    session.open("0/drag", "fitted")
    session.wait(240.0)
    session.compare()
    session.wait(240.0)
    with Server(session, port=0) as server, opened_browser() as browser:
        page = browser.new_page()
        page.set_default_timeout(240_000)
        page.goto(server.url)
        browsed = page.context.new_cdp_session(page)

        def nodes_after(changes: int) -> int:
            for theme in ("dark", "light") * (changes // 2):
                page.emulate_media(color_scheme=theme)
                page.wait_for_function(
                    "Bokeh.documents.length > 3 && Bokeh.documents.every((own) => own.is_idle)"
                )
                page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done)))")
            browsed.send("HeapProfiler.collectGarbage")
            return int(browsed.send("Memory.getDOMCounters")["nodes"])

        page.wait_for_selector("#plots[data-drawn]")
        first = nodes_after(4)
        assert nodes_after(16) < 1.2 * first


@contextlib.contextmanager
def comparison_without_end(
    wheel: Wheel, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Server, Callable[[], Any]]]:
    """Yield a server whose comparison goes on until the user ends it, and what opens a page of it in a browser."""
    from playwright.sync_api import expect

    ended = threading.Event()

    def compare(recordings: Any, model: Any, *, progress: Any) -> None:
        for step in itertools.count():
            progress(f"step {step}")  # ends it where the user has
            assert not ended.wait(0.02)

    monkeypatch.setattr("gyrowheel.workbench.session.compare", compare)
    expect.set_options(timeout=240_000)
    session = Session(Library([wheel.recording.parent]), gw.Model())
    session.open("0/drag", "fitted")
    session.wait(240.0)
    with Server(session, port=0) as server, opened_browser() as browser:

        def opened() -> Any:
            page = browser.new_page()
            page.set_default_timeout(240_000)
            page.goto(server.url)
            return page

        try:
            yield server, opened
        finally:
            ended.set()


def begin_to_compare(page: Any) -> None:
    page.locator("#steps [data-step=what]").click()
    press(page.locator("button[data-do=compare]"))


@pytest.mark.slow
@needs_browser
def test_progress_takes_neither_focus_nor_typed_text(wheel: Wheel, monkeypatch: pytest.MonkeyPatch) -> None:
    from playwright.sync_api import expect

    with comparison_without_end(wheel, monkeypatch) as (_, opened):
        page, other = opened(), opened()
        page.locator("#save-name").select_text()
        begin_to_compare(other)
        expect(page.locator("#job")).to_contain_text("step ")
        expect(page.locator("form[data-do=save] button")).to_be_disabled()
        page.keyboard.type("mine.yaml")  # in place of what is selected, in a field that was written again
        press(page.locator("#job button"))  # found with Tab, though the line changes all along
        expect(page.locator("#trouble")).to_have_text("ended")
        expect(page.locator("#save-name")).to_have_value("mine.yaml")


@pytest.mark.slow
@needs_browser
def test_a_page_that_is_left_and_loaded_again_shows_the_job(
    wheel: Wheel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reload, another page and back, and closing the page leave the job running, which can be ended afterwards."""
    from playwright.sync_api import expect

    with comparison_without_end(wheel, monkeypatch) as (server, opened):
        page = opened()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        begin_to_compare(page)
        expect(page.locator("#job")).to_contain_text("step ")
        for leave in (page.reload, lambda: (page.goto(f"{server.url}help"), page.go_back())):
            leave()
            expect(page.locator("#job")).to_contain_text("step ")
        page.close()
        page = opened()
        press(page.locator("#job button"))
        expect(page.locator("#trouble")).to_have_text("ended")
        assert errors == []
