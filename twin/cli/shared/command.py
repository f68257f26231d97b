"""The `command` decorator: check inputs and outputs, run the command, write and print its result, set the exit status.

Every path parameter of a command is an input unless it is marked as an `Output`; no output may be an input. Every number must be of a
magnitude that can be computed with. `command` replaces Typer's own decorator, so that no command can omit these checks. Files that a
command reads indirectly (the URDF that a machine file names, a default calibration) are recorded by `twin._common.files` when read.
"""

from __future__ import annotations

import functools
import inspect
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Final, TypeVar, final, get_args, get_type_hints

import typer

from twin._common.bundled import bundled_folder, find_bundled, find_program
from twin._common.errors import InputError, closest_name, did_you_mean
from twin._common.families import Language
from twin._common.files import check_writable, names_beside, read_bytes, tracked_files, write_json
from twin._common.messages import say, translated
from twin.cli.shared.complete import ListingCommand
from twin.cli.shared.installation import NOT_ALL_MET
from twin.cli.shared.terminal import echo, is_silenced, positive, print_error, silenced, usable_number
from twin.samples import PLANS

HELP: Final = {"help_option_names": ["-h", "--help"]}
"""Options that show the help of a command."""
registered = typer.Typer()
"""Commands whose modules were imported; `twin.cli.commands.load` takes them from here."""


@final
@dataclass(frozen=True)
class Output:
    """Marker of a path parameter that the command writes."""

    suffixes: tuple[str, ...] = ()  # permitted suffixes of the file name; empty for any
    folder: bool = False  # whether the path may be a folder; the files in it are checked once their names are known


HTML: Final = Output((".html", ".htm"))
CALIBRATION: Final = Output((".yaml", ".yml"))
TABLE: Final = Output((".csv",))
URDF: Final = Output((".urdf", ".xml"))
XML: Final = Output((".xml",))
ANY: Final = Output()
EXISTING: Final = "existing"
"""Marker of the path of a file that must exist, unless it is the bare name of one that comes with twin."""
PROGRAM: Final = "program"
"""Marker of the path of an NC program: as `EXISTING`, with the error of a program."""
MACHINE: Final = "machine"
"""Marker of the machine's name: it is looked up before the command imports what it needs."""
POSITIVE: Final = "positive"
"""Marker of a number that must be positive."""
QuietOption = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result as JSON to this file."), ANY]


@final
@dataclass(frozen=True)
class CommandResult:
    """Result of a command, as text and as JSON."""

    text: str  # printed to standard output
    report: Callable[[], Any]  # returns the content of the `--json` file
    met: bool = True  # whether all requirements were met; exit status 3 if not
    written: str | None = ""  # text after the files' names in the line "written: …"; None for no line
    files: Sequence[Path] = ()  # files in that line, if they are not the outputs that were named
    after: Sequence[str] = ()  # lines printed after that line
    errors: Sequence[str] = ()  # lines printed to standard error
    status: int | None = None  # exit status, if not the one that follows from ``met``; None otherwise
    show: Callable[[], None] | None = None  # prints further output after the text, such as tables
    check_json: Callable[[Path], object] | None = None  # reads the JSON before it is in place


Function = TypeVar("Function", bound=Callable[..., CommandResult | None])


def command(*examples: str, name: str | None = None) -> Callable[[Function], Function]:  # noqa: C901
    """Register a command, with examples for its help, whose inputs, outputs and numbers are checked, and whose result is reported."""

    def register(function: Function) -> Function:  # noqa: C901
        hints = {key: list(_nested_types(hint)) for key, hint in get_type_hints(function, include_extras=True).items()}
        paths = path_parameters(function)

        @functools.wraps(function)
        def checked(*arguments: Any, quiet: bool = False, **options: Any) -> None:
            with silenced() if quiet else nullcontext():
                run(*arguments, **options)

        def run(*arguments: Any, **options: Any) -> None:
            values = inspect.signature(function).bind(*arguments, **options).arguments
            _check_numbers(values, hints)
            outputs = _selected_paths(values, paths, outputs=True)
            with tracked_files() as files:
                for parameter, mark in paths.items():
                    inputs = _selected_paths(values, {parameter: mark}, outputs=False)
                    marks = {one for one in hints[parameter] if isinstance(one, str)}
                    for path in inputs:
                        if path.exists():
                            files.add_input(path)
                        elif len(inputs) == 1 and {EXISTING, PROGRAM} & marks and not _is_bundled(path):
                            # Before the command imports what it needs: such an error is usually a misspelt name.
                            _refuse_missing(path, program=PROGRAM in marks)
                check_writable([path for path in outputs if not path.is_dir()])
                for parameter, mark in paths.items():
                    if mark is not None and values.get(parameter) is not None:
                        _check_output(values[parameter], mark)
                for parameter in (value for value in values if MACHINE in hints[value]):
                    find_bundled(values[parameter], ".yaml", "a machine file")
                with _in_language(values.get("lang")):
                    result = function(*arguments, **options)
                    if result is not None:
                        _report(result, outputs, values.get("json_file"))

        _add_option(checked, "quiet", QuietOption)
        epilog = "\n\n".join(("Examples:", *examples))
        registered.command(name, cls=ListingCommand, epilog=epilog, context_settings=HELP)(checked)
        return function

    return register


def _add_option(function: Callable[..., Any], name: str, option: Any) -> None:
    """Give a function one more parameter, a flag, for Typer, which reads signature and annotations."""
    hints = get_type_hints(function, include_extras=True)
    own = inspect.signature(function)
    flag = inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=option)
    known = [parameter.replace(annotation=hints[key]) for key, parameter in own.parameters.items()]
    function.__signature__ = own.replace(parameters=[*known, flag])  # type: ignore[attr-defined]
    function.__annotations__ = {**hints, name: option}


def path_parameters(function: Callable[..., Any]) -> dict[str, Output | None]:
    """Return the path parameters of a command, each with its `Output` marker, or None if it is an input."""
    parameters = {}
    for name, hint in get_type_hints(function, include_extras=True).items():
        if Path in _nested_types(hint):
            parameters[name] = next((part for part in _nested_types(hint) if isinstance(part, Output)), None)
    return parameters


@contextmanager
def progress_bar() -> Iterator[Any]:
    """Show a progress bar on stderr; show nothing if stderr is not a terminal."""
    if not sys.stderr.isatty() or is_silenced():  # a disabled `Progress` of rich before 14.1 writes an empty line
        yield lambda stage, fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:>10}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage, completed=fraction)


def _report(result: CommandResult, outputs: Sequence[Path], json_file: Path | None) -> None:
    if json_file is not None:
        write_json(json_file, result.report(), check=result.check_json)
    echo(say(result.text), end="")
    if result.show is not None:
        result.show()
    if (files := result.files or outputs) and result.written is not None:
        line = say("written: {files}", files=", ".join(map(str, files))) + say(result.written)
        echo(f"\n{line}" if result.text else line)
    for line in result.after:
        echo(say(line))
    for line in result.errors:
        print_error(line)
    status = result.status if result.status is not None else 0 if result.met else NOT_ALL_MET
    if status:
        raise typer.Exit(status)


@contextmanager
def _in_language(language: Language | None) -> Iterator[None]:
    """Print in a language (``--lang``) inside the context; None for English."""
    if language in (None, Language.en):
        yield
        return
    from twin.display.sheet import translation_of

    with translated(translation_of(Language(language))):
        yield


def _check_numbers(values: Mapping[str, Any], hints: Mapping[str, list[Any]]) -> None:
    for parameter, value in values.items():
        option = f"--{parameter.replace('_', '-')}"
        if isinstance(value, float) and isfinite(value):  # the command itself checks the rest
            usable_number(option, value, value)
        if value is not None and POSITIVE in hints[parameter]:
            positive(option, value)


def _is_bundled(path: Path) -> bool:
    """Return whether the path is the bare name of a file that comes with twin."""
    samples = PLANS[0].parent
    return path.parent == Path() and any((folder / path.name).is_file() for folder in (samples, bundled_folder()))


def _refuse_missing(path: Path, *, program: bool) -> None:
    """Raise the `InputError` of an input that does not exist, with the most similar name of its folder or of the bundled files."""
    if program:
        find_program(path)
    bundled = [] if path.parent != Path() else [*names_beside(PLANS[0]), *names_beside(bundled_folder() / path)]
    names = [name for name in (*names_beside(path), *bundled) if Path(name).suffix == path.suffix]
    try:
        read_bytes(path)
    except InputError as error:
        raise InputError(
            error.what, expected=error.expected, file=path, value=error.value, nearest=closest_name(path.name, names)
        ) from None


def _nested_types(hint: Any) -> Iterator[Any]:
    """Yield a type hint and all its nested type arguments."""
    yield hint
    for part in get_args(hint):
        yield from _nested_types(part)


def _selected_paths(values: Mapping[str, Any], paths: Mapping[str, Output | None], *, outputs: bool) -> list[Path]:
    selected = []
    for name, mark in paths.items():
        value = values.get(name)
        if value is not None and (mark is not None) is outputs:
            selected += [value] if isinstance(value, Path) else list(value)
    return selected


def _check_output(path: Path, mark: Output) -> None:
    if path.is_dir() and not mark.folder:
        raise InputError("cannot be written", expected="a file, not a folder", file=path)
    if mark.suffixes and path.suffix.lower() not in mark.suffixes:
        raise InputError(
            "wrong suffix of the output file", expected=f"a name ending in {' or '.join(mark.suffixes)}", file=path
        )


# --- Handle SIGTERM and SIGHUP like Ctrl-C: remove temporary files and stop child processes -------

NAMES: Final = ("SIGTERM", "SIGHUP")


@final
class Received:
    """The signal that ended the command, if one did."""

    def __init__(self) -> None:
        self.number: int | None = None

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt on the first signal; ignore later ones, so that the clean-up completes."""
        if self.number is None:
            self.number = number
            raise KeyboardInterrupt

    @property
    def status(self) -> int:
        """Exit status of an interrupted command: 128 plus the signal's number; that of SIGINT if none was received."""
        return 128 + (signal.SIGINT if self.number is None else self.number)

    @property
    def reason(self) -> str:
        """Reason for the end of the command, in a few words."""
        return "interrupted" if self.number is None else f"ended by {signal.Signals(self.number).name}"


@contextmanager
def as_interrupt() -> Iterator[Received]:
    """Turn the signals into KeyboardInterrupt inside the context; a signal that is ignored, as under nohup, stays ignored."""
    received = Received()
    before = {}
    if threading.current_thread() is threading.main_thread():
        for name in NAMES:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, received.interrupt)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# --- Usage errors in one line: the offending text, the nearest valid name, and the help to consult

# Not every version of typer exports the parser's exception classes; this is their common base.
UsageError: type[Exception] = typer.BadParameter.__mro__[1]


def usage_message(error: Any) -> str:
    """Return the message of a `UsageError`, in one line."""
    context = getattr(error, "ctx", None)
    path = "twin" if context is None else str(context.command_path)
    example = _example(context) if type(error).__name__ == "MissingParameter" else None
    if example is not None:
        return f"{_message(error, context)}; expected, for example, `{example}` (all options: {path} --help)"
    return f"{_message(error, context)}; expected what `{path} --help` lists"


def help_text(error: Any) -> str | None:
    """Return the help text if the command line was empty; None otherwise."""
    if type(error).__name__ != "NoArgsIsHelpError":
        return None
    return str(error.ctx.get_help())


def _example(context: Any) -> str | None:
    """Return the first example of a command's help; None if it has none."""
    examples = [
        line for line in (getattr(context.command, "epilog", None) or "").splitlines() if line.startswith("twin ")
    ]
    return examples[0] if examples else None


def _message(error: Any, context: Any) -> str:
    text = " ".join(str(error.format_message()).split()).rstrip(".")
    option = getattr(error, "option_name", None)
    if option is not None and context is not None and type(error).__name__ == "NoSuchOption":
        known = [name for param in context.command.params for name in (*param.opts, *param.secondary_opts)]
        return f"no such option: {option!r}{did_you_mean(option, [name for name in known if name.startswith('-')])}"
    command = re.search(r"No such command '([^']*)'", text)
    if command is not None and context is not None:
        known = context.command.list_commands(context)
        return f"no such command: {command[1]!r}{did_you_mean(command[1], known)}"
    choice = re.search(r"'([^']*)' is not one of (.*)$", text)
    if choice is not None:
        known = re.findall(r"'([^']*)'", choice[2])
        text = text.replace("Value error, ", "") + did_you_mean(choice[1], known)
    return text[0].lower() + text[1:] if text else "cannot be used"
