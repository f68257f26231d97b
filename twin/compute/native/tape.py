"""A CasADi function as straight-line code with every value computed once; source of the C++ code, and run by NumPy without it.

CasADi's own evaluation spends most of its time on finding the next instruction, five nanoseconds each for every row. Here an
instruction is one NumPy call for a block of rows, or a line of C++ for a register of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, final

import casadi as ca
import numpy as np

BLOCK: Final = 1024
"""Rows per instruction: enough to outweigh the cost of a NumPy call, few enough to keep the values in cache."""


def _where(condition: np.ndarray, value: np.ndarray, out: np.ndarray) -> None:
    out[...] = np.where(condition != 0.0, value, 0.0)


def _not(condition: np.ndarray, out: np.ndarray) -> None:
    np.equal(condition, 0.0, out)


@final
@dataclass(frozen=True)
class Operation:
    """One kind of instruction.

    Attributes:
        code: CasADi's number.
        run: NumPy function of the operands and the result array.
        cpp: C++ expression with places for the operands; empty for sine and cosine, which are computed together.
        needs_vector: whether the C++ needs a vector even for a constant; sums and products accept a number.
    """

    code: int
    run: Callable[..., Any]
    cpp: str
    needs_vector: bool = True


OPERATIONS: Final[Mapping[str, Operation]] = MappingProxyType(
    {
        "add": Operation(ca.OP_ADD, np.add, "{0} + {1}", needs_vector=False),
        "sub": Operation(ca.OP_SUB, np.subtract, "{0} - {1}", needs_vector=False),
        "mul": Operation(ca.OP_MUL, np.multiply, "{0} * {1}", needs_vector=False),
        "div": Operation(ca.OP_DIV, np.divide, "{0} / {1}"),
        "neg": Operation(ca.OP_NEG, np.negative, "-{0}"),
        "sqrt": Operation(ca.OP_SQRT, np.sqrt, "vsqrt({0})"),
        "sin": Operation(ca.OP_SIN, np.sin, ""),
        "cos": Operation(ca.OP_COS, np.cos, ""),
        "asin": Operation(ca.OP_ASIN, np.arcsin, "vasin({0})"),
        "atan2": Operation(ca.OP_ATAN2, np.arctan2, "vatan2({0}, {1})"),
        "floor": Operation(ca.OP_FLOOR, np.floor, "vfloor({0})"),
        "abs": Operation(ca.OP_FABS, np.abs, "vabs({0})"),
        "min": Operation(ca.OP_FMIN, np.fmin, "vmin({0}, {1})"),
        "max": Operation(ca.OP_FMAX, np.fmax, "vmax({0}, {1})"),
        "lt": Operation(ca.OP_LT, np.less, "{0} < {1}"),
        "le": Operation(ca.OP_LE, np.less_equal, "{0} <= {1}"),
        "not": Operation(ca.OP_NOT, _not, "~{0}", needs_vector=False),
        "where": Operation(ca.OP_IF_ELSE_ZERO, _where, "where({0}, {1})"),
    }
)
"""Supported operations; squares, doubles, inverses and whole powers are reduced to these."""
NAMES: Final[Mapping[int, str]] = MappingProxyType({one.code: name for name, one in OPERATIONS.items()})
COMMUTE: Final = frozenset({"add", "mul"})
TURNS: Final = frozenset({"sin", "cos"})
LOGICAL: Final = frozenset({"lt", "le", "not"})
"""Operations with a logical result; ``where`` (condition, value) takes one, and is zero where it is false."""

MAX_MULTIPLE: Final = 20
"""Largest multiple of an angle that is built from the angle; each step costs one rounding."""
UNIT_TOLERANCE: Final = 4e-16
"""Tolerance for a factor of one: two roundings."""

Node = tuple[str, int, int]
"""Operation and the numbers of its operands (−1: none)."""


class UnknownOperationError(Exception):
    """An operation of a CasADi function is not supported here; the caller uses CasADi instead."""


@final
class Tape:
    """The instructions of one function.

    Attributes:
        inputs, outputs: numbers of scalar inputs and outputs, all arguments concatenated, column-major.
        constants: the constants, kept out of the code so that calibrations with curves of the same orders share it.
        nodes: operations on values: values 0 … are the inputs, then the constants, then the nodes themselves.
        results: numbers of the output values.

    Raises:
        UnknownOperationError: an operation is not in `OPERATIONS`.
    """

    def __init__(self, function: ca.Function) -> None:
        if not function.is_a("SXFunction"):
            raise UnknownOperationError("operations on matrices")
        self.inputs = sum(function.numel_in(i) for i in range(function.n_in()))
        builder = _Builder(self.inputs)
        results = builder.read(function)
        self.constants, self.nodes, self.results = builder.finished(results)
        self.outputs = len(self.results)
        self._first = self.inputs + len(self.constants)

    @classmethod
    def of(cls, function: ca.Function) -> Tape | None:
        """Return the instructions of a function; None if it has an unsupported operation."""
        try:
            return cls(function)
        except UnknownOperationError:
            return None

    def __call__(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """Return (outputs, rows) from one (rows,) array per input, evaluated with NumPy."""
        rows = len(columns[0])
        values_out = np.empty((self.outputs, rows))
        program, slots, results = self._program
        scratch = np.empty((slots, min(rows, BLOCK)))
        constants = [np.array(value) for value in self.constants]
        with np.errstate(all="ignore"):
            for start in range(0, rows, BLOCK):
                part = slice(start, start + BLOCK)
                arrays = [*(np.ascontiguousarray(column[part]) for column in columns), *constants]
                size = len(arrays[0])
                place = [*arrays, *scratch[:, :size]]
                for function, a, b, out in program:
                    function(place[a], place[b], place[out]) if b >= 0 else function(place[a], place[out])
                for k, slot in enumerate(results):
                    values_out[k, part] = place[slot]
        return values_out

    @cached_property
    def _program(self) -> tuple[list[tuple[Callable[..., Any], int, int, int]], int, list[int]]:
        """Instructions on slots, reused when their value is no longer needed; the number of slots; the slots of the results."""
        last: dict[int, int] = {}
        for i, (_, a, b) in enumerate(self.nodes):
            last[a] = last[b] = i
        for value in self.results:
            last[value] = len(self.nodes)
        slot = {value: value for value in range(self._first)}
        free: list[int] = []
        count = 0
        program: list[tuple[Callable[..., Any], int, int, int]] = []
        for i, (name, a, b) in enumerate(self.nodes):
            if free and name != "where":
                out = free.pop()
            else:
                out, count = self._first + count, count + 1
            slot[self._first + i] = out
            program.append((OPERATIONS[name].run, slot[a], slot[b] if b >= 0 else -1, out))
            for value in {a, b}:
                if value >= self._first and last[value] == i:
                    free.append(slot[value])
        return program, count, [slot[value] for value in self.results]


class _Builder:
    """Reader of instructions that assigns one number to equal values."""

    def __init__(self, inputs: int) -> None:
        self.inputs = inputs
        self.number: dict[Any, int] = {}
        self.known: list[Any] = list(range(inputs))  # an input, ("const", value) or a node
        self.constants: dict[int, float] = {}
        self.logical: set[int] = set()

    def value(self, key: Any) -> int:
        number = self.number.get(key)
        if number is None:
            number = self.number[key] = len(self.known)
            self.known.append(key)
            if key[0] in LOGICAL:
                self.logical.add(number)
        return number

    def constant(self, value: float) -> int:
        number = self.value(("const", float(value)))
        self.constants.setdefault(number, float(value))  # zero and minus zero are one constant, the first
        return number

    def numeric(self, number: int) -> int:
        """Return a value as a number: one for true, zero for false."""
        return self.value(("where", number, self.constant(1.0))) if number in self.logical else number

    def operation(self, name: str, a: int, b: int = -1) -> int:
        # CasADi multiplies by logical values: the derivative of a maximum is the slope times a comparison.
        if self.logical:
            if name == "mul" and (a in self.logical) is not (b in self.logical):
                a, b = (a, b) if a in self.logical else (b, a)
                return self.value(("where", a, b))
            if name != "not":
                a, b = a if name == "where" else self.numeric(a), self.numeric(b)
        if name == "div" and self.constants.get(b, 0.0) != 0.0:
            name, b = "mul", self.constant(1.0 / self.constants[b])
        if name == "mul":
            return self.product(a, b)
        if name in TURNS:
            return self.turn(name, a)
        if name in COMMUTE and b < a:
            a, b = b, a
        return self.value((name, a, b))

    def product(self, a: int, b: int) -> int:
        """Return a product; constant factors are combined, and dropped if they cancel to rounding (degrees and back)."""
        known = self.constants
        if a not in known and b not in known:
            return self.value(("mul", a, b) if a <= b else ("mul", b, a))
        if a in known and b in known:
            return self.constant(known[a] * known[b])
        inner, rest = self.factor(b if a in known else a)
        factor = known[a if a in known else b] * inner
        if abs(factor - 1.0) < UNIT_TOLERANCE:
            return rest
        return self.value(("mul", *sorted((rest, self.constant(factor)))))

    def factor(self, value: int) -> tuple[float, int]:
        """Return a value as a constant and another value to be multiplied by it."""
        key = self.known[value]
        if isinstance(key, tuple) and key[0] == "add" and key[1] == key[2]:
            number, rest = self.factor(key[1])
            return 2.0 * number, rest
        if isinstance(key, tuple) and key[0] == "mul":
            for one, other in ((key[1], key[2]), (key[2], key[1])):
                if one in self.constants:
                    return self.constants[one], other
        return 1.0, value

    def turn(self, name: str, angle: int) -> int:
        """Return sine or cosine; for a whole multiple of an angle by recurrence from the multiple below."""
        number, rest = self.factor(angle)
        times = round(number) if abs(number) <= MAX_MULTIPLE else 0
        if times < 2 or abs(number / times - 1.0) >= UNIT_TOLERANCE:
            return self.value((name, angle, -1))
        below = self.product(self.constant(times - 1.0), rest)
        (s1, c1), (s, c) = ((self.turn("sin", v), self.turn("cos", v)) for v in (rest, below))
        if name == "sin":
            return self.operation("add", self.operation("mul", s1, c), self.operation("mul", c1, s))
        return self.operation("sub", self.operation("mul", c1, c), self.operation("mul", s1, s))

    def power(self, base: int, exponent: float | None) -> int:
        if exponent is None or exponent != int(exponent) or not 1 <= exponent <= 16:
            raise UnknownOperationError("a power that is no small whole number")
        power = base
        for _ in range(int(exponent) - 1):
            power = self.operation("mul", power, base)
        return power

    def read(self, function: ca.Function) -> list[int]:
        starts_in = np.cumsum([0] + [function.numel_in(i) for i in range(function.n_in())]).tolist()
        starts_out = np.cumsum([0] + [function.numel_out(i) for i in range(function.n_out())]).tolist()
        rows = [function.sparsity_out(i).find() for i in range(function.n_out())]
        results = [self.constant(0.0)] * starts_out[-1]
        work = [0] * function.sz_w()
        kind = function.instruction_id
        operands_of, outputs_of = function.instruction_input, function.instruction_output
        for k in range(function.n_instructions()):
            code, operands, outputs = kind(k), operands_of(k), outputs_of(k)
            name = NAMES.get(code)
            if name is not None:
                work[outputs[0]] = self.operation(name, *[work[i] for i in operands])
            elif code == ca.OP_CONST:
                work[outputs[0]] = self.constant(function.instruction_constant(k))
            elif code == ca.OP_INPUT:
                work[outputs[0]] = starts_in[operands[0]] + operands[1]
            elif code == ca.OP_OUTPUT:
                results[starts_out[outputs[0]] + rows[outputs[0]][outputs[1]]] = self.numeric(work[operands[0]])
            else:
                work[outputs[0]] = self._translated(code, [work[i] for i in operands])
        return results

    def _translated(self, code: int, operands: list[int]) -> int:
        """Return an operation that is reduced to others."""
        match code:
            case ca.OP_ASSIGN:
                return operands[0]
            case ca.OP_SQ:
                return self.operation("mul", operands[0], operands[0])
            case ca.OP_TWICE:
                return self.operation("add", operands[0], operands[0])
            case ca.OP_INV:
                return self.operation("div", self.constant(1.0), operands[0])
            case ca.OP_POW | ca.OP_CONSTPOW:
                return self.power(operands[0], self.constants.get(operands[1]))
        raise UnknownOperationError(f"operation {code}")

    def finished(self, results: list[int]) -> tuple[tuple[float, ...], tuple[Node, ...], tuple[int, ...]]:
        """Return constants, nodes and results without unused values, renumbered."""
        used: set[int] = set()
        stack = list(results)
        while stack:
            value = stack.pop()
            if value < 0 or value in used:
                continue
            used.add(value)
            if value >= self.inputs and value not in self.constants:
                stack += self.known[value][1:]
        constants = [v for v in sorted(used) if v in self.constants]
        nodes = [v for v in sorted(used) if v >= self.inputs and v not in self.constants]
        new = {v: v for v in range(self.inputs)} | {-1: -1}
        new |= {v: self.inputs + i for i, v in enumerate([*constants, *nodes])}
        code = tuple((self.known[v][0], new[self.known[v][1]], new[self.known[v][2]]) for v in nodes)
        return tuple(self.constants[v] for v in constants), code, tuple(new[v] for v in results)
