"""Formulas with Greek letters and raised digits for the terminal, and as MathML for browsers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from markupsafe import Markup, escape

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects.grammar import Node, parts_of, unknown_names
from gyrowheel_sim.effects.targets import TARGETS

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.estimates import Estimate

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
_SUM, _PRODUCT, _POWER, _ATOM = range(4)
_GREEK = {"Omega": "Ω", "rho": "ρ", "theta": "θ", "pi": "π", "phi": "φ", "tau": "τ", "omega": "ω"}
_TIMES = Markup('<mo lspace="0.1em" rspace="0.1em">&#x2062;</mo>')
_APPLIED = Markup("<mo>&#x2061;</mo>")
_MINUS = Markup('<mo form="prefix">−</mo>')
_BETWEEN = {False: Markup("<mo>+</mo>"), True: Markup("<mo>−</mo>")}


def pretty(formula: str) -> str:
    """Return one or several formulas, separated by ``; ``, as people write and type them: ``−k·(Ω/Ω₀)ⁿ·z``."""
    return "; ".join(_one(part) for part in formula.split("; "))


def in_words(target: str) -> str:
    """Return the target of a law in a few words; the left side of the rate or the start value of a state as it is."""
    if target in TARGETS:
        return TARGETS[target].words
    return target if "(" in target else target.replace("_", " ")


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


def typeset(formula: str) -> Markup:
    """Return the laws of a formula as MathML, one below the other; anything else stays text.

    Several laws are separated by ``; ``. Coefficients may be declared behind them.
    """
    laws, declared = [], []
    for part in formula.split("; "):
        target, equals, law = part.partition(" = ")
        try:
            parts = parts_of(law if equals else part, unknown_names(law if equals else part), "")
        except InputError:
            declared.append(pretty(part.replace("+-", "±")))
            continue
        if equals and parts.kind == "number":  # the start value of a coefficient
            declared.append(pretty(part.replace("+-", "±")))
            continue
        acts = Markup("{}<mo>=</mo>").format(_left(target)) if equals else Markup()
        laws.append(
            Markup('<math displaystyle="true" alttext="{}">{}{}</math>').format(
                pretty(part), acts, _row([_shown(parts)[0]])
            )
        )
    lines = [*laws, *([escape("; ".join(declared))] if declared else [])]
    return Markup("<br>").join(lines)


def _left(target: str) -> Markup:
    """Return the left side of a law: its target in words, or the derivative of a state."""
    if state := re.fullmatch(r"d\((\w+)\)/dt", target):
        top = Markup("<mi>d</mi>{}").format(_symbol(state[1]))
        return Markup("<mfrac><mrow>{}</mrow><mrow><mi>d</mi><mi>t</mi></mrow></mfrac>").format(top)
    return Markup("<mtext>{}</mtext>").format(in_words(target))


def _shown(node: Node) -> tuple[Markup, int]:
    """Return a part of a formula, and how tightly it binds."""
    if node.kind == "number":
        return Markup("<mn>{}</mn>").format(_number(node)), _ATOM
    if node.kind == "name":
        return _symbol(node.name), _ATOM
    if node.kind == "sum":
        return _sum(node), _SUM
    if node.kind == "product":
        return _product(node), _PRODUCT
    if node.kind == "power":
        return _power(node)
    return _call(node), _ATOM


def _within(node: Node, least: int) -> Markup:
    """Return a part, in brackets where it binds less tightly than its surroundings."""
    shown, level = _shown(node)
    return shown if level >= least else _bracketed(shown)


def _bracketed(shown: Markup, left: str = "(", right: str = ")") -> Markup:
    return Markup("<mrow><mo>{}</mo>{}<mo>{}</mo></mrow>").format(left, shown, right)


def _row(parts: Sequence[Markup]) -> Markup:
    return parts[0] if len(parts) == 1 else Markup("<mrow>{}</mrow>").format(Markup().join(parts))


def _number(node: Node) -> str:
    text = f"{float(node.number):g}" if node.number is not None else ""
    return text.replace("-", "−")


def _sum(node: Node) -> Markup:
    parts = [_within(node.items[0], _PRODUCT)]
    for item, minus in zip(node.items[1:], node.inverse[1:], strict=True):
        own = item.kind == "product" and item.number is not None  # has another sign behind that of the sum
        parts += [_BETWEEN[minus], _within(item, _POWER if own else _PRODUCT)]
    return _row(parts)


def _product(node: Node) -> Markup:
    above, below = (
        [item for item, divides in zip(node.items, node.inverse, strict=True) if divides is part]
        for part in (False, True)
    )
    if below:
        top = _factors(above) if above else Markup("<mn>1</mn>")
        shown = Markup("<mfrac>{}{}</mfrac>").format(top, _factors(below))
    else:
        shown = _factors(above)
    return _row([_MINUS, shown]) if node.number is not None else shown


def _factors(items: Sequence[Node]) -> Markup:
    if len(items) == 1:  # alone above or below a bar it needs no brackets
        return _shown(items[0])[0]
    parts: list[Markup] = []
    left = list(items)
    while left:
        item = left.pop(0)
        if parts:
            parts.append(Markup("<mo>·</mo>") if item.kind == "number" else _TIMES)
        if left and _is_square((item, left[0])):
            left.pop(0)
            parts.append(_size("2"))
        else:
            own = item.kind == "product" and item.number is not None  # has another sign
            parts.append(_within(item, _POWER if own else _PRODUCT))
    return _row(parts)


def _is_square(items: Sequence[Node]) -> bool:
    """Whether factors are the tilt and its conjugate."""
    if len(items) != 2 or items[1].kind != "call" or items[1].name != "conj":
        return False
    return all(item.kind == "name" and item.name == "z" for item in (items[0], items[1].items[0]))


def _size(power: str) -> Markup:
    """Return a power of the magnitude of the tilt."""
    size = _bracketed(_symbol("z"), "|", "|")
    return size if power == "1" else Markup("<msup>{}<mn>{}</mn></msup>").format(size, power)


def _twice(exponent: Node) -> str:
    """Return twice a number that is whole or a half; empty for anything else."""
    if exponent.kind == "number":
        twice = 2.0 * float(_number(exponent).replace("−", "-"))
    elif exponent.kind == "product" and all(item.kind == "number" for item in exponent.items):
        twice = 2.0
        for item, divides in zip(exponent.items, exponent.inverse, strict=True):
            twice *= float(_number(item).replace("−", "-")) ** (-1 if divides else 1)
        twice *= -1.0 if exponent.number is not None else 1.0
    else:
        return ""
    return f"{twice:g}".replace("-", "−") if twice == round(twice) else ""


def _power(node: Node) -> tuple[Markup, int]:
    base, exponent = node.items
    if base.kind == "product" and base.number is None and _is_square(base.items) and _twice(exponent):
        return _size(_twice(exponent)), _POWER
    shown = _within(base, _ATOM)
    return Markup("<msup>{}{}</msup>").format(shown, _shown(exponent)[0]), _POWER


def _call(node: Node) -> Markup:
    inner = [_shown(item)[0] for item in node.items]
    if node.name == "abs":
        return _bracketed(inner[0], "|", "|")
    if node.name == "sqrt" and node.items[0].kind == "product" and _is_square(node.items[0].items):
        return _size("1")
    if node.name == "sqrt":
        return Markup("<msqrt>{}</msqrt>").format(inner[0])
    if node.name == "conj":
        return Markup('<mover accent="true">{}<mo>‾</mo></mover>').format(inner[0])
    if node.name == "exp":
        return Markup("<msup><mi>e</mi>{}</msup>").format(inner[0])
    listed = Markup("<mo>,</mo>").join(inner)
    return _row([Markup("<mi>{}</mi>").format(node.name), _APPLIED, _bracketed(listed)])


def _symbol(name: str) -> Markup:
    """Return a quantity or a coefficient: an index behind its letter, a dot above it for its rate."""
    if name.endswith("_rate"):
        letter = _symbol(name.removesuffix("_rate"))
        return Markup('<mover accent="true">{}<mo>˙</mo></mover>').format(letter)
    base, _, index = name.partition("_")
    letter = Markup("<mi>{}</mi>").format(_GREEK.get(base, base))
    if not index:
        return letter
    below = "0" if index == "ref" else re.sub("_", " ", index)
    tag = Markup("<mn>{}</mn>") if below.isdigit() else Markup("<mi>{}</mi>")
    return Markup("<msub>{}{}</msub>").format(letter, tag.format(below))


def is_pure(effect: str, coefficient: str, estimate: Estimate | None = None) -> bool:
    """Whether a coefficient without unit shapes the law of an effect (an exponent).

    That of a user-defined effect is known by its `estimate`: only what shapes a law has a prior.
    """
    from gyrowheel_sim.effects import registry

    if (known := registry().get(effect)) is None:
        return estimate is not None and estimate.prior is not None
    return any(c.name == coefficient for c in known.shapes)
