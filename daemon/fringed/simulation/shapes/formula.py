"""Read a formula z(x, y) that somebody typed, and nothing else.

Owns the grammar: numbers, x, y, pi, arithmetic and the functions of `FUNCTIONS`. Nothing is ever executed.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fringed.data import Float64Array

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "log": np.log, "sqrt": np.sqrt, "abs": np.abs,
    "tanh": np.tanh, "atan2": np.arctan2, "hypot": np.hypot, "minimum": np.minimum, "maximum": np.maximum,
}  # fmt: skip
_OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow, ast.USub: operator.neg, ast.UAdd: operator.pos,
}  # fmt: skip
_ALLOWED = f"numbers, x, y, pi, + - * / ** ( ) and {', '.join(sorted(FUNCTIONS))}"
MAX_LENGTH = 2000


def evaluate(formula: str, x: Float64Array, y: Float64Array) -> Float64Array:
    """Return the values of `formula` at x and y (same shape).

    Raises
    ------
    ValueError
        the formula holds something else than it may, or its values are not finite.
    """
    if len(formula) > MAX_LENGTH:
        raise ValueError(f"the formula has {len(formula)} characters; at most {MAX_LENGTH} are allowed")
    try:
        tree = ast.parse(formula.strip(), mode="eval").body
        with np.errstate(all="ignore"):
            value = _value(tree, {"x": x, "y": y, "pi": math.pi})
            result = np.broadcast_to(np.asarray(value, dtype=np.float64), x.shape)
    except (SyntaxError, RecursionError, MemoryError, TypeError, ArithmeticError) as error:
        raise ValueError(f"{formula[:80]!r} is not a formula of x and y ({error}); write {_ALLOWED}") from error
    if not np.isfinite(result).all():
        raise ValueError(f"{formula[:80]!r} is not finite everywhere on the surface; change it or its size")
    return np.array(result)


def _value(node: ast.AST, names: Mapping[str, Any]) -> Any:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return float(node.value)
    if isinstance(node, ast.Name) and node.id in names:
        return names[node.id]
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_value(node.left, names), _value(node.right, names))
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)](_value(node.operand, names))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        function = FUNCTIONS.get(node.func.id)
        if function is not None:
            return function(*(_value(argument, names) for argument in node.args))
    raise ValueError(f"{ast.unparse(node)[:80]!r} is not allowed in a formula; write {_ALLOWED}")
