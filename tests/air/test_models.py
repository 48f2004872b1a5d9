"""The four models behind one interface: symmetry, similarity, ranges, coefficients of the effects."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from gyrowheel_air.cfd.case import Case
from gyrowheel_air.check import check_table
from gyrowheel_air.correlations import Correlation, Vorticity
from gyrowheel_air.geometry import Geometry
from gyrowheel_air.surrogate import MODELS, air_effects, coefficients, fit_model, fit_table, get_model
from gyrowheel_air.table import Table, TorqueTable
from gyrowheel_air.torque import AirModel
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.effects import get, parse_option

from .helpers import AIR, GEOMETRY, SPEEDS, TILTS, found_laws, made_up, power_laws, row

MADE_UP = made_up()
ALL = [get_model(name, MADE_UP) for name in MODELS]
rpms = st.floats(1000.0, 4000.0)
angles = st.floats(0.1, 4.9)
names = pytest.mark.parametrize("model", ALL, ids=lambda model: model.name)


# ---- what holds for all


@names
def test_models_have_a_common_interface(model: AirModel):
    assert isinstance(model, AirModel)
    found = model.torque(GEOMETRY, AIR, (3 * DEG, 0.0), 3500 * RPM)
    assert found.components.shape == found.uncertainty.shape == found.case.shape == (3,)
    assert found.components[2] < 0.0
    assert not found.components[0] >= 0.0  # back, or unknown
    assert not found.components[1] <= 0.0  # ahead, or unknown


@names
def test_without_tilt_only_drag_remains(model: AirModel):
    found = model.torque(GEOMETRY, AIR, (0.0, 0.0), 3500 * RPM)
    assert found.case[:2] == pytest.approx(0.0, abs=1e-12)
    assert found.case[2] < 0.0


@names
@given(tilt=angles, direction=st.floats(-math.pi, math.pi), rpm=rpms)
def test_the_torque_turns_with_the_tilt(model: AirModel, tilt: float, direction: float, rpm: float):
    tangent = math.tan(tilt * DEG)
    along = model.torque(GEOMETRY, AIR, (tilt * DEG, 0.0), rpm * RPM)
    turned = model.torque(
        GEOMETRY,
        AIR,
        (math.atan(tangent * math.cos(direction)), math.atan(tangent * math.sin(direction))),
        rpm * RPM,
    )
    turn = np.array(
        [
            [math.cos(direction), -math.sin(direction), 0],
            [math.sin(direction), math.cos(direction), 0],
            [0, 0, 1],
        ]
    )
    assert turned.case == pytest.approx(turn @ along.case, rel=1e-6, abs=1e-12, nan_ok=True)


@names
@pytest.mark.parametrize(
    ("tilt", "speed", "word"),
    [((0.0, 0.0), 0.0, "spin rate"), ((0.0, 0.0), float("nan"), "spin rate"), ((2.0, 0.0), 300.0, "tilt")],
)
def test_invalid_conditions_are_refused(model: AirModel, tilt: tuple[float, float], speed: float, word: str):
    with pytest.raises(InputError, match=word):
        model.torque(GEOMETRY, AIR, tilt, speed)


def test_unknown_model_is_refused():
    with pytest.raises(InputError, match=r"'guess'.*correlation, vorticity, table, surrogate"):
        get_model("guess")


# ---- end-gap vorticity


def test_vorticity_model_by_hand():
    # 3 pi/16 . 1.205 . (0.335 . 366.52)^2 . 0.0535^6/0.012
    assert Vorticity().stiffness(GEOMETRY, AIR, 3500 * RPM) == pytest.approx(0.02092, rel=1e-3)


@given(gap=st.floats(4.0, 30.0))
def test_a_wider_end_gap_has_a_smaller_restoring_torque(gap: float):
    wider = GEOMETRY.with_value("case_height", GEOMETRY.rotor_height + 2e-3 * gap)
    one = Vorticity().stiffness(wider, AIR, 3500 * RPM)
    assert one == pytest.approx(Vorticity().stiffness(GEOMETRY, AIR, 3500 * RPM) * 12.0 / gap)


# ---- table


@pytest.mark.parametrize("tilt", TILTS[1:])
@pytest.mark.parametrize("speed", SPEEDS)
def test_table_gives_its_rows_back(tilt: float, speed: float):
    found = Table(MADE_UP).torque(GEOMETRY, AIR, (tilt, 0.0), speed)
    assert found.components == pytest.approx(power_laws(tilt, speed), rel=1e-9)


@given(tilt=st.floats(0.0, 5.0), rpm=rpms)
def test_table_interpolates_power_laws(tilt: float, rpm: float):
    found = Table(MADE_UP).torque(GEOMETRY, AIR, (tilt * DEG, 0.0), rpm * RPM)
    expected = power_laws(tilt * DEG, rpm * RPM)
    assert found.components == pytest.approx(expected, rel=3e-3, abs=1e-9)


@given(density=st.floats(0.3, 1.3), rpm=st.floats(1000, 4000))
def test_table_follows_similarity_in_other_air(density: float, rpm: float):
    # power laws have the density to the power n - 1, inside the table's Reynolds numbers and beyond
    found = Table(MADE_UP).torque(GEOMETRY, AIR.with_density(density), (3 * DEG, 0.0), rpm * RPM)
    exponents = np.array([2.05, 1.98, 1.48]) - 1.0
    expected = power_laws(3 * DEG, rpm * RPM) * (density / AIR.density) ** exponents
    assert found.components == pytest.approx(expected, rel=0.01)


def test_table_uncertainty_grows_beyond_its_reynolds_numbers():
    model = Table(
        made_up(beside=[row(5 * DEG, 3500 * RPM, 1.1 * power_laws(5 * DEG, 3500 * RPM), mesh="coarse")])
    )
    here = model.torque(GEOMETRY, AIR, (5 * DEG, 0.0), 1000 * RPM)
    thin = model.torque(GEOMETRY, AIR.with_density(0.3), (5 * DEG, 0.0), 1000 * RPM)
    assert here.uncertainty / np.abs(here.components) == pytest.approx(0.1)
    assert np.all(thin.uncertainty / np.abs(thin.components) > 0.15)


@given(size=st.floats(0.5, 2.0))
def test_table_holds_for_a_rotor_of_the_same_proportions(size: float):
    scaled = GEOMETRY
    for name, value in GEOMETRY.to_dict().items():
        scaled = scaled.with_value(name, size * value)
    # thinner air for a larger rotor at the same speed: the same Reynolds number
    air = AIR.with_density(AIR.density / size**2)
    one = Table(MADE_UP).torque(GEOMETRY, AIR, (3 * DEG, 0.0), 3500 * RPM).components
    other = Table(MADE_UP).torque(scaled, air, (3 * DEG, 0.0), 3500 * RPM).components
    assert other == pytest.approx(one * size**3, rel=1e-6)


@pytest.mark.parametrize(
    ("tilt", "rpm", "geometry", "words"),
    [
        (5.1, 3500.0, GEOMETRY, ["5.1 deg", "0 .. 5 deg"]),
        (3.0, 900.0, GEOMETRY, ["900 rpm", "1000 .. 4000 rpm"]),
        (3.0, 4100.0, GEOMETRY, ["4100 rpm", "1000 .. 4000 rpm"]),
        (3.0, 3500.0, GEOMETRY.with_value("case_radius", 0.0585), ["rim gap", "5 mm", "4 mm", "cfd sweep"]),
    ],
)
def test_table_refuses_conditions_outside_its_range(
    tilt: float, rpm: float, geometry: Geometry, words: list[str]
):
    with pytest.raises(InputError) as refused:
        Table(MADE_UP).torque(geometry, AIR, (tilt * DEG, 0.0), rpm * RPM)
    assert all(word in str(refused.value) for word in words)


def test_table_refuses_air_far_from_its_own():
    with pytest.raises(InputError, match="Reynolds number"):
        Table(MADE_UP).torque(GEOMETRY, AIR.with_density(0.02), (3 * DEG, 0.0), 1000 * RPM)


def test_table_survives_its_file(tmp_path: Path):
    MADE_UP.write(tmp_path / "table.json")
    again = TorqueTable.load(tmp_path / "table.json")
    assert [r.to_json() for r in again.rows] == [r.to_json() for r in MADE_UP.rows]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["not valid JSON"]),
        ("{}", ["not a torque table"]),
        ('{"schema": 7, "rows": []}', ["schema", "7", "allowed: 1"]),
        ('{"schema": 1, "rows": []}', ["no finished cases"]),
        ('{"schema": 1, "rows": [{"case": 3}]}', ["rows[0]"]),
    ],
)
def test_bad_table_files_are_refused(tmp_path: Path, text: str, words: list[str]):
    path = tmp_path / "table.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        TorqueTable.load(path)
    assert str(path) in str(refused.value)
    assert all(word in str(refused.value) for word in words)


def test_a_grid_with_holes_is_refused():
    rows = [r for r in MADE_UP.rows if not (r.case.tilt == TILTS[2] and r.case.spin_rate == SPEEDS[1])]
    with pytest.raises(InputError, match=r"lacks 1 of 30 cases: 2 deg 2000 rpm"):
        TorqueTable.of(rows)


# ---- surrogate


def test_surrogate_finds_the_laws_of_a_table():
    for law, size, exponent in zip(
        fit_table(MADE_UP).laws, (0.022, 0.0053, 0.95e-3), (2.05, 1.98, 1.48), strict=True
    ):
        assert law is not None
        assert law.size == pytest.approx(size, rel=1e-9)
        assert law.exponent == pytest.approx(exponent, rel=1e-9)
        assert law.largest < 1e-9


def test_surrogate_states_its_residuals_and_the_spread_of_the_table():
    def bumpy(tilt: float, speed: float) -> np.ndarray:
        return power_laws(tilt, speed) * (1.0 + 0.05 * math.cos(math.pi * round(tilt / DEG)))

    other = row(5 * DEG, 3500 * RPM, 1.2 * bumpy(5 * DEG, 3500 * RPM), model="laminar")
    law = fit_table(made_up(bumpy, beside=[other])).laws[2]
    assert law is not None
    assert law.rms == pytest.approx(0.05, rel=0.05)
    assert law.size_error / law.size == pytest.approx(0.2, rel=0.05)


@given(tilt=angles, direction=st.floats(-math.pi, math.pi), rpm=rpms, density=st.floats(0.3, 1.3))
def test_surrogate_is_exactly_the_effects_of_the_air(
    tilt: float, direction: float, rpm: float, density: float
):
    model = get_model("surrogate", MADE_UP)
    z = math.tan(tilt * DEG) * complex(math.cos(direction), math.sin(direction))
    found = model.torque(
        GEOMETRY, AIR.with_density(density), (math.atan(z.real), math.atan(z.imag)), rpm * RPM
    )
    across, along = 0j, 0.0
    for name, members in coefficients(model, GEOMETRY, AIR).items():
        (law,) = get(name).laws
        known = {"Omega": rpm * RPM, "Omega_ref": 3500 * RPM, "rho": density, "rho_ref": 1.205, "z": z}
        known |= {symbol: value for symbol, (value, _) in members.items()}
        value = complex(
            sp.lambdify(sorted(law.expression.free_symbols, key=str), law.expression)(
                *(known[str(symbol)] for symbol in sorted(law.expression.free_symbols, key=str))
            )
        )
        if law.target == "rotor_torque":
            across += value
        else:
            along += value.real
    axis = found.axes[2]
    # what acts across the rotor's axis has the z component that makes it so
    torque = np.array([across.real, across.imag, 0.0])
    torque[2] = -(torque @ axis) / axis[2]
    assert found.case == pytest.approx(torque + along * axis, rel=1e-9)


@pytest.mark.parametrize(
    ("model", "effects"),
    [
        (Correlation(), {"windage"}),
        (Vorticity(), {"aero_restoring", "windage"}),
        (Table(MADE_UP), {"aero_restoring", "aero_cross", "windage"}),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_every_model_gives_coefficients_of_what_it_knows(model: AirModel, effects: set[str]):
    found = coefficients(model, GEOMETRY, AIR)
    assert set(found) == effects
    for members in found.values():
        assert all(error >= 0.0 and value > 0.0 for value, error in members.values())
    assert 1.45 < found["windage"]["n"][0] < 1.55
    assert found["windage"]["w"][0] == pytest.approx(0.95e-3, rel=0.01)


@pytest.mark.parametrize("model", MODELS)
def test_a_model_of_the_air_can_be_given_to_a_machine(model: str):
    found = air_effects(model, table=MADE_UP)
    given = dict(parse_option(text) for text in found.options)
    assert set(given) == set(found.values) == set(found.errors)
    for effect, members in given.items():
        assert members == pytest.approx(found.values[effect], rel=1e-3)


@given(rpm=st.floats(1000, 8000), density=st.floats(0.3, 1.3))
def test_coefficients_at_another_reference_are_the_same_laws(rpm: float, density: float):
    model = get_model("surrogate", MADE_UP)
    found = coefficients(model, GEOMETRY, AIR, reference_speed=rpm * RPM, reference_density=density)
    for name, size, n in (
        ("aero_restoring", 0.022, 2.05),
        ("aero_cross", 0.0053, 1.98),
        ("windage", 0.95e-3, 1.48),
    ):
        (value, _), (exponent, _) = found[name].values()
        assert exponent == pytest.approx(n)
        assert value == pytest.approx(size * (rpm / 3500) ** n * (density / 1.205) ** (n - 1))


def test_the_end_gap_model_grows_as_the_square_of_the_speed():
    law = fit_model(Vorticity(), GEOMETRY, AIR).laws[0]
    assert law is not None
    assert law.exponent == pytest.approx(2.0, abs=1e-6)


# ---- check list, geometry


def test_a_table_of_the_expected_laws_passes_its_check_list():
    t = found_laws(5 * DEG, 3500 * RPM)
    back = row(-5 * DEG, 3500 * RPM, t * [-1, -1, 1])
    turned = row(5 * DEG, 3500 * RPM, t, direction=math.pi / 4)
    finer = row(5 * DEG, 3500 * RPM, 1.02 * t, mesh="low_re_fine")
    checks = check_table(made_up(found_laws, beside=[back, turned, finer]))
    assert [item.what for item in checks if item.holds is not True] == []
    assert all(item.bar for item in checks)


def test_findings_of_the_published_rotor_do_not_apply_to_another():
    wide = GEOMETRY.with_value("case_radius", 60e-3)
    rows = [
        replace(own, case=Case.of(wide, AIR, own.case.tilt, own.case.spin_rate)) for own in made_up().rows
    ]
    checks = check_table(TorqueTable.of(rows))
    assert [item.holds for item in checks if "T3 falls" in item.what] == [None]
    assert any(item.holds is True and "pressure's share" in item.what for item in checks)


def test_the_check_list_detects_wrong_tables():
    def wrong(tilt: float, speed: float) -> np.ndarray:
        laws = power_laws(tilt, speed) * (speed / SPEEDS[3]) ** 0.5
        return laws * [1, 1 if tilt < 4 * DEG else -1e-3, 1 + 2 * tilt]

    t = wrong(5 * DEG, 3500 * RPM)
    back = row(-5 * DEG, 3500 * RPM, t * [-1, -1, 1.06])
    checks = check_table(made_up(lambda tilt, speed: np.abs(wrong(tilt, speed)) * [-1, 1, -1], beside=[back]))
    missed = [item.what for item in checks if item.holds is False]
    for word in (
        "backwards",
        "T3 falls",
        "T2 falls",
        "T3 grows",
        "T1 grows",
        "T3 without tilt",
        "T3 from one",
    ):
        assert any(word in what for what in missed), word
    assert [item.holds for item in checks if "45°" in item.what] == [None]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("value: 53.5e-3", ["lengths.rotor_radius.value", "'wide'", "not a number"]),
        ("unit: m", ["lengths.rotor_radius.unit", "'wide'", "allowed: m"]),
        ("53.5e-3", ["rotor_radius", "less than case_radius"]),
    ],
)
def test_bad_geometry_files_are_refused(tmp_path: Path, change: str, words: list[str]):
    text = (Path(__file__).parents[2] / "src/gyrowheel_air/gyrowheel_air/geometry.yaml").read_text()
    new = change.split(":")[0] + ": wide" if ":" in change else "0.06"
    path = tmp_path / "geometry.yaml"
    path.write_text(text.replace(change, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        Geometry.load(path)
    assert str(path) in str(refused.value)
    assert all(word in str(refused.value) for word in words)


@given(tilt=st.floats(-6.0, 6.0))
def test_clearance_is_that_of_the_turned_corners(tilt: float):
    angle = tilt * DEG
    corners = [(y * GEOMETRY.rotor_radius, z * GEOMETRY.rotor_height / 2) for y in (-1, 1) for z in (-1, 1)]
    turned = [
        (y * math.cos(angle) - z * math.sin(angle), y * math.sin(angle) + z * math.cos(angle))
        for y, z in corners
    ]
    side = min(GEOMETRY.case_radius - abs(y) for y, _ in turned)
    top = min(GEOMETRY.case_height / 2 - abs(z) for _, z in turned)
    assert GEOMETRY.clearance(angle) == pytest.approx(min(side, top), abs=1e-15)
