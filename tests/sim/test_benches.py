"""The shipped benches, one unlike the other: their files, their loops, and the sizes that effects have on them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrowheel_control.loops.closed_loop import Run, simulate
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM, unit_registry
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.blind import draw, draw_effect
from gyrowheel_sim.effects import Effect, effect_from_text, get, parse_option, registry
from gyrowheel_sim.effects.registry import for_bench, torque_scale
from gyrowheel_sim.plant.scenario import Scenario

BENCHES = [Bench.load(name) for name in Bench.shipped()]
EACH = pytest.mark.parametrize("bench", BENCHES, ids=lambda bench: bench.name)
OTHERS = pytest.mark.parametrize("bench", BENCHES[1:], ids=lambda bench: bench.name)
DEFAULT, DTG = Bench.load(), Bench.load("dtg")


# --- bench files ---------------------------------------------------------------------------------------------


def test_the_default_bench_comes_first():
    assert Bench.shipped()[0] == DEFAULT.name == "gyrowheel"


@pytest.mark.parametrize("name", Bench.shipped())
def test_a_shipped_bench_is_found_by_its_name(name):
    assert Bench.load(name).name == name


def test_changing_a_bench_does_not_change_another():
    parameters = Bench.load().parameters
    assert isinstance(parameters, dict)
    parameters.clear()
    assert Bench.load() == DEFAULT


def test_an_unknown_bench_is_refused_with_the_nearest_name():
    with pytest.raises(InputError, match="bench 'dtgg': no such shipped bench or file; did you mean dtg"):
        Bench.load("dtgg")
    with pytest.raises(
        InputError, match="bench: Bench is not allowed; allowed: the name of a shipped bench, or"
    ):
        Bench.load(Bench.load("dtg"))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="shipped: gyrowheel, dtg"):
        Bench.load("xyz")


@EACH
def test_every_value_has_unit_uncertainty_source_and_description(bench):
    for p in bench.parameters.values():
        default = DEFAULT.parameters[p.name]
        units = [unit_registry().parse_units(unit) for unit in (p.unit, default.unit)]
        assert units[0].dimensionality == units[1].dimensionality, p.name
        assert p.source.strip()
        assert p.description.strip()
        # the fit knows the parameters that vary together by the name of their group
        assert p.group == default.group
        assert (p.uncertainty > 0.0) == (default.uncertainty > 0.0), p.name
        key = p.source.split(",")[0].split(":")[0]
        assert key == "assumed" or key in bench.references or " " in key, f"{p.name}: {p.source}"


@EACH
def test_a_bench_is_tuned_at_its_reference_speed(bench):
    stiffness = 0.5 * (bench.value("flexure_stiffness_x") + bench.value("flexure_stiffness_y"))
    tuned = math.sqrt(2.0 * stiffness / bench.tuning_inertia)
    assert tuned == pytest.approx(bench.value("spin_rate_reference"), rel=1e-3)
    assert bench.value("spin_rate_minimum") < tuned < bench.value("spin_rate_maximum")


@OTHERS
def test_another_bench_is_another_machine(bench):
    """Nothing but constants of nature and of the tests is the same."""
    same = {n for n, p in bench.parameters.items() if p.value == DEFAULT.value(n) != 0.0}
    orders = {n for n in bench.parameters if n.endswith("_filter_order")}  # one pole, where there is a filter
    assert same - orders == {"tilt_scale", "spin_angle_noise", "spin_rate_noise", "temperature_noise", "pressure_noise",
                    "air_temperature"}  # fmt: skip
    assert bench.axial_inertia < 0.05 * DEFAULT.axial_inertia


# --- the loops -----------------------------------------------------------------------------------------------


def hold(bench: Bench, spin: float, tilt: float) -> tuple[Run, Plan]:
    """Run a hold at a tilt about x on a machine without noise."""
    quiet = {n: 0.0 for n in bench.parameters if n.endswith(("_noise", "_drift"))}
    plan = Plan.load(
        "schema: 1\nname: hold\nhold_s: 2.0\ntilt_rate_deg_s: 6.0\nsegments:\n"
        f"  - {{spin_rpm: {spin / RPM}, tilt_deg: [[0, 0], [{tilt / DEG}, 0]]}}\n"
    )
    return simulate(bench, Scenario(values=quiet), plan), plan


@EACH
@pytest.mark.parametrize("part", [0.0, 0.5, 1.0])
def test_one_set_of_gains_serves_every_bench(bench, part):
    """A ramp to most of the tilt limit settles within half a second, at every speed."""
    low, high = bench.value("spin_rate_minimum"), bench.value("spin_rate_maximum")
    spin, tilt = low + part * (high - low), 0.6 * bench.value("tilt_limit")
    run, plan = hold(bench, spin, tilt)
    segment = plan.segments[1]
    settled = run.measurement[round((segment.start + segment.ramp + 0.5) / bench.sample_period) :]
    error = settled[:, 0] + 1j * settled[:, 1] - tilt
    assert np.abs(error).max() < 0.02 * DEG
    assert np.abs(settled[:, 3].mean() / spin - 1.0) < 1e-3


# --- sizes of effects ----------------------------------------------------------------------------------------


def measures(bench: Bench) -> dict[str, float]:
    """Return what sizes can be compared with, by unit."""
    v = bench.value
    torque = v("flexure_stiffness_x") * v("tilt_reference")
    tilt, rate = v("tilt_reference"), v("spin_rate_reference")
    return {
        "N*m": torque,
        "N*m/rad": torque / tilt,
        "N*m/rad^3": torque / tilt**3,
        "N*m*s/rad": torque / rate / tilt,
        "kg*m^2": torque / rate**2,
        "rad": tilt,
        "1/rad^2": 1.0 / tilt**2,
        "s": 1.0 / rate,
        "ohm": v("motor_constant") ** 2 * rate / torque,
        "N*m/V": torque / (v("motor_constant") * rate),
        "1": 1.0,
        "1/K": 1.0,
        "rad/s": 1.0,
    }


@OTHERS
@pytest.mark.parametrize("effect", registry().values(), ids=lambda effect: effect.name)
def test_effects_scale_with_the_flexure_torque_of_a_bench(effect, bench):
    own, default = measures(bench), measures(DEFAULT)
    sized = for_bench(effect, bench)
    assert replace(sized, coefficients=effect.coefficients) == effect
    for c, was in zip(sized.coefficients, effect.coefficients, strict=True):
        for pair, before in ((c.usual, was.usual), (c.bounds, was.bounds)):
            expected = np.array(before) * own[c.unit] / default[c.unit]
            np.testing.assert_allclose(pair, expected, rtol=1e-9)
        assert (c.signed, c.unit) == (was.signed, was.unit)
        # times and ways in which a state follows are those of the bench; exponents are not
        ratio = own[c.unit] / default[c.unit] if c.unit != "1" else 1.0
        assert c.shape == (None if was.shape is None else pytest.approx(was.shape * ratio))
        low, high = c.usual
        assert low <= c.default <= high


def test_scaling_changes_nothing_on_the_default_bench():
    assert all(for_bench(effect, DEFAULT) is effect for effect in registry().values())
    assert torque_scale(DEFAULT) == 1.0
    assert torque_scale(DTG) == pytest.approx(0.0882, abs=1e-4)


def test_drawn_and_default_coefficients_are_scaled_to_the_bench():
    effect = registry()["windage"]
    low, high = for_bench(effect, DTG).coefficients[0].usual
    assert high < 0.2 * effect.coefficients[0].usual[0]
    assert low <= parse_option("windage", bench=DTG)[1]["w"] <= high
    assert parse_option("windage:w=0.0002", bench=DTG)[1]["w"] == 0.0002
    assert get("windage", bench=DTG) == for_bench(effect, DTG)
    rng = np.random.default_rng(1)
    assert all(low <= draw_effect(for_bench(effect, DTG), rng)["w"] <= high for _ in range(20))
    for seed in range(20):
        for name, values in draw(DTG, seed, kinds=("single",)).effects.items():
            known = {c.name: c for c in for_bench(registry()[name], DTG).coefficients}
            for key, value in values.items():
                least, most = known[key].usual
                assert least * (1 - 1e-9) <= abs(value) <= most * (1 + 1e-9)


def test_user_defined_effect_keeps_its_stated_sizes():
    own: Effect = effect_from_text("own: torque = -k*z; k = 0.02 [N*m/rad]")
    assert get("own", declared={"own": own}, bench=DTG) is own
