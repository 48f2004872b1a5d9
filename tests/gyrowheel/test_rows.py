"""Every number of a row follows from the residuals that come with it, and compare, diagnose and add agree on them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

import gyrowheel as gw
from gyrowheel.workbench import windows
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.session import Session, Step
from gyrowheel_analysis.channels import LISTED, TORQUES
from gyrowheel_analysis.fitting.variance import DriftCovariance
from gyrowheel_analysis.residuals.error_table import Residuals

from .conftest import Wheel


@pytest.fixture(scope="module")
def results(wheel: Wheel) -> dict[str, Any]:
    model = gw.Model.load(wheel.model)
    fit, other = gw.Recording.open(wheel.recording), gw.Recording.open(wheel.other)
    compared = gw.compare(fit, model)
    found = gw.diagnose(fit, model, validate=other)
    better = model.add("windage", fit=fit, validate=other).added
    # a law that explains nothing has the same error before
    useless = model.add(gw.own_effect("axial_torque = -k*abs(z)^2", name="useless"), fit=fit).added
    assert better is not None
    assert useless is not None
    report = gw.Report.around(found, model, [fit], [other], comparison=compared).to_dict()["diagnosis"]
    return {
        "compare": (compared.residuals, {"before": compared.error_before.to_json()}),
        "diagnose": (found.residuals, found.to_dict()["error"]),
        "report": (found.residuals, report["error"]),
        "add": (better.residuals, better.error.to_json()),
        "useless": (useless.residuals, useless.error.to_json()),
        "channels": compared.to_dict()["channels"],
        "data": compared,
    }


def recomputed(
    residuals: Sequence[Residuals], channel: str, side: int, role: str
) -> tuple[float, float, float]:
    """Return RMS, noise and χ²/N of a channel from residuals, their noise and the whitened ones alone."""
    own = [r for r in residuals if r.role == role]
    of = "channels" if channel in TORQUES else "further"
    values = np.concatenate([getattr(r, of)[channel][side] for r in own])
    sigma = np.concatenate([getattr(r, of)[channel][2] for r in own])
    white = np.concatenate([r.whitened[channel][side] for r in own])
    weight, parts = 1.0 / sigma**2, len(LISTED[channel].rows)
    rms = np.sqrt(np.sum(weight * np.abs(values) ** 2) / np.sum(weight))
    noise = np.sqrt(parts * len(weight) / np.sum(weight))
    return float(rms), float(noise), float(np.mean(np.abs(white) ** 2) / parts)


@pytest.mark.parametrize("name", ["compare", "diagnose", "report", "add", "useless"])
def test_every_number_of_a_row_follows_from_the_exported_residuals(
    results: dict[str, Any], name: str
) -> None:
    residuals, error = results[name]
    for field, row in error.items():
        if not isinstance(row, dict) or field.endswith("noise_floor"):
            continue
        role = "validation" if field.startswith("validation") else "fit"
        floor = error.get("validation_noise_floor" if role == "validation" else "noise_floor")
        total = rows = 0.0
        for channel, shown in row["channels"].items():
            rms, noise, chi2 = recomputed(residuals, channel, int(field.endswith("after")), role)
            assert shown["rms"] == pytest.approx(rms, rel=1e-9)
            assert shown["chi2_per_n"] == pytest.approx(chi2, rel=1e-9)
            if floor is not None:
                assert floor["channels"][channel]["rms"] == pytest.approx(noise, rel=1e-9)
            if not LISTED[channel].drift:
                assert chi2 == pytest.approx((rms / noise) ** 2, rel=1e-9)
            total, rows = total + chi2 * len(LISTED[channel].rows), rows + len(LISTED[channel].rows)
        # all channels have a row of each window
        assert row["chi2_per_n"] == pytest.approx(total / rows, rel=1e-9)


def test_compare_diagnose_and_add_have_one_error_before_and_one_noise(results: dict[str, Any]) -> None:
    before = results["compare"][1]["before"]
    for name in ("diagnose", "add", "useless"):
        own = results[name][1]["before"]
        assert own["chi2_per_n"] == pytest.approx(before["chi2_per_n"], rel=1e-9)
        for channel, shown in before["channels"].items():
            for key in ("rms", "chi2_per_n"):
                assert own["channels"][channel][key] == pytest.approx(shown[key], rel=1e-9)
            floor = results[name][1]["noise_floor"]["channels"][channel]["rms"]
            assert results["channels"][channel]["noise_floor_rms"] == pytest.approx(floor, rel=1e-9)


def test_the_shares_and_maps_of_chi2_sum_to_that_of_the_rows(results: dict[str, Any]) -> None:
    compared = results["data"]
    white: dict[str, float] = {}
    for channel in compared.channels:
        parts = [np.abs(r.whitened[channel][0]) ** 2 for r in compared.residuals]
        name = "tilt" if channel in ("tilt_x", "tilt_y") else channel
        white[name] = white.get(name, 0.0) + float(np.sum(np.concatenate(parts)))
    for name, part in compared.data.parts.items():
        assert float(part.chi2.sum()) == pytest.approx(white[name], rel=1e-6)
    for shown in compared.maps:
        assert sum(cell.share_of_chi2 for cell in shown.cells) == pytest.approx(1.0)
        for name in compared.data.parts:
            mean = np.average(
                [c.chi2_per_n[name] for c in shown.cells], weights=[c.count for c in shown.cells]
            )
            assert mean * len(compared.data.windows) * len(compared.data.parts[name].kind.rows) == (
                pytest.approx(white[name], rel=1e-6)
            )


def test_the_map_of_the_workbench_is_that_of_the_comparison(results: dict[str, Any], wheel: Wheel) -> None:
    compared, session = (
        results["data"],
        Session(Library([wheel.recording.parent]), gw.Model.load(wheel.model)),
    )
    session.steps = [Step(gw.Model.load(wheel.model), compared)]
    own = {name: float(part.chi2.sum()) for name, part in compared.data.parts.items()}
    rows = {name: len(part.kind.rows) for name, part in compared.data.parts.items()}
    for shown in windows.maps(session):
        for name, chi2 in own.items():
            total = sum(cell["chi2"][name] * len(cell["windows"]) * rows[name] for cell in shown["cells"])
            assert total == pytest.approx(chi2, rel=5e-3, abs=0.1)  # shown to three places
    chosen = shown["cells"][0]["windows"]
    share = sum(float(part.chi2[chosen].sum()) for part in compared.data.parts.values()) / sum(own.values())
    assert windows.region(session, chosen)["share"] == pytest.approx(share)


def test_the_whitened_residuals_are_those_of_the_whole_covariance() -> None:
    """Independent of the recursion that whitens: the dense matrix of white noise and drift."""
    rng = np.random.default_rng(5)
    time = np.sort(rng.uniform(0.0, 60.0, 40))
    own = DriftCovariance(time, rng.uniform(1.0, 4.0, 40), 3.0, 20.0)
    rows = rng.normal(size=40) * 5.0
    dense = float(rows @ np.linalg.solve(own.dense(1.7), rows))
    assert float(np.sum(own.whiten(rows, 1.7) ** 2)) == pytest.approx(dense)
    shares = own.shares(rows, 1.7)
    assert float(shares.sum()) == pytest.approx(dense)
    assert np.all(shares >= 0.0)
