"""Subprograms written out in place of their calls, with the origin of every line."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple, final

from twin._common.errors import InputError
from twin._common.files import read_bytes, register_input
from twin.nc.blocks import Origin, Program, lines_in
from twin.nc.text import ending

DEEPEST: Final = 10
"""Most calls within calls; a subprogram that calls itself exceeds it."""
MOST_LINES: Final = 2_000_000
"""Most lines of a program with its subprograms written out."""


class Line(NamedTuple):
    """A line of a program or subprogram, with its file and number."""

    text: str
    file: str
    number: int


@final
@dataclass(frozen=True)
class Call:
    """A call found in a line.

    Attributes:
        name: the subprogram.
        repeats: how often it runs.
        values: what replaces its parameters: the text of each value by the parameter's name, in capitals.
        outside: whether it can only be a file of its own.
        certain: whether the line is a call even if there is no such subprogram.
    """

    name: str
    repeats: int = 1
    values: Sequence[str] = ()
    outside: bool = False
    certain: bool = True


class Inliner(ABC):
    """Writes out the subprograms of one language.

    Args:
        program: the main program.
        folders: where its subprograms may be, in the order of search; none if it is not a file.
    """

    def __init__(self, program: Program, folders: Sequence[Path]) -> None:
        self.program = program
        self.folders = tuple(folders)
        self._count = 0
        self._found = False
        self._files: dict[Path, list[Line]] = {}

    @cached_property
    def lines(self) -> list[Line]:
        """The lines of the program."""
        return [Line(text, self.program.source, i) for i, text in enumerate(self.program.texts, 1)]

    @abstractmethod
    def likely(self, text: str) -> bool:
        """Return whether a line may be a call; quick, True for every call and few other lines."""

    @abstractmethod
    def likely_within(self, text: str) -> bool:
        """Return whether a line of a text may be a call; quicker than line by line, True if `likely` is for one of them."""

    @abstractmethod
    def call(self, line: Line) -> Call | None:
        """Return the call in a line, None if it has none.

        Raises:
            InputError: a call that cannot be written out.
        """

    def calls(self, line: Line) -> bool:
        """Return whether a line calls a subprogram, also one that is missing or cannot be written out."""
        try:
            call = self.call(line)
            return call is not None and (call.certain or self.body(call, line) is not None)
        except InputError:
            return True

    @abstractmethod
    def body(self, call: Call, line: Line) -> list[Line] | None:
        """Return the lines of a subprogram with the values of its parameters; None if there is no such subprogram.

        Raises:
            InputError: it cannot be written out.
        """

    @abstractmethod
    def main(self) -> list[Line]:
        """Return the lines that the control executes, in order, where calls stand for their subprograms."""

    @abstractmethod
    def comment(self, text: str) -> str:
        """Return a text as a comment."""

    def expanded(self) -> Program:
        """Return the program with its calls written out; the program itself if it has none.

        Raises:
            InputError: a call that cannot be written out, with its file and line.
        """
        if not self.likely_within(self.program.text):
            return self.program
        likely = [i for i, text in enumerate(self.program.texts) if self.likely(text)]
        if not any(self.call(self.lines[i]) for i in likely):
            return self.program
        lines: list[tuple[str, Origin]] = []
        for line in self.main():
            lines += ((one.text, Origin(one.file, one.number, line.number)) for one in self._written(line, 0))
        if not self._found:
            return self.program
        origins = tuple(
            replace(origin, main=origin.line) if origin.file == self.program.source else origin for _, origin in lines
        )
        return replace(self.program, texts=tuple(text for text, _ in lines), origins=origins)

    def _written(self, line: Line, depth: int) -> Iterator[Line]:
        """Yield a line, or the lines of the subprogram that it calls."""
        self._count += 1
        if self._count > MOST_LINES:
            raise refused("the program is too long with its subprograms", f"at most {MOST_LINES:,} lines", line)
        call = self.call(line)
        body = None if call is None else self.body(call, line)
        if call is None or body is None:
            if call is not None and call.certain:
                where = " or in ".join(["this file", *map(str, self.folders)])
                raise refused(f"no subprogram {call.name}", f"it in {where}", line)
            yield line
            return
        if depth >= DEEPEST:
            raise refused("subprograms call each other too deeply", f"at most {DEEPEST} levels", line)
        self._found = True
        yield line._replace(text=self.comment(line.text))
        for _ in range(call.repeats if body else 0):
            for one in body:
                yield from self._written(one, depth + 1)

    def read_file(self, path: Path) -> list[Line]:
        """Return the lines of another file, which is read once."""
        if path not in self._files:
            register_input(path)
            self._files[path] = [Line(text, str(path), i) for i, text in enumerate(lines_in(read_bytes(path)), 1)]
        return self._files[path]

    def file_named(self, *names: str) -> Path | None:
        """Return the file of the first folder that has one of these names, whatever its capitals; None if there is none.

        Raises:
            InputError: a folder cannot be searched.
        """
        for folder in self.folders:
            try:
                files = {path.name.upper(): path for path in sorted(folder.iterdir()) if path.is_file()}
            except OSError as error:
                expected = "a folder with subprograms"
                raise InputError(
                    "cannot be searched", expected=expected, file=folder, value=error.strerror, setting="subprograms"
                ) from None
            found = next((files[name.upper()] for name in names if name.upper() in files), None)
            if found is not None:
                return found
        return None


@contextmanager
def errors_in_files(program: Program) -> Iterator[None]:
    """Let an `InputError` at a line of a program name the file and line that this line is from."""
    try:
        yield
    except InputError as error:
        if not program.origins or error.file != program.source or error.line is None:
            raise
        origin = program.origins[error.line - 1]
        raise InputError(
            error.what,
            expected=error.expected,
            file=origin.file,
            line=origin.line,
            value=error.value,
            nearest=error.nearest,
            setting=error.setting,
        ) from None


def refused(what: str, expected: str, line: Line) -> InputError:
    """Return the error at a line."""
    return InputError(what, expected=expected, file=line.file, line=line.number, value=line.text.strip())


def with_ending(text: str, like: str) -> str:
    """Return a text with the line ending of a line."""
    return text.rstrip("\r\n") + (ending(like) or "\n")
