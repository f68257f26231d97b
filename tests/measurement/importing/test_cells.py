"""Decimal signs, headers, units and encodings one by one; the expected values are written down, not computed."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import pytest

import twin
from twin.measurement.importing.cells import layout_of, read_cells
from twin.measurement.importing.quantities import decimal_sign, decimal_value, direction_of, meaning_of, unit_named


@pytest.mark.parametrize(
    ("cell", "point", "comma"),
    [
        ("1,234", "1234", "1.234"),
        ("1.234,5", None, "1234.5"),
        ("1,234.5", "1234.5", None),
        ("1'234.5", "1234.5", None),
        ("1\u202f234,5", None, "1234.5"),
        ("−3.25", "-3.25", None),
        ("+.5", "0.5", None),
        ("1e-3", "0.001", "0.001"),
        ("1,23,4", None, None),
        ("12:30", None, None),
        ("24.11.2026", None, None),
        ("-", None, None),
        ("e99", None, None),
        ("٣", None, None),
    ],
)
def test_numbers(cell: str, point: str | None, comma: str | None) -> None:
    assert decimal_value(cell, ".") == (None if point is None else Decimal(point))
    assert decimal_value(cell, ",") == (None if comma is None else Decimal(comma))


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["1.234,5"], (",", "", "")),
        (["1,234.5"], (".", "", "")),
        (["1,234", "2,345"], (",", "1,234", "")),
        (["0,234"], (",", "", "")),
        (["1.234", "0,5"], (",", "1.234", "")),
        (["0.5", "0,5"], (",", "", "0.5")),
        (["12", "x"], (".", "", "")),
    ],
)
def test_decimal_signs(cells: list[str], expected: tuple[str, str, str]) -> None:
    assert tuple(decimal_sign(cells)) == expected


@pytest.mark.parametrize(
    ("header", "kind", "name", "unit", "certain"),
    [
        ("X-Soll [mm]", "command", "X", "mm", True),
        ("Sollwert X in mm", "command", "X", "mm", True),
        ("Nom. X", "command", "X", "", True),
        ("XIst (mm)", "measured", "X", "mm", True),
        ("Xmeas", "measured", "X", "", True),
        ("Actual Y (in)", "measured", "Y", "in", True),
        ("C-Achse [°]", "bare", "C", "°", True),
        ("Tisch B", "bare", "B", "", True),
        ("Messung B", "bare", "B", "", False),
        ("X Offset", "", "X", "", True),
        ("X-Soll korrigiert", "command", "X", "", False),
        ("dX", "deviation", "X", "", True),
        ("Abweichung X", "deviation", "X", "", True),
        ("Unsicherheit Z [µm]", "uncertainty", "Z", "µm", True),
        ("Temperatur Bett °C", "temperature", "bett", "°C", True),
        ("Richtung X", "approach", "X", "", True),
        ("Messpunkt", "point", "point", "", True),
        ("Point Name", "point", "point", "", True),
        ("Reflektor", "target", "target", "", True),
        ("Lfd. Nr.", "index", "index", "", True),
        ("Datum/Uhrzeit", "datetime", "datetime", "", True),
        ("Drehzahl [1/min]", "spindle_rpm", "spindle_rpm", "1/min", True),
        ("X_mm", "exact", "X_mm", "", True),
        ("u_x_mm", "exact", "u_x_mm", "", True),
        ("Farbe", "", "", "", True),
    ],
)
def test_headers(header: str, kind: str, name: str, unit: str, certain: bool) -> None:
    assert tuple(meaning_of(header, twin.Machine.load("dmu50"))) == (kind, name, unit, certain)


@pytest.mark.parametrize(
    ("unit", "value", "expected"),
    [
        ("inch", "1", "25.4"),
        ("µm", "4.5", "0.0045"),
        ("m", "0.0001", "0.1"),
        ("arcsec", "3600", "1"),
        ("°F", "68", "20"),
        ("K", "293.15", "20"),
        ("mrad", "1000", "57.2957795130823"),
        ("min", "1.5", "90"),
    ],
)
def test_units(unit: str, value: str, expected: str) -> None:
    found = unit_named(unit)
    assert found is not None and found.to_table(Decimal(value)) == Decimal(expected)


def test_directions() -> None:
    assert [direction_of(word) for word in ("+", "up", "vorwärts", "−", "Rückwärts", "0", "", "schnell")] == [
        1,
        1,
        1,
        -1,
        -1,
        0,
        0,
        None,
    ]


def test_code_page_and_quotes(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes('Titel – „A“\r\nX;"Y ""oben""\nzwei"\r\n0,5;1,5\r\n\r\n2;3\r\nEnde\r\n'.encode("cp1252"))
    raw = read_cells(path)
    assert raw.encoding == "cp1252" and raw.delimiter == "semicolon"
    layout = layout_of(raw)
    assert layout.titles == ("Titel – „A“",) and layout.names == ("X", 'Y "oben" zwei')
    assert layout.rows == ((4, ("0,5", "1,5")), (6, ("2", "3"))) and layout.left_out == ((7, "Ende"),)
    assert layout.header_line == 2
