"""Print to a terminal: replace characters its encoding lacks, and escape control characters."""

from __future__ import annotations

import codecs
import io
import os
import re
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import ClassVar, Final, final

from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import CodeBlock, Markdown, MarkdownElement, TableElement
from rich.measure import Measurement
from rich.padding import Padding
from rich.text import Text

from twin._common.errors import InputError, closest_name, printable

BROKEN_PIPE: Final = 141
"""Exit status if standard output is closed: 128 + SIGPIPE, as for other Unix tools."""
_PLAIN: Final = {
    **{
        "−": "-",
        "–": "-",
        "→": "->",
        "µ": "u",
        "°": " deg",
        "±": "+/-",
        "×": "x",
        "·": "*",
        "…": "...",
        "≤": "<=",
        "≥": ">=",
    },
    **{"²": "^2", "³": "^3", "χ": "chi", "σ": "sigma", "λ": "lambda", "θ": "theta", "“": '"', "”": '"', "’": "'"},
}
"""ASCII replacements of characters that some encodings lack."""


def _readable(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    unreadable = error.object[error.start : error.end]
    return "".join(_PLAIN.get(one) or one.encode("ascii", "backslashreplace").decode() for one in unreadable), error.end


codecs.register_error("twin.readable", _readable)


def open_closed_streams() -> None:
    """Open standard streams that the caller closed, as by ``2>&-``, on the empty device, so that no output gets their number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "r" if number == 0 else "w", encoding="utf-8", closefd=False))


def accept_any_text() -> None:
    """Make the standard streams replace characters that their encoding lacks by ASCII."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="twin.readable")


def echo(text: object = "", *, end: str = "\n") -> None:
    """Print to the standard output, with control characters escaped."""
    print(printable(str(text)), end=end)


class _Nowhere(io.StringIO):
    """A standard output that keeps nothing."""

    def write(self, text: str) -> int:
        return len(text)


@contextmanager
def silenced() -> Iterator[None]:
    """Print nothing to the standard output, and show no progress."""
    with redirect_stdout(_Nowhere()):
        yield


def is_silenced() -> bool:
    """Return whether nothing is printed, within `silenced`."""
    return isinstance(sys.stdout, _Nowhere)


def print_error(text: str) -> None:
    """Print one line to the standard error, with control characters escaped; ignore a failure to write."""
    with suppress(OSError):
        print(printable(text, one_line=True), file=sys.stderr, flush=True)


def flush() -> None:
    """Flush the standard output; `OSError` if it cannot be written."""
    if sys.stdout is not None:
        sys.stdout.flush()


def discard_output() -> None:
    """Discard unwritten output, so that the interpreter does not try to write it at exit."""
    with suppress(OSError, ValueError, AttributeError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)


def os_error_message(error: OSError) -> str:
    """Return the message of an operating system error, in one line."""
    place = "standard output or TMPDIR" if error.filename is None else str(error.filename)
    return f"{place}: cannot be read or written: {error.strerror or error}; expected free space and permission"


# --- Pages of the manual in a terminal: nothing is cut or broken within a figure, however narrow the terminal is

_INDENT: Final = 4
_OPTION: Final = re.compile(r" (?=-{1,2}[a-zA-Z])")


class _Code(CodeBlock):
    """A code block in its own lines; lines that are too long are continued (`code_lines`)."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width - _INDENT
        lines = (part for line in str(self.text).rstrip().splitlines() for part in code_lines(line, width))
        for line in lines:
            yield Text(" " * _INDENT + line, style="cyan")


class _Table(TableElement):
    """A table; one that is wider than the terminal is printed row by row, each cell on its own line behind its heading."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        (table,) = super().__rich_console__(console, options)
        wide = options.update(max_width=10_000)
        if Measurement.get(console, wide, table).maximum <= options.max_width or self.body is None:  # type: ignore[arg-type]
            yield table
            return
        header = self.header.row.cells if self.header is not None and self.header.row is not None else []
        for row in self.body.rows:
            yield Text()
            for column, (heading, cell) in enumerate(zip(header, row.cells, strict=False)):
                name = f"{heading.content.plain}: " if heading.content.plain else ""
                if cell.content.plain:
                    line = Text.assemble((name, "dim"), (cell.content.plain, "bold" if column == 0 else ""))
                    yield Padding(line, (0, 0, 0, _INDENT if column else 0))


@final
class ManualPage(Markdown):
    """A page of the manual, to be printed by a rich console."""

    elements: ClassVar[dict[str, type[MarkdownElement]]] = {
        **Markdown.elements,
        "fence": _Code,
        "code_block": _Code,
        "table_open": _Table,
    }


def code_lines(line: str, width: int) -> list[str]:
    """Return a line of code in lines of at most ``width`` columns, without losing a word.

    A `twin` command is continued before an option, as a shell accepts it; other lines are continued at a space, indented further.
    """
    indent = " " * (len(line) - len(line.lstrip()) + _INDENT)
    if line.lstrip().startswith("twin "):
        words = _OPTION.split(line)
        lines = [words[0]]
        for word in words[1:]:
            if len(lines[-1]) + len(word) + len(" ") <= width - len(" \\"):
                lines[-1] += f" {word}"
            else:
                lines[-1] += " \\"
                lines.append(f"{indent}{word}")
        return lines
    return textwrap.wrap(line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False) or [""]


# --- Parsing of the command line: options with several words, and numbers of a usable magnitude ---

MANY_WORDS: Final[Mapping[str, re.Pattern[str]]] = {
    "--work-offset": re.compile(r"[A-Za-z]\w*=.*"),
    "--at": re.compile(r"[A-Za-z]\w*=.*"),
    "--temperature": re.compile(r"[^\W\d][\w.-]*=.*"),
    "--scope": re.compile(r"[LR]-[A-Z]{3}\+?|FOR", re.I),
    "--only": re.compile(r"E_[A-Z0-9*?]+"),
    "--reduce": re.compile(r"E_[A-Z0-9*?]+"),
    "--spheres": re.compile(r"-?[\d.]+,-?[\d.]+,-?[\d.]+"),
    "--harmless": re.compile(r"[A-Za-z]\w*|[A-Za-z]+ [\w ]+"),
    "--auxiliary-axes": re.compile(r"[A-Za-z]"),
    "--subprograms": re.compile(r"[^-].*/|\.\.?|(?!-)(?:.*/)?[^./]+"),
}
"""Options that take several words, each with the pattern of every word after the first."""
BETWEEN: Final[Mapping[str, str]] = {"--spheres": r"\s+", "--subprograms": r"(?!)"}
"""Separator of several words in one argument, where it is not blanks and commas; paths may contain both."""
MANY_WORDS_OF: Final[Mapping[str, Mapping[str, re.Pattern[str]]]] = {
    "evaluate": {"--tolerance": re.compile(r"[A-Za-z][\w:()↑↓↺↻]*=.*"), "--sensors": re.compile(r"[A-Za-z][\w-]*=.*")},
    "report": {"--tolerance": re.compile(r"[A-Za-z]\w*=.*")},
    "machine": {"--no": re.compile(r"\d+")},
    "thermal": {"--along": re.compile(r"[A-Za-z]=.*")},
}
"""The same for options that take several words with one command only."""
VARIABLE: Final = "_TWIN_COMPLETE"
WORDS: Final = "COMP_WORDS"
WORD: Final = "COMP_CWORD"
"""Variables that bash sets: the whole command line, and the index of the word being completed."""
SMALLEST: Final = 1e-12
LARGEST: Final = 1e12
"""Limits of a number on the command line in any unit: below the size of an atom, above the seconds since 1970."""


def repeat_options(arguments: list[str]) -> list[str]:
    """Return the arguments with an option of several words repeated for each word: ``--scope L-POS L-STR``, ``--at X=1 Y=2``."""
    patterns = _many_words(arguments)
    out: list[str] = []
    gathering: str | None = None
    fresh = False
    for word in arguments:
        if word in patterns:
            gathering, fresh = word, True
        elif gathering and fresh:
            parts = [part for part in re.split(BETWEEN.get(gathering, r"[\s,]+"), word) if part] or [word]
            for part in parts:
                out += [gathering, part]
            fresh = False
        elif gathering and patterns[gathering].fullmatch(word):
            out += [gathering, word]
        else:
            gathering = None
            out.append(word)
    return [*out, gathering] if gathering and fresh else out


def pairs(
    option: str, entries: Iterable[str] | None, expected: str, *, last: bool = False
) -> Iterator[tuple[str, str, str]]:
    """Yield name, text and word of each ``NAME=text``, each name once; ``last`` if a name may contain an equals sign."""
    known: set[str] = set()
    for entry in entries or ():
        name, equals, text = entry.rpartition("=") if last else entry.partition("=")
        if not equals or not name:
            raise InputError(f"{option} cannot be read", expected=expected, value=entry)
        if name in known:
            raise InputError(f"{option} names {name} twice", expected="each name once", value=entry)
        known.add(name)
        yield name, text, entry


def axis_values(option: str, entries: Iterable[str] | None, axes: Sequence[str]) -> dict[str, float]:
    """Return one number for each axis of ``AXIS=number`` words; `InputError` for an unknown axis, or one given twice."""
    values: dict[str, float] = {}
    for name, text, entry in pairs(option, entries, f"AXIS=number, once for each axis of {', '.join(axes)}"):
        if name not in axes:
            raise InputError(
                f"{option} names an unknown axis",
                expected=f"one of {', '.join(axes)}",
                value=entry,
                nearest=closest_name(name, axes),
            )
        values[name] = number(option, text, entry)
    return values


def _many_words(arguments: list[str]) -> Mapping[str, re.Pattern[str]]:
    own = next((MANY_WORDS_OF[word] for word in arguments[:2] if word in MANY_WORDS_OF), {})
    return {**MANY_WORDS, **own}


def expand_bash_line() -> None:
    """Rewrite bash's command line for the parser: an option with several words is repeated before each of them."""
    if os.environ.get(VARIABLE) != "complete_bash" or WORDS not in os.environ:
        return
    line = os.environ[WORDS].split()
    try:
        position = int(os.environ.get(WORD, ""))
    except ValueError:
        return
    before, current = line[1:position], line[position] if position < len(line) else ""
    if any(mark in " ".join(line) for mark in "\"'\\"):
        return  # splitting at spaces would break quoted words
    words = repeat_options(before)
    if (
        len(words) >= 2
        and words[-2] in _many_words(before)
        and not current.startswith("-")
        and not Path(current).exists()
    ):
        words.append(words[-2])
    os.environ[WORDS] = " ".join([line[0] if line else "twin", *words, current])
    os.environ[WORD] = str(len(words) + 1)


def three_numbers(option: str, text: str, shown: str, expected: str) -> tuple[float, float, float]:
    """Parse three numbers separated by commas, each as `number`."""
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(f"{option} must be three numbers", expected=expected, value=shown)
    x, y, z = (number(option, part, shown) for part in parts)
    return x, y, z


def number(option: str, text: str, shown: str) -> float:
    """Parse a number and check it with `usable_number`."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    usable_number(option, value, shown)
    return value


def usable_number(option: str, value: float, shown: object) -> None:
    """Raise `InputError` unless a number is zero or its magnitude is within `SMALLEST` … `LARGEST`; ``shown``: the text as typed."""
    if not abs(value) < float("inf"):
        raise InputError(f"{option} must be a finite number", expected="digits, as in 12.5", value=shown)
    if value != 0.0 and not SMALLEST <= abs(value) <= LARGEST:
        raise InputError(
            f"{option} is too large or too small",
            expected=f"0, or a magnitude between {SMALLEST:g} and {LARGEST:g}",
            value=shown,
        )


def positive(option: str, value: float) -> None:
    """Raise `InputError` unless a value is positive and finite."""
    if not 0.0 < value < float("inf"):
        raise InputError(f"{option} must be positive", expected="a number above 0", value=value)


def not_negative(option: str, value: int) -> None:
    """Raise `InputError` if a number is negative."""
    if value < 0:
        raise InputError(f"{option} must not be negative", expected="0 or more", value=value)


def tolerances(entries: Sequence[str]) -> dict[str, float]:
    """Return the tolerances, each given as ``SYMBOL=NUMBER``, a name once and no number negative."""
    limits: dict[str, float] = {}
    for name, text, entry in pairs("--tolerance", entries, "symbol and µm or µrad: A=10"):
        limits[name] = number("--tolerance", text, entry)
        if limits[name] < 0.0:
            raise InputError("--tolerance must not be negative", expected="µm or µrad, 0 or above", value=entry)
    return limits
