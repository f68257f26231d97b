"""The measurement table: content, round trip, rows set aside and tables refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.columns import RowNote, grouped_notes, overstated_noise
from twin.measurement.formats.tracker import load_export
from twin.measurement.table import Measurements

HEADER = "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm"
ROW = "{x},100,-50,0,0,K,tool,{x}.01,1.5,2.5"


def table(tmp_path: Path, *rows: str, header: str = HEADER) -> Path:
    path = tmp_path / "m.csv"
    path.write_text("# a comment\n" + header + "\n" + "\n".join(rows) + "\n")
    return path


def rows(*xs: int) -> list[str]:
    return [ROW.format(x=x) for x in xs]


def test_reads_all_documented_columns(dmu50: Machine, tmp_path: Path) -> None:
    header = HEADER + ",station,round,time_s,approach_X,T_X_degC,T_bed_degC,readback_X_mm,u_x_mm,u_y_mm,u_z_mm"
    tail = ",s1,2,{t},-1,20.5,21,{x}.001,0.002,0.003,"
    path = table(tmp_path, *(ROW.format(x=x) + tail.format(t=x, x=x) for x in (0, 50, 100)), header=header)
    found = Measurements.load(path, dmu50)
    assert len(found) == 3
    assert found.positions.tolist() == [[x, 100.0, -50.0, 0.0, 0.0] for x in (0.0, 50.0, 100.0)]
    assert found.point_mm[1] == pytest.approx([50.01, 1.5, 2.5])
    assert found.lines.tolist() == [3, 4, 5]
    assert set(found.station) == {"s1"} and set(found.round) == {"2"}
    assert found.approach[:, 0].tolist() == [-1.0, -1.0, -1.0] and not found.approach[:, 1:].any()
    assert sorted(found.temperature_degC) == ["X", "bed"]
    assert found.readback[2, 0] == 100.001 and np.isnan(found.readback[:, 1:]).all()
    assert np.isnan(found.u_mm[:, 2]).all() and found.u_mm[0, 1] == 0.003
    assert not found.set_aside and not found.notices
    with pytest.raises(ValueError, match="read-only"):
        found.point_mm[0, 0] = 1.0


@given(seed=st.integers(0, 2**32 - 1))
def test_write_then_read(dmu50: Machine, tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 30))
    point = rng.normal(size=(n, 3)) * 1e3
    point[rng.random((n, 3)) < 0.2] = np.nan
    point[:, 0] = np.where(np.isnan(point).all(axis=1), 1.0, point[:, 0])
    original = Measurements(
        source="drawn",
        lines=np.arange(n),
        positions=rng.uniform([0, 0, -400, 0, -360], [500, 450, 0, 180, 360], (n, 5)),
        readback=np.where(rng.random((n, 5)) < 0.5, np.nan, rng.normal(size=(n, 5))),
        target=np.array(["K", "P"], dtype=object)[rng.integers(0, 2, n)],
        carrier=np.full(n, "tool", dtype=object),
        station=np.full(n, "east", dtype=object),
        round=np.full(n, "1", dtype=object),
        point_mm=point,
        u_mm=rng.uniform(1e-4, 1e-2, (n, 3)),
        time_s=np.arange(n, dtype=float),
        approach=rng.integers(-1, 2, (n, 5)).astype(float),
        place_mm=np.tile(rng.normal(size=3), (n, 1)) if rng.random() < 0.5 else np.full((n, 3), np.nan),
        station_pose=np.tile(rng.normal(size=6), (n, 1)) if rng.random() < 0.5 else np.full((n, 6), np.nan),
        temperature_degC={"bed": rng.normal(20, 1, n)},
    )
    path = tmp_path_factory.mktemp("m") / "m.csv"
    original.save(path, dmu50, comment="drawn\nfor a test")
    again = Measurements.load(path, dmu50)
    for name in ("positions", "readback", "point_mm", "u_mm", "time_s", "approach", "place_mm", "station_pose"):
        assert np.array_equal(getattr(again, name), getattr(original, name), equal_nan=True), name
    assert again.target.tolist() == original.target.tolist()
    assert np.array_equal(again.temperature_degC["bed"], original.temperature_degC["bed"])


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ("nan,100,-50,0,0,K,tool,1,2,3", "not finite"),
        ("50,100,-50,0,0,K,tool,inf,2,3", "coordinate is not finite"),
        ("50,100,-50,0,0,K,tool,nan,2,3", "coordinate is not finite"),
        ("50,100,-50,0,0,K,tool,,,", "no coordinate"),
        ("50,100,-50,190,0,K,tool,1,2,3", "the command of B is outside its range"),
        ("0,100,-50,0,0,K,tool,0.01,1.5,2.5", "copy of line 3"),
    ],
)
def test_rows_set_aside_say_why(dmu50: Machine, tmp_path: Path, bad: str, reason: str) -> None:
    found = Measurements.load(table(tmp_path, *rows(0, 50, 100), bad, *rows(150)), dmu50)
    assert len(found) == 4
    (note,) = found.set_aside
    assert note.line == 6
    assert reason in note.text


def test_notes_are_grouped_by_reason() -> None:
    """One line for each reason: count, first lines, the worst row; a single row unchanged."""
    off = [RowNote(line, f"{line} µm off", kind="too far off", size=float(line)) for line in (4, 9, 7)]
    alike = [RowNote(line, "no coordinate was measured") for line in range(10, 1010)]
    assert grouped_notes([off[0], *alike, RowNote(3, "12 mm off", kind="off", size=12.0), *off[1:]]) == [
        "3 rows (lines 4, 9, 7): too far off; worst, line 9: 9 µm off",
        "1,000 rows (lines 10, 11, 12, 13, 14 and 995 more): no coordinate was measured",
        "line 3: 12 mm off",
    ]
    assert grouped_notes([]) == []


def test_a_station_with_too_few_points(dmu50: Machine, tmp_path: Path) -> None:
    lines = [row + ",a" for row in rows(0, 50, 100)] + [row + ",b" for row in rows(150, 200)]
    found = Measurements.load(table(tmp_path, *lines, header=HEADER + ",station"), dmu50)
    assert len(found) == 3
    assert [note.line for note in found.set_aside] == [6, 7]
    assert "station b" in found.set_aside[0].text


def test_a_coordinate_that_was_not_measured_is_no_fault(dmu50: Machine, tmp_path: Path) -> None:
    found = Measurements.load(table(tmp_path, *rows(0, 50), "100,100,-50,0,0,K,tool,100.01,,"), dmu50)
    assert np.isnan(found.point_mm[2, 1:]).all() and not found.set_aside


def test_missing_rounds_are_noticed(dmu50: Machine, tmp_path: Path) -> None:
    first = [row + ",1" for row in rows(0, 50, 100, 150)]
    second = [row.replace(".01,", ".02,") + ",2" for row in rows(0, 50, 100)]
    found = Measurements.load(table(tmp_path, *first, *second, header=HEADER + ",round"), dmu50)
    assert found.notices == ("target K: round 2 lacks 1 of 4 positions",)


@pytest.mark.parametrize(
    ("lines", "header", "line", "words"),
    [
        ([], HEADER, None, "one row for each point"),
        (rows(0), HEADER.replace("X_mm", "X_m"), 2, "column X_mm is missing (the table has X_m)"),
        (rows(0), HEADER.replace("carrier", "side"), 2, "carrier"),
        (rows(0), HEADER.replace("Y_mm", "X_mm"), 2, "each column once"),
        ([*rows(0), ROW.format(x=50).replace("tool", "table")], HEADER, 4, "tool or work"),
        ([*rows(0), ROW.format(x=50).replace("tool", "work")], HEADER, 4, "one carrier for each target"),
        ([*rows(0), ROW.format(x=50).replace("1.5", "1,5")], HEADER, 4, "11 cells"),
        ([*rows(0), ROW.format(x=50).replace("1.5", "1.5mm")], HEADER, 4, "1.5mm"),
        ([*rows(0), ROW.format(x=50).replace("K", "")], HEADER, 4, "no target in this row"),
        ([row + ",2" for row in rows(0, 50)], HEADER + ",approach_X", 3, "+1, -1 or 0"),
        (["50,100,-50,0,0,K,tool,,,"], HEADER, 3, "no usable row of station 1"),
    ],
)
def test_bad_tables_say_where(
    dmu50: Machine, tmp_path: Path, lines: list[str], header: str, line: int | None, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        Measurements.load(table(tmp_path, *lines, header=header), dmu50)
    assert caught.value.line == line
    assert words in str(caught.value)


@pytest.mark.parametrize(("separator", "name"), [(";", "semicolons"), ("\t", "tabs")])
def test_another_separator_is_named(dmu50: Machine, tmp_path: Path, separator: str, name: str) -> None:
    path = table(tmp_path, *rows(0, 50, 100))
    path.write_text(path.read_text().replace(",", separator))
    with pytest.raises(InputError, match=f"separated by {name}") as caught:
        Measurements.load(path, dmu50)
    assert caught.value.line == 2 and "decimal points" in caught.value.expected


def test_noise_stated_too_large_is_reported() -> None:
    """Chi² of 20 degrees of freedom is below 2 by chance in one of nine million data sets."""
    assert stats.chi2.cdf(2.0, 20) == pytest.approx(1.1e-7, rel=0.05)
    assert overstated_noise(11.0, 95.0, 100.0) == () and overstated_noise(11.0, 0.1, 10.0) == ()
    (notice,) = overstated_noise(11.0, 1e-4, 100.0)
    assert notice.startswith("assumed: ") and "1000 times the residuals (11 µm)" in notice and "u_x_mm" in notice


def test_unknown_columns_are_reported(dmu50: Machine, tmp_path: Path) -> None:
    found = Measurements.load(
        table(tmp_path, *(row + ",1" for row in rows(0, 50, 100)), header=HEADER + ",aproach_X"), dmu50
    )
    assert found.notices == ("column aproach_X is unknown and not used (did you mean approach_X?)",)


def test_the_thesis_export(dmu50: Machine, tmp_path: Path) -> None:
    """Three targets in blocks of eleven, the positions from the command line; rounds are files."""
    x = np.arange(0.0, 501.0, 50.0)
    positions = np.column_stack([x, np.zeros((11, 2)), np.zeros((11, 2))])
    tables = []
    for number in (1, 2):
        path = tmp_path / f"Round {number}.csv"
        points = [(f"p{i}", q + 10 * k, k, number * 1e-3) for k in range(3) for i, q in enumerate(x)]
        path.write_text("".join(f"{name}, {a}, {b}, {c}\n" for name, a, b, c in points))
        tables.append(load_export(path, dmu50, positions, targets=["K", "P", "Q"], round_name=str(number)))
    both = Measurements.join(tables)
    assert len(both) == 66
    assert both.target[11] == "P" and both.round[33] == "2"
    assert both.positions[12, 0] == 50.0 and both.point_mm[12] == pytest.approx([60.0, 1.0, 1e-3])
    with pytest.raises(InputError, match=r"33 points; expected 22"):
        load_export(tmp_path / "Round 1.csv", dmu50, positions, targets=["K", "P"])
    (tmp_path / "bad.csv").write_text("a, 1, 2\n")
    with pytest.raises(InputError, match=r"bad.csv:1: .*name, x, y, z"):
        load_export(tmp_path / "bad.csv", dmu50, positions, targets=["K"])


KNOWN = HEADER + ",station,place_x_mm,place_y_mm,place_z_mm"
POSE = ",station_x_mm,station_y_mm,station_z_mm,station_a_deg,station_b_deg,station_c_deg"


def test_a_known_place_and_a_known_station(dmu50: Machine, tmp_path: Path) -> None:
    """Given in one row, it holds for the target, or the station, in every row; the others stay unknown."""
    lines = [
        "0,100,-50,0,0,K,tool,1,2,3,s,,,," + ",,,,,",
        "50,100,-50,0,0,K,tool,1,2,3,s,1.5,-2,30," + ",,,,,",
        "0,100,-50,0,0,P,tool,1,2,3,s,,,," + ",,,,,",
        "50,100,-50,0,0,P,tool,1,2,3,t,,,,0,-2000,200,0,0,90",
        "60,100,-50,0,0,P,tool,1,2,3,t,,,,0,-2000,200,0,0,90",
        "70,100,-50,0,0,P,tool,1,2,3,t,,,,0,-2000,200,0,0,90",
    ]
    found = Measurements.load(table(tmp_path, *lines, header=KNOWN + POSE), dmu50)
    assert not found.notices and not found.set_aside
    assert found.place_mm[:2].tolist() == [[1.5, -2.0, 30.0]] * 2 and np.isnan(found.place_mm[2:]).all()
    assert found.station_pose[3:].tolist() == [[0.0, -2000.0, 200.0, 0.0, 0.0, 90.0]] * 3
    assert np.isnan(found.station_pose[:3]).all()
    picked = found.select(found.target == "K")
    assert picked.place_mm.shape == (2, 3) and picked.station_pose.shape == (2, 6)
    with pytest.raises(ValueError, match="read-only"):
        found.place_mm[0, 0] = 1.0


@pytest.mark.parametrize(
    ("tails", "header", "line", "words"),
    [
        (["s,1,2,3", "s,1,2,4", "s,1,2,3"], KNOWN, 4, "two places for target K: '1, 2, 4'"),
        (["s,1,2,3", "s,1,2,3", "s,1,,3"], KNOWN, 5, "incomplete place of target K"),
        (["s,1,2,3", "s,1,2,nan", "s,1,2,3"], KNOWN, 4, "incomplete place of target K"),
        (["s,1,2", "s,,", "s,,"], KNOWN.removesuffix(",place_z_mm"), 3, "place_x_mm, place_y_mm, place_z_mm"),
        (
            ["s,,,,0,0,0,0,0,0", "s,,,,0,0,0,0,0,0", "s,,,,0,0,0,0,0,1"],
            KNOWN + POSE,
            5,
            "two places for station s",
        ),
        (["s,,,,0,0,0,0,0,", "s,,,,,,,,,", "s,,,,,,,,,"], KNOWN + POSE, 3, "station_c_deg"),
    ],
)
def test_places_that_contradict_or_are_given_in_part(
    dmu50: Machine, tmp_path: Path, tails: list[str], header: str, line: int, words: str
) -> None:
    lines = [f"{row},{tail}" for row, tail in zip(rows(0, 50, 100), tails, strict=True)]
    with pytest.raises(InputError) as caught:
        Measurements.load(table(tmp_path, *lines, header=header), dmu50)
    assert caught.value.line == line
    assert words in str(caught.value)


def test_joined_tables_agree_on_places(dmu50: Machine, tmp_path: Path) -> None:
    first = Measurements.load(table(tmp_path, *(row + ",s,1,2,3" for row in rows(0, 50, 100)), header=KNOWN), dmu50)
    silent = Measurements.load(table(tmp_path, *rows(150, 200, 250)), dmu50)
    other = Measurements.load(table(tmp_path, *(row + ",s,1,2,5" for row in rows(0, 50, 100)), header=KNOWN), dmu50)
    assert Measurements.join([silent, first]).place_mm.tolist() == [[1.0, 2.0, 3.0]] * 6
    with pytest.raises(InputError, match="two places for target K"):
        Measurements.join([first, other])


def test_a_plan_is_written_without_coordinates(dmu50: Machine, tmp_path: Path) -> None:
    measured = Measurements.load(table(tmp_path, *rows(0, 50, 100)), dmu50)
    plan = replace(measured, point_mm=np.full((3, 3), np.nan))
    headers = [set(one.to_csv(dmu50).splitlines()[0].split(",")) for one in (measured, plan)]
    assert headers[0] - headers[1] == {"x_mm", "y_mm", "z_mm"}
    path = tmp_path / "plan.csv"
    plan.save(path, dmu50)
    assert Measurements.load(path, dmu50, plan=True).positions.tolist() == plan.positions.tolist()
