"""Compensation of a whole program in memory, or from file to file.

The output is read back, compared with the intended positions and simulated before it is returned or its file appears.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.bundled import find_program
from twin._common.errors import InputError
from twin._common.files import atomic_file, tracked_files
from twin._common.resources import Progress, silent
from twin.compensation.programs.account import CompensationAccount
from twin.compensation.programs.block_conditions import block_conditions
from twin.compensation.programs.correction import Corrected, correct, new_positions
from twin.compensation.programs.follow import SectionMotions, follow, motionless, motions_of, sections, spaces
from twin.compensation.programs.motions import ToolPath, increments_hinted
from twin.compensation.programs.pieces import Pieces
from twin.compensation.programs.prepared import Options, PreparedMachine
from twin.compensation.programs.report import Report
from twin.compensation.programs.stream import Streamed, check, unreadable
from twin.compensation.programs.uncorrected import frame_uses
from twin.display.results import Display, DisplayedResult
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import dialect_for, dialect_of, read_program
from twin.nc.blocks import Interpretation, NewPositions, Notice, Program, as_columns
from twin.nc.dialect import Dialect
from twin.nc.inline import errors_in_files
from twin.nc.modal import UNKNOWN_AFTER


@final
@dataclass(frozen=True, repr=False)
class Compensation(DisplayedResult):
    """A compensated program.

    Attributes:
        text: the program, to be written as latin-1.
        report: what was corrected and what was not.
        reading: the program as read.
        new: the new positions of its moves, in words.
        path: the program as motions.
        nominal: (rows, axes) nominal commands of every block's pieces, mm and degrees.
        exact: (rows, axes) compensated commands before the linear words were rounded.
        commands: (rows, axes) compensated commands as printed.
        moves: (rows,) index of each row's move among those of the reading.
        lines: (rows,) program line of each row.
        backlash_move: (rows,) whether the row only takes up backlash before the block begins.
    """

    text: str
    report: Report
    reading: Interpretation
    new: NewPositions
    path: ToolPath
    nominal: np.ndarray
    exact: np.ndarray
    commands: np.ndarray
    moves: np.ndarray
    lines: np.ndarray
    backlash_move: np.ndarray

    @property
    def brief(self) -> str:
        """That of its report."""
        return self.report.brief

    def display(self) -> Display:
        """Return that of its report."""
        return self.report.display()


@final
class Compensator:
    """Compensates programs on one machine with one calibration.

    Args:
        machine: the machine.
        calibration: its errors.
        options: the options; defaults if None.

    Raises:
        InputError: the machine cannot run programs, or the method does not apply to it.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> compensator = twin.Compensator(machine, twin.Calibration.default(machine), twin.Options(tool_length_mm=120))
        >>> for name in ("cone_frustum.nc", "cone_frustum.h"):  # set up once, used for many programs
        ...     program, dialect = twin.read_program(name)
        ...     print(name, round(compensator.compensate(program, dialect).report.before.max_um, 1))
        cone_frustum.nc 83.6
        cone_frustum.h 83.6
    """

    def __init__(self, machine: Machine, calibration: Calibration, options: Options | None = None) -> None:
        self.prepared = PreparedMachine(machine, calibration, Options() if options is None else options)

    def compensate(
        self,
        program: Program,
        dialect: Dialect,
        progress: Progress = silent,
        *,
        into: Dialect | None = None,
        reading: Interpretation | None = None,
    ) -> Compensation:
        """Compensate one program.

        Args:
            program: as read.
            dialect: its language.
            progress: called with a stage and the fraction done.
            into: the language to write; another than the program's own only for cutter locations (APT), which are then
                posted as axis words.
            reading: the program's moves, if they are known more exactly than from its text.

        Raises:
            InputError: the program cannot be read, or contains something that must not pass uncompensated.
            OutputError: the output, read back, differs from the intended positions; nothing was written.
        """
        with (
            errors_in_files(program),
            increments_hinted(self.prepared.machine, dialect, lambda line: "".join(program.texts[line - 1 : line])),
        ):
            return self._compensate(program, dialect, progress, into, reading)

    def _compensate(
        self,
        program: Program,
        dialect: Dialect,
        progress: Progress,
        into: Dialect | None,
        reading: Interpretation | None,
    ) -> Compensation:
        progress("reading", 0.0)
        prepared, axes = self.prepared, self.prepared.space.axes
        if reading is None:
            reading = dialect.moves(program, axes, tcp=prepared.options.tcp)
        parts = sections(prepared.space, program.source, reading)
        first, later = spaces(parts)
        path = follow(program, reading, first, later)
        if not path.motions:
            raise motionless(program.source, path.unknown)
        written = dialect if into is None else into
        posted = written.name != dialect.name
        progress("solving", 0.1)
        corrected = self._corrected(program, dialect, reading, path, motions_of(parts, path), progress, posted=posted)
        new = _with_shares(new_positions(corrected, len(reading.moves), len(axes.names)), corrected)
        progress("writing", 0.8)
        if posted:
            text = dialect.posted(program, reading, new, axes, written)
        else:
            text = dialect.rewrite(program, axes, reading, new)
        if np.any(new.count):
            text = written.with_comments(text, prepared.comments)
        self._check(program, reading, new, text, written, posted=posted)
        progress("checking", 0.9)
        numbers = program.numbers
        account = CompensationAccount(
            prepared, prepared.aim(turns=any(one.pieces.aim.turns for one in corrected)), program.source
        )
        for one in corrected:
            account.add(one)
        notices = [notice._replace(line=int(numbers[notice.line]) - 1) for notice in (*reading.notices, *path.notices)]
        if program.origins:
            notices.append(
                Notice(0, "subprograms are written out in place of their calls: the output needs none of them")
            )
        report = account.report(
            lines=len(program.texts),
            moves=len(reading.moves),
            notices=notices,
            unknown=[one._replace(line=int(numbers[one.line]) - 1) for one in path.unknown],
            frames=frame_uses(parts, numbers),
            text_of=lambda number: (
                program.texts[int(np.flatnonzero(numbers == number)[0])] if dialect.has_increments else ""
            ),
        )
        progress("done", 1.0)
        columns = [np.concatenate(column) for column in zip(*map(_columns, corrected), strict=True)]
        return Compensation(text, report, reading, new, path, *map(read_only, columns))

    def _corrected(
        self,
        program: Program,
        dialect: Dialect,
        reading: Interpretation,
        path: ToolPath,
        parts: Sequence[SectionMotions],
        progress: Progress,
        *,
        posted: bool,
    ) -> list[Corrected]:
        """Return every section of the program corrected, under the conditions of its blocks."""
        prepared = self.prepared
        turns = as_columns(prepared.space.axes.names, reading.moves).turns(prepared.space.axes.rotary)
        conditions = block_conditions(
            program,
            dialect,
            path,
            [(part.begin, part.space) for part in parts],
            prepared.calibration,
            prepared.options.conditions,
        )
        corrected = []
        for part in parts:
            within = prepared.within(part.space)
            pieces = Pieces(
                within,
                part.path,
                within.aim(turns=turns and part.space.tilt is None),
                dialect,
                source=program.source,
                numbers=program.numbers,
                conditions=conditions.part(part.begin - part.context, part.end),
                posted=posted,
            )
            corrected.append(correct(pieces, progress, context=part.context))
        return corrected

    def _check(
        self,
        program: Program,
        reading: Interpretation,
        new: NewPositions,
        text: str,
        written: Dialect,
        *,
        posted: bool,
    ) -> None:
        """Read the output back and compare it with the intended positions."""
        axes, tcp = self.prepared.space.axes, self.prepared.options.tcp and not posted
        try:
            read_back = written.moves(written.read(text.encode("latin-1"), program.source), axes, tcp=tcp)
        except InputError as error:
            raise unreadable(program.source, error) from error
        moves, got = (as_columns(axes.names, one.moves) for one in (reading, read_back))
        check(program.source, program.numbers[moves.line], new, got.position)

    def compensate_file(
        self, program: Path, output: Path, progress: Progress = silent, *, into: Dialect | None = None
    ) -> Report:
        """Compensate a program from file to file; the output is written atomically.

        An ISO program on a machine without backlash, under conditions that apply to all of it, is processed in stretches, so memory
        does not grow with its length. Any other program, and one with drilling cycles, is held in memory as a whole.

        Args:
            program: its path.
            output: where to write it.
            progress: called with a stage and the fraction done.
            into: as for `compensate`.

        Raises:
            InputError: as for `compensate`; a file cannot be read or written; the output is the program, or a file of the machine or
                the calibration.
            OutputError: as for `compensate`.
        """
        dialect = dialect_of(program)
        target = dialect if into is None else into
        setup = self.prepared.options.setup
        in_one_piece = bool(self.prepared.backlash.axes or self.prepared.by_block or setup.offsets or setup.tools)
        streams = dialect.in_chunks and target.name == dialect.name and program.is_file() and not in_one_piece
        with tracked_files() as files, ExitStack() as stack:
            for path in self._inputs(program):
                files.add_input(path)
            out = stack.enter_context(atomic_file(output))
            report = self._streamed(program, out, progress) if streams else None
            if report is None:
                out.seek(0)
                out.truncate()
                result = self.compensate(*read_program(program), progress, into=into)
                out.write(result.text.encode("latin-1"))
                report = result.report
        return report

    def _streamed(self, program: Path, out: BinaryIO, progress: Progress) -> Report | None:
        """Compensate a program in stretches; None if it must be held as a whole: it has drilling cycles or calls subprograms."""
        try:
            report = Streamed(self.prepared, program, progress).run(out)
        except InputError:
            if read_program(program)[0].origins:
                return None
            raise
        unknown = report is not None and any(UNKNOWN_AFTER in note.text for note in report.notes)
        return None if unknown and read_program(program)[0].origins else report

    def _inputs(self, program: Path) -> Iterator[Path]:
        """Yield the input files of this compensation."""
        calibration, machine = self.prepared.calibration, self.prepared.machine
        tables = () if calibration.control is None else calibration.control.entries
        log = self.prepared.options.conditions.log
        paths = (program, machine.path, machine.urdf, calibration.path, None if log is None else log.path)
        setup = self.prepared.options.setup
        given = (table.path for table in (setup.offsets, setup.tools) if table is not None)
        files = (*paths, *given, *(table.file for table in tables))
        return (path for path in files if path is not None)


def compensate(
    program: str | Path,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    options: Options | None = None,
    temperature: Mapping[str, float] | None = None,
    time_s: float | None = None,
    spindle_rpm: float | None = None,
    load_kg: float | None = None,
) -> Compensation:
    """Compensate the program of a file, or a sample program of twin, and return it with its report.

    Args:
        program: its path.
        machine: the machine it runs on.
        calibration: the machine's errors; the machine file's own if None.
        options: the options; defaults if None. Their `Conditions` may have a log of the machine (`twin.MachineLog`).
        temperature: °C by axis (of its scale) or sensor over the whole program; replaces those of the options.
        time_s: time within a warm-up, in the measured table's ``time_s``; replaces that of the options.
        spindle_rpm: spindle speed, constant since the start, 1/min; replaces that of the options. Without it the speeds are those of
            the log, or of the program's S words.
        load_kg: mass carried, kg; replaces that of the options.

    Raises:
        InputError: as for `Compensator` and its `compensate`; the program cannot be read.
        OutputError: as for `Compensator.compensate`.

    Examples:
        >>> from pathlib import Path
        >>> machine = twin.Machine.load("dmu50")
        >>> result = twin.compensate("cone_frustum.nc", machine, options=twin.Options(tool_length_mm=120))
        >>> report = result.report
        >>> round(report.before.rms_um, 1), round(report.after.rms_um, 1)
        (67.7, 0.4)
        >>> _ = Path("compensated.nc").write_text(result.text, encoding="latin-1")

    References:
        - ISO/TR 16907:2015, Numerical compensation of geometric errors (classes of errors).
    """
    chosen = Options() if options is None else options
    base = chosen.conditions
    conditions = replace(
        base,
        temperature_degC=base.temperature_degC if temperature is None else temperature,
        time_s=base.time_s if time_s is None else time_s,
        spindle_rpm=base.spindle_rpm if spindle_rpm is None else spindle_rpm,
        load_kg=base.load_kg if load_kg is None else load_kg,
        speed_of_program=True,
    )
    errors = Calibration.default(machine) if calibration is None else calibration
    read, dialect = read_program(program)
    return Compensator(machine, errors, replace(chosen, conditions=conditions)).compensate(read, dialect)


def compensate_file(
    program: str | Path,
    output: str | Path,
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    options: Options | None = None,
    progress: Progress = silent,
) -> Report:
    """Compensate the program of a file, or a sample program of twin, into another file; memory stays bounded for ISO programs.

    Args:
        program: its path.
        output: where to write it, atomically.
        machine: the machine it runs on.
        calibration: the machine's errors; the machine file's own if None.
        options: the options; defaults if None.
        progress: called with a stage and the fraction done.

    Raises:
        InputError: as for `Compensator.compensate_file`.
        OutputError: as for `Compensator.compensate_file`.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> options = twin.Options(tool_length_mm=120)
        >>> report = twin.compensate_file("cone_frustum.nc", "compensated.nc", machine, options=options)
        >>> report.complete
        True
    """
    errors = Calibration.default(machine) if calibration is None else calibration
    source, target = find_program(program), Path(output)
    into = dialect_for(target) if dialect_of(source).cutter_locations else None
    return Compensator(machine, errors, options).compensate_file(source, target, progress, into=into)


def _columns(found: Corrected) -> tuple[np.ndarray, ...]:
    """Return the columns of `Compensation` for one section."""
    rows, columns = found.own, found.pieces.path.columns
    moves, lines = columns.move[rows.motion], found.lines[rows.motion]
    return rows.nominal, rows.exact, rows.commands, moves, lines, rows.backlash_move


def _with_shares(new: NewPositions, stretches: Sequence[Corrected]) -> NewPositions:
    """Return new positions with the shares of the moves' time, where moves are inserted that take up backlash."""
    if not any(np.any(found.rows.backlash_move) for found in stretches):
        return new
    return replace(new, shares=np.concatenate([_shares(found) for found in stretches]))


def _shares(found: Corrected) -> np.ndarray:
    """Return (rows,) the share of its motion's time for each row, NaN if all are equal. One degree counts as one millimetre."""
    rows, taken = found.rows, found.rows.backlash_move
    starts = np.append(True, rows.motion[1:] != rows.motion[:-1])[: len(taken)]
    shares = rows.fraction - np.where(starts, 0.0, np.roll(rows.fraction, 1))
    way = np.linalg.norm(np.diff(rows.printed, axis=0, prepend=rows.printed[:1]), axis=1)
    total = np.bincount(rows.motion, way)[rows.motion]
    shares[taken] = way[taken] / np.maximum(total[taken], found.pieces.increment[0])
    with_backlash = np.bincount(rows.motion, taken)[rows.motion] > 0
    return np.where(with_backlash, np.clip(shares, 1e-6, 1.0), np.nan)
