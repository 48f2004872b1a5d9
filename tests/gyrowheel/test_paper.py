"""The verb `paper` and its Python face: the published test judged statement by statement."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel.paper_figures import flow
from gyrowheel.paper_figures.api import STATEMENTS
from gyrowheel.paper_figures.evidence import TILT, VERDICTS, Evidence
from gyrowheel_air.flow import Flow, shipped, write
from gyrowheel_air.table import TorqueTable

from .helpers import Shell
from .pages import Page, check_numbers

#: What needs no recording and no simulated hold.
QUICK = ["eq-6-sign", "fig-7", "fig-8-growth", "fig-8-drag"]


@pytest.fixture(scope="module")
def whole() -> gw.Paper:
    return gw.paper()


def test_every_figure_and_table_is_judged() -> None:
    named = " ".join(own.where for own in STATEMENTS)
    figures = {int(number) for number in re.findall(r"Fig\. (\d+)", named)}
    assert figures == set(range(3, 18))
    assert {"Table 1", "Table 2"} <= {own.where for own in STATEMENTS}
    assert len({own.name for own in STATEMENTS}) == len(STATEMENTS)


@pytest.mark.slow
def test_pages_and_pictures_are_whole_after_every_statement(gyrowheel: Shell, tmp_path: Path) -> None:
    folder = tmp_path / "paper"
    seen: list[int] = []

    def look(part: float) -> None:
        content = json.loads((folder / "paper.json").read_text(encoding="utf-8"))
        assert content["rows"][-1]["verdict"] in VERDICTS
        seen.append(len(content["rows"]))

    found = gw.paper(folder, only=QUICK, progress=look)
    assert seen == list(range(1, len(QUICK) + 1))
    page = (folder / "index.html").read_text(encoding="utf-8")
    for row in found.rows:
        assert f'id="{row.name}"' in page
        assert (folder / f"{row.name}.png").is_file() == (row.finding.draw is not None)
    told = Page(page)
    assert check_numbers(told) >= 5 * len(QUICK)
    assert told.content == json.loads((folder / "paper.json").read_text(encoding="utf-8"))
    # the page needs no other file
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert page.count("data:image/png") == sum(row.finding.draw is not None for row in found.rows)
    # an earlier outcome is replaced, other files are not
    again = gyrowheel.good("paper", "-o", folder, "--only", "fig-7", "--json", "-").json
    assert [row["name"] for row in again["rows"]] == ["fig-7"]
    other = tmp_path / "other"
    other.mkdir()
    (other / "index.html").write_text("mine", encoding="utf-8")
    refused = gyrowheel("paper", "-o", other, "--only", "fig-7")
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "holds other files" in refused.err
    assert (other / "index.html").read_text(encoding="utf-8") == "mine"
    assert "no statement" in gyrowheel("paper", "--only", "fig-33").err


@pytest.mark.parametrize("width", [80, 120])
def test_the_table_fits_the_width(width: int) -> None:
    from gyrowheel.paper_figures.page import paper_page
    from gyrowheel.show.layout import plain_text

    text = plain_text(paper_page(gw.paper(only=QUICK)), width)
    assert max(map(len, text.splitlines())) <= width
    assert "Both transverse torques grow with the tilt." in " ".join(text.split())


def test_wrong_equations_have_the_size_that_follows() -> None:
    found = gw.paper(
        only=["app-a-potential", "eq-6-frame", "eq-6-sign", "earth-rate", "eq-1-middle", "eq-1-last"]
    )
    half = found["app-a-potential"].finding.values
    assert half["tuned_speed_as_printed_rad_s"] == pytest.approx(math.sqrt(2.0) * half["tuned_speed_rad_s"])
    assert half["holding_torque_as_printed_n_m"] == pytest.approx(13.45e-3, abs=0.02e-3)
    assert found["eq-6-frame"].finding.values["share_left_in_average"] < 1e-3
    assert found["eq-6-sign"].finding.values["wrong_elements"] == 1.0
    assert found["earth-rate"].finding.values["earth_torque_n_m"] == pytest.approx(0.036e-3, abs=0.001e-3)
    assert {name: found[name].finding.verdict for name in ("eq-1-middle", "eq-1-last")} == {
        "eq-1-middle": "disagree",
        "eq-1-last": "agree",
    }


@pytest.mark.slow
@pytest.mark.study
def test_the_increment_of_fig_16_is_not_air(whole: gw.Paper) -> None:
    cause = whole["fig-16-cause"].finding
    parts = cause.values
    # an increment by the parts of the model, and by the voltages of a recording with noise
    assert parts["gimbal_n_m"] + parts["joint_ripple_n_m"] + parts["air_n_m"] == pytest.approx(
        parts["change_n_m"], abs=0.01e-3
    )
    assert whole["fig-16"].finding.values["coil_x_v"] == pytest.approx(parts["change_v"], abs=0.005)
    # gimbal: ½AΩ² tan φ by hand
    bench = Evidence().bench
    gimbal = -0.5 * bench.tuning_inertia * math.tan(TILT) * (4000.0**2 - 1000.0**2) * (math.pi / 30.0) ** 2
    assert parts["gimbal_n_m"] == pytest.approx(gimbal, rel=0.01)
    assert parts["share_not_air"] > 1.1
    assert cause.verdict == "disagree"
    assert whole["fig-16-across"].finding.verdict == "agree"


@pytest.mark.slow
@pytest.mark.study
def test_all_statements_get_a_verdict(whole: gw.Paper) -> None:
    assert len(whole.rows) == whole.total == len(STATEMENTS)
    assert sum(whole.counts().values()) == whole.total
    assert all(np.isfinite(list(row.finding.values.values())).all() for row in whole.rows)
    # without hyphens for minus signs
    assert not [row.name for row in whole.rows if re.search(r"(?<!\w)-\d", row.finding.ours)]
    assert whole["fig-14-cause"].finding.verdict == "cannot be decided"
    for row in whole.rows:
        assert (f"fig-{row.name[4:6].strip('-')}" != row.name) or row.finding.draw is not None, row.name


def test_a_flow_as_in_the_paper_gets_the_verdict_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """Verdicts come from the table: one whose T2 grows and whose T3 is constant turns them round."""
    from dataclasses import replace

    table = TorqueTable.load()
    rows = []
    for row in table.rows:
        tilt, rate = row.case.tilt, row.case.spin_rate
        mean = np.array([-0.3 * tilt * rate**2, 0.1 * tilt * rate**2, -(rate**1.5)]) * 1e-7
        rows.append(replace(row, torque=replace(row.torque, mean=mean, scatter=1e-3 * np.abs(mean))))
    evidence = Evidence()
    monkeypatch.setattr(evidence, "table", TorqueTable.of(rows), raising=False)
    judged = {
        own.name: own.judge(evidence).verdict for own in flow.STATEMENTS if own.name.startswith("fig-8")
    }
    assert judged == {"fig-8": "agree", "fig-8-growth": "agree", "fig-8-drag": "agree"}


def test_a_flow_without_tilt_is_even(monkeypatch: pytest.MonkeyPatch) -> None:
    """The flow of the upright rotor in place of the tilted one shows nothing of what Figs 10 and 11 state."""
    from dataclasses import replace

    still = shipped()[0]
    flows = tuple(replace(still, tilt=own.tilt, spin_rate=own.spin_rate) for own in shipped())
    evidence = Evidence()
    monkeypatch.setattr(evidence, "flows", flows, raising=False)
    judged = {
        own.name: own.judge(evidence).verdict for own in flow.STATEMENTS if own.name in ("fig-10", "fig-11")
    }
    assert judged == {"fig-10": "disagree", "fig-11": "disagree"}


def test_shipped_flow_belongs_to_the_table(tmp_path: Path) -> None:
    assert [(own.mesh, own.model) for own in shipped()] == [TorqueTable.load().method] * 3
    for own in shipped():
        # the top of the rotor is a disc, here a polygon of 48 sides, and its pressure has no mean
        sides = 48
        area = 0.5 * sides * math.sin(2.0 * math.pi / sides) * 0.0535**2
        assert own.area.sum() == pytest.approx(area, rel=1e-4)
        assert abs(np.average(own.pressure, weights=own.area)) < 1e-5
    # pressure on the top turns the tilted rotor back, as T1 does, and forwards, as T2 does
    along, ahead = shipped()[1].moment
    assert along < 0.0 < ahead
    write(tmp_path / "flow.npz", shipped())
    assert (tmp_path / "flow.npz").stat().st_size < 500_000
    assert isinstance(shipped()[0], Flow)
