"""Generation of C++ code from a tape, on SIMD registers: several poses per instruction, without branches and calls.

It uses the vector extensions of GCC and Clang, not `std::experimental::simd`: both compilers have them. Sine and cosine are our own, so
that nothing needs ``-ffast-math`` and not-a-number and comparisons keep their meaning.
"""

from __future__ import annotations

from typing import Final

from twin.compute.native.tape import LOGICAL, OPERATIONS, Tape

LARGEST_ANGLE: Final = 1e5
"""Largest angle in radians that the C++ reduces without loss, 16,000 turns of a table; poses beyond it are left to NumPy."""
ROUNDING: Final = 1e-10
"""Tolerance of that comparison, relative to the value or to one; rounding errors of either are a thousandth of it."""


def unused(name: str) -> str:
    """Return a C++ function in the place of a `routine` that is never called."""
    return f"INLINE void {name}(const V *, const double *, V *) {{}}\n"


def routine(name: str, tape: Tape) -> str:
    """Return the C++ function ``name(x, k, y)`` of inputs, constants and results."""
    first = tape.inputs + len(tape.constants)
    lines = [f"INLINE void {name}(const V *x, const double *k, V *y) {{"]
    turns: dict[int, str] = {}

    def text(value: int, *, needs_vector: bool = False) -> str:
        if value < tape.inputs:
            return f"x[{value}]"
        if value < first:
            number = f"k[{value - tape.inputs}]"
            return f"all({number})" if needs_vector else number
        return f"v{value - first}"

    for i, (kind, a, b) in enumerate(tape.nodes):
        if kind in ("sin", "cos"):
            if a not in turns:
                turns[a] = f"t{i}"
                lines.append(f"  const Turn t{i} = sincos({text(a, needs_vector=True)});")
            lines.append(f"  const V v{i} = {turns[a]}.{kind[0]};")
            continue
        operation = OPERATIONS[kind]
        needs_vector = operation.needs_vector or all(tape.inputs <= v < first for v in (a, b))
        body = operation.cpp.format(
            text(a, needs_vector=needs_vector), text(b, needs_vector=needs_vector) if b >= 0 else ""
        )
        lines.append(f"  const {'M' if kind in LOGICAL else 'V'} v{i} = {body};")
    lines += [f"  y[{i}] = {text(value, needs_vector=True)};" for i, value in enumerate(tape.results)]
    return "\n".join([*lines, "}", ""])
