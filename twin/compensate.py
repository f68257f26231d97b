"""A program in, the program out whose execution on the machine with errors lands where the first one meant.

For every block: nominal pose -> commands that reach it -> rotary words at their least increment -> linear axes solved again
for what was rounded -> linear words at theirs. Blocks are split where the machine, moving straight between two compensated ends,
would leave the meant path by more than the tolerance. What comes out is read back and re-simulated before anybody sees it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Literal, final

import numpy as np

from twin.calibration import Calibration
from twin.errors import InputError, OutputError
from twin.inverse import DEFAULT_ROTARY_LIMIT_DEG, Inverse, Status
from twin.iso16907 import BASIC, Scope, iso_class
from twin.kinematics import Kinematics, Poses, angle_between_rad
from twin.machine import Machine
from twin.nc.blocks import Dialect, Notice, Program, Reading, Rewrite
from twin.report import ClassShare, Deviation, LineNote, Report
from twin.thesis import ThesisMethod
from twin.toolpath import Path, Setup, WordSpace, along, chords, follow

Progress = Callable[[str, float], None]

SAMPLES_A_PIECE: Final = 5
"""Interior points at which every piece is re-simulated; more where it is long."""
SAMPLE_SPACING: Final = (10.0, 3.0)
"""No two samples further apart than this: mm of linear and degrees of rotary motion."""
LARGEST_SPLIT: Final = 4096
"""Pieces a block may be split into; an error that needs more is not one that splitting cures."""
VECTOR_DECIMALS: Final = {"apt": 9}
"""Decimals of a tool vector by dialect; 7 elsewhere (0.1 µrad)."""


@final
@dataclass(frozen=True)
class Options:
    """What to do, beside the machine and its calibration.

    Attributes:
        setup: work offsets and origin.
        tool_length_mm: None for the machine file's own.
        tcp: whether the control's kinematics are on from the start.
        scope: None for everything the program can carry.
        tolerance_mm: error allowed between the ends of a block, and of a chord.
        rotary_limit_deg: how far a rotary axis may move to repair an orientation.
        method: ``exact``, or ``thesis`` for the baseline of `twin.thesis`.
    """

    setup: Setup = field(default_factory=Setup)
    tool_length_mm: float | None = None
    tcp: bool = False
    scope: Scope | None = None
    tolerance_mm: float = 1e-3
    rotary_limit_deg: float = DEFAULT_ROTARY_LIMIT_DEG
    method: Literal["exact", "thesis"] = "exact"


@final
@dataclass(frozen=True)
class Compensation:
    """A compensated program.

    Attributes:
        text: the program, to be written as latin-1.
        report: what was done and what is left.
        path: the program as motions.
        nominal: (rows, axes) nominal commands of every block's pieces, mm and degrees.
        exact: (rows, axes) compensated commands before the linear words were rounded.
        commands: (rows, axes) compensated commands as printed.
        lines: (rows,) program line of each.
    """

    text: str
    report: Report
    path: Path
    nominal: np.ndarray
    exact: np.ndarray
    commands: np.ndarray
    lines: np.ndarray


@final
@dataclass(frozen=True)
class _Rows:
    """Ends of pieces: which motion each belongs to, at which fraction of it, and everything solved for it."""

    motion: np.ndarray
    fraction: np.ndarray
    words: np.ndarray
    nominal: np.ndarray
    target: Poses
    exact: np.ndarray
    commands: np.ndarray
    printed: np.ndarray
    vectors: np.ndarray
    orientation_left: np.ndarray
    singular: np.ndarray
    clamped: np.ndarray
    untouched: np.ndarray


@final
class Compensator:
    """Compensates programs on one machine with one calibration.

    Args:
        machine: the machine.
        calibration: its errors.
        options: what to do.

    Raises:
        InputError: the machine cannot run programs, or the method does not fit it.
    """

    def __init__(self, machine: Machine, calibration: Calibration, options: Options) -> None:
        self.machine = machine
        self.calibration = calibration
        self.options = options
        self.space = WordSpace(machine, options.setup, options.tool_length_mm)
        self.full = Kinematics(machine, calibration, tool_length_mm=options.tool_length_mm)
        self.thesis = ThesisMethod(calibration, self.space.nominal) if options.method == "thesis" else None
        increments = np.array([axis.increment for axis in machine.axes])
        self.increment = increments[self.space.order]

    def compensate(self, program: Program, dialect: Dialect, progress: Progress | None = None) -> Compensation:
        """Compensate one program.

        Raises:
            InputError: the program cannot be read, or something in it must not pass uncompensated.
            OutputError: the text produced does not say what was meant; nothing was written.
        """
        say = progress or (lambda stage, fraction: None)
        say("reading", 0.0)
        reading = dialect.moves(program, self.space.axes, tcp=self.options.tcp)
        path = follow(program, reading, self.space)
        if not path.motions:
            raise InputError(
                "no block that moves an axis to a known place", expected="a program with motion", file=program.source
            )
        run = _Run(self, path, reading, dialect)
        say("solving", 0.1)
        rows = run.split(say)
        rewrites = run.rewrites(rows)
        say("writing", 0.8)
        text = dialect.rewrite(program, self.space.axes, reading, rewrites)
        run.verify(program, text, rewrites)
        say("checking", 0.9)
        report = run.report(program, rows)
        say("done", 1.0)
        lines = np.array([program.lines[path.motions[m].move.line].number for m in rows.motion])
        return Compensation(text, report, path, rows.nominal, rows.exact, rows.commands, lines)

    def limited(self, keep: Callable[[str], bool]) -> Kinematics:
        """The machine with only some of its errors."""
        return Kinematics(self.machine, self.calibration.where(keep), tool_length_mm=self.options.tool_length_mm)


@final
class _Run:
    """One program on its way through."""

    def __init__(self, compensator: Compensator, path: Path, reading: Reading, dialect: Dialect) -> None:
        self.c = compensator
        self.space = compensator.space
        self.path = path
        self.reading = reading
        self.dialect = dialect
        self.turns = any(move.vector is not None or move.named & set(self.space.axes.rotary) for move in reading.moves)
        self.scope = compensator.options.scope or Scope.everything(orientation=self.turns)
        self.tcp = np.array([motion.move.tcp for motion in path.motions])
        self.start = np.array([motion.start for motion in path.motions])
        self.end = np.array([motion.end for motion in path.motions])
        self.straight = np.array([motion.move.arc is None for motion in path.motions])
        self.by_vector = np.array([motion.move.vector is not None for motion in path.motions])
        self.interpolated = np.array([motion.interpolated for motion in path.motions])
        # From outside the range there is no meant path to keep to; such a start is reported with its own block.
        self.interpolated &= ~self._outside(self.space.commands(self.start, self.tcp))
        self.pieces = np.array([chords(motion, compensator.options.tolerance_mm) for motion in path.motions])

    @cached_property
    def point(self) -> Kinematics:
        """The errors corrected at the functional point."""
        return self.c.limited(lambda name: self.scope.at_point(name, self.c.machine))

    @cached_property
    def _point_inverse(self) -> Inverse:
        return Inverse(self.point)

    @cached_property
    def _orientation_inverse(self) -> Inverse | None:
        """The errors corrected by the rotary axes; None where they do not move for it."""
        limited = self.c.limited(lambda name: self.scope.in_orientation(name, self.c.machine))
        empty = not (limited.calibration.curves or limited.calibration.location)
        if not self.turns or empty:
            return None
        return Inverse(limited, rotary_limit_deg=self.c.options.rotary_limit_deg)

    # --- pieces ------------------------------------------------------------------------------------------------------

    def split(self, say: Progress) -> _Rows:
        """Solve all blocks, splitting where the error between two ends exceeds the tolerance."""
        everything = np.arange(len(self.path.motions))
        rows = self._solve(*self._ends(everything))
        if self.c.options.method == "thesis":
            return rows
        candidates = everything[self.interpolated]
        step = 0
        while candidates.size and step < 16:
            step += 1
            say("splitting", min(0.7, 0.2 + 0.05 * step))
            worst = self._between(candidates, rows)
            stuck = np.zeros(len(everything), dtype=bool)
            stuck[rows.motion[rows.clamped | rows.untouched]] = True
            failing = (
                (worst > self.c.options.tolerance_mm) & ~stuck[candidates] & (self.pieces[candidates] < LARGEST_SPLIT)
            )
            candidates = candidates[failing]
            if not candidates.size:
                break
            factor = np.sqrt(
                worst[failing] / self.c.options.tolerance_mm
            )  # the error between ends is quadratic in length
            grown = np.ceil(self.pieces[candidates] * np.clip(1.1 * factor, 1.3, 16.0)).astype(int)
            self.pieces[candidates] = np.minimum(grown, LARGEST_SPLIT)
            rows = _replaced(rows, candidates, self._solve(*self._ends(candidates)))
        kept = np.unique(rows.motion[rows.untouched])
        if np.any(self.pieces[kept] > 1):
            # A block that leaves the range on its way is left as written, whole.
            self.pieces[kept] = 1
            rows = _replaced(rows, kept, self._solve(*self._ends(kept)))
            rows = replace(rows, untouched=rows.untouched | np.isin(rows.motion, kept))
        return rows

    def _ends(self, motions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        of = np.repeat(motions, self.pieces[motions])
        counts = self.pieces[motions]
        within = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
        return of, within / np.repeat(counts, counts)

    def _words_at(self, of: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        start = np.where(np.isfinite(self.start[of]), self.start[of], self.end[of])
        words = start + fraction[:, None] * (self.end[of] - start)
        words[fraction == 1.0] = self.end[of[fraction == 1.0]]
        for motion in np.unique(of[~self.straight[of]]):
            rows = of == motion
            words[rows] = along(self.path.motions[motion], fraction[rows])
        return words

    def _solve(self, of: np.ndarray, fraction: np.ndarray) -> _Rows:
        words = self._words_at(of, fraction)
        tcp = self.tcp[of]
        nominal = self.space.commands(words, tcp)
        limits = self.c.machine.limits / self.c.machine.scale[:, None]
        untouched = self._outside(nominal)
        safe = np.where(untouched[:, None], np.clip(nominal, limits[:, 0], limits[:, 1]), nominal)
        target = self.space.nominal.forward(safe)
        vectors = np.full((len(of), 3), np.nan)
        orientation_left = np.zeros(len(of))
        singular = np.zeros(len(of), dtype=bool)
        commands = np.array(safe)
        rotary = list(self.c.machine.rotary)
        if self.c.thesis is not None:
            commands = self.c.thesis.commands(safe)
            exact = np.array(commands)
        else:
            if self._orientation_inverse is not None:
                solution = self._orientation_inverse.solve(target, safe)
                good = solution.where(Status.CONVERGED) | solution.where(Status.SINGULAR)
                commands[np.ix_(good, rotary)] = solution.positions[np.ix_(good, rotary)]
                singular = solution.where(Status.SINGULAR)
                orientation_left = np.where(singular, solution.orientation_residual_rad, 0.0)
            commands, vectors = self._rotary_as_printed(commands, of)
            exact = self._point_inverse.solve(target, commands, rotary=False).positions
        clipped = np.clip(exact, limits[:, 0], limits[:, 1])
        clamped = (np.abs(clipped - exact) > 0.5 * np.array([axis.increment for axis in self.c.machine.axes])).any(
            axis=1
        )
        out = self.space.words(clipped, tcp)
        printed = np.round(out / self.c.increment) * self.c.increment
        printed[np.ix_(self.by_vector[of], range(3, printed.shape[1]))] = out[
            np.ix_(self.by_vector[of], range(3, printed.shape[1]))
        ]
        printed[untouched] = words[untouched]
        final = self.space.commands(printed, tcp)
        return _Rows(
            of,
            fraction,
            words,
            nominal,
            target,
            exact,
            final,
            printed,
            vectors,
            orientation_left,
            singular,
            clamped & ~untouched,
            untouched,
        )

    def _outside(self, commands: np.ndarray) -> np.ndarray:
        """(n,) whether commands (mm, degrees) leave an axis's range or a curve's domain."""
        limits = self.c.machine.limits / self.c.machine.scale[:, None]
        slack = 1e-9
        inside = ((commands >= limits[:, 0] - slack) & (commands <= limits[:, 1] + slack)).all(axis=1)
        return np.asarray(~inside | self.c.full.outside_domain(commands).any(axis=1))

    def _rotary_as_printed(self, commands: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotary axes where the printed words will put them; tool vectors where the program gives those."""
        rotary = list(self.c.machine.rotary)
        commands = np.array(commands)
        offset = self.space.offset[3:]
        increment = self.c.increment[3:]
        vectors = np.full((len(of), 3), np.nan)
        plain = ~self.by_vector[of]
        words = commands[:, rotary] - offset
        commands[np.ix_(plain, rotary)] = (np.round(words / increment) * increment + offset)[plain]
        rows = np.flatnonzero(~plain)
        if rows.size:
            decimals = VECTOR_DECIMALS.get(self.dialect.name, 7)
            vectors[rows] = np.round(self.space.nominal.forward(commands[rows]).axis, decimals)
            unit = vectors[rows] / np.linalg.norm(vectors[rows], axis=1, keepdims=True)
            for row, solutions in zip(rows, self.space.branches.all(unit), strict=True):
                found = self.space.branches.nearest(solutions, commands[row, rotary])
                if found is not None:
                    commands[row, rotary] = found
        return commands, vectors

    # --- re-simulation -----------------------------------------------------------------------------------------------

    def _samples(self, motions: np.ndarray, rows: _Rows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Motion, fraction and commands really given at dense points of motions, moving straight in printed words.

        Linear words are taken before rounding, so that splitting is not asked to cure rounding.
        """
        size = np.abs(
            self.end[motions] - np.where(np.isfinite(self.start[motions]), self.start[motions], self.end[motions])
        )
        spacing = np.maximum(
            size[:, :3].max(axis=1) / SAMPLE_SPACING[0], size[:, 3:].max(axis=1, initial=0.0) / SAMPLE_SPACING[1]
        )
        pieces = self.pieces[motions]
        each = np.maximum(SAMPLES_A_PIECE, np.ceil(spacing / pieces)).astype(int)
        count = pieces * each
        of = np.repeat(motions, count)
        index = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
        within = (index % np.repeat(each, count) + 0.5) / np.repeat(each, count)
        piece = index // np.repeat(each, count)
        return of, (piece + within) / np.repeat(pieces, count), np.stack([piece, within], axis=1)

    def _path_commands(self, of: np.ndarray, local: np.ndarray, rows: _Rows, given: np.ndarray) -> np.ndarray:
        """Commands at (piece, fraction within it) of motions whose piece ends are ``given`` in words, row by row."""
        first = np.searchsorted(rows.motion, of)
        row = first + local[:, 0].astype(int)
        begin = np.where((local[:, 0] == 0)[:, None], self._begin(rows, given)[of], given[np.maximum(row - 1, 0)])
        words = begin + local[:, 1][:, None] * (given[row] - begin)
        return self.space.commands(words, self.tcp[of])

    def _begin(self, rows: _Rows, given: np.ndarray) -> np.ndarray:
        """(motions, axes) words each motion starts from: the last of the one before, where it follows on."""
        ends = np.searchsorted(rows.motion, np.arange(len(self.path.motions)), side="right") - 1
        begin = np.full_like(self.start, np.nan)
        begin[1:] = given[ends[:-1]]
        follows = np.zeros(len(begin), dtype=bool)
        follows[1:] = (self.tcp[1:] == self.tcp[:-1]) & (self.start[1:] == self.end[:-1]).all(axis=1)
        apart = np.flatnonzero(~follows & np.isfinite(self.start).all(axis=1))
        if apart.size:
            # Where a motion starts from a place left as written, the correction is run in along it.
            begin[apart] = self.start[apart]
            solved = self._solve_starts(apart)
            begin[apart] = solved
        return begin

    def _solve_starts(self, motions: np.ndarray) -> np.ndarray:
        rows = self._solve(motions, np.zeros(len(motions)))
        return self.space.words(rows.exact, self.tcp[motions])

    def _between(self, motions: np.ndarray, rows: _Rows) -> np.ndarray:
        """(motions,) largest distance (mm) of the reached point from the meant one between the ends of each motion."""
        of, fraction, local = self._samples(motions, rows)
        given = self.space.words(np.where(np.isfinite(rows.exact), rows.exact, rows.commands), self.tcp[rows.motion])
        commands = self._path_commands(of, local, rows, given)
        meant = self.space.nominal.reached(
            self.space.commands(self._words_at(of, fraction), self.tcp[of]) * self.c.machine.scale
        )[1]
        reached = self.point.reached(commands * self.c.machine.scale)[1]
        distance = np.linalg.norm(reached - meant, axis=1) * 1e3
        worst = np.zeros(len(self.path.motions))
        np.maximum.at(worst, of, distance)
        return worst[motions]

    # --- out ---------------------------------------------------------------------------------------------------------

    def rewrites(self, rows: _Rows) -> list[Rewrite]:
        """One a motion, in order."""
        found = []
        bounds = np.searchsorted(rows.motion, np.arange(len(self.path.motions) + 1))
        kept = np.zeros(len(self.path.motions), dtype=bool)
        kept[rows.motion[rows.untouched]] = True
        for i, motion in enumerate(self.path.motions):
            if kept[i]:
                continue
            part = slice(bounds[i], bounds[i + 1])
            positions = rows.printed[part].copy()
            vectors = None
            if self.by_vector[i] or not self.turns:
                positions[:, 3:] = np.nan  # no rotary words: the vector says it, or the program has none
            if self.by_vector[i]:
                vectors = rows.vectors[part]
            found.append(Rewrite(motion.move, positions, vectors))
        return found

    def verify(self, program: Program, text: str, rewrites: list[Rewrite]) -> None:
        """Read the output back and compare every position with what was meant.

        Raises:
            OutputError: they differ.
        """
        again = self.dialect.read(text.encode("latin-1"), program.source)
        moves = self.dialect.moves(again, self.space.axes, tcp=self.c.options.tcp).moves
        by_move = {id(rewrite.move): rewrite for rewrite in rewrites}
        position = 0
        for move in self.reading.moves:
            rewrite = by_move.get(id(move))
            wanted = np.array([move.position]) if rewrite is None else rewrite.positions
            found = moves[position : position + len(wanted)]
            position += len(wanted)
            line = program.lines[move.line].number
            if len(found) < len(wanted):
                raise OutputError(f"{program.source}:{line}: a block was lost on the way out")
            got = np.array([one.position for one in found])
            # Half a least increment of the coarser, inch, output: what printing may change.
            off = np.abs(got - wanted) > 2e-4
            if rewrite is not None and np.any(off):
                raise OutputError(
                    f"{program.source}:{line}: the output says {got[off.any(axis=1)][0]}, not {wanted[off.any(axis=1)][0]}"
                )
        if position != len(moves):
            raise OutputError(f"{program.source}: {len(moves)} moves in the output, {position} meant")

    def report(self, program: Program, rows: _Rows) -> Report:
        """Re-simulate densely what was written, beside what was there before."""
        motions = np.arange(len(self.path.motions))
        dense = motions[self.interpolated]
        of, fraction, local = self._samples(dense, rows)
        ends = np.flatnonzero(np.ones(len(rows.motion), dtype=bool))
        words = np.concatenate([rows.words[ends], self._words_at(of, fraction)])
        motion = np.concatenate([rows.motion[ends], of])
        before = self.space.commands(words, self.tcp[motion])
        after = np.concatenate([rows.commands[ends], self._path_commands(of, local, rows, rows.printed)])
        keep = ~self.c.full.outside_domain(before).any(axis=1) & ~self.c.full.outside_domain(after).any(axis=1)
        keep &= np.isfinite(after).all(axis=1) & np.isfinite(before).all(axis=1)
        before, after, motion = before[keep], after[keep], motion[keep]
        lines = np.array([program.lines[m.move.line].number for m in self.path.motions])
        meant = self.space.nominal.forward(before)
        uncompensated, compensated = self.c.full.forward(before), self.c.full.forward(after)
        good = np.flatnonzero(~rows.untouched & ~rows.clamped)
        rounding = (
            np.linalg.norm(self.point.forward(rows.commands[good]).point_mm - rows.target.point_mm[good], axis=1) * 1e3
        )
        exact = np.linalg.norm(self.point.forward(rows.exact[good]).point_mm - rows.target.point_mm[good], axis=1) * 1e3
        corrections = np.abs(rows.commands - rows.nominal)[~rows.untouched]
        notes = [_note(program, notice) for notice in (*self.reading.notices, *self.path.passed)]
        return Report(
            program=program.source,
            machine=self.c.machine.name,
            calibration=str(self.c.calibration.path or "none"),
            calibration_source=self.c.calibration.source,
            illustrative=any(curve.illustrative for curve in self.c.calibration.curves.values()),
            method=self.c.options.method,
            scope="as in the thesis" if self.c.options.method == "thesis" else str(self.scope),
            tool_length_mm=self.c.full.tool_length_mm,
            tolerance_um=self.c.options.tolerance_mm * 1e3,
            lines=len(program.lines),
            moves=len(self.reading.moves),
            rewritten=len(np.unique(rows.motion[~rows.untouched])),
            split=int(np.count_nonzero(self.pieces > 1)),
            added=int(np.sum(self.pieces - 1)),
            largest_correction={
                axis.name: (float(corrections[:, i].max(initial=0.0)), axis.unit)
                for i, axis in enumerate(self.c.machine.axes)
            },
            before=Deviation.of(uncompensated, meant, lines[motion]),
            after=Deviation.of(compensated, meant, lines[motion]),
            rounding_um=float(rounding.max(initial=0.0)),
            solver_um=float(exact.max(initial=0.0)),
            classes=self._classes(before, after, meant),
            out_of_range=self._out_of_range(program, rows),
            orientation_left=self._orientation_left(program, rows),
            not_met=self._not_met(program, rows),
            notes=tuple(notes),
            orientation_asked=self.scope.asked and self.scope.orientation,
        )

    def _classes(self, before: np.ndarray, after: np.ndarray, meant: Poses) -> tuple[ClassShare, ...]:
        shares = []
        reached = self.space.nominal.forward(after)
        for name in BASIC:
            alone = self.c.limited(lambda error, name=name: iso_class(error, self.c.machine) == name)  # type: ignore[misc]
            found = alone.calibration
            if not (found.curves or found.squareness or found.location):
                continue
            share = np.linalg.norm(alone.forward(before).point_mm - meant.point_mm, axis=1) * 1e3
            turn = angle_between_rad(alone.forward(before).axis, meant.axis) * 1e6
            corrected = None if self.c.options.method == "thesis" else name in self.scope.classes
            left = np.linalg.norm(alone.forward(after).point_mm - reached.point_mm, axis=1) * 1e3
            shares.append(
                ClassShare(
                    name=name,
                    corrected=corrected,
                    before_rms_um=_rms(share),
                    before_max_um=float(share.max(initial=0.0)),
                    before_max_urad=float(turn.max(initial=0.0)),
                    left_rms_um=None if corrected is None else 0.0 if corrected else _rms(left),
                )
            )
        return tuple(shares)

    def _out_of_range(self, program: Program, rows: _Rows) -> tuple[LineNote, ...]:
        notes = {}
        for row in np.flatnonzero(rows.untouched | rows.clamped):
            number = program.lines[self.path.motions[rows.motion[row]].move.line].number
            if number in notes:
                continue
            asked = rows.nominal[row] if rows.untouched[row] else rows.exact[row]
            wrong = [
                f"{axis.name} {value:.4f} outside {axis.lower:g} … {axis.upper:g} {axis.unit}"
                for axis, value in zip(self.c.machine.axes, asked, strict=True)
                if axis.lower is not None
                and axis.upper is not None
                and not axis.lower - 1e-9 <= value <= axis.upper + 1e-9
            ] or ["outside the domain of an error motion"]
            done = "left as written" if rows.untouched[row] else "stopped at the limit"
            notes[number] = LineNote(number, f"{'; '.join(wrong)}: {done}")
        return tuple(notes.values())

    def _orientation_left(self, program: Program, rows: _Rows) -> tuple[LineNote, ...]:
        worst: dict[int, float] = {}
        for row in np.flatnonzero(rows.singular):
            number = program.lines[self.path.motions[rows.motion[row]].move.line].number
            worst[number] = max(worst.get(number, 0.0), float(rows.orientation_left[row]))
        return tuple(
            LineNote(number, f"{angle * 1e6:.1f} µrad of orientation left: the rotary axes cannot repair it here")
            for number, angle in worst.items()
        )

    def _not_met(self, program: Program, rows: _Rows) -> tuple[LineNote, ...]:
        if self.c.options.method == "thesis":
            return ()
        dense = np.flatnonzero(self.interpolated)
        worst = self._between(dense, rows) if dense.size else np.zeros(0)
        limit = self.c.options.tolerance_mm
        stuck = set(rows.motion[rows.clamped | rows.untouched].tolist())
        return tuple(
            LineNote(
                program.lines[self.path.motions[m].move.line].number,
                f"{error * 1e3:.2f} µm between ends, after splitting in {self.pieces[m]}",
            )
            for m, error in zip(dense, worst, strict=True)
            if error > limit and m not in stuck
        )


def _replaced(rows: _Rows, motions: np.ndarray, new: _Rows) -> _Rows:
    """Rows with those of some motions exchanged, still in order."""
    keep = ~np.isin(rows.motion, motions)
    order = np.argsort(np.concatenate([rows.motion[keep], new.motion]), kind="stable")

    def merged(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.asarray(np.concatenate([a[keep], b])[order])

    target = Poses(merged(rows.target.point_mm, new.target.point_mm), merged(rows.target.rotation, new.target.rotation))
    fields = {
        name: merged(getattr(rows, name), getattr(new, name)) for name in _Rows.__dataclass_fields__ if name != "target"
    }
    return _Rows(target=target, **fields)


def _note(program: Program, notice: Notice) -> LineNote:
    return LineNote(program.lines[notice.line].number, notice.text)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


