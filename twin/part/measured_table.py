"""Tables of measured points as programs of coordinate measuring machines export them: CSV or Excel.

Points in rows: feature, nominal and measured x, y, z. Characteristics in rows: feature, the axis (X, Y, Z) and one nominal and one
measured value, as in reports of PC-DMIS (AX, NOMINAL, MEAS) and tables of Calypso (the axis in the name of the characteristic).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import count_with_noun
from twin.measurement.columns import simulated_comments
from twin.measurement.importing.cells import Layout, layout_of, read_cells
from twin.measurement.importing.quantities import ROLES as WORDS
from twin.measurement.importing.quantities import decimal_sign, plain_words, quantity_in, unit_named, without_unit

ROLES: Final[Mapping[str, frozenset[str]]] = {
    "nominal": WORDS["command"],
    "measured": WORDS["measured"],
    "normal": frozenset("normal normale vector vektor".split()),
    "u": frozenset("u uncertainty unsicherheit".split()),
}
NAMES: Final[Mapping[str, frozenset[str]]] = {
    "feature": frozenset(
        ("feature", "feature name", "element", "elementname", "name", "feature id", "characteristic", "merkmal")
    ),
    "axis": frozenset(("axis", "ax", "achse", "coordinate")),
    "engagement": frozenset(("engagement", "eingriff", "radial depth")),
}
AXES: Final = "xyz"
_VECTOR: Final = {"i": "x", "j": "y", "k": "z"}
_AXIS_IN_NAME: Final = (
    re.compile(r"(?P<axis>[XYZ])(?:[ _-]*(?:value|wert|coordinate|koordinate))?[ _:./-]+(?P<name>.+)", re.IGNORECASE),
    re.compile(r"(?P<name>.+?)[ _:./-]+(?P<axis>[XYZ])(?:[ _-]*(?:value|wert|coordinate|koordinate))?", re.IGNORECASE),
)
_SIZE: Final = re.compile(
    r"d|df|dm|diam.*|durchm.*|r|radius|form|tp|.*(?:diameter|durchmesser|radius|form|ebenheit|flatness).*", re.I
)
NONE: Final = (np.nan, np.nan, np.nan)


@final
@dataclass(frozen=True)
class MeasuredPoint:
    """A point of a feature; NaN for what the table does not give.

    Attributes:
        line: of the file.
        nominal_mm, measured_mm: (3,) in the part's frame.
        normal: (3,) outward normal.
        u_mm: standard uncertainty of a coordinate.
        engagement_mm: width of cut at which the surface was finished.
    """

    line: int
    feature: str
    nominal_mm: tuple[float, float, float] = NONE
    measured_mm: tuple[float, float, float] = NONE
    normal: tuple[float, float, float] = NONE
    u_mm: float = np.nan
    engagement_mm: float = np.nan


@final
@dataclass(frozen=True)
class MeasuredTable:
    """A table of measured points. ``stated``: whether the file names its unit of length; ``notes``: what was not used."""

    path: Path
    points: tuple[MeasuredPoint, ...]
    stated: bool
    simulated: bool
    origin: str
    notes: tuple[str, ...] = field(default=())


def read_measured(path: Path, sheet: str | None = None) -> MeasuredTable:
    """Read the measured points of a file.

    Raises:
        InputError: with file, line and value: not a table; no column for the feature, or none for nominal or measured coordinates; two
            columns for one thing; two units of length; a cell that is not a number.
    """
    layout = layout_of(read_cells(path, sheet=sheet))
    columns = _columns(layout)
    sign = decimal_sign(cell for name in columns.values() for cell in layout.column(name[0])).sign
    reader = _Cells(layout, columns, sign)
    if "feature" not in columns:
        raise _missing(layout, "the feature's name", "feature (name, element, characteristic)")
    wide = any(f"measured {axis}" in columns for axis in AXES)
    if not wide and ("measured" not in columns or "nominal" not in columns):
        raise _missing(
            layout,
            "measured coordinates",
            "measured x, y, z (meas, actual, ist), with nominal x, y, z; or axis, nominal and measured",
        )
    points, skipped = reader.points() if wide else reader.characteristics()
    if not points:
        raise InputError("no measured point", expected="X, Y or Z of a feature in a row", file=path)
    notes = [f"not used: {count_with_noun(skipped, 'row')} of diameters, forms and other sizes"] if skipped else []
    said = [*layout.titles, *layout.raw.comments]
    return MeasuredTable(
        path, tuple(points), reader.stated(said), bool(simulated_comments(said)), layout.raw.origin, tuple(notes)
    )


def _missing(layout: Layout, what: str, expected: str) -> InputError:
    return InputError(
        f"no column for {what}",
        expected=expected,
        file=layout.raw.path,
        line=layout.header_line or layout.raw.rows[0][0],
        value=", ".join(layout.names),
    )


def _columns(layout: Layout) -> dict[str, tuple[str, str]]:
    """Return the column of each meaning, and the unit in its header."""
    found: dict[str, tuple[str, str]] = {}
    for name, below in zip(layout.names, layout.units, strict=True):
        text, unit = without_unit(name)
        meaning = _meaning(text)
        if not meaning:
            continue
        if meaning in found:
            raise InputError(
                f"two columns for {meaning}",
                expected="one of them",
                file=layout.raw.path,
                line=layout.header_line or None,
                value=f"{found[meaning][0]}, {name}",
            )
        found[meaning] = name, unit or below
    return found


def _meaning(header: str) -> str:
    """Return what a header means: ``nominal x``, ``measured``, ``normal z``, ``u``, ``feature``, ``axis``; empty if unknown."""
    text = " ".join(re.findall(r"[a-z0-9]+", plain_words(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", header))))
    for kind, names in NAMES.items():
        if text in names or header.strip().lower() in names:
            return kind
    if text in _VECTOR:
        return f"normal {_VECTOR[text]}"
    words = []
    for word in text.split():
        known = frozenset().union(*ROLES.values())
        if len(word) > 1 and word[0] in AXES and word[1:] in known:
            words += [word[0], word[1:]]
        elif len(word) > 1 and word[-1] in AXES and word[:-1] in known:
            words += [word[-1], word[:-1]]
        elif re.fullmatch("n[xyz]", word):
            words += [word[1], "normal"]
        else:
            words.append(word)
    axis = [word for word in words if word in AXES]
    roles = [role for role, own in ROLES.items() if own & {*words}]
    rest = [word for word in words if word not in AXES and not any(word in own for own in ROLES.values())]
    if rest or len(roles) != 1 or len(axis) > 1:
        return ""
    return f"{roles[0]} {axis[0]}" if axis else roles[0]


@final
class _Cells:
    """The cells of a layout by their meaning; numbers in mm."""

    def __init__(self, layout: Layout, columns: Mapping[str, tuple[str, str]], sign: str) -> None:
        self.layout, self.columns, self.sign = layout, columns, sign
        self._text = {meaning: layout.column(name) for meaning, (name, _) in columns.items()}
        self.units: dict[str, str] = {}

    def stated(self, said: Sequence[str]) -> bool:
        """Return whether a unit of length is stated; `InputError` for inches in a title beside numbers without a unit."""
        texts = " ".join(said)
        title = re.search(r"\bunits?\s*[=:]\s*(\w+)", texts, re.IGNORECASE)
        if title and not self.units and unit_named(title[1], "x_mm") is not unit_named("mm", "x_mm"):
            raise InputError(
                "the file states another unit than millimetres",
                expected="coordinates in mm, or the unit in the header of each column",
                file=self.layout.raw.path,
                value=title[0],
            )
        return bool(self.units) or title is not None

    def number(self, meaning: str, row: int) -> float:
        """Return a number, in mm for a length; NaN for an empty cell or no such column."""
        if meaning not in self.columns or not (cell := self._text[meaning][row].strip()):
            return np.nan
        name, unit = self.columns[meaning]
        found, length = quantity_in(cell, self.sign), not meaning.startswith("normal")
        line = self.layout.rows[row][0]
        if found is None:
            raise InputError(
                f"column {name}: not a number", expected="a number", file=self.layout.raw.path, line=line, value=cell
            )
        if not length:
            return float(found.value)
        if unit or found.unit:
            self.units[meaning] = unit or found.unit
        value = found.to_table("x_mm", unit or None)
        if value is None:
            raise InputError(
                f"column {name}: unknown or contradicting unit",
                expected="mm, µm or inch",
                file=self.layout.raw.path,
                line=line,
                value=f"{cell} {unit}".strip(),
            )
        return float(value)

    def three(self, role: str, row: int) -> tuple[float, float, float]:
        """Return x, y and z of a role."""
        x, y, z = (self.number(f"{role} {axis}", row) for axis in AXES)
        return x, y, z

    def points(self) -> tuple[list[MeasuredPoint], int]:
        """Return the points of a table with one row for each, and the number of rows without a coordinate."""
        points, skipped = [], 0
        for row, (line, _) in enumerate(self.layout.rows):
            measured = self.three("measured", row)
            if not np.isfinite(measured).any():
                skipped += 1
                continue
            points.append(
                MeasuredPoint(
                    line,
                    self._text["feature"][row],
                    self.three("nominal", row),
                    measured,
                    self.three("normal", row),
                    self.number("u", row),
                    self.number("engagement", row),
                )
            )
        return points, skipped

    def characteristics(self) -> tuple[list[MeasuredPoint], int]:
        """Return the points of a table with one row for each coordinate, and the number of rows of sizes.

        A coordinate that was given already begins the next point of its feature.
        """
        values: list[tuple[int, str, dict[str, tuple[float, float]], float]] = []
        skipped = 0
        for row, (line, _) in enumerate(self.layout.rows):
            name, axis = self._axis(row)
            if not axis:
                skipped += 1
                continue
            if not values or values[-1][1] != name or axis in values[-1][2]:
                values.append((line, name, {}, self.number("u", row)))
            values[-1][2][axis] = self.number("nominal", row), self.number("measured", row)
        points = []
        for line, name, by_axis, u in values:
            both = np.array([by_axis.get(axis, (np.nan, np.nan)) for axis in AXES])
            nominal, measured = (tuple(map(float, column)) for column in both.T)
            points.append(MeasuredPoint(line, name, nominal, measured, u_mm=u))  # type: ignore[arg-type]
        return points, skipped

    def _axis(self, row: int) -> tuple[str, str]:
        """Return the feature of a row, and its axis; empty if it is a size.

        Raises `InputError`: neither the axis's column nor the name says which coordinate it is.
        """
        name, line = self._text["feature"][row], self.layout.rows[row][0]
        if "axis" in self.columns:
            word = self._text["axis"][row].strip().lower()
            if word in (*AXES, "") or _SIZE.fullmatch(word):
                return name, word if word in AXES else ""
            raise InputError(
                "unknown axis",
                expected="X, Y or Z, or a size such as D",
                file=self.layout.raw.path,
                line=line,
                value=word,
            )
        for pattern in _AXIS_IN_NAME:
            if match := pattern.fullmatch(name):
                return match["name"], match["axis"].lower()
        if _SIZE.fullmatch(name):
            return name, ""
        raise InputError(
            "which coordinate this characteristic is, is not known",
            expected="a column with the axis, or a name such as `X Value_Circle 1` or `Circle 1.X`",
            file=self.layout.raw.path,
            line=line,
            value=name,
        )
