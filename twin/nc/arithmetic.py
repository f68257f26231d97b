"""Arithmetic with parameters and conditions: Fanuc and LinuxCNC ``#1``, SINUMERIK ``R1`` and names, Heidenhain ``Q1``.

Angles are in degrees. An expression is unknown (NaN) if a parameter in it is, or if controls disagree about its value: a remainder or a
rounding toward zero of a negative number, a division by zero, numbers compared that are almost equal. A condition is 1 or 0.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Final, final

from twin.nc.text import number

_TOKEN: Final = re.compile(
    r"[ \t]*+(?:(?P<number>\d++(?:\.\d*+)?+|\.\d++)|(?P<name>\#(?:\d++|<[^>\r\n]*+>)|\$?[A-Za-z_]\w*+)"
    r"|(?P<sign>\*\*|[=<>]=|<>|[-+*/^()\[\],<>]))",
    re.ASCII,
)
_CLOSING: Final = {"(": ")", "[": "]"}


def _down(value: float) -> float:
    return math.floor(value) if value >= 0.0 else math.nan


def _up(value: float) -> float:
    return math.ceil(value) if value >= 0.0 else math.nan


def _nearest(value: float) -> float:
    return math.floor(value + 0.5) if value >= 0.0 else -math.floor(0.5 - value)


FUNCTIONS: Final[Mapping[str, Callable[[float], float]]] = {
    "SIN": lambda value: math.sin(math.radians(value)),
    "COS": lambda value: math.cos(math.radians(value)),
    "TAN": lambda value: math.tan(math.radians(value)),
    "ASIN": lambda value: math.degrees(math.asin(value)),
    "ACOS": lambda value: math.degrees(math.acos(value)),
    "ATAN": lambda value: math.degrees(math.atan(value)),
    "SQRT": math.sqrt,
    "ABS": abs,
    "ROUND": _nearest,
    "FIX": _down,
    "FUP": _up,
    "TRUNC": math.trunc,
    "INT": math.trunc,
    "POT": lambda value: value * value,
    "SQ": lambda value: value * value,
    "LN": math.log,
    "EXP": math.exp,
    "NEG": lambda value: -value,
    "SGN": lambda value: math.copysign(1.0, value) if value else 0.0,
    "FRAC": lambda value: math.modf(value)[0],
}
"""Functions of one number."""
_BINARY: Final[Mapping[str, Callable[[float, float], float]]] = {
    "*": lambda one, other: one * other,
    "/": lambda one, other: one / other,
    "MOD": lambda one, other: math.fmod(one, other) if one >= 0.0 and other > 0.0 else math.nan,
    "LEN": math.hypot,
    "ANG": lambda one, other: math.degrees(math.atan2(one, other)) % 360.0,
}


_COMPARED: Final[Mapping[str, Callable[[float, float], bool]]] = {
    **dict.fromkeys(("EQ", "==", "EQU"), operator.eq),
    **dict.fromkeys(("NE", "<>"), operator.ne),
    **dict.fromkeys(("GT", ">"), operator.gt),
    **dict.fromkeys(("GE", ">="), operator.ge),
    **dict.fromkeys(("LT", "<"), operator.lt),
    **dict.fromkeys(("LE", "<="), operator.le),
}
_LOGICAL: Final[Mapping[str, Callable[[bool, bool], bool]]] = {
    "AND": operator.and_,
    "OR": operator.or_,
    "XOR": operator.xor,
}
EQUAL: Final = 1e-4
"""Numbers closer than this are equal for LinuxCNC (EQ and NE); other controls compare more exactly."""
_CLOSE: Final = 1e-9
"""Numbers closer than this may compare differently in the arithmetic of another control."""


def key_of(name: str) -> str:
    """Return a parameter's name in capitals and without spaces, neither of which counts."""
    return "".join(name.upper().split())


def evaluate(text: str, parameters: Mapping[str, float], *, heidenhain: bool = False, linuxcnc: bool = False) -> float:
    """Return the value of an expression; NaN if it is unknown.

    Parameters have names in capitals (``#1``, ``R1``, ``_DEPTH``, ``Q1``). For ``heidenhain`` ``DIV`` is a quotient and commas are
    decimal; else ``DIV`` gives a whole number (SINUMERIK). ``linuxcnc``: whether it is LinuxCNC that compares.
    """
    try:
        parser = _Parser(text.replace(",", ".") if heidenhain else text, parameters, not heidenhain, linuxcnc)
        value = parser.condition()
    except (ArithmeticError, ValueError):
        return math.nan
    return value if parser.at_end and math.isfinite(value) else math.nan


@final
class _Parser:
    """Recursive descent; raises `ValueError` for anything that is not an expression."""

    def __init__(self, text: str, parameters: Mapping[str, float], whole_division: bool, linuxcnc: bool) -> None:
        self._parameters, self._whole_division, self._linuxcnc = parameters, whole_division, linuxcnc
        self._tokens: list[tuple[str, str]] = []
        at = 0
        text = text.rstrip()
        while at < len(text):
            match = _TOKEN.match(text, at)
            if match is None or match.lastgroup is None:
                raise ValueError(text)
            self._tokens.append((match.lastgroup, key_of(match[match.lastgroup])))
            at = match.end()
        self._at = 0

    @property
    def at_end(self) -> bool:
        """Whether everything has been read."""
        return self._at == len(self._tokens)

    def _next(self) -> str:
        return "" if self.at_end else self._tokens[self._at][1]

    def _take(self, *wanted: str) -> str:
        """Read the next token if it is one of some; return it, or an empty text."""
        token = self._next()
        if token not in wanted:
            return ""
        self._at += 1
        return token

    def condition(self) -> float:
        """Return comparisons that one logical operator joins; several different ones need brackets, which controls read alike."""
        begin = self._at
        value = self._comparison()
        word = self._next()
        while self._next() in _LOGICAL:
            if self._take(word) == "" or self._sums(begin, self._at - 1):
                return math.nan
            begin = self._at
            other = self._comparison()
            if self._sums(begin, self._at):
                return math.nan
            known = value in (0.0, 1.0) and other in (0.0, 1.0)
            value = float(_LOGICAL[word](bool(value), bool(other))) if known else math.nan
        return value

    def _sums(self, begin: int, end: int) -> bool:
        """Return whether tokens are arithmetic without a comparison: some controls apply a logical operator first."""
        texts = {text for _, text in self._tokens[begin:end]}
        return bool(texts & {"+", "-", "*", "/", "**", "MOD"}) and not texts & _COMPARED.keys()

    def _comparison(self) -> float:
        value = self.sum()
        if not (word := self._take(*_COMPARED)):
            return value
        other = self.sum()
        if self._next() in _COMPARED or value != value or other != other:
            return math.nan
        apart = abs(value - other)
        if self._linuxcnc and word in ("EQ", "NE"):
            return float((apart < EQUAL) == (word == "EQ"))
        close = EQUAL if _COMPARED[word] in (operator.eq, operator.ne) else _CLOSE
        return math.nan if 0.0 < apart <= close and not self._linuxcnc else float(_COMPARED[word](value, other))

    def sum(self) -> float:
        """Return a sum of products."""
        value = self._product()
        while sign := self._take("+", "-"):
            other = self._product()
            value = value + other if sign == "+" else value - other
        return value

    def _product(self) -> float:
        value = self._power()
        while sign := self._take(*_BINARY, "DIV"):
            other = self._power()
            if sign == "DIV":
                value = math.trunc(value / other) if self._whole_division else value / other
            else:
                value = _BINARY[sign](value, other)
        return value

    def _power(self) -> float:
        """Return powers by ``**`` from left to right, of operands with their signs: LinuxCNC, ``-2 ** 2`` is 4."""
        value = self._signed()
        while self._take("**"):
            value = math.pow(value, self._signed())
        return value

    def _signed(self) -> float:
        """Return an operand with its sign; the power ``^`` (Heidenhain) comes before the sign."""
        if self._take("NOT"):
            value = self._signed()
            return 1.0 - value if value in (0.0, 1.0) else math.nan
        if sign := self._take("+", "-"):
            value = self._signed()
            return -value if sign == "-" else value
        value = self._operand()
        return math.pow(value, self._signed()) if self._take("^") else value

    def _operand(self) -> float:
        if self._next() in _CLOSING:
            return self._bracket()[0]
        if self.at_end:
            raise ValueError("no operand")
        kind, text = self._tokens[self._at]
        self._at += 1
        if kind == "number":
            return number(text)
        if kind != "name":
            raise ValueError(text)
        if text in self._parameters:
            return self._parameters[text]
        if text in ("ATAN", "ATAN2", "POW") and self._next() in _CLOSING:
            return self._of_two(text)
        if text in FUNCTIONS:
            return FUNCTIONS[text](self._bracket()[0] if self._next() in _CLOSING else self._signed())
        return {"PI": math.pi, "$PI": math.pi, "TRUE": 1.0, "FALSE": 0.0}.get(text, math.nan)

    def _of_two(self, name: str) -> float:
        """Return a function of two numbers: ``ATAN2(y,x)``, ``ATAN[y,x]``, ``ATAN[y]/[x]``, ``POW[x,y]``."""
        values = self._bracket()
        if name == "ATAN" and len(values) == 1 and self._next() == "/":
            self._at += 1
            if self._next() not in _CLOSING:
                raise ValueError(name)
            values += self._bracket()
        if name == "POW" and len(values) == 2:
            return math.pow(*values)
        if len(values) == 1 and name == "ATAN":
            return FUNCTIONS[name](values[0])
        if len(values) != 2:
            raise ValueError(name)
        angle = math.degrees(math.atan2(*values))
        # SINUMERIK and LinuxCNC give −180° to 180°, Fanuc 0° to 360° by default.
        return angle if angle >= 0.0 or name == "ATAN2" else math.nan

    def _bracket(self) -> list[float]:
        """Return the values in a bracket, separated by commas."""
        closing = _CLOSING[self._take(*_CLOSING)]
        values = [self.condition()]
        while self._take(","):
            values.append(self.sum())
        if not self._take(closing):
            raise ValueError(closing)
        return values
