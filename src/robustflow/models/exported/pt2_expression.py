"""The sizes in a file of `torch.export.save`: expressions of sympy, which PyTorch reads by evaluating them."""

from __future__ import annotations

import ast
import re

_FUNCTIONS = {
    *("Symbol", "Integer", "Float", "Rational", "Add", "Mul", "Pow", "Max", "Min", "Mod", "PythonMod", "FloorDiv"),
    *("CleanDiv", "CeilDiv", "ModularIndexing", "Where", "CeilToInt", "FloorToInt", "TruncToInt", "RoundToInt"),
    *("IntTrueDiv", "FloatTrueDiv", "ToFloat", "Identity", "Piecewise", "ExprCondPair"),
    *("Equality", "Unequality", "StrictLessThan", "LessThan", "StrictGreaterThan", "GreaterThan", "And", "Or", "Not"),
    *("Eq", "Ne", "Lt", "Le", "Gt", "Ge"),
}
_SYMBOL = re.compile(r"[a-z_]{1,20}\d{0,9}", re.ASCII)
_ASSUMPTIONS = {"positive", "nonnegative", "integer", "real", "evaluate"}
_LARGEST = 2**63


def check_expression(text: str) -> bool:
    """Whether a size is arithmetic on symbols and whole numbers, and nothing else.

    >>> check_expression("Mul(Integer(8), Symbol('s39', positive=True, integer=True))")
    True
    >>> check_expression("Symbol('s0').__class__"), check_expression("open('x')"), check_expression("Pow(9, 9**9)")
    (False, False, False)
    """
    if len(text) > 10_000:
        return False
    try:
        tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return False
    return _known(tree.body)


def _known(node: ast.expr) -> bool:
    if isinstance(node, ast.Constant):
        if isinstance(node.value, str):
            return _SYMBOL.fullmatch(node.value) is not None
        return isinstance(node.value, int | float) and abs(node.value) <= _LARGEST
    if isinstance(node, ast.Name):
        return node.id in ("true", "false", "oo") or re.fullmatch(r"[su]\d{1,9}", node.id, re.ASCII) is not None
    if isinstance(node, ast.UnaryOp):
        return isinstance(node.op, ast.USub) and _known(node.operand)
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.Add | ast.Sub | ast.Mult | ast.Div | ast.FloorDiv | ast.Mod) and (
            _known(node.left) and _known(node.right)
        )
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _FUNCTIONS):
        return False
    if node.func.id == "Pow" and not (len(node.args) == 2 and _small(node.args[1])):
        return False
    return all(_known(part) for part in node.args) and all(
        word.arg in _ASSUMPTIONS and isinstance(word.value, ast.Constant) and isinstance(word.value.value, bool)
        for word in node.keywords
    )


def _small(exponent: ast.expr) -> bool:
    """Whether a power can be worked out in no time."""
    if isinstance(exponent, ast.Call) and len(exponent.args) == 1:
        exponent = exponent.args[0]
    if isinstance(exponent, ast.UnaryOp):
        exponent = exponent.operand
    return isinstance(exponent, ast.Constant) and isinstance(exponent.value, int) and exponent.value <= 16
