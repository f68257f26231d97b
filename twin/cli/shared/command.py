"""The frame around every command: inputs and outputs are checked before it; what it found is written, printed and rated after it.

Every path that a command is given is an input unless it is marked as an `Output`, and no output may be an input. Every number that it
is given has a size that arithmetic can bear. `command` replaces Typer's own decorator, so that no command can forget this. Files that
a command reads indirectly (the URDF a machine file names, a default calibration) are noted by `twin._common.files` when they are read.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar, final, get_args, get_type_hints

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from twin._common.errors import InputError
from twin._common.files import check_writable, command_files, write_json
from twin.cli.shared.installation import NOT_ALL_MET
from twin.cli.shared.terminal import echo, tell_error
from twin.cli.shared.words import positive, usable_number

registered = typer.Typer()
"""Commands whose modules were imported; `twin.cli.commands.load` takes them from here."""


@final
@dataclass(frozen=True)
class Output:
    """Marks a path that a command writes.

    Attributes:
        suffixes: the endings its name may have; empty for any.
        folder: whether it may be a folder: what is written into it is checked when the names are known.
    """

    suffixes: tuple[str, ...] = ()
    folder: bool = False


HTML: Final = Output((".html", ".htm"))
CALIBRATION: Final = Output((".yaml", ".yml"))
TABLE: Final = Output((".csv",))
ANY: Final = Output()
POSITIVE: Final = "positive"
"""Marks a number that must be larger than zero."""
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the report as JSON."), ANY]


@final
@dataclass(frozen=True)
class CommandResult:
    """What a command found, for people and for programs.

    Attributes:
        text: for the standard output.
        report: gives what `--json` writes.
        met: whether all was met; exit status 3 if not.
        written: the line that names the files that were written, ``{}`` where they stand; empty for none.
        after: lines after that.
        errors: lines for the standard error.
        status: exit status where there are more than these two; that of ``met`` if None.
        show: prints what comes after the text, where that is more than text.
    """

    text: str
    report: Callable[[], Any]
    met: bool = True
    written: str = "\nwritten: {}"
    after: Sequence[str] = ()
    errors: Sequence[str] = ()
    status: int | None = None
    show: Callable[[], None] | None = None


Function = TypeVar("Function", bound=Callable[..., CommandResult | None])


def command(*examples: str, name: str | None = None) -> Callable[[Function], Function]:
    """Register a command: its inputs, outputs and numbers are checked before it begins, its account is given when it is done.

    Args:
        examples: calls to copy, for its help.
        name: the command's name; the function's if None.
    """

    def register(function: Function) -> Function:
        hints = {key: list(_parts(hint)) for key, hint in get_type_hints(function, include_extras=True).items()}
        paths = path_parameters(function)

        @functools.wraps(function)
        def framed(*arguments: Any, **options: Any) -> None:
            given = inspect.signature(function).bind(*arguments, **options).arguments
            for parameter, value in given.items():
                option = f"--{parameter.replace('_', '-')}"
                if isinstance(value, float) and isfinite(value):  # the command says what else it wants
                    usable_number(option, value, value)
                if value is not None and POSITIVE in hints[parameter]:
                    positive(option, value)
            outputs = _given(given, paths, outputs=True)
            with command_files() as files:
                for path in _given(given, paths, outputs=False):
                    if path.exists():
                        files.add_input(path)
                check_writable([path for path in outputs if not path.is_dir()])
                for parameter, mark in paths.items():
                    if mark is not None and given.get(parameter) is not None:
                        _check(given[parameter], mark)
                account = function(*arguments, **options)
                if account is not None:
                    _give(account, outputs, given.get("json_file"))

        registered.command(name, epilog="\n\n".join(("Examples:", *examples)))(framed)
        return function

    return register


def path_parameters(function: Callable[..., Any]) -> dict[str, Output | None]:
    """Return the parameters that are paths, each with its mark; None for an input."""
    found = {}
    for name, hint in get_type_hints(function, include_extras=True).items():
        if Path in _parts(hint):
            found[name] = next((part for part in _parts(hint) if isinstance(part, Output)), None)
    return found


@contextmanager
def progress() -> Iterator[Any]:
    """One line on stderr while it lasts; nothing where stderr is not a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:  # a disabled `Progress` of rich before 14.1 writes an empty line
        yield lambda stage, fraction: None
        return
    columns = (
        TextColumn("{task.description:>10}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)


def _give(account: CommandResult, outputs: Sequence[Path], json_file: Path | None) -> None:
    """Write the JSON, print the rest, and end with the account's exit status."""
    if json_file is not None:
        write_json(json_file, account.report())
    echo(account.text, end="")
    if account.show is not None:
        account.show()
    if outputs and account.written:
        echo(account.written.format(", ".join(map(str, outputs))))
    for line in account.after:
        echo(line)
    for line in account.errors:
        tell_error(line)
    status = account.status if account.status is not None else 0 if account.met else NOT_ALL_MET
    if status:
        raise typer.Exit(status)


def _parts(hint: Any) -> Iterator[Any]:
    """The type and everything it is made of."""
    yield hint
    for part in get_args(hint):
        yield from _parts(part)


def _given(given: Mapping[str, Any], paths: Mapping[str, Output | None], *, outputs: bool) -> list[Path]:
    found = []
    for name, mark in paths.items():
        value = given.get(name)
        if value is not None and (mark is not None) is outputs:
            found += [value] if isinstance(value, Path) else list(value)
    return found


def _check(path: Path, mark: Output) -> None:
    if path.is_dir() and not mark.folder:
        raise InputError("cannot be written", expected="a file, not a folder", file=path)
    if mark.suffixes and path.suffix.lower() not in mark.suffixes:
        raise InputError(
            "the output's name does not fit what is written",
            expected=f"a name ending in {' or '.join(mark.suffixes)}",
            file=path,
        )
