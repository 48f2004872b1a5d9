"""Formulas as people type them, read into SymPy; see `gyrowheel_sim.effects.grammar` for what may stand in them."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import sympy as sp

from gyrowheel_core.errors import InputError
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
from gyrowheel_sim.effects.parts import ComplexArgumentError, Parts, is_real
from gyrowheel_sim.effects.printing import to_text
from gyrowheel_sim.effects.quantities import QUANTITIES


@dataclass(frozen=True)
class Formula:
    """A formula that was read: its text, its parts with their places, and the SymPy expression."""

    text: str
    where: str
    node: Node
    expression: sp.Expr = field(compare=False)

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
        return Formula(self.text, self.where, node, _Builder(self.text, self.where).build(node))

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


def read(text: str, names: Collection[str] = (), where: str = "formula") -> Formula:
    """Return a formula with the places of its parts; see `parse`."""
    if not isinstance(text, str):
        raise InputError(f"{where}: {shortened(repr(text))} is not a formula; a text is expected")
    if len(text) > MAX_LENGTH:
        raise InputError(f"{where}: the formula has {len(text)} characters; allowed: up to {MAX_LENGTH}")
    node = parts_of(text, names, where)
    size, _ = _size(node)
    if size > MAX_SIZE:
        raise InputError(
            f"{where}: the formula is too complicated: it needs {size} operations, allowed: {MAX_SIZE}; "
            "lower a power of a complex number, or multiply fewer of them"
        )
    return Formula(text, where, node, _settled(_Builder(text, where).build(node), frozenset(names)))


def _replaced(node: Node, numbers: Mapping[str, int]) -> Node:
    if node.kind == "name" and node.name in numbers:
        return Node("number", node.start, node.end, number=sp.Integer(numbers[node.name]))
    return replace(node, items=tuple(_replaced(item, numbers) for item in node.items))


def _settled(expression: sp.Expr, names: frozenset[str]) -> sp.Expr:
    """Return the expression as it reads after printing: SymPy simplifies some forms only when they are built again."""
    with contextlib.suppress(InputError):
        for _ in range(4):
            text = to_text(expression)
            again = _Builder(text, "").build(parts_of(text, names, ""))
            if again == expression:
                break
            expression = again
    return expression


def _size(node: Node) -> tuple[int, bool]:
    """Return how large real and imaginary part will be, and whether there is an imaginary one.

    A product of complex numbers holds each of them twice, so products within products grow fast.
    """
    if not node.items:
        return 1, node.name in ("z", "z_rate", "i")
    parts = [_size(item) for item in node.items]
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

    def __init__(self, text: str, where: str) -> None:
        self.text, self.where = text, where
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
