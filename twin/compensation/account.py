"""What a compensation did: the written program re-simulated densely beside the original, stretch by stretch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.arrays import every
from twin.compensation.bench import Aim, Bench
from twin.compensation.comparison import Commands
from twin.compensation.correction import Corrections, CorrectionTally
from twin.compensation.interpolation import interpolated
from twin.compensation.pieces import Pieces
from twin.compensation.report import ClassShare, ControlNote, DeviationTally, LineNote, Report, ReversalNote
from twin.compensation.rows import Rows, Ways
from twin.compensation.uncorrected import Uncorrected
from twin.kinematics.forward import angle_between_rad
from twin.machine.conditions import TIME, Listening
from twin.nc.blocks import Notice
from twin.uncertainty.at_tool import ToolUncertainty

WARM_UP_S: Final = 600.0
"""Over which it is said how far a warm-up goes on."""
ENDS: Final = 16_384
"""Whose uncertainty is taken at once: 36 numbers for every end."""
STRAIGHT_MM: Final = 1.0
STRAIGHT_DEG: Final = 0.3
"""How far from a straight line axes may be for their uncertainty to be taken along it: over so little, that of a curve changes by less
than a hundredth but at the very ends of its domain."""
SAME_SIDE: Final = 0.01
"""The same of the sides that axes come from, +1 and −1."""
CLASS_POSES: Final = 5000
"""Poses at which the shares of the classes are taken: a share needs no more, the total is over all."""
LEAST_SHARE: Final = 1e-9
"""Of the blocks: where one block alone has more poses than that, it has them."""
GOLDEN: Final = (5.0**0.5 - 1.0) / 2.0
"""Blocks whose number times this has a fraction below a share are that share of all blocks, spread as evenly as can be, and in step
with nothing that a program repeats (H. Weyl, Math. Ann. 77, 1916; V. Sós, 1958)."""


@final
class Account:
    """The account of one compensated program.

    Args:
        bench: machine, calibration, options.
        aim: what was corrected.
        source: the program's name.

    Attributes:
        idle: whether no error motion is in scope.
    """

    def __init__(self, bench: Bench, aim: Aim, source: str) -> None:
        self.bench = bench
        self.aim = aim
        self.source = source
        self._motions = 0
        self._before, self._after = DeviationTally(), DeviationTally()
        self._point, self._axis = CorrectionTally("tool point", "um"), CorrectionTally("tool axis", "urad")
        self._sample = _Sample()
        self._left_um = {"rounding": 0.0, "solver": 0.0}
        self._largest = np.zeros(len(bench.machine.axes))
        self._split = self._added = self._rewritten = 0
        self.idle = False
        self._all_tcp, self._any_tcp = True, False
        self._cutting = 0
        self._uncorrected = Uncorrected(bench, aim)
        self._reversals = np.zeros(len(bench.machine.axes), dtype=int)
        self._of_sides: list[LineNote] = []

    def add(self, pieces: Pieces, rows: Rows, *, rewritten: int, context: int = 0) -> None:
        """Re-simulate densely what was written of a stretch, beside what was there before.

        Args:
            pieces: the stretch cut into pieces.
            rows: the commands for their ends.
            rewritten: how many moves were given new words.
            context: how many of its motions, the first ones, belong to the stretch before.
        """
        lines = pieces.path.columns.line + 1
        legs = pieces.legs.motion
        dense = np.flatnonzero(pieces.interpolated[legs] & (legs >= context))
        ways = pieces.ways(rows, rows.printed, as_run=True)
        whole, rows = rows, rows.where(slice(int(np.searchsorted(rows.motion, context)), None))
        place = np.mod((self._motions - context + np.arange(len(lines))) * GOLDEN, 1.0)
        for seen in self._seen(pieces, rows, ways, dense):
            self._compare(seen, lines, place)
        good = ~rows.untouched & ~rows.clamped
        meant = Commands(rows.nominal)
        left_um = {}
        for name, given in (("rounding", rows.commands), ("solver", rows.exact)):
            left_um[name] = self.aim.compared.distance_mm(meant, Commands(given), rows.approach) * 1e3
            self._left_um[name] = max(self._left_um[name], float(left_um[name][good].max(initial=0.0)))
        corrections = np.abs(rows.commands - rows.nominal)[~rows.untouched]
        self._largest = np.maximum(self._largest, corrections.max(axis=0, initial=0.0))
        count = pieces.count(whole)[context:]
        self._cutting += int(np.count_nonzero(~pieces.path.columns.rapid[context:]))
        self._split += int(np.count_nonzero(count > 1))
        self._added += int(np.sum(count - 1))
        self._rewritten += rewritten
        self.idle = pieces.idle
        self._all_tcp &= bool(pieces.tcp[context:].all())
        self._any_tcp |= bool(pieces.tcp[context:].any())
        self._correct(rows, lines)
        if not self.idle:
            self._uncorrected.add(pieces, whole, context, lines, left_um)
        for axis in self.bench.lost.axes:
            self._reversals[axis] += int(np.count_nonzero(rows.turned[:, axis] & rows.taken))
        self._of_sides += self._note_sides(rows, lines)
        self._motions += len(pieces.path.motions) - context

    def report(self, *, lines: int, moves: int, notices: Sequence[Notice]) -> Report:
        """The account of all of it.

        Args:
            lines: how many lines the program has.
            moves: how many moves.
            notices: of whoever read it.
        """
        bench = self.bench
        notes = [LineNote(notice.line + 1, notice.text) for notice in notices]
        notes = [*self._unused_setup(), *self._of_channels(), *self._of_sides, *notes]
        unused = bench.options.conditions.unused(bench.calibration)
        left = self._uncorrected.shortfalls()
        return Report(
            program=self.source,
            machine=bench.machine.name,
            calibration=str(bench.calibration.path or "none"),
            calibration_source=bench.calibration.source,
            warnings=bench.calibration.warnings,
            method=bench.options.method,
            scope="as in the thesis" if bench.options.method == "thesis" else str(self.aim.scope),
            tool_length_mm=bench.full.tool_length_mm,
            tolerance_um=bench.options.tolerance_mm * 1e3,
            lines=lines,
            moves=moves,
            rewritten=self._rewritten,
            split=self._split,
            added=self._added,
            largest_correction={
                axis.name: (float(self._largest[i]), axis.unit) for i, axis in enumerate(bench.machine.axes)
            },
            before=self._before.deviation(),
            after=self._after.deviation(),
            rounding_um=self._left_um["rounding"],
            solver_um=self._left_um["solver"],
            classes=self._classes(whole=not left),
            not_corrected=left,
            cutting=self._cutting,
            idle=self.idle,
            notes=tuple(notes),
            uncertainty=Corrections(self._point.correction(), self._axis.correction()),
            conditions={name: value for name, value in bench.options.conditions.channels.items() if name not in unused},
            reversals=self._of_reversals(),
            control=self._of_control(),
        )

    # --- what is added ---------------------------------------------------------------------------------------------------

    def _seen(self, pieces: Pieces, rows: Rows, ways: Ways, dense: np.ndarray) -> Iterator[_Seen]:
        """Ends of pieces, then the dense points inside those of some legs."""
        # Written unchanged: its arcs are arcs.
        ends = Commands(rows.nominal), Commands(rows.nominal if pieces.idle else rows.commands)
        if self.bench.lost.axes:
            yield self._sided(pieces, rows, ends, ways, dense)
            return
        yield _Seen(rows.motion, *ends, counts=~rows.taken)
        for portion in pieces.portions(dense):
            samples = pieces.samples(portion)
            meant = pieces.meant(samples)
            given = meant if pieces.idle else pieces.given(samples, ways)
            yield _Seen(pieces.legs.motion[samples.leg][samples.piece], meant, given)

    def _sided(
        self, pieces: Pieces, rows: Rows, ends: tuple[Commands, Commands], ways: Ways, dense: np.ndarray
    ) -> _Seen:
        """Both at once with the sides axes come from, which depend on all that was before."""
        samples = pieces.samples(dense)
        meant = pieces.meant(samples)
        inside = meant, meant if pieces.idle else pieces.given(samples, ways)
        motion = np.concatenate([rows.motion, pieces.legs.motion[samples.leg][samples.piece]])
        fraction = np.concatenate([rows.fraction, pieces.fractions(samples)])
        taken = np.concatenate([rows.taken, np.zeros(len(samples.piece), dtype=bool)])
        order = np.lexsort((taken, fraction, motion))
        commands, sides = [], []
        for end, between in zip(ends, inside, strict=True):
            both = np.concatenate([end.written(), between.written()])
            side = np.zeros(both.shape)
            side[order] = self.bench.lost.sides(pieces.path, motion[order], both[order])
            commands.append(Commands(both))
            sides.append(side)
        # A move that takes up a reversal has no place of its own to be at.
        return _Seen(motion, commands[0], commands[1], sides[0], sides[1], counts=~taken)

    def _compare(self, seen: _Seen, lines: np.ndarray, place: np.ndarray) -> None:
        """Re-simulate places, as meant and as given; of motions their ``lines``, and ``place`` in the sample."""
        before = self.bench.compared.poses(seen.meant, seen.meant, seen.meant_from)
        after = self.bench.compared.poses(seen.meant, seen.given, seen.given_from)
        keep = before.known & after.known
        if seen.counts is not None:
            keep &= seen.counts
        of = lines[seen.motion]
        if not keep.all():
            before, after, of = before.where(keep), after.where(keep), of[keep]
        self._before.add(before, of)
        self._after.add(after, of)
        self._sample.add(place, seen, keep)

    def _correct(self, rows: Rows, lines: np.ndarray) -> None:
        """How far the tool was moved at the block ends, and how well the calibration knows that it had to be.

        By the machine as drawn from the meant commands to the given ones; the calibration's uncertainty, of what is in scope, at
        the meant ones: there and at the given ones it is the same to a thousandth.
        """
        aim = self.aim
        given = np.where(rows.clamped[:, None], rows.commands, rows.exact)  # rounding is accounted for by itself
        moved = self.bench.corrected_by.poses(Commands(rows.nominal), Commands(given))
        keep = ~rows.untouched & ~rows.taken & moved.known
        keep &= every(~self.bench.full.outside_domain(rows.nominal))
        if not np.any(keep):
            return
        if not keep.all():
            rows, moved = rows.where(keep), moved.where(keep)
        of = lines[rows.motion]
        at_point = None
        if not aim.point.calibration.empty:
            at_point = _known(aim.at_point, rows)
            self._point.add(
                of, rows.motion, moved.distance_mm * 1e3, at_point[:, 0, 0], at_point[:, 0, 1:], aim.at_point
            )
        turned = ~rows.singular  # the others are listed as what cannot be corrected
        asked = aim.scope.orientation and self.bench.thesis is None
        if asked and aim.at_axis is not None and np.any(turned):
            same = at_point if aim.at_axis is aim.at_point else None
            at_axis = (_known(aim.at_axis, rows) if same is None else same)[turned]
            size = moved.angle_rad[turned] * 1e6
            self._axis.add(of[turned], rows.motion[turned], size, at_axis[:, 1, 0], at_axis[:, 1, 1:], aim.at_axis)

    def _note_sides(self, rows: Rows, lines: np.ndarray) -> list[LineNote]:
        """Where the side an axis comes from is not known, and what taking up a reversal looks like."""
        notes = []
        for axis in self.aim.lost.axes:
            name = self.bench.machine.axes[axis].name
            unknown = np.flatnonzero((rows.approach[:, axis] == 0.0) & ~rows.untouched)
            if unknown.size:
                blocks = np.unique(rows.motion[unknown])
                where = "here" if len(blocks) == 1 else f"in {len(blocks)} blocks from here on"
                notes.append(
                    LineNote(
                        int(lines[blocks[0]]),
                        f"the program has not said from which side {name} comes {where}: taken as the middle of its reversal",
                    )
                )
            if self.bench.lost.size[axis] > 0.0 and np.any(rows.taken):
                notes.append(
                    LineNote(
                        1,
                        f"the reversal of {name} is positive (it jumps ahead when it turns): taking it up moves {name} beyond the "
                        "turning point for a moment, by its size and three increments",
                    )
                )
        return notes

    # --- what is made of it ----------------------------------------------------------------------------------------------

    def _of_reversals(self) -> tuple[ReversalNote, ...]:
        """What was done about every reversal of the calibration."""
        found = []
        for axis in np.flatnonzero(self.bench.lost.size).tolist():
            machine_axis = self.bench.machine.axes[axis]
            unit, scale = ("um", 1e3) if machine_axis.linear else ("urad", machine_axis.scale * 1e6)
            found.append(
                ReversalNote(
                    axis=machine_axis.name,
                    unit=unit,
                    size=float(self.bench.lost.size[axis] * scale),
                    corrected=axis in self.aim.lost.axes,
                    taken_up=int(self._reversals[axis]),
                )
            )
        return tuple(found)

    def _of_channels(self) -> list[LineNote]:
        """What a reader must know of temperatures and time."""
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
        return notes

    def _unused_setup(self) -> list[LineNote]:
        """Offsets the user gave that this program has no words for: better said than silently ignored."""
        setup, axes = self.bench.options.setup, self.bench.space.axes
        notes = []
        if self._all_tcp and any(setup.work_offset.get(name) for name in axes.linear):
            notes.append(
                LineNote(
                    1, "work offsets of linear axes are not used: the words are tool-tip coordinates (--work-origin)"
                )
            )
        if not self._any_tcp and any(setup.work_origin_mm):
            notes.append(LineNote(1, "the work origin is not used: the words are axis positions (--work-offset)"))
        return notes

    def _of_control(self) -> ControlNote | None:
        """What the control does by itself at the poses the classes are told apart at."""
        section, alone = self.bench.calibration.control, self.bench.control_alone
        if section is None:
            return None
        files = tuple(entry.file.name for entry in section.tables)
        if alone is None:
            return ControlNote(section.errors_are, files, (), None, None, section.caution)
        before, before_from, _, _ = self._sample.poses()
        moved = alone.forward(before, before_from).point_mm - self.bench.space.nominal.forward(before).point_mm
        share = np.linalg.norm(moved, axis=1) * 1e3
        axes = tuple(dict.fromkeys(table.axis.name for table in self.bench.calibration.corrections))
        return ControlNote(section.errors_are, files, axes, _rms(share), float(share.max(initial=0.0)))

    def _classes(self, whole: bool) -> tuple[ClassShare, ...]:
        """The shares of the classes; ``whole`` where every block is corrected."""
        before, before_from, after, after_from = self._sample.poses()
        nominal = self.bench.space.nominal
        meant, reached = nominal.forward(before), nominal.forward(after)
        shares = []
        for name, alone in self.aim.by_class.items():
            alone_before = alone.forward(before, before_from)
            share = np.linalg.norm(alone_before.point_mm - meant.point_mm, axis=1) * 1e3
            turn = angle_between_rad(alone_before.axis, meant.axis) * 1e6
            corrected = None if self.bench.options.method == "thesis" else name in self.aim.scope.classes
            left = np.linalg.norm(alone.forward(after, after_from).point_mm - reached.point_mm, axis=1) * 1e3
            shares.append(
                ClassShare(
                    name=name,
                    corrected=corrected,
                    before_rms_um=_rms(share),
                    before_max_um=float(share.max(initial=0.0)),
                    before_max_urad=float(turn.max(initial=0.0)),
                    left_rms_um=_rms(left) if corrected is False else 0.0 if corrected and whole else None,
                )
            )
        return tuple(shares)


class _Seen(NamedTuple):
    """Places on the way.

    Attributes:
        motion: (n,) which motion each is on.
        meant, given: commands as meant and as given.
        meant_from, given_from: (n, axes) sides axes come from there, where the machine makes one of it.
        counts: (n,) whether it is a place to be at; None: all.
    """

    motion: np.ndarray
    meant: Commands
    given: Commands
    meant_from: np.ndarray | None = None
    given_from: np.ndarray | None = None
    counts: np.ndarray | None = None


@final
class _Sample:
    """Some of the poses, spread over all of a program whose end is not in sight: those of a share of its blocks."""

    def __init__(self) -> None:
        self._share = 1.0
        self._parts: list[tuple[np.ndarray, ...]] = []
        self._count = 0

    def add(self, place: np.ndarray, seen: _Seen, keep: np.ndarray) -> None:
        """Take what falls to the share of some places; ``place``: (motions,) from 0 to 1 where each motion's block is in it."""
        which = np.flatnonzero((place < self._share)[seen.motion] & keep)
        poses = []
        for commands, sides in ((seen.meant, seen.meant_from), (seen.given, seen.given_from)):
            written = commands.written(which)
            poses += [written, np.zeros(written.shape) if sides is None else sides[which]]
        self._take((place[seen.motion[which]], *poses))
        while (
            self._count > CLASS_POSES
            and self._share > LEAST_SHARE
            and any(np.any(part[0] < self._share / 2.0) for part in self._parts)
        ):
            self._share /= 2.0
            parts, self._parts, self._count = self._parts, [], 0
            for part in parts:
                self._take(part)

    def _take(self, part: tuple[np.ndarray, ...]) -> None:
        keep = np.flatnonzero(part[0] < self._share)
        self._parts.append(tuple(array[keep] for array in part))
        self._count += len(keep)

    def poses(self) -> tuple[np.ndarray, ...]:
        """The arrays."""
        return tuple(np.concatenate(arrays) for arrays in list(zip(*self._parts, strict=True))[1:])


def _known(tool: ToolUncertainty, rows: Rows) -> np.ndarray:
    """(rows, 2, 4) U of the point and its standard uncertainties, µm; of the axis and the rotation, µrad; NaN if nothing is known."""
    if not tool.parameters:
        return np.full((len(rows.motion), 2, 4), np.nan)

    def some(which: np.ndarray) -> np.ndarray:
        found = tool.at(rows.nominal[which], rows.approach[which])
        point = np.column_stack([found.expanded_um, found.standard_um])
        return np.stack([point, np.column_stack([found.axis_expanded_urad, found.standard_urad])], axis=1)

    def values(which: np.ndarray) -> np.ndarray:
        return np.concatenate([some(which[first : first + ENDS]) for first in range(0, len(which), ENDS)])

    axes = tool.kinematics.machine.axes
    near = [STRAIGHT_MM if axis.linear else STRAIGHT_DEG for axis in axes]
    return interpolated(values, np.hstack([rows.nominal, rows.approach]), np.array(near + [SAME_SIDE] * len(axes)))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
