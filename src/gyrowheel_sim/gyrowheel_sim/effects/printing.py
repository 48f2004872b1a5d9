"""The one printer of formulas: SymPy expressions as text that `gyrowheel_sim.effects.formula.read` reads back."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from typing import Any

import sympy as sp
from sympy.core.sorting import default_sort_key

from gyrowheel_sim.effects.grammar import FUNCTIONS
from gyrowheel_sim.effects.quantities import QUANTITIES, z

_SUM, _PRODUCT, _POWER, _ATOM = range(4)
_FUNCTION_NAMES = {
    function.func if isinstance(function, functools.partial) else function: name
    for name, function in FUNCTIONS.items()
}


def to_text(expression: sp.Expr) -> str:
    """Return an expression as a formula that `formula.parse` reads back into the same expression.

    Coefficients come first and the tilt last. A function that the grammar does not have is printed as SymPy does.
    """
    return _text(expression)[0]


def _wrapped(expression: sp.Expr, least: int) -> str:
    text, level = _text(expression)
    return text if level >= least else f"({text})"


def _text(e: sp.Expr) -> tuple[str, int]:
    """Return the text and how tightly it binds."""
    if e.is_Symbol:
        return e.name, _ATOM
    if e.is_Float:
        value = float(e)
        return repr(value), _ATOM if math.copysign(1.0, value) > 0.0 else _PRODUCT
    if e.is_Rational:
        return str(e), _ATOM if e.is_Integer and e >= 0 else _PRODUCT
    if e in (sp.I, sp.pi):
        return ("i" if e is sp.I else "pi"), _ATOM
    if e is sp.E:
        return "exp(1)", _ATOM
    if e.is_Add:
        return _sum_text(e), _SUM
    if e.is_Mul:
        return _product_text(e), _PRODUCT
    if isinstance(e, sp.Pow):
        if e.exp.is_number and e.exp.is_negative:
            return _product_text(e), _PRODUCT
        if e.exp == sp.S.Half:
            return f"sqrt({to_text(e.base)})", _ATOM
        return f"{_wrapped(e.base, _ATOM)}^{_wrapped(e.exp, _ATOM)}", _POWER
    if e.func in _FUNCTION_NAMES:
        arguments = e.args
        if len(arguments) > 1:
            arguments = sorted(arguments, key=lambda a: (a.is_number, default_sort_key(a)))
        return f"{_FUNCTION_NAMES[e.func]}({', '.join(map(to_text, arguments))})", _ATOM
    return sp.sstr(e), _ATOM if e.is_Atom or e.is_Function else _SUM


def _sum_text(e: sp.Expr) -> str:
    texts = signless_first(_text(term)[0] for term in ordered_terms(e))
    return "".join(
        [texts[0]] + [f" - {text[1:]}" if text.startswith("-") else f" + {text}" for text in texts[1:]]
    )


def _product_text(e: sp.Expr) -> str:
    number, rest = e.as_coeff_Mul()
    over: list[sp.Expr] = []
    under: list[sp.Expr] = []
    for factor in sp.Mul.make_args(rest):
        if isinstance(factor, sp.Pow) and factor.exp.is_number and factor.exp.is_negative:
            under.append(sp.Pow(factor.base, -factor.exp))
        elif factor is not sp.S.One:
            over.append(factor)
    sign = "-" if number.is_negative else ""
    size = abs(number)
    over.sort(key=factor_place)
    under.sort(key=default_sort_key)
    if size.is_Float or size.p != 1 or not over:
        over.insert(0, size if size.is_Float else sp.Integer(size.p))
    if not size.is_Float and size.q != 1:
        under.insert(0, sp.Integer(size.q))
    text = sign + "*".join(_wrapped(factor, _PRODUCT) for factor in over)
    if len(under) > 1:
        return f"{text}/({'*'.join(_wrapped(factor, _PRODUCT) for factor in under)})"
    return f"{text}/{_wrapped(under[0], _POWER)}" if under else text


def ordered_terms(e: sp.Add) -> list[sp.Expr]:
    """Return the terms of a sum in the order in which people write them: real ones, numbers, imaginary ones."""
    return sorted(e.args, key=lambda term: (term.has(sp.I), term.is_number, default_sort_key(term)))


def signless_first(texts: Iterable[str]) -> list[str]:
    """Return the texts of terms so that a sum begins with one that needs no sign."""
    return sorted(texts, key=lambda text: text.startswith("-"))


def factor_place(factor: sp.Expr) -> tuple[int, Any]:
    """Return a key by which factors are sorted: i, coefficients, the rest, what has the tilt."""
    symbols = factor.free_symbols
    if factor is sp.I:
        rank = 0
    elif symbols and not any(s.name in QUANTITIES for s in symbols):
        rank = 1
    else:
        rank = 3 if z in symbols else 2
    return rank, default_sort_key(factor)
