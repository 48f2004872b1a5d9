"""Formulas with Greek letters and raised digits in place of their spelled names."""

from __future__ import annotations

import re

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
_TARGETS = {
    "rotor_torque": "torque on the rotor",
    "axial_torque": "torque along the spin axis",
    "shaft_torque": "torque on the shaft",
    "flexure_torque": "torque of each flexure",
    "inertia_difference": "difference of the moments of inertia",
    "case_rate": "rate of the case",
    "coil_gain": "relative change of the torque per volt",
    "coil_anisotropy": "mirrored part of the torque of the coils",
    "coil_lag": "lag of the coils",
    "motor_gain": "relative change of the motor constant",
    "winding_resistance": "relative change of the winding resistance",
    "supply_drop": "fall of the supply",
    "tilt_reading": "error of the tilt reading",
}


def pretty(formula: str) -> str:
    """Return a formula as people write it, ``−k·(Ω/Ω₀)ⁿ·z``, and as it can be typed in.

    Parameters
    ----------
    formula : str
        As an effect declares it: ASCII names, ``*`` and ``^``; several are separated by ``; ``.
    """
    return "; ".join(_one(part) for part in formula.split("; "))


def in_words(target: str) -> str:
    """Return what a law acts on in a few words."""
    return _TARGETS.get(target, target.replace("_", " "))


def plain(text: str) -> str:
    """Return a formula with the names of its targets, where it may have them in the words of `pretty`."""
    for target, words in _TARGETS.items():
        text = text.replace(f"{words} =", f"{target} =")
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
