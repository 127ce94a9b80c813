"""Parameters of OpenSCENARIO and the expressions ``${...}`` that are made of them.

The grammar is that of version 1.3: ``or``, ``and``, ``not``, comparisons, ``+ -``, ``* / %``, signs, calls, brackets, numbers,
``$parameters`` and texts. Nothing of Python evaluates what a file says.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping

from ...errors import short

Value = float | bool | str
MOST_LETTERS = 4000
DEEPEST = 50
"""Of brackets inside each other."""
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|\$(?P<parameter>[A-Za-z_][\w.]*)|(?P<word>[A-Za-z_]\w*)"
    r"|(?P<text>'[^']*'|\"[^\"]*\")|(?P<sign><=|>=|==|!=|&&|\|\||[-+*/%()<>,!]))"
)
_COMPARISONS: dict[str, Callable[[Value, Value], bool]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


def _rounded(value: float) -> float:
    """Return the nearest integer; halves go away from 0."""
    return math.copysign(math.floor(abs(value) + 0.5), value)


_FUNCTIONS: dict[str, tuple[int, int, Callable[..., float]]] = {
    "round": (1, 1, _rounded),
    "floor": (1, 1, math.floor),
    "ceil": (1, 1, math.ceil),
    "abs": (1, 1, abs),
    "sign": (1, 1, lambda value: float((value > 0) - (value < 0))),
    "sqrt": (1, 1, math.sqrt),
    "pow": (2, 2, math.pow),
    "exp": (1, 1, math.exp),
    "log": (1, 1, math.log),
    **{name: (1, 1, getattr(math, name)) for name in ("sin", "cos", "tan", "asin", "acos", "atan")},
    "min": (1, 100, lambda *values: min(values)),
    "max": (1, 100, lambda *values: max(values)),
}
_CONSTANTS: dict[str, Value] = {"true": True, "false": False, "pi": math.pi}


class ExpressionError(ValueError):
    """An expression that has no value. The message says why."""


class Scope:
    """Parameters by name, those of the scope around it among them. Values are texts as a file has them."""

    def __init__(self, own: Mapping[str, str] | None = None, around: Scope | None = None) -> None:
        self.own, self.around = dict(own or {}), around
        self._values: dict[str, Value] = {}
        self._open: set[str] = set()

    def find(self, name: str) -> Value:
        """Return a parameter's value. Raises `ExpressionError`."""
        if name in self._values:
            return self._values[name]
        if name in self.own and name not in self._open:
            self._open.add(name)
            try:
                self._values[name] = self.value(self.own[name])
            finally:
                self._open.discard(name)
            return self._values[name]
        if self.around is not None:
            # a parameter that is made of one of its own name means that of the scope around
            return self.around.find(name)
        if name in self._open:
            raise ExpressionError(f"the parameter {short(f'${name}')} is made of itself")
        raise ExpressionError(f"there is no parameter {short(f'${name}')}")

    def value(self, text: str) -> Value:
        """Return what a file's text stands for: itself, a parameter's value or that of an expression."""
        if text.startswith("${") and text.rstrip().endswith("}"):
            return _Expression(text.rstrip()[2:-1], self.find).value()
        if text.startswith("$"):
            return self.find(text[1:])
        return text


def text_of(value: Value) -> str:
    """Return a value as a file writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return value


def _plain(value: Value) -> Value:
    """Return the number or the truth that a text says, or the text."""
    if not isinstance(value, str):
        return value
    if value in ("true", "false"):
        return value == "true"
    try:
        return float(value)
    except ValueError:
        return value


class _Expression:
    def __init__(self, text: str, find: Callable[[str], Value]) -> None:
        if len(text) > MOST_LETTERS:
            raise ExpressionError(f"it has {len(text)} letters, more than {MOST_LETTERS}")
        self.find, self.at, self.depth = find, 0, 0
        self.tokens: list[tuple[str, str]] = []
        end, place = len(text.rstrip()), 0
        while place < end:
            match = _TOKEN.match(text, place)
            if match is None:
                raise ExpressionError(f"{short(text[place:].strip()[:20])} is none of its signs")
            kind = match.lastgroup or ""
            self.tokens.append((kind, match.group(kind)))
            place = match.end()

    def value(self) -> Value:
        if not self.tokens:
            raise ExpressionError("it is empty")
        value = self._or()
        if self.at < len(self.tokens):
            raise ExpressionError(f"{short(self.tokens[self.at][1])} is not expected")
        if isinstance(value, float) and not math.isfinite(value):
            raise ExpressionError("it has no finite value")
        return value

    def _next(self, *signs: str) -> str | None:
        if self.at < len(self.tokens):
            kind, text = self.tokens[self.at]
            if kind in ("sign", "word") and text in signs:
                self.at += 1
                return text
        return None

    def _or(self) -> Value:
        value = self._and()
        while self._next("or", "||"):
            after = self._and()
            value = self._truth(value) | self._truth(after)
        return value

    def _and(self) -> Value:
        value = self._not()
        while self._next("and", "&&"):
            after = self._not()
            value = self._truth(value) & self._truth(after)
        return value

    def _not(self) -> Value:
        if self._next("not", "!"):
            self._deeper()
            value: Value = not self._truth(self._not())
            self.depth -= 1
            return value
        return self._comparison()

    def _comparison(self) -> Value:
        value = self._sum()
        while sign := self._next(*_COMPARISONS):
            left, right = _plain(value), _plain(self._sum())
            if sign not in ("==", "!="):
                left, right = self._number(left), self._number(right)
            value = _COMPARISONS[sign](left, right)
        return value

    def _sum(self) -> Value:
        value = self._product()
        while sign := self._next("+", "-"):
            after = self._number(self._product())
            value = self._number(value) + (after if sign == "+" else -after)
        return value

    def _product(self) -> Value:
        value = self._signed()
        while sign := self._next("*", "/", "%"):
            left, right = self._number(value), self._number(self._signed())
            if sign != "*" and right == 0:
                raise ExpressionError("it divides by 0")
            value = left * right if sign == "*" else left / right if sign == "/" else math.fmod(left, right)
        return value

    def _signed(self) -> Value:
        sign = self._next("+", "-")
        if sign is None:
            return self._part()
        self._deeper()
        value = self._number(self._signed())
        self.depth -= 1
        return -value if sign == "-" else value

    def _part(self) -> Value:
        if self._next("("):
            self._deeper()
            value = self._or()
            self.depth -= 1
            self._close()
            return value
        if self.at == len(self.tokens):
            raise ExpressionError("it ends too early")
        kind, text = self.tokens[self.at]
        self.at += 1
        if kind == "number":
            return float(text)
        if kind == "parameter":
            return _plain(self.find(text))
        if kind == "text":
            return text[1:-1]
        if kind == "word" and text in _FUNCTIONS and self._next("("):
            return self._call(text)
        if kind == "word" and text in _CONSTANTS:
            return _CONSTANTS[text]
        raise ExpressionError(f"{short(text)} is not known")

    def _call(self, name: str) -> float:
        self._deeper()
        values = [self._number(self._or())]
        while self._next(","):
            values.append(self._number(self._or()))
        self.depth -= 1
        self._close()
        least, most, function = _FUNCTIONS[name]
        if not least <= len(values) <= most:
            raise ExpressionError(f"{name} takes {least} values, not {len(values)}")
        try:
            return float(function(*values))
        except (ValueError, OverflowError):
            raise ExpressionError(f"{name} has no value there") from None

    def _close(self) -> None:
        if not self._next(")"):
            raise ExpressionError("a bracket is not closed")

    def _deeper(self) -> None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise ExpressionError(f"it has more than {DEEPEST} brackets inside each other")

    def _number(self, value: Value) -> float:
        value = _plain(value)
        if isinstance(value, bool) or isinstance(value, str):
            raise ExpressionError(f"{short(value)} is no number")
        return float(value)

    def _truth(self, value: Value) -> bool:
        value = _plain(value)
        if not isinstance(value, bool):
            raise ExpressionError(f"{short(value)} is neither true nor false")
        return value
