"""Import of a table: cells, mapping, measurement table, checks."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError, printable
from twin._common.files import other_kind, read_bytes, scratch_folder, write_atomic
from twin._common.messages import Message
from twin._common.provenance import SIMULATED, SourceWarning, warning_texts, warnings_to_json
from twin._common.records import TIME
from twin._common.units import count_with_noun
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.measurement.agreement import ColumnChange, wrong_columns
from twin.measurement.columns import POINT_COLUMNS, RowNote, comment_lines, csv_text, grouped_notes, table_columns
from twin.measurement.columns import SIMULATED as SIMULATED_WORD
from twin.measurement.formats import other_format
from twin.measurement.importing.apply import Applied, PlanPoints, moment_in
from twin.measurement.importing.arrangement import table_layout
from twin.measurement.importing.cells import MAX_BYTES, Layout, read_cells
from twin.measurement.importing.columns import Proposal, quoted
from twin.measurement.importing.mapping import ColumnMapping, OriginEntry, unchecked
from twin.measurement.importing.propose import proposed
from twin.measurement.instruments import default_instrument, others_alike
from twin.measurement.observation import FEWEST_REPEATS, repeats_dof
from twin.measurement.table import Measurements

PREVIEW_ROWS: Final = 5
MAX_COMMENTS: Final = 100
TABLES: Final = ("a measurement table", "a plan", "a spreadsheet or zip file")
"""Kinds of files that are tables."""
SIMULATION: Final = re.compile(r"\bsimul(ated|iert)", re.IGNORECASE)
"""Words of a comment or title which state that the readings were computed."""


CYCLE_LOG: Final = re.compile(r"CYCLE99(?:6|60)\b|measure kinematics|kinematik vermessen(?!.*zyklus 45)", re.IGNORECASE)
"""Names of SINUMERIK's cycles in their logs."""


@final
@dataclass(frozen=True, repr=False)
class ImportedTable(Result):
    """A table of another program as a measurement table, with its mapping.

    Attributes:
        source: the file.
        origin: its name, size and SHA-256.
        layout: its encoding, delimiter and header, in words.
        mapping: the mapping of its columns, given or proposed.
        assumptions: what the proposal assumed; a person must confirm it. Empty for a given mapping.
        findings: signs, order and units of coordinates that seem to be wrong, from the machine's motion.
        notes: further facts.
        columns: cells of the measurement table, by column.
        measurements: the table as `Measurements.load` reads it; None where it is not valid (``notes`` say why).
        remarks: comments for the entries of the mapping file.
        comments: comment lines of the measurement table.
    """

    source: str
    origin: str
    layout: str
    mapping: ColumnMapping
    assumptions: tuple[str, ...]
    findings: tuple[str, ...]
    notes: tuple[str, ...]
    columns: Mapping[str, Sequence[str]]
    measurements: Measurements | None
    remarks: Mapping[str, str]
    comments: tuple[str, ...]

    @property
    def confirmed(self) -> bool:
        """Whether nothing was assumed, or the mapping was given: the table can be written."""
        open_findings = self.findings if self.mapping.path is None else ()
        return self.measurements is not None and not self.assumptions and not open_findings

    @property
    def to_confirm(self) -> tuple[str, ...]:
        """Assumptions and findings, one line each."""
        return (*self.assumptions, *self.findings)

    @property
    def text(self) -> str:
        """The measurement table as CSV."""
        return csv_text(self.columns, comment_lines("\n".join(self.comments), simulated=False))

    @property
    def _warnings(self) -> tuple[SourceWarning, ...]:
        return (SIMULATED,) if self.measurements is not None and self.measurements.simulated else ()

    def save(self, path: str | Path) -> None:
        """Write the measurement table atomically.

        Raises:
            InputError: the mapping has assumptions that were not confirmed.
        """
        if not self.confirmed:
            count = count_with_noun(len(self.to_confirm), "item")
            raise InputError(f"{count} to confirm", expected="a confirmed mapping (save_columns)", file=self.source)
        write_atomic(Path(path), self.text)

    def save_columns(self, path: str | Path, *, next_step: str = "") -> None:
        """Write the mapping, after it was read back, as a commented file that a person confirms or changes.

        Args:
            path: the file to write.
            next_step: the next command, for a comment.
        """
        head = [
            f"Columns of {self.origin}",
            "Proposed by twin import. Check the entries with comments and change what is wrong.",
        ]
        head += [f"Then: {next_step}"] if next_step else []
        head += [f"assumed: {text}" for text in self.assumptions]
        head += [f"finding, not applied: {text}" for text in self.findings]
        text = self.mapping.to_yaml(self.remarks, [printable(line, one_line=True) for line in head])
        write_atomic(Path(path), text, check=self.mapping.check_copy)

    def preview(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Return the columns of the measurement table and its first rows."""
        count = min(PREVIEW_ROWS, len(next(iter(self.columns.values()), ())))
        return tuple(self.columns), [tuple(cells[row] for cells in self.columns.values()) for row in range(count)]

    def to_text(self) -> str:
        """Return origin, columns, first rows, assumptions and findings as text."""
        count = count_with_noun(len(next(iter(self.columns.values()), ())), "row")
        longest = max(map(len, self.columns), default=0)
        origins = [f"  {name.ljust(longest)}  {origin_of(self.mapping, name)}" for name in self.columns]
        lines = [f"{self.source}: {count}; {self.layout}", "", *origins, ""]
        names, rows = self.preview()
        shown = [names, *rows]
        widths = [max(len(row[i]) for row in shown) for i in range(len(names))]
        lines.append("First rows as understood:")
        lines += ["  " + "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in shown]
        for title, texts in (
            ("Assumed", self.assumptions),
            ("Found, not applied", self.findings),
            ("Notes", (*warning_texts(self._warnings), *self.notes)),
        ):
            if texts:
                lines += ["", f"{title}:", *(f"  {text}" for text in texts)]
        return printable("\n".join(lines) + "\n")

    def to_dict(self) -> dict[str, Any]:
        """Return JSON data (``schema: twin.import/1``)."""
        return {
            "schema": "twin.import/1",
            "file": self.source,
            "origin": self.origin,
            "layout": self.layout,
            "written": self.confirmed,
            "rows": len(next(iter(self.columns.values()), ())),
            "mapping": self.mapping.entries.model_dump(by_alias=True, exclude_defaults=True),
            "assumptions": list(self.assumptions),
            "findings": list(self.findings),
            "notes": list(self.notes),
            "warnings": warnings_to_json(self._warnings),
        }

    @property
    def brief(self) -> str:
        """File, number of rows, and what is to be confirmed."""
        rows = count_with_noun(len(next(iter(self.columns.values()), ())), "row")
        return f"{self.source}: {rows}, {count_with_noun(len(self.to_confirm), 'item')} to confirm"


def origin_of(mapping: ColumnMapping, name: str) -> str:
    """Return the origin of a column in words."""
    entries = mapping.entries
    if name in POINT_COLUMNS and entries.spherical is not None:
        return "from angles and distance: " + quoted(entries.spherical.sources)
    if name in POINT_COLUMNS and entries.deviations is not None:
        return f"from deviations in {entries.deviations.unit or 'mm'}: " + quoted(entries.deviations.sources)
    return origin_text(entries.columns.get(name))


def origin_text(entry: OriginEntry | None) -> str:
    """Return the origin of a column in words."""
    if entry is None:
        return "from the plan"
    if entry.source is None:
        return f"{entry.value:g} in all rows" if isinstance(entry.value, float) else f"{entry.value} in all rows"
    text = " and ".join(f"'{source}'" for source in entry.sources)
    text += f" in {entry.unit}" if entry.unit else ""
    text += ", opposite sign" if entry.sign < 0 else ""
    text += f", {entry.offset:+g}" if entry.offset else ""
    text += ", by its words" if entry.words else ""
    return text + (f", form {entry.format}" if entry.format else "")


def _instrument_note(data: Measurements) -> tuple[str, ...]:
    """Return a note of the instrument whose noise the weights of the readings are taken from, if nothing else shows the noise."""
    read = np.isfinite(data.point_mm).any(axis=0)
    shown = np.isfinite(data.u_mm).any() or all(data.instrument) or repeats_dof(data) >= FEWEST_REPEATS
    if shown or np.count_nonzero(read) < 2:
        return ()
    instrument = default_instrument("point", str(data.station_carrier[0]), float(np.nanmax(np.abs(data.point_mm))))
    names = others_alike(instrument)
    other = f", or {' or '.join(names)}" if names else ""
    return (
        f"the file names no instrument and has too few repeats to show the noise: identification will assume a "
        f"{instrument.specification.title}. Name the instrument in the mapping, under columns: "
        f"instrument: {{value: {instrument.name}}}{other}",
    )


def import_table(
    path: str | Path,
    machine: Machine,
    *,
    columns: str | Path | None = None,
    sheet: str | None = None,
    plan: str | Path | None = None,
) -> ImportedTable:
    """Read a table of measured points as another program wrote it: any CSV dialect, or an Excel workbook.

    Args:
        path: the file.
        machine: the machine that was measured.
        columns: mapping file (``twin.columns/1``), applied exactly; None to propose a mapping from the headers.
        sheet: sheet of a workbook; None for the one that the mapping names, or the only one that is not empty.
        plan: plan with the commanded positions, if the file does not give them.

    Raises:
        InputError: with file, line, value and what was expected: the file is not a table or belongs to `twin.convert`, a column
            that the mapping names is missing, a cell cannot be read, or the rows are not those of the plan.

    Examples:
        >>> from twin.samples import TABLES
        >>> machine = twin.Machine.load("dmu50")
        >>> imported = twin.import_table(TABLES[0], machine)
        >>> len(imported.measurements), len(imported.assumptions)
        (420, 0)
        >>> imported.save_columns("columns.yaml")  # check and change this file, then
        >>> twin.import_table(TABLES[0], machine, columns="columns.yaml").save("measured.csv")
    """
    path = Path(path)
    given = None if columns is None else ColumnMapping.load(Path(columns), machine)
    if given is None and (stated := CYCLE_LOG.search(read_bytes(path, most_bytes=MAX_BYTES)[:4000].decode("latin-1"))):
        raise InputError(
            f"a log of SINUMERIK's measurement of kinematics ({stated[0]}), whose lines no public description explains",
            expected="a line `X=… Y=… Z=… A=… C=…` for each measurement, which the program writes (WRITE): the axis positions "
            "with the tip at the sphere's centre; or a program of `twin plan --program`",
            file=path,
        )
    try:
        return _imported(path, machine, given, sheet=sheet, plan=None if plan is None else Path(plan))
    except InputError as error:
        if given is not None:
            raise
        kind = other_format(path, most_bytes=MAX_BYTES)
        other = None if kind else other_kind(read_bytes(path).decode("latin-1"), *TABLES)
        if (
            error.cure is not None and other != "an XML file"
        ):  # rows of letters and numbers may also look like a program
            other = None
        if kind is None and other is None:
            raise
    if kind is None:
        raise InputError(f"{other}, not a table", expected="a table of measured points", file=path)
    what = f"a file of its own format: {kind}"
    raise InputError(what, expected="a table with a header (`twin convert` reads this file)", file=path)


def _imported(
    path: Path, machine: Machine, given: ColumnMapping | None, *, sheet: str | None, plan: Path | None
) -> ImportedTable:
    """Return the imported table; arguments and errors as `import_table`."""
    entries = None if given is None else given.entries
    raw = read_cells(
        path,
        sheet=sheet or (entries.sheet or None if entries is not None else None),
        encoding="" if entries is None else entries.encoding,
        delimiter="" if entries is None else entries.delimiter,
    )
    layout = table_layout(raw, () if entries is None else entries.names)
    rows = None if plan is None else PlanPoints.load(plan, machine)
    complete = given is not None and given.entries.is_complete(machine)
    if given is not None and (given.entries.plan is None) != (rows is None) and (complete or rows is None):
        what = "the mapping takes positions from a plan" if rows is None else "the mapping does not use a plan"
        expected = "the plan" if rows is None else "an entry `plan: {match: order}`"
        line = None if rows is None else "plan: {match: order}"
        raise InputError(what, expected=expected, file=given.path, setting="plan", cure=line)
    if given is None or not complete:
        proposal = proposed(layout, machine, rows, entries)
        return _finished(Applied(layout, proposal.mapping(), machine), rows, proposal)
    return _finished(Applied(layout, given, machine), rows, None)


def _finished(applied: Applied, plan: PlanPoints | None, proposal: Proposal | None) -> ImportedTable:
    mapping, machine = applied.mapping, applied.machine
    cells, unusable = applied.table(plan), applied.set_aside()
    kept = [row for row in range(len(applied.layout.rows)) if row not in unusable]
    if not kept:
        line, why = applied.layout.rows[0][0], unusable[0]
        raise InputError(
            f"no usable row: {why}", expected="a row with all of its values", file=applied.layout.raw.path, line=line
        )
    layout = replace(applied.layout, rows=tuple(applied.layout.rows[row] for row in kept))
    order = [name for part in table_columns(machine) for name in part.columns]
    order += sorted(cells.keys() - {*order})
    cells = {name: [cells[name][row] for row in kept] for name in order if name in cells}
    notices = wrong_columns(machine, unchecked(cells, machine))
    comments = _comments(layout, mapping, cells)
    assumptions = () if proposal is None else tuple(proposal.assumptions)
    notes = [] if proposal is None else list(proposal.notes)
    notes += grouped_notes(
        RowNote(
            applied.layout.rows[row][0],
            Message("set aside, {text}", text=why),
            Message("set aside, a value is missing"),
        )
        for row, why in unusable.items()
    )
    measurements: Measurements | None = None
    try:
        measurements = _read_back(cells, comments, layout, machine)
    except InputError as error:
        if not assumptions and not notices:
            raise
        if not notices:
            notes.append(f"not a valid measurement table yet: {error}")
    if measurements is not None:
        notes += [
            *measurements.notices,
            *_instrument_note(measurements),
            *(f"line {one.line}: set aside, {one.text}" for one in measurements.set_aside[:5]),
        ]
    raw = layout.raw
    parts = [
        f"sheet {raw.sheet}" if raw.sheet else f"{raw.encoding}, delimiter {raw.delimiter}",
        f"decimal {mapping.entries.decimal}",
    ]
    parts.append(f"header in line {layout.header_line}" if layout.header_line else "no header")
    return ImportedTable(
        source=str(raw.path),
        origin=raw.origin,
        layout=", ".join(parts),
        mapping=mapping,
        assumptions=assumptions,
        findings=tuple(notice.text for notice in notices),
        notes=tuple(notes),
        columns=cells,
        measurements=measurements,
        remarks={} if proposal is None else _remarks(proposal, notices),
        comments=tuple(comments),
    )


def _remarks(proposal: Proposal, found: Sequence[ColumnChange]) -> dict[str, str]:
    """Return the comments for the entries of a mapping file: assumptions and findings."""
    remarks = dict(proposal.remarks)
    for one in found:
        for name in one.columns:
            remarks[name] = f"{remarks[name]}; {one.advice}" if name in remarks else one.advice
    return remarks


def _comments(layout: Layout, mapping: ColumnMapping, cells: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the comments of the measurement table: origin, mapping, and comments and titles of the file."""
    says = [_stated(text, text) for text in layout.raw.comments[:MAX_COMMENTS]]
    says += [_stated(text, f"the file says: {text}") for text in layout.titles[:MAX_COMMENTS]]
    by = "a proposed mapping without assumptions" if mapping.path is None else f"the mapping {mapping.path.name}"
    origins = [f"{name}: {origin_of(mapping, name)}" for name in cells]
    lines = [f"imported from {layout.raw.origin}, with {by}", *_date(layout, mapping), *origins, *says]
    return [printable(line, one_line=True) for line in lines]


def _date(layout: Layout, mapping: ColumnMapping) -> list[str]:
    """Return the comment with the date of the first row, if the file gives dates."""
    entry = mapping.entries.columns.get(TIME)
    if entry is None or entry.format is None or not (entry.format == "iso" or "%y" in entry.format.lower()):
        return []
    moment = moment_in(" ".join(layout.column(source)[0] for source in entry.sources), entry.format)
    return [] if moment is None else [f"measured {moment:%Y-%m-%d %H:%M}"]


def _stated(text: str, otherwise: str) -> str:
    """Return a comment or title of the file as a comment of the table; one that states simulated readings keeps that meaning."""
    if text.lower().startswith(SIMULATED_WORD):
        return text
    return f"{SIMULATED_WORD} readings: {text}" if SIMULATION.search(text) else otherwise


def _read_back(
    cells: Mapping[str, Sequence[str]], comments: Sequence[str], layout: Layout, machine: Machine
) -> Measurements:
    """Return the table as the project's reader reads it, with the lines and the name of the file.

    Raises `InputError`: about the file, as `Measurements.load`.
    """
    head = comment_lines("\n".join(comments), simulated=False)
    first = head.count("\n") + 2
    with scratch_folder() as folder:
        made = folder / "measured.csv"
        made.write_text(csv_text(cells, head), encoding="utf-8")
        try:
            measurements = Measurements.load(made, machine)
        except InputError as error:
            line = (
                None
                if error.line is None
                else layout.rows[max(0, error.line - first)][0]
                if error.line >= first
                else None
            )
            raise InputError(
                error.what,
                expected=error.expected,
                file=layout.raw.path,
                line=line,
                value=error.value,
                nearest=error.nearest,
            ) from error
    origin = np.array([line for line, _ in layout.rows])
    return replace(
        measurements,
        source=str(layout.raw.path),
        lines=read_only(origin[measurements.lines - first]),
        set_aside=tuple(replace(one, line=int(origin[one.line - first])) for one in measurements.set_aside),
    )
