"""NC programs in three languages (ISO, Heidenhain plain language, APT), read and written without losing a byte."""

from __future__ import annotations

from collections.abc import Sequence
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
HEAD_BYTES = 1 << 16
"""Bytes at the beginning of a program from which its language is recognised."""
DIALECTS: tuple[Dialect, ...] = (Iso(), Heidenhain(), Apt())


def dialect_for(path: Path, data: bytes | None = None, language: str | None = None) -> Dialect:
    """Return the language of a program: as given, else by its content, else by the suffix of its name.

    Of the program's bytes the first `HEAD_BYTES` count. It raises `InputError` for an unknown name, or if neither content nor suffix
    are those of one language.
    """
    if language is not None:
        for dialect in DIALECTS:
            if dialect.name == language:
                return dialect
        expected = ", ".join(one.name for one in DIALECTS)
        raise InputError("unknown language", expected=expected, value=language, setting="language")
    found = [] if data is None else [one for one in DIALECTS if one.evidence.search(data[:HEAD_BYTES])]
    opened = [
        one for one in found if one.opening is not None and data is not None and one.opening.search(data[:HEAD_BYTES])
    ]
    found, hinted = opened or found, _by_suffix(path)
    possible = [one for one in found if one in hinted] if len(found) > 1 else found or hinted
    if len(possible) == 1:
        return possible[0]
    if data is not None and not found:
        kind = other_kind(data.decode("latin-1"), "an NC program")
        if kind is not None:
            raise InputError(f"{kind}, not an NC program", expected="an NC program, or its language", file=path)
    names = " or ".join(one.name for one in found or DIALECTS)
    what = "blocks of several languages" if found else "unknown NC program type"
    expected = f"the language ({names}), or a file name ending in {_SUFFIXES}"
    raise InputError(what, expected=expected, file=path, value=path.suffix.lower(), setting="language")


def _by_suffix(path: Path) -> list[Dialect]:
    return [dialect for dialect in DIALECTS if path.suffix.lower() in dialect.suffixes]


_SUFFIXES = " ".join(
    suffix for dialect in DIALECTS for suffix in dialect.suffixes if len(_by_suffix(Path(f"a{suffix}"))) == 1
)


def dialect_of(path: Path, language: str | None = None) -> Dialect:
    """Return the language of an existing program as `dialect_for` does; raise `InputError` if it cannot be read."""
    try:
        with open_input(path) as stream:
            return dialect_for(path, stream.read(HEAD_BYTES), language)
    except OSError as error:
        raise InputError("cannot be read", expected="a readable file", file=path, value=error.strerror) from error


def dialect_to_write(output: Path, source: Path, dialect: Dialect) -> Dialect:
    """Return the language in which to write a program: that of the suffix of its name, if it is one's own.

    The language of the source is kept where the suffix is the same, or one of several languages. It raises `InputError` for another
    suffix that is of no language, such as that of a picture.
    """
    by_suffix = _by_suffix(output)
    same = output.suffix.lower() == source.suffix.lower()
    if not (by_suffix or same):
        expected = f"a file name ending in one of {_SUFFIXES}, or that of {source.name}"
        raise InputError("unknown NC program type", expected=expected, file=output, value=output.suffix.lower())
    return by_suffix[0] if len(by_suffix) == 1 and not same else dialect


def read_program(
    path: str | Path, language: str | None = None, subprograms: Sequence[str | Path] = ()
) -> tuple[Program, Dialect]:
    """Read a program from a file (or a sample that comes with twin) and return it with its language.

    Its subprograms, in the same file, its folder or other folders, its loops and its jumps are written out as they are executed.

    Args:
        path: its path.
        language: ``iso``, ``heidenhain`` or ``apt``; None to recognise it by content, then by suffix.
        subprograms: folders in which subprograms are searched after the program's own.

    Raises:
        InputError: there is no such file, its language is not recognised, it is empty or not text, it needs more memory than there is,
            or a subprogram cannot be written out.

    Examples:
        >>> program, dialect = twin.read_program("cone_frustum.nc")
        >>> dialect.name, len(program.texts)
        ('iso', 375)
    """
    source = find_program(path)
    data = read_bytes(source, most_bytes=MAX_TEXT_BYTES)
    most = memory_bytes()
    if LINE_BYTES * (1 + max(data.count(b"\n"), data.count(b"\r"))) > most:
        what = "the program is too large to be held in memory"
        expected = (
            f"at most {most / LINE_BYTES:,.0f} lines with {most / 1e9:.1f} GB of memory; split it into several programs"
        )
        raise InputError(what, expected=expected, file=source)
    dialect = dialect_for(source, data, language)
    return dialect.expanded(dialect.read(data, str(source)), (source.parent, *map(Path, subprograms))), dialect
