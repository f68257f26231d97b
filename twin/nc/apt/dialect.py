"""The APT dialect: cutter locations (``.cls``, ``.apt``), ``GOTO/x,y,z,i,j,k`` in the work frame."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import PROGRAM_SUFFIXES
from twin.nc.apt.locations import VECTOR_DECIMALS
from twin.nc.apt.program import read, rewritten
from twin.nc.apt.statements import statement_at, statements
from twin.nc.apt.technology import line_words
from twin.nc.blocks import AxisWords, Interpretation, Kind, Program
from twin.nc.columns import NewPositions, as_columns
from twin.nc.dialect import Dialect
from twin.nc.header import first_lines, insert_comments
from twin.nc.technology import FeedUnit, LineWords
from twin.nc.text import MM_PER_INCH, Style, format_number

_REMARK: Final = re.compile(r"[ \t]*+(?:\$\$[^\r\n]*+)?+[\r\n]*+", re.ASCII)
_LOCATION: Final = re.compile(r"[ \t]*+GOTO[ \t]*+/[ \t\d.,+-]++[\r\n]*+", re.ASCII | re.IGNORECASE)


@final
class Apt(Dialect):
    """APT cutter locations: tool-tip coordinates and tool vectors, independent of the machine's kinematics."""

    name = "apt"
    suffixes = PROGRAM_SUFFIXES["apt"]
    vector_decimals = VECTOR_DECIMALS
    linear_increment_mm = 1e-5
    cutter_locations = True

    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Interpretation:
        """See `Dialect.moves`. Cutter locations are tool-tip coordinates whatever ``tcp`` says."""
        return read(program, axes)

    def rewrite(self, program: Program, axes: AxisWords, reading: Interpretation, new: NewPositions) -> str:
        """See `Dialect.rewrite`."""
        return (
            rewritten(program, axes, as_columns(axes.names, reading.moves), new) if np.any(new.count) else program.text
        )

    def with_comments(self, text: str, comments: Sequence[str]) -> str:
        """See `Dialect.with_comments`: after ``PARTNO``."""
        lines = first_lines(text)
        at = place = 0
        while place < len(lines):
            statement, after = statement_at(lines, place)
            if statement.word == "PARTNO":
                at = after
            elif statement.word:
                break
            place = after
        return insert_comments(text, lines, at, comments, "$$ {}".format, _comment)

    def from_points(self, names: Sequence[str], points: np.ndarray, feed: float | None, remark: str, title: str) -> str:
        """See `Dialect.from_points`."""
        said = "" if feed is None else f"FEDRAT/{feed:g},MMPM\n"
        style = Style(min_decimals=5)
        rows = [",".join(format_number(value, 9, style) for value in row) for row in points.tolist()]
        return f"$$ {remark}\nUNITS/MM\n{said}" + "".join(f"GOTO/{row}\n" for row in rows) + "FINI\n"

    def line_words(self, text: str) -> LineWords:
        """See `Dialect.line_words`."""
        return line_words(text)

    def is_comment(self, text: str) -> bool:
        """See `Dialect.is_comment`."""
        return _REMARK.fullmatch(text) is not None

    def is_motion_only(self, text: str, names: tuple[str, ...]) -> bool:
        """See `Dialect.is_motion_only`."""
        return _LOCATION.fullmatch(text) is not None

    def posted(
        self, program: Program, reading: Interpretation, new: NewPositions, axes: AxisWords, into: Dialect
    ) -> str:
        """See `Dialect.posted`."""
        _check_known(program, reading)
        writer = into.new_program(axes)
        writer.start(program.source)
        unit = 1.0
        move_of = {move.line: (index, move) for index, move in enumerate(reading.moves)}
        for statement in statements(program.texts):
            if statement.line in move_of:
                index, move = move_of[statement.line]
                rewrite = new.of_move(index, move)
                if rewrite is None:
                    raise ValueError(f"the move of line {statement.line + 1} has no position")
                if not np.all(np.isfinite(rewrite.positions)):
                    raise ValueError(f"the move of line {statement.line + 1} has an unknown axis position")
                for row in rewrite.positions.tolist():
                    writer.move(row, rapid=move.kind is Kind.RAPID)
            elif statement.word == "UNITS":
                unit = MM_PER_INCH if statement.arguments and statement.texts[0].upper().startswith("INCH") else 1.0
            elif statement.word == "FEDRAT":
                words = line_words(f"FEDRAT/{statement.arguments}")
                writer.feed = _feed(words, unit, writer.feed)
                if words.unit is not FeedUnit.MINUTE:
                    writer.comment(" ".join(statement.raw.split()))
            elif statement.word and statement.word not in ("RAPID", "FROM", "GOTO", "?"):
                writer.comment(" ".join(statement.raw.split()))
        writer.finish()
        return "".join(writer.out)


def _check_known(program: Program, reading: Interpretation) -> None:
    """Raise `InputError` for an unknown location."""
    for lost in reading.moves:
        if lost.unknown:
            raise InputError(
                f"a location that cannot be posted: {lost.unknown}",
                expected="statements whose effect on the locations is known",
                file=program.source,
                line=lost.line + 1,
                value=program.texts[lost.line].strip(),
            )


def _feed(words: LineWords, unit: float, last: float) -> float:
    """Return the feed of a ``FEDRAT`` in mm/min; the last feed if it is not per minute, or no positive number."""
    if words.unit is not FeedUnit.MINUTE or words.feed is None or not words.feed > 0.0:
        return last
    return words.feed * (1.0 if words.metric else unit)


def _comment(line: str) -> str | None:
    """Return the text of a line that is a comment or blank; None for any other line."""
    body = line.strip()
    return body[2:].strip() if body.startswith("$$") else None if body else ""
