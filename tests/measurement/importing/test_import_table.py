"""Tables of other programs give the same measurement table in every dialect; what is not stated is proposed, never applied."""

from __future__ import annotations

import csv
import io
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from tests.measurement.importing import shop_files
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.importing import ImportedTable, import_table
from twin.measurement.table import Measurements


@pytest.fixture(scope="module")
def machine() -> Machine:
    return twin.Machine.load("dmu50")


COLUMNS = (
    "X_mm",
    "Y_mm",
    "Z_mm",
    "B_deg",
    "C_deg",
    "target",
    "carrier",
    "x_mm",
    "y_mm",
    "z_mm",
    "round",
    "approach_X",
    "T_bed_degC",
)
HEADERS = {
    "German": (
        "X-Soll [mm]", "Y-Soll [mm]", "Z-Soll [mm]", "B [°]", "C [°]", "Reflektor", "Träger", "X-Ist [mm]", "Y-Ist [mm]", "Z-Ist [mm]",
        "Durchgang", "Anfahrrichtung X", "T_bed_degC",
    ),
    "English": (
        "X nominal (mm)", "Nominal Y (mm)", "Cmd Z mm", "B deg", "C (deg)", "Target", "Carrier", "X actual (mm)", "Measured Y (mm)",
        "Meas Z in mm", "Run", "X approach", "T_bed_degC",
    ),
    "twin": COLUMNS,
}  # fmt: skip
ROWS = [
    (0.5, 10.25, -3.125, 0.0, 12.5, "K", "tool", 1794.37961, -358.2832, 379.5, "1", 1, 20.25),
    (474.3, 140.3, -230.7, 30.0, 45.0, "P;Q", "tool", 2094.35941, 747.4939, 149.2983, "1", -1, 20.5),
    (413.9, 184.1, -180.2, 60.5, 90.0, "K", "tool", -2019.7537, 746.1195, 0.25, "2", 1, 21.0),
    (13.8, 339.1, -184.7, 90.0, 350.0, "R, S", "tool", 1606.9496, 629.1233, 195.2918, "2", -1, 21.5),
]
DELIMITERS = {";": "semicolon", "\t": "tab", ",": "comma", "|": "bar"}


def written(rows: Any, header: Any, *, delimiter: str = ",", decimal: str = ".", end: str = "\n") -> str:
    out = io.StringIO()
    writer = csv.writer(out, delimiter=delimiter, lineterminator=end)
    writer.writerow(header)
    for row in rows:
        writer.writerow([repr(cell).replace(".", decimal) if isinstance(cell, float) else cell for cell in row])
    return out.getvalue()


def same(one: Measurements, other: Measurements) -> None:
    for name, values in one.arrays().items():
        if name == "lines":
            continue
        expected = getattr(other, name)
        equal = (
            values == expected
            if values.dtype == object
            else (values == expected) | (np.isnan(values) & np.isnan(expected))
        )
        assert np.all(equal), name
    assert one.temperature_degC.keys() == other.temperature_degC.keys()


@pytest.fixture(scope="module")
def expected(machine: Machine, tmp_path_factory: pytest.TempPathFactory) -> Measurements:
    path = tmp_path_factory.mktemp("truth") / "plain.csv"
    path.write_text(written(ROWS, COLUMNS))
    return Measurements.load(path, machine)


@pytest.mark.sample(8)  # of 24
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
@pytest.mark.parametrize("delimiter", DELIMITERS)
def test_every_dialect_gives_the_same_table(
    machine: Machine, expected: Measurements, tmp_path: Path, encoding: str, delimiter: str
) -> None:
    path, measured = tmp_path / "shop.csv", tmp_path / "measured.csv"
    for (language, header), decimal, end, title in product(HEADERS.items(), ",.", ("\n", "\r\n", "\r"), (False, True)):
        if language == "twin" and decimal == ",":
            continue
        text = written(ROWS, header, delimiter=delimiter, decimal=decimal, end=end)
        if title:
            text = f"Messprotokoll{end}Prüfer: Müller{end}{end}# Kommentar{end}{text}{end}{end}"
        path.write_bytes(text.encode(encoding))
        found = import_table(path, machine)
        assert found.to_confirm == () and found.mapping.entries.delimiter == DELIMITERS[delimiter], found.to_text()
        found.save(measured)
        same(Measurements.load(measured, machine), expected)
        assert found.measurements is not None
        same(found.measurements, expected)
        first = 2 + 4 * title
        assert found.measurements.lines.tolist() == [first, first + 1, first + 2, first + 3]


finite = st.floats(-3000.0, 3000.0, allow_nan=False).map(lambda value: round(value, 6) + 0.0)
names = st.text(st.sampled_from("ABCxyz ;,|\t\"'äß°#-_.0123"), min_size=1, max_size=8).map(
    lambda text: " ".join(f"K{text}".split())
)
tables = st.lists(
    st.tuples(
        st.floats(0.0, 500.0).map(lambda v: round(v, 4)), st.floats(-400.0, 0.0).map(lambda v: round(v, 4)), names,
        finite, finite, finite, st.sampled_from("+-"),
    ),
    min_size=3, max_size=12,
)  # fmt: skip


@settings(max_examples=settings.default.max_examples // 2)  # 12; 100 in a slow run
@given(
    rows=tables,
    delimiter=st.sampled_from(list(DELIMITERS)),
    decimal=st.sampled_from(",."),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    end=st.sampled_from(["\n", "\r\n"]),
    broken=st.booleans(),
)
def test_a_table_in_any_dialect_is_read_back_exactly(
    tmp_path_factory: pytest.TempPathFactory,
    machine: Machine,
    rows: list[tuple[Any, ...]],
    delimiter: str,
    decimal: str,
    encoding: str,
    end: str,
    broken: bool,
) -> None:
    """Compare numbers bit by bit; the first row makes the decimal sign clear."""
    path = tmp_path_factory.getbasetemp() / "any.csv"
    header = (
        "X-Soll [mm]",
        "Z-Soll [mm]",
        "Reflektor",
        "x Ist [mm]",
        "y Ist [mm]",
        "z Ist [mm]",
        "Richtung X",
        "Y_mm",
        "B_deg",
        "C_deg",
        "carrier",
    )
    own = [(0.25, -0.5, "K", 0.125, 0.25, 0.5, "+"), *rows]
    data = [(*row, 100, 0, 0, "tool") for row in own]
    if broken:  # names with line breaks, in quotes
        data = [(*row[:2], row[2].replace(" ", "\n"), *row[3:]) for row in data]
    path.write_bytes(written(data, header, delimiter=delimiter, decimal=decimal, end=end).encode(encoding))
    found = import_table(path, machine)
    assert found.assumptions == (), found.to_text()
    assert [float(cell) for cell in found.columns["X_mm"]] == [row[0] for row in own]
    assert [float(cell) for cell in found.columns["Z_mm"]] == [row[1] for row in own]
    assert list(found.columns["target"]) == [row[2] for row in own]
    for i, name in enumerate(("x_mm", "y_mm", "z_mm")):
        assert [float(cell) for cell in found.columns[name]] == [row[3 + i] for row in own]
    assert list(found.columns["approach_X"]) == ["1" if row[6] == "+" else "-1" for row in own]


def confirmed(
    found: ImportedTable, machine: Machine, folder: Path, *changes: tuple[str, str], **options: Any
) -> ImportedTable:
    """Return the import with the proposed mapping, after changes of its text."""
    path = folder / "map.yaml"
    found.save_columns(path)
    text = path.read_text()
    for old, new in changes:
        assert old in text, (old, text)
        text = text.replace(old, new)
    path.write_text(text)
    return import_table(found.source, machine, columns=path, **options)


SHOP: dict[str, tuple[str, ...]] = {
    "cmm.csv": ("all rows are of one target", "B stood at 0", "C stood at 0", "carrier: tool"),
    "inches.csv": ("each name of 'Name' is a target: A, B, C", "month first", "B stood", "C stood", "carrier: tool"),
    "notebook.csv": (
        "no unit is given for 'X', 'Y', 'Z': mm",
        "no unit is given for 'x', 'y', 'z': mm",
        "carrier: tool",
    ),
    "metres.txt": ("'nominal_Z': m, because", "rad, because", "'meas_Z': m", "one target", "carrier"),
    "depth.txt": ("one target", "B stood", "C stood", "carrier", "Z seems to be mirrored: 23 of 24 rows"),
    "mirrored.csv": ("z seems to be mirrored: 24 of 24 rows",),
    "thousands.csv": ("one target", "B stood", "C stood", "carrier"),
}


@pytest.mark.parametrize("name", SHOP)
def test_shop_files(machine: Machine, tmp_path: Path, name: str) -> None:
    """Each assumption is listed, nothing is written before the mapping is confirmed, and the numbers are then the true ones."""
    path = tmp_path / name
    path.write_bytes(shop_files.FILES[name]())
    found = import_table(path, machine)
    assert len(found.to_confirm) == len(SHOP[name]), found.to_text()
    for text, part in zip(found.to_confirm, SHOP[name], strict=True):
        assert part in text
    assert not found.confirmed
    with pytest.raises(InputError, match="to confirm"):
        found.save(tmp_path / "measured.csv")
    assert not (tmp_path / "measured.csv").exists()
    mirrored = {"depth.txt": "Z_mm", "mirrored.csv": "z_mm"}.get(name)
    changes = (
        [] if mirrored is None else [(_entry(found, mirrored), _entry(found, mirrored).replace("sign: 1", "sign: -1"))]
    )
    again = confirmed(found, machine, tmp_path, *changes)
    assert again.confirmed and again.findings == () and again.measurements is not None
    q, point = shop_files.points()
    tolerance = 2e-3 if name == "metres.txt" else 1e-5
    assert np.allclose(again.measurements.positions[:, :3], q, atol=tolerance)
    if name == "mirrored.csv":
        assert np.allclose(again.measurements.point_mm, q, atol=0.02)
    else:
        assert np.allclose(again.measurements.point_mm, point, atol=tolerance)
    again.save(tmp_path / "measured.csv")
    same(Measurements.load(tmp_path / "measured.csv", machine), again.measurements)


def _entry(found: ImportedTable, column: str) -> str:
    text = found.mapping.to_yaml({}, ())
    return next(line for line in text.splitlines() if line.startswith(f"  {column}:"))


def test_a_workbook(machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "book.xlsx"
    shop_files.workbook(path)
    with pytest.raises(InputError, match="several sheets; expected one of Deckblatt, Messung"):
        import_table(path, machine)
    with pytest.raises(
        InputError, match=r"no such sheet: 'Mesung' \(did you mean Messung\?\); expected one of Deckblatt, Messung"
    ):
        import_table(path, machine, sheet="Mesung")
    found = import_table(path, machine, sheet="Messung")
    (assumption,) = found.assumptions
    assert assumption.startswith("the targets sit on the tool side of the machine (carrier: tool): on the other side")
    again = confirmed(found, machine, tmp_path)
    table = again.measurements
    q, point = shop_files.points()
    assert table is not None and np.array_equal(table.positions[:, :3], q) and np.array_equal(table.point_mm, point)
    assert table.time_s.tolist() == [20.0 * i for i in range(24)] and table.u_mm[0, 2] == 0.0045
    assert table.temperature_degC["bett"][1] == 20.51 and table.target.tolist()[:4] == ["K", "P", "Q", "K"]
    assert "# measured 2026-03-02 08:15\n" in again.text  # `twin watch` reads this date
    assert table.simulated is False and table.lines[0] == 6


@pytest.mark.parametrize("name", ["cmm.csv", "inches.csv", "points.txt"])
def test_the_warning_of_simulated_readings_travels(machine: Machine, tmp_path: Path, name: str) -> None:
    path, plan = tmp_path / name, tmp_path / "plan.csv"
    path.write_bytes(shop_files.FILES[name]())
    plan.write_text(shop_files.analyser_plan())
    found = import_table(path, machine, plan=plan if name == "points.txt" else None)
    assert found.measurements is not None and found.measurements.simulated
    assert found.to_dict()["warnings"][0]["name"] == "simulated_readings" and "SIMULATED READINGS" in found.to_text()


def test_points_of_a_plan_by_name(machine: Machine, tmp_path: Path) -> None:
    path, plan = tmp_path / "points.txt", tmp_path / "plan.csv"
    path.write_bytes(shop_files.analyser_points())
    plan.write_text(shop_files.analyser_plan())
    found = import_table(path, machine, plan=plan)
    q, point = shop_files.points()
    assert found.confirmed and found.measurements is not None
    assert np.array_equal(found.measurements.positions[:, :3], q) and np.array_equal(found.measurements.point_mm, point)
    with pytest.raises(
        InputError, match=r"points.txt:2: no commanded positions: 'X \[mm\]', 'Y \[mm\]', 'Z \[mm\]' can be either"
    ):
        import_table(path, machine)


def test_rows_of_a_plan_by_order(machine: Machine, tmp_path: Path) -> None:
    path, plan = tmp_path / "bare.csv", tmp_path / "plan.csv"
    path.write_bytes(shop_files.bare_points())
    plan.write_text(shop_files.order_plan())
    found = import_table(path, machine, plan=plan)
    assert found.assumptions == (
        "the file has no header; 'column 2', 'column 3', 'column 4' are x, y, z",
        "no unit is given for 'column 2', 'column 3', 'column 4': mm, because the readings extend over 565.838",
        "the rows are in the order of the plan",
    )
    again = confirmed(found, machine, tmp_path, plan=plan)
    q, _ = shop_files.points()
    assert again.measurements is not None and np.array_equal(again.measurements.positions[:, :3], q)
    with pytest.raises(InputError, match="the mapping takes positions from a plan"):
        import_table(path, machine, columns=tmp_path / "map.yaml")
    plan.write_text("\n".join(shop_files.order_plan().splitlines()[:-4]) + "\n")
    with pytest.raises(
        InputError, match=r"bare.csv:21: 24 measured points, and .*plan.csv has 20: this row has no row in the plan"
    ):
        import_table(path, machine, plan=plan)
    path.write_text("\n".join(shop_files.bare_points().decode().splitlines()[:5]) + "\n")
    with pytest.raises(
        InputError, match=r"bare.csv:5: 5 measured points, and .*plan.csv has 20: the file ends with this row"
    ):
        import_table(path, machine, plan=plan)


def test_a_row_that_is_not_that_of_the_plan(machine: Machine, tmp_path: Path) -> None:
    plan, path = tmp_path / "plan.csv", tmp_path / "shop.csv"
    plan.write_text(shop_files.order_plan())
    q, point = shop_files.points()
    rows = [(*map(float, c), *map(float, p)) for c, p in zip(q, point, strict=True)]
    rows[7] = (rows[7][0] + 1.0, *rows[7][1:])
    path.write_text(
        written(rows, ("X soll [mm]", "Y soll [mm]", "Z soll [mm]", "X ist [mm]", "Y ist [mm]", "Z ist [mm]"))
    )
    with pytest.raises(
        InputError, match=r"shop.csv:9: X_mm is not that of the plan: '141.2'; expected 140.2, as in the plan"
    ):
        import_table(path, machine, plan=plan)
    plan.write_text(shop_files.analyser_plan().replace(",p07\n", ",q07\n"))
    path.write_bytes(shop_files.analyser_points())
    found = import_table(path, machine, plan=plan)
    assert "the rows are in the order of the plan" in found.assumptions, "names that differ are no names of the plan"
    found.save_columns(tmp_path / "map.yaml")
    text = (tmp_path / "map.yaml").read_text().replace("{match: order}", '{match: point, point: "Point Name"}')
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(InputError, match=r"shop.csv:10: a point that the plan does not have: 'p07' \(did you mean"):
        import_table(path, machine, columns=tmp_path / "map.yaml", plan=plan)


MESSAGES = {
    "mixed decimals": ("X_mm;Y_mm;x_mm;y_mm\n1,5;2;3;4\n1.5;2;3;4\n", ":3: decimal commas and decimal points in one file: '1.5'"),
    "no numbers": ("a;b\nc;d\n", ":1: no row with numbers"),
    "no readings": ("X_mm;Y_mm;Z_mm\n1,5;2;3\n", ":1: no measured coordinates"),
    "not a number": ("X soll [mm];X ist [mm];Y ist [mm]\n1,5;2;3\n2,5;abc;3\n", ":3: X ist [mm] (x_mm) is not a number: 'abc'"),
    "too many cells": ("X soll [mm];X ist [mm]\n1,5;2\n2,5;2;7\n", ":3: 3 cells, more than the 2 of the header"),
    "empty": ("\n\n", ": no cells"),
    "zero bytes": ("X_mm,x_mm\n1,2\n\0", "not a text file"),
    "program": ("%\nN10 G1 X1.5 Y2 F100\nN20 X5\n", "an NC program, not a table"),
    "ball bar": ("<?xml version='1.0'?><BALLBAR_RUN/>\n", "`twin convert` reads this file"),
    "contacts": ("contact_x_mm,contact_y_mm,contact_z_mm\n1,2,3\n", "`twin convert` reads this file"),
}  # fmt: skip


@pytest.mark.parametrize("name", MESSAGES)
def test_bad_files(machine: Machine, tmp_path: Path, name: str) -> None:
    text, expected = MESSAGES[name]
    path = tmp_path / "shop.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        import_table(path, machine)
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('from: "X-Soll"', 'from: "X-Sol"', "map.yaml:LINE: {path} has no such column: 'X-Sol' (did you mean X-Soll?)"),
        ("unit: mm, sign: 1", "unit: degC, sign: 1", "map.yaml:LINE: the unit does not fit this column: 'degC'"),
        ("X_mm:", "X_mn:", "map.yaml:LINE: no such column of a measurement table: 'X_mn' (did you mean X_mm?)"),
        ("sign: 1", "sign: 2", "map.yaml:LINE: `columns.X_mm.sign` is invalid: '2'"),
        ('{from: "X-Soll", unit: mm, sign: 1}', "{unit: mm}", "map.yaml:LINE: no single origin of this column: 'X_mm'"),
        ("schema: twin.columns/1", "schema: twin.columns/2", "wrong kind of file"),
    ],
)
def test_a_mapping_is_checked_with_its_line(
    machine: Machine, tmp_path: Path, old: str, new: str, expected: str
) -> None:
    path = tmp_path / "cmm.csv"
    path.write_bytes(shop_files.cmm_report())
    import_table(path, machine).save_columns(tmp_path / "map.yaml")
    text = (tmp_path / "map.yaml").read_text()
    (tmp_path / "map.yaml").write_text(text.replace(old, new, 1))
    line = next(i for i, line in enumerate(text.splitlines(), start=1) if line.startswith("  X_mm:"))
    with pytest.raises(InputError) as caught:
        import_table(path, machine, columns=tmp_path / "map.yaml")
    assert expected.replace("LINE", str(line)).format(path=path) in str(caught.value)


def test_an_ambiguous_sign_is_stated(machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "shop.csv"
    header = "X soll [mm];Y_mm;Z_mm;B_deg;C_deg;target;carrier;X ist [mm];Y ist [mm];Z ist [mm]\n"
    path.write_text(header + "".join(f"{i},250;10;-10;0;0;K;tool;{i},500;1;2\n" for i in range(1, 9)))
    (assumption,) = import_table(path, machine).assumptions
    assert assumption == "the decimal sign is the comma: '1,250' is read as 1.250"
    path.write_text(header + "".join(f"{i},25;10;-10;0;0;K;tool;{i}.500;1;2\n" for i in range(1, 9)))
    (assumption,) = import_table(path, machine).assumptions
    assert assumption == "the decimal sign is the comma: '1.500' is read as 1500"
