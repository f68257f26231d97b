"""What a command prints, on any terminal: readable in its encoding, and unable to steer it."""

from __future__ import annotations

import codecs
import io
import os
import sys
from contextlib import suppress
from typing import Final

from twin._common.errors import printable

BROKEN_PIPE: Final = 141
"""Exit status where nothing reads the standard output any more: 128 + SIGPIPE, as of other Unix tools."""
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
"""ASCII for the characters in messages that not every encoding has."""


def _readable(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = error.object[error.start : error.end]
    return "".join(_PLAIN.get(one) or one.encode("ascii", "backslashreplace").decode() for one in found), error.end


codecs.register_error("twin.readable", _readable)


def accept_any_text() -> None:
    """Let the standard streams write characters that their encoding does not have as ASCII."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="twin.readable")


def echo(text: object = "", *, end: str = "\n") -> None:
    """Print to the standard output, with control characters escaped."""
    print(printable(str(text)), end=end)


def tell_error(text: str) -> None:
    """Print one line to the standard error, with control characters escaped; nothing where that cannot be written."""
    with suppress(OSError):
        print(printable(text, one_line=True), file=sys.stderr, flush=True)


def flush() -> None:
    """Write out what was printed.

    Raises:
        OSError: it cannot be written.
    """
    if sys.stdout is not None:
        sys.stdout.flush()


def discard_output() -> None:
    """Drop what is left to print, so that the interpreter does not try again when it ends."""
    with suppress(OSError, ValueError, AttributeError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)


def line_of_failure(error: OSError) -> str:
    """Return what the operating system refused, in one line."""
    place = "standard output or TMPDIR" if error.filename is None else str(error.filename)
    return f"{place}: cannot be read or written: {error.strerror or error}; expected room and permission to write"
