"""Effects that other packages bring by an entry point."""

from __future__ import annotations

import dataclasses
import logging
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

from gyrowheel_sim.effects import (
    parse_option,
    registry,
)

from .every_effect import EVERY


@pytest.fixture
def distribution(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder of installed packages; the registry is read again before and after."""
    monkeypatch.syspath_prepend(str(tmp_path))
    registry.cache_clear()
    yield tmp_path
    monkeypatch.undo()
    registry.cache_clear()


def install(folder: Path, name: str, source: str, points: dict[str, str]) -> None:
    (folder / f"{name}.py").write_text(textwrap.dedent(source))
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = "".join(f"{point} = {value}\n" for point, value in points.items())
    (info / "entry_points.txt").write_text(f"[gyrowheel.effects]\n{lines}")


def test_effects_of_another_package_are_registered(distribution: Path) -> None:
    source = """
        from gyrowheel_sim.effects import effect_from_text
        PULL = effect_from_text("plugin_pull: torque = -k*z; k = 0.01 [N*m/rad]")
        MORE = [effect_from_text("plugin_drag: shaft_torque = -m*r; m [N*m]")]
    """
    install(distribution, "gw_plugin", source, {"pull": "gw_plugin:PULL", "more": "gw_plugin:MORE"})
    assert {"plugin_pull", "plugin_drag", "windage"} <= set(registry())
    assert parse_option("plugin_pull:k=0.02") == ("plugin_pull", {"k": 0.02})


#: A package with laws that remember: one that is good, and one that grows without limit.
MEMORY = """
import sympy as sp
from gyrowheel_sim.effects import Coefficient, Effect, Law, LawState
from gyrowheel_sim.effects.quantities import z_rate
F, b = sp.symbols("F b", real=True)
s = sp.Symbol("s", complex=True)
EFFECTS = [
    Effect(
        name=name, title="cable", category="flexure", sentence="It slips.", laws=(Law("rotor_torque", -F * s),),
        states=(LawState("s", "1", (z_rate + sign * s * sp.Abs(z_rate)) / b + (sign + 1) * s, complex=True),),
        coefficients=(
            Coefficient("F", "N*m", "friction", (1e-4, 1e-3), (0.0, 0.02), "assumed"),
            Coefficient("b", "rad", "way", (0.01, 0.03), (0.002, 0.2), "assumed", shape=0.02, shape_uncertainty=0.01),
        ),
        validity="small tilts", source="assumed",
    )
    for name, sign in (("gw_cable", -1), ("gw_runaway", 1))
]
CABLE, RUNAWAY = EFFECTS
"""


def test_a_law_with_a_memory_that_cannot_be_integrated_is_left_out(
    distribution: Path, caplog: pytest.LogCaptureFixture
) -> None:
    install(distribution, "gw_memory", MEMORY, {"cable": "gw_memory:CABLE", "runaway": "gw_memory:RUNAWAY"})
    with caplog.at_level(logging.WARNING):
        known = registry()
    assert "gw_cable" in known
    assert "gw_runaway" not in known
    assert any("gw_memory:RUNAWAY" in message for message in caplog.messages)


#: A package with two effects, the second of which has a law of a wrong unit.
WRONG_UNIT = """
import sympy as sp
from gyrowheel_sim.effects import Coefficient, Effect, Law, effect_from_text
from gyrowheel_sim.effects.quantities import Omega, Omega_ref, z
k = sp.Symbol("k", real=True)
EFFECT = [
    effect_from_text("gw_good: torque = -k*z; k [N*m/rad]"),
    Effect(
        name="gw_pull", title="pull", category="other", sentence="It pulls.",
        laws=(Law("rotor_torque", -k * Omega * z),),
        coefficients=(Coefficient("k", "N*m/rad", "size", (0.01, 0.05), (-0.5, 0.5), "assumed"),),
        validity="everywhere", source="assumed",
    ),
]
"""


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("raise RuntimeError('broken')", "broken"),
        ("EFFECT = 5", "not iterable"),
        ("EFFECT = ['windage']", "is no Effect"),
        (
            "from gyrowheel_sim.effects.library.air import WINDAGE as EFFECT",
            "taken",
        ),
        ("OTHER = 1", "EFFECT"),
        (WRONG_UNIT, "gw_pull.rotor_torque: column 1: '-k*Omega*z' has the unit N*m*rad/s; N*m is needed"),
        (WRONG_UNIT.replace("Omega * ", "sp.sinh(Omega/Omega_ref) * "), "'sinh' is not a known function"),
        (WRONG_UNIT.replace('"rotor_torque"', '"coil_gain"'), "gw_pull.coil_gain: column 1"),
    ],
    ids=["raises", "number", "strings", "taken", "missing", "unit", "function", "target"],
)
def test_a_broken_package_is_skipped_with_a_warning(
    source: str,
    reason: str,
    distribution: Path,
    caplog: pytest.LogCaptureFixture,
    request: pytest.FixtureRequest,
) -> None:
    name = f"gw_broken_{request.node.callspec.id}"
    install(distribution, name, source, {"broken": f"{name}:EFFECT"})
    with caplog.at_level(logging.WARNING):
        assert set(registry()) == {effect.name for effect in EVERY[: len(registry())]}
    (record,) = caplog.records
    assert name in record.getMessage()
    assert reason in record.getMessage()


def test_a_declaration_in_python_is_checked_too() -> None:
    windage = registry()["windage"]
    coefficient = dataclasses.replace(windage.coefficients[0], name="r")
    with pytest.raises(ValueError, match="which is taken"):
        dataclasses.replace(windage, coefficients=(coefficient,), laws=())
