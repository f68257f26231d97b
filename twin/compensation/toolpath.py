"""From what a program says to what the axes are told: words, commands, and the path between two blocks.

*Words* are a program's numbers made absolute (order `AxisWords.names`: x, y, z, then rotary axes). *Commands* are axis
coordinates (command order). In mode ``axis`` words are commands less the work offset; in mode ``tcp`` the first three are the tool
tip in the work frame and the control finds the commands by the nominal inverse. Between blocks the control moves straight in words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import final, overload

import numpy as np
import pinocchio as pin

from twin._common.arrays import every
from twin._common.errors import InputError
from twin.display import card, pairs
from twin.kinematics.branches import Branches
from twin.kinematics.forward import Kinematics, Poses
from twin.kinematics.inverse import Inverse
from twin.machine.calibration import Calibration
from twin.machine.effects.empirical import check_ranges
from twin.machine.machine import Machine
from twin.nc.blocks import AxisWords, Kind, Left, Move, Notice, Program, Reading
from twin.nc.columns import MoveColumns


@final
@dataclass(frozen=True)
class Setup:
    """How the workpiece is set up.

    Attributes:
        work_offset: added to axis words, by axis name, mm and degrees.
        work_origin_mm: where the program's zero is in the work frame, for tool-tip coordinates.
        start_deg: where rotary axes stand before the program says so; 0 where not given.
    """

    work_offset: Mapping[str, float] = field(default_factory=dict)
    work_origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start_deg: Mapping[str, float] = field(default_factory=dict)

    def _repr_html_(self) -> str:
        x, y, z = self.work_origin_mm
        offsets = ", ".join(f"{name} {value:g}" for name, value in self.work_offset.items())
        rows = [
            ("added to axis words (mm, °)", offsets or "nothing"),
            ("program zero in the work frame", f"x {x:g}, y {y:g}, z {z:g} mm"),
            ("rotary axes start at", ", ".join(f"{name} {value:g}°" for name, value in self.start_deg.items()) or "0°"),
        ]
        return card("Setup", pairs(rows)).text


def axis_words(machine: Machine) -> AxisWords:
    """The words of a machine's programs: its linear axes in the order x, y, z of the work frame.

    Raises:
        InputError: the machine is not one that runs programs.
    """
    machine.check_programs()
    data = machine.model.createData()
    pin.framesForwardKinematics(machine.model, data, pin.neutral(machine.model))
    to_work = data.oMf[machine.work_frame].rotation.T
    order: dict[int, str] = {}
    for i in machine.linear:
        axis = machine.axes[i]
        frame = next(frame for frame in machine.frames if frame.axis == axis.name and frame.role == "motion")
        motion = to_work @ data.oMi[frame.joint].rotation @ np.array(axis.direction)
        motion = -motion if axis.side == "work" else motion
        along = int(np.argmax(motion))
        if motion[along] < 1.0 - 1e-9:
            raise InputError(
                f"axis {axis.name} does not move the tool along x, y or z",
                expected="linear axes along the work frame",
                file=machine.path,
            )
        order[along] = axis.name
    if sorted(order) != [0, 1, 2]:
        raise InputError(
            "not three linear axes across each other",
            expected="a five-axis machine, to run programs",
            file=machine.path,
        )
    return AxisWords(
        linear=tuple(order[i] for i in range(3)),
        rotary=tuple(machine.axes[i].name for i in machine.rotary),
        increment={axis.name: axis.increment for axis in machine.axes},
        tcp_on=machine.tcp_on,
        tcp_off=machine.tcp_off,
    )


@final
class WordSpace:
    """Words to commands and back, for one machine, tool length and setup.

    Args:
        machine: the machine.
        setup: offsets.
        tool_length_mm: the tool.

    Attributes:
        axes: the axis words.
        nominal: the machine without errors.
        order: (axes,) column of the commands each word is.
    """

    def __init__(self, machine: Machine, setup: Setup, tool_length_mm: float | None) -> None:
        self.machine = machine
        self.axes = axis_words(machine)
        self.nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=tool_length_mm)
        self.inverse = Inverse(self.nominal)
        self.order = np.array([machine.names.index(name) for name in self.axes.names])
        self.offset = np.array([setup.work_offset.get(name, 0.0) for name in self.axes.names])
        self.origin = np.array(setup.work_origin_mm)
        self.start = np.array([setup.start_deg.get(name, 0.0) for name in self.axes.rotary])

    @cached_property
    def branches(self) -> Branches:
        """Rotary positions for tool vectors."""
        return Branches(self.nominal)

    def commands(self, words: np.ndarray, tcp: np.ndarray) -> np.ndarray:
        """(n, axes) commands the control makes of (n, axes) words; ``tcp`` (n,) says in which mode each stands."""
        shifted = words + self.offset
        if np.any(tcp):
            rows = np.flatnonzero(tcp & np.isfinite(words).all(axis=1))
            start = np.zeros((len(rows), len(self.order)))
            start[:, self.order[3:]] = shifted[rows, 3:]
            reached = self.nominal.forward(start)
            target = Poses(words[rows, :3] + self.origin, reached.rotation)
            shifted[rows] = self.inverse.solve(target, start, rotary=False).positions[:, self.order]
        if np.all(self.order == np.arange(len(self.order))):
            return np.asarray(shifted)
        commands = np.empty_like(shifted)
        commands[:, self.order] = shifted
        return commands

    def words(self, commands: np.ndarray, tcp: np.ndarray) -> np.ndarray:
        """(n, axes) words that make the control give (n, axes) commands."""
        words = commands[:, self.order] - self.offset
        rows = np.flatnonzero(tcp & np.isfinite(commands).all(axis=1))
        if rows.size:
            words[rows, :3] = self.nominal.forward(commands[rows]).point_mm - self.origin
        return words


@final
@dataclass(frozen=True)
class Motion:
    """One move with its ends known, in words of its own mode.

    Attributes:
        move: the move as read.
        start: (axes,) words where it starts; NaN where the program has not said yet.
        end: (axes,) words where it ends; rotary words also where the program gave a tool vector.
    """

    move: Move
    start: np.ndarray
    end: np.ndarray

    @property
    def interpolated(self) -> bool:
        """Whether the control follows a line or arc here (a rapid's path is the control's own affair)."""
        return self.move.kind is not Kind.RAPID and bool(np.isfinite(self.start).all())


@final
@dataclass(frozen=True)
class MotionColumns(Sequence[Motion]):
    """Motions in columns; a motion is made where somebody asks for it.

    Attributes:
        move: (n,) index of each one's move among those it was followed with.
        line: (n,) index of its line.
        rapid: (n,) whether it is a rapid.
        tcp: (n,) whether its words are tool-tip coordinates.
        start, end: (n, axes) as of `Motion`.
        special: by index, the moves with more to them: arcs and tool vectors.
    """

    move: np.ndarray
    line: np.ndarray
    rapid: np.ndarray
    tcp: np.ndarray
    start: np.ndarray
    end: np.ndarray
    special: Mapping[int, Move]

    @classmethod
    def of(cls, motions: Sequence[Motion], move: Sequence[int] | None = None) -> MotionColumns:
        """Of motions; ``move``: of which moves, 0, 1, 2 … if None."""
        moves = [motion.move for motion in motions]
        return cls(
            np.arange(len(moves)) if move is None else np.array(move, dtype=int),
            np.array([one.line for one in moves], dtype=int),
            np.array([one.kind is Kind.RAPID for one in moves], dtype=bool),
            np.array([one.tcp for one in moves], dtype=bool),
            np.array([motion.start for motion in motions]),
            np.array([motion.end for motion in motions]),
            {i: one for i, one in enumerate(moves) if one.arc is not None or one.vector is not None},
        )

    @classmethod
    def joined(cls, parts: Sequence[MotionColumns], width: int) -> MotionColumns:
        """One behind the other; ``width``: how many axes."""
        if not parts:
            none, nowhere = np.zeros(0, dtype=int), np.zeros((0, width))
            return cls(none, none, none > 0, none > 0, nowhere, nowhere, {})
        special: dict[int, Move] = {}
        count = 0
        for part in parts:
            special |= {count + i: move for i, move in part.special.items()}
            count += len(part)
        return cls(
            move=np.concatenate([part.move for part in parts]),
            line=np.concatenate([part.line for part in parts]),
            rapid=np.concatenate([part.rapid for part in parts]),
            tcp=np.concatenate([part.tcp for part in parts]),
            start=np.concatenate([part.start for part in parts]),
            end=np.concatenate([part.end for part in parts]),
            special=special,
        )

    def part(self, begin: int, end: int) -> MotionColumns:
        """Some of them, one behind the other."""
        which = slice(begin, end)
        return MotionColumns(
            move=self.move[which],
            line=self.line[which],
            rapid=self.rapid[which],
            tcp=self.tcp[which],
            start=self.start[which],
            end=self.end[which],
            special={i - begin: move for i, move in self.special.items() if begin <= i < end},
        )

    def __len__(self) -> int:
        return len(self.line)

    @overload
    def __getitem__(self, index: int) -> Motion: ...
    @overload
    def __getitem__(self, index: slice) -> list[Motion]: ...
    def __getitem__(self, index: int | slice) -> Motion | list[Motion]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        move = self.special.get(index)
        if move is None:
            kind = Kind.RAPID if self.rapid[index] else Kind.LINEAR
            end = tuple(self.end[index].tolist())
            move = Move(int(self.line[index]), kind, bool(self.tcp[index]), end, frozenset())
        return Motion(move, self.start[index], self.end[index])


@final
@dataclass(frozen=True)
class Passage:
    """Axes moved between two motions by a line that is left as written.

    Attributes:
        before: index of the motion that comes next.
        commands: (axes,) where the moved axes go, mm and degrees, command order; NaN where that is not known.
        moved: (axes,) which they are.
    """

    before: int
    commands: np.ndarray
    moved: np.ndarray


@final
@dataclass(frozen=True)
class Path:
    """A program as motions.

    Attributes:
        motions: those with every position known.
        passed: notices on lines that move but are left as written, and on what was assumed.
        passages: what those lines, and lines that leave an axis in a place unknown, do to the axes.
    """

    motions: Sequence[Motion]
    passed: tuple[Notice, ...]
    passages: tuple[Passage, ...] = ()

    @cached_property
    def columns(self) -> MotionColumns:
        """The motions in columns."""
        return self.motions if isinstance(self.motions, MotionColumns) else MotionColumns.of(self.motions)


def follow(program: Program, reading: Reading, space: WordSpace) -> Path:
    """Go through a program, keeping track of where every axis stands.

    Raises:
        InputError: a feed move from or to a place the program has not said, or a tool vector the machine cannot reach.
    """
    follower = Follower(program.source, space)
    motions = follower.follow(reading.moves, reading.left, lambda line: program.texts[line])
    return Path(tuple(motions), tuple(follower.passed), tuple(follower.passages))


@final
class Follower:
    """Goes through a program, in one stretch or several, keeping track of where every axis stands.

    Args:
        source: the program's name.
        space: words to commands.

    Attributes:
        passed: notices so far on lines that move but are left as written, and on what was assumed.
        passages: what lines between motions did to the axes so far.
        count: motions so far.
    """

    def __init__(self, source: str, space: WordSpace) -> None:
        self.passed: list[Notice] = []
        self.passages: list[Passage] = []
        self.count = 0
        self._source = source
        self._space = space
        self._words = np.full(len(space.axes.names), np.nan)
        self._tcp: bool | None = None
        self._assumed = False
        self._left: list[Left] = []

    def follow(self, moves: Sequence[Move], left: Sequence[Left], text_of: Callable[[int], str]) -> list[Motion]:
        """The motions of the next moves, one by one.

        Args:
            moves: the moves.
            left: what lines among them leave in places unknown.
            text_of: the text of a line, by its index in the program.

        Raises:
            InputError: as `follow`.
        """
        vectors = self._vectors({i: move for i, move in enumerate(moves) if move.vector is not None})
        self._left = [*left[::-1], *self._left]
        steps = (self._step(move, vectors.get(i), text_of) for i, move in enumerate(moves))
        return [motion for motion in steps if motion is not None]

    def columns(self, moves: MoveColumns, left: Sequence[Left], text_of: Callable[[int], str]) -> MotionColumns:
        """As `follow`, those that are plain all at once."""
        vectors = self._vectors({i: move for i, move in moves.special.items() if move.vector is not None})
        self._left = [*left[::-1], *self._left]
        stops = np.unique(
            np.concatenate(
                [
                    np.array([*moves.special, len(moves)], dtype=int),
                    np.flatnonzero(np.diff(moves.tcp)) + 1,
                    np.searchsorted(moves.line, np.array([one.line for one in left], dtype=int), side="right"),
                ]
            )
        )
        parts: list[MotionColumns] = []
        loose: dict[int, Motion] = {}
        at = 0
        while at < len(moves):
            self._forget_before(int(moves.line[at]))
            end = int(stops[np.searchsorted(stops, at, side="right")])
            plain = end > at + 1 and at not in moves.special and self._tcp == bool(moves.tcp[at])
            if plain and np.isfinite(self._words).all():
                if loose:
                    parts.append(MotionColumns.of([*loose.values()], [*loose]))
                    loose = {}
                parts.append(self._plain(moves, at, end))
                at = end
                continue
            motion = self._step(moves[at], vectors.get(at), text_of)
            if motion is not None:
                loose[at] = motion
            at += 1
        if loose:
            parts.append(MotionColumns.of([*loose.values()], [*loose]))
        return MotionColumns.joined(parts, len(self._words))

    def _plain(self, moves: MoveColumns, begin: int, end: int) -> MotionColumns:
        """Moves that only name positions, from where every axis is known."""
        said = moves.position[begin:end]
        ends = np.where(np.isnan(said), self._words, said)
        starts = np.concatenate([self._words[None, :], ends[:-1]])
        self._words = ends[-1].copy()
        self.count += end - begin
        part = slice(begin, end)
        return MotionColumns(
            np.arange(begin, end), moves.line[part], moves.rapid[part], moves.tcp[part], starts, ends, {}
        )

    def _vectors(self, moves: Mapping[int, Move]) -> dict[int, np.ndarray]:
        """Rotary positions for the tool vectors there are."""
        if not moves:
            return {}
        solutions = self._space.branches.all(np.array([move.vector for move in moves.values()]))
        return dict(zip(moves, solutions, strict=True))

    def _forget_before(self, line: int) -> None:
        """What the lines before one left in places unknown."""
        while self._left and self._left[-1].line < line:
            left, words = self._left.pop(), self._words
            forgotten = np.isin(np.arange(len(words)), left.axes)
            self.passages.append(_passage(self.count, np.full(len(words), np.nan), forgotten, self._space))
            if left.moved:
                self._words = np.where(forgotten, np.nan, words)
                self._assumed = self._assumed and not forgotten[3:].any()

    def _step(self, move: Move, solutions: np.ndarray | None, text_of: Callable[[int], str]) -> Motion | None:
        """One move; None if it is no motion from and to places that are known."""
        self._forget_before(move.line)
        space, words = self._space, self._words
        if move.tcp != self._tcp:
            words = words if self._tcp is None else _switched(words, move.tcp, space)
            self._words, self._tcp = words, move.tcp
        end = np.array(move.position)
        if move.machine:
            self.passages.append(_passage(self.count, end, np.isfinite(end), space))
            self._words = _after_machine_move(words, end, move, space)
            self.passed.append(Notice(move.line, "machine coordinates: passed through as written"))
            return None
        end = np.where(np.isnan(end), words, end)
        if solutions is not None:
            end[3:] = self._along_vector(move, solutions, words[3:])
        unsaid = np.isnan(end[3:])
        if np.any(unsaid):
            end[3:] = np.where(unsaid, space.start, end[3:])
            if not self._assumed:
                names = [name for name, missing in zip(space.axes.rotary, unsaid, strict=True) if missing]
                at = ", ".join(
                    f"{name} = {value:g}°"
                    for name, value in zip(space.axes.rotary, space.start, strict=True)
                    if name in names
                )
                self.passed.append(
                    Notice(move.line, f"the program has not said where {' and '.join(names)} stand: taken as {at}")
                )
                self._assumed = True
        start = words.copy()
        start[3:] = np.where(np.isnan(start[3:]), end[3:], start[3:])
        self._words = end
        if np.isnan(end[:3]).any():
            names = [name for name, value in zip(space.axes.linear, end, strict=False) if np.isnan(value)]
            if move.kind is not Kind.RAPID:
                raise InputError(
                    f"a feed move before the program said where {', '.join(names)} stand",
                    expected="a position for every linear axis first",
                    file=self._source,
                    line=move.line + 1,
                    value=text_of(move.line).strip(),
                )
            self.passed.append(Notice(move.line, f"{', '.join(names)} not said yet: rapid passed through as written"))
            commands = end + space.offset
            if move.tcp:
                commands[:3] = np.nan
            moved = np.array([name in move.named for name in space.axes.names])
            self.passages.append(_passage(self.count, commands, moved, space))
            return None
        self.count += 1
        return Motion(move, start, end)

    def _along_vector(self, move: Move, solutions: np.ndarray, before: np.ndarray) -> np.ndarray:
        space = self._space
        standing = np.where(np.isnan(before), space.start, before) + space.offset[3:]
        found = space.branches.nearest(solutions, standing)
        if found is None:
            raise InputError(
                f"{space.machine.name} cannot point its tool that way",
                expected="a tool vector within the ranges of its rotary axes",
                file=self._source,
                line=move.line + 1,
                value=move.vector,
            )
        return np.asarray(found - space.offset[3:])


def outside_range(machine: Machine, commands: np.ndarray) -> np.ndarray:
    """(n,) whether commands (mm, degrees) leave an axis's range; NaN does."""
    limits = machine.limits / machine.scale[:, None]
    slack = 1e-9
    return ~every((commands >= limits[:, 0] - slack) & (commands <= limits[:, 1] + slack))


def check_domains(real: Kinematics, source: str, lines: np.ndarray, commands: np.ndarray) -> None:
    """A position the axis has and its curves or an empirical effect do not know is an error, not an extrapolation.

    Args:
        real: the machine with its calibration.
        source: the program's name, for the message.
        lines: (n,) program line number of each command.
        commands: (n, axes) mm and degrees; those out of range are somebody else's to report.

    Raises:
        InputError: with line, value and domain.
    """
    inside = ~outside_range(real.machine, commands)
    outside = real.calibration.outside_domains(commands) & inside[:, None]
    if np.any(outside):
        row, column = np.argwhere(outside)[0]
        lo, hi = real.calibration.domains()[column]
        axis = real.machine.axes[column]
        raise InputError(
            f"{axis.name} outside the domain of its error motions in {real.calibration.path or 'the calibration'}",
            expected=f"{lo:g} to {hi:g} {axis.unit}",
            file=source,
            line=int(lines[row]),
            value=f"{axis.name} {commands[row, column]:.6g}",
        )
    check_ranges(real.calibration.empirical, real.calibration.state(commands[inside]), lines[inside], source)


def along(motion: Motion, fractions: np.ndarray) -> np.ndarray:
    """(k, axes) words at fractions (0…1] of a motion: straight, or on its arc, rotary words and pitch in proportion."""
    words = motion.start + fractions[:, None] * (motion.end - motion.start)
    arc = motion.move.arc
    if arc is not None:
        a, b, _ = arc.plane
        radial = motion.start[[a, b]] - arc.centre_mm
        # A centre printed to the increment leaves start and end radius unlike: go from one to the other.
        last = motion.end[[a, b]] - arc.centre_mm
        radius = np.hypot(*radial) + fractions * (np.hypot(*last) - np.hypot(*radial))
        begin = np.arctan2(radial[1], radial[0])
        finish = np.arctan2(last[1], last[0])
        sweep = arc.angle_rad + np.mod(finish - begin - arc.angle_rad + np.pi, 2 * np.pi) - np.pi
        angle = begin + fractions * sweep
        words[:, a] = arc.centre_mm[0] + radius * np.cos(angle)
        words[:, b] = arc.centre_mm[1] + radius * np.sin(angle)
        words[fractions == 1.0] = motion.end
    return np.asarray(words)


def chords(motion: Motion, tolerance_mm: float) -> int:
    """How many chords of a motion stay within a tolerance of it: 1 for a line."""
    arc = motion.move.arc
    if arc is None:
        return 1
    a, b, _ = arc.plane
    radius = float(np.hypot(*(motion.start[[a, b]] - arc.centre_mm)))
    if radius <= tolerance_mm:
        return max(1, int(np.ceil(abs(arc.angle_rad) / (np.pi / 2))))
    step = 2.0 * np.arccos(1.0 - tolerance_mm / radius)
    return max(1, int(np.ceil(abs(arc.angle_rad) / step)))


def _switched(words: np.ndarray, tcp: bool, space: WordSpace) -> np.ndarray:
    """The same place in the words of the other mode."""
    if not np.isfinite(words).all():
        return np.concatenate([np.full(3, np.nan), words[3:]])
    commands = space.commands(words[None, :], np.array([not tcp]))
    return space.words(commands, np.array([tcp]))[0]


def _passage(before: int, commands: np.ndarray, moved: np.ndarray, space: WordSpace) -> Passage:
    """``commands`` and ``moved`` in the order of the words."""
    ordered, which = np.empty_like(commands), np.empty_like(moved)
    ordered[space.order], which[space.order] = commands, moved
    return Passage(before, ordered, which)


def _after_machine_move(words: np.ndarray, end: np.ndarray, move: Move, space: WordSpace) -> np.ndarray:
    named = np.array([name in move.named for name in space.axes.names])
    after = np.where(named, end - space.offset, words)
    if move.tcp:
        after[:3] = np.nan  # where the tip is then depends on the control
    return np.asarray(after)
