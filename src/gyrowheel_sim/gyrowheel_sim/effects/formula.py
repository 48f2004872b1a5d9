"""Formulas of effects, between text and SymPy: printed, and read as `gyrowheel_sim.effects.grammar` allows."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import sympy as sp
from sympy.core.sorting import default_sort_key

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects.complex_parts import COMPONENTS, ComplexArgumentError, Parts, is_real
from gyrowheel_sim.effects.grammar import (
    COMPLEX_FUNCTIONS,
    FUNCTIONS,
    HANDY,
    LARGEST,
    MAX_LENGTH,
    MAX_POWER,
    MAX_SIZE,
    Node,
    error_at,
    parts_of,
    shortened,
)
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


@dataclass(frozen=True)
class Formula:
    """A formula that was read: its text, its parts with their places, and the SymPy expression."""

    text: str
    where: str
    node: Node
    expression: sp.Expr = field(compare=False)
    two: frozenset[str] = frozenset()  # names of complex numbers besides the quantities

    @property
    def real(self) -> bool:
        """Whether it is real; raises InputError if a part of it would have to be real, and is not."""
        try:
            return is_real(self.expression)
        except ComplexArgumentError as error:
            part = shortened(to_text(error.argument), 60)
            raise self.error(self.node, f"'{part}' is complex where a real number is needed") from None

    def error(self, node: Node, message: str) -> InputError:
        """Return the error that names a place in this formula."""
        return error_at(self.where, node.start, message)

    def shown(self, node: Node) -> str:
        """Return the text of a part, for messages."""
        return shortened(self.text[node.start : node.end])

    def with_numbers(self, numbers: Mapping[str, int]) -> Formula:
        """Return the formula with numbers in place of some coefficients.

        Raises
        ------
        InputError
            If it has no value any more.
        """
        node = _replaced(self.node, numbers)
        return replace(self, node=node, expression=_Builder(self.text, self.where, self.two).build(node))

    def value(self, node: Node) -> float:
        """Return the value of a part that is made of numbers alone."""
        return float(_Builder(self.text, self.where).build(node))


def parse(text: str, names: Collection[str] = (), where: str = "formula") -> sp.Expr:
    """Return the expression of a formula.

    Parameters
    ----------
    text : str
        The formula.
    names : collection of str
        Names of the coefficients in it.
    where : str
        What messages begin with.

    Raises
    ------
    InputError
        If the text is no formula, has an unknown name, is too long or too deeply nested, or a number or power in it
        is too large; the message has the column.
    """
    return read(text, names, where).expression


def read(
    text: str, names: Collection[str] = (), where: str = "formula", two: Collection[str] = ()
) -> Formula:
    """Return a formula with the places of its parts; see `parse`. `two` are the names of complex numbers."""
    if not isinstance(text, str):
        raise InputError(f"{where}: {shortened(repr(text))} is not a formula; a text is expected")
    if len(text) > MAX_LENGTH:
        raise InputError(f"{where}: the formula has {len(text)} characters; allowed: up to {MAX_LENGTH}")
    node = parts_of(text, names, where)
    size, _ = _size(node, {*_COMPLEX_NAMES, *two})
    if size > MAX_SIZE:
        raise InputError(
            f"{where}: the formula is too complicated: it needs {size} operations, allowed: {MAX_SIZE}; "
            "lower a power of a complex number, or multiply fewer of them"
        )
    complex_ = frozenset(two)
    expression = _settled(_Builder(text, where, complex_).build(node), frozenset(names), complex_)
    return Formula(text, where, node, expression, complex_)


def _replaced(node: Node, numbers: Mapping[str, int]) -> Node:
    if node.kind == "name" and node.name in numbers:
        return Node("number", node.start, node.end, number=sp.Integer(numbers[node.name]))
    return replace(node, items=tuple(_replaced(item, numbers) for item in node.items))


def _settled(expression: sp.Expr, names: frozenset[str], two: frozenset[str]) -> sp.Expr:
    """Return the expression as it reads after printing: SymPy simplifies some forms only when they are built again."""
    with contextlib.suppress(InputError):
        for _ in range(4):
            text = to_text(expression)
            again = _Builder(text, "", two).build(parts_of(text, names, ""))
            if again == expression:
                break
            expression = again
    return expression


_COMPLEX_NAMES = (*(symbol.name for symbol in COMPONENTS), "i")


def _size(node: Node, two: Collection[str]) -> tuple[int, bool]:
    """Return how large real and imaginary part will be, and whether there is an imaginary one.

    A product of complex numbers holds each of them twice, so products within products grow fast.
    """
    if not node.items:
        return 1, node.name in two
    parts = [_size(item, two) for item in node.items]
    total, mixed = sum(size for size, _ in parts), any(part[1] for part in parts)
    if node.kind == "product" and mixed:
        real = sum(size for size, complex_ in parts if not complex_)
        several = [size for size, complex_ in parts if complex_]
        return _multiplied(several) + 2 * real + 2 * sum(several) * any(node.inverse), True
    if node.kind == "power" and parts[0][1] and node.items[1].constant:
        base = parts[0][0]
        times, negative = _whole(node.items[1])
        if times is None:  # allowed for real numbers alone
            return total, False
        size = base
        for digit in bin(min(times, MAX_POWER))[3:]:
            size = _multiplied([size, size] + [base] * (digit == "1"))
        return size + 2 * base * negative, True
    if node.kind == "call":
        if node.name == "exp" and mixed:
            return 2 * total + 2, True
        return total + 1, mixed and node.name == "conj"
    return total, mixed


def _whole(node: Node) -> tuple[int | None, bool]:
    """Return the size of a written whole number, and whether it is negative; None for anything else."""
    negative = node.kind == "product" and len(node.items) == 1
    number = node.items[0].number if negative else node.number
    if number is None or not (number.is_Integer or float(number).is_integer()):
        return None, negative
    return int(number), negative


def _multiplied(sizes: list[int]) -> int:
    result = sizes[0]
    for size in sizes[1:]:
        result = 2 * (result + size)
    return result


def _vanishes(node: Node, expression: sp.Expr) -> bool:
    """Whether an expression is zero; SymPy leaves the smallest of some numbers, and the like, as it was written."""
    return bool(expression == 0 or (node.constant and sp.Abs(expression).evalf(15) == 0))


class _Builder:
    """From the parts of a formula to a SymPy expression; what a computation could not use is refused."""

    def __init__(self, text: str, where: str, two: frozenset[str] = frozenset()) -> None:
        self.text, self.where, self.two = text, where, two
        self.memo: dict[sp.Expr, Parts] = {}

    def fail(self, node: Node, message: str) -> InputError:
        return error_at(self.where, node.start, message)

    def shown(self, node: Node) -> str:
        return shortened(self.text[node.start : node.end])

    def build(self, node: Node) -> sp.Expr:
        result = getattr(self, f"_{node.kind}")(node)
        if result.has(sp.zoo, sp.nan, sp.oo, -sp.oo):
            raise self.fail(node, f"'{self.shown(node)}' is not finite")
        if node.constant and node.items:
            size = sp.Abs(result).evalf(15)
            if not size.is_Number or size > LARGEST:
                raise self.fail(node, f"'{self.shown(node)}' is not a finite number below 1e100")
        return result

    def _number(self, node: Node) -> sp.Expr:
        return node.number

    def _name(self, node: Node) -> sp.Expr:
        if node.name in QUANTITIES:
            return QUANTITIES[node.name].symbol
        if node.name in self.two:
            return sp.Symbol(node.name, complex=True)
        return HANDY.get(node.name, sp.Symbol(node.name, real=True))

    def _sum(self, node: Node) -> sp.Expr:
        # products are built whole with their sign: SymPy would multiply a sign into a sum
        terms = []
        for item, subtracted in zip(node.items, node.inverse, strict=True):
            if item.kind == "product" and subtracted:
                terms.append(sp.Mul(sp.S.NegativeOne, *self._factors(item)))
            else:
                terms.append(-self.build(item) if subtracted else self.build(item))
        return sp.Add(*terms)

    def _product(self, node: Node) -> sp.Expr:
        return sp.Mul(*self._factors(node))

    def _factors(self, node: Node) -> list[sp.Expr]:
        factors = [node.number] if node.number is not None else []
        for item, divides in zip(node.items, node.inverse, strict=True):
            factor = self.build(item)
            if divides and _vanishes(item, factor):
                raise self.fail(item, f"division by '{self.shown(item)}', which is zero")
            factors.append(1 / factor if divides else factor)
        return factors

    def _power(self, node: Node) -> sp.Expr:
        base, exponent = (self.build(item) for item in node.items)
        if node.items[1].constant:
            if not exponent.is_real or abs(exponent) > MAX_POWER:
                raise self.fail(
                    node.items[1],
                    f"the power '{self.shown(node.items[1])}' is out of range; allowed: -{MAX_POWER} .. {MAX_POWER}",
                )
            if exponent.is_Float and float(exponent).is_integer() and not self._is_real(base):
                exponent = sp.Integer(int(exponent))
            if exponent < 0 and _vanishes(node.items[0], base):
                raise self.fail(node, f"'{self.shown(node)}' is not finite")
        if not exponent.is_Integer:
            self._must_be_real(node.items[0], base, "the base of a power that is no whole number")
            self._must_be_real(node.items[1], exponent, "an exponent")
        return sp.Pow(base, exponent)

    def _call(self, node: Node) -> sp.Expr:
        arguments = [self.build(item) for item in node.items]
        if node.name not in COMPLEX_FUNCTIONS:
            for item, argument in zip(node.items, arguments, strict=True):
                self._must_be_real(item, argument, f"the argument of {node.name}")
        if node.name in ("re", "im") and self._is_real(arguments[0]):
            return arguments[0] if node.name == "re" else sp.S.Zero
        return FUNCTIONS[node.name](*arguments)

    def _must_be_real(self, node: Node, expression: sp.Expr, what: str) -> None:
        if not self._is_real(expression):
            raise self.fail(
                node, f"'{self.shown(node)}' is complex, but {what} must be real: use abs, re or im"
            )

    def _is_real(self, expression: sp.Expr) -> bool:
        try:
            return is_real(expression, self.memo)
        except ComplexArgumentError:  # SymPy made a power of a complex number of it
            return False
