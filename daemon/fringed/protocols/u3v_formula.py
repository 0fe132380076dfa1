"""The formulas of a GenApi description, as its SwissKnife and Converter nodes have them.

Owns the grammar: numbers, names, `+ - * / % **`, shifts, bits, comparisons, `&& ||`, `? :` and brackets.
Functions (`SIN`, `ROUND`, …) are refused by name. Knows no nodes.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable

from fringed.errors import ProtocolError

Number = int | float
_TOKEN = re.compile(
    r"\s*(?:(0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([A-Za-z_][\w.]*)"
    r"|(\*\*|<<|>>|<=|>=|<>|&&|\|\||[-+*/%&|^~<>=?:()]))"
)
_LEVELS: tuple[tuple[str, ...], ...] = (
    ("||",), ("&&",), ("|",), ("^",), ("&",), ("=", "<>"), ("<", ">", "<=", ">="), ("<<", ">>"), ("+", "-"),
    ("*", "/", "%"),
)  # fmt: skip
_COMPARE: dict[str, Callable[[Number, Number], bool]] = {
    "=": operator.eq, "<>": operator.ne, "<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge,
}  # fmt: skip
_DEEPEST, _LONGEST = 40, 4000


def evaluate(formula: str, variable: Callable[[str], Number], integer: bool = False) -> Number:
    """Return the value of `formula`; `integer` divides as IntSwissKnife does.

    >>> evaluate("(TO + 1) * 2.5", {"TO": 3}.__getitem__)
    10.0

    Raises
    ------
    ProtocolError
        a formula that cannot be read here, or that has no value.
    """
    if len(formula) > _LONGEST:
        raise ProtocolError(f"the camera describes a formula of {len(formula)} characters; up to {_LONGEST} are read")
    parser = _Parser(_tokens(formula), variable, integer, formula)
    try:
        value = parser.ternary(True)
    except (ArithmeticError, ValueError, TypeError) as error:
        if isinstance(error, ProtocolError):
            raise
        raise ProtocolError(f"the camera's formula {formula!r} has no value: {error}") from error
    parser.done()
    return value


def _tokens(formula: str) -> list[str]:
    tokens, at, text = [], 0, formula.strip()
    while at < len(text):
        found = _TOKEN.match(text, at)
        if found is None:
            raise ProtocolError(f"the camera's formula {formula!r} cannot be read at {text[at : at + 10]!r}")
        tokens.append(found.group().strip())
        at = found.end()
    return tokens


class _Parser:
    """Recursive descent that computes as it goes; `live` is false in the half of a `? :` that is not taken."""

    def __init__(self, tokens: list[str], variable: Callable[[str], Number], integer: bool, formula: str) -> None:
        self._tokens, self._variable, self._integer, self._formula = tokens, variable, integer, formula
        self._at = self._depth = 0

    def done(self) -> None:
        """Raise unless all was read."""
        if self._at < len(self._tokens):
            raise self._wrong(f"{self._tokens[self._at]!r} is too much")

    def ternary(self, live: bool) -> Number:
        """Read `a ? b : c` or anything below it."""
        self._depth += 1
        if self._depth > _DEEPEST:
            raise self._wrong(f"more than {_DEEPEST} brackets are open")
        condition = self._level(0, live)
        if self._take("?"):
            first = self.ternary(live and bool(condition))
            self._expect(":")
            second = self.ternary(live and not condition)
            condition = first if condition else second
        self._depth -= 1
        return condition

    def _level(self, level: int, live: bool) -> Number:
        if level == len(_LEVELS):
            return self._unary(live)
        value = self._level(level + 1, live)
        while (sign := self._peek()) in _LEVELS[level]:
            self._at += 1
            right = self._level(level + 1, live)
            value = self._apply(sign, value, right) if live else 0
        return value

    def _unary(self, live: bool) -> Number:
        negative = False
        inverse = False
        while (sign := self._peek()) in ("-", "+", "~"):
            self._at += 1
            negative ^= sign == "-"
            inverse ^= sign == "~"
        value = self._atom(live)
        if self._take("**"):
            exponent = self._unary(live)
            if abs(exponent) > 64:
                raise self._wrong(f"the power {exponent} is more than 64")
            value = self._power(value, exponent) if live else 0
        if inverse:
            value = ~int(value)
        return -value if negative else value

    def _atom(self, live: bool) -> Number:
        token = self._peek()
        self._at += 1
        if token == "(":
            value = self.ternary(live)
            self._expect(")")
            return value
        if token[:1].isdigit() or token[:1] == ".":
            return int(token, 16) if token[:2] in ("0x", "0X") else float(token) if "." in token else _number(token)
        if not (token[:1].isalpha() or token[:1] == "_"):
            raise self._wrong(f"{token!r} stands where a number should")
        if self._peek() == "(":
            raise self._wrong(f"the function {token} is not among those that are computed here")
        return self._variable(token) if live else 0

    def _apply(self, sign: str, left: Number, right: Number) -> Number:
        if sign in _COMPARE:
            return int(_COMPARE[sign](left, right))
        if sign in ("&&", "||"):
            return int(bool(left) and bool(right)) if sign == "&&" else int(bool(left) or bool(right))
        if sign in ("&", "|", "^"):
            a, b = int(left), int(right)
            return a & b if sign == "&" else a | b if sign == "|" else a ^ b
        if sign in ("<<", ">>"):
            if not 0 <= right < 64:
                raise self._wrong(f"a shift by {right} is not within 0 to 63")
            return int(left) << int(right) if sign == "<<" else int(left) >> int(right)
        return self._arithmetic(sign, left, right)

    def _arithmetic(self, sign: str, left: Number, right: Number) -> Number:
        if sign == "/":
            if not self._integer:
                return left / right
            quotient = abs(int(left)) // abs(int(right))
            return quotient if (left < 0) == (right < 0) else -quotient
        if sign == "%":
            return left % right
        return left + right if sign == "+" else left - right if sign == "-" else left * right

    def _power(self, base: Number, exponent: Number) -> Number:
        raised: object = base**exponent
        if not isinstance(raised, int | float):
            raise self._wrong(f"{base} to the power of {exponent} is no real number")
        return raised

    def _peek(self) -> str:
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _take(self, token: str) -> bool:
        taken = self._peek() == token
        self._at += taken
        return taken

    def _expect(self, token: str) -> None:
        if not self._take(token):
            raise self._wrong(f"{token!r} is missing before {self._peek() or 'its end'!r}")

    def _wrong(self, why: str) -> ProtocolError:
        return ProtocolError(f"the camera's formula {self._formula!r} cannot be computed: {why}")


def _number(token: str) -> Number:
    return float(token) if "e" in token.lower() else int(token)
