"""Single panes of the workbench in a real browser."""

from __future__ import annotations

from dataclasses import replace

import pytest

import gyrowheel as gw
from gyrowheel.diagnosis.api import Diagnosis
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.server import Server
from gyrowheel.workbench.session import Session

from .browser import faults, needs_browser, opened_browser, press
from .conftest import Wheel
from .findings import MAP, UNKNOWN


@pytest.mark.slow
@needs_browser
def test_the_missing_torque_is_drawn_as_a_map_with_its_uncertainty(wheel: Wheel) -> None:
    from playwright.sync_api import expect

    expect.set_options(timeout=240_000)
    session = Session(Library([wheel.recording.parent]), gw.Model())
    session.open("0/drag", "fitted")
    session.wait(240.0)
    session.compare()
    session.wait(240.0)
    session.steps = [replace(session.step, diagnosis=Diagnosis.of(replace(UNKNOWN, map=MAP)))]
    with Server(session, port=0) as server, opened_browser() as browser:
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(240_000)
        page.goto(server.url)
        page.locator("#steps [data-step=where]").click()
        # chosen among the variables; the colours are of the torque, and of its standard deviation
        page.locator("#where-variable").select_option(label="map of the missing torque on the rotor")
        expect(page.locator("#where")).to_have_attribute("data-drawn", "map rotor_torque 1432")
        expect(page.locator("#where-said")).to_contain_text("0.496 ± 0.0222 mN·m (both axes together)")
        page.locator("#where-variable").select_option("map shaft_torque")
        page.locator("#where-speed").select_option(label="3533 rpm")
        expect(page.locator("#where-said")).to_contain_text("Largest at 3533 rpm: 0.05 ± 0.007 mN·m")
        assert faults(page) == []
        # its windows are the same as in all panes
        press(page.locator("#where"), "Home")
        expect(page.locator("#chosen")).to_contain_text("1 of ")
        page.locator("#where-variable").select_option("speed")
        expect(page.locator("#where")).to_have_attribute("data-drawn", "spin speed")


#: Names of the ranges of the figures in a pane, column by column.
RANGES = """(pane) => {
  const { model } = [...Bokeh.index.roots].find(({ el }) => document.querySelector(pane).contains(el));
  return model.children.map((column) => column.children.map(({ x_range, y_range }) => [x_range.id, y_range.id]));
}"""


@pytest.mark.slow
@needs_browser
def test_two_models_and_two_recordings_side_by_side(wheel: Wheel) -> None:
    from playwright.sync_api import expect

    expect.set_options(timeout=240_000)
    session = Session(Library([wheel.recording.parent]), gw.Model())
    for name in ("drag", "other"):
        session.open(f"0/{name}", "fitted")
        session.wait(240.0)
    session.compare()
    session.wait(240.0)
    before = session.step
    assert before.comparison is not None
    # a model that leaves half of the residual of the motor
    data = before.comparison.data
    spin = data.parts["spin"]
    less = replace(spin, values=0.5 * spin.values, chi2=0.25 * spin.chi2)
    half = replace(before.comparison, data=replace(data, parts={**data.parts, "spin": less}))
    session.steps = [before, replace(before, model=gw.Model(), comparison=half)]
    with Server(session, port=0) as server, opened_browser() as browser:
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(240_000)
        page.goto(server.url)
        page.locator("#steps [data-step=where]").click()
        press(page.locator("#where-sides button"))
        expect(page.locator("#where")).to_have_attribute(
            "data-drawn", "spin speed model: no effects model as it is"
        )
        first, second = page.evaluate(RANGES, "#where")
        assert first == second  # the same axes
        # windows are chosen in both
        press(page.locator("#where"), "Home")
        expect(page.locator("#chosen")).to_contain_text("1 of ")
        page.locator("#tab-residual").click()
        page.locator("#residual-over").select_option("speed")
        press(page.locator("#residual-sides button"))
        said = page.locator("#residual-said")
        chi2 = [before.comparison.channels["spin"].chi2_per_n * share for share in (1.0, 0.25)]
        for title, value in zip(("model: no effects", "model as it is"), chi2, strict=True):
            expect(said).to_contain_text(f"{title}: ")
            expect(said).to_contain_text(f"χ²/N {float(f'{value:.3g}'):g}")
        first, second = page.evaluate(RANGES, "#residual")
        assert first == second
        # and of recordings: each has its own windows
        page.locator("#residual-left").select_option(label="recording: drag")
        page.locator("#residual-right").select_option(label="recording: other")
        counts = [int((data.recording == k).sum()) for k in (0, 1)]
        expect(said).to_contain_text(f"of {counts[0]} windows beyond ±1 σ. recording: other: ")
        expect(said).to_contain_text(f"of {counts[1]} windows beyond")
        assert faults(page) == []
        press(page.locator("#residual-sides button"))
        expect(said).to_contain_text(f"of {sum(counts)} windows lie beyond their noise")
