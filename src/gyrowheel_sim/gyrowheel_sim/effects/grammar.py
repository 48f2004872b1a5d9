"""The grammar of formulas: from text to its parts, each with its place in the text.

Nothing is evaluated as Python. A formula is made of numbers, the quantities of the bench, coefficients,
``+ - * / ^`` (or ``**``), brackets, ``|x|``, and the functions of `FUNCTIONS`; ``i`` is the imaginary unit and ``r``
the spin rate over its reference. The signs that the project shows (``Ω``, ``θ'``, ``ρ₀``, ``·``, ``z²``) are read too.
"""

from __future__ import annotations

import difflib
import functools
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Literal

import sympy as sp

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects.complex_parts import COMPONENTS
from gyrowheel_sim.effects.quantities import QUANTITIES, Omega, Omega_ref

MAX_LENGTH = 1000
MAX_DEPTH = 30
MAX_POWER = 20
#: Largest number of operations that a formula may need once real and imaginary part are written out.
MAX_SIZE = 1000
LARGEST = 1e100
SHOWN = 40  # characters of a formula that a message repeats


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
COMPLEX_FUNCTIONS = ("conj", "abs", "re", "im", "exp")
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
    """A part of a formula with its place in the text."""

    kind: Kind  # ``number``, ``name``, ``sum``, ``product``, ``power`` (base, exponent) or ``call``
    #: Where it stands in the text.
    start: int
    end: int
    items: tuple[Node, ...] = ()  # what it is made of
    #: For every item of a sum whether it is subtracted, of a product whether it divides.
    inverse: tuple[bool, ...] = ()
    name: str = ""  # the name, or the function
    number: sp.Expr | None = None  # the number; of a product its sign where that is negative

    @property
    def constant(self) -> bool:
        """Whether it is made of numbers alone."""
        if self.kind == "name":
            return self.name in ("i", "pi")
        return all(item.constant for item in self.items)


def error_at(where: str, place: int, message: str) -> InputError:
    """Return the error that names a place in a formula, counted from 0."""
    return InputError(f"{where}: column {place + 1}: {message}")


def one_line(text: str) -> str:
    """Return a text as one line of printable characters."""
    return "".join(c if c.isprintable() else " " for c in " ".join(text.split()))


def shortened(text: str, longest: int = SHOWN) -> str:
    """Return a text in one line of limited length, for messages."""
    text = one_line(text)
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


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
        return error_at(self.where, token.start, message)

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
            raise self.fail(self.token, f"'{shortened(self.token.text)}' is not expected here: {what}")
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
            raise self.fail(token, f"'{shortened(token.text)}' is no exponent here")

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
        what = "the formula ends" if token.kind == "end" else f"'{shortened(token.text)}' stands"
        raise self.fail(token, f"{what} where a number, a name or a bracket is expected")

    def _close(self, opened: _Token) -> _Token:
        if not self.sees(")"):
            if self.token.kind == "end":
                raise self.fail(opened, "this bracket is never closed")
            raise self.fail(
                self.token, f"'{shortened(self.token.text)}' is not expected here: ')' is missing"
            )
        return self.take()

    def _number(self, token: _Token) -> sp.Expr:
        if token.text.isdigit():
            if len(token.text) > 100:
                raise self.fail(token, "a number of more than 100 digits")
            return sp.Integer(token.text)
        value = float(token.text)
        digits = re.split("[eE]", token.text)[0]
        if not 1 / LARGEST <= value <= LARGEST and (value != 0.0 or digits.strip("0.")):
            raise self.fail(
                token, f"the number {shortened(token.text)} is out of range; allowed: 1e-100 .. 1e100"
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
                raise self.fail(self.token, f"'{shortened(name)}' is not a function: an operator is missing")
            raise self.fail(
                token, f"'{shortened(name)}' is not a known function; known: {', '.join(FUNCTIONS)}"
            )
        if called:
            return self._call(token, name)
        if name in FUNCTIONS and name not in self.names:
            raise self.fail(token, f"{name} needs its argument in brackets")
        if name not in self.names and name not in QUANTITIES and name not in HANDY:
            known = [*self.names, *QUANTITIES, *HANDY]
            near = difflib.get_close_matches(name[:SHOWN], [*known, *FUNCTIONS], n=2)
            hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}"
            raise self.fail(
                token, f"'{shortened(name)}' is neither a quantity nor a declared coefficient; {hint}"
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


def parts_of(text: str, names: Collection[str], where: str) -> Node:
    """Return the parts of a formula.

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
        If the text is no formula, has an unknown name, or is too deeply nested; the message has the column.
    """
    return _Parser(text, frozenset(names), where).whole()


def unknown_names(text: str) -> list[str]:
    """Return the names in a text that mean nothing yet, in order: those that coefficients could have."""
    found = []
    for token in _Parser(text, frozenset(), "").tokens:
        if token.kind == "raised" and "n" in token.text.translate(_RAISED):
            found.append("n")
        elif token.kind == "name":
            found.append(token.text)
    known = {*RESERVED, *_SIGNS, _CONJUGATE}
    return [name for name in dict.fromkeys(found) if name not in known]
