"""Laws as MathML: whole, well-formed, and the same formula as the one that is typed."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest

from gyrowheel.show.formulas import in_words, typeset
from gyrowheel_sim.effects import registry


def laws(formula: str) -> list[ET.Element]:
    text = str(typeset(formula)).replace("<br>", "<br/>")
    return ET.fromstring(f"<p>{text}</p>").findall("math")


def outline(part: ET.Element) -> str:
    """Return a part of a law as a text: one of what it is and of what is in it."""
    inside = [outline(child) for child in part]
    text = (part.text or "").replace("\u2062", "*").replace("\u2061", "")
    forms = {"mfrac": "[{}/{}]", "msup": "{}^{{{}}}", "msub": "{}_{}", "msqrt": "√[{}]", "mover": "{}{}"}
    if part.tag in forms:
        return forms[part.tag].format(*inside)
    return text + "".join(inside)


@pytest.mark.parametrize(
    ("formula", "shown"),
    [
        ("rotor_torque = -k*r^n*z", "torque on the rotor=−k*r^{n}*z"),
        ("-k*(Omega/Omega_ref)^2*z", "−k*([Ω/Ω_0])^{2}*z"),
        ("(a + i*b)*Omega^2/Omega_ref^2", "[(a+i*b)*Ω^{2}/Ω_0^{2}]"),
        ("a - (b - c)*z", "a−(b−c)*z"),
        ("a*z - -b*z", "a*z−(−b*z)"),
        ("k*z*conj(z)*z", "k*|z|^{2}*z"),
        ("k*sqrt(z*conj(z))", "k*|z|"),
        ("k*(z*conj(z))^(3/2)", "k*|z|^{3}"),
        ("(a^b)^c", "(a^{b})^{c}"),
        ("exp(-theta_z)", "e^{−θ_z}"),
        ("c*max(0, abs(z) - a)*z_rate", "c*max(0,|z|−a)*z˙"),
        ("k*2*sqrt(rho/rho_ref)", "k·2*√[[ρ/ρ_0]]"),
        ("1/(2*k)", "[1/2*k]"),
    ],
)
def test_a_law_is_typeset(formula: str, shown: str) -> None:
    (law,) = laws(formula)
    assert outline(law).replace("‾", "̄") == shown


def test_every_law_of_the_library_is_typeset_with_all_its_symbols() -> None:
    for effect in registry().values():
        found = laws(effect.formula)
        assert len(found) == len(effect.laws) + len(effect.states), effect.name
        for law, shown in zip(effect.laws, found, strict=False):
            assert shown[0].text == in_words(law.target)
            letters = {part.text for part in shown.iter("mi")}
            single = {s.name for s in law.expression.free_symbols if re.fullmatch("[A-Za-z]", s.name)}
            assert single <= letters, effect.name


def test_other_texts_are_not_typeset() -> None:
    text = str(typeset("rotor_torque = a*z; a [N*m/rad]; q = 2.06 +- 1 [1]"))
    assert text.count("<math") == 1
    assert text.endswith("<br>a [N·m/rad]; q = 2.06 ± 1 [1]")
    assert str(typeset("<b>no law</b>")) == "&lt;b&gt;no law&lt;/b&gt;"
