"""Writer of APT statements: locations replaced, every other byte kept."""

from __future__ import annotations

import re
from typing import Final, final

from twin.nc.apt.locations import MOST_DECIMALS, POSITION_DECIMALS, VECTOR_DECIMALS, Said, Together, TogetherJob
from twin.nc.apt.statements import Statement
from twin.nc.blocks import Kind, Rewrite
from twin.nc.emit import vector_texts
from twin.nc.text import Style, apply_edits, ending, format_number, style_of

_EXPONENT: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)[EeDd][+-]?\d{1,3}", re.ASCII)


@final
class AptWriter:
    """Writer of statements that keeps track of the last tool vector.

    Args:
        newline: line ending of the program.
        together: how simple statements are written together.
    """

    def __init__(self, newline: str, together: Together) -> None:
        self.newline = newline
        self._together = together
        self._said: Said | None = vector_texts((0.0, 0.0, 1.0), VECTOR_DECIMALS, False)

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

    def together(self, job: TogetherJob) -> str:
        """Return simple ``GOTO`` statements with new locations."""
        text, self._said = self._together(job, self._said)
        return text

    def _vector(self, vector: list[float] | None, *, again: bool) -> tuple[str, ...]:
        """Return the components of a tool vector, none if it is the last one written; ``again``: always."""
        if vector is None:
            return ()
        texts = vector_texts(vector, VECTOR_DECIMALS, False)
        new = again or texts != self._said
        self._said = texts
        return texts if new else ()


def _decimals(text: str) -> int:
    fraction = text.partition(".")[2]
    return min(MOST_DECIMALS, len(fraction)) if fraction.isdigit() or not _EXPONENT.fullmatch(text) else 0
