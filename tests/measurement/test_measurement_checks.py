"""Equal rows, positions outside the range, stations without a reading: refused, set aside or reported while a table is read."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.truth.few_axes import write_drill
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.measurement.columns import copied_rows, overstated_noise
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.samples import thesis_plan

SEED = 20


@pytest.fixture(scope="module")
def tracked(dmu50: Machine) -> Measurements:
    """Return the thesis's plan measured by a laser tracker, written to hundredths of a micrometre; four rounds."""
    rng = np.random.default_rng(SEED)
    data = simulate(thesis_plan.plan(dmu50), dmu50, Calibration.default(dmu50), LaserTracker(), rng)[0]
    return replace(data, point_mm=read_only(np.round(data.point_mm, 5)))


def pasted(data: Measurements, machine: Machine, path: Path, rows: list[int], *without: str) -> Path:
    """Return the table as a file with some rows repeated after the last; columns that begin with ``without`` are left out."""
    lines = [line.split(",") for line in data.to_csv(machine).splitlines() if not line.startswith("#")]
    lines += [lines[row + 1] for row in rows]
    keep = [i for i, name in enumerate(lines[0]) if not name.startswith(without or "-")]
    path.write_text("\n".join(",".join(line[i] for i in keep) for line in lines) + "\n")
    return path


@pytest.mark.parametrize("without", [(), ("round",), ("round", "approach")], ids=lambda names: "-".join(names) or "all")
def test_a_pasted_row_of_a_tracker_is_a_copy(
    dmu50: Machine, tracked: Measurements, tmp_path: Path, without: tuple[str, ...]
) -> None:
    """No time is given. 16 repeats of a point at 5 µm and digits of 0.01 µm: chance makes an equal pair in 10⁶ tables."""
    found = Measurements.load(pasted(tracked, dmu50, tmp_path / "m.csv", [3, 400], *without), dmu50)
    assert len(found) == len(tracked)
    assert [(note.line, note.text) for note in found.set_aside] == [
        (len(tracked) + 2, "copy of line 5: equal in every column"),
        (len(tracked) + 3, "copy of line 402: equal in every column"),
    ]


@pytest.mark.parametrize("rows", [10, 840])
def test_a_table_pasted_twice(dmu50: Machine, tracked: Measurements, tmp_path: Path, rows: int) -> None:
    """With and without repeats that differ."""
    part = tracked.select(np.arange(rows))
    path = pasted(part, dmu50, tmp_path / "m.csv", list(range(rows)), "round")
    found = Measurements.load(path, dmu50)
    assert len(found) == rows and [note.line for note in found.set_aside] == list(range(rows + 2, 2 * rows + 2))


def gauge(machine: Machine, path: Path, *, step_mm: float, noise_mm: float, times: bool = False) -> Path:
    """Return a drill's x measured by a gauge with coarse steps: 5 positions, 40 readings of each, no rounds."""
    rng = np.random.default_rng(SEED)
    x = np.tile(np.linspace(0.0, 200.0, 5), 40)
    read = np.round((x * (1.0 + 30e-6) + rng.normal(0.0, noise_mm, len(x))) / step_mm) * step_mm
    lines = ["X_mm,Z_mm,target,carrier,x_mm,y_mm,z_mm" + (",time_s" if times else "")]
    lines += [
        f"{q:g},0,G,work,{-m:.5f},," + (f",{10 * i}" if times else "")
        for i, (q, m) in enumerate(zip(x, read, strict=True))
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(("step_mm", "noise_mm"), [(0.0025, 0.004), (0.01, 0.003), (0.01, 0.0), (0.05, 0.004)])
def test_equal_readings_of_a_coarse_gauge_are_no_copies(tmp_path: Path, step_mm: float, noise_mm: float) -> None:
    """Steps as fine as the noise, coarser, and so coarse that no repeat differs."""
    machine = Machine.load(write_drill(tmp_path))
    found = Measurements.load(gauge(machine, tmp_path / "m.csv", step_mm=step_mm, noise_mm=noise_mm), machine)
    assert len(found) == 200 and not found.set_aside


def test_times_decide(tmp_path: Path) -> None:
    """The same gauge with times: no reading is taken twice at one time, so that the pasted row is found."""
    machine = Machine.load(write_drill(tmp_path))
    path = gauge(machine, tmp_path / "m.csv", step_mm=0.01, noise_mm=0.003, times=True)
    assert not Measurements.load(path, machine).set_aside
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, lines[7]]) + "\n")
    (note,) = Measurements.load(path, machine).set_aside
    assert (note.line, note.text) == (202, "copy of line 8: equal in every column")
    # Times of the minute are shared by different readings: they do not tell.
    coarse = [re.sub(r"(\d+)$", lambda found: str(int(found[1]) // 600), line) for line in lines[1:]]
    path.write_text("\n".join([lines[0], *coarse]) + "\n")
    assert not Measurements.load(path, machine).set_aside


@pytest.mark.parametrize("column", ["T_bed_degC", "readback_X_mm", "u_x_mm", "load_kg"])
def test_a_row_that_differs_in_any_column_is_no_copy(
    dmu50: Machine, tracked: Measurements, tmp_path: Path, column: str
) -> None:
    """Also in the last column, which is unknown."""
    lines = pasted(tracked, dmu50, tmp_path / "m.csv", [3]).read_text().splitlines()
    text = [f"{lines[0]},{column}", *(f"{line},0.01" for line in lines[1:-1]), f"{lines[-1]},0.02"]
    (tmp_path / "m.csv").write_text("\n".join(text) + "\n")
    assert not Measurements.load(tmp_path / "m.csv", dmu50).set_aside
    (tmp_path / "m.csv").write_text("\n".join([*text[:-1], f"{lines[-1]},0.01"]) + "\n")
    (note,) = Measurements.load(tmp_path / "m.csv", dmu50).set_aside
    assert note.line == len(tracked) + 2


def shifted(data: Measurements, machine: Machine, path: Path, axis: int, change: float, factor: float = 1.0) -> Path:
    positions = np.array(data.positions)
    positions[:, axis] = positions[:, axis] * factor + change
    replace(data, positions=read_only(positions)).save(path, machine)
    return path


@pytest.mark.parametrize(
    ("axis", "change", "words", "likely"),
    [
        (0, 600.0, "X_mm is 600 … 1100, the range of X 0 … 500", "subtract 600 mm from X_mm?"),
        (0, -250.0, "X_mm is -250 … 250, the range of X 0 … 500", "subtract -250 mm from X_mm?"),
        (0, 50.0, "X_mm is 50 … 550, the range of X 0 … 500", "subtract 50 mm from X_mm?"),
        (1, 60.0, "Y_mm is 60 … 510, the range of Y 0 … 450", "subtract 60 mm from Y_mm?"),
        (2, 400.0, "Z_mm is 0 … 400, the range of Z -400 … 0", "subtract 400 mm from Z_mm?"),
        (3, -90.0, "B_deg is -90 … 90, the range of B 0 … 180", "subtract -90 deg from B_deg?"),
    ],
)
def test_a_missing_offset_is_named(
    dmu50: Machine, tracked: Measurements, tmp_path: Path, axis: int, change: float, words: str, likely: str
) -> None:
    """All rows outside the range, or a part of them."""
    path = shifted(tracked, dmu50, tmp_path / "m.csv", axis, change)
    with pytest.raises(InputError) as caught:
        Measurements.load(path, dmu50)
    assert words in caught.value.what and likely in caught.value.expected
    assert caught.value.file == str(path) and caught.value.line is not None
    line = path.read_text().splitlines()[caught.value.line - 1].split(",")
    assert float(line[axis]) == float(str(caught.value.value))


def test_micrometres_are_named(dmu50: Machine, tracked: Measurements, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="X_mm looks like micrometres: divide by 1000"):
        Measurements.load(shifted(tracked, dmu50, tmp_path / "m.csv", 0, 0.0, 1e3), dmu50)


def test_single_rows_outside_the_range_are_set_aside(dmu50: Machine, tracked: Measurements, tmp_path: Path) -> None:
    """Typing errors on either side are no offset."""
    positions = np.array(tracked.positions)
    positions[[5, 100, 300], 0] = [600.0, 501.0, -70.0]
    replace(tracked, positions=read_only(positions)).save(tmp_path / "m.csv", dmu50)
    found = Measurements.load(tmp_path / "m.csv", dmu50)
    assert len(found) == len(tracked) - 3
    assert {note.text for note in found.set_aside} == {"the command of X is outside its range 0 … 500 mm"}


def test_a_station_without_a_reading_is_named(dmu50: Machine, tracked: Measurements, tmp_path: Path) -> None:
    """A notice if other stations remain; refused if it is the only one. The same for a target."""
    points, stations = np.array(tracked.point_mm), np.array(tracked.station)
    stations[:40], points[:40] = "west", np.nan
    points[tracked.target == "P"] = np.nan
    lost = int(np.count_nonzero(tracked.target == "P"))
    replace(tracked, point_mm=read_only(points), station=read_only(stations)).save(tmp_path / "m.csv", dmu50)
    assert Measurements.load(tmp_path / "m.csv", dmu50).notices[:3] == (
        "the file says: simulated readings",
        "station west is not used: none of its 40 rows is usable (no coordinate was measured)",
        f"target P is not used: none of its {lost} rows is usable (no coordinate was measured)",
    )
    lines = tmp_path / "n.csv"
    lines.write_text(
        "X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm,station\n" + "0,0,0,0,0,K,tool,,,,west\n" * 4
    )
    with pytest.raises(InputError, match="station west: no coordinate was measured") as caught:
        Measurements.load(lines, dmu50)
    assert caught.value.line == 2


@pytest.mark.parametrize(("expected", "copied"), [(0.021, False), (0.0045, True)])
def test_equal_readings_are_copies_below_one_expected_in_a_hundred_tables(expected: float, copied: bool) -> None:
    """Forty readings of one point with a resolution of 1 µm: two normal readings agree with the probability r/(2√π σ) a coordinate."""
    rng, n, resolution = np.random.default_rng(12), 40, 1e-3
    pairs = n * (n - 1) / 2
    sigma = resolution / (2.0 * np.sqrt(np.pi)) * (pairs / expected) ** (1.0 / 3.0)
    points = rng.normal(0.0, 1.0, (n, 3))
    # Of exactly this standard deviation between successive readings, which is what the noise is estimated from.
    points *= sigma / np.sqrt(np.mean(np.diff(points, axis=0) ** 2, axis=0) / 2.0)
    points = np.round(points / resolution) * resolution
    points[30] = points[4]
    same = [b"one point"] * n
    found = copied_rows(points, same, same, same, np.full(n, np.nan))
    assert found == ({30: 4} if copied else {})


@pytest.mark.parametrize(
    ("chi2", "dof", "noticed"), [(4.9, 50, True), (5.1, 50, False), (1.0, 19, False), (1.0, 20, True)]
)
def test_a_noise_stated_too_large_is_noticed(chi2: float, dof: float, noticed: bool) -> None:
    """Reduced chi² below a tenth, from twenty degrees of freedom on; the text says how many times the noise is too large."""
    found = overstated_noise(0.3, chi2, dof)
    assert len(found) == int(noticed)
    assert not noticed or f"{np.sqrt(dof / chi2):.3g} times the residuals (0.3 µm)" in found[0]
