"""NC programs in three languages (ISO, Heidenhain plain language, APT), read and written without losing a byte."""

from __future__ import annotations

from pathlib import Path

from twin._common.bundled import find_program
from twin._common.errors import InputError
from twin._common.files import MAX_TEXT_BYTES, open_input, other_kind, read_bytes
from twin._common.resources import memory_bytes
from twin.nc.apt.dialect import Apt
from twin.nc.blocks import Program
from twin.nc.dialect import Dialect
from twin.nc.heidenhain.dialect import Heidenhain
from twin.nc.iso.dialect import Iso

LINE_BYTES = 2400
"""Memory that a line needs when a program is held as a whole: measured, five axes in a block, animated."""
DIALECTS: tuple[Dialect, ...] = (Iso(), Heidenhain(), Apt())


def dialect_for(path: Path, data: bytes | None = None) -> Dialect:
    """Return the language of a program by the suffix of its name.

    Args:
        path: the program's path.
        data: the program's bytes, if known: some suffixes are shared by several languages.

    Raises:
        InputError: an unknown suffix.
    """
    suffix = path.suffix.lower()
    for dialect in DIALECTS:
        if data is not None and suffix in dialect.shared_suffixes and dialect.begins.match(data[:200]):
            return dialect
    for dialect in DIALECTS:
        if suffix in dialect.suffixes:
            return dialect
    known = " ".join(suffix for dialect in DIALECTS for suffix in dialect.suffixes)
    kind = None if data is None else other_kind(data.decode("latin-1"), "an NC program")
    if kind is not None:
        expected = f"a program, whose name ends in one of {known}"
        raise InputError(f"{kind}, not an NC program", expected=expected, file=path)
    raise InputError(
        "unknown NC program type", expected=f"a file name ending in one of {known}", file=path, value=suffix
    )


def dialect_of(path: Path) -> Dialect:
    """Return the language of an existing program, by the suffix of its name and its first bytes.

    Raises:
        InputError: it cannot be read, or its suffix is unknown.
    """
    try:
        with open_input(path) as stream:
            return dialect_for(path, stream.read(4000))
    except OSError as error:
        raise InputError("cannot be read", expected="a readable file", file=path, value=error.strerror) from error


def _check_size(path: Path, needed: int) -> None:
    """Raise `InputError` for a program that needs more memory, in bytes, than this process can have."""
    most = memory_bytes()
    if needed > most:
        raise InputError(
            "the program is too large to be held in memory",
            expected=f"at most {most / LINE_BYTES:,.0f} lines with {most / 1e9:.1f} GB of memory; split it into several programs",
            file=path,
        )


def read_program(path: str | Path) -> tuple[Program, Dialect]:
    """Read a program from a file (or a sample that comes with twin) and return it with its language.

    Its subprograms, in the same file or folder, are written out in place of their calls.

    Raises:
        InputError: there is no such file, its suffix is unknown, it is empty or not text, it needs more memory than there is, or a
            subprogram cannot be written out.

    Examples:
        >>> program, dialect = twin.read_program("cone_frustum.nc")
        >>> dialect.name, len(program.texts)
        ('iso', 375)
    """
    source = find_program(path)
    data = read_bytes(source, most_bytes=MAX_TEXT_BYTES)
    _check_size(source, LINE_BYTES * (1 + max(data.count(b"\n"), data.count(b"\r"))))
    dialect = dialect_for(source, data)
    return dialect.expanded(dialect.read(data, str(source)), source.parent), dialect
