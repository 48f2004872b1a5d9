"""Formulas with Greek letters and raised digits in place of their spelled names."""

from __future__ import annotations

import re

from gyrowheel_sim.effects.targets import TARGETS

_NAMES = {
    "Omega_ref": "Ω₀",
    "Omega": "Ω",
    "rho_ref": "ρ₀",
    "rho": "ρ",
    "theta_z": "θ_z",
    "theta_rate": "θ'",
    "theta": "θ",
    "z_rate": "z'",
    "z_ref": "z₀",
    "T_ref": "T₀",
}
_CONJUGATE = "z\u0304"
_RAISED = str.maketrans("0123456789-n", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻ⁿ")


def pretty(formula: str) -> str:
    """Return a formula as people write it, ``−k·(Ω/Ω₀)ⁿ·z``, and as it can be typed in.

    Parameters
    ----------
    formula : str
        As an effect declares it: ASCII names, ``*`` and ``^``; several are separated by ``; ``.
    """
    return "; ".join(_one(part) for part in formula.split("; "))


def in_words(target: str) -> str:
    """Return the target of a law in a few words."""
    return TARGETS[target].words if target in TARGETS else target.replace("_", " ")


def plain(text: str) -> str:
    """Return a formula with the names of its targets, where it may have them in the words of `pretty`."""
    for target in TARGETS.values():
        text = text.replace(f"{target.words} =", f"{target.name} =")
    return text


def _one(formula: str) -> str:
    target, equals, law = formula.partition(" = ")
    if not equals:
        target, law = "", formula
    law = law.replace("conj(z)", _CONJUGATE)
    law = re.sub(r"[A-Za-z_]+", lambda match: _NAMES.get(match.group(), match.group()), law)
    law = law.replace("^(n - 1)", "ⁿ⁻¹")
    law = re.sub(r"\^(\d+|n)(?![\w.])", lambda match: match.group(1).translate(_RAISED), law)
    law = law.replace("*", "·")
    law = re.sub(r"(?<![\w)])-", "−", law)
    law = re.sub(rf"\bz·{_CONJUGATE}(?![⁰-⁹²³])", "|z|²", law)
    law = law.replace("sqrt(|z|²)", "|z|").replace("(|z|²)^(3/2)", "|z|³")
    return f"{in_words(target)} = {law}" if target else law
