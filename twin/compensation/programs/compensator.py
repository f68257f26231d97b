"""Compensation of a whole program in memory, or from file to file.

The output is read back, compared with the intended positions and simulated before it is returned or its file appears.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import final

import numpy as np

from twin._common.arrays import read_only
from twin._common.bundled import find_program
from twin._common.files import atomic_file, tracked_files
from twin._common.resources import Progress, silent
from twin.compensation.programs.correction import Corrected
from twin.compensation.programs.motions import ToolPath
from twin.compensation.programs.parts import ProgramFile, ProgramInMemory, ProgramRun, ProgramSource
from twin.compensation.programs.prepared import Options, PreparedMachine
from twin.compensation.programs.report import Report
from twin.display.results import Display, DisplayedResult
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import dialect_of, dialect_to_write, read_program
from twin.nc.blocks import Interpretation, NewPositions, Program
from twin.nc.dialect import Dialect


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
        out = BytesIO()
        run = ProgramRun(
            self.prepared, ProgramInMemory(program, dialect), dialect if into is None else into, progress, reading
        )
        report = run.write(out)
        part, solved = run.last
        columns = [np.concatenate(column) for column in zip(*map(_columns, solved.stretches), strict=True)]
        text = out.getvalue().decode("latin-1")
        return Compensation(text, report, run.reader.reading, solved.new, part.path, *map(read_only, columns))

    def compensate_file(
        self, program: Path, output: Path, progress: Progress = silent, *, into: Dialect | None = None
    ) -> Report:
        """Compensate a program from file to file; the output is written atomically.

        It is processed in parts, so that memory does not grow with its length, except with backlash, conditions of every block, or
        subprograms (`twin.compensation.programs.parts`).

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
        with tracked_files() as files, atomic_file(output) as out:
            for path in self._inputs(program):
                files.add_input(path)
            source = self._source(program)
            return ProgramRun(self.prepared, source, source.dialect if into is None else into, progress).write(out)

    def _source(self, program: Path) -> ProgramSource:
        """Return a program in parts, or in memory if something needs the whole."""
        language, folders = self.prepared.options.language, self.prepared.options.subprograms
        if program.is_file() and not (self.prepared.backlash.axes or self.prepared.by_block):
            file = ProgramFile(program, dialect_of(program, language), folders)
            if not (file.calls and read_program(program, language, folders)[0].origins):
                return file
        return ProgramInMemory(*read_program(program, language, folders))

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
    read, dialect = read_program(program, chosen.language, chosen.subprograms)
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
    """Compensate the program of a file, or a sample program of twin, into another file, as `Compensator.compensate_file`.

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
    dialect = dialect_of(source, None if options is None else options.language)
    into = dialect_to_write(target, source, dialect) if dialect.cutter_locations else None
    return Compensator(machine, errors, options).compensate_file(source, target, progress, into=into)


def _columns(found: Corrected) -> tuple[np.ndarray, ...]:
    """Return the columns of `Compensation` for one section."""
    rows, columns = found.own, found.pieces.path.columns
    moves, lines = columns.move[rows.motion], found.lines[rows.motion]
    return rows.nominal, rows.exact, rows.commands, moves, lines, rows.backlash_move
