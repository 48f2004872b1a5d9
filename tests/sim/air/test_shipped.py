"""The shipped table: complete, with its provenance, and what it reproduces and what it does not."""

from __future__ import annotations

import numpy as np
import pytest

from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.air import get_model
from gyrowheel_sim.air.cfd.mesh import MESHES
from gyrowheel_sim.air.check import check_table
from gyrowheel_sim.air.effects import air_effects
from gyrowheel_sim.air.table import TorqueTable

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
def test_every_row_says_where_it_comes_from(row):
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


def test_rows_beside_the_grid_show_mesh_model_and_axes():
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


# what the check list must say; a table computed anew may do better, and then this list is to be shortened
MISSED = {
    "T3 varies by less than 10 %",
    "T2 is not zero and grows",
    "T3 at all tilts",
    "every row of the grid has settled",
}


def test_the_shipped_table_reproduces_what_it_is_said_to():
    missed = {what for what, check in CHECKS.items() if check.holds is not True}
    assert {what for what in missed if not any(words in what for words in MISSED)} == set()


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
