"""Compensation of a program in memory, from file to file, or of many programs in parallel processes into one folder.

The output is read back, compared with the intended positions and simulated before it is returned or its file appears. A worker on this
computer reads and writes files itself, in memory that does not grow with the program. To the workers of a cluster, programs are sent as
data and returned as data, so that no shared file system is needed.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.bundled import find_program
from twin._common.errors import InputError, OutputError
from twin._common.files import (
    atomic_file,
    check_writable,
    move_into_place,
    scratch_folder,
    tracked_files,
    write_atomic,
    write_json,
)
from twin._common.resources import Progress, silent
from twin.compensation.programs.correction import Corrected
from twin.compensation.programs.motions import ToolPath
from twin.compensation.programs.parts import ProgramFile, ProgramInMemory, ProgramRun, ProgramSource
from twin.compensation.programs.prepared import Options, PreparedMachine
from twin.compensation.programs.report import Report
from twin.compute.native.compiler import equal_portions
from twin.compute.parallel import Workers, map_as_completed
from twin.display.results import Display, DisplayedResult, Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS, dialect_of, dialect_to_write, read_program
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
    errors = Calibration.given(machine, calibration)
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
    errors = Calibration.given(machine, calibration)
    source, target = find_program(program), Path(output)
    dialect = dialect_of(source, None if options is None else options.language)
    into = dialect_to_write(target, source, dialect) if dialect.cutter_locations else None
    return Compensator(machine, errors, options).compensate_file(source, target, progress, into=into)


def _columns(found: Corrected) -> tuple[np.ndarray, ...]:
    """Return the columns of `Compensation` for one section."""
    rows, columns = found.own, found.pieces.path.columns
    moves, lines = columns.move[rows.motion], found.lines[rows.motion]
    return rows.nominal, rows.exact, rows.commands, moves, lines, rows.backlash_move


# --- Many programs into one folder ----------------------------------------------------------------

TEXT_SUFFIX: Final = ".report.txt"
JSON_SUFFIX: Final = ".report.json"
"""Suffixes of the reports after the program's name: text and JSON."""

Verdict = Literal["done", "not met", "failed"]


@final
@dataclass(frozen=True, repr=False)
class ProgramOutcome(Result):
    """Result of compensating one program.

    Attributes:
        program: its path as given.
        output: where it was written; None if it was not.
        summary: its JSON report; empty if there is none.
        error: why it was not written; None if it was. A `twin._common.errors.OutputError` is a defect of `twin`.
        strict: whether ``done`` requires that everything was corrected, rapids and the orientation included.
    """

    program: Path
    output: Path | None
    summary: dict[str, Any]
    error: InputError | OutputError | None
    strict: bool = False

    @property
    def verdict(self) -> Verdict:
        """``done``; ``not met``: written, but its report lists something that could not be corrected; ``failed``: not written."""
        if self.error is not None:
            return "failed"
        return "done" if self.summary["strictly_complete" if self.strict else "complete"] else "not met"

    @property
    def brief(self) -> str:
        """Summary in one line."""
        if self.error is not None:
            return f"failed: {self.error}"
        before, after = self.summary["before"], self.summary["after"]
        change = f"{before['rms_um']:.2f} → {after['rms_um']:.2f} µm RMS, {before['max_um']:.2f} → {after['max_um']:.2f} µm max"
        return f"{self.summary['headline']} ({change})"

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON report."""
        shown = ("lines", "moves", "rewritten", "split", "added", "before", "after", "headline", "warnings")
        return {
            "program": str(self.program),
            "output": None if self.output is None else str(self.output),
            "verdict": self.verdict,
            "error": None if self.error is None else str(self.error),
            **{name: self.summary[name] for name in shown if name in self.summary},
        }


@final
@dataclass(frozen=True)
class ProgramTask:
    """One program to compensate."""

    program: Path  # its path on the requesting computer
    output: Path  # where to write it there
    # the program's content for a worker on another computer; None for a worker that reads and writes these files itself; an error if
    # the program cannot be read
    data: bytes | InputError | None


class ProgramAnswer(NamedTuple):
    """Report as text and as JSON, and the compensated program if it was sent as data."""

    text: str
    report: dict[str, Any]
    data: bytes | None = None


@final
@dataclass(frozen=True)
class ProgramCompensator:
    """Machine, calibration and options common to all programs."""

    machine: Machine  # machine, calibration, options: see `Compensator`
    calibration: Calibration
    options: Options
    programs: int  # number of programs: many short ones are worth compiled code as one long program is

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle: the attributes without cached objects."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def compensator(self) -> Compensator:
        """Compensator, created once per worker."""
        return Compensator(self.machine, self.calibration, self.options)

    def compensate(self, task: ProgramTask) -> ProgramAnswer | InputError | OutputError:
        """Compensate one program; an error is returned rather than raised, so that it does not stop the others."""
        try:
            if isinstance(task.data, InputError):
                return task.data
            with equal_portions(self.programs):
                if task.data is not None:
                    return self._elsewhere(task, task.data)
                report = self.compensator.compensate_file(task.program, task.output)
                return ProgramAnswer(report.to_text(), report.to_dict())
        except (InputError, OutputError) as error:
            return error

    def _elsewhere(self, task: ProgramTask, data: bytes) -> ProgramAnswer:
        with scratch_folder() as scratch:
            own, out = scratch / task.program.name, scratch / f"out.{task.program.name}"
            own.write_bytes(data)
            try:
                report = self.compensator.compensate_file(own, out)
            except InputError as error:
                if error.file != str(own):
                    raise
                raise InputError(
                    error.what, expected=error.expected, file=task.program, line=error.line, value=error.value
                ) from None
            except OutputError as error:
                raise OutputError(str(error).replace(str(own), str(task.program))) from None
            report = replace(report, program=str(task.program))
            return ProgramAnswer(report.to_text(), report.to_dict(), out.read_bytes())


def outputs(programs: Sequence[Path], folder: Path) -> dict[Path, Path]:
    """Return the output path of each program; `InputError` if two names are alike, or the folder is not for outputs."""
    program_suffixes = {suffix for dialect in DIALECTS for suffix in dialect.suffixes}
    if not folder.is_dir() and (folder.exists() or folder.suffix.lower() in program_suffixes):
        raise InputError("several programs cannot be written to one file", expected="a folder", file=folder)
    if not folder.is_dir() and not folder.parent.is_dir():
        expected = f"an existing folder: create {folder.parent} first"
        raise InputError("cannot be written: its folder does not exist", expected=expected, file=folder)
    outputs: dict[Path, Path] = {}
    for program in programs:
        if folder.resolve() == program.resolve().parent:
            raise InputError("the output would overwrite the program", expected="another folder", file=program)
        output = folder / program.name
        if output in outputs.values():
            raise InputError("two programs have the same file name", expected="different file names", file=program)
        outputs[program] = output
    if folder.is_dir():
        check_writable([path for output in outputs.values() for path in _written(output)])
    return outputs


def _written(output: Path) -> tuple[Path, Path, Path]:
    return output, output.with_name(output.name + TEXT_SUFFIX), output.with_name(output.name + JSON_SUFFIX)


def compensate_files(
    programs: Sequence[str | Path],
    folder: str | Path,
    machine: Machine,
    calibration: Calibration,
    *,
    options: Options | None = None,
    workers: Workers | None = None,
    progress: Progress = silent,
) -> Generator[ProgramOutcome, None, None]:
    """Compensate programs; write each atomically and yield its outcome as soon as it is done.

    Args:
        programs: paths, or names of sample programs of twin.
        folder: output folder; created if it does not exist.
        machine: the machine.
        calibration: its errors.
        options: the options; defaults if None.
        workers: workers to use; None for one process per core.
        progress: called with a stage and the fraction done.

    Raises:
        InputError: as for `outputs` and `map_as_completed`; machine, calibration and options do not fit each other. An
            error in one program is in its `ProgramOutcome`.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> calibration, options = twin.Calibration.default(machine), twin.Options(tool_length_mm=120)
        >>> programs, one = ["cone_frustum.nc", "cone_frustum.h"], twin.Workers(1)
        >>> outcomes = twin.compensate_files(programs, "compensated", machine, calibration, options=options, workers=one)
        >>> [(outcome.output.name, outcome.verdict) for outcome in outcomes]
        [('cone_frustum.nc', 'done'), ('cone_frustum.h', 'done')]
    """
    own = Workers() if workers is None else workers
    worker = ProgramCompensator(machine, calibration, Options() if options is None else options, len(programs))
    _ = worker.compensator  # an error common to all programs is raised once, before anything is written
    targets, folder = outputs([Path(program) for program in programs], Path(folder)), Path(folder)
    made = not folder.is_dir()
    folder.mkdir(exist_ok=True)
    try:
        # In the same file system, so that finished outputs are renamed into place and unfinished ones vanish with the scratch folder.
        with scratch_folder(folder) as scratch:
            files, targets_of = [], []
            for program, target in targets.items():
                try:
                    files.append((find_program(program), scratch / target.name))
                    targets_of.append((program, target))
                except InputError as error:
                    yield ProgramOutcome(program, None, {}, error)
            tasks = _ProgramTasks(files, travel=own.scheduler is not None)
            progress("programs", 0.0)
            answers = map_as_completed(
                ProgramCompensator.compensate, worker, tasks, own, name=lambda one: str(one.program), return_errors=True
            )
            with closing(answers):
                for count, (index, found) in enumerate(answers, 1):
                    program, target = targets_of[index]
                    if isinstance(found, ProgramAnswer):
                        _keep(found, files[index][1], target)
                        outcome = ProgramOutcome(program, target, found.report, None)
                    else:  # an error in one program, even one that ends its worker, does not stop the others
                        outcome = ProgramOutcome(program, None, {}, found)
                    progress("programs", count / len(tasks))
                    yield outcome
    finally:
        if made and not any(folder.iterdir()):
            folder.rmdir()


@final
class _ProgramTasks(Sequence[ProgramTask]):
    """Sequence of orders; programs to be sent are read only when their order is requested, not all at once."""

    def __init__(self, files: Sequence[tuple[Path, Path]], *, travel: bool) -> None:
        self._there = files
        self._travel = travel

    def __len__(self) -> int:
        return len(self._there)

    def __getitem__(self, index: Any) -> Any:
        program, output = self._there[index]
        data: bytes | InputError | None = None
        try:
            data = program.read_bytes() if self._travel else None
        except OSError as error:
            data = InputError("cannot be read", expected="a readable file", file=program, value=error.strerror)
        return ProgramTask(program, output, data)


def _keep(answer: ProgramAnswer, made: Path, target: Path) -> None:
    """Write the reports, then the program: wherever a program exists, its reports do too."""
    program, text, data = _written(target)
    write_atomic(text, answer.text)
    write_json(data, answer.report)
    if answer.data is not None:
        write_atomic(program, answer.data)
        return
    try:
        move_into_place(made, program)
    except OSError as error:
        raise InputError("cannot be written", expected="a writable file", file=target, value=error.strerror) from error
