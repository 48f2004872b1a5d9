"""A free form whose exponents are whole numbers within their errors is offered as that simple law too."""

from __future__ import annotations

import pytest

from gyrowheel.show.sentences.diagnosis import simple_sentence
from gyrowheel_analysis.diagnosis.estimates import Estimate
from gyrowheel_analysis.diagnosis.findings import FreeForm
from gyrowheel_analysis.diagnosis.free_forms import forms, whole_exponents, with_exponents
from gyrowheel_sim.effects.user_defined_line import effect_to_line, typed_effect

Found = dict[str, tuple[float, float]]


@pytest.mark.parametrize(
    ("name", "found", "whole", "law"),
    [
        (
            "power_1_1",
            {"k": (1.03, 0.04), "q": (1.16, 0.1)},
            {"k": 1, "q": 1},
            "torque = (a + i*b)*z/z_ref*r",
        ),
        (
            "power_3_1",
            {"k": (2.98, 0.05), "q": (0.02, 0.1)},
            {"k": 3, "q": 0},
            "torque = (a + i*b)*z^2*conj(z)/z_ref^3",
        ),
        ("power_0_2", {"k": (0.04, 0.05), "q": (2.02, 0.1)}, {"k": 0, "q": 2}, ""),
        ("spin_power_3", {"q": (3.0, 0.01)}, {"q": 3}, "shaft_torque = a*r^3"),
        ("power_1_1", {"k": (1.03, 0.04), "q": (1.4, 0.1)}, {}, ""),  # one is not whole
        ("power_1_1", {"k": (1.03, 0.04), "q": (1.16, 0.4)}, {}, ""),  # one is hardly known
        ("dead_zone_0_4", {"p": (1.0, 0.01)}, {}, ""),  # an edge is no exponent
    ],
)
def test_whole_exponents_make_a_law_that_can_be_typed(
    name: str, found: Found, whole: dict[str, int], law: str
) -> None:
    (effect,) = (term.effect for term in forms() if term.name == name)
    assert effect is not None
    assert whole_exponents(effect, found) == whole
    if not whole:
        return
    amplitudes = [c.name for c in effect.coefficients if c.shape is None]
    simple = typed_effect(effect_to_line(with_exponents(effect, whole)), name="simple", where="line")
    assert [c.name for c in simple.coefficients] == amplitudes
    if law:
        units = "; ".join(f"{c} [N*m]" for c in amplitudes)
        typed = typed_effect(f"{law}; {units}", name="other", where="line")
        (own,), (other,) = simple.laws, typed.laws
        assert (own.expression - other.expression).expand() == 0


def test_the_sentence_has_the_exponents_that_were_found() -> None:
    exponents = {"k": Estimate(1.03, 0.04, "1"), "q": Estimate(1.16, 0.1, "1")}
    form = FreeForm("law", 50.0, exponents, "torque along the tilt", simple="simple", whole={"k": 1, "q": 1})
    said = simple_sentence(form)
    assert "k = 1 (1.030 ± 0.040), q = 1 (1.16 ± 0.10)" in said
    assert simple_sentence(FreeForm("law", 50.0, exponents, "torque along the tilt")) == ""
