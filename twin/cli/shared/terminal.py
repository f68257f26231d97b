"""Print to a terminal: replace characters its encoding lacks, and escape control characters."""

from __future__ import annotations

import codecs
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Final

from twin._common.errors import printable

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
    found = error.object[error.start : error.end]
    return "".join(_PLAIN.get(one) or one.encode("ascii", "backslashreplace").decode() for one in found), error.end


codecs.register_error("twin.readable", _readable)


def open_closed_streams() -> None:
    """Open standard streams that the caller closed, as by ``2>&-``, on the empty device.

    Otherwise the next file that is opened, such as an output, gets the number of the closed stream, and messages end in it.
    """
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
    """Flush the standard output.

    Raises:
        OSError: it cannot be written.
    """
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
