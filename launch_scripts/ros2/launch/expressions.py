# SPDX-License-Identifier: Apache-2.0
"""$(eval ...): arithmetic, comparisons and logic on constants, and nothing else of Python."""
from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from typing import Any

from ros2.launch.context import LaunchError

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.Not: operator.not_, ast.USub: operator.neg, ast.UAdd: operator.pos,
}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge,
    ast.In: lambda a, b: a in b, ast.NotIn: lambda a, b: a not in b,
}


def evaluate(text: str) -> str:
    """Return the value of an expression as text.

    :raises LaunchError: when it is malformed, fails, or holds more than constants and operators.
    """
    try:
        return str(_value(ast.parse(text.strip(), mode='eval').body))
    except LaunchError as error:
        raise LaunchError(f'$(eval) of {text!r}: {error}') from None
    except (SyntaxError, TypeError, ValueError, ArithmeticError) as error:
        raise LaunchError(f'$(eval) of {text!r} fails: {error}') from None


def _value(node: ast.expr) -> Any:
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.List | ast.Tuple):
        return [_value(item) for item in node.elts]
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        left, right = _value(node.left), _value(node.right)
        if isinstance(node.op, ast.Mult) and not isinstance(left, int | float):
            raise LaunchError('only numbers can be multiplied')
        return _BINARY[type(node.op)](left, right)
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        return _UNARY[type(node.op)](_value(node.operand))
    if isinstance(node, ast.BoolOp):
        results = (_value(item) for item in node.values)
        return all(results) if isinstance(node.op, ast.And) else any(results)
    if isinstance(node, ast.IfExp):
        return _value(node.body if _value(node.test) else node.orelse)
    if isinstance(node, ast.Compare):
        left = _value(node.left)
        for kind, item in zip(node.ops, node.comparators, strict=True):
            right = _value(item)
            if type(kind) not in _COMPARISONS or not _COMPARISONS[type(kind)](left, right):
                return False
            left = right
        return True
    raise LaunchError('only constants and operators are supported here')
