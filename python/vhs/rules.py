"""Rules: conditions that a configuration says in words, such as ``reward > 0 and not truncated``.

A rule is parsed as a Python expression and read by a small evaluator of its own: constants, names, entries,
comparisons, ``and``, ``or``, ``not``, ``+`` and ``-``. Nothing of it is ever run as code.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from vhs._core import ArgumentError

MOST_LETTERS = 200
"""Of a rule."""

_OPERATORS: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.In: lambda entry, entries: entry in entries,
    ast.NotIn: lambda entry, entries: entry not in entries,
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
}
_PARTS = (
    ast.Expression,
    ast.Constant,
    ast.Name,
    ast.Load,
    ast.Subscript,
    ast.Compare,
    ast.BoolOp,
    ast.And,
    ast.Or,
    ast.UnaryOp,
    ast.BinOp,
    *_OPERATORS,
)


@dataclass(frozen=True)
class Rule:
    """A condition over named values."""

    text: str

    def __post_init__(self) -> None:
        """Parse it once, so that what is wrong with it is said at once.

        Raises:
            ArgumentError: It is no expression, too long, or has a part that rules do not have.
        """
        for part in ast.walk(self._tree):
            if not isinstance(part, _PARTS):
                raise ArgumentError(
                    f"expected names, numbers, texts, comparisons, `and`, `or`, `not`, found "
                    f"{type(part).__name__} in {self.text!r}"
                )

    def holds(self, named: Mapping[str, Any], entries: Mapping[str, Any]) -> bool:
        """Whether the condition is true.

        Args:
            named: What the names mean.
            entries: What other names mean, ``info`` of an environment.

        Raises:
            ArgumentError: A name or an entry is not there, or values do not compare.
        """
        try:
            return bool(_value(self._tree.body, {**entries, **named}))
        except KeyError as error:
            known = ", ".join([*named, *map(str, entries)])
            raise ArgumentError(f"{self.text!r}: expected one of {known}, found {error}") from error
        except TypeError as error:
            raise ArgumentError(f"{self.text!r}: expected values that compare, found {error}") from error

    @cached_property
    def _tree(self) -> ast.Expression:
        if len(self.text) > MOST_LETTERS:
            raise ArgumentError(f"expected at most {MOST_LETTERS} letters, found {len(self.text)}")
        try:
            return ast.parse(self.text.strip(), mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise ArgumentError(f"expected a condition such as `reward > 0`, found {self.text!r}") from error


def _value(node: ast.expr, names: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant():
            return node.value
        case ast.Name():
            return names[node.id]
        case ast.Subscript():
            return _value(node.value, names)[_value(node.slice, names)]
        case ast.UnaryOp():
            return _OPERATORS[type(node.op)](_value(node.operand, names))
        case ast.BinOp():
            return _OPERATORS[type(node.op)](_value(node.left, names), _value(node.right, names))
        case ast.BoolOp():
            parts = (_value(part, names) for part in node.values)
            return all(parts) if isinstance(node.op, ast.And) else any(parts)
        case ast.Compare():
            values = [_value(part, names) for part in (node.left, *node.comparators)]
            compared = zip(node.ops, values, values[1:], strict=False)
            return all(_OPERATORS[type(op)](left, right) for op, left, right in compared)
    raise AssertionError(node)  # refused when it was parsed
