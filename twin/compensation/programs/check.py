"""Examination of a program before anything is computed: what it needs, what would be corrected, and what stops it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.bundled import find_program
from twin._common.errors import InputError
from twin._common.messages import Message, Quoted, joined, say
from twin._common.records import json_form
from twin.compensation.programs.block_conditions import durations_s
from twin.compensation.programs.follow import follow_sections
from twin.compensation.programs.motions import LostBlock, ToolPath, by_reason, machine_hints
from twin.compensation.programs.prepared import Options
from twin.compensation.programs.report import LineNote, grouped
from twin.compensation.programs.uncorrected import FrameUse, frame_uses, line_numbers
from twin.compensation.programs.words import WordSpace, outside_range
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.nc import dialect_of, read_program
from twin.nc.blocks import AxisWords, Interpretation, Kind, Program
from twin.nc.dialect import Dialect
from twin.nc.inline import errors_in_files

Verdict = Literal["ready", "in part", "refused"]
VERDICTS: Final[dict[Verdict, Message]] = {
    "ready": Message("ready"),
    "in part": Message("in part"),
    "refused": Message("refused"),
}
NOUNS: Final = {
    "rapid": (Message("1 rapid"), partial(Message, "{count:,} rapids")),
    "linear": (Message("1 straight feed"), partial(Message, "{count:,} straight feeds")),
    "arc": (Message("1 arc"), partial(Message, "{count:,} arcs")),
    "hole": (Message("1 hole"), partial(Message, "{count:,} holes")),
}
"""Kinds of blocks, one and several."""
_MODES: Final = {
    "tcp": Message("tool centre point control"),
    "planes": Message("tilted planes"),
    "beside": Message("cutter radius compensation, or corners and curves left to the control"),
    "cycles": Message("drilling cycles"),
    "written_out": Message("subprograms, loops or jumps written out"),
}


@final
@dataclass(frozen=True)
class Travel:
    """Positions of one axis at the ends of blocks."""

    low: float  # low, high: mm or degrees, in axis coordinates
    high: float
    beyond: tuple[int, ...]  # line numbers of blocks that end outside its range


@final
@dataclass(frozen=True)
class LeftBlocks:
    """Blocks that would stay as written, for one reason."""

    reason: str  # why
    lines: tuple[int, ...]  # their line numbers
    feeds: int  # how many of them are feeds


@final
@dataclass(frozen=True, repr=False)
class ProgramCheck(Result):
    """Result of examining a program: its needs, the blocks that would be corrected, and its refusal.

    Attributes:
        program: its path as given.
        language: name of its language; empty if it is not recognised.
        control: the control whose words it has; empty if they are those of several.
        error: why it would be refused; None if it would not.
        lines: number of its lines.
        blocks: number of blocks by kind: ``rapid``, ``linear``, ``arc``; those that execute a cycle as ``hole``.
        uses: of tool centre point control, planes, cutter radius compensation, cycles and written-out parts: the first line of each.
        travel: by axis, those that it moves.
        tools, offsets: names of the tools and work offsets that it selects, each with its first line, up to one that cannot be read.
        lacks: axes that it names and the machine does not have, up to the first line that cannot be read.
        frames: work offsets, tools and planes in force.
        left: blocks that would stay as written.
        notes: assumptions and blocks that pass through unchanged.
        time_s: duration by feed and path, without accelerations; None if a feed is missing.
    """

    program: Path
    language: str = ""
    control: str = ""
    error: InputError | None = None
    lines: int = 0
    blocks: Mapping[str, int] = field(default_factory=dict)
    uses: Mapping[str, int] = field(default_factory=dict)
    travel: Mapping[str, Travel] = field(default_factory=dict)
    tools: Mapping[str, int] = field(default_factory=dict)
    offsets: Mapping[str, int] = field(default_factory=dict)
    lacks: tuple[str, ...] = ()
    frames: tuple[FrameUse, ...] = ()
    left: tuple[LeftBlocks, ...] = ()
    notes: tuple[LineNote, ...] = ()
    time_s: float | None = None

    @property
    def verdict(self) -> Verdict:
        """``ready``; ``in part``: some feeds would not be corrected; ``refused``."""
        if self.error is not None:
            return "refused"
        beyond = any(axis.beyond for axis in self.travel.values())
        return "in part" if beyond or any(one.feeds for one in self.left) else "ready"

    @property
    def brief(self) -> Message:
        """Summary in one line."""
        if self.error is not None:
            lacks = Message("the machine lacks {names}; ", names=" ".join(self.lacks)) if self.lacks else ""
            return Message("refused: {lacks}{error}", lacks=lacks, error=Quoted(str(self.error)))
        head = joined(": ", [VERDICTS[self.verdict], self._language])
        parts = [head, *self._counted, *(_MODES[use] for use in self.uses)]
        beyond = sorted({line for axis in self.travel.values() for line in axis.beyond})
        if beyond:
            names = " ".join(name for name, axis in self.travel.items() if axis.beyond)
            parts.append(Message("beyond the range of {names}: {lines}", names=names, lines=line_numbers(beyond)))
        feeds = sum(one.feeds for one in self.left)
        if feeds:
            parts.append(Message("feeds left as written: {count}", count=feeds))
        return joined(", ", parts)

    @property
    def _language(self) -> str:
        return f"{self.language} ({self.control})" if self.control else self.language

    @property
    def _counted(self) -> list[Message]:
        return [
            NOUNS[kind][0] if number == 1 else NOUNS[kind][1](count=number)
            for kind, number in self.blocks.items()
            if number
        ]

    def to_text(self) -> str:
        """Return the whole examination as text."""
        needs = [
            f"  {say(title):<14}"
            + ", ".join(say(Message("{name} (line {line})", name=name, line=line)) for name, line in found.items())
            for title, found in ((Message("tools"), self.tools), (Message("work offsets"), self.offsets))
            if found
        ]
        if self.error is not None:
            return "\n".join([f"{self.program}: {say(self.brief)}", *needs, ""])
        minutes = (
            Message("unknown: a feed is missing")
            if self.time_s is None
            else Message("{minutes:.1f} min by feed and path", minutes=self.time_s / 60.0)
        )
        lines = Message("{language}, {count} lines", language=self._language, count=self.lines)
        facts = (
            (Message("language"), lines),
            (Message("blocks"), joined(", ", self._counted)),
            (Message("time"), minutes),
        )
        uses = [Message("{use}, from line {line} on", use=_MODES[use], line=line) for use, line in self.uses.items()]
        out = [
            f"{self.program}: {say(VERDICTS[self.verdict])}",
            *(f"  {say(title):<14}{say(text)}" for title, text in facts),
            *needs,
            *(f"  {say(text)}" for text in uses),
            *(f"  {'' if i else say('set-up'):<14}{say(one.sentence)}" for i, one in enumerate(self.frames)),
        ]
        for name, axis in self.travel.items():
            beyond = Message("; beyond its range in {lines}", lines=line_numbers(axis.beyond)) if axis.beyond else ""
            span = Message("{low:.3f} to {high:.3f}{beyond}", low=axis.low, high=axis.high, beyond=beyond)
            out.append(f"  {name:<14}{say(span)}")
        left = [
            Message("left as written: {lines}: {reason}", lines=line_numbers(one.lines), reason=one.reason)
            for one in self.left
        ]
        return "\n".join([*out, *(f"  {say(text)}" for text in (*left, *grouped(self.notes))), ""])

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON report."""
        error = None if self.error is None else str(self.error)
        found = json_form(self, leave_out=("program", "error"))
        return {"program": str(self.program), "verdict": self.verdict, "error": error, **found}


def check_program(program: str | Path, machine: Machine, *, options: Options | None = None) -> ProgramCheck:
    """Examine a program on a machine without errors: nothing is corrected or written.

    Args:
        program: its path, or the name of one that comes with twin.
        machine: the machine that it is for.
        options: set-up, tool length, mode, language and folders of subprograms, as for a compensation.

    Examples:
        >>> check = twin.check_program("cone_frustum.nc", twin.Machine.load("dmu50"))
        >>> check.verdict, check.language, check.blocks["linear"]
        ('ready', 'iso', 362)
    """
    chosen = Options() if options is None else options
    found = ProgramCheck(Path(program))
    try:
        source = find_program(program)
        found = replace(found, language=dialect_of(source, chosen.language).name)
        read, dialect = read_program(source, chosen.language, chosen.subprograms)
        space = WordSpace(machine, chosen.setup, chosen.tool_length_mm)
        found = _with_needs(found, read, dialect, space.axes, tcp=chosen.tcp)
        texts = read.texts
        with errors_in_files(read), machine_hints(machine, dialect, lambda line: "".join(texts[line - 1 : line])):
            return _examined(found, read, dialect, space, tcp=chosen.tcp)
    except InputError as error:
        return replace(found, error=error)


def _with_needs(found: ProgramCheck, read: Program, dialect: Dialect, axes: AxisWords, *, tcp: bool) -> ProgramCheck:
    """Return the tools, work offsets and axes that a program names, up to the first line that cannot be read on any machine."""
    rotary = tuple(name for name in "ABCUVW" if name not in (*axes.linear, *axes.auxiliary_axes))
    increment = dict.fromkeys((*axes.linear, *rotary), 0.001)
    every = replace(axes, rotary=rotary, increment=increment, offsets_known=True, tools_known=True, references={})
    try:
        reading = dialect.moves(read, every, tcp=tcp)
    except InputError as error:
        until = replace(read, texts=read.texts[: (error.line or 1) - 1], origins=())
        reading = dialect.moves(until, every, tcp=tcp) if len(until.texts) else Interpretation(())
    named = {name for move in reading.moves for name in move.named}
    tools, offsets = dict[str, int](), dict[str, int]()
    for line, frame in reading.frames:
        for name, names in ((frame.tool or frame.length, tools), (frame.offset, offsets)):
            if name not in ("", "0"):
                names.setdefault(name, int(read.numbers[line]))
    lacks = tuple(sorted(named - {*axes.names}))
    return replace(found, control=reading.control, tools=tools, offsets=offsets, lacks=lacks)


def _examined(found: ProgramCheck, read: Program, dialect: Dialect, space: WordSpace, *, tcp: bool) -> ProgramCheck:
    """Return the examination of a program that can be read."""
    reading = dialect.moves(read, space.axes, tcp=tcp)
    sections, way, parts = follow_sections(read, reading, space)
    numbers = read.numbers
    travel = _travel(space, [(part.space, part.path, part.context) for part in parts], numbers)
    try:
        said = dialect.technology(read)
        time_s = (
            said.dwell_s.sum() + durations_s(read.source, said, way, [(part.begin, part.space) for part in parts]).sum()
        )
    except InputError:
        time_s = None
    return replace(
        found,
        control=reading.control,
        lines=len(read.texts),
        blocks=_blocks(reading),
        uses=_uses(read, reading),
        travel=travel,
        frames=frame_uses(sections.found, lambda line: int(numbers[line])) if sections.selects else (),
        left=_left(way.unknown, numbers),
        notes=tuple(LineNote(int(numbers[one.line]), one.text) for one in (*reading.notices, *way.notices)),
        time_s=None if time_s is None else float(time_s),
    )


def _blocks(reading: Interpretation) -> dict[str, int]:
    """Return the number of blocks by kind."""
    kinds = {Kind.RAPID: 0, Kind.LINEAR: 0, Kind.ARC: 0}
    drilled = {line for part in reading.drilled for line in part}
    for move in reading.moves:
        kinds[move.kind] += move.line not in drilled
    return {**{kind.value: number for kind, number in kinds.items()}, "hole": len(drilled)}


def _uses(read: Program, reading: Interpretation) -> dict[str, int]:
    """Return the first line of each use that matters to a correction."""
    first: dict[str, int] = {}
    for use, lines in (
        ("tcp", (move.line for move in reading.moves if move.tcp)),
        ("planes", (change.line for change in reading.frames if change.frame.plane is not None)),
        ("beside", (move.line for move in reading.moves if move.whole)),
        ("cycles", (part.start for part in reading.drilled)),
    ):
        line = next(iter(lines), None)
        if line is not None:
            first[use] = int(read.numbers[line])
    if read.origins:
        first["written_out"] = 1
    return first


def _left(unknown: Sequence[LostBlock], numbers: np.ndarray) -> tuple[LeftBlocks, ...]:
    return tuple(
        LeftBlocks(reason, tuple(int(numbers[one.line]) for one in blocks), sum(one.cutting for one in blocks))
        for reason, blocks in by_reason(unknown).items()
    )


def _travel(
    space: WordSpace, parts: Sequence[tuple[WordSpace, ToolPath, int]], numbers: np.ndarray
) -> dict[str, Travel]:
    """Return the positions of the axes at the ends of blocks, by name of axis, those that move or leave their range."""
    machine = space.machine
    commands = np.concatenate(
        [within.commands(path.columns.end, path.columns.tcp)[context:] for within, path, context in parts]
    )
    lines = np.concatenate([path.columns.line[context:] for _, path, context in parts])
    outside = outside_range(machine, commands)
    ranges = machine.limits / machine.scale[:, None]
    travel = {}
    for i, axis in enumerate(machine.axes):
        beyond = outside & ~((commands[:, i] >= ranges[i, 0] - 1e-9) & (commands[:, i] <= ranges[i, 1] + 1e-9))
        low, high = float(commands[:, i].min()), float(commands[:, i].max())
        travel[axis.name] = Travel(low, high, tuple(np.unique(numbers[lines[beyond]]).tolist()))
    return travel
