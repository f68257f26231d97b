"""Writer of APT statements: locations replaced, every other byte kept."""

from __future__ import annotations

import re
from typing import Final, final

import numpy as np

from twin.nc.apt.statements import Statement
from twin.nc.blocks import Kind, Rewrite
from twin.nc.emit import vector_texts
from twin.nc.lines.scan import Scan
from twin.nc.text import Style, apply_edits, ending, format_number, style_of

POSITION_DECIMALS: Final = 5
VECTOR_DECIMALS: Final = 9
MOST_DECIMALS: Final = 12
"""Decimals of a coordinate that are kept at most."""
_COMPONENT: Final = f"%.{VECTOR_DECIMALS}f"
_EXPONENT: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)[EeDd][+-]?\d{1,3}", re.ASCII)


@final
class AptWriter:
    """Writer of statements that keeps track of the last tool vector.

    Args:
        newline: line ending of the program.
    """

    def __init__(self, newline: str) -> None:
        self.newline = newline
        self._said: tuple[str, ...] | None = vector_texts((0.0, 0.0, 1.0), VECTOR_DECIMALS, False)

    def unchanged(self, raw: str, *, tilts: bool) -> str:
        """Return a statement unchanged; ``tilts``: whether it has a tool vector."""
        if tilts:
            self._said = None
        return raw

    def location(self, statement: Statement, rewrite: Rewrite, rows: list[list[float]], unit: float) -> str:
        """Return the segments of a location.

        Args:
            statement: the statement.
            rewrite: its replacement.
            rows: the positions of the replacement, as lists.
            unit: mm per program unit.
        """
        raw, fields = statement.raw, statement.fields
        style = Style()
        decimals = [max(POSITION_DECIMALS, _decimals(text)) for _, _, text in fields[:3]]
        edits: list[tuple[int, int, str]] = []
        for (start, end, text), places, target in zip(fields, decimals, rows[0], strict=False):
            if target == target:
                style = style_of(text, style)
                if style.min_decimals != places or style.comma:
                    style = style._replace(min_decimals=places, comma=False)
                edits.append((start, end, format_number(target / unit, places, style)))
        vectors: list[list[float] | None] = [None] * len(rows) if rewrite.vectors is None else rewrite.vectors.tolist()
        written = len(fields) == 6
        texts = self._vector(vectors[0], again=written)
        if written:
            edits += [(start, end, text) for (start, end, _), text in zip(fields[3:], texts, strict=False)]
            self._said = self._said if texts else None
        elif texts:
            edits.append((fields[2].end, fields[2].end, f",{','.join(texts)}"))
        end_of_line = ending(raw)
        newline = end_of_line or self.newline
        lines = [apply_edits(raw, edits) + ("" if end_of_line or len(rows) == 1 else newline)]
        head = raw[: fields[0].start]
        goto = head if "$" not in head and statement.word == "GOTO" else "GOTO/"
        rapid = f"RAPID{newline}" if rewrite.move.kind is Kind.RAPID else ""
        for row, vector in zip(rows[1:], vectors[1:], strict=True):
            numbers = [
                format_number(target / unit, places, style._replace(min_decimals=places))
                for target, places in zip(row, decimals, strict=False)
            ]
            lines.append(f"{rapid}{goto}{','.join([*numbers, *self._vector(vector, again=False)])}{newline}")
        if not end_of_line and len(rows) > 1:
            lines[-1] = lines[-1].removesuffix(newline)
        return "".join(lines)

    def together(
        self,
        scan: Scan,
        whole: slice,
        lines: np.ndarray,
        count: np.ndarray,
        positions: np.ndarray,
        vectors: np.ndarray,
    ) -> str:
        """Return simple ``GOTO`` statements, consecutive except for comments, with new locations.

        Args:
            scan: the text.
            whole: the range of the text that contains the lines.
            lines: (n,) indices of the lines.
            count: (n,) number of segments of each.
            positions: (segments, axes) their end points in program units.
            vectors: (segments, 3) their tool vectors.
        """
        text, words = scan.data[whole].decode("latin-1"), scan.words
        first, last = scan.first[lines], scan.first[lines + 1] - 1
        places = np.clip(words.fraction[first[:, None] + [0, 1, 2]], POSITION_DECIMALS, MOST_DECIMALS)
        numbers = list(zip(*(_fixed(positions[:, i], np.repeat(places[:, i], count)) for i in range(3)), strict=True))
        tools = list(zip(*(_shortest(vectors[:, i]) for i in range(3)), strict=True))
        ranges = (words.start[first], words.end[last], scan.start[lines], scan.end[lines])
        columns = (*((ends - whole.start).tolist() for ends in ranges), (last - first == 5).tolist(), count.tolist())

        def location(row: int, *, again: bool) -> str:
            new = again or tools[row] != self._said
            self._said = tools[row]
            return ",".join(numbers[row] + tools[row] if new else numbers[row])

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
        return "".join(out)

    def _vector(self, vector: list[float] | None, *, again: bool) -> tuple[str, ...]:
        """Return the components of a tool vector, none if it is the last one written; ``again``: always."""
        if vector is None:
            return ()
        texts = vector_texts(vector, VECTOR_DECIMALS, False)
        new = again or texts != self._said
        self._said = texts
        return texts if new else ()


def _fixed(values: np.ndarray, places: np.ndarray) -> list[str]:
    """Return numbers as `format_number` does with these many decimals and no fewer."""
    found = list(map("%.*f".__mod__, zip(places.tolist(), values.tolist(), strict=True)))
    for i in np.flatnonzero(np.signbit(values) & (np.abs(values) < 1.0)).tolist():
        found[i] = format_number(float(values[i]), int(places[i]), Style(min_decimals=int(places[i])))
    return found


def _shortest(values: np.ndarray) -> list[str]:
    """Return the components of tool vectors as `vector_texts` does."""
    found = [
        text.rstrip("0").rstrip(".") if text[-1] == "0" else text for text in map(_COMPONENT.__mod__, values.tolist())
    ]
    for i in np.flatnonzero(np.signbit(values) & (np.abs(values) < 10.0**-VECTOR_DECIMALS)).tolist():
        found[i] = format_number(float(values[i]), VECTOR_DECIMALS, Style())
    return found


def _decimals(text: str) -> int:
    fraction = text.partition(".")[2]
    return min(MOST_DECIMALS, len(fraction)) if fraction.isdigit() or not _EXPONENT.fullmatch(text) else 0
