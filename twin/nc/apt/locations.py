"""Locations of simple ``GOTO`` statements written together: with Python strings, or the same in compiled code (`locations.cpp`)."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Final, final

import numpy as np

from twin.compute.native import compiler
from twin.nc.lines.scan import Scan, scan
from twin.nc.text import Style, ending, format_number

POSITION_DECIMALS: Final = 5
VECTOR_DECIMALS: Final = 9
MOST_DECIMALS: Final = 12
"""Decimals of a coordinate that are kept at most."""
_COMPONENT: Final = f"%.{VECTOR_DECIMALS}f"
_LONGEST_LOCATION: Final = 6 * 32
"""Most characters of a location: sign, 16 digits, point, 12 decimals and comma for each number."""
_VECTOR_ROOM: Final = 128
_POINTERS: Final = ctypes.c_void_p
_SCANNED: Final = ("text", "start", "end", "first")
_WORDS: Final = ("start", "end", "fraction")
_SAMPLE: Final = b"    X1.5Y-2Z0.1234567A0B0C1\r\n\n    X1Y2Z3.0000000000001\r\n    X0Y0Z-.5\n%\n    X1Y1Z1A1B0C0\n"
"""In the form of ISO lines, as `twin.nc.apt.reader.scan` makes it of a program."""


@final
@dataclass(frozen=True)
class TogetherJob:
    """Simple ``GOTO`` statements, consecutive except for comments, and their new locations.

    Attributes:
        scan: the text.
        whole: the range of the text that contains the lines.
        lines: (n,) indices of the lines.
        count: (n,) number of segments of each.
        positions: (segments, axes) their end points in program units.
        vectors: (segments, 3) their tool vectors.
    """

    scan: Scan
    whole: slice
    lines: np.ndarray
    count: np.ndarray
    positions: np.ndarray
    vectors: np.ndarray


Said = tuple[str, ...]
"""Components of the tool vector written last."""
Together = Callable[[TogetherJob, Said | None], tuple[str, Said | None]]
"""Function that returns the statements with their new locations, and the last tool vector in them, given the last one before."""


def written(job: TogetherJob, said: Said | None) -> tuple[str, Said | None]:
    """Write locations with Python strings; see `Together`."""
    scan, whole, lines, count, vectors = job.scan, job.whole, job.lines, job.count, job.vectors
    text, words = scan.data[whole].decode("latin-1"), scan.words
    first, last = scan.first[lines], scan.first[lines + 1] - 1
    places = np.clip(words.fraction[first[:, None] + [0, 1, 2]], POSITION_DECIMALS, MOST_DECIMALS)
    numbers = list(zip(*(_fixed(job.positions[:, i], np.repeat(places[:, i], count)) for i in range(3)), strict=True))
    tools = list(zip(*(_shortest(vectors[:, i]) for i in range(3)), strict=True))
    ranges = (words.start[first], words.end[last], scan.start[lines], scan.end[lines])
    columns = (*((ends - whole.start).tolist() for ends in ranges), (last - first == 5).tolist(), count.tolist())

    def location(row: int, *, again: bool) -> str:
        before = tools[row - 1] if row else said
        return ",".join(numbers[row] + tools[row] if again or tools[row] != before else numbers[row])

    out, at, row = list[str](), 0, 0
    for begin, behind, start, end, tilted, segments in zip(*columns, strict=True):
        out += (text[at:begin], location(row, again=tilted))
        at = behind
        if segments > 1:
            head, newline = text[start:begin], ending(text[start:end])
            out.append(text[behind:end])
            out += (f"{head}{location(row + i, again=False)}{newline}" for i in range(1, segments))
            at = end
        row += segments
    out.append(text[at:])
    return "".join(out), tools[-1] if tools else said


def _fixed(values: np.ndarray, places: np.ndarray) -> list[str]:
    """Return numbers as `format_number` does with these many decimals and no fewer."""
    fixed = list(map("%.*f".__mod__, zip(places.tolist(), values.tolist(), strict=True)))
    for i in np.flatnonzero(np.signbit(values) & (np.abs(values) < 1.0)).tolist():
        fixed[i] = format_number(float(values[i]), int(places[i]), Style(min_decimals=int(places[i])))
    return fixed


def _shortest(values: np.ndarray) -> list[str]:
    """Return the components of tool vectors as `twin.nc.writer.vector_texts` does."""
    shortest = [
        text.rstrip("0").rstrip(".") if text[-1] == "0" else text for text in map(_COMPONENT.__mod__, values.tolist())
    ]
    for i in np.flatnonzero(np.signbit(values) & (np.abs(values) < 10.0**-VECTOR_DECIMALS)).tolist():
        shortest[i] = format_number(float(values[i]), VECTOR_DECIMALS, Style())
    return shortest


class _LocationJob(ctypes.Structure):
    """`Locations` of locations.cpp, field by field."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("begin", "stop", "count_lines", "axes")),
        *((name, _POINTERS) for name in ("text", "lines", "count", "start", "end", "first")),
        *((f"word_{name}", _POINTERS) for name in _WORDS),
        *((name, _POINTERS) for name in ("positions", "vectors", "said")),
        ("said_size", ctypes.c_int64),
        ("out", _POINTERS),
        ("written", ctypes.c_int64),
    )


@final
@dataclass(frozen=True)
class _CompiledLocations:
    """Writing by a compiled library."""

    library: ctypes.CDLL

    def written(self, job: TogetherJob, said: Said | None) -> tuple[str, Said | None]:
        """As `written`, which is called if a number is too large for the compiled code: 2⁵² units of its last decimal."""
        scan, whole = job.scan, job.whole
        given = {
            "lines": np.ascontiguousarray(job.lines, dtype=np.int64),
            "count": np.ascontiguousarray(job.count, dtype=np.int64),
            "positions": np.ascontiguousarray(job.positions, dtype=float),
            "vectors": np.ascontiguousarray(job.vectors, dtype=float),
        }
        given |= {name: getattr(scan, name) for name in _SCANNED}
        given |= {f"word_{name}": getattr(scan.words, name) for name in _WORDS}
        lines, count = given["lines"], given["count"]
        copied = int(count @ (scan.end[lines] - scan.start[lines]))
        room = whole.stop - whole.start + copied + _LONGEST_LOCATION * len(job.positions)
        given["out"] = np.empty(room, dtype=np.uint8)
        before = ",".join(said or ()).encode()
        # A longer vector differs from all that are written here.
        last = ctypes.create_string_buffer(before if len(before) < _VECTOR_ROOM else b"", _VECTOR_ROOM)
        passed = _LocationJob(
            begin=whole.start,
            stop=whole.stop,
            count_lines=len(lines),
            axes=job.positions.shape[1],
            said=ctypes.addressof(last),
            said_size=len(last.value),
            **{name: values.ctypes.data for name, values in given.items()},
        )
        self.library.write_locations(ctypes.byref(passed))
        if passed.written < 0:
            return written(job, said)
        text = str(given["out"][: passed.written].data, "latin-1")
        return text, tuple(last.raw[: passed.said_size].decode().split(",")) if passed.said_size else None


def together_code(lines: int) -> Together:
    """Return compiled code if there is a compiler and the program is long enough to be worth it, else `written`.

    Args:
        lines: number of lines of the program.
    """
    found = _compiled() if compiler.worth_compiling(lines) else None
    return written if found is None else found.written


@cache
def _compiled() -> _CompiledLocations | None:
    """Return the compiled code; None if it cannot be compiled, or differs from `written` on a sample."""
    jobs = {"write_locations": _LocationJob}
    confirmed_library = compiler.confirmed_library(
        "twin.nc.apt", "locations.cpp", jobs, lambda one: _agrees(_CompiledLocations(one))
    )
    return None if confirmed_library is None else _CompiledLocations(confirmed_library)


def _agrees(compiled: _CompiledLocations) -> bool:
    """Return whether a sample is written as by `written`."""
    seen = scan(_SAMPLE, ("X", "Y", "Z", "A", "B", "C"))
    lines = np.flatnonzero(seen.simple)
    count = 1 + np.arange(len(lines)) % 3
    positions = np.cumsum(np.full((count.sum(), 3), [0.4371, -1e-6, 1 / 3]), axis=0) - [1.5, 0.0, 2.0**-7]
    vectors = np.round(np.sin(positions), 2)
    vectors[1::2] = vectors[: len(vectors) // 2 * 2 : 2]
    job = TogetherJob(seen, slice(0, len(_SAMPLE)), lines, count, positions, vectors)
    return all(compiled.written(job, said) == written(job, said) for said in (None, ("0", "0", "1")))
