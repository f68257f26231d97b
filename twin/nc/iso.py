"""ISO programs (G-code) in the flavours of Fanuc, LinuxCNC and Siemens 840D."""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

from twin.nc.blocks import AxisWords, Dialect, Move, Program, Reading, Rewrite
from twin.nc.emit import pieces_of
from twin.nc.iso_state import Interpreter
from twin.nc.iso_write import Writer
from twin.nc.text import Style, newline_of, read_lines, style_in


@final
class Iso(Dialect):
    """G-code."""

    name = "iso"
    suffixes = (".nc", ".ngc", ".tap", ".mpf", ".txt", ".iso", ".eia")

    def read(self, data: bytes, source: str) -> Program:
        """Split bytes into lines; see `Dialect.read`."""
        return read_lines(data, source, self.name)

    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Reading:
        """Interpret a program; see `Dialect.moves`."""
        interpreter = Interpreter(program.source, axes, tcp=tcp)
        moves: list[Move] = []
        for index, line in enumerate(program.lines):
            block = interpreter.step(index, line.text)
            if block is not None and block.moves:
                moves += block.moves
        return Reading(tuple(moves), tuple(interpreter.notices))

    def rewrite(self, program: Program, axes: AxisWords, reading: Reading, rewrites: Iterable[Rewrite]) -> str:
        """The text with moves replaced; see `Dialect.rewrite`."""
        by_line = pieces_of(reading, rewrites, axes)
        if not by_line:
            return program.text
        strokes = any(place > 0 for places in by_line.values() for place in places)
        # A switch of kinematics before the first move makes the start irrelevant, else the first move shows it.
        interpreter = Interpreter(program.source, axes, tcp=reading.moves[0].tcp)
        cycles = {move.line for move in reading.moves}
        drilled = len(cycles) != len(reading.moves) and (strokes or _touches_cycle(reading, by_line))
        writer = Writer(
            program.source, axes, newline_of(program), style_in(program, Style(point=True)), expand_cycles=drilled
        )
        out: list[str] = []
        for index, line in enumerate(program.lines):
            block = interpreter.step(index, line.text)
            out.append(line.text if block is None else writer.block(index, block, by_line.get(index)))
        return "".join(out)


def _touches_cycle(reading: Reading, by_line: dict[int, dict[int, tuple[Rewrite, list[list[float]]]]]) -> bool:
    """Whether a block that a drilling cycle follows is rewritten (the cycle is then written out)."""
    seen: set[int] = set()
    twice = {move.line for move in reading.moves if move.line in seen or seen.add(move.line)}  # type: ignore[func-returns-value]
    return any(line in by_line for line in twice)
