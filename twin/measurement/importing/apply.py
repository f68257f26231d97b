"""Application of a mapping: the cells of a measurement table from those of the file, exactly as the mapping says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from typing import Final, final

from twin._common.errors import InputError
from twin.measurement.columns import CARRIERS
from twin.measurement.importing.decimals import SIGNS, decimal_text, decimal_value
from twin.measurement.importing.layout import Layout
from twin.measurement.importing.mapping import ColumnMapping, OriginEntry
from twin.measurement.importing.units import Unit, table_unit, unit_named, units_of
from twin.measurement.importing.vocabulary import CARRIER_WORDS, direction_of, plain_words

WORD_COLUMNS: Final = ("target", "carrier", "station", "station_carrier", "instrument", "round")
TIME: Final = "time_s"


@final
@dataclass(frozen=True)
class Applied:
    """Application of a mapping to a file.

    Attributes:
        layout: the file.
        mapping: the mapping.
    """

    layout: Layout
    mapping: ColumnMapping

    def columns(self) -> dict[str, list[str]]:
        """Return the cells of every mapped column of the measurement table, by its name.

        Raises:
            InputError: a column of the mapping is not in the file; a cell that is not a number, direction, side or date.
        """
        return {name: self.column(name, entry) for name, entry in self.mapping.entries.columns.items()}

    def column(self, name: str, entry: OriginEntry) -> list[str]:
        """Return the cells of one column.

        Raises:
            InputError: as `columns`.
        """
        if entry.source is None:
            value = "" if entry.value is None else entry.value
            return [f"{value:g}" if isinstance(value, float) else str(value)] * len(self.layout.rows)
        self._check_sources(name, entry.sources)
        if name in WORD_COLUMNS:
            return self._words(name, entry)
        if name.startswith("approach_"):
            return self._directions(name, entry)
        if name == TIME and entry.format is not None:
            return self._seconds(entry)
        return self._numbers(name, entry)

    def _check_sources(self, name: str, sources: Sequence[str]) -> None:
        for source in sources:
            if source not in self.layout.names:
                names = self.layout.names
                raise self.mapping.error(
                    f"{self.layout.raw.path} has no such column",
                    ("columns", name, "from"),
                    expected=f"one of {', '.join(names)}",
                    value=source,
                    known=names,
                )

    def _error(self, what: str, row: int, value: str, expected: str) -> InputError:
        line = self.layout.rows[row][0]
        return InputError(what, expected=expected, file=self.layout.raw.path, line=line, value=value)

    def _words(self, name: str, entry: OriginEntry) -> list[str]:
        words = {plain_words(word): str(meaning) for word, meaning in (entry.words or {}).items()}
        cells = self.layout.column(entry.sources[0])
        if name in ("carrier", "station_carrier"):
            words = {**CARRIER_WORDS, "base": "base", **words}
            for row, cell in enumerate(cells):
                if plain_words(cell) not in words:
                    expected = f"{' or '.join(CARRIERS)}, or an entry of `words` in the mapping"
                    raise self._error(f"{name} is not a side of the machine", row, cell, expected)
        return [words.get(plain_words(cell), cell) for cell in cells]

    def _directions(self, name: str, entry: OriginEntry) -> list[str]:
        words = {plain_words(word): meaning for word, meaning in (entry.words or {}).items()}
        found = []
        for row, cell in enumerate(self.layout.column(entry.sources[0])):
            value = words.get(plain_words(cell), direction_of(cell))
            if value is None or str(value) not in ("-1", "0", "1"):
                expected = "+, -, up, down, vorwärts, rückwärts, +1, -1 or 0, or an entry of `words` in the mapping"
                raise self._error(f"{name} is not a direction", row, cell, expected)
            found.append(str(int(value) * entry.sign))
        return found

    def _numbers(self, name: str, entry: OriginEntry) -> list[str]:
        unit, sign = self._unit(name, entry), self.mapping.entries.sign
        offset = Decimal(repr(entry.offset))
        found = []
        for row, cell in enumerate(self.layout.column(entry.sources[0])):
            if not cell:
                found.append("")
                continue
            value = decimal_value(cell, "." if self.layout.raw.sheet and "," not in cell else sign)
            if value is None:
                expected = f"a number with a decimal {SIGNS[sign]}, or an empty cell"
                raise self._error(f"{entry.sources[0]} ({name}) is not a number", row, cell, expected)
            value = value if unit is None else unit.to_table(value)
            found.append(decimal_text(value * entry.sign + offset if entry.sign < 0 or offset else value))
        return found

    def _unit(self, name: str, entry: OriginEntry) -> Unit | None:
        return unit_named(entry.unit) if entry.unit else next(iter(units_of(name)), None) if table_unit(name) else None

    def _seconds(self, entry: OriginEntry) -> list[str]:
        """Return times in seconds since the first row that has one."""
        columns = [self.layout.column(source) for source in entry.sources]
        texts = [" ".join(parts) for parts in zip(*columns, strict=True)]
        first: datetime | None = None
        found = []
        for row, text in enumerate(texts):
            if not text.strip():
                found.append("")
                continue
            moment = moment_in(text, entry.format or "")
            if moment is None:
                raise self._error("not a date and time", row, text, f"the form {entry.format}")
            first = moment if first is None else first
            found.append(decimal_text(Decimal((moment - first) // timedelta(microseconds=1)) / 1_000_000))
        return found


def moment_in(text: str, form: str) -> datetime | None:
    """Return a date and time, without its time zone; None if the text does not have this form (``iso``, or as `datetime.strptime`)."""
    try:
        moment = datetime.fromisoformat(text) if form == "iso" else datetime.strptime(text, form)
    except ValueError:
        return None
    return moment.replace(tzinfo=None) if moment.tzinfo is None else moment.astimezone(UTC).replace(tzinfo=None)
