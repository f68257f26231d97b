"""Tests common to all formats of measured data; the valid and the invalid files of each are in `cases`."""

from __future__ import annotations

import inspect
import os
import re
from pathlib import Path

import numpy as np
import pytest

from tests.measurement.formats.cases import CASES, spheres
from twin._common.errors import InputError
from twin.cli.doc import page_text
from twin.machine.machine import Machine
from twin.measurement.formats import FORMATS, ConvertedFiles, MeasuredFormat, convert, format_named, format_of
from twin.measurement.formats.heidenhain import MASK
from twin.measurement.table import Measurements

every_format = pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)


def put(folder: Path, form: MeasuredFormat, text: str | None = None) -> Path:
    case = CASES[form.name]
    path = folder / case.FILE
    path.write_text(case.GOOD if text is None else text, encoding="utf-8", newline="")
    return path


def read(path: Path, form: MeasuredFormat) -> tuple[ConvertedFiles, Machine]:
    case = CASES[form.name]
    machine = Machine.load(case.MACHINE)
    return convert(path, machine, case.GIVEN, format_name=form.name), machine


@every_format
def test_the_rows_are_those_of_the_case(form: MeasuredFormat, tmp_path: Path) -> None:
    case = CASES[form.name]
    table = read(put(tmp_path, form), form)[0].measurements
    state = {name: getattr(table, name) for name in ("positions", "point_mm", "approach", "feed_mm_min")}
    state |= {f"T_{name}_degC": values for name, values in table.temperature_degC.items()}
    for name, expected in case.ROWS.items():
        np.testing.assert_allclose(state[name], expected, rtol=0.0, atol=case.AGREES_MM, err_msg=name)
    station, rides_on, carrier = case.SIDES
    assert set(table.station) == {station} and set(table.station_carrier) == {rides_on}
    assert set(table.carrier) == {carrier} and not table.simulated


@every_format
def test_the_table_that_is_written_reads_back(form: MeasuredFormat, tmp_path: Path) -> None:
    """Also its comments: origin, assumptions, and all that is not verified."""
    found, machine = read(put(tmp_path, form), form)
    found.save(tmp_path / "measured.csv", machine)
    comments = [line for line in (tmp_path / "measured.csv").read_text().splitlines() if line.startswith("#")]
    assert comments[0].startswith(f"# converted from {CASES[form.name].FILE}, ")
    assert {f"# not verified: {text}" for text in form.specification.unverified} <= set(comments)
    assert all(text in found.to_text() for text in found.notes)
    if len(found.measurements) < 3:
        return  # too few for a station; twin says so when it loads them
    back = Measurements.load(tmp_path / "measured.csv", machine)
    for name, values in found.measurements.arrays().items():
        if name != "lines":
            np.testing.assert_array_equal(getattr(back, name), values, err_msg=name)


@every_format
def test_line_ends_and_byte_order_mark_do_not_matter(form: MeasuredFormat, tmp_path: Path) -> None:
    windows = "\ufeff" + CASES[form.name].GOOD.replace("\n", "\r\n")
    expected = read(put(tmp_path, form), form)[0].measurements.arrays()
    found = read(put(tmp_path, form, windows), form)[0].measurements.arrays()
    for name in expected:
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)


@every_format
def test_a_format_is_recognised_by_its_content(form: MeasuredFormat, tmp_path: Path) -> None:
    path = put(tmp_path, form)
    assert format_of(path) is form
    assert format_of(path.rename(tmp_path / "unknown.dat")) is form
    assert format_named(form.name) is form and path.suffix in form.specification.suffixes


@every_format
def test_every_format_is_documented(form: MeasuredFormat) -> None:
    module = inspect.getmodule(type(form))
    assert (module is not None and len(module.__doc__ or "") > 300) or form.name == "tracker"
    spec = form.specification
    row = f"| `{spec.name}` {spec.title} | {' '.join(spec.suffixes)} | {spec.gives} | {spec.needs or '(complete)'} |"
    assert row in page_text("convert") and spec.source
    (line,) = (text for text in page_text("convert").splitlines() if text.startswith(f"- `{spec.name}` ("))
    assert spec.source in line and all(text in line for text in spec.unverified)
    assert [one.name for one in FORMATS].count(form.name) == 1


@pytest.mark.parametrize(
    ("name", "old", "new", "line", "what"), [(name, *bad) for name, case in CASES.items() for bad in case.BAD]
)
def test_refused(name: str, old: str, new: str, line: int | None, what: str, tmp_path: Path) -> None:
    good, form = CASES[name].GOOD, format_named(name)
    assert old in good
    with pytest.raises(InputError, match=what) as caught:
        read(put(tmp_path, form, good.replace(old, new, 1)), form)
    assert caught.value.line == line
    assert Path(str(caught.value.file)).name == CASES[name].FILE and "\n" not in str(caught.value)


@every_format
def test_a_truncated_file_is_refused_or_gives_fewer_rows(form: MeasuredFormat, tmp_path: Path) -> None:
    """Cut after every tenth of the file: never another exception, never rows that the whole file does not have."""
    good, whole = CASES[form.name].GOOD, read(put(tmp_path, form), form)[0].measurements
    refused = 0
    for share in range(10):
        try:
            part = read(put(tmp_path, form, good[: len(good) * share // 10]), form)[0].measurements
        except InputError as error:
            refused += 1
            assert error.file is not None and "\n" not in str(error)
        else:
            assert len(part) <= len(whole)
    assert refused >= 6


@every_format
def test_what_the_file_lacks_must_be_given(form: MeasuredFormat, tmp_path: Path) -> None:
    path, machine = put(tmp_path, form), Machine.load(CASES[form.name].MACHINE)
    if form.specification.needs.startswith(("positions of the other", "the centre", "a plan")):
        with pytest.raises(InputError, match="position"):
            convert(path, machine)


def test_several_files_have_rounds_of_their_own(tmp_path: Path) -> None:
    form = format_named("contacts")
    first, machine = put(tmp_path, form), Machine.load("dmu50")
    second = tmp_path / "again.csv"
    second.write_text(CASES["contacts"].GOOD)
    found = convert([first, second], machine, CASES["contacts"].GIVEN)
    assert len(found.measurements) == 6 and len(set(found.measurements.round)) == 2
    laser = tmp_path / "x.rtl"
    laser.write_text(CASES["renishaw-laser"].GOOD)
    with pytest.raises(InputError, match="files of different formats"):
        convert([first, laser], machine, CASES["contacts"].GIVEN)


def test_an_unknown_file(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello\n")
    with pytest.raises(InputError, match="no known format"):
        format_of(tmp_path / "a.txt")
    with pytest.raises(InputError, match="no such format"):
        format_named("renishaw_laser")


def test_the_mask_of_the_manual_prints_what_is_read() -> None:
    """The text of the mask, filled in by the rules of printf, gives the file of the case."""
    text, _, parameters = MASK.removeprefix('"').partition('",')
    assert parameters.count("Q") == text.count("%") == 6 and f"    {MASK}\n" in page_text("convert")
    printed = "".join(text % (*point, b, c, 1) + "\n" for point, _, b, c in spheres.contacts())
    assert printed == CASES["heidenhain"].GOOD


def test_a_binary_dynamic_capture_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.rtx"
    path.write_bytes(b"HEADER::\r\nOwner : CARTO-Dynamic\r\nData:\r\n" + os.urandom(64) + b"EOF::\r\n")
    with pytest.raises(InputError, match="dynamic capture"):
        convert(path, Machine.load("dmu50"))


def test_the_readings_of_a_ball_bar_can_be_named(tmp_path: Path) -> None:
    """Two lists of lengths in a run are not guessed from; one is named. Absolute lengths are recognised as such."""
    from dataclasses import replace

    case, form = CASES["renishaw-ballbar"], format_named("renishaw-ballbar")
    absolute = " ".join(f"{100 + value * 1e-3:.4f}" for value in case.DEVIATIONS["CCW"])
    more = case.GOOD.replace("</BALLBAR_RUN>", f'<RAW DT="UT_LENGTH_MM">{absolute}</RAW></BALLBAR_RUN>')
    path, machine = put(tmp_path, form, more), Machine.load("dmu50")
    with pytest.raises(
        InputError, match=r"2 lists of lengths .*READINGS \(9 numbers, DT UT_LENGTH_UM\), RAW"
    ) as caught:
        convert(path, machine, case.GIVEN)
    assert caught.value.setting == "trace"
    named = convert(path, machine, replace(case.GIVEN, trace="READINGS")).measurements
    np.testing.assert_allclose(named.point_mm, case.ROWS["point_mm"], atol=1e-9)
    raw = convert(path, machine, replace(case.GIVEN, trace="RAW"))
    np.testing.assert_allclose(raw.measurements.point_mm[:9, 0], case.ROWS["point_mm"][:9, 0], atol=1e-9)
    assert "assumed: the readings are the length itself" in raw.notes


def test_a_laser_file_with_decimal_commas(tmp_path: Path) -> None:
    """All numbers have commas, as in a country that writes them; a file with both signs is refused (`BAD` of the case)."""
    form, case = format_named("renishaw-laser"), CASES["renishaw-laser"]
    commas = "\n".join(
        re.sub(r"(\d)\.(\d+)", r"\1,\2", line) for line in case.GOOD.split("\n") if "Version" not in line
    )
    assert commas.count(",") > 20
    found = convert(put(tmp_path, form, commas), Machine.load("dmu50"), case.GIVEN).measurements
    np.testing.assert_allclose(found.point_mm, case.ROWS["point_mm"], atol=1e-9)
    np.testing.assert_allclose(found.temperature_degC["air"], case.ROWS["T_air_degC"])


def test_positions_outside_the_machine_are_refused(tmp_path: Path) -> None:
    """Coordinates of a work offset instead of the machine's: all positions would fit after one constant."""
    from dataclasses import replace

    form, case = format_named("renishaw-laser"), CASES["renishaw-laser"]
    with pytest.raises(InputError, match="outside the machine's range"):
        convert(put(tmp_path, form), Machine.load("dmu50"), replace(case.GIVEN, offset={"X": 2000.0}))
