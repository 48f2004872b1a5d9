"""Formulas as people type them: read by a small grammar into SymPy, and printed so that they can be read again.

Nothing is evaluated as Python. A formula is made of numbers, the quantities of the bench, coefficients,
``+ - * / ^`` (or ``**``), brackets, ``|x|``, and the functions of `FUNCTIONS`; ``i`` is the imaginary unit and ``r``
the spin rate over its reference. The signs that the project shows (``Ω``, ``θ'``, ``ρ₀``, ``·``, ``z²``) are read too.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import math
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any, Literal

import sympy as sp
from sympy.core.sorting import default_sort_key

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects.parts import COMPONENTS, ComplexArgumentError, Parts, is_real
from gyrowheel_sim.effects.quantities import QUANTITIES, Omega, Omega_ref, z

MAX_LENGTH = 1000
MAX_DEPTH = 30
MAX_POWER = 20
#: Largest number of operations that a formula may need once real and imaginary part are written out.
MAX_SIZE = 1000
_LARGEST = 1e100
_SHOWN = 40  # characters of a formula that a message repeats


def _unevaluated(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that leaves its arguments alone.

    SymPy expands powers to find real parts, and compares the arguments of a maximum in pairs: minutes for long ones.
    """
    return functools.partial(function, evaluate=False)


#: Names that are always there, beside the quantities.
HANDY: dict[str, sp.Expr] = {"r": Omega / Omega_ref, "i": sp.I, "pi": sp.pi}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "conj": sp.conjugate,
    "abs": sp.Abs,
    "re": _unevaluated(sp.re),
    "im": _unevaluated(sp.im),
    "sign": sp.sign,
    "sqrt": sp.sqrt,
    "exp": sp.exp,
    "log": sp.log,
    "sin": sp.sin,
    "cos": sp.cos,
    "tanh": sp.tanh,
    "max": _unevaluated(sp.Max),
    "min": _unevaluated(sp.Min),
}
_SEVERAL = ("max", "min")
_COMPLEX = ("conj", "abs", "re", "im", "exp")
#: Names that no coefficient may have.
RESERVED = frozenset(
    (
        *QUANTITIES,
        *HANDY,
        *FUNCTIONS,
        *(part.name for pair in COMPONENTS.values() for part in pair),  # names in the compiled code
        *("conjugate", "real", "imag", "maximum", "minimum"),
        "declaration",  # fields of the model file
        "value",
        "standard_error",
    )
)
#: What the name of a coefficient or of an effect looks like.
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")

_SIGNS = {
    "Ω₀": "Omega_ref",
    "Ω": "Omega",
    "ρ₀": "rho_ref",
    "ρ": "rho",
    "θ_z": "theta_z",
    "θ'": "theta_rate",
    "θ": "theta",
    "z₀": "z_ref",
    "z'": "z_rate",
    "T₀": "T_ref",
}
_CONJUGATE = "z\u0304"
_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺ⁿ", "0123456789-+n")
_OPERATORS = {"**": "^", "·": "*", "×": "*", "⋅": "*", "−": "-"}
_TOKEN = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    rf"|(?P<name>{_CONJUGATE}|{'|'.join(_SIGNS)}|[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<raised>[⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺ⁿ]+)"
    r"|(?P<operator>\*\*|[-+*/^(),|·×⋅−])"
)

Kind = Literal["number", "name", "sum", "product", "power", "call"]


@dataclass(frozen=True)
class Node:
    """A part of a formula with its place in the text.

    Attributes
    ----------
    kind : str
        ``number``, ``name``, ``sum``, ``product``, ``power`` (base, exponent) or ``call``.
    start, end : int
        Where it stands in the text.
    items : tuple of Node
        What it is made of.
    inverse : tuple of bool
        For every item of a sum whether it is subtracted, of a product whether it divides.
    name : str
        The name, or the function.
    number : sympy number or None
        The number; of a product its sign where that is negative.
    """

    kind: Kind
    start: int
    end: int
    items: tuple[Node, ...] = ()
    inverse: tuple[bool, ...] = ()
    name: str = ""
    number: sp.Expr | None = None

    @property
    def constant(self) -> bool:
        """Whether it is made of numbers alone."""
        if self.kind == "name":
            return self.name in ("i", "pi")
        return all(item.constant for item in self.items)


@dataclass(frozen=True)
class Formula:
    """A formula that was read: its text, its parts with their places, and the SymPy expression."""

    text: str
    where: str
    node: Node
    expression: sp.Expr = field(compare=False)

    def error(self, node: Node, message: str) -> InputError:
        """Return the error that names a place in this formula."""
        return _error(self.where, node.start, message)

    def shown(self, node: Node) -> str:
        """Return the text of a part, for messages."""
        return _short(self.text[node.start : node.end])

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
        raise InputError(f"{where}: {_short(repr(text))} is not a formula; a text is expected")
    if len(text) > MAX_LENGTH:
        raise InputError(f"{where}: the formula has {len(text)} characters; allowed: up to {MAX_LENGTH}")
    node = _Parser(text, frozenset(names), where).whole()
    size, _ = _size(node)
    if size > MAX_SIZE:
        raise InputError(
            f"{where}: the formula is too complicated: it needs {size} operations, allowed: {MAX_SIZE}; "
            "lower a power of a complex number, or multiply fewer of them"
        )
    return Formula(text, where, node, _settled(_Builder(text, where).build(node), frozenset(names)))


def _settled(expression: sp.Expr, names: frozenset[str]) -> sp.Expr:
    """Return the expression as it reads after printing: SymPy simplifies some forms only when they are built again."""
    with contextlib.suppress(InputError):
        for _ in range(4):
            text = to_text(expression)
            again = _Builder(text, "").build(_Parser(text, names, "").whole())
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


def _error(where: str, place: int, message: str) -> InputError:
    return InputError(f"{where}: column {place + 1}: {message}")


def _short(text: str) -> str:
    text = "".join(c if c.isprintable() else " " for c in " ".join(text.split()))
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    start: int
    end: int


class _Parser:
    """Recursive descent: sum, product, sign, power, atom."""

    def __init__(self, text: str, names: frozenset[str], where: str) -> None:
        self.text, self.names, self.where = text, names, where
        self.tokens = self._tokens()
        self.at = self.depth = 0

    def fail(self, token: _Token, message: str) -> InputError:
        if token.kind == "stray":
            message = f"{token.text!r} does not belong in a formula"
        return _error(self.where, token.start, message)

    def _tokens(self) -> list[_Token]:
        tokens, at = [], 0
        while at < len(self.text):
            if self.text[at].isspace():
                at += 1
                continue
            match = _TOKEN.match(self.text, at)
            if match is None or match.lastgroup is None:
                tokens.append(_Token("stray", self.text[at], at, at + 1))
                at += 1
                continue
            content = match.group()
            if match.lastgroup == "operator":
                content = _OPERATORS.get(content, content)
            tokens.append(_Token(match.lastgroup, content, at, match.end()))
            at = match.end()
        tokens.append(_Token("end", "", len(self.text), len(self.text)))
        return tokens

    @property
    def token(self) -> _Token:
        return self.tokens[self.at]

    def take(self) -> _Token:
        self.at += 1
        return self.tokens[self.at - 1]

    def sees(self, *operators: str) -> bool:
        return self.token.kind == "operator" and self.token.text in operators

    def deeper(self) -> None:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise self.fail(self.token, f"nested too deeply; allowed: {MAX_DEPTH} levels")

    def whole(self) -> Node:
        if self.token.kind == "end":
            raise InputError(f"{self.where}: the formula is empty")
        node = self.sum()
        if self.token.kind != "end":
            what = "a bracket too many" if self.sees(")") else "an operator is missing before it"
            raise self.fail(self.token, f"'{_short(self.token.text)}' is not expected here: {what}")
        return node

    def sum(self) -> Node:
        self.deeper()
        items, inverse = [self.product()], [False]
        while self.sees("+", "-"):
            inverse.append(self.take().text == "-")
            items.append(self.product())
        self.depth -= 1
        if len(items) == 1:
            return items[0]
        return Node("sum", items[0].start, items[-1].end, tuple(items), tuple(inverse))

    def product(self) -> Node:
        start = self.token.start
        negative = False
        items: list[Node] = []
        inverse: list[bool] = []
        divides = False
        while True:
            while self.sees("+", "-"):
                negative ^= self.take().text == "-"
            items.append(self.power())
            inverse.append(divides)
            if not self.sees("*", "/"):
                break
            divides = self.take().text == "/"
        if len(items) == 1 and not negative:
            return items[0]
        return Node(
            "product",
            start,
            items[-1].end,
            tuple(items),
            tuple(inverse),
            number=sp.S.NegativeOne if negative else None,
        )

    def power(self) -> Node:
        base = self.atom()
        if self.token.kind == "raised":
            token = self.take()
            exponent = self._raised(token)
        elif self.sees("^"):
            self.take()
            self.deeper()
            start, negative = self.token.start, False
            while self.sees("+", "-"):
                negative ^= self.take().text == "-"
            exponent = self.power()
            if negative:
                exponent = Node(
                    "product", start, exponent.end, (exponent,), (False,), number=sp.S.NegativeOne
                )
            self.depth -= 1
        else:
            return base
        return Node("power", base.start, exponent.end, (base, exponent))

    def _raised(self, token: _Token) -> Node:
        """Return the exponent that raised signs mean: ``²``, ``⁻¹``, ``ⁿ⁻¹``."""
        parts = re.fullmatch(r"(-?)(?:(n)(?:([-+])([0-9]+))?|([0-9]{1,3}))", token.text.translate(_RAISED))
        if parts is None or (parts[2] and "n" not in self.names):
            raise self.fail(token, f"'{_short(token.text)}' is no exponent here")

        def number(digits: str) -> Node:
            return Node("number", token.start, token.end, number=sp.Integer(digits))

        node = Node("name", token.start, token.end, name="n") if parts[2] else number(parts[1] + parts[5])
        if parts[1] and parts[2]:
            node = Node("product", token.start, token.end, (node,), (False,), number=sp.S.NegativeOne)
        if parts[4]:
            items = (node, number(parts[4]))
            node = Node("sum", token.start, token.end, items, (False, parts[3] == "-"))
        return node

    def atom(self) -> Node:
        token = self.take()
        if token.kind == "number":
            return Node("number", token.start, token.end, number=self._number(token))
        if token.kind == "name":
            return self._name(token)
        if token.kind == "operator" and token.text == "(":
            inner = self.sum()
            # the place of what the brackets hold is shown with them
            return Node(
                inner.kind,
                token.start,
                self._close(token).end,
                inner.items,
                inner.inverse,
                inner.name,
                inner.number,
            )
        if token.kind == "operator" and token.text == "|":
            inner = self.sum()
            if not self.sees("|"):
                raise self.fail(token, "'|' is never closed")
            return Node("call", token.start, self.take().end, (inner,), name="abs")
        self.at -= 1
        what = "the formula ends" if token.kind == "end" else f"'{_short(token.text)}' stands"
        raise self.fail(token, f"{what} where a number, a name or a bracket is expected")

    def _close(self, opened: _Token) -> _Token:
        if not self.sees(")"):
            if self.token.kind == "end":
                raise self.fail(opened, "this bracket is never closed")
            raise self.fail(self.token, f"'{_short(self.token.text)}' is not expected here: ')' is missing")
        return self.take()

    def _number(self, token: _Token) -> sp.Expr:
        if token.text.isdigit():
            if len(token.text) > 100:
                raise self.fail(token, "a number of more than 100 digits")
            return sp.Integer(token.text)
        value = float(token.text)
        digits = re.split("[eE]", token.text)[0]
        if not 1 / _LARGEST <= value <= _LARGEST and (value != 0.0 or digits.strip("0.")):
            raise self.fail(
                token, f"the number {_short(token.text)} is out of range; allowed: 1e-100 .. 1e100"
            )
        return sp.Float(value)

    def _name(self, token: _Token) -> Node:
        name = _SIGNS.get(token.text, token.text)
        if token.text == _CONJUGATE:
            inner = Node("name", token.start, token.end, name="z")
            return Node("call", token.start, token.end, (inner,), name="conj")
        called = self.sees("(")
        if called and name not in FUNCTIONS:
            if name in self.names or name in QUANTITIES or name in HANDY:
                raise self.fail(self.token, f"'{_short(name)}' is not a function: an operator is missing")
            raise self.fail(token, f"'{_short(name)}' is not a known function; known: {', '.join(FUNCTIONS)}")
        if called:
            return self._call(token, name)
        if name in FUNCTIONS and name not in self.names:
            raise self.fail(token, f"{name} needs its argument in brackets")
        if name not in self.names and name not in QUANTITIES and name not in HANDY:
            known = [*self.names, *QUANTITIES, *HANDY]
            near = difflib.get_close_matches(name[:_SHOWN], [*known, *FUNCTIONS], n=2)
            hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}"
            raise self.fail(
                token, f"'{_short(name)}' is neither a quantity nor a declared coefficient; {hint}"
            )
        return Node("name", token.start, token.end, name=name)

    def _call(self, token: _Token, name: str) -> Node:
        opened = self.take()
        items = [self.sum()]
        while self.sees(","):
            self.take()
            items.append(self.sum())
        closed = self._close(opened)
        if name in _SEVERAL and len(items) < 2:
            raise self.fail(token, f"{name} needs two arguments or more")
        if name not in _SEVERAL and len(items) > 1:
            raise self.fail(token, f"{name} takes one argument, not {len(items)}")
        return Node("call", token.start, closed.end, tuple(items), name=name)


class _Builder:
    """From the parts of a formula to a SymPy expression; what a computation could not use is refused."""

    def __init__(self, text: str, where: str) -> None:
        self.text, self.where = text, where
        self.memo: dict[sp.Expr, Parts] = {}

    def fail(self, node: Node, message: str) -> InputError:
        return _error(self.where, node.start, message)

    def shown(self, node: Node) -> str:
        return _short(self.text[node.start : node.end])

    def build(self, node: Node) -> sp.Expr:
        result = getattr(self, f"_{node.kind}")(node)
        if result.has(sp.zoo, sp.nan, sp.oo, -sp.oo):
            raise self.fail(node, f"'{self.shown(node)}' is not finite")
        if node.constant and node.items:
            size = sp.Abs(result).evalf(15)
            if not size.is_Number or size > _LARGEST:
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
            if divides and factor == 0:
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
            if base == 0 and exponent < 0:
                raise self.fail(node, f"'{self.shown(node)}' is not finite")
        if not exponent.is_Integer:
            self._must_be_real(node.items[0], base, "the base of a power that is no whole number")
            self._must_be_real(node.items[1], exponent, "an exponent")
        return sp.Pow(base, exponent)

    def _call(self, node: Node) -> sp.Expr:
        arguments = [self.build(item) for item in node.items]
        if node.name not in _COMPLEX:
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


# --- printing ---

_SUM, _PRODUCT, _POWER, _ATOM = range(4)
_FUNCTION_NAMES = {
    function.func if isinstance(function, functools.partial) else function: name
    for name, function in FUNCTIONS.items()
}


def to_text(expression: sp.Expr) -> str:
    """Return an expression as a formula that `parse` reads back into the same expression.

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
    terms = sorted(e.args, key=lambda a: (a.has(sp.I), a.is_number, default_sort_key(a)))
    texts = [_text(term)[0] for term in terms]
    # begin with a term that needs no sign
    texts.sort(key=lambda text: text.startswith("-"))
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
    over.sort(key=_place)
    under.sort(key=default_sort_key)
    if size.is_Float or size.p != 1 or not over:
        over.insert(0, size if size.is_Float else sp.Integer(size.p))
    if not size.is_Float and size.q != 1:
        under.insert(0, sp.Integer(size.q))
    text = sign + "*".join(_wrapped(factor, _PRODUCT) for factor in over)
    if len(under) > 1:
        return f"{text}/({'*'.join(_wrapped(factor, _PRODUCT) for factor in under)})"
    return f"{text}/{_wrapped(under[0], _POWER)}" if under else text


def _place(factor: sp.Expr) -> tuple[int, Any]:
    """Return where a factor stands: i, coefficients, the rest, what has the tilt."""
    symbols = factor.free_symbols
    if factor is sp.I:
        rank = 0
    elif symbols and not any(s.name in QUANTITIES for s in symbols):
        rank = 1
    else:
        rank = 3 if z in symbols else 2
    return rank, default_sort_key(factor)
