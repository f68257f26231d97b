"""Convert a program's moves to motions, tracking the position of every axis.

The position of an axis is its word plus the work offset. To the third linear axis the control adds the length of the tool while one
is in force; without a table of tools, but with one of work offsets, always. In tool centre point mode the work offset moves the
program's zero on the workpiece instead: it is the place of the spindle nose at the offset's linear values and rotary axes at zero. In a
tilted plane the words are places on the tilted workpiece, and the control keeps the rotary axes at the positions of the plane.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin.compensation.programs.motions import (
    CHORD_MM,
    MOST_SAMPLES,
    SAMPLE_SPACING,
    LostBlock,
    MotionColumns,
    Passage,
    PathMotion,
    ProgramMotions,
    ToolPath,
)
from twin.compensation.programs.words import Tilt, WordSpace
from twin.model.calibration import Calibration
from twin.nc.blocks import (
    NO_POSITION,
    STATED_LENGTH,
    FrameChange,
    Interpretation,
    Kind,
    LostPositions,
    Move,
    MoveColumns,
    Notice,
    Plane,
    Program,
    WordFrame,
    as_columns,
)
from twin.tool.forward import Kinematics

TextOf = Callable[[int], str]
"""Function from a line's index in the program to its text."""


def follow(program: Program, reading: Interpretation, space: WordSpace, found: Sequence[Section] = ()) -> ToolPath:
    """Return a program as motions with known end points; `InputError` for an unknown position or a tool vector out of reach."""
    follower = Follower(program.source, space)
    follower.enter(found)
    moves = as_columns(space.axes.names, reading.moves)
    columns = follower.columns(moves, reading.lost_positions, lambda line: program.texts[line])
    return follower.path(columns, moves)


def motionless(source: str, unknown: Sequence[LostBlock] = ()) -> InputError:
    """Return the error for a program without a motion between known positions; ``unknown``: its blocks that go to unknown places."""
    what = "no block moves an axis to a known position"
    if not unknown:
        return InputError(what, expected="a program with axis motion", file=source)
    expected = "statements whose effect is known, or machine coordinates of every axis after them"
    return InputError(f"{what}: {unknown[0].reason}", expected=expected, file=source, line=unknown[0].line + 1)


@final
class Follower:
    """Converts a program's moves to motions, in one stretch or several, tracking the position of every axis.

    ``notices``, ``passages``, ``unknown``: as in `ToolPath`, so far.
    """

    def __init__(self, source: str, space: WordSpace) -> None:
        self.notices: list[Notice] = []
        self.passages: list[Passage] = []
        self.unknown: list[LostBlock] = []
        self._count = 0
        self._source = source
        self._space = space
        self._later: list[tuple[int, WordSpace]] = []
        self._words = np.full(len(space.axes.names), np.nan)
        self._lost = np.zeros(len(self._words), dtype=bool)
        """Whether each axis has been moved to an unknown place since its last known position."""
        self._references: dict[int, str] = {}
        """The reference return that has moved an axis, by its index in word order."""
        self._tcp: bool | None = None
        self._assumed = False
        self._left: list[LostPositions] = []

    def path(self, columns: MotionColumns, moves: Sequence[Move]) -> ToolPath:
        """Return all motions of a program, with its moves as read and what lies between them."""
        passed = tuple(self.notices), tuple(self.passages), tuple(self.unknown)
        return ToolPath(ProgramMotions(columns, moves), columns, *passed)

    def enter(self, found: Sequence[Section]) -> None:
        """Take over sections that begin at later moves, or at the first one."""
        if found and self._tcp is None and not found[0].line:
            self._space, found = found[0].space, found[1:]
        self._later = [*((section.line, section.space) for section in found[::-1]), *self._later]

    def columns(self, moves: MoveColumns, left: Sequence[LostPositions], text_of: TextOf) -> MotionColumns:
        """Return the motions of the next moves, plain ones together; ``left``: lines that leave axes at unknown positions."""
        self._left = [*left[::-1], *self._left]
        if np.any(moves.by_vector):
            self._space.branches  # noqa: B018  # refuses a machine that cannot follow tool vectors
        single = {i for i, move in moves.special.items() if move.arc is not None or move.passes or move.whole}
        changes = np.searchsorted(moves.line, [one.line for one in left], side="right")
        later = np.searchsorted(moves.line, [line for line, _ in self._later])
        modes = (np.diff(moves.tcp) | np.diff(moves.by_vector)).nonzero()[0] + 1
        stops = np.array(sorted({*single, *(i + 1 for i in single), *modes, *changes, *later, len(moves)}), dtype=int)
        parts: list[MotionColumns] = []
        loose: dict[int, PathMotion] = {}
        at = 0
        while at < len(moves):
            self._forget_before(int(moves.line[at]))
            end = int(stops[np.searchsorted(stops, at, side="right")])
            plain = (
                end > at + 1 and at not in single and self._tcp == bool(moves.tcp[at]) and not self._moved(moves, at)
            )
            if plain and np.isfinite(self._words).all():
                found = self._plain(moves, at, end)
                if len(found):
                    parts += [MotionColumns.of(loose, len(self._words)), found]
                    loose = {}
                    at += len(found)
                    continue
            motion = self._step(moves[at], text_of)
            if motion is not None:
                loose[at] = motion
            at += 1
        return self._checked(MotionColumns.joined([*parts, MotionColumns.of(loose, len(self._words))]), text_of)

    def _moved(self, moves: MoveColumns, at: int) -> bool:
        """Return whether a conversion begins at a move that is not yet in force."""
        return bool(self._later) and self._later[-1][0] <= int(moves.line[at])

    def _plain(self, moves: MoveColumns, begin: int, end: int) -> MotionColumns:
        """Return the motions of moves that only name positions or vectors within reach, when every axis position is known."""
        part = slice(begin, end)
        named = moves.position[part]
        ends = _carried_on(named, self._words)
        if np.isfinite(moves.vector[begin, 0]):
            solutions = self._space.branches.all(moves.vector[part])
            rotary = self._space.branches.along(solutions, self._words[3:], self._space.offset[3:])
            ends = ends[: len(rotary)]
            ends[:, 3:] = rotary
            part = slice(begin, begin + len(rotary))
        starts = np.concatenate([self._words[None, :], ends[:-1]])[: len(ends)]
        self._words = ends[-1].copy() if len(ends) else self._words
        self._count += len(ends)
        return MotionColumns(
            np.arange(part.start, part.stop),
            moves.line[part],
            moves.rapid[part],
            moves.tcp[part],
            starts,
            ends,
            moves.by_vector[part],
            {},
        )

    def _forget_before(self, line: int) -> None:
        """Mark axis positions as unknown that lines before this one have made unknown."""
        while self._left and self._left[-1].line < line:
            left, words = self._left.pop(), self._words
            forgotten = np.isin(np.arange(len(words)), left.axes)
            self._pass(np.full(len(words), np.nan), forgotten)
            self._references |= {axis: left.reference for axis in left.axes if left.reference}
            if left.moved:
                self._words, self._lost = np.where(forgotten, np.nan, words), self._lost | forgotten
                self._assumed = self._assumed and not forgotten[3:].any()

    def _pass(self, commands: np.ndarray, moved: np.ndarray) -> None:
        """Record a passage; both arguments are in word order."""
        ordered, which = np.empty_like(commands), np.empty_like(moved)
        ordered[self._space.order], which[self._space.order] = commands, moved
        self.passages.append(Passage(self._count, ordered, which))

    def _step(self, move: Move, text_of: TextOf) -> PathMotion | None:
        """Return one move as a motion; None if it is not a motion between known positions."""
        self._forget_before(move.line)
        while self._later and self._later[-1][0] <= move.line:
            self._change_space(self._later.pop()[1])
        if move.tcp != self._tcp:
            if self._tcp is not None:
                self._words = self._space.switched_if_known(self._words, tcp=move.tcp)
            self._tcp = move.tcp
        if move.unknown and not move.machine:
            if move.unknown.startswith(NO_POSITION):
                self._pass_arc(move, text_of)
            else:
                self._lose(move)
            return None
        words, end = self._words, np.array(move.position)
        if move.machine:
            self._place(move, end)
            return None
        unmoved = np.isnan(end) & self._named(move) & (move.vector is None)  # increments of zero at unknown positions
        end = np.where(np.isnan(end), words, end)
        if move.vector is not None:
            end[3:] = self._along_vector(move, words[3:])
        unmoved |= np.isnan(end) & self._lost & (np.arange(len(end)) >= 3)
        if np.isnan(end[3:]).any() and not unmoved.any():
            end[3:] = self._assume(move.line, end[3:])
        start = words.copy()
        start[3:] = np.where(np.isnan(start[3:]), end[3:], start[3:])
        self._words, self._lost = end, self._lost & np.isnan(end)
        if unmoved.any() or np.isnan(end[:3]).any():
            self._unknown_position(move, end, unmoved, text_of)
            return None
        self._count += 1
        return PathMotion(move, start, end)

    def _place(self, move: Move, end: np.ndarray) -> None:
        """Pass a block in coordinates of the machine, or of an unknown work offset, through; ``end``: NaN where they are unknown."""
        named = self._named(move)
        self._pass(end, named)
        self._words = self._space.of_positions(np.where(named, end, self._space.positions(self._words)))
        if move.tcp or self._space.tilt is not None:
            self._words[:3] = np.nan  # the position of the tip then depends on the control
        self._lost = np.where(named, np.isnan(end), self._lost)
        if move.unknown:
            self.unknown.append(LostBlock(move.line, move.kind is not Kind.RAPID, move.unknown))
        else:
            self.notices.append(Notice(move.line, "machine coordinates: passed through unchanged"))

    def _lose(self, move: Move) -> None:
        """Pass a block to an unknown place through."""
        self.unknown.append(LostBlock(move.line, move.kind is not Kind.RAPID, move.unknown))
        everywhere = np.full(len(self._words), np.nan)
        known = not self.passages or np.isfinite(self.passages[-1].commands).any() or not self.passages[-1].moved.all()
        if known or self.passages[-1].before != self._count:
            self._pass(everywhere, np.ones(len(everywhere), dtype=bool))
        self._words, self._assumed = everywhere, False
        self._lost = np.isnan(everywhere)

    def _checked(self, motions: MotionColumns, text_of: TextOf) -> MotionColumns:
        """Return motions; raise `InputError` for the first that needs more than `MOST_SAMPLES` samples."""
        long = motions.spacings > MOST_SAMPLES
        for i, move in motions.special.items():
            long[i] |= move.arc is not None and motions[i].chords(CHORD_MM) > MOST_SAMPLES
        if not long.any():
            return motions
        line = int(motions.line[int(np.argmax(long))])
        most_mm, most_deg = (MOST_SAMPLES * one for one in SAMPLE_SPACING)
        raise InputError(
            "the motion is too long",
            expected=f"at most {most_mm:,.0f} mm, {most_deg:,.0f}° or {MOST_SAMPLES:,} chords of an arc: is a decimal point missing?",
            file=self._source,
            line=line + 1,
            value=text_of(line).strip(),
        )

    def _named(self, move: Move) -> np.ndarray:
        """Return (axes,) which words a move has."""
        return np.array([name in move.named for name in self._space.axes.names])

    def _change_space(self, space: WordSpace) -> None:
        """Convert the axis positions to words of another conversion, in which the program goes on."""
        words, tcp, tilt = self._words, bool(self._tcp), space.tilt
        known = np.isfinite(words).all()
        self._words = space.of_positions(self._space.positions(words))
        if known and (tilt is None or tilt.stays):
            mode = np.array([tcp])
            commands = self._space.commands(words[None, :], mode)
            if tilt is not None:
                commands[:, space.order[3:]] = tilt.rotary_deg
            self._words = space.words(commands, mode)[0]
        elif tcp or tilt is not None or self._space.tilt is not None:
            self._words[:3] = np.nan
        if tilt is not None:
            self._words[3:], self._lost[3:] = space.start, False
        self._space = space

    def _assume(self, line: int, rotary: np.ndarray) -> np.ndarray:
        """Return rotary words, with the set-up's values for unknown ones; a notice is recorded the first time."""
        space, unknown = self._space, np.isnan(rotary)
        if not self._assumed:
            rows = zip(space.axes.rotary, space.start, unknown, strict=True)
            assumed = {name: value for name, value, missing in rows if missing}
            at = ", ".join(f"{name} = {value:g}°" for name, value in assumed.items())
            self.notices.append(
                Notice(
                    line, f"the program gives no position of {' and '.join(assumed)} before this line: taken as {at}"
                )
            )
            self._assumed = True
        return np.where(unknown, space.start, rotary)

    def _unknown_position(self, move: Move, end: np.ndarray, unmoved: np.ndarray, text_of: TextOf) -> None:
        """Pass a move to an unknown position through; see `_check_arc`.

        ``unmoved``: (axes,) which axes it leaves, or names by an increment, where something has moved them.
        """
        space = self._space
        missing = unmoved | (np.isnan(end) & (np.arange(len(end)) < 3))
        names = ", ".join(name for name, unknown in zip(space.axes.names, missing, strict=True) if unknown)
        reason = f"{NO_POSITION} {names}"
        self._check_arc(move, reason, self._cure(missing), text_of)
        turns = missing[:3].any() and not (move.tcp or move.named & {*space.axes.linear})
        if turns or move.kind is Kind.RAPID:
            text = f"position of {names} not yet known: {'turn' if turns else 'rapid'} passed through unchanged"
            self.notices.append(Notice(move.line, text))
        else:
            self.unknown.append(LostBlock(move.line, True, reason + self._cure(missing)))
        commands = space.positions(end)
        commands[:3] = np.nan if move.tcp or space.tilt is not None else commands[:3]
        self._pass(commands, self._named(move))

    def _pass_arc(self, move: Move, text_of: TextOf) -> None:
        """Pass an arc from an unknown start through; see `_check_arc`."""
        self._check_arc(move, move.unknown, "", text_of)
        self.unknown.append(LostBlock(move.line, True, move.unknown))
        end, named = np.array(move.position), self._named(move)
        self._words = np.where(named, end, self._words)
        commands = self._space.positions(self._words)
        commands[:3] = np.nan if move.tcp or self._space.tilt is not None else commands[:3]
        self._pass(commands, named)

    def _check_arc(self, move: Move, reason: str, cure: str, text_of: TextOf) -> None:
        """Raise `InputError` for an arc left as written behind corrected blocks: its centre would not suit a corrected start."""
        if move.kind is Kind.ARC and self._count:
            raise InputError(
                f"arc where {reason}",
                expected=f"a position of these axes before it{cure}",
                file=self._source,
                line=move.line + 1,
                value=text_of(move.line).strip(),
            )

    def _cure(self, missing: np.ndarray) -> str:
        """Return the entries of the machine file that would make the positions of some axes known; empty if there are none."""
        words: dict[str, list[str]] = {}
        for axis in np.flatnonzero(missing & self._lost).tolist():
            if axis in self._references:
                words.setdefault(self._references[axis], []).append(f"{self._space.axes.names[axis]}: ...")
        entries = ", ".join(f"{word}: {{{', '.join(places)}}}" for word, places in words.items())
        return f" (in the machine file: programs: {{references: {{{entries}}}}})" if entries else ""

    def _along_vector(self, move: Move, before: np.ndarray) -> np.ndarray:
        space = self._space
        standing = np.where(np.isnan(before), space.start, before) + space.offset[3:]
        (nearest,) = space.branches.nearest(space.branches.all(np.array([move.vector])), standing[None])
        if np.isnan(nearest).any():
            raise InputError(
                f"{space.machine.name} cannot reach this tool vector",
                expected="a tool vector within the ranges of its rotary axes",
                file=self._source,
                line=move.line + 1,
                value=move.vector,
            )
        return np.asarray(nearest - space.offset[3:])


# --- Coordinates of a program that selects work offsets and tools: the set-up and the tool length of every frame


STANDS_DEG: Final = 0.01
"""Angle between the tool and the normal of a plane at which the program itself has positioned the rotary axes: rounding of words."""


@final
class FrameSpaces:
    """Conversions of words in the frames of one machine; the tool length of ``base`` applies where its tables do not say one."""

    def __init__(self, base: WordSpace) -> None:
        self._base = base
        self._made: dict[Hashable, WordSpace] = {}
        if base.setup.offsets is None and base.setup.tools is None:
            key = tuple(sorted(base.setup.work_offset.items())), base.setup.work_origin_mm, base.tool_length_mm
            self._made[key] = base

    @cached_property
    def _nose(self) -> Kinematics:
        return Kinematics(self._base.machine, Calibration.zero(self._base.machine), tool_length_mm=0.0)

    def of(self, frame: WordFrame, source: str, line: int, standing_deg: np.ndarray) -> WordSpace:
        """Return the conversion of words in a frame; the same object for equal work offsets and tool lengths.

        ``standing_deg``: (rotary axes,) commands before it. `InputError` for an unknown work offset or tool, or a plane out of reach.
        """
        base, setup, length = self._base, self._base.setup, self._base.tool_length_mm
        tools = setup.tools
        tool = frame.length or frame.tool
        if tool.startswith(STATED_LENGTH):
            length = float(tool.removeprefix(STATED_LENGTH))
        elif tools is not None and tool not in ("", "0"):
            length = tools.of(tool, source, line) + frame.delta_mm
        elif tools is not None and tool == "0":
            length = 0.0
        shift, origin = self._offset(frame, source, line)
        if frame.length or (tools is None and setup.offsets is not None):
            along = base.axes.linear[2]
            added = base.nominal.tool_length_mm if length is None else length
            shift[along] = shift.get(along, 0.0) + added
        turn = None
        if frame.plane is None:
            by = frame.shift or (0.0,) * len(base.axes.names)
            shift |= {name: shift.get(name, 0.0) + add for name, add in zip(base.axes.names, by, strict=True) if add}
            origin = origin[0] + by[0], origin[1] + by[1], origin[2] + by[2]
            turn = frame.turn
        key: tuple[Hashable, ...] = tuple(sorted(shift.items())), origin, length, *(() if turn is None else (turn,))
        if key not in self._made:
            plain = replace(setup, work_offset=shift, work_origin_mm=origin, offsets=None, tools=None)
            like = next((one for one in (base, *self._made.values()) if one.tool_length_mm == length), None)
            self._made[key] = WordSpace(
                base.machine, plain, length, turn=None if turn is None else np.array(turn, dtype=float), like=like
            )
        space = self._made[key]
        if frame.plane is None:
            return space
        rotary = self._rotary(space, frame.plane, standing_deg, source, line)
        key = (*key, frame.plane, frame.shift, frame.turn, frame.inclined, tuple(rotary.tolist()))
        if key not in self._made:
            self._made[key] = WordSpace(
                base.machine, space.setup, length, self._tilt(space, frame.plane, frame, rotary), like=space
            )
        return self._made[key]

    def _offset(self, frame: WordFrame, source: str, line: int) -> tuple[dict[str, float], tuple[float, float, float]]:
        """Return the work offset of a frame by axis, and the program's zero in the work frame."""
        setup, names = self._base.setup, self._base.axes.names
        stated = {name: value for name, value in zip(names, frame.stated, strict=False) if value is not None}
        if setup.offsets is not None:
            row = stated if len(stated) == len(names) else {**setup.offsets.of(frame.offset, source, line), **stated}
            shift = {name: row.get(name, 0.0) for name in names}
            return shift, self._origin(shift)
        return {**setup.work_offset, **stated}, setup.work_origin_mm

    def _tilt(self, space: WordSpace, plane: Plane, frame: WordFrame, rotary_deg: np.ndarray) -> Tilt:
        """Return the plane of a frame, with its zero in the words of ``space``; its shift and turn are along its own axes."""
        if self._base.setup.offsets is None:
            zero = np.zeros((1, len(space.order)))
            zero[:, space.order] = np.where(np.arange(len(space.order)) < 3, space.offset, 0.0)
            origin = space.nominal.forward(zero).point_mm[0]
        else:
            origin = space.origin
        if plane.rotation is None:
            standing, zero = (space.tool_axes(deg) for deg in (rotary_deg, np.zeros(len(rotary_deg))))
            rotation = standing @ zero.T
        else:
            rotation = np.array(plane.rotation)
        turn = np.eye(3) if frame.turn is None else np.array(frame.turn)
        shift = np.array(frame.shift[:3] or (0.0, 0.0, 0.0))
        at = origin + np.array(plane.origin_mm) + rotation @ shift
        return Tilt(rotation @ turn, at, rotary_deg, plane.stays)

    def _rotary(self, space: WordSpace, plane: Plane, standing_deg: np.ndarray, source: str, line: int) -> np.ndarray:
        """Return the commands of the rotary axes for a plane, rounded where the control positions them, or raise `InputError`."""
        if plane.read_deg is not None:
            other = space.tool_axes(np.array(plane.read_deg)) @ space.tool_axes(np.zeros(len(plane.read_deg))).T
            if np.abs(other - np.array(plane.rotation)).max() > np.radians(STANDS_DEG):
                what = "the angles of the plane are another plane as positions of the rotary axes"
                expected = "PLANE SPATIAL, or angles that are the same as both"
                raise InputError(what, expected=expected, file=source, line=line, value=plane.read_deg)
        if plane.at_deg is not None:
            at = np.array(plane.at_deg) + space.offset[3:]
            wanted = space.tool_axes(at) if plane.rotation is None else np.array(plane.rotation)
            off = np.degrees(np.linalg.norm(space.tool_axes(at)[:, 2] - wanted[:, 2]))
            if not off <= STANDS_DEG:
                words = " ".join(f"{name}{word:g}" for name, word in zip(space.axes.rotary, plane.at_deg, strict=True))
                expected = "positions of the rotary axes for it, or its positioning by the control"
                what = f"the rotary axes stand {off:.4g}° off the tilted plane"
                raise InputError(what, expected=expected, file=source, line=line, value=words)
            return at
        normal = np.array(plane.rotation)[:, 2]
        solutions = space.branches.all(normal[None])[0]
        if plane.choice:
            wrong = plane.choice * solutions[:, space.branches.master] < -1e-9
            solutions[wrong & ~wrong.all()] = np.nan
        (nearest,) = space.branches.nearest(solutions[None], standing_deg[None])
        if np.isnan(nearest).any():
            raise InputError(
                f"{space.machine.name} cannot reach this tilted plane",
                expected="a plane within the ranges of its rotary axes",
                file=source,
                line=line,
                value=" ".join(f"{value:.4g}" for value in normal),
            )
        increment = np.array([space.axes.increment[name] for name in space.axes.rotary])
        return np.asarray(np.round(nearest / increment) * increment)

    def _origin(self, shift: dict[str, float]) -> tuple[float, float, float]:
        commands = np.array([[shift[axis.name] if axis.linear else 0.0 for axis in self._base.machine.axes]])
        x, y, z = self._nose.forward(commands).point_mm[0].tolist()
        return x, y, z


def _carried_on(named: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return (n, axes) words where each that a move does not name (NaN) is that of the move before; ``before``: of the first one."""
    missing = np.isnan(named)
    if not missing[1:].any():
        return np.where(missing, before, named)
    rows = np.where(missing, -1, np.arange(len(named))[:, None])
    last = np.maximum.accumulate(rows, axis=0)
    return np.where(last < 0, before, named[last, np.arange(named.shape[1])])


# --- Sections of a program: consecutive motions in the same frame, with its own work offset and tool


@final
@dataclass(frozen=True)
class Section:
    """Lines of a program in the same frame, with one tool: another of the same length begins another section."""

    line: int  # 0-based index of the first line
    frame: WordFrame
    space: WordSpace  # conversion of its words, with its work offset and tool
    # name of the work offset in force before the program selects one; empty without a table of them
    assumed_offset: str = ""


@final
class Sections:
    """The sections of a program, found part by part; ``selects``: whether it has work offsets, tools or changing frames."""

    def __init__(self, base: WordSpace, source: str) -> None:
        setup = base.setup
        self.found: list[Section] = []
        self._base, self._source = base, source
        self._frames = FrameSpaces(base)
        self.selects = setup.offsets is not None or setup.tools is not None
        self._assumed = "" if setup.offsets is None else setup.offsets.assumed
        self._frame = FrameChange(0, WordFrame())
        self._decided = False
        self._standing = base.start + base.offset[3:]
        self._last = np.zeros((0, len(base.axes.names)))

    def add(self, moves: MoveColumns, changes: Sequence[FrameChange]) -> list[Section]:
        """Return the sections that begin among the next moves; `InputError` for a work offset or a tool that is not in its table."""
        self.selects = self.selects or bool(changes)
        known, new = ~moves.passes, len(self.found)
        lines, positions = moves.line[known], moves.position[known]
        ends = [*np.searchsorted(lines, [change.line for change in changes]).tolist(), len(lines)]
        begin = 0
        for change, end in zip((None, *changes), ends, strict=True):
            if change is not None:
                self._frame, self._decided = change, False
            if not self._decided and end > begin:
                self._enter(int(lines[begin]))
            self._last = positions[end - 1 : end] if end > begin else self._last
            begin = end
        return self.found[new:]

    def _enter(self, line: int) -> None:
        """Begin the section of the frame and tool in force, if it is another one; ``line``: that of its first move."""
        change, frame, found = self._frame, self._frame.frame, self.found
        at = self._standing if frame.plane is None else _standing(self._last, self._standing, self._base)
        space = self._frames.of(frame, self._source, line + 1, at)
        self._standing = self._standing if space.tilt is None else space.tilt.rotary_deg
        self._decided = True
        if not found or found[-1].space is not space or found[-1].frame.tool != frame.tool:
            found.append(Section(change.line if found else 0, frame, space, self._assumed))


def _standing(positions: np.ndarray, first: np.ndarray, base: WordSpace) -> np.ndarray:
    """Return (rotary axes,) the commands of the rotary axes after moves; ``first``: those at the beginning of their section."""
    words = positions[-1, 3:] + base.offset[3:] if len(positions) else first
    return np.where(np.isnan(words), first, words)


@final
@dataclass(frozen=True)
class SectionMotions:
    """The motions of a section, or of a part of it."""

    space: WordSpace  # conversion of the section's words
    path: ToolPath  # the motions, after ``context`` motions of the section before in the words of this one
    begin: int  # begin, end: the range of its own motions among those given
    end: int
    context: int  # 1, or 0 if no other section is before
    tool: str = ""  # number or name of the tool in the spindle, if the program's tools are followed


def motions_of(
    space: WordSpace, found: Sequence[Section], path: ToolPath, last: tuple[WordSpace, MotionColumns] | None = None
) -> list[SectionMotions]:
    """Return the motions of every section that has any; ``last``: last motion of the part before, and the conversion of its words."""
    cuts = np.searchsorted(path.columns.line, [section.line for section in found]).tolist()
    parts: list[SectionMotions] = []
    before = None if last is None else last[0]
    spaces, tools = (space, *(section.space for section in found)), ("", *(section.frame.tool for section in found))
    for within, tool, begin, end in zip(spaces, tools, (0, *cuts), (*cuts, len(path.columns)), strict=True):
        if begin == end:
            continue
        context = int(before is not None and before is not within)
        if before is None or not context:
            part = path if (begin, end) == (0, len(path.columns)) else path.part(begin, end)
        elif begin == 0 and last is not None:
            columns = MotionColumns.joined([last[1], path.columns.part(0, end)])
            part = replace_first(ToolPath(columns, columns), before, within)
        else:
            part = replace_first(path.part(begin - 1, end), before, within)
        parts.append(SectionMotions(within, part, begin, end, context, tool))
        before = within
    return parts


def follow_sections(
    program: Program, reading: Interpretation, space: WordSpace
) -> tuple[Sections, ToolPath, list[SectionMotions]]:
    """Return a program's sections, its motions as `follow` does, and those of every section; `InputError` also without a motion."""
    sections = Sections(space, program.source)
    found = sections.add(as_columns(space.axes.names, reading.moves), reading.frames)
    path = follow(program, reading, space, found)
    if not path.motions:
        raise motionless(program.source, path.unknown)
    return sections, path, motions_of(space, found, path)


def replace_first(path: ToolPath, before: WordSpace, space: WordSpace) -> ToolPath:
    """Return a path whose first motion has no length: it stays on its end point, in words of another conversion."""
    columns = path.columns
    mode = columns.tcp[:1]
    end = space.words(before.commands(columns.end[:1], mode), mode)
    special = {i: move for i, move in columns.special.items() if i}
    changed = MotionColumns(
        columns.move,
        columns.line,
        columns.rapid,
        columns.tcp,
        np.concatenate([end, columns.start[1:]]),
        np.concatenate([end, columns.end[1:]]),
        columns.by_vector & (np.arange(len(columns)) > 0),
        special,
    )
    return replace(path, motions=changed, columns=changed)
