"""Laws that nobody has written down: drawn by their seed, finite, and without anything of the search."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrowheel.campaigns import reality
from gyrowheel.campaigns.cases import Campaign, cases
from gyrowheel.campaigns.hidden import hide, yardstick
from gyrowheel.campaigns.reality import STRANGE, Strange, strange_effect
from gyrowheel_sim.effects.dimensions import check_effect
from gyrowheel_sim.effects.law_code import array_law
from gyrowheel_sim.effects.quantities import QUANTITIES

from .helpers import DRAG_PLAN, OTHER_PLAN


@pytest.mark.parametrize("kind", STRANGE)
@pytest.mark.parametrize("seed", range(6))
def test_drawn_law_is_finite_of_a_torque_and_the_same_for_its_seed(kind: Strange, seed: int) -> None:
    effect, values = strange_effect(kind, np.random.default_rng(seed))
    assert (effect, values) == strange_effect(kind, np.random.default_rng(seed))
    assert values.keys() == {c.name for c in effect.coefficients}
    check_effect(effect)
    z = 0.05 * np.exp(1j * np.linspace(0.0, 6.0, 50)) * np.linspace(0.0, 1.0, 50)
    at = dict.fromkeys(QUANTITIES, 0.0) | {"z": z, "z_ref": 0.0524, "Omega_ref": 366.5}
    at |= {state.name: 1.0 for state in effect.states}
    torque = array_law(effect, 0)({**at, "Omega": np.linspace(105.0, 420.0, 50), **values})
    assert np.isfinite(torque).all()
    assert 0.0 < np.abs(torque).max() < 0.5


def test_fields_of_a_kind_are_one_law_so_that_one_plant_is_compiled() -> None:
    first, second = (strange_effect("rotor_field", np.random.default_rng(seed))[0] for seed in (1, 2))
    assert first == second


def test_strange_laws_share_nothing_with_the_search() -> None:
    tree = ast.parse(Path(reality.__file__).read_text(encoding="utf-8"))
    imported = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    imported += [
        alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names
    ]
    assert not [name for name in imported if "analysis" in name or "torque_map" in name]


def test_campaign_hides_strange_laws_among_those_outside_the_library_with_reality_alone() -> None:
    campaign = Campaign(DRAG_PLAN, OTHER_PLAN, seed=5, kinds=("outside",), reality=True)
    measure = yardstick(campaign.bench, campaign.plan)
    secrets = [hide(case, measure) for case in cases(campaign, 13)]
    names = {name for secret in secrets for name in secret.truth}
    assert {f"strange_{kind}" for kind in STRANGE} <= names
    for secret in secrets:
        assert set(secret.truth) <= {*secret.scenario.declared, "speed_bump", "three_lobed", "contact"}
    plain = cases(replace(campaign, reality=False), 13)
    assert not [name for case in plain for name in hide(case, measure).truth if name.startswith("strange")]
