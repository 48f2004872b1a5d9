"""Formulas in the files of others: read as numbers, one variable and known functions, and computed here.

What else stands in such a file is never run.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError

_LONGEST: Final = 1000
_VARIABLES: Final = ("X", "X1", "x", "x1")
_CONSTANTS: Final = {"INF": np.inf, "NaN": np.nan}
_FUNCTIONS: Final = {
    name: getattr(np, f"arc{name[1:]}" if name in ("asin", "acos", "atan") else name)
    for name in (
        "abs", "sqrt", "exp", "expm1", "log", "log10", "log1p", "sin", "cos", "tan", "arcsin", "arccos", "arctan",
        "arctan2", "asin", "acos", "atan", "sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh",
    )
}  # fmt: skip
_OPERATIONS: Final[dict[type, Callable[..., Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}


def computed(formula: str, values: Any, where: str) -> NDArray[np.float64]:
    """Return what a formula gives for values of its variable, ``X`` or ``X1``.

    Raises
    ------
    InputError
        If it consists of anything but numbers, the variable, known functions and signs of arithmetic.
    """
    variable = np.asarray(values, dtype=np.float64)
    try:
        if len(formula) > _LONGEST:
            raise ValueError
        tree = ast.parse(formula.strip(), mode="eval")
        with np.errstate(all="ignore"):
            result = np.asarray(_value(tree.body, variable), dtype=np.float64)
        return np.array(np.broadcast_to(result, variable.shape))
    except (ValueError, TypeError, KeyError, SyntaxError, RecursionError, OverflowError):
        raise InputError(
            f"{where}: its values are by the formula {formula[:80]!r}, which is not read"
        ) from None


def _value(node: ast.expr, variable: NDArray[np.float64]) -> Any:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return np.float64(node.value)
    if isinstance(node, ast.Name) and node.id in _VARIABLES:
        return variable
    if isinstance(node, ast.Name) and node.id in _CONSTANTS:
        return np.float64(_CONSTANTS[node.id])
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATIONS:
        return _OPERATIONS[type(node.op)](_value(node.operand, variable))
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATIONS:
        return _OPERATIONS[type(node.op)](_value(node.left, variable), _value(node.right, variable))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _FUNCTIONS[node.func.id](*(_value(own, variable) for own in node.args))
    raise ValueError
