"""What a compensation did: the written program re-simulated densely beside the original."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from twin.channels import TIME, Listening
from twin.compensation.bench import Bench
from twin.compensation.correction import Correction, Corrections
from twin.compensation.pieces import Pieces, Rows
from twin.compensation.report import ClassShare, Deviation, LineNote, Report, ReversalNote
from twin.iso16907 import BASIC, iso_class
from twin.kinematics import Kinematics, Poses, angle_between_rad
from twin.nc.blocks import Notice, Program
from twin.uncertainty import ToolUncertainty

WARM_UP_S: Final = 600.0
"""Over which it is said how far a warm-up goes on."""
CLASS_POSES: Final = 5000
"""Poses at which the shares of the classes are taken: a share needs no more, the total is over all."""


@final
class Account:
    """The account of one compensated program.

    Args:
        bench: machine, calibration, options.
        pieces: the program cut into pieces.
        rows: the commands for their ends.
        program: the program as read.
        rewritten: how many moves were given new words.
    """

    def __init__(self, bench: Bench, pieces: Pieces, rows: Rows, program: Program, *, rewritten: int) -> None:
        self.bench = bench
        self.pieces = pieces
        self.rows = rows
        self.program = program
        self.rewritten = rewritten

    def report(self) -> Report:
        """Re-simulate densely what was written, beside what was there before."""
        rows, pieces = self.rows, self.pieces
        dense = np.flatnonzero(pieces.interpolated[pieces.legs.motion])
        of, fraction, local = pieces.samples(dense)
        words = np.concatenate([rows.words, pieces.words_at(pieces.legs.motion[of], fraction)])
        motion = np.concatenate([rows.motion, pieces.legs.motion[of]])
        before = self.bench.space.commands(words, pieces.tcp[motion])
        after = np.concatenate([rows.commands, pieces.path_commands(of, local, rows, rows.printed, as_run=True)[0]])
        after = before if pieces.idle else after  # written unchanged: its arcs are arcs
        order = np.lexsort((np.append(rows.taken, np.zeros(len(of))), np.append(rows.fraction, fraction), motion))
        before_from, after_from = self._sides(motion, before, order), self._sides(motion, after, order)
        keep = ~self.bench.full.outside_domain(before).any(axis=1) & ~self.bench.full.outside_domain(after).any(axis=1)
        keep &= np.isfinite(after).all(axis=1) & np.isfinite(before).all(axis=1)
        keep[: len(rows.taken)] &= ~rows.taken  # a move that takes up a reversal has no place of its own to be at
        before, after, motion = before[keep], after[keep], motion[keep]
        before_from, after_from = before_from[keep], after_from[keep]
        lines = np.array([self.program.lines[m.move.line].number for m in self.pieces.path.motions])
        meant = self.bench.space.nominal.forward(before)
        uncompensated = self.bench.full.forward(before, before_from)
        compensated = self.bench.full.forward(after, after_from)
        good = ~self.rows.untouched & ~self.rows.clamped
        rounding = self._left_at_ends(self.rows.commands, good)
        exact = self._left_at_ends(self.rows.exact, good)
        corrections = np.abs(self.rows.commands - self.rows.nominal)[~self.rows.untouched]
        notes = [_note(self.program, notice) for notice in (*self.pieces.reading.notices, *self.pieces.path.passed)]
        notes = [*self._unused_setup(), *self._of_channels(lines), *notes]
        count = pieces.count(rows)
        if self.pieces.idle:
            notes.insert(0, LineNote(1, "the calibration has no error motion in scope: written unchanged"))
        return Report(
            program=self.program.source,
            machine=self.bench.machine.name,
            calibration=str(self.bench.calibration.path or "none"),
            calibration_source=self.bench.calibration.source,
            illustrative=self.bench.calibration.illustrative,
            method=self.bench.options.method,
            scope="as in the thesis" if self.bench.options.method == "thesis" else str(self.pieces.scope),
            tool_length_mm=self.bench.full.tool_length_mm,
            tolerance_um=self.bench.options.tolerance_mm * 1e3,
            lines=len(self.program.lines),
            moves=len(self.pieces.reading.moves),
            rewritten=self.rewritten,
            split=int(np.count_nonzero(count > 1)),
            added=int(np.sum(count - 1)),
            largest_correction={
                axis.name: (float(corrections[:, i].max(initial=0.0)), axis.unit)
                for i, axis in enumerate(self.bench.machine.axes)
            },
            before=Deviation.of(uncompensated, meant, lines[motion]),
            after=Deviation.of(compensated, meant, lines[motion]),
            rounding_um=float(rounding.max(initial=0.0)),
            solver_um=float(exact.max(initial=0.0)),
            classes=self._classes((before, before_from), (after, after_from), meant),
            out_of_range=self._out_of_range(),
            orientation_left=self._orientation_left(),
            not_met=self._not_met(),
            notes=tuple(notes),
            uncertainty=self._corrections(lines),
            orientation_asked=self.pieces.scope.asked and self.pieces.scope.orientation,
            conditions=self._conditions(),
            reversals=self._reversals(),
        )

    def _sides(self, motion: np.ndarray, commands: np.ndarray, order: np.ndarray) -> np.ndarray:
        """(n, axes) the side each axis comes from, where the machine makes one of it; ``order``: as they are executed."""
        found = np.zeros(commands.shape)
        if self.bench.lost.axes:
            found[order] = self.bench.lost.sides(self.pieces.path, motion[order], commands[order])
        return found

    def _conditions(self) -> dict[str, float]:
        """The temperatures and the time that were given and that the calibration needs, by channel."""
        unused = self.bench.options.conditions.unused(self.bench.calibration)
        return {name: value for name, value in self.bench.options.conditions.channels.items() if name not in unused}

    def _reversals(self) -> tuple[ReversalNote, ...]:
        """What was done about every reversal of the calibration."""
        rows, found = self.rows, []
        for axis in self.bench.lost.axes:
            machine_axis = self.bench.machine.axes[axis]
            unit, scale = ("um", 1e3) if machine_axis.linear else ("urad", machine_axis.scale * 1e6)
            found.append(
                ReversalNote(
                    axis=machine_axis.name,
                    unit=unit,
                    size=float(self.bench.lost.size[axis] * scale),
                    corrected=axis in self.pieces.lost.axes,
                    taken_up=int(np.count_nonzero(rows.turned[:, axis] & rows.taken)),
                )
            )
        return tuple(found)

    def _of_channels(self, lines: np.ndarray) -> list[LineNote]:
        """What a reader must know of temperatures, time and sides.

        Args:
            lines: (motions,) program line of each.
        """
        conditions = self.bench.options.conditions
        notes = [
            LineNote(1, f"{name} was given and the calibration does not need it")
            for name in conditions.unused(self.bench.calibration)
        ]
        time = conditions.time_s
        for effect in () if time is None else self.bench.calibration.effects:
            now, later = Listening(self.bench.machine), Listening(self.bench.machine)
            now[TIME], later[TIME] = np.array([time]), np.array([time]) + WARM_UP_S
            before, after = effect.components(now), effect.components(later)
            grown = np.sqrt(sum((after[i] - before[i]) ** 2 for i in before if i < 3))
            if np.any(grown >= 0.1):
                notes.append(
                    LineNote(
                        1,
                        f"{effect.name} goes on by {float(grown[0]):.1f} µm in the {WARM_UP_S / 60:g} minutes after --time",
                    )
                )
        for axis in self.pieces.lost.axes:
            name = self.bench.machine.axes[axis].name
            unknown = np.flatnonzero((self.rows.approach[:, axis] == 0.0) & ~self.rows.untouched)
            if unknown.size:
                blocks = np.unique(self.rows.motion[unknown])
                where = "here" if len(blocks) == 1 else f"in {len(blocks)} blocks from here on"
                notes.append(
                    LineNote(
                        int(lines[blocks[0]]),
                        f"the program has not said from which side {name} comes {where}: taken as the middle of its reversal",
                    )
                )
            if self.bench.lost.size[axis] > 0.0 and np.any(self.rows.taken):
                notes.append(
                    LineNote(
                        1,
                        f"the reversal of {name} is positive (it jumps ahead when it turns): taking it up moves {name} beyond the "
                        "turning point for a moment, by its size and three increments",
                    )
                )
        return notes

    def _corrections(self, lines: np.ndarray) -> Corrections:
        """How far the tool was moved at the block ends, and how well the calibration knows that it had to be.

        By the machine as drawn from the meant commands to the given ones; the calibration's uncertainty, of what is in scope, at
        the meant ones: there and at the given ones it is the same to a thousandth.

        Args:
            lines: (motions,) program line of each.
        """
        rows, nominal, point = self.rows, self.bench.space.nominal, self.pieces.point
        given = np.where(rows.clamped[:, None], rows.commands, rows.exact)  # rounding is accounted for by itself
        keep = ~rows.untouched & ~rows.taken & np.isfinite(given).all(axis=1)
        keep &= ~self.bench.full.outside_domain(rows.nominal).any(axis=1)
        if not np.any(keep):
            return Corrections(None, None)
        meant, motion, sides = rows.nominal[keep], rows.motion[keep], rows.approach[keep]
        reached, target = nominal.forward(given[keep]), rows.target
        of_point = of_axis = at_point = None
        if not point.calibration.empty:
            at_point = ToolUncertainty(point).at(meant, sides)
            size = np.linalg.norm(reached.point_mm - target.point_mm[keep], axis=1) * 1e3
            of_point = Correction.of_point(lines[motion], motion, size, at_point)
        turning = self.pieces.orientation
        turned = ~rows.singular[keep]  # the others are listed as what cannot be corrected
        asked = self.pieces.scope.orientation and self.bench.thesis is None
        if asked and turning is not None and np.any(turned):
            same = _names(turning) <= _names(point)  # what only moves the point does not turn the axis
            at_axis = at_point if same and at_point is not None else ToolUncertainty(turning).at(meant, sides)
            size = angle_between_rad(reached.axis, target.axis[keep])[turned] * 1e6
            of_axis = Correction.of_axis(lines[motion[turned]], motion[turned], size, at_axis.where(turned))
        return Corrections(of_point, of_axis)

    def _unused_setup(self) -> list[LineNote]:
        """Offsets the user gave that this program has no words for: better said than silently ignored."""
        setup, axes = self.bench.options.setup, self.bench.space.axes
        notes = []
        if self.pieces.tcp.all() and any(setup.work_offset.get(name) for name in axes.linear):
            notes.append(
                LineNote(
                    1, "work offsets of linear axes are not used: the words are tool-tip coordinates (--work-origin)"
                )
            )
        if not self.pieces.tcp.any() and any(setup.work_origin_mm):
            notes.append(LineNote(1, "the work origin is not used: the words are axis positions (--work-offset)"))
        return notes

    def _left_at_ends(self, commands: np.ndarray, good: np.ndarray) -> np.ndarray:
        """(k,) µm between point and target at piece ends, of what the scope corrects.

        Unchecked: a command within rounding of a limit may lie just beyond it before it is printed.
        """
        point = self.pieces.point.reached(commands[good] * self.bench.machine.scale, self.rows.approach[good])[1]
        return np.linalg.norm(point * 1e3 - self.rows.target.point_mm[good], axis=1) * 1e3

    def _classes(
        self, before: tuple[np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray], meant: Poses
    ) -> tuple[ClassShare, ...]:
        """The shares of the classes; ``before`` and ``after``: commands, and the sides they come from."""
        if len(meant) > CLASS_POSES:
            some = np.linspace(0, len(meant) - 1, CLASS_POSES).astype(int)
            before, after = (before[0][some], before[1][some]), (after[0][some], after[1][some])
            meant = Poses(meant.point_mm[some], meant.rotation[some])
        shares = []
        reached = self.bench.space.nominal.forward(after[0])
        for name in BASIC:
            alone = self.bench.limited(lambda error, name=name: iso_class(error, self.bench.machine) == name)  # type: ignore[misc]
            if alone.calibration.empty:
                continue
            alone_before = alone.forward(*before)
            share = np.linalg.norm(alone_before.point_mm - meant.point_mm, axis=1) * 1e3
            turn = angle_between_rad(alone_before.axis, meant.axis) * 1e6
            corrected = None if self.bench.options.method == "thesis" else name in self.pieces.scope.classes
            left = np.linalg.norm(alone.forward(*after).point_mm - reached.point_mm, axis=1) * 1e3
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

    def _out_of_range(self) -> tuple[LineNote, ...]:
        notes = {}
        for row in np.flatnonzero(self.rows.untouched | self.rows.clamped):
            number = self.program.lines[self.pieces.path.motions[self.rows.motion[row]].move.line].number
            if number in notes:
                continue
            asked = self.rows.nominal[row] if self.rows.untouched[row] else self.rows.exact[row]
            wrong = [
                f"{axis.name} {value:.4f} outside {axis.lower:g} … {axis.upper:g} {axis.unit}"
                for axis, value in zip(self.bench.machine.axes, asked, strict=True)
                if axis.lower is not None
                and axis.upper is not None
                and not axis.lower - 1e-9 <= value <= axis.upper + 1e-9
            ] or ["an axis would leave the domain of its error motions"]
            done = "left as written" if self.rows.untouched[row] else "stopped at the limit"
            notes[number] = LineNote(number, f"{'; '.join(wrong)}: {done}")
        return tuple(notes.values())

    def _orientation_left(self) -> tuple[LineNote, ...]:
        worst: dict[int, tuple[float, str]] = {}
        for row in np.flatnonzero(self.rows.singular):
            number = self.program.lines[self.pieces.path.motions[self.rows.motion[row]].move.line].number
            left = float(self.rows.orientation_left[row])
            if left >= worst.get(number, (0.0, ""))[0]:
                worst[number] = left, self._why_not(self.rows.commands[row])
        return tuple(
            LineNote(number, f"{left * 1e6:.1f} µrad of orientation left: {why}")
            for number, (left, why) in worst.items()
        )

    def _why_not(self, commands: np.ndarray) -> str:
        """Why the rotary axes cannot repair an orientation at these commands."""
        for i in self.bench.machine.rotary:
            axis = self.bench.machine.axes[i]
            for limit in (axis.lower, axis.upper):
                if limit is not None and abs(commands[i] - limit) < axis.increment:
                    return f"{axis.name} stands at its limit of {limit:g}°"
        return (
            f"near a singular pose, it would take more than {self.bench.options.rotary_limit_deg:g}° of a rotary axis"
        )

    def _not_met(self) -> tuple[LineNote, ...]:
        if self.bench.options.method == "thesis":
            return ()
        of = self.pieces.legs.motion
        dense = np.flatnonzero(self.pieces.interpolated[of])
        worst = np.zeros(len(self.pieces.path.motions))
        if dense.size:
            np.maximum.at(worst, of[dense], self.pieces.between(dense, self.rows))
        count = self.pieces.count(self.rows)
        limit = self.bench.options.tolerance_mm
        stuck = set(self.rows.motion[self.rows.clamped | self.rows.untouched].tolist())
        return tuple(
            LineNote(
                self.program.lines[self.pieces.path.motions[m].move.line].number,
                f"{error * 1e3:.2f} µm between ends, after splitting in {count[m]}",
            )
            for m, error in enumerate(worst)
            if error > limit and m not in stuck
        )


def _names(kinematics: Kinematics) -> set[str]:
    return {effect.name for effect in kinematics.calibration.effects}


def _note(program: Program, notice: Notice) -> LineNote:
    return LineNote(program.lines[notice.line].number, notice.text)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
