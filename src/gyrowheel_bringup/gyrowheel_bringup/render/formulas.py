"""Formulas with Greek letters and raised digits in place of their spelled names."""

from __future__ import annotations

import re

_NAMES = {
    "Omega_ref": "Ω₀",
    "Omega": "Ω",
    "rho_ref": "ρ₀",
    "rho": "ρ",
    "theta_rate": "θ'",
    "theta": "θ",
    "z_rate": "z'",
    "z_ref": "z₀",
    "T_coil": "T_coil",
    "T_ref": "T₀",
    "conjugate(z)": "z*",
}
_RAISED = str.maketrans("0123456789-n", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻ⁿ")
_TARGETS = {
    "rotor_torque": "torque on the rotor",
    "axial_torque": "torque along the spin axis",
    "shaft_torque": "torque on the shaft",
    "flexure_torque": "torque of each flexure",
    "coil_gain": "relative change of the torque per volt",
    "tilt_reading": "error of the tilt reading",
}


def pretty(formula: str) -> str:
    """Return a formula as people write it: ``-k·(Ω/Ω₀)ⁿ·z``.

    Parameters
    ----------
    formula : str
        As an effect declares it: ASCII names, ``*`` and ``^``; several are separated by ``; ``.
    """
    return "; ".join(_one(part) for part in formula.split("; "))


def _one(formula: str) -> str:
    target, equals, law = formula.partition(" = ")
    if not equals:
        target, law = "", formula
    law = law.replace("conjugate(z)", "\0")
    law = re.sub(r"[A-Za-z_]+", lambda match: _NAMES.get(match.group(), match.group()), law)
    law = law.replace("(-1 + n)", "(n-1)")
    law = re.sub(r"\^\((n-1)\)", "ⁿ⁻¹", law)
    law = re.sub(r"\^(\d+|n\b)", lambda match: match.group(1).translate(_RAISED), law)
    law = law.replace("*", "·").replace("\0", "z*")
    law = re.sub(r"(?<![\w)])-", "−", law)
    law = law.replace("z·z*", "|z|²").replace("sqrt(|z|²)", "|z|").replace("(|z|²)^(3/2)", "|z|³")
    law = law.replace("Max(", "max(")
    law = re.sub(r"^(−?)z·(.*)·z\*", r"\1\2·|z|²", law)
    law = re.sub(r"^(−?(?:i·)?)z·([^ ]*|.*\(.*\))$", r"\1\2·z", law)
    return f"{_TARGETS.get(target, target)} = {law}" if target else law
