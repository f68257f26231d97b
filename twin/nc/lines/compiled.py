"""Simple lines read and written in compiled code (`lines.cpp`), with the same result as `scan` and `rewritten_lines` with arrays.

The arrays serve without a compiler and are the reference. Compiled code reads a line in 0.12 µs instead of 2.1, and `twin compensate`
of 500,000 five-axis blocks takes 4.2 s of processor instead of 7.1 (60,000: 2.5 instead of 3.0).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Final, final

import numpy as np

from twin.compute.native import compiler
from twin.nc.blocks import AxisWords
from twin.nc.lines.scan import NOTE, Scan, Words, rewritten_lines, scan, tables
from twin.nc.text import Style, count_of
from twin.nc.writer import SAME_NUMBER, Formatting, Grids, OutputState

_POINTERS: Final = ctypes.c_void_p
_TABLES: Final = ("text", "kind", "rank", "axis")
_LINES: Final = {
    "start": np.int64,
    "end": np.int64,
    "simple": np.bool_,
    "blank": np.uint8,
    "wide": np.bool_,
    "code": np.int8,
    "first": np.int64,
}
_WORDS: Final = {
    "word_line": np.int32,
    "word_axis": np.int8,
    "word_start": np.int32,
    "word_end": np.int32,
    "value": np.float64,
    "sign": np.uint8,
    "whole": np.int16,
    "fraction": np.int16,
    "point": np.bool_,
    "padded": np.bool_,
}
_READ: Final = tuple(name for name in _WORDS if name != "word_line")
_STYLE: Final = tuple(
    f"{'style_' if i < 4 else ''}{name}"
    for i, name in enumerate(("point", "min_decimals", "leading_zero", "plus", "spaced", "lower"))
)
_LONGEST_WORD: Final = 48
"""Most characters of a word: blank, letter, sign, 20 digits, point, `MOST_DIGITS` decimals."""
_SAMPLE: Final = b"%\nN10 G01 X-1.50 y+.25 Z3 B-0. C12 F100\r\n(note)\rX1 X2\nG2 X1\nX 1\n\nG1\nC.5"
_PLAIN: Final = Formatting(Style(), True, False)
_MAYBE_NOTE: Final = 2
"""Mark of a line that the compiled code leaves to the pattern of comments."""


class _Job(ctypes.Structure):
    """`Scanned` of lines.cpp, field by field."""

    _fields_ = (
        ("size", ctypes.c_int64),
        *((name, _POINTERS) for name in (*_TABLES, *_LINES, *_WORDS)),
        ("lines", ctypes.c_int64),
        ("words", ctypes.c_int64),
    )


class _RewriteJob(ctypes.Structure):
    """`Rewritten` of lines.cpp, field by field."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("begin", "stop", "lines", "axes")),
        ("text", _POINTERS),
        *((name, _POINTERS) for name in ("line", "start", "end", "first")),
        *((name, _POINTERS) for name in _READ),
        *((name, _POINTERS) for name in ("count", "targets", "step", "decimals", "scale", "letters", "own")),
        ("same_number", ctypes.c_double),
        *((name, _POINTERS) for name in ("said", "stale")),
        *((name, ctypes.c_int64) for name in _STYLE),
        ("out", _POINTERS),
        ("written", ctypes.c_int64),
    )


@final
@dataclass(frozen=True)
class _Compiled:
    """Reading and writing by a compiled library."""

    library: ctypes.CDLL

    def scan(self, data: bytes, names: tuple[str, ...]) -> Scan:
        """As `twin.nc.lines.scan.scan`."""
        text = np.frombuffer(data, dtype=np.uint8)
        kind, rank, axis, _ = tables(names)
        given = dict(zip(_TABLES, (text, np.frombuffer(kind, np.uint8), rank, axis), strict=True))
        job = _Job(size=len(data), **{name: values.ctypes.data for name, values in given.items()})
        # Upper bounds: memory that is not written is not taken.
        lines = count_of(data, ord("\n")) + count_of(data, ord("\r")) + 2
        words = len(data) // 2 + 1
        room: dict[str, np.ndarray] = {
            name: np.empty(size, dtype=kind_)
            for names_, size in ((_LINES, lines), (_WORDS, words))
            for name, kind_ in names_.items()
        }
        for name, values in room.items():
            setattr(job, name, values.ctypes.data)
        self.library.scan(ctypes.byref(job))
        made = {name: room[name][: job.lines + (name == "first")] for name in _LINES}
        found = Words(**{name.removeprefix("word_"): room[name][: job.words] for name in _WORDS})
        blank = made["blank"] == 1
        for i in np.flatnonzero(made["blank"] == _MAYBE_NOTE).tolist():
            blank[i] = NOTE.fullmatch(data, made["start"][i], made["end"][i]) is not None
        return Scan(
            data,
            text,
            made["start"],
            made["end"],
            made["simple"],
            blank,
            made["code"],
            made["wide"],
            found,
            made["first"],
        )

    def rewritten_lines(
        self,
        scan: Scan,
        whole: slice,
        lines: np.ndarray,
        count: np.ndarray,
        targets: np.ndarray,
        said: OutputState,
        formatting: Formatting,
        grids: Grids,
    ) -> tuple[bytes, Formatting]:
        """As `twin.nc.lines.scan.rewritten_lines`."""
        axes = targets.shape[1]
        own = {
            "line": np.ascontiguousarray(lines, dtype=np.int64),
            "count": np.ascontiguousarray(count, dtype=np.int64),
            "targets": np.ascontiguousarray(targets, dtype=float),
            "said": np.array(said.value, dtype=float),
            "stale": np.array(said.stale, dtype=np.uint8),
            "step": grids.step,
            "decimals": np.asarray(grids.decimals, dtype=np.int64),
            "scale": grids.scale,
            "letters": grids.letters,
            "own": grids.own,
        }
        own |= {name: getattr(scan, name) for name in ("text", "start", "end", "first")}
        own |= {name: getattr(scan.words, name.removeprefix("word_")) for name in _READ}
        words = int(scan.first[lines[-1] + 1] - scan.first[lines[0]])
        room = whole.stop - whole.start + _LONGEST_WORD * (words + targets.size + axes) + 2 * len(targets)
        own["out"] = np.empty(room, dtype=np.uint8)
        style = formatting.style
        before = (style.point, style.min_decimals, style.leading_zero, style.plus, formatting.spaced, formatting.lower)
        job = _RewriteJob(begin=whole.start, stop=whole.stop, lines=len(lines), axes=axes, same_number=SAME_NUMBER)
        for name, value in zip(_STYLE, before, strict=True):
            setattr(job, name, int(value))
        for name, values in own.items():
            setattr(job, name, values.ctypes.data)
        self.library.rewrite(ctypes.byref(job))
        said.value[:], said.stale[:] = own["said"].tolist(), own["stale"].astype(bool).tolist()
        point, least, zero, plus, spaced, lower = (int(getattr(job, name)) for name in _STYLE)
        after = Formatting(Style(bool(point), least, bool(zero), bool(plus), False), bool(spaced), bool(lower))
        return own["out"][: job.written].tobytes(), after


@final
@dataclass(frozen=True)
class LineCode:
    """Reader and writer of simple lines: with arrays, or the same in compiled code.

    Attributes:
        scan: `twin.nc.lines.scan.scan`.
        rewritten_lines: `twin.nc.lines.scan.rewritten_lines`.
    """

    scan: Callable[[bytes, tuple[str, ...]], Scan]
    rewritten_lines: Callable[..., tuple[bytes, Formatting]]


ARRAYS: Final = LineCode(scan, rewritten_lines)


def line_code(lines: int) -> LineCode:
    """Return compiled code if there is a compiler and the program is long enough to be worth it, else `ARRAYS`.

    Args:
        lines: approximate number of lines of the program.
    """
    found = _compiled() if compiler.worth_compiling(lines) else None
    return ARRAYS if found is None else LineCode(found.scan, found.rewritten_lines)


@cache
def _compiled() -> _Compiled | None:
    """Return the compiled code; None if it cannot be compiled, or differs from the arrays on a sample."""
    jobs = {"scan": _Job, "rewrite": _RewriteJob}
    confirmed_library = compiler.confirmed_library(
        "twin.nc.lines", "lines.cpp", jobs, lambda one: _agrees(_Compiled(one))
    )
    return None if confirmed_library is None else _Compiled(confirmed_library)


def _agrees(compiled: _Compiled) -> bool:
    """Return whether a sample is read and written as by the arrays."""
    names = ("X", "Y", "Z", "B", "C")
    seen = [read(_SAMPLE, names) for read in (scan, compiled.scan)]
    columns = [
        [getattr(one, name).tobytes() for name in _LINES]
        + [getattr(one.words, name.removeprefix("word_")).tobytes() for name in _WORDS]
        for one in seen
    ]
    if columns[0] != columns[1]:
        return False
    lines, grids = np.flatnonzero(seen[0].simple), Grids(names, [0.001] * len(names))
    targets = np.cumsum(np.full((2 * len(lines), len(names)), 0.4371), axis=0) - 1.5
    written = []
    for write in (rewritten_lines, compiled.rewritten_lines):
        state = OutputState(AxisWords(names[:3], names[3:], dict.fromkeys(names, 0.001)))
        whole = slice(0, len(_SAMPLE))
        count = np.full(len(lines), 2)
        written.append((*write(seen[0], whole, lines, count, targets, state, _PLAIN, grids), state.value, state.stale))
    return bool(written[0] == written[1])
