"""Compensation of many programs in parallel processes into one folder, each under its own name with its report.

A worker on this computer reads and writes files itself, in memory that does not grow with the program. To the workers of a cluster,
programs are sent as data and returned as data, so that no shared file system is needed.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, final

from twin._common.bundled import find_program
from twin._common.errors import InputError, OutputError
from twin._common.files import check_writable, move_into_place, scratch_folder, write_atomic, write_json
from twin._common.resources import Progress, silent
from twin.compensation.programs.compensator import Compensator
from twin.compensation.programs.prepared import Options
from twin.compute.native.compiler import equal_portions
from twin.compute.parallel import Workers, map_as_completed
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS

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
    """One program to compensate.

    Attributes:
        program: its path on the requesting computer.
        output: where to write it there.
        data: the program's content for a worker on another computer; None for a worker that reads and writes these files itself; an
            error if the program cannot be read.
    """

    program: Path
    output: Path
    data: bytes | InputError | None


class ProgramAnswer(NamedTuple):
    """Report as text and as JSON, and the compensated program if it was sent as data."""

    text: str
    report: dict[str, Any]
    data: bytes | None = None


@final
@dataclass(frozen=True)
class ProgramCompensator:
    """Machine, calibration and options common to all programs.

    Attributes:
        machine, calibration, options: see `Compensator`.
        programs: number of programs: many short ones are worth compiled code as one long program is.
    """

    machine: Machine
    calibration: Calibration
    options: Options
    programs: int

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
    """Return the output path of each program: its own name in the folder.

    Raises:
        InputError: two programs have the same name; the folder contains the programs themselves, is a file, or cannot be made or
            written.
    """
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
