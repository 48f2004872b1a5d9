"""The mesh of the flow computation: its blocks, how it follows a tilt, its files."""

from __future__ import annotations

import math
import re
import tarfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrowheel_air.cfd.mesh import (
    MESHES,
    PolyMesh,
    block_mesh_dict,
    both_sides,
    morph,
    read_field,
    read_points,
    write_field,
    write_points,
)
from gyrowheel_air.torque import tilt_axes
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG

from .helpers import GEOMETRY, RECORDED

tilts = st.floats(-5.0, 5.0)
directions = st.floats(-180.0, 180.0)


@pytest.fixture(scope="module")
def upright(tmp_path_factory: pytest.TempPathFactory) -> PolyMesh:
    """Return the recorded mesh of the resolution `tiny` without tilt."""
    folder = tmp_path_factory.mktemp("mesh")
    with tarfile.open(RECORDED / "polyMesh.tar.gz") as archive:
        archive.extractall(folder / "constant")
    return PolyMesh.read(folder)


def moved(mesh: PolyMesh, tilt: float, direction: float = 0.0) -> PolyMesh:
    points = morph(mesh.points, GEOMETRY, tilt * DEG, direction * DEG)
    return PolyMesh(points, mesh.faces, mesh.owner, mesh.neighbour, mesh.patches)


@pytest.mark.parametrize("name", MESHES)
def test_blocks_have_the_stated_number_of_cells(name: str):
    text = block_mesh_dict(GEOMETRY, MESHES[name])
    blocks = re.findall(r"hex \([\d ]+\) \((\d+) (\d+) (\d+)\)", text)
    assert len(blocks) == 22
    assert sum(math.prod(map(int, block)) for block in blocks) == MESHES[name].cells


def test_low_re_meshes_have_the_published_order_of_cells():
    assert MESHES["coarse"].cells == 43_200
    assert 90_000 <= MESHES["low_re"].cells <= 110_000
    assert MESHES["low_re_fine"].cells > 2 * MESHES["low_re"].cells


def test_grading_is_fine_at_both_walls():
    assert both_sides(10.0) == "((0.5 0.5 10)(0.5 0.5 0.1))"
    assert both_sides(1.0) == "1"


def test_the_mesh_fills_the_gap(upright: PolyMesh):
    exact = math.pi * (
        GEOMETRY.case_radius**2 * GEOMETRY.case_height - GEOMETRY.rotor_radius**2 * GEOMETRY.rotor_height
    )
    # 16 straight sides in place of a circle
    polygon = math.sin(2 * math.pi / 16) / (2 * math.pi / 16)
    assert upright.cells == MESHES["tiny"].cells
    assert upright.volumes.sum() == pytest.approx(polygon * exact, rel=1e-6)


@pytest.mark.slow
@given(tilt=tilts, direction=directions)
def test_no_cell_folds_when_the_rotor_tilts(upright: PolyMesh, tilt: float, direction: float):
    mesh = moved(upright, tilt, direction)
    assert mesh.volumes.min() > 0.2 * upright.volumes.min()
    for patch in ("rotor", "case"):
        assert mesh.wall_distance(patch).min() > 0.0
        # a closed surface
        assert mesh.face_areas[mesh.patches[patch]].sum(axis=0) == pytest.approx(0.0, abs=1e-15)


@given(tilt=tilts, direction=directions)
def test_the_rotor_turns_as_a_whole_and_the_case_stays(upright: PolyMesh, tilt: float, direction: float):
    mesh = moved(upright, tilt, direction)
    axes, still = tilt_axes(tilt * DEG, direction * DEG), tilt_axes(0.0, direction * DEG)
    rotor = np.unique(mesh.faces[mesh.patches["rotor"]])
    assert mesh.points[rotor] @ axes.T == pytest.approx(upright.points[rotor] @ still.T, abs=1e-9)
    case = np.unique(mesh.faces[mesh.patches["case"]])
    x, y, z = mesh.points[case].T
    on_end = np.isclose(np.abs(z), GEOMETRY.case_height / 2, atol=1e-9)
    on_rim = np.isclose(np.hypot(x, y), GEOMETRY.case_radius, atol=1e-9)
    assert np.all(on_end | on_rim)
    assert np.hypot(x, y).max() <= GEOMETRY.case_radius + 1e-9


@pytest.mark.parametrize(
    ("tilt", "geometry", "words"),
    [
        (5.5, GEOMETRY, ["5.5 deg", "-5 to 5 deg"]),
        (
            5.0,
            GEOMETRY.with_value("case_radius", 0.0545),
            ["5 deg", "mm of the case", "a tenth of the rim gap"],
        ),
        (float("nan"), GEOMETRY, ["nan"]),
    ],
)
def test_a_tilt_without_a_mesh_is_refused(upright: PolyMesh, tilt: float, geometry, words: list[str]):
    with pytest.raises(InputError) as refused:
        morph(upright.points, geometry, tilt * DEG)
    assert all(word in str(refused.value) for word in words)


def test_wall_distance_of_a_mesh_by_hand(upright: PolyMesh):
    # end gap of 12 mm in 5 equal cells: the first centre is at 1.2 mm
    faces = upright.patches["rotor"]
    flat = np.abs(upright.face_areas[faces][:, 2]) > 1e-12
    assert upright.wall_distance("rotor")[flat] == pytest.approx(1.2e-3, rel=1e-6)


def test_points_and_fields_survive_their_files(tmp_path: Path, upright: PolyMesh):
    write_points(tmp_path / "points", upright.points)
    assert read_points(tmp_path / "points") == pytest.approx(upright.points, abs=1e-10)
    for values in (upright.cell_centres, upright.volumes):
        write_field(tmp_path / "field", "field", "0 0 0 0 0 0 0", values, {"rotor": "type zeroGradient;"})
        assert read_field(tmp_path / "field", upright.cells) == pytest.approx(values, rel=1e-7, abs=1e-12)


def test_a_field_of_another_mesh_is_refused(tmp_path: Path, upright: PolyMesh):
    write_field(tmp_path / "field", "field", "0 0 0 0 0 0 0", upright.volumes, {})
    with pytest.raises(InputError, match="1824 values, 7 are expected"):
        read_field(tmp_path / "field", 7)
