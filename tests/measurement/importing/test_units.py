"""Every unit and every pair of options of a mapping, against SciPy's constants and a computation written out here.

No table of factors is shared with `twin`: what a unit is comes from `scipy.constants` or from its definition.
"""

from __future__ import annotations

from decimal import Decimal
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy import constants as si

from twin.machine.machine import Machine
from twin.measurement.importing.apply import Applied
from twin.measurement.importing.cells import layout_of, read_cells
from twin.measurement.importing.mapping import ColumnMapping
from twin.measurement.importing.quantities import UNITS, table_unit, unit_named, units_of

DEG = 1.0 / si.degree
"""Degrees per radian."""
EXPECTED: dict[str, tuple[str, float, float]] = {
    "mm": ("mm", 1.0, 0.0),
    "m": ("mm", 1.0 / si.milli, 0.0),
    "cm": ("mm", si.centi / si.milli, 0.0),
    "um": ("mm", si.micro / si.milli, 0.0),
    "nm": ("mm", si.nano / si.milli, 0.0),
    "inch": ("mm", si.inch / si.milli, 0.0),
    "deg": ("deg", 1.0, 0.0),
    "rad": ("deg", DEG, 0.0),
    "mrad": ("deg", si.milli * DEG, 0.0),
    "urad": ("deg", si.micro * DEG, 0.0),
    "gon": ("deg", 360.0 / 400.0, 0.0),
    "arcmin": ("deg", si.arcmin * DEG, 0.0),
    "arcsec": ("deg", si.arcsec * DEG, 0.0),
    "degC": ("degC", 1.0, 0.0),
    "degF": ("degC", si.degree_Fahrenheit, float(si.convert_temperature(0.0, "F", "C"))),
    "K": ("degC", 1.0, -si.zero_Celsius),
    "s": ("s", 1.0, 0.0),
    "ms": ("s", si.milli, 0.0),
    "min": ("s", si.minute, 0.0),
    "h": ("s", si.hour, 0.0),
    "rpm": ("rpm", 1.0, 0.0),
    "mm/min": ("mm_min", 1.0, 0.0),
    "m/min": ("mm_min", 1.0 / si.milli, 0.0),
    "kg": ("kg", 1.0, 0.0),
    "g": ("kg", si.gram, 0.0),
}
"""Table unit, size of one of it in table units, and its zero there."""
WORDS = {
    "mm": "mm MM millimeter millimetre millimeters millimetres millimètre millimètres",
    "m": "m M meter metre meters metres Metern mètre mètres",
    "cm": "cm centimeter centimetre centimeters centimetres Zentimeter",
    "um": "um µm μm micron microns Mikrometer my micrometer micrometre micrometers micrometres",
    "nm": "nm",
    "inch": "inch in inches Zoll pouce pouces \"",
    "deg": "deg ° º degree degrees Grad degré degrés dd",
    "gon": "gon gons gradian gradians grads Neugrad",
    "rad": "rad radian radians radiant",
    "mrad": "mrad",
    "urad": "urad µrad μrad",
    "arcmin": "arcmin ' ′",
    "arcsec": "arcsec '' ″ arcsecond arcseconds Bogensekunden",
    "degC": "degC °C ºC Celsius c",
    "degF": "degF °F Fahrenheit f",
    "K": "K k Kelvin",
    "s": "s sec sek seconds Sekunden",
    "ms": "ms",
    "min": "min minutes Minuten",
    "h": "h hours Stunden Std",
    "rpm": "rpm 1/min U/min min-1 rev/min min^-1",
    "mm/min": "mm/min mm_min",
    "m/min": "m/min",
    "kg": "kg",
    "g": "g",
}  # fmt: skip
COLUMN = {"mm": "x_mm", "deg": "C_deg", "degC": "T_bed_degC", "s": "time_s", "rpm": "spindle_rpm", "kg": "load_kg"} | {
    "mm_min": "feed_mm_min"
}
"""A column of each table unit."""


def test_the_vocabulary_of_units_is_the_one_tested() -> None:
    assert {unit.name for unit in UNITS if not unit.packed} == set(EXPECTED) == set(WORDS)
    assert {word.casefold() for unit in UNITS if not unit.packed for word in unit.words} <= {
        word.casefold() for words in WORDS.values() for word in words.split()
    }


@pytest.mark.parametrize("name", EXPECTED)
def test_every_unit_has_its_size(name: str) -> None:
    end, factor, zero = EXPECTED[name]
    for word in WORDS[name].split():
        unit = unit_named(f" {word} ")
        assert unit is not None and unit.name == name and unit.table_unit == end, word
        for value in ("0", "1", "-40", "1234.5678"):
            # Fifteen digits of the largest number that occurs in the conversion.
            size = max(abs(float(value) * factor), abs(zero), 1e-300)
            assert abs(float(unit.to_table(Decimal(value))) - (float(value) * factor + zero)) <= 1e-14 * size, word


@pytest.mark.parametrize("end", COLUMN)
def test_a_column_takes_the_units_of_its_quantity_only(end: str) -> None:
    assert table_unit(COLUMN[end]) == end
    assert {unit.name for unit in units_of(COLUMN[end]) if not unit.packed} == {
        name for name, (own, _, _) in EXPECTED.items() if own == end
    }


OPTIONS = {"unit": "unit: {unit}", "sign": "sign: -1", "offset": "offset: -12.75"}
"""Options of a column of numbers, as they are written in a mapping."""


def applied(machine: Machine, folder: Path, column: str, options: str, cells: list[str], decimal: str) -> list[float]:
    """Return the cells of one column of the measurement table, made from a column of a file with some options."""
    sign = "," if decimal == "comma" else "."
    rows = [f"{k}{sign}5;{k};{cell.replace('.', sign)}" for k, cell in enumerate(cells)]
    (folder / "shop.csv").write_text("\n".join(["X_mm;Y_mm;raw", *rows]) + "\n")
    mapping = ["schema: twin.columns/1", f"decimal: {decimal}", "columns:", f"  {column}: {{from: raw{options}}}"]
    (folder / "map.yaml").write_text("\n".join(mapping) + "\n")
    layout = layout_of(read_cells(folder / "shop.csv"))
    (made,) = Applied(layout, ColumnMapping.load(folder / "map.yaml", machine), machine).columns().values()
    return [float(cell) if cell else np.nan for cell in made]


@pytest.mark.parametrize("decimal", ["point", "comma"])
@pytest.mark.parametrize(("column", "unit"), [(COLUMN[end], name) for name, (end, _, _) in EXPECTED.items()])
def test_every_pair_of_options_acts_in_one_order(
    dmu50: Machine, tmp_path: Path, column: str, unit: str, decimal: str
) -> None:
    """The number is read, converted, mirrored and shifted, in this order: the offset is in the table's unit and is not mirrored."""
    _, factor, zero = EXPECTED[unit]
    cells = ["0.5", "", "-0.25", "1250.125"]
    for some in (some for count in range(len(OPTIONS) + 1) for some in combinations(OPTIONS, count)):
        options = "".join(f", {OPTIONS[name].format(unit=unit)}" for name in some)
        size, start = (factor, zero) if "unit" in some else (1.0, 0.0)
        mirror, offset = (-1.0 if "sign" in some else 1.0), (-12.75 if "offset" in some else 0.0)
        expected = [mirror * (float(cell) * size + start) + offset if cell else np.nan for cell in cells]
        made = applied(dmu50, tmp_path, column, options, cells, decimal)
        # Fifteen digits of the largest number in the sum.
        np.testing.assert_allclose(made, expected, rtol=1e-14, atol=1e-12, err_msg=options)


def test_a_unit_is_that_of_the_table_if_none_is_given(dmu50: Machine, tmp_path: Path) -> None:
    for column in COLUMN.values():
        assert applied(dmu50, tmp_path, column, "", ["3.5", "-2"], "point") == [3.5, -2.0]


def test_words_and_sign_of_a_direction(dmu50: Machine, tmp_path: Path) -> None:
    """`words` say what a cell means and precede the vocabulary; `sign` mirrors the meaning; none stays none."""
    meaning = {"rauf": 1, "runter": -1, "up": -1, "+": 1, "-": -1, "0": 0, "": 0}
    for sign in (1, -1):
        options = f", words: {{rauf: 1, runter: -1, up: -1}}, sign: {sign}"
        found = applied(dmu50, tmp_path, "approach_X", options, list(meaning), "point")
        assert found == [sign * value for value in meaning.values()]


def test_dates_count_in_seconds_from_the_first_row(dmu50: Machine, tmp_path: Path) -> None:
    cells = ["02.03.2026 23:59:30", "", "03.03.2026 00:00:45", "02.03.2026 23:59:30"]
    found = applied(dmu50, tmp_path, "time_s", ", format: '%d.%m.%Y %H:%M:%S'", cells, "point")
    np.testing.assert_array_equal(found, [0.0, np.nan, 75.0, 0.0])
    found = applied(
        dmu50,
        tmp_path,
        "time_s",
        ", format: '%m/%d/%Y %I:%M %p'",
        ["03/02/2026 11:59 AM", "03/02/2026 12:01 PM"],
        "point",
    )
    assert found == [0.0, 120.0]


def test_degrees_minutes_and_seconds_in_one_number() -> None:
    """45.3030 is 45° 30′ 30″; the sign belongs to the whole; nothing has 60 minutes or seconds."""
    (unit,) = (unit for unit in UNITS if unit.packed)
    for word in ("D.MMSS", "DMS", "g.mmss"):
        assert unit_named(word, "C_deg") is unit
    for text, seconds in (
        ("45.3030", 45 * 3600 + 1830),
        ("-0.00305", -30.5),
        ("359.595999", 359 * 3600 + 59 * 60 + 59.99),
    ):
        value = unit.to_table(Decimal(text))
        assert value is not None and float(value) == pytest.approx(seconds / 3600, abs=1e-12)
    assert unit.to_table(Decimal("10.60")) is None and unit.to_table(Decimal("10.0060")) is None
