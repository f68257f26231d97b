"""Measured data of other programs as measurement tables: contacts of a probe, ball bar, interferometer, tracker.

Manual: `twin doc convert`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common import families
from twin._common.arrays import read_only
from twin._common.errors import InputError, require_name
from twin._common.files import read_bytes
from twin._common.provenance import SIMULATED, SourceWarning, warning_texts, warnings_to_json
from twin._common.units import count_with_noun
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.measurement.columns import check_ranges
from twin.measurement.contacts import SphereCentre
from twin.measurement.formats.base import MAX_BYTES, Conversion, FormatSpecification, Given, MeasuredFormat
from twin.measurement.formats.tracker import TrackerExport
from twin.measurement.table import Measurements

FORMATS: Final[tuple[MeasuredFormat, ...]] = families.members("twin.measurement.formats", families.MEASURED_FORMATS)
"""All formats."""


@final
@dataclass(frozen=True, repr=False)
class ConvertedFiles(Result):
    """A measurement table made from files of another program.

    ``notes``: assumptions (they begin with ``assumed``) and findings, one sentence each; ``centres``: sphere centres with their
    covariances, if the files have single contacts; ``origins``: names, sizes and SHA-256 of the files.
    """

    specification: FormatSpecification
    measurements: Measurements
    notes: tuple[str, ...]
    centres: tuple[SphereCentre, ...]
    origins: tuple[str, ...]

    @property
    def _warnings(self) -> tuple[SourceWarning, ...]:
        return (SIMULATED,) if self.measurements.simulated else ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Assumptions, findings, and the parts of the format that are not verified, one line each."""
        warnings = warning_texts(self._warnings)
        return (*warnings, *self.notes, *(f"not verified: {text}" for text in self.specification.unverified))

    @property
    def comment(self) -> str:
        """Comment lines for the table: origin, assumptions, what is not verified."""
        origins = [f"converted from {origin}" for origin in self.origins]
        return "\n".join((*origins, *self.remarks))

    def save(self, path: str | Path, machine: Machine) -> None:
        """Write the table atomically, with its origin in comments."""
        self.measurements.save(path, machine, comment=self.comment)

    @property
    def brief(self) -> str:
        """Format, numbers of rows and rounds, and what the rows are."""
        rounds = count_with_noun(len(dict.fromkeys(self.measurements.round)), "round")
        rows = count_with_noun(len(self.measurements), "row")
        return f"{self.specification.title}: {rows}, {rounds}; {self.specification.gives}"

    def to_text(self) -> str:
        """Return rows, assumptions and what is not verified as text."""
        lines = [self.brief, *(f"  {text}" for text in self.remarks)]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return JSON data (``schema: twin.conversion/1``)."""
        return {
            "schema": "twin.conversion/1",
            "format": self.specification.name,
            "instrument": self.specification.instrument,
            "files": list(self.origins),
            "rows": len(self.measurements),
            "notes": list(self.notes),
            "not_verified": list(self.specification.unverified),
            "centres": [centre.to_dict() for centre in self.centres],
            "warnings": warnings_to_json(self._warnings),
        }


def format_named(name: str) -> MeasuredFormat:
    """Return the format of that name. Raises `InputError`: there is no such format."""
    names = [form.name for form in FORMATS]
    require_name("format of measured data", name, names)
    return FORMATS[names.index(name)]


def other_format(path: Path, *, most_bytes: int = MAX_BYTES) -> str | None:
    """Return the title of the format of a file that is not a table with a header of its own; None if it is a table.

    Raises `InputError`: it cannot be read.
    """
    text = read_bytes(path, most_bytes=most_bytes).decode("latin-1").removeprefix("\xef\xbb\xbf")
    fitting = [form.specification for form in FORMATS if form.recognises(text)]
    return next((one.title for one in fitting if one.name != TrackerExport.specification.name), None)


def format_of(path: Path) -> MeasuredFormat:
    """Return the format of a file, by its content and, where several fit, by its suffix.

    Raises `InputError`: it cannot be read, or no format or several fit.
    """
    text = read_bytes(path, most_bytes=MAX_BYTES).decode("latin-1").removeprefix("\xef\xbb\xbf")
    fitting = [form for form in FORMATS if form.recognises(text)]
    by_suffix = [form for form in fitting if path.suffix.lower() in form.specification.suffixes]
    chosen = fitting if len(fitting) == 1 else by_suffix
    if len(chosen) != 1:
        names = ", ".join(form.name for form in fitting or FORMATS)
        what = "several formats fit" if fitting else "no known format of measured data"
        tables = "" if fitting else " (`twin import` reads tables with columns of any name)"
        raise InputError(what, expected=f"one of {names}{tables}", file=path, setting="format")
    return chosen[0]


def convert(
    paths: str | Path | Sequence[str | Path],
    machine: Machine,
    given: Given | None = None,
    *,
    format_name: str | None = None,
) -> ConvertedFiles:
    """Return the measurement table of files of another program.

    Args:
        paths: a file, or several of one format; each then has its own rounds.
        machine: the machine that was measured.
        given: what the files do not say; None for nothing.
        format_name: name of their format; None to recognise it.

    Raises:
        InputError: with file, line, value and what was expected, as `MeasuredFormat.read`; files of different formats; positions with a
            constant offset from the machine's range.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> away = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]])  # contacts around a sphere
        >>> rows = np.column_stack([[250, 225, -200] + 15.0 * away, np.zeros((5, 2))])
        >>> header = "contact_x_mm,contact_y_mm,contact_z_mm,B_deg,C_deg"
        >>> np.savetxt("contacts.csv", rows, delimiter=",", header=header, comments="")
        >>> twin.convert("contacts.csv", machine).measurements.positions.round(3)
        array([[ 250.,  225., -200.,    0.,    0.]])

    References:
        - A. B. Forbes: Least-squares best-fit geometric elements, NPL report DITC 140/89, 1989 (spheres through single contacts).
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    if not files:
        raise InputError("no file", expected="one or more files of one format")
    given = Given() if given is None else given
    given.check(machine)
    forms = [format_of(path) if format_name is None else format_named(format_name) for path in files]
    for path, form in zip(files, forms, strict=True):
        if form is not forms[0]:
            raise InputError("files of different formats", expected=forms[0].name, file=path, value=form.name)
    conversions = [
        _with_round(form.read(path, machine, given, str(k)), str(k), several=len(files) > 1)
        for k, (path, form) in enumerate(zip(files, forms, strict=True), start=1)
    ]
    for own in (conversion.measurements for conversion in conversions):
        check_ranges(machine.axes, own.positions, own.lines, own.source)
    table = Measurements.join([conversion.measurements for conversion in conversions])
    named = np.full(len(table), forms[0].specification.instrument, dtype=object)
    return ConvertedFiles(
        forms[0].specification,
        replace(table, instrument=read_only(named)),
        tuple(dict.fromkeys(note for conversion in conversions for note in conversion.notes)),
        tuple(centre for conversion in conversions for centre in conversion.centres),
        tuple(_origin(path) for path in files),
    )


def _with_round(one: Conversion, name: str, *, several: bool) -> Conversion:
    """Return a conversion whose rounds are different from those of the other files."""
    table = one.measurements
    if not several or np.all(table.round == name):
        return one
    rounds = np.array([f"{name}.{own}" for own in table.round], dtype=object)
    return replace(one, measurements=replace(table, round=read_only(rounds)))


def _origin(path: Path) -> str:
    data = read_bytes(path, most_bytes=MAX_BYTES)
    return f"{path.name}, {len(data)} bytes, SHA-256 {sha256(data).hexdigest()[:16]}"


__all__ = [
    "FORMATS",
    "Conversion",
    "ConvertedFiles",
    "FormatSpecification",
    "Given",
    "MeasuredFormat",
    "convert",
    "format_named",
    "format_of",
    "other_format",
]
