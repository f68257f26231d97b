"""Tables of shops, written by `forms` with known numbers: each form gives the same table, or a refusal that its last line cures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from tests.measurement.importing import forms
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.importing import ImportedTable, import_table
from twin.measurement.table import Measurements

CURE = "; in a mapping file: "


@pytest.fixture(scope="module")
def trunnion() -> Machine:
    return Machine.load(forms.MACHINE)


@pytest.fixture(scope="module")
def own() -> forms.Table:
    return forms.table()


def read(path: Path, machine: Machine, lines: Mapping[str, Any] | None = None, **options: Any) -> ImportedTable:
    """Return an import: as it is, or after the proposed mapping is confirmed unchanged; ``lines`` are lines of a mapping file."""
    mapping = path.with_suffix(".mapping.yaml")
    if lines is not None:
        mapping.write_text(yaml.safe_dump({"schema": "twin.columns/1", **lines}, allow_unicode=True))
        options["columns"] = mapping
    found = import_table(path, machine, **options)
    if found.confirmed:
        return found
    found.save_columns(mapping)
    assert found.to_confirm
    return import_table(path, machine, **{**options, "columns": mapping})


def check(found: ImportedTable, own: forms.Table, tolerance: float = 1e-6) -> Measurements:
    """Compare a table with the truth, and its file with the table."""
    data = found.measurements
    assert data is not None
    assert data.target.tolist() == list(own.target) and data.carrier.tolist() == own.side
    np.testing.assert_allclose(data.positions, own.q, atol=1e-6)
    np.testing.assert_allclose(data.point_mm, own.xyz, atol=tolerance)
    return data


def put(folder: Path, text: str, encoding: str = "utf-8", name: str = "shop.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


def refusal(path: Path, machine: Machine, lines: Mapping[str, Any] | None = None, **options: Any) -> InputError:
    with pytest.raises(InputError) as caught:
        read(path, machine, lines, **options)
    return caught.value


def cured(path: Path, machine: Machine, most: int = 6, **options: Any) -> ImportedTable:
    """Return the import after putting into the mapping file the line with which each refusal ends."""
    lines: dict[str, Any] = {}
    for _ in range(most):
        try:
            return read(path, machine, lines or None, **options)
        except InputError as error:
            text = str(error)
            assert CURE in text and text.endswith(str(error.cure)), text
            line = yaml.safe_load(text.rpartition(CURE)[2])
            assert isinstance(line, dict)
            before = str(lines)
            for key, value in line.items():
                lines[key] = {**lines.get(key, {}), **value} if isinstance(value, dict) else value
            assert str(lines) != before, text  # the same refusal again
    raise AssertionError("not cured")


FORMS: dict[str, tuple[Callable[[forms.Table], str], str, float]] = {
    "names": (forms.named_points, "cp1252", 1e-6),
    "names with blanks": (
        lambda own: forms.named_points(own, "P_{name} {X} {Y} {Z} {A} {C}", ",", ".", "Units: mm"),
        "utf-8-sig",
        1e-6,
    ),
    "names without separators": (lambda own: forms.named_points(own, "{X}{Y}{Z}{A}{C}-{name}", ";"), "utf-16", 1e-6),
    "cells in mm and degrees": (forms.cells_with_units, "utf-8", 1e-6),
    "cells in inches and radians": (lambda own: forms.cells_with_units(own, "in", "rad", sign=","), "utf-8", 1e-5),
    "cells in µm and arc seconds": (lambda own: forms.cells_with_units(own, "µm", "''", ""), "utf-8", 1e-6),
    "cells in metres and gon": (lambda own: forms.cells_with_units(own, "m", "gon"), "cp1252", 1e-5),
    "headings": (forms.blocks, "utf-8", 1e-6),
    "inches by title": (lambda own: forms.titled(own, "English", ["Units: Inches; deg"], scale=25.4), "utf-8", 1e-5),
    **{
        f"titles, {language}": (
            lambda own, language=language: forms.titled(own, language, ["Einheit: mm / Grad"]),
            "cp1252",
            1e-6,
        )  # type: ignore[misc]
        for language in forms.TITLES
    },
}


@pytest.mark.parametrize("name", FORMS)
def test_every_form_gives_the_same_table(trunnion: Machine, own: forms.Table, tmp_path: Path, name: str) -> None:
    writer, encoding, tolerance = FORMS[name]
    found = read(put(tmp_path, writer(own), encoding), trunnion)
    check(found, own, tolerance)
    found.save(tmp_path / "measured.csv")
    check_file = Measurements.load(tmp_path / "measured.csv", trunnion)
    np.testing.assert_allclose(check_file.point_mm, own.xyz, atol=tolerance)


@settings(max_examples=8, deadline=None)
@given(
    sign=st.sampled_from(",."),
    delimiter=st.sampled_from("\t;|"),
    style=st.permutations(["{X}", "{Y}", "{Z}", "{A}", "{C}", "{name}"]),
    joiner=st.sampled_from(["_", " ", "__", " / "]),
    encoding=st.sampled_from(["utf-8", "cp1252", "utf-16", "utf-8-sig"]),
)
def test_positions_in_names_in_any_order(
    trunnion: Machine,
    tmp_path_factory: pytest.TempPathFactory,
    sign: str,
    delimiter: str,
    style: list[str],
    joiner: str,
    encoding: str,
) -> None:
    own = forms.table()
    text = forms.named_points(own, joiner.join(style), delimiter, sign, f"Einheit:{delimiter}mm")
    check(read(put(tmp_path_factory.mktemp("names"), text, encoding), trunnion), own)


@settings(max_examples=8, deadline=None)
@given(
    length=st.sampled_from(list(forms.LENGTHS)),
    angle=st.sampled_from(list(forms.ANGLES)),
    blank=st.sampled_from(["", " "]),
    sign=st.sampled_from(",."),
)
def test_units_in_cells(
    trunnion: Machine, tmp_path_factory: pytest.TempPathFactory, length: str, angle: str, blank: str, sign: str
) -> None:
    own = forms.table()
    blank = " " if length == "m" else blank  # 2m is a name
    path = put(tmp_path_factory.mktemp("cells"), forms.cells_with_units(own, length, angle, blank, sign))
    check(read(path, trunnion), own, 1e-5)


@pytest.mark.sample(2)  # of 20
@pytest.mark.parametrize("angle", ["deg", "gon", "rad", "dms", "d.mmss"])
@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("zenith", [False, True])
def test_angles_and_distance(
    trunnion: Machine, own: forms.Table, tmp_path: Path, angle: str, clockwise: bool, zenith: bool
) -> None:
    """The readings show the sense and the zero of the angles, and the units that the header does not state."""
    found = read(put(tmp_path, forms.spherical(own, angle, clockwise, zenith)), trunnion)
    check(found, own, 1e-4)
    if angle != "dms":
        check(
            read(put(tmp_path, forms.spherical(own, angle, clockwise, zenith, "mm", stated=False)), trunnion), own, 1e-4
        )


def test_sixty_minutes_are_no_packed_angle(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    """An angle of 27.61 in degrees, minutes and seconds is refused with its line, not read as 28° 01′."""
    text = forms.spherical(own, "d.mmss")
    first = text.splitlines()[1].split(";")[-3]
    with pytest.raises(InputError, match=r"27\.6100") as refused:
        read(put(tmp_path, text.replace(first, "27.6100", 1)), trunnion)
    assert refused.value.line == 2 and "d.mmss" in str(refused.value)


def test_the_conventions_of_angles_are_confirmed_where_the_readings_do_not_show_them(
    trunnion: Machine, tmp_path: Path
) -> None:
    own = forms.table().take(range(3))
    found = import_table(put(tmp_path, forms.spherical(own)), trunnion)
    assert any("the readings do not show it" in text for text in found.assumptions)


def test_deviations_need_the_places_of_the_reflectors(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    """Deviations give the readings in the machine's frame, once the places are entered; until then nothing is written."""
    path = put(tmp_path, forms.deviations(own), "cp1252")
    found = import_table(path, trunnion)
    assert not found.confirmed and any("without their places" in text for text in found.assumptions)
    mapping = tmp_path / "map.yaml"
    found.save_columns(mapping)
    with pytest.raises(InputError, match=r"map.yaml:\d+: place_x_mm of 'K1' is not known: '\?'; expected a number"):
        import_table(path, trunnion, columns=mapping)
    content = yaml.safe_load(mapping.read_text())
    for i, axis in enumerate("xyz"):
        content["columns"][f"place_{axis}_mm"]["words"] = {name: place[i] for name, place in forms.PLACES.items()}
    mapping.write_text(yaml.safe_dump(content, allow_unicode=True))
    data = import_table(path, trunnion, columns=mapping).measurements
    assert data is not None and data.carrier.tolist() == own.side
    np.testing.assert_allclose(data.point_mm, own.base, atol=1e-6)
    np.testing.assert_allclose(data.place_mm, [forms.PLACES[name] for name in own.target])


def test_nominal_coordinates_and_deviations_beside_positions_in_names(
    trunnion: Machine, own: forms.Table, tmp_path: Path
) -> None:
    """Nominal coordinates of the points and deviations are readings: no place needs to be known."""
    nominal = own.base - own.deviation
    rows: list[list[object]] = [["Name", *(f"Nom {a} [mm]" for a in "XYZ"), *(f"Dev {a} [mm]" for a in "XYZ")]]
    rows += [
        [forms.name_of(q, name), *(f"{v:.6f}" for v in p), *(f"{v:.6f}" for v in d)]
        for q, name, p, d in zip(own.q, own.target, nominal, own.deviation, strict=True)
    ]
    data = read(put(tmp_path, forms.csv_text(rows)), trunnion).measurements
    assert data is not None and data.target.tolist() == list(own.target)
    np.testing.assert_allclose(data.positions, own.q, atol=1e-9)
    np.testing.assert_allclose(data.point_mm, own.base, atol=2e-6)


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("merged", [False, True])
def test_workbooks(trunnion: Machine, own: forms.Table, tmp_path: Path, last: bool, merged: bool) -> None:
    path = tmp_path / "book.xlsx"
    forms.workbook(path, own, last=last, merged=merged)
    data = check(read(path, trunnion), own)
    assert ("temperatur" in str(data.temperature_degC).lower() or "air" in data.temperature_degC) == last
    forms.with_formulas(path)
    check(read(path, trunnion), own)
    forms.with_formulas(path, stored=False)


def test_cells_merged_over_several_rows(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    """The name of a reflector above a block of points, and the titles above two rows."""
    from openpyxl import load_workbook

    path = tmp_path / "book.xlsx"
    forms.workbook(path, own)
    book = load_workbook(path)
    sheet = book.active
    first = 4
    for name in forms.PLACES:
        count = own.target.count(name)
        sheet.merge_cells(start_row=first, end_row=first + count - 1, start_column=8, end_column=8)
        first += count
    for column in ("A", "B", "H"):
        sheet.merge_cells(f"{column}1:{column}2")
    book.save(path)
    check(read(path, trunnion), own)


def test_a_formula_without_a_stored_value(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    path = tmp_path / "book.xlsx"
    forms.workbook(path, own)
    forms.with_formulas(path, stored=False)
    assert "book.xlsx:4: the formula in cell C4 has no stored value" in str(refusal(path, trunnion))


def test_several_sheets_are_cured_by_the_name_of_one(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    path = tmp_path / "book.xlsx"
    forms.workbook(path, own, other=True)
    assert str(refusal(path, trunnion)).endswith('in a mapping file: sheet: "Messdaten"')
    check(cured(path, trunnion), own)


# --- Rows and cells that cannot be used ---------------------------------------------------------------


@pytest.mark.parametrize("cell", ["#N/A", "-", "", "---", "n/a", "NaN", "#WERT!", "nicht gemessen", "***"])
@pytest.mark.parametrize("column", [0, 7])
def test_a_row_without_a_value_is_set_aside_with_its_line(
    trunnion: Machine, own: forms.Table, tmp_path: Path, cell: str, column: int
) -> None:
    lines = forms.titled(own, "English", ["Units: mm / deg"]).split("\r\n")
    cells = lines[9].split(";")
    cells[column] = cell
    lines[9] = ";".join(cells)
    found = read(put(tmp_path, "\r\n".join(lines)), trunnion)
    check(found, own.take([i for i in range(len(own.q)) if i != 7]))
    assert any("line 10: set aside" in note and lines[1].split(";")[column] in note for note in found.notes), (
        found.notes
    )


def test_a_word_for_no_value_is_named_in_the_line_that_cures(
    trunnion: Machine, own: forms.Table, tmp_path: Path
) -> None:
    text = forms.titled(own, "English", ["Units: mm / deg"])
    lines = text.split("\r\n")
    lines[9] = lines[9].rpartition(";")[0].rpartition(";")[0] + ";beam;1"
    error = refusal(path := put(tmp_path, "\r\n".join(lines)), trunnion)
    assert (error.line, error.value) == (10, "beam") and error.cure == 'missing: ["beam"]'
    check(cured(path, trunnion), own.take([i for i in range(len(own.q)) if i != 7]))


def test_a_measurement_table_keeps_its_empty_coordinates(trunnion: Machine, tmp_path: Path) -> None:
    header = "X_mm,Y_mm,Z_mm,A_deg,C_deg,target,carrier,x_mm,y_mm,z_mm\n"
    rows = [f"{x},0,0,0,0,K,tool,{x},{'' if x == 20 else 0},0" for x in range(0, 100, 10)]
    data = import_table(put(tmp_path, header + "\n".join(rows)), trunnion).measurements
    assert data is not None and len(data) == 10 and np.isnan(data.point_mm[2, 1])


# --- Units --------------------------------------------------------------------------------------------


def test_units_of_titles_contradicted_by_the_header(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    text = forms.titled(own, "English", ["Units: Inches / deg"]).replace("X nominal", "X nominal [mm]")
    path = put(tmp_path, text)
    error = refusal(path, trunnion)
    assert error.line == 2 and "'X nominal [mm]' is in mm, and the titles of the file state inch" in str(error)
    check(cured(path, trunnion), own)


def test_units_of_cells_contradicted_by_the_header(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    path = put(tmp_path, forms.cells_with_units(own, "in", "rad").replace("x meas", "x meas [mm]"))
    error = refusal(path, trunnion)
    assert error.line == 2 and error.value == "in" and "x meas [mm]" in str(error)
    check(cured(path, trunnion), own, 1e-5)


def test_two_units_in_the_titles(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    path = put(tmp_path, forms.titled(own, "English", ["Units: mm / deg", "Length unit: inch"]))
    assert "two units in the titles" in str(refusal(path, trunnion))
    cured(path, trunnion)


def test_decimal_commas_and_points_are_cured_by_the_sign(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    lines = forms.titled(own, "English", ["Units: mm / deg"]).split("\r\n")
    lines[9] = lines[9].replace(",", ".")
    path = put(tmp_path, "\r\n".join(lines))
    error = refusal(path, trunnion)
    assert error.line == 10 and error.cure == "decimal: comma"
    check(cured(path, trunnion, most=12), own.take([i for i in range(len(own.q)) if i != 7]))


# --- Other refusals, each cured by its last line -------------------------------------------------------


def test_more_cells_than_titles(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    text = forms.titled(own, "English", ["Units: mm / deg"]).replace(";Run\r\n", "\r\n")
    error = refusal(path := put(tmp_path, text), trunnion)
    assert "10 cells, more than the 9 of the header" in str(error)
    check(cured(path, trunnion), own)


def test_titles_without_a_meaning(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    """Columns without a known title are offered in their order; a person sees them before anything is written."""
    text = forms.titled(own, "English", ["Units: mm / deg"])
    for i, old in enumerate(["X actual", "Y actual", "Z actual"]):
        text = text.replace(old, f"Kanal {i}")
    check(cured(put(tmp_path, text), trunnion), own)


def test_unknown_sides_and_directions(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    text = forms.titled(own, "English", ["Units: mm / deg"]).replace("Run", "Seite")
    path = put(tmp_path, text)
    error = refusal(path, trunnion, {"columns": {"carrier": {"from": "Seite"}}})
    assert error.value == "1" and error.cure is not None and '"1": "tool"' in error.cure
    error = refusal(path, trunnion, {"columns": {"approach_X": {"from": "Reflector"}}})
    assert error.cure is not None and yaml.safe_load(error.cure)["columns"]["approach_X"]["words"] == {"K1": 0}


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        ({"length": "mn"}, "map.yaml:2: no such unit: 'mn' (did you mean m?)"),
        ({"angle": "mm"}, "map.yaml:2: no such unit: 'mm'"),
        (
            {"spherical": {"horizontal": "H", "vertical": "V", "distance": "D", "angle": "gom"}},
            "no such unit: 'gom' (did you mean gon?)",
        ),
        ({"spherical": {"horizontal": "H", "vertical": "V", "distance": "D"}}, "has no such column: 'H'"),
        ({"deviations": {"x": "X actual", "unit": "deg"}}, "no such unit: 'deg'"),
        ({"deviations": {"x": "X actual", "along": "Q_mm"}}, "no such axis: 'Q_mm'"),
        ({"deviations": {"x": "X aktual", "along": "X_mm"}}, "has no such column: 'X aktual'"),
        ({"plan": {"match": "positions"}}, "the mapping takes positions from a plan"),
    ],
)
def test_a_line_that_is_wrong_is_refused(
    trunnion: Machine, own: forms.Table, tmp_path: Path, lines: dict[str, Any], what: str
) -> None:
    path, mapping = put(tmp_path, forms.titled(own, "English", ["Units: mm / deg"])), tmp_path / "map.yaml"
    mapping.write_text(yaml.safe_dump({"schema": "twin.columns/1", **lines}, sort_keys=False))
    with pytest.raises(InputError) as caught:
        import_table(path, trunnion, columns=mapping)
    assert what in str(caught.value)


# --- Plans --------------------------------------------------------------------------------------------


def plan_of(own: forms.Table, path: Path) -> Path:
    rows: list[list[object]] = [["X_mm", "Y_mm", "Z_mm", "A_deg", "C_deg", "target", "carrier", "round"]]
    rows += [
        [*q, name, side, k] for q, name, side, k in zip(own.q.tolist(), own.target, own.side, own.round, strict=True)
    ]
    path.write_text(forms.csv_text(rows, ",", "\n"))
    return path


def test_names_are_compared_with_the_plan(trunnion: Machine, tmp_path: Path) -> None:
    """Rows are found in the plan by their names, though some are missing; a name that the plan does not have next is an error."""
    own = forms.table(rounds=2)
    plan = plan_of(own, tmp_path / "plan.csv")
    kept = [i for i in range(len(own.q)) if i not in (3, 21, 50)]
    found = import_table(put(tmp_path, forms.named_points(own.take(kept))), trunnion, plan=plan)
    assert found.confirmed, found.to_text()
    data = check(found, own.take(kept))
    assert data.round.tolist() == [own.round[i] for i in kept]
    text = forms.named_points(own).replace("X150.5_", "X155_", 1)
    error = refusal(put(tmp_path, text), trunnion, plan=plan)
    assert error.line == 8 and "X_mm is not that of the plan: '155'; expected 150.5" in str(error)
    text = forms.named_points(own.take(kept)).replace("X150.5_", "X155_", 1)
    error = refusal(put(tmp_path, text), trunnion, plan=plan)
    assert error.line == 8 and "X155" in str(error)


def test_points_measured_twice_in_a_row(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    """Each of two equal rows is the next one of the plan: rounds alternate."""
    rows = np.repeat(np.arange(len(own.q)), 2).tolist()
    twice = replace(own.take(rows), round=tuple("12" * len(own.q)))
    plan = plan_of(twice, tmp_path / "plan.csv")
    data = check(read(put(tmp_path, forms.named_points(twice)), trunnion, plan=plan), twice)
    assert data.round.tolist() == list(twice.round)


def test_rounded_names_take_the_position_of_the_plan(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    plan = plan_of(own, tmp_path / "plan.csv")
    text = forms.named_points(own).replace("X150.5_", "X150_")
    check(read(put(tmp_path, text), trunnion, plan=plan), own)


def test_names_in_another_order_than_the_plan(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    plan = plan_of(own, tmp_path / "plan.csv")
    order = np.random.default_rng(2).permutation(len(own.q)).tolist()
    check(read(put(tmp_path, forms.named_points(own.take(order))), trunnion, plan=plan), own.take(order))


# --- Sides --------------------------------------------------------------------------------------------


def test_a_wrong_side_is_named_by_its_targets(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    rows: list[list[object]] = [["X_mm", "Y_mm", "Z_mm", "A_deg", "C_deg", "target", "carrier", "x_mm", "y_mm", "z_mm"]]
    rows += [[*q, name, "tool", *p] for q, name, p in zip(own.q.tolist(), own.target, own.xyz.tolist(), strict=True)]
    path = put(tmp_path, forms.csv_text(rows, ",", "\n"))
    with pytest.raises(InputError, match="do not agree: T1, T2 sit on the work side, not on the tool side"):
        twin.identify(Measurements.load(path, trunnion), trunnion)
    (finding,) = import_table(path, trunnion).findings
    assert finding.startswith("T1, T2 sit on the work side, not on the tool side")


def test_sides_that_the_readings_do_not_show(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    """A reflector measured once fits on either side: the proposal states it."""
    kept = [i for i, name in enumerate(own.target) if name != "K2"]
    few = own.take([*kept, own.target.index("K2")])
    found = import_table(put(tmp_path, forms.named_points(few)), trunnion)
    assert any("do not show the side of K2 (tool)" in text for text in found.assumptions), found.assumptions


# --- Positioning tests of one axis ---------------------------------------------------------------------


@pytest.mark.parametrize("style", ["columns", "groups", "signs", "rows"])
@pytest.mark.parametrize("sign", [",", "."])
def test_matrices_of_iso_230_2(trunnion: Machine, tmp_path: Path, style: str, sign: str) -> None:
    found = read(put(tmp_path, forms.matrix(style, sign)), trunnion)
    check_runs(found.measurements)
    if style in ("columns", "rows"):
        assert any(
            "rows without a reading are left out" in note
            for note in import_table(tmp_path / "shop.csv", trunnion).notes
        )


@pytest.mark.parametrize("measured", [False, True])
@pytest.mark.parametrize("head", ["Axis: X", "Achse X", "X-Achse", "Axe : X"])
def test_runs_of_one_axis(trunnion: Machine, tmp_path: Path, measured: bool, head: str) -> None:
    check_runs(read(put(tmp_path, forms.runs(measured=measured, head=head)), trunnion).measurements)


def check_runs(data: Measurements | None) -> None:
    """Compare with the deviations: one row for each target and run, in either order of the targets."""
    assert data is not None and len(data) == len(forms.RUNS) * len(forms.TARGETS)
    assert set(data.instrument) == {"linear-interferometer"} and set(data.carrier) == {"tool"}
    for (run, way), errors in zip(forms.RUNS, forms.errors_um(), strict=True):
        rows = np.flatnonzero((data.round == str(run)) & (data.approach[:, 0] == way))
        rows = rows[np.argsort(data.positions[rows, 0])]
        np.testing.assert_allclose(data.positions[rows, 0], forms.TARGETS)
        np.testing.assert_allclose((data.point_mm[rows, 0] - forms.TARGETS) * 1e3, errors, atol=2e-3)
        assert np.isnan(data.point_mm[rows, 1:]).all()


def test_a_positioning_test_of_an_unknown_axis_is_confirmed(trunnion: Machine, tmp_path: Path) -> None:
    found = import_table(put(tmp_path, forms.runs(head="Laser")), trunnion)
    assert "the file does not name the axis that was measured: X" in found.assumptions


def test_a_positioning_test_of_a_rotary_axis_is_refused(trunnion: Machine, tmp_path: Path) -> None:
    text = forms.runs(head="Axis: C").replace("[mm]", "[°]")
    assert "a positioning test of C, a rotary axis" in str(refusal(put(tmp_path, text), trunnion))


# --- Words of titles and names ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "head", ["Units in mm", "All dimensions in mm, angles in degrees", "Einheiten: mm / Grad", "Unités : mm"]
)
def test_titles_that_state_units(trunnion: Machine, own: forms.Table, tmp_path: Path, head: str) -> None:
    found = import_table(put(tmp_path, forms.titled(own, "English", [head])), trunnion)
    assert not any("no unit is given for 'X" in text for text in found.assumptions), found.assumptions


def test_footers_are_left_out_and_listed(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    text = forms.titled(own, "German", ["Messprotokoll", "Einheit: mm, Grad"])
    found = read(
        put(tmp_path, text + "Mittelwert;;;;;;1,5;2,5;3,5\r\nStdabw;;;;;;0,001;0,002;0,003\r\nEnde\r\n"), trunnion
    )
    check(found, own)
    last = len(text.splitlines()) + 1
    assert any(
        f"line {last} (Mittelwert 1,5 2,5 3,5)" in note for note in import_table(tmp_path / "shop.csv", trunnion).notes
    )


def test_names_with_a_number_for_each_point(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    rows: list[list[object]] = [
        ["Punkt", *(f"{a} soll [mm]" for a in "XYZ"), "A soll [°]", "C soll [°]", *(f"{a} ist [mm]" for a in "XYZ")]
    ]
    rows += [[f"{own.target[i]}_{i + 1:03d}", *own.q[i], *own.xyz[i]] for i in range(len(own.q))]
    path = put(tmp_path, forms.csv_text(rows))
    assert "each name of 'Punkt: name' is a target: K1, K2, T1, T2" in import_table(path, trunnion).assumptions
    check(read(path, trunnion), own)


def test_a_table_of_another_machine(dmu50: Machine, own: forms.Table, tmp_path: Path) -> None:
    """A forgotten choice of the machine is named, not filled up with an axis that stood still."""
    for text in (forms.named_points(own), forms.titled(own, "German"), forms.cells_with_units(own)):
        assert "positions of A, an axis that DMU 50 eVolution does not have" in str(refusal(put(tmp_path, text), dmu50))


def laser_matrix(titles: str, header: str = "Target (mm)") -> str:
    """Matrix of two runs in both directions of X with deviations (n, 4) in µm: 8 sin (x / 120 mm) + run ± 2."""
    rows = [f"{header};Run 1 (+);Run 1 (-);Run 2 (+);Run 2 (-)"]
    for x in range(0, 601, 100):
        cells = (f"{8 * np.sin(x / 120) + run + side:.2f}" for run in (1, 2) for side in (2, -2))
        rows.append(f"{x}.0000;{';'.join(cells)}")
    return f"{titles}\nAxis;X\n\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize("titles", ["Units;Millimetres;Errors;Micrometres", "Units;Millimetres"])
def test_titles_in_mm_do_not_make_deviations_of_µm_a_thousand_times_larger(
    trunnion: Machine, tmp_path: Path, titles: str
) -> None:
    found = import_table(put(tmp_path, laser_matrix(titles)), trunnion)
    assert found.measurements is not None
    x, reading = found.measurements.positions[:, 0], found.measurements.point_mm[:, 0]
    np.testing.assert_allclose(reading[:7] - x[:7], 1e-3 * np.round(8 * np.sin(x[:7] / 120) + 3, 2), atol=1e-9)
    assert ("Errors" in titles) != any("no unit is given" in text for text in found.assumptions)


def test_tolerances_are_no_runs(trunnion: Machine, tmp_path: Path) -> None:
    """A report with one row for each axis and columns +TOL and -TOL was read as a positioning test of two runs."""
    rows = [f"{axis} {10.0 * n:.4f} {10.0 * n + 0.01:.4f} 0.010 0.010 0.0100" for n in range(6) for axis in "XYZ"]
    error = refusal(put(tmp_path, "AX NOMINAL MEAS +TOL -TOL DEV\n" + "\n".join(rows)), trunnion)
    assert "one row for each axis or feature" in error.what and error.line == 1


def test_collection_group_and_point(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    """Points as ``A::Round_1::P001`` with an offset behind x, y, z; the plan has the names of the points alone."""
    lines = [f"A::Round_1::P{n:03d}, {', '.join(f'{v:.4f}' for v in p)}, 0.000" for n, p in enumerate(own.xyz)]
    plan = ["X_mm,Y_mm,Z_mm,A_deg,C_deg,target,carrier,point"]
    plan += [f"{','.join(map(str, q))},{own.target[n]},{own.side[n]},P{n:03d}" for n, q in enumerate(own.q)]
    path = put(tmp_path, "// Units: Millimeters\n" + "\n".join(lines))
    (tmp_path / "plan.csv").write_text("\n".join([plan[0], *reversed(plan[1:])]))
    data = check(read(path, trunnion, plan=tmp_path / "plan.csv"), own)
    assert {*data.round.tolist()} == {"1"}


def test_sides_by_the_words_of_any_column(trunnion: Machine, own: forms.Table, tmp_path: Path) -> None:
    rows = ["Punkt;X Soll;Y Soll;Z Soll;A Soll;C Soll;X Ist;Y Ist;Z Ist;Ort", ";mm;mm;mm;Grad;Grad;mm;mm;mm;"]
    for q, p, name, side in zip(own.q, own.xyz, own.target, own.side, strict=True):
        numbers = ";".join(f"{v:.4f}".replace(".", ",") for v in (*q, *p))
        rows.append(f"{name};{numbers};{'Spindel' if side == 'tool' else 'Tisch'}")
    found = import_table(put(tmp_path, "\n".join(rows), "cp1252"), trunnion)
    assert [text for text in found.assumptions if "carrier" in text] == []
    check(read(put(tmp_path, "\n".join(rows), "cp1252"), trunnion), own)


def test_a_probe_at_a_sphere_line_by_line(trunnion: Machine, tmp_path: Path) -> None:
    """Lines that name their values: the refusal's line makes them positions of a probe with its tip at the sphere's centre."""
    own = [
        (300.0012, 250.0031, -120.4412, 0.0, 0.0),
        (300.0112, 250.0131, -120.4512, 0.0, 90.0),
        (301.0, 251.0, -119.0, -30.0, 0.0),
    ]
    lines = [
        "%",
        "O9996 CENTRES",
        *(" ".join(f"{a}={v:.4f}" for a, v in zip("XYZAC", row, strict=True)) for row in own),
        "%",
    ]
    found = cured(put(tmp_path, "\n".join(lines), name="dprnt.txt"), trunnion)
    data = found.measurements
    assert (
        data is not None
        and {*data.station_carrier} == {"tool"}
        and {*data.carrier} == {"work"}
        and {*data.instrument} == {"probe"}
    )
    np.testing.assert_allclose(data.positions, own, atol=1e-9)
    assert not data.point_mm.any()


def test_a_log_of_cycle_996_says_what_to_write_instead(trunnion: Machine, tmp_path: Path) -> None:
    log = "CYCLE996 Kinematik vermessen\nP1: A=0.0 C=0.0 X=300.0 Y=250.0 Z=-120.0\nP2: A=-45.0 C=0.0 X=300.1 Y=250.1 Z=-120.1\n"
    error = refusal(put(tmp_path, log, name="log.txt"), trunnion)
    assert "CYCLE996" in error.what and "WRITE" in str(error) and "twin plan --program" in str(error)


def test_a_single_run_of_a_laser_is_cured_by_its_axis(trunnion: Machine, tmp_path: Path) -> None:
    """Columns of angles and straightness beside the length are no coordinates."""
    rows = ["Axis,X", "Unit,mm", "", "No.,Nominal,Linear,Pitch [arcsec],Yaw [arcsec]"]
    rows += [f"{n},{100.0 * n:.1f},{100.0 * n + 0.01:.4f},{0.3 * n:.1f},{0.1 * n:.1f}" for n in range(1, 8)]
    found = cured(put(tmp_path, "\n".join(rows)), trunnion)
    assert found.measurements is not None
    np.testing.assert_allclose(found.measurements.point_mm[:, 0] - found.measurements.positions[:, 0], 0.01, atol=1e-9)


def test_an_xml_file_is_no_table(trunnion: Machine, tmp_path: Path) -> None:
    text = '<?xml version="1.0"?><Test><Radius unit="mm">150</Radius><Data>1.0 2.0 3.0</Data></Test>'
    assert "an XML file" in refusal(put(tmp_path, text, name="test.xml"), trunnion).what
