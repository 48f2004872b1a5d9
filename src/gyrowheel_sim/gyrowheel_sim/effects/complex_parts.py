"""Real and imaginary part of a law, by its structure: without expansion, so that long formulas do not grow."""

from __future__ import annotations

import sympy as sp

from gyrowheel_sim.effects.quantities import V_coil, home_x, home_y, up_across, z, z_rate

#: The real symbols that stand for the two components of the complex quantities.
COMPONENTS: dict[sp.Symbol, tuple[sp.Symbol, sp.Symbol]] = {
    symbol: (sp.Symbol(x, real=True), sp.Symbol(y, real=True))
    for symbol, x, y in (
        (z, "zx", "zy"),
        (z_rate, "zx_rate", "zy_rate"),
        (V_coil, "Vx", "Vy"),
        (up_across, "up_x", "up_y"),
        (home_x, "home_xx", "home_xy"),
        (home_y, "home_yx", "home_yy"),
    )
}
Parts = tuple[sp.Expr, sp.Expr]


def components(symbol: sp.Symbol) -> tuple[sp.Symbol, ...]:
    """Return the real symbols that stand for a symbol: its two components, or itself."""
    if symbol in COMPONENTS:
        return COMPONENTS[symbol]
    if symbol.is_real:
        return (symbol,)
    return sp.Symbol(f"{symbol.name}_x", real=True), sp.Symbol(f"{symbol.name}_y", real=True)


class ComplexArgumentError(ValueError):
    """A function or a power that is defined for real numbers alone was given a complex one."""

    def __init__(self, argument: sp.Expr) -> None:
        super().__init__("the argument is complex")
        self.argument = argument


def split(expression: sp.Expr, memo: dict[sp.Expr, Parts] | None = None) -> Parts:
    """Return real and imaginary part of a law in `COMPONENTS` and the real quantities.

    Parameters
    ----------
    expression : sympy expression
        Built of sums, products, powers, ``conjugate``, ``re``, ``im``, ``Abs``, ``exp`` and real functions of real
        arguments.
    memo : dict, optional
        Parts of sub-expressions, to be shared by several calls.

    Raises
    ------
    ComplexArgumentError
        If a power that is no integer, or another function, has a complex argument.
    """
    memo = {} if memo is None else memo
    if expression not in memo:
        memo[expression] = _split(expression, memo)
    return memo[expression]


def is_real(expression: sp.Expr, memo: dict[sp.Expr, Parts] | None = None) -> bool:
    """Whether the imaginary part of a law vanishes for every tilt."""
    return bool(split(expression, memo)[1] == 0)


def _split(e: sp.Expr, memo: dict[sp.Expr, Parts]) -> Parts:
    zero = sp.S.Zero
    if e.is_Symbol:
        own = components(e)
        return (own[0], own[1]) if len(own) == 2 else (e, zero)
    if e is sp.I:
        return zero, sp.S.One
    if e.is_Atom:
        return e, zero
    if e.is_Add:
        parts = [split(a, memo) for a in e.args]
        return sp.Add(*(p[0] for p in parts)), sp.Add(*(p[1] for p in parts))
    if e.is_Mul:
        return _product([split(a, memo) for a in e.args])
    if isinstance(e, sp.Pow):
        base, exponent = split(e.base, memo), split(e.exp, memo)
        if base[1] == 0 and exponent[1] == 0:
            return sp.Pow(base[0], exponent[0]), zero
        if not e.exp.is_Integer:
            raise ComplexArgumentError(e.base if base[1] != 0 else e.exp)
        return _power(base, int(e.exp))
    return _of_function(e, [split(a, memo) for a in e.args])


def _of_function(e: sp.Expr, parts: list[Parts]) -> Parts:
    """Return the parts of a function, given those of its arguments."""
    zero = sp.S.Zero
    real, imaginary = parts[0]
    if isinstance(e, sp.conjugate):
        return real, -imaginary
    if isinstance(e, sp.re):
        return real, zero
    if isinstance(e, sp.im):
        return imaginary, zero
    if isinstance(e, sp.Abs):
        return (sp.Abs(real) if imaginary == 0 else sp.sqrt(real**2 + imaginary**2)), zero
    if isinstance(e, sp.exp) and imaginary != 0:
        size = sp.exp(real)
        return size * sp.cos(imaginary), size * sp.sin(imaginary)
    for argument, part in zip(e.args, parts, strict=True):
        if part[1] != 0:
            raise ComplexArgumentError(argument)
    # comparing long arguments would take SymPy minutes
    unevaluated = {"evaluate": False} if isinstance(e, sp.Max | sp.Min) else {}
    return e.func(*(p[0] for p in parts), **unevaluated), zero


def _product(parts: list[Parts]) -> Parts:
    factor = sp.Mul(*(p[0] for p in parts if p[1] == 0))
    real, imaginary = sp.S.One, sp.S.Zero
    for a, b in (p for p in parts if p[1] != 0):
        real, imaginary = real * a - imaginary * b, real * b + imaginary * a
    return factor * real, factor * imaginary


def _power(base: Parts, exponent: int) -> Parts:
    if exponent < 0:
        size = base[0] ** 2 + base[1] ** 2
        base = (base[0] / size, -base[1] / size)
    result: Parts = (sp.S.One, sp.S.Zero)
    for digit in bin(abs(exponent))[2:]:
        result = _product([result, result])
        if digit == "1":
            result = _product([result, base])
    return result
