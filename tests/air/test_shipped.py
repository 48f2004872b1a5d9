"""The shipped table: complete, with its provenance, and what it reproduces and what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrowheel_air.cfd.mesh import MESHES
from gyrowheel_air.check import check_table
from gyrowheel_air.surrogate import air_effects, get_model
from gyrowheel_air.table import TorqueTable
from gyrowheel_core.units import DEG, RPM

from .helpers import AIR, GEOMETRY

TABLE = TorqueTable.load()
CHECKS = {check.what: check for check in check_table(TABLE)}


def test_grid_of_the_shipped_table():
    assert TABLE.method == ("low_re", "sst")
    assert TABLE.tilts / DEG == pytest.approx([0, 1, 2, 3, 4, 5])
    assert TABLE.speeds / RPM == pytest.approx([1000, 2000, 3000, 3500, 4000])
    assert TABLE.lengths == pytest.approx(GEOMETRY.to_dict())
    assert (TABLE.air.density, TABLE.air.viscosity) == (AIR.density, AIR.viscosity)


@pytest.mark.parametrize("row", TABLE.rows, ids=lambda row: row.case.name)
def test_every_row_states_its_provenance(row):
    origin = row.provenance
    assert origin["version"].startswith("1912")
    assert origin["iterations"] >= row.case.iterations
    assert origin["cells"] == MESHES[row.case.mesh].cells
    assert origin["first_guess"]
    assert origin["cpu_seconds"] > 10.0
    assert 200 <= row.torque.window < origin["iterations"]
    assert set(origin["residuals"]) >= {"Ux", "Uy", "Uz", "p"}
    assert max(origin["residuals"].values()) < 0.1
    assert 0.1 < row.y_plus["rotor"][0] < 20.0


def test_rows_outside_the_grid_vary_mesh_model_and_axes():
    beside = [row.case for row in TABLE.rows if row not in TABLE.grid]
    assert any(case.tilt < 0.0 for case in beside)
    assert any(case.direction > 0.0 for case in beside)
    assert {(case.mesh, case.model) for case in beside} >= {
        ("low_re_fine", "sst"),
        ("low_re", "laminar"),
        ("coarse", "paper"),
        ("medium", "paper"),
    }


def test_pressure_turns_the_rotor_back_and_friction_brakes_it():
    for row in TABLE.grid:
        if row.case.tilt > 0.0:
            assert row.torque.pressure[0] / row.torque.mean[0] == pytest.approx(0.96, abs=0.04)
        assert abs(row.torque.pressure[2]) < 1e-3 * abs(row.torque.mean[2])


def missed(rows) -> list[str]:
    return [check.what for check in check_table(TorqueTable.of(rows)) if check.holds is False]


def test_the_shipped_table_shows_what_was_found():
    assert [check.what for check in CHECKS.values() if check.holds is not True] == []
    fall = next(check for check in CHECKS.values() if check.what.startswith("T3 falls"))
    assert "Taylor vortices" in fall.cause
    assert "hardly depends on the tilt" in fall.paper


def scaled(row, component: int, factor: float, quantities: tuple[str, ...]):
    """Return a row with another value of a component of its torque."""
    by = np.where(np.arange(3) == component, factor, 1.0)
    return replace(
        row, torque=replace(row.torque, **{name: getattr(row.torque, name) * by for name in quantities})
    )


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("component", [0, 1, 2])
def test_a_table_damaged_by_more_than_its_spread_fails(component: int, sign: float):
    factor = 1.0 + 1.25 * sign * float(np.hypot(*TABLE.spread)[component])
    # one row, whichever it is
    for damaged in TABLE.grid:
        if damaged.case.tilt > 0.0 or component == 2:
            rows = [
                scaled(row, component, factor, ("mean",)) if row is damaged else row for row in TABLE.rows
            ]
            assert missed(rows) != [], damaged.case.name
    # all rows, in all that they say of the torque
    assert (
        missed([scaled(row, component, factor, ("mean", "pressure", "scatter")) for row in TABLE.rows]) != []
    )


def test_a_table_of_rows_that_did_not_settle_fails():
    def restless(row):
        return replace(row, torque=replace(row.torque, drift=0.05 * np.abs(row.torque.mean)))

    assert any("drift" in what for what in missed([restless(row) for row in TABLE.rows]))


@pytest.mark.parametrize("model", ["table", "surrogate"])
@pytest.mark.parametrize("rpm", [1000, 3500, 4000])
def test_models_of_the_table_agree_with_the_correlations_upright(model: str, rpm: float):
    ours = get_model(model).torque(GEOMETRY, AIR, (0.0, 0.0), rpm * RPM).components[2]
    theirs = get_model("correlation").torque(GEOMETRY, AIR, (0.0, 0.0), rpm * RPM).components[2]
    assert ours == pytest.approx(theirs, rel=0.15)


def test_end_gap_model_lies_within_its_own_uncertainty_of_the_table():
    for rpm in (1000, 2000, 3500, 4000):
        ours = get_model("vorticity").torque(GEOMETRY, AIR, (3 * DEG, 0.0), rpm * RPM)
        table = get_model("table").torque(GEOMETRY, AIR, (3 * DEG, 0.0), rpm * RPM)
        off = ours.components[0] - table.components[0]
        assert abs(off) < 2.0 * np.hypot(ours.uncertainty[0], table.uncertainty[0])


def test_default_effects_have_the_size_of_the_shipped_effects():
    found = air_effects().values
    assert 0.010 < found["aero_restoring"]["k"] < 0.040
    assert 0.003 < found["aero_cross"]["c"] < 0.010
    assert 0.0008 < found["windage"]["w"] < 0.0013
