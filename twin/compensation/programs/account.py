"""Collect the report of a compensation by simulating the original and the written program densely, stretch by stretch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.arrays import rows_all_true
from twin._common.records import TIME
from twin.compensation.programs.comparison import Commands
from twin.compensation.programs.correction import Corrected
from twin.compensation.programs.motions import LostBlock
from twin.compensation.programs.pieces import Pieces, Rows
from twin.compensation.programs.prepared import CorrectionAim, PreparedMachine
from twin.compensation.programs.report import (
    ClassShare,
    CompensationTally,
    ControlNote,
    Corrections,
    CorrectionTally,
    Deviation,
    LineNote,
    Report,
    ReversalNote,
    UnknownErrors,
)
from twin.compensation.programs.uncorrected import (
    FrameUse,
    Sample,
    Shortfall,
    ShortfallTally,
    SimulatedPoints,
    directed_points,
    hinted,
    interpolated,
    of_unknown,
    uncorrected,
)
from twin.model.effects.base import RecordingState
from twin.nc.blocks import Notice
from twin.tool.forward import Poses, angle_between_rad
from twin.tool.uncertainty import ToolUncertainty

WARM_UP_S: Final = 600.0
"""Time over which the further change of a thermal effect is reported, s."""


def setup_notes(prepared: PreparedMachine, *, all_tcp: bool, any_tcp: bool) -> Iterator[LineNote]:
    """Yield a note for every work offset or origin that was given but does not apply to this program."""
    setup = prepared.options.setup
    if all_tcp and any(setup.work_offset.get(name) for name in prepared.space.axes.linear):
        text = (
            "work offsets of linear axes are ignored: the words are tool-tip coordinates, which the work origin shifts"
        )
        yield LineNote(1, text)
    if not any_tcp and any(setup.work_origin_mm):
        yield LineNote(1, "the work origin is ignored: the words are axis positions, which work offsets shift")


def condition_notes(prepared: PreparedMachine, by_block: str) -> Iterator[LineNote]:
    """Yield notes on conditions that changed (``by_block``, in words), that no effect uses, or whose effects still change."""
    conditions = prepared.options.conditions
    if by_block:
        yield LineNote(1, by_block)
    for name in conditions.unused(prepared.calibration):
        yield LineNote(1, f"{name} was given and the calibration does not need it")
    if conditions.time_s is None or TIME in prepared.by_block:
        return
    for effect in prepared.calibration.effects:
        now, later = RecordingState(prepared.machine), RecordingState(prepared.machine)
        now[TIME], later[TIME] = np.array([conditions.time_s]), np.array([conditions.time_s]) + WARM_UP_S
        before, after = effect.components(now), effect.components(later)
        grown = np.sqrt(sum((after[i] - before[i]) ** 2 for i in before if i < 3))
        if np.any(grown >= 0.1):
            size, minutes = f"{float(grown[0]):.1f} µm", f"{WARM_UP_S / 60:g}"
            yield LineNote(
                1, f"{effect.name} changes by a further {size} in the {minutes} minutes after the given time"
            )


def approach_notes(corrected: Corrected) -> Iterator[LineNote]:
    """Yield notes on axes whose approach direction is unknown, and on axes that overshoot while a positive reversal is taken up."""
    prepared, rows = corrected.pieces.prepared, corrected.own
    for axis in corrected.pieces.aim.backlash.axes:
        name = prepared.machine.axes[axis].name
        blocks = np.unique(rows.motion[(rows.approach[:, axis] == 0.0) & ~rows.untouched])
        if blocks.size:
            where = "in this block" if len(blocks) == 1 else f"in {len(blocks)} blocks from here on"
            yield LineNote(
                int(corrected.lines[blocks[0]]),
                f"approach direction of {name} unknown {where}: the middle of its reversal value is assumed",
            )
        if prepared.backlash.size[axis] > 0.0 and np.any(rows.backlash_move):
            yield LineNote(
                1,
                f"the reversal value of {name} is positive (the axis jumps ahead when it reverses): compensating it moves {name} "
                "briefly beyond the reversal point, by that value plus three least increments",
            )


def reversal_notes(prepared: PreparedMachine, aim: CorrectionAim, taken_up: np.ndarray) -> Iterator[ReversalNote]:
    """Yield how each reversal of the calibration was treated; ``taken_up`` (axes,): number of reversals at which it was taken up."""
    for i in np.flatnonzero(prepared.backlash.size).tolist():
        axis = prepared.machine.axes[i]
        unit, scale = ("um", 1e3) if axis.linear else ("urad", axis.scale * 1e6)
        yield ReversalNote(
            axis.name, unit, float(prepared.backlash.size[i] * scale), i in aim.backlash.axes, int(taken_up[i])
        )


# --- Collect the report of a compensation by simulating the original and the written program densely, stretch by stretch

ENDS: Final = 16_384
"""Block end points whose uncertainty is evaluated at once; each takes 36 numbers."""
STRAIGHT_MM: Final = 1.0
STRAIGHT_DEG: Final = 0.3
"""Deviation of an axis from a straight line (mm, degrees) up to which uncertainty is interpolated along that line. Over such a distance
a curve's uncertainty changes by less than one per cent, except at the very ends of its domain.
"""
SAME_SIDE: Final = 0.01
"""The same limit for approach directions, which range from −1 to +1."""


class _Sampled(NamedTuple):
    """Sampled poses of one aim: commands, approach directions (n, axes), and poses of the machine without errors."""

    aim: CorrectionAim
    commands: np.ndarray
    approach: np.ndarray
    nominal: Poses


@final
class CompensationAccount:
    """Builds the report of one compensated program; ``source``: the program's name."""

    def __init__(self, prepared: PreparedMachine, source: str) -> None:
        self._prepared, self._source = prepared, source
        self._before, self._after = CompensationTally(4, 4), CompensationTally(4, 4)
        self._point, self._axis = CorrectionTally("tool point", "um"), CorrectionTally("tool axis", "urad")
        self._with_unknown = CompensationTally(1, 1)
        self._samples: dict[CorrectionAim, Sample] = {}
        self._shortfalls = ShortfallTally()
        self._residual_um = {"rounding": 0.0, "solver": 0.0}
        self._largest = np.zeros(len(prepared.machine.axes))
        self._motions = self._split = self._added = self._rewritten = self._cutting = 0
        self._idle = self._any_tcp = self._turns = False
        self._all_tcp = True
        self._by_block = ""
        self._reversals = np.zeros(len(prepared.machine.axes), dtype=int)
        self._approach_notes: list[LineNote] = []

    def add(self, corrected: Corrected) -> None:
        """Simulate a corrected stretch densely, before and after correction, and add the result to the totals."""
        pieces, rows, context = corrected.pieces, corrected.own, corrected.context
        self._idle, self._by_block = pieces.idle, pieces.conditions.source
        self._turns |= pieces.aim.turns
        for points in self._simulated(corrected):
            self._compare(points, pieces, corrected.lines, self._motions - context)
        residual_um = self._end_point_residuals_um(pieces, rows)
        corrections = np.abs(rows.commands - rows.nominal)
        if rows.untouched.any():
            corrections = corrections[~rows.untouched]
        self._largest = np.maximum(self._largest, [axis.max(initial=0.0) for axis in corrections.T])
        count = pieces.count(corrected.rows)[context:]
        self._cutting += int(np.count_nonzero(~pieces.path.columns.rapid[context:]))
        self._split += int(np.count_nonzero(count > 1))
        self._added += int(np.sum(count - 1))
        self._rewritten += corrected.rewritten
        self._all_tcp &= bool(pieces.tcp[context:].all())
        self._any_tcp |= bool(pieces.tcp[context:].any())
        self._tally_correction(pieces, rows, corrected.lines)
        if not self._idle:
            for shortfalls in uncorrected(corrected, residual_um):
                self._shortfalls.add(shortfalls)
        axes = self._prepared.backlash.axes
        self._reversals[axes] += np.count_nonzero(rows.reverses[rows.backlash_move][:, axes], axis=0)
        self._approach_notes += approach_notes(corrected)
        self._motions += len(pieces.start) - context

    def report(
        self,
        *,
        lines: int,
        moves: int,
        notices: Sequence[Notice],
        unknown: Sequence[LostBlock] = (),
        frames: tuple[FrameUse, ...] = (),
        text_of: Callable[[int], str],
    ) -> Report:
        """Return the report of everything added so far; ``text_of``: function that returns the text of a line by its number."""
        prepared, options = self._prepared, self._prepared.options
        notes = tuple(self._notes(notices))
        not_corrected = self._not_corrected(unknown, text_of)
        return Report(
            program=self._source,
            machine=prepared.machine.name,
            calibration=str(prepared.calibration.path or "none"),
            calibration_source=prepared.calibration.source,
            warnings=prepared.calibration.warnings,
            method=options.method,
            scope="as in the thesis" if options.method == "thesis" else str(self._aim.scope),
            tool_length_mm=frames[0].tool_length_mm if frames else prepared.real.tool_length_mm,
            frames=frames,
            tolerance_um=options.tolerance_mm * 1e3,
            lines=lines,
            moves=moves,
            rewritten=self._rewritten,
            split=self._split,
            added=self._added,
            largest_correction={
                axis.name: (float(most), axis.unit)
                for axis, most in zip(prepared.machine.axes, self._largest, strict=True)
            },
            before=Deviation.of(self._before),
            after=Deviation.of(self._after),
            rounding_um=self._residual_um["rounding"],
            solver_um=self._residual_um["solver"],
            classes=tuple(self._classes(all_corrected=not not_corrected)),
            not_corrected=not_corrected,
            notes=notes,
            uncertainty=Corrections(self._point.correction(), self._axis.correction(), self._unknown_errors()),
            cutting=self._cutting + sum(one.cutting for one in unknown),
            idle=self._idle,
            conditions=prepared.constant,
            reversals=tuple(reversal_notes(prepared, self._aim, self._reversals)),
            control=self._control_note(),
        )

    @property
    def _aim(self) -> CorrectionAim:
        """The errors that were corrected."""
        return self._prepared.aim(turns=self._turns)

    # --- accumulation ------------------------------------------------------------------------------------------------

    def _simulated(self, corrected: Corrected) -> Iterator[SimulatedPoints]:
        """Yield the end points of pieces, then dense points inside the pieces, one portion of legs after the other."""
        pieces, path_errors, rows = corrected.pieces, corrected.path_errors, corrected.own
        legs = pieces.legs.motion
        dense = np.flatnonzero(pieces.interpolated[legs] & (legs >= corrected.context))
        # An idle program is written unchanged, so its arcs stay arcs.
        ends = Commands(rows.nominal), Commands(rows.nominal if pieces.idle else rows.commands)
        portions, varying = path_errors.portions(dense), bool(pieces.conditions.names)
        if self._prepared.backlash.axes:
            ways = path_errors.ways(corrected.rows, printed=True, as_run=True)
            yield from directed_points(corrected, self._prepared, ends, portions, ways)
            return
        state = self._state(pieces, rows.motion, rows.fraction)
        yield SimulatedPoints(rows.motion, *ends, state, state).of(np.flatnonzero(~rows.backlash_move))
        if not portions:
            return
        ways = path_errors.ways(corrected.rows, printed=True, as_run=True)
        for portion in portions:
            samples = path_errors.samples(portion)
            nominal, written = path_errors.commands(samples, ways)
            written = nominal if pieces.idle else written
            motion = legs[samples.leg] if nominal.points is not None else legs[samples.leg][samples.piece]
            points = SimulatedPoints(motion, nominal, written)
            if varying:
                points = points.of(np.arange(len(motion)))
                state = self._state(pieces, points.motion, path_errors.fractions(samples))
                points = points._replace(nominal_sides=state, written_sides=state)
            yield points

    def _state(self, pieces: Pieces, motion: np.ndarray, fraction: np.ndarray) -> np.ndarray | None:
        """Return (n, axes + channels) the conditions of points where there is no backlash; None if they are the same everywhere."""
        if not pieces.conditions.names:
            return None
        return pieces.conditions.at(np.zeros((len(motion), len(self._prepared.machine.axes))), motion, fraction)

    def _compare(self, points: SimulatedPoints, pieces: Pieces, lines: np.ndarray, first: int) -> None:
        """Simulate points with nominal and written commands, and add the deviations; ``first``: the stretch's first motion."""
        comparison = pieces.prepared.comparison
        found = comparison.totals(points.nominal, points.written, points.nominal_sides, points.written_sides)
        for tally, totals in zip((self._before, self._after), found, strict=True):
            if totals.count:
                tally.add(totals.largest.T, totals.squares, lines[points.motion[totals.line]], totals.count)

        def known(some: SimulatedPoints) -> np.ndarray:
            return comparison.known(some.nominal.begin) & comparison.known(some.written.begin)

        self._samples.setdefault(pieces.aim, Sample()).add(first, points, known)

    def _end_point_residuals_um(self, pieces: Pieces, rows: Rows) -> dict[str, np.ndarray]:
        """Return by cause (``rounding``, ``solver``) the (rows,) distance in µm of the tool point from its target at end points."""
        good, state = ~rows.untouched & ~rows.clamped, pieces.state(rows)
        meant, found = np.concatenate([rows.nominal] * 2), np.concatenate([rows.commands, rows.exact])
        distance = pieces.aim.comparison.distance_mm(Commands(meant), Commands(found), np.concatenate([state] * 2))
        residual_um = dict(zip(("rounding", "solver"), 1e3 * distance.reshape(2, -1), strict=True))
        for name, of_rows in residual_um.items():
            self._residual_um[name] = max(self._residual_um[name], float(of_rows[good].max(initial=0.0)))
        return residual_um

    def _tally_correction(self, pieces: Pieces, rows: Rows, lines: np.ndarray) -> None:
        """Tally how far the correction moves the tool at block end points, and the uncertainty of that correction.

        The displacement is that of the machine without errors between nominal and compensated commands. The uncertainty is that of the
        corrected errors at the nominal commands; at the compensated ones it differs by less than a thousandth.
        """
        aim, prepared = pieces.aim, pieces.prepared
        compensated = np.where(rows.clamped[:, None], rows.commands, rows.exact)  # rounding is reported separately
        moved = prepared.nominal_comparison.poses(rows.nominal, compensated)
        keep = ~rows.untouched & ~rows.backlash_move & moved.known
        keep &= rows_all_true(~prepared.real.outside_domain(rows.nominal))
        if not np.any(keep):
            return
        if not keep.all():
            rows = rows.where(keep)
        line_of = lines[rows.motion]
        at_point = None
        if not aim.point.calibration.empty:
            at_point = _uncertainty(aim.at_point, pieces, rows)
            self._point.add(line_of, rows.motion, moved.distance_mm[keep] * 1e3, at_point[:, 0], aim.at_point)
        if prepared.at_unknown.unknown:
            squares = _uncertainty(prepared.at_unknown, pieces, rows)[:, 0, 0] ** 2
            # Independent of the identified errors: the radii add in squares, or less.
            squares += 0.0 if at_point is None else np.nan_to_num(at_point[:, 0, 0]) ** 2
            self._with_unknown.add(np.sqrt(squares)[None], np.array([squares.sum()]), line_of)
        turned = ~rows.singular  # the others are listed as not corrected
        orientation_corrected = aim.scope.orientation and prepared.thesis is None
        if orientation_corrected and aim.at_axis is not None and np.any(turned):
            uncertainty = (
                at_point
                if at_point is not None and aim.at_axis is aim.at_point
                else _uncertainty(aim.at_axis, pieces, rows)
            )
            size = moved.angle_rad[keep][turned] * 1e6
            self._axis.add(line_of[turned], rows.motion[turned], size, uncertainty[turned, 1], aim.at_axis)

    def _notes(self, notices: Sequence[Notice]) -> Iterator[LineNote]:
        yield from setup_notes(self._prepared, all_tcp=self._all_tcp, any_tcp=self._any_tcp)
        yield from condition_notes(self._prepared, self._by_block)
        yield from self._approach_notes
        yield from (LineNote(notice.line + 1, notice.text) for notice in notices)

    def _not_corrected(self, unknown: Sequence[LostBlock], text_of: Callable[[int], str]) -> tuple[Shortfall, ...]:
        if not self._idle:
            for shortfalls in of_unknown(unknown):
                self._shortfalls.add(shortfalls)
        return tuple(hinted(shortfall, text_of) for shortfall in self._shortfalls.shortfalls())

    def _unknown_errors(self) -> UnknownErrors | None:
        """Return U with the errors that the calibration could not determine; None if there are none, or nothing was corrected."""
        found = self._with_unknown
        if not found.count:
            return None
        (rms,), largest, line = found.rms, float(found.largest[0, 0]), int(found.lines[0])
        return UnknownErrors(self._prepared.at_unknown.unknown, rms, largest, line)

    # --- results -----------------------------------------------------------------------------------------------------

    def _control_note(self) -> ControlNote | None:
        """Return the share that the control's own tables correct, at the sampled poses; None if the calibration has no tables."""
        section, acts = self._prepared.calibration.control, bool(self._prepared.calibration.corrections)
        if section is None or (not acts and section.errors_are == "uncorrected"):
            return None
        active = section.entries if self._prepared.options.tcp else (*section.tables, *section.live)
        files = tuple(entry.file.name for entry in active)
        if not acts:
            return ControlNote(section.errors_are, files, (), None, None, section.caution, bool(section.live))
        moves = []
        for aim, sample in self._samples.items():
            before, before_from, _, _ = sample.poses()
            alone = aim.prepared.control_alone
            if alone is not None:
                moves.append(
                    alone.forward(before, before_from).point_mm - aim.prepared.space.nominal.forward(before).point_mm
                )
        share = np.linalg.norm(np.concatenate([np.zeros((0, 3)), *moves]), axis=1) * 1e3
        axes = tuple(dict.fromkeys(table.axis.name for table in self._prepared.calibration.corrections))
        return ControlNote(section.errors_are, files, axes, _rms(share), float(share.max(initial=0.0)))

    def _classes(self, *, all_corrected: bool) -> Iterator[ClassShare]:
        """Yield the share of each class; ``all_corrected``: whether every block is corrected."""
        before: list[_Sampled] = []
        after: list[_Sampled] = []
        for aim, sample in self._samples.items():
            nominal = aim.prepared.space.nominal
            meant, meant_from, written, written_from = sample.poses()
            before.append(_Sampled(aim, meant, meant_from, nominal.forward(meant)))
            after.append(_Sampled(aim, written, written_from, nominal.forward(written)))
        for name in self._aim.by_class:
            corrected = None if self._prepared.thesis is not None else name in self._aim.scope.classes
            share_um, turn_urad = _class_errors(name, before)
            left = 0.0 if corrected and all_corrected else None
            yield ClassShare(
                name=name,
                corrected=corrected,
                before_rms_um=_rms(share_um),
                before_max_um=float(share_um.max(initial=0.0)),
                before_max_urad=float(turn_urad.max(initial=0.0)),
                left_rms_um=_rms(_class_errors(name, after)[0]) if corrected is False else left,
            )


def _uncertainty(tool: ToolUncertainty, pieces: Pieces, rows: Rows) -> np.ndarray:
    """Return (rows, 2, 4): U and three standard uncertainties of the tool point (µm) and of its orientation (µrad); NaN if unknown."""
    if not tool.parameters:
        return np.full((len(rows.motion), 2, 4), np.nan)

    state = pieces.state(rows)

    def some(which: np.ndarray) -> np.ndarray:
        found = tool.at(rows.nominal[which], state[which])
        point = np.column_stack([found.expanded_um, found.standard_um])
        return np.stack([point, np.column_stack([found.axis_expanded_urad, found.standard_urad])], axis=1)

    def values(which: np.ndarray) -> np.ndarray:
        return np.concatenate([some(which[first : first + ENDS]) for first in range(0, len(which), ENDS)])

    axes = tool.kinematics.machine.axes
    near = [STRAIGHT_MM if axis.linear else STRAIGHT_DEG for axis in axes]
    return interpolated(values, np.hstack([rows.nominal, rows.approach]), np.array(near + [SAME_SIDE] * len(axes)))


def _class_errors(name: str, samples: Sequence[_Sampled]) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of one class at sampled poses: of the point (µm) and of the tool axis (µrad)."""
    point_um, axis_urad = [np.zeros(0)], [np.zeros(0)]
    for aim, commands, approach, nominal in samples:
        reached = aim.by_class[name].forward(commands, approach)
        point_um.append(np.linalg.norm(reached.point_mm - nominal.point_mm, axis=1) * 1e3)
        axis_urad.append(angle_between_rad(reached.axis, nominal.axis) * 1e6)
    return np.concatenate(point_um), np.concatenate(axis_urad)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
