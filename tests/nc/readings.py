"""twin's reading of a program beside that of LinuxCNC's interpreter, block by block."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from tests.nc import rs274
from tests.nc.modal_programs import Event
from tests.nc.nc_support import AXES
from twin._common.errors import InputError
from twin.nc import read_program
from twin.nc.blocks import Kind, Move
from twin.nc.inline import errors_in_files

EQUAL_MM = 1e-6
SAME_MM = 1e-7
"""A stroke shorter than this does not count: one of the two may leave it out."""


def event_of(move: Move) -> Event:
    """Return a move of a reading as an event."""
    if move.arc is None:
        return Event(0 if move.kind is Kind.RAPID else 1, move.position)
    sweep = move.arc.angle_rad
    return Event(3 if sweep > 0 else 2, move.position, move.arc.plane[:2], move.arc.centre_mm, sweep)


@dataclass(frozen=True)
class Comparison:
    """Result of comparing two readings.

    Attributes:
        difference: the first block that the two read differently, in words; empty if there is none.
        refused: twin's message, empty if it reads the whole program.
        line: the line that it refuses.
        said: twin's notices.
        blocks: blocks with motions that agree.
        values: known positions that agree.
        judge: the interpreter's reading; it is not asked where twin refuses.
    """

    difference: str = ""
    refused: str = ""
    line: int | None = None
    said: str = ""
    blocks: int = 0
    values: int = 0
    judge: rs274.Reading | None = None


def compare(path: Path, folder: Path, *, known: bool = True, tools: str = "", parameters: str = "") -> Comparison:
    """Return the comparison for a program; ``known``: whether twin takes the values of offsets and tools as known."""
    axes = replace(AXES, tools_known=known, offsets_known=known, one_tool=False)
    try:
        program, dialect = read_program(path)
        with errors_in_files(program):
            reading = dialect.moves(program, axes, tcp=False)
    except InputError as error:
        return Comparison(refused=str(error), line=error.line)
    judge = rs274.read(path, folder, tools=tools, parameters=parameters)
    said = " ".join(notice.text for notice in (*reading.notices,))
    line_of = [origin.line for origin in program.origins] or range(1, len(program.texts) + 1)
    lost = {line_of[max(one.line, 0)] for one in reading.lost_positions}
    moved = {motion.line for motion in judge.motions}
    read = {move.line for move in reading.moves}  # an arc from an unknown position is a move of twin's, too
    returns = [
        one.line for one in reading.lost_positions if line_of[max(one.line, 0)] in moved and one.line not in read
    ]

    def block(move: Move) -> tuple[int, int]:
        """Return the line, and how many reference returns come before: the same line may follow itself in a subprogram."""
        return line_of[move.line], bisect_left(returns, move.line)

    ours = [(line, list(group)) for (line, _), group in groupby(reading.moves, block)]
    theirs = [(line, list(group)) for line, group in groupby(judge.motions, lambda motion: motion.line)]
    return replace(_difference(ours, theirs, lost, not judge.refusal), judge=judge, said=said)


def _difference(
    ours: Sequence[tuple[int, list[Move]]],
    theirs: Sequence[tuple[int, list[rs274.Motion]]],
    lost: set[int],
    whole: bool,
) -> Comparison:
    """Return the comparison of the blocks that have motions.

    Args:
        whole: whether the interpreter came to the end of the program.
    """
    at, blocks, values = 0, 0, 0
    before: tuple[tuple[float, ...], tuple[float, ...]] = ((0.0,) * 5, (0.0,) * 5)
    for line, motions in theirs:
        if at == len(ours) or ours[at][0] != line:
            if motions[-1].event.end == before[0] and not motions[-1].event.sweep:
                continue  # G0 alone
            # A reference return: its places are not known to twin, and it says so.
            if line in lost:
                before = (motions[-1].event.end, (float("nan"),) * 5)
                continue
            there = f"line {ours[at][0]}: {ours[at][1]}" if at < len(ours) else "nothing more"
            return Comparison(f"line {line}: {motions} but twin has {there}", blocks=blocks, values=values)
        moves = ours[at][1]
        if not whole and motions is theirs[-1][1]:
            moves = moves[: len(motions)]  # the interpreter has stopped within a subprogram or loop
        found = _block(moves, motions, before)
        if isinstance(found, str):
            return Comparison(f"line {line}: {found}", blocks=blocks, values=values)
        before = (motions[-1].event.end, moves[-1].position)
        at, blocks, values = at + 1, blocks + 1, values + found
    if at < len(ours) and whole:
        return Comparison(f"twin has line {ours[at][0]}: {ours[at][1]}", blocks=blocks, values=values)
    return Comparison(blocks=blocks, values=values)


def _block(
    moves: list[Move], motions: list[rs274.Motion], before: tuple[tuple[float, ...], tuple[float, ...]]
) -> int | str:
    """Return how many values of a block agree, or the difference in words."""
    if moves[0].unknown:
        return 0
    one = [event_of(move) for move in moves]
    other = [motion.event for motion in motions]
    if len(one) == len(other):  # what twin does not know is not compared
        other = [event for event, move in zip(other, moves, strict=True) if not move.unknown]
        one = [event for event, move in zip(one, moves, strict=True) if not move.unknown]
    else:
        one, other = _moving(one, before[1]), _moving(other, before[0])
    shown = f"{moves} and {motions}"
    if len(one) != len(other):
        return f"{len(one)} and {len(other)} motions: {shown}"
    values = 0
    for a, b in zip(one, other, strict=True):
        end = motions[0].machine if moves[0].machine else b.end
        if a.code != b.code or a.plane != b.plane or not _near([*a.end, *a.centre], [*end, *b.centre]):
            return shown
        if abs(a.sweep - b.sweep) > 1e-6:
            return shown
        values += sum(value == value for value in a.end)
    return values


def _near(ours: Sequence[float], theirs: Sequence[float]) -> bool:
    """Return whether known values agree."""
    return all(a != a or abs(a - b) < EQUAL_MM for a, b in zip(ours, theirs, strict=True))


def _moving(events: list[Event], before: tuple[float, ...]) -> list[Event]:
    """Return the events of a block without those that stay where they are."""
    kept, last = [], before
    for event in events:
        if event.sweep or any(
            abs(a - b) >= SAME_MM or (a != a) != (b != b) for a, b in zip(event.end, last, strict=True)
        ):
            kept.append(event)
        last = event.end
    return kept
