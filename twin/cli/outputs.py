"""Declares a command: every path it is given is an input unless it is marked as an `Output`, and no output may be an input.

Every number it is given has a size that arithmetic can bear, so that no command can overflow.

`command` replaces Typer's own decorator, so that no command can forget the check. Files that a command reads indirectly (the URDF a
machine file names, a default calibration) are noted by `twin._common.files` when they are read.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar, final, get_args, get_type_hints

import typer

from twin._common.errors import InputError
from twin._common.files import check_writable, command_files
from twin.cli.app import app
from twin.cli.options import usable_number

Function = TypeVar("Function", bound=Callable[..., None])


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
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the report as JSON."), ANY]


def command(*examples: str, name: str | None = None) -> Callable[[Function], Function]:
    """Register a command whose outputs are checked before it begins, and against everything it reads.

    Args:
        examples: calls to copy, for its help.
        name: the command's name; the function's if None.
    """

    def register(function: Function) -> Function:
        paths = path_parameters(function)

        @functools.wraps(function)
        def checked(*arguments: Any, **options: Any) -> None:
            given = inspect.signature(function).bind(*arguments, **options).arguments
            for parameter, value in given.items():
                if isinstance(value, float) and isfinite(
                    value
                ):  # the command says what else it wants than a finite number
                    usable_number(f"--{parameter.replace('_', '-')}", value, value)
            with command_files() as files:
                for path in _given(given, paths, outputs=False):
                    if path.exists():
                        files.add_input(path)
                check_writable([path for path in _given(given, paths, outputs=True) if not path.is_dir()])
                for parameter, mark in paths.items():
                    if mark is not None and given.get(parameter) is not None:
                        _check(given[parameter], mark)
                function(*arguments, **options)

        app.command(name, epilog="\n\n".join(("Examples:", *examples)))(checked)
        return function

    return register


def path_parameters(function: Callable[..., None]) -> dict[str, Output | None]:
    """Return the parameters that are paths, each with its mark; None for an input."""
    found = {}
    for name, hint in get_type_hints(function, include_extras=True).items():
        if Path in _parts(hint):
            found[name] = next((part for part in _parts(hint) if isinstance(part, Output)), None)
    return found


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
