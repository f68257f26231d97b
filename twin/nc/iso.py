"""ISO programs (G-code) in the flavours of Fanuc, LinuxCNC and Siemens 840D."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import final

from twin.nc.blocks import AxisWords, Move, Program, Reading, Rewrite
from twin.nc.dialect import TextDialect
from twin.nc.emit import pieces_of
from twin.nc.header import with_iso_comments
from twin.nc.iso_plain import PlainInterpreter
from twin.nc.iso_write import Writer
from twin.nc.plain import NOTHING, iso_plain
from twin.nc.text import BLANK, Style, newline_of, style_in


@final
class Iso(TextDialect):
    """G-code."""

    name = "iso"
    suffixes = (".nc", ".ngc", ".tap", ".mpf", ".txt", ".iso", ".eia")

    def commented(self, text: str, comments: Sequence[str]) -> str:
        """See `Dialect.commented`."""
        return with_iso_comments(text, comments) if comments else text

    def _moves(self, program: Program, axes: AxisWords, *, tcp: bool, short_way: bool = True) -> Reading:
        """See `TextDialect._moves`."""
        interpreter = PlainInterpreter(program.source, axes, tcp=tcp)
        match = (iso_plain(axes.names).pattern if short_way else NOTHING).fullmatch
        plain, step = interpreter.plain, interpreter.step
        moves: list[Move] = []
        for index, text in enumerate(program.texts):
            if text in BLANK:
                continue
            found = match(text)
            if found is not None:
                move = plain(index, found)
                if move is not None:
                    moves.append(move)
                    continue
            block = step(index, text)
            if block is not None and block.moves:
                moves += block.moves
        return Reading(tuple(moves), tuple(interpreter.notices), tuple(interpreter.left))

    def _rewrite(
        self,
        program: Program,
        axes: AxisWords,
        reading: Reading,
        rewrites: Iterable[Rewrite],
        *,
        short_way: bool = True,
    ) -> str:
        """See `TextDialect._rewrite`."""
        by_line = pieces_of(reading, rewrites, axes)
        if not by_line:
            return program.text
        strokes = any(place > 0 for places in by_line.values() for place in places)
        # A switch of kinematics before the first move makes the start irrelevant, else the first move shows it.
        interpreter = PlainInterpreter(program.source, axes, tcp=reading.moves[0].tcp)
        cycles = {move.line for move in reading.moves}
        drilled = len(cycles) != len(reading.moves) and (strokes or _touches_cycle(reading, by_line))
        writer = Writer(
            program.source, axes, newline_of(program), style_in(program.texts, Style(point=True)), expand_cycles=drilled
        )
        match = (iso_plain(axes.names).pattern if short_way else NOTHING).fullmatch
        out: list[str] = []
        for index, text in enumerate(program.texts):
            pieces = by_line.get(index)
            found = match(text)
            if found is not None:
                new = writer.plain(index, found, interpreter, pieces)
                if new is not None:
                    out.append(new)
                    continue
            block = interpreter.step(index, text)
            out.append(text if block is None else writer.block(index, block, pieces))
        return "".join(out)


def _touches_cycle(reading: Reading, by_line: dict[int, dict[int, tuple[Rewrite, list[list[float]]]]]) -> bool:
    """Whether a block that a drilling cycle follows is rewritten (the cycle is then written out)."""
    seen: set[int] = set()
    twice = {move.line for move in reading.moves if move.line in seen or seen.add(move.line)}  # type: ignore[func-returns-value]
    return any(line in by_line for line in twice)
