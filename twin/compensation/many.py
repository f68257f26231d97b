"""Many programs compensated on many processes, into one folder: each output under its program's name, with its report beside it.

On this computer a worker reads and writes files itself, in memory that does not grow with the program. To a cluster programs travel as
data and come back as data: its workers need no file system of ours.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, final

from twin._common.errors import InputError, OutputError
from twin._common.files import check_writable, move_into_place, scratch_folder, write_json, write_whole
from twin.compensation.bench import Options
from twin.compensation.compensator import Compensator
from twin.compute.parallel import Workers, finished
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.nc import DIALECTS, find_program

TEXT: Final = ".report.txt"
JSON: Final = ".report.json"
"""Behind the program's name: its report, for a person and for a program."""

Verdict = Literal["done", "not met", "failed"]


@final
@dataclass(frozen=True)
class ProgramOutcome:
    """What became of one program.

    Attributes:
        program: as it was named.
        output: where it was written; None if it was not.
        summary: of its report, as in its JSON; empty if there is none.
        error: why there is none; a `twin._common.errors.OutputError` is a defect of `twin`.
        strict: whether ``done`` means that everything was corrected, rapids and the orientation, too.
    """

    program: Path
    output: Path | None
    summary: dict[str, Any]
    error: InputError | OutputError | None
    strict: bool = False

    @property
    def verdict(self) -> Verdict:
        """``not met``: written, and something could not be corrected, which its report lists."""
        if self.error is not None:
            return "failed"
        return "done" if self.summary["strictly_complete" if self.strict else "complete"] else "not met"

    @property
    def line(self) -> str:
        """What became of it, in a line."""
        if self.error is not None:
            return f"failed: {self.error}"
        before, after = self.summary["before"], self.summary["after"]
        told = f"{before['rms_um']:.2f} → {after['rms_um']:.2f} µm RMS, {before['max_um']:.2f} → {after['max_um']:.2f} µm max"
        return f"{self.summary['headline']} ({told})"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
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
class Order:
    """One program to compensate.

    Attributes:
        program: its path, on the computer that asks.
        output: where to write it, there.
        data: the program itself, for a worker that is elsewhere; None for one that reads and writes these files; an error if it
            cannot be read.
    """

    program: Path
    output: Path
    data: bytes | InputError | None


class ProgramAnswer(NamedTuple):
    """The report as text and as JSON, with the program where it travelled as data."""

    text: str
    report: dict[str, Any]
    data: bytes | None = None


@final
@dataclass(frozen=True)
class Shop:
    """What all programs share: machine, calibration and options."""

    machine: Machine
    calibration: Calibration
    options: Options

    def __getstate__(self) -> dict[str, Any]:
        """For a pickle: the attributes, not what was made of them here."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def compensator(self) -> Compensator:
        """Set up once a worker."""
        return Compensator(self.machine, self.calibration, self.options)

    def fill(self, order: Order) -> ProgramAnswer | InputError | OutputError:
        """One order; why a program cannot be compensated is an answer, so that it does not stop the others."""
        try:
            if isinstance(order.data, InputError):
                return order.data
            if order.data is not None:
                return self._elsewhere(order, order.data)
            report = self.compensator.compensate_file(order.program, order.output)
            return ProgramAnswer(report.to_text(), report.to_dict())
        except (InputError, OutputError) as error:
            return error

    def _elsewhere(self, order: Order, data: bytes) -> ProgramAnswer:
        with scratch_folder() as room:
            own, out = room / order.program.name, room / f"out.{order.program.name}"
            own.write_bytes(data)
            try:
                report = self.compensator.compensate_file(own, out)
            except InputError as error:
                if error.file != str(own):
                    raise
                raise InputError(
                    error.what, expected=error.expected, file=order.program, line=error.line, value=error.value
                ) from None
            except OutputError as error:
                raise OutputError(str(error).replace(str(own), str(order.program))) from None
            report = replace(report, program=str(order.program))
            return ProgramAnswer(report.to_text(), report.to_dict(), out.read_bytes())


def outputs(programs: Sequence[Path], folder: Path) -> dict[Path, Path]:
    """Where each program goes: under its own name into the folder.

    Raises:
        InputError: two programs of one name; the folder is the programs' own, no folder, or one that cannot be made or written.
    """
    program_suffixes = {suffix for dialect in DIALECTS for suffix in dialect.suffixes}
    if not folder.is_dir() and (folder.exists() or folder.suffix.lower() in program_suffixes):
        raise InputError("several programs into one file", expected="a folder", file=folder)
    if not folder.is_dir() and not folder.parent.is_dir():
        raise InputError("cannot be written", expected=f"an existing folder {folder.parent}", file=folder)
    found: dict[Path, Path] = {}
    for program in programs:
        if folder.resolve() == program.resolve().parent:
            raise InputError("the output is the program itself", expected="another folder", file=program)
        output = folder / program.name
        if output in found.values():
            raise InputError("two programs of the same name", expected="a name each", file=program)
        found[program] = output
    if folder.is_dir():
        check_writable([path for output in found.values() for path in _written(output)])
    return found


def _written(output: Path) -> tuple[Path, Path, Path]:
    return output, output.with_name(output.name + TEXT), output.with_name(output.name + JSON)


def compensate_files(
    programs: Sequence[Path],
    folder: Path,
    machine: Machine,
    calibration: Calibration,
    *,
    options: Options | None = None,
    workers: Workers | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Generator[ProgramOutcome, None, None]:
    """Compensate programs, each written as soon as it is done, whole or not at all; in the order in which they are done.

    Args:
        programs: paths, or names of programs that come with twin.
        folder: where to; made if it is not there.
        machine: the machine.
        calibration: its errors.
        options: what to do.
        workers: who does it; None for one process a core.
        progress: called with a stage and the fraction done.

    Raises:
        InputError: as `outputs`; machine, calibration and options do not fit each other; as `twin.compute.parallel.finished`. What
        is wrong
            with one program is in its `ProgramOutcome`.
    """
    say = progress or (lambda stage, fraction: None)
    own = Workers() if workers is None else workers
    shop = Shop(machine, calibration, Options() if options is None else options)
    _ = shop.compensator  # what is wrong with all of them is said once, before anything is written
    goals = outputs(programs, folder)
    made = not folder.is_dir()
    folder.mkdir(exist_ok=True)
    try:
        # In the same file system: what is done appears by renaming, and what is not goes with the room.
        with scratch_folder(folder) as room:
            there, goal_of = [], []
            for program, goal in goals.items():
                try:
                    there.append((find_program(program), room / goal.name))
                    goal_of.append((program, goal))
                except InputError as error:
                    yield ProgramOutcome(program, None, {}, error)
            orders = _Orders(there, travel=own.scheduler is not None)
            say("programs", 0.0)
            answers = finished(Shop.fill, shop, orders, own, name=lambda order: str(order.program), return_errors=True)
            with closing(answers):
                for count, (index, found) in enumerate(answers, 1):
                    program, goal = goal_of[index]
                    if isinstance(found, ProgramAnswer):
                        _keep(found, there[index][1], goal)
                        outcome = ProgramOutcome(program, goal, found.report, None)
                    else:  # a program that ends its worker stops the others as little as one that cannot be read
                        outcome = ProgramOutcome(program, None, {}, found)
                    say("programs", count / len(orders))
                    yield outcome
    finally:
        if made and not any(folder.iterdir()):
            folder.rmdir()


@final
class _Orders(Sequence[Order]):
    """Orders, of which those that travel are read when they are wanted: not all programs at once."""

    def __init__(self, there: Sequence[tuple[Path, Path]], *, travel: bool) -> None:
        self._there = there
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
        return Order(program, output, data)


def _keep(answer: ProgramAnswer, made: Path, goal: Path) -> None:
    """The reports first: where the program is, they are."""
    program, text, data = _written(goal)
    write_whole(text, answer.text)
    write_json(data, answer.report)
    if answer.data is not None:
        write_whole(program, answer.data)
        return
    try:
        move_into_place(made, program)
    except OSError as error:
        raise InputError("cannot be written", expected="a writable file", file=goal, value=error.strerror) from error
