"""`twin path`: fewer blocks for the same path, checked by independent interpreters, distances and machine models."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import twin
from tests.nc.nc_support import plain_positions
from tests.truth.machine import RANGES, TruthMachine, run_iso
from twin._common.errors import InputError
from twin.cli.commands import app
from twin.cli.shared.terminal import repeat_options
from twin.compensation import Options
from twin.compensation.fewer_blocks import PathReport, UncertaintyContribution, combined
from twin.compensation.fewer_blocks.refit import Refit, Refitter
from twin.compensation.programs.words import Setup
from twin.machine.machine import Machine
from twin.model.calibration import Calibration

URDF = Path(__file__).resolve().parents[2] / "urdf"
SAMPLES = Path(twin.__file__).parent / "samples"
READ = 1e-9
"""Difference (mm) that parsing and adding decimal numbers may cause."""


# -------------------------------------------------------------------- independent distances and interpreters


def from_line(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return the distance of every point from a polyline, over all pairs of points and segments."""
    found = []
    for point in points:
        a, b = line[:-1], line[1:]
        way = b - a
        share = ((point - a) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-300)
        nearest = a + np.clip(share, 0.0, 1.0)[:, None] * way
        found.append(np.sqrt(((point - nearest) ** 2).sum(axis=1)).min())
    return np.array(found)


def cut(line: np.ndarray, parts: int = 9) -> np.ndarray:
    share = np.arange(parts) / parts
    return np.concatenate([*(a + share[:, None] * (b - a) for a, b in pairwise(line)), line[-1:]])


def hausdorff(one: np.ndarray, other: np.ndarray) -> float:
    return float(max(from_line(cut(one), other).max(), from_line(cut(other), one).max()))


def feed_path(text: str) -> np.ndarray:
    """Return the positions of an absolute metric program from the last rapid before its G1 blocks on."""
    moves = run_iso(text)
    first = next(i for i, (code, _) in enumerate(moves) if code == "G1")
    return np.array([q for _, q in moves[max(first - 1, 0) :]])


def program_of(points: np.ndarray, names: str = "XYZ", decimals: int = 4) -> str:
    rows = [" ".join(f"{n}{v:.{decimals}f}" for n, v in zip(names, row, strict=True)) for row in points]
    return f"G90 G21 G94\nG0 {rows[0]}\nG1 F500\n" + "".join(f"{row}\n" for row in rows[1:]) + "M30\n"


def refitted(machine: Machine, text: str, tolerance: float, name: str = "p.nc", **options: object) -> Refit:
    from twin.nc import dialect_for

    dialect = dialect_for(Path(name))
    chosen = Options(tolerance_mm=tolerance, **options)  # type: ignore[arg-type]
    maker = Refitter(machine, Calibration.zero(machine), chosen, compensated=False)
    return maker.refit(dialect.read(text.encode("latin-1"), name), dialect)


CENTRE = np.array([250.0, 225.0, -200.0])


def circle(count: int = 480, radius: float = 40.0) -> np.ndarray:
    t = np.linspace(0.0, 2.0 * np.pi, count + 1)
    return CENTRE + radius * np.stack([np.cos(t), np.sin(t), 0.0 * t], axis=1)


def helix(count: int = 720) -> np.ndarray:
    t = np.linspace(0.0, 6.0 * np.pi, count + 1)
    return CENTRE + np.stack([20.0 * np.cos(t), 20.0 * np.sin(t), 2.0 * t], axis=1)


def cycloid(count: int = 600, radius: float = 10.0) -> np.ndarray:
    t = np.linspace(0.0, 2.0 * np.pi, count + 1)
    return CENTRE + radius * np.stack([t - np.sin(t), 1.0 - np.cos(t), 0.0 * t], axis=1)


# -------------------------------------------------------------------- the path is kept, with fewer blocks


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [pytest.param(0.005, marks=pytest.mark.slow), 0.02])
@pytest.mark.parametrize("points", [circle(), helix(), cycloid()], ids=["circle", "helix", "cycloid"])
def test_fewer_blocks_on_the_same_path(dmu50: Machine, points: np.ndarray, tolerance: float) -> None:
    text = program_of(points)
    result = refitted(dmu50, text, tolerance)
    run = result.report.runs[0]
    before, after = feed_path(text)[:, :3], feed_path(result.text)[:, :3]
    assert hausdorff(before, after) <= tolerance + READ
    # A chord's length goes with the root of its sagitta: the fewest blocks within ± tolerance, and no more than twice as many.
    bend = np.linalg.norm(np.diff(points, 2, axis=0), axis=1)
    least = float(np.sqrt(bend / 16.0 / tolerance).sum())
    assert least * 0.8 < len(after) - 1 < min(2.0 * least + 4.0, 0.6 * (len(before) - 1))
    assert (run.blocks, run.blocks_out) == (len(before) - 1, len(after) - 1)
    assert run.control_points < 30
    assert after[[0, -1]] == pytest.approx(np.round(before[[0, -1]], 3), abs=6e-4)  # exact, at the least increment
    assert result.report.complete and run.total_um <= tolerance * 1e3
    # The reported error of the executed path is the real one.
    assert run.total_um == pytest.approx(hausdorff(before, after) * 1e3, abs=0.05 * tolerance * 1e3)


@pytest.mark.slow
def test_an_arc_is_two_arcs(dmu50: Machine) -> None:
    """A circle in the trigonometric basis: three control points per arc, one of them shared."""
    run = refitted(dmu50, program_of(circle()), 0.01).report.runs[0]
    assert run.degrees == ("t2", "t2")
    assert run.control_points == 5


@pytest.mark.slow
def test_axes_at_rest_stay_at_rest(dmu50: Machine) -> None:
    after = feed_path(refitted(dmu50, program_of(circle()), 0.01).text)
    assert np.ptp(after[:, 2]) == 0.0


@pytest.mark.slow
@settings(max_examples=3)
@given(st.integers(0, 10_000), st.sampled_from([0.004, 0.01, 0.05]), st.integers(30, 240), st.booleans())
def test_any_smooth_or_rough_path_is_kept(seed: int, tolerance: float, count: int, rough: bool) -> None:
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0.0, 1.0, count)) if rng.random() < 0.5 else np.linspace(0.0, 1.0, count)
    points = CENTRE + sum(
        rng.normal(size=3) * 40.0 / k**2 * np.sin(2.0 * np.pi * k * t[:, None] + rng.uniform(0.0, 6.0))
        for k in range(1, 5)
    )
    if rough:
        points = points + rng.normal(size=points.shape) * rng.choice([1e-3, 0.05, 3.0])
    text = program_of(points)
    result = refitted(Machine.load("dmu50"), text, tolerance)
    assert hausdorff(feed_path(text)[:, :3], feed_path(result.text)[:, :3]) <= tolerance + READ
    assert result.report.blocks_out <= result.report.blocks


def test_a_tolerance_below_the_chord_height_changes_nothing(dmu50: Machine) -> None:
    """Chords 52 µm high cannot be reduced within 10 µm: the output equals the input byte for byte."""
    text = program_of(circle(60))
    result = refitted(dmu50, text, 0.01)
    assert result.text == text
    assert result.report.runs[0].why


# -------------------------------------------------------------------- corners


def legs(*corners: tuple[float, float], step: float = 0.5) -> np.ndarray:
    points = [np.array([*corners[0], 0.0])]
    for a, b in pairwise(corners):
        ends = np.array([[*a, 0.0], [*b, 0.0]])
        count = round(float(np.linalg.norm(ends[1] - ends[0])) / step)
        points += [ends[0] + k / count * (ends[1] - ends[0]) for k in range(1, count + 1)]
    return CENTRE + np.array(points)


def test_a_corner_stays_a_corner(dmu50: Machine) -> None:
    text = program_of(legs((0, 0), (20, 0), (20, 15), (0, 15), (0, 0)))
    result = refitted(dmu50, text, 0.05)
    after = feed_path(result.text)[:, :3] - CENTRE
    assert after.tolist() == [[0, 0, 0], [20, 0, 0], [20, 15, 0], [0, 15, 0], [0, 0, 0]]
    assert result.report.runs[0].corners == 3


def test_lines_and_arcs_between_corners(dmu50: Machine) -> None:
    """A half circle between lines at right angles to it: both corners exact, the arc within the tolerance."""
    t = np.linspace(np.pi, 0.0, 181)
    arc = CENTRE + np.stack([10.0 + 10.0 * np.cos(t), 10.0 * np.sin(t), 0.0 * t], axis=1)
    line = np.linspace([-10.0, 0.0, 0.0], [0.0, 0.0, 0.0], 21) + CENTRE
    off = np.linspace([20.0, 0.0, 0.0], [30.0, 0.0, 0.0], 21) + CENTRE
    text = program_of(np.concatenate([line, arc[1:], off[1:]]))
    result = refitted(dmu50, text, 0.01)
    after = feed_path(result.text)[:, :3]
    assert hausdorff(feed_path(text)[:, :3], after) <= 0.01 + READ
    for corner in ([0.0, 0.0, 0.0], [20.0, 0.0, 0.0]):
        assert np.abs(after - CENTRE - corner).max(axis=1).min() == pytest.approx(0.0, abs=READ)
    assert result.report.blocks_out < 60


# -------------------------------------------------------------------- ends of runs, lines that pass through


def test_everything_else_passes_byte_for_byte(dmu50: Machine) -> None:
    rows = program_of(circle()).splitlines()
    rows[100] += " F300"
    rows[200] += " M8"
    rows.insert(300, "(a remark)")
    rows.insert(400, "G4 P1")
    text = "%\r\n" + "\r\n".join(rows) + "\r\n%"
    result = refitted(dmu50, text, 0.01)
    before, after = text.split("\r\n"), result.text.split("\r\n")
    for kept in ("G90 G21 G94", rows[1], "G1 F500", rows[200], "(a remark)", "G4 P1", "M30"):
        assert kept in after
    assert after[-1] == "%"
    assert sum("F300" in row for row in after) == 1
    assert len(result.report.runs) == 4
    assert [row for row in after if row in before] == [row for row in before if row in set(after)]
    assert hausdorff(feed_path(text)[:, :3], feed_path(result.text)[:, :3]) <= 0.01 + READ
    lines = result.report.runs[0]
    assert (before[lines.first_line - 1], before[lines.last_line - 1]) == (rows[3], rows[99])


@pytest.mark.slow
def test_incremental_and_inch_programs(dmu50: Machine) -> None:
    points = np.round(circle(), 4)
    steps = np.diff(points, axis=0)
    rows = [" ".join(f"{n}{v:.4f}" for n, v in zip("XYZ", row, strict=True)) for row in steps]
    start = " ".join(f"{n}{v:.4f}" for n, v in zip("XYZ", points[0], strict=True))
    text = f"G90 G21\nG0 {start}\nG91\nG1 F500\n" + "\n".join(rows) + "\nG0 Z5\nM30\n"
    result = refitted(dmu50, text, 0.01)
    first = np.array([float(v) for v in re.findall(r"[XYZ](-?[\d.]+)", result.text.splitlines()[1])])
    moved = [
        [float((re.search(rf"{n}(-?[\d.]+)", row) or ["", "0"])[1]) for n in "XYZ"]
        for row in result.text.splitlines()[4:-2]
    ]
    after = first + np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)])
    assert hausdorff(points, after) <= 0.01 + READ
    assert len(after) < 0.4 * len(points)
    inch = program_of(points / 25.4, decimals=6).replace("G21", "G20")
    after = feed_path(refitted(dmu50, inch, 0.01).text)[:, :3] * 25.4
    assert hausdorff(feed_path(inch)[:, :3] * 25.4, after) <= 0.01 + READ


def test_inverse_time_blocks_are_left_unchanged(dmu50: Machine) -> None:
    text = program_of(circle()).replace("G1 F500", "G93 G1 F500")
    result = refitted(dmu50, text, 0.01)
    assert result.text == text
    assert not result.report.runs
    assert "nothing was refitted" in result.report.notes[0].text


# -------------------------------------------------------------------- five axes, compensated


def tips(machine: TruthMachine, commands: np.ndarray, *, real: bool) -> np.ndarray:
    return np.array([machine.pose(q, real=real)[:3, 3] for q in commands])


@pytest.mark.slow
def test_five_axes_compensated(dmu50: Machine) -> None:
    """The cone frustum in axis words; an independent machine with the errors executes the output and the input."""
    result = twin.refit("cone_frustum.nc", dmu50, options=Options(tolerance_mm=0.1, tool_length_mm=120.0))
    truth = TruthMachine(URDF / "dmu50.calibration.yaml", tool_length=120.0)
    original = feed_path((SAMPLES / "cone_frustum.nc").read_text())
    run = result.report.runs[0]
    lines = run.blocks
    words, output = original[: lines + 1], feed_path(result.text)
    output = output[: run.blocks_out + 1]
    assert len(output) - 1 < 0.3 * lines
    meant, done = tips(truth, cut(words, 12), real=False), tips(truth, cut(output, 40), real=True)
    off = max(from_line(meant, done).max(), from_line(done, meant).max())
    # Both are polylines of dense points here. A block of 3° of C bulges by 40 µm at the tool, its chords of 0.25° by 0.3 µm.
    assert off <= 0.1 + 3e-4
    assert off * 1e3 == pytest.approx(run.total_um, abs=0.6)
    assert (
        from_line(meant, tips(truth, cut(output, 12), real=False)).max() > 0.05
    )  # the uncompensated errors are significant


def test_tool_tip_mode_in_plain_language(dmu50: Machine) -> None:
    source = (SAMPLES / "cone_frustum.h").read_text()
    result = refitted(dmu50, source, 0.02, "p.h", tool_length_mm=120.0)
    before, after = np.array(plain_positions(source)), np.array(plain_positions(result.text))
    run = result.report.runs[0]
    inside = before[2 : 2 + run.blocks + 1], after[2 : 2 + run.blocks_out + 1]
    assert hausdorff(inside[0][:, :3], inside[1][:, :3]) <= 0.02 + READ
    # Tip and rotary words at the lever together: the report's own tolerance for angles.
    scale = np.array([1.0, 1.0, 1.0, *[np.radians(120.0)] * 2])
    assert hausdorff(inside[0] * scale, inside[1] * scale) <= 0.02 + READ
    assert result.report.angle_deg == pytest.approx(np.degrees(0.02 / 120.0))
    assert run.blocks_out < 0.5 * run.blocks
    # Half an increment of 1 µm and 0.001° in each axis; the angles count at the length of the tool.
    half_um = 0.5 * np.array([1.0, 1.0, 1.0, *[np.radians(1.0) * 120.0] * 2])
    assert result.report.shares.rounding == pytest.approx(np.linalg.norm(half_um))
    numbers = [int(row.split()[0]) for row in result.text.splitlines()]
    assert numbers == list(range(len(numbers)))
    assert result.text.splitlines()[-3].split(" ", 1)[1] == source.splitlines()[-3].split(" ", 1)[1]


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize("suffix", ["cls", "nc"])
def test_cutter_locations(dmu50: Machine, suffix: str, tmp_path: Path) -> None:
    """Posted blocks are straight in axis words; the independent machine gives the resulting path."""
    options = Options(tolerance_mm=0.05, tool_length_mm=120.0)
    result = twin.refit(
        "cone_frustum.cls", dmu50, options=options, compensated=False, output=tmp_path / f"out.{suffix}"
    )
    source = (SAMPLES / "cone_frustum.cls").read_text()
    numbers = r"GOTO/([-\d.]+),([-\d.]+),([-\d.]+)"
    meant = np.array(re.findall(numbers, source), dtype=float)
    run = result.report.runs[0]
    if suffix == "cls":
        done = np.array(re.findall(numbers, result.text), dtype=float)
    else:
        words = np.array([q for _, q in run_iso(result.text)])
        done = tips(TruthMachine(URDF / "dmu50.calibration.yaml", tool_length=120.0), cut(words, 12), real=False)
    assert run.blocks_out < 0.4 * run.blocks
    assert result.report.complete
    inner = meant[2 : 2 + run.blocks]
    assert from_line(cut(inner, 4), done).max() <= 0.05 + 3e-4  # the chords between points, as above


def test_a_run_outside_a_range_is_left_unchanged(dmu50: Machine) -> None:
    text = program_of(circle() - [220.0, 0.0, 0.0])
    result = refitted(dmu50, text, 0.01)
    assert result.text == text
    assert "range" in result.report.runs[0].why


def test_a_curve_that_touches_a_limit_is_left_unchanged(dmu50: Machine) -> None:
    """The blocks of a curve lie on both sides of it: here they would leave the range of X, which the program does not."""
    text = program_of(circle() - [210.0, 0.0, 0.0])
    assert feed_path(text)[:, 0].min() == 0.0
    assert refitted(dmu50, text, 0.02).text == text


def test_every_feed_begins_where_it_began(dmu50: Machine) -> None:
    """Blocks with different feeds are not joined: the second feed begins at its point, rounded to the increment of 1 µm."""
    points = circle(240)
    lines = program_of(points).splitlines(keepends=True)
    lines[3 + 120] = lines[3 + 120].replace("\n", " F200\n")
    first, second = refitted(dmu50, "".join(lines), 0.02).text.split(" F200\n")
    assert first.count("\n") + second.count("\n") < 120
    before = [float(word[1:]) for word in first.splitlines()[-2].split()]
    assert before == pytest.approx(points[120], abs=6e-4)


def test_control_points_are_those_of_the_chain_of_curves(dmu50: Machine) -> None:
    """Curves share the points at their joints: degrees plus one; an unchanged run has one more point than blocks."""
    (run,) = refitted(dmu50, program_of(circle()), 0.02).report.runs
    assert run.degrees == ("t2", "t2") and run.control_points == 5
    (run,) = refitted(dmu50, program_of(circle(30)), 0.001).report.runs
    assert run.why and run.control_points == run.blocks + 1 == 31


# -------------------------------------------------------------------- points


def table(path: Path, header: str, rows: np.ndarray) -> Path:
    path.write_text(f"# a curve\n{header}\n" + "".join(",".join(f"{v:.7f}" for v in row) + "\n" for row in rows))
    return path


@pytest.mark.slow
def test_points_of_a_curve(dmu50: Machine, tmp_path: Path) -> None:
    points = cycloid()
    source = table(tmp_path / "curve.csv", "x_mm,y_mm,z_mm", points)
    result = twin.refit(source, dmu50, options=Options(tolerance_mm=0.005), compensated=False, feed=400.0)
    after = np.array([q for _, q in run_iso(result.text)])[:, :3]
    assert hausdorff(points, after) <= 0.005 + 1e-6  # the table has seven decimals
    assert len(after) < 0.15 * len(points)
    assert result.text.count("F400") == 1
    assert not re.search(r"\.\d{4}", result.text)  # every word at its least increment


@pytest.mark.parametrize("turning", [False, True])
def test_a_point_at_a_limit_is_rounded_towards_the_inside(dmu50: Machine, tmp_path: Path, turning: bool) -> None:
    """The work offset is between two least increments, so that no word gives the limit itself."""
    low, high = np.array([*list(RANGES.values())[:4], (-np.inf, np.inf)]).T  # C turns without end
    offset = np.array([4e-4, -4e-4, 3e-4, -4e-4, 4e-4])
    t = np.linspace(0.0, 1.0, 201)
    x, y = np.minimum(500.0, 550.0 - 100.0 * t), np.maximum(0.0, 50.0 - 100.0 * t)
    at = np.stack([x, y, 0.0 * t, 20.0 * (1.0 - t), 350.0 + 10.0 * t], axis=1)
    axes = 5 if turning else 3
    header = "x_mm,y_mm,z_mm,B_deg,C_deg" if turning else "x_mm,y_mm,z_mm"
    source = table(tmp_path / "p.csv", header, (at - offset)[:, :axes])
    setup = Setup(work_offset=dict(zip(RANGES, offset.tolist(), strict=True)))
    options = Options(tolerance_mm=0.02, tool_length_mm=120.0, setup=setup)
    result = twin.refit(source, dmu50, options=options, compensated=False)
    reached = (np.array([q for _, q in run_iso(result.text)]) + offset)[:, :axes]
    assert np.all(reached >= low[:axes] - 1e-9) and np.all(reached <= high[:axes] + 1e-9)
    # Where C is rounded by half a least increment, X and Y move by 4 µm at 0.5 m from it.
    assert np.all(np.minimum(reached - low[:axes], high[:axes] - reached)[:, :4].min(axis=0) < 4e-3), "limits are met"
    assert np.abs(reached[[0, -1]] - at[[0, -1], :axes]).max() < (6e-3 if turning else 1e-3)


def test_points_outside_a_range_are_not_moved(dmu50: Machine, tmp_path: Path) -> None:
    points = circle() - [220.0, 0.0, 0.0]
    result = twin.refit(table(tmp_path / "p.csv", "x_mm,y_mm,z_mm", points), dmu50, compensated=False)
    assert np.array([q for _, q in run_iso(result.text)])[:, :3] == pytest.approx(points, abs=5.1e-4)


@pytest.mark.slow
def test_points_with_rotary_axes_and_vectors(dmu50: Machine, tmp_path: Path) -> None:
    t = np.linspace(0.0, 1.0, 301)
    points = np.stack([30.0 * t, 10.0 * np.sin(3.0 * t), 60.0 + 0.0 * t, 20.0 + 15.0 * t, 40.0 * t**2], axis=1)
    source = table(tmp_path / "five.csv", "x_mm,y_mm,z_mm,B_deg,C_deg", points)
    options = Options(tolerance_mm=0.02, tcp=True, tool_length_mm=120.0)
    result = twin.refit(source, dmu50, options=options, compensated=False, output=tmp_path / "o.h")
    after = np.array(plain_positions(result.text))
    scale = np.array([1.0, 1.0, 1.0, *[np.radians(120.0)] * 2])
    assert hausdorff(points * scale, after * scale) <= 0.02 + 1e-6
    assert len(after) < 60
    tilt = 0.2 + 0.1 * t
    vectors = np.stack([np.sin(tilt), 0.0 * t, np.cos(tilt)], axis=1)
    source = table(tmp_path / "v.csv", "x_mm,y_mm,z_mm,i,j,k", np.concatenate([points[:, :3], vectors], axis=1))
    result = twin.refit(source, dmu50, options=options, compensated=False, output=tmp_path / "o.cls")
    found = np.array([row[5:].split(",") for row in result.text.splitlines() if row.startswith("GOTO/")], dtype=float)
    assert hausdorff(points[:, :3], found[:, :3]) <= 0.02 + 1e-6
    assert np.linalg.norm(found[:, 3:], axis=1) == pytest.approx(1.0, abs=1e-8)
    assert len(found) < 60


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("x_mm,y_mm\n1,2\n", ":1:", "not a table of points"),
        ("x_mm,y_mm,z_mm\n1,2,3\n1,2\n", ":3:", "2 values"),
        ("# c\nx_mm,y_mm,z_mm\n1,2,3\n1,two,3\n", ":4:", "y_mm"),
        ("x_mm,y_mm,z_mm\n1,2,nan\n1,2,3\n", ":2:", "z_mm"),
        ("x_mm,y_mm,z_mm\n1,2,3\n", "", "1 point"),
        ("", "", "no header"),
        ("x_mm,y_mm,z_mm,i,j,k\n1,2,3,0,0,1\n1,2,3,0,0,2\n", ":3:", "tool vector"),
    ],
)
def test_tables_that_are_refused(dmu50: Machine, tmp_path: Path, text: str, place: str, message: str) -> None:
    source = tmp_path / "bad.csv"
    source.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        twin.refit(source, dmu50)
    assert f"bad.csv{place}" in str(caught.value)


# -------------------------------------------------------------------- command, report, uncertainty


def invoke(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, repeat_options([str(argument) for argument in arguments]))
    return result.exit_code, result.output if result.exception is None else f"{result.output}{result.exception}"


def test_the_command(tmp_path: Path) -> None:
    source, output, report = tmp_path / "c.nc", tmp_path / "o.nc", tmp_path / "r.json"
    source.write_text(program_of(circle()))
    code, said = invoke("path", source, "-o", output, "--tolerance", "0.02", "--tool-length", "120", "--json", report)
    assert code == 0, said
    assert "480 in 1 run" in said and "ILLUSTRATIVE" in said
    data = json.loads(report.read_text())
    assert data["schema"] == "twin.path/1" and data["complete"]
    shares, used = data["shares_um"], data["used_um"]
    assert shares["rounding"] + shares["compensation"] + shares["path"] == pytest.approx(shares["tolerance"])
    assert used["fit"] < shares["path"] and used["path"] <= shares["path"]
    assert used["machine"] <= shares["rounding"] + shares["compensation"]
    assert used["total"] <= 20.0
    assert data["compensation"]["schema"] == "twin.compensation/1"
    assert data["uncertainty"]["contributions"][0]["name"].startswith("path")


def test_a_block_out_of_range_is_exit_status_3(tmp_path: Path) -> None:
    source, output = tmp_path / "c.nc", tmp_path / "o.nc"
    source.write_text(program_of(circle() - [220.0, 0.0, 0.0]))
    code, said = invoke("path", source, "-o", output)
    assert code == 3
    assert "outside the range of X: left as written" in said and output.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--tolerance", "0.0005", "--no-compensate"), "rounding"),
        (("--tolerance", "0"), "positive"),
        (("--feed", "100"), "a feed was given for a program"),
        (("--machine", "nowhere"), "nowhere"),
    ],
)
def test_refusals_leave_nothing(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    source, output = tmp_path / "c.nc", tmp_path / "o.nc"
    source.write_text(program_of(circle(40)))
    with pytest.raises(InputError, match=message):
        CliRunner().invoke(app, ["path", str(source), "-o", str(output), *arguments], catch_exceptions=False)
    assert not output.exists()


def test_other_refusals(dmu50: Machine, tmp_path: Path) -> None:
    source = tmp_path / "c.nc"
    source.write_text(program_of(circle(40)))
    with pytest.raises(InputError, match="cannot be converted from iso to heidenhain"):
        twin.refit(source, dmu50, output=tmp_path / "o.h")
    with pytest.raises(InputError, match="output file is also an input"):
        CliRunner().invoke(app, ["path", str(source), "-o", str(source)], catch_exceptions=False)
    source.write_text("G1 X1 Y2 Z-3 F10\nG1 X1..2\n")
    with pytest.raises(InputError, match=r"c\.nc:2"):
        twin.refit(source, dmu50)


def test_table_2_of_the_paper() -> None:
    """Díaz Pérez et al. (2019), table 2: 501 nm; and its claim that a fit within 0.05 µm adds less than 0.01 µm."""
    table_2 = [
        UncertaintyContribution("HRPWM", 0.700 / np.sqrt(12.0), "2.62e-5 V/√12"),
        UncertaintyContribution("laser system", 0.00158 / np.sqrt(12.0), "1.58 nm/√12"),
        UncertaintyContribution("calibrated laser system", 0.099, "geometrical errors, measuring system"),
        UncertaintyContribution("RMS positioning error", 0.110, "noise, vibrations"),
    ]
    assert combined(table_2) == pytest.approx(0.501, abs=5e-4)  # as printed
    added = combined([*table_2, UncertaintyContribution.within("trajectory", 0.05, "fit")]) - combined(table_2)
    assert 0.0 < added < 0.01


@pytest.mark.slow
def test_the_fit_enters_the_uncertainty(dmu50: Machine) -> None:
    """U² is the sum of (2u)²; a coarser path increases it by its own contribution only."""

    def of(tolerance: float) -> PathReport:
        return refitted(dmu50, program_of(circle()), tolerance).report

    fine, coarse = of(0.005), of(0.05)
    for report in (fine, coarse):
        path, machine = report.contributions
        assert path.standard_um == pytest.approx(report.runs[0].path_um / 3**0.5)
        assert report.expanded_um == pytest.approx(2.0 * np.hypot(path.standard_um, machine.standard_um))
    assert coarse.expanded_um > 5.0 * fine.expanded_um


def test_unknown_machine_uncertainty_is_unknown(dmu50: Machine, tmp_path: Path) -> None:
    """The illustrative calibration has no covariance: null, never a number without it."""
    source = tmp_path / "c.nc"
    source.write_text(program_of(circle(100, 5.0)))
    report = twin.refit(source, dmu50, options=Options(tool_length_mm=120.0, tolerance_mm=0.02)).report
    assert report.to_dict()["uncertainty"]["expanded_um"] is None
    assert "unknown" in report.to_text()


# -------------------------------------------------------------------- a program from real machining


def numbered(text: str) -> tuple[list[int], np.ndarray]:
    """Return block number and position after every block, from the words alone (end points of arcs)."""
    where = dict.fromkeys("XYZ", np.nan)
    numbers, found = [], []
    for row in text.splitlines():
        row = re.sub(r"\(.*?\)|;.*", "", row)
        head = re.match(r"\s*N(\d+)", row)
        where |= {n: float(v) for n, v in re.findall(r"([XYZ])(-?(?:\d+\.?\d*|\.\d+))", row)}
        numbers.append(int(head[1]) if head else -1)
        found.append([where[n] for n in "XYZ"])
    return numbers, np.array(found)


@pytest.mark.slow
def test_a_real_program(programs: Path) -> None:
    """The keychain: outlines of letters as runs of short blocks, with arcs between."""
    machine = Machine.load("xyzbc_trunnion")
    source = programs / "spinnerU5_Keychain_Schluesselanhaenger.mpf"
    options = Options(tolerance_mm=0.03, tool_length_mm=50.0)
    result = twin.refit(source, machine, options=options, compensated=False)
    original = source.read_bytes().decode("latin-1")
    before, places = numbered(original)
    after, new = numbered(result.text)
    assert result.report.blocks_out < 0.6 * result.report.blocks
    for run in result.report.runs:
        first, last = run.first_line - 1, run.last_line - 1
        inside = [i for i, number in enumerate(after) if before[first] <= number <= before[last]]
        assert len(inside) == run.blocks_out
        old, now = places[first - 1 : last + 1], new[inside[0] - 1 : inside[-1] + 1]
        assert hausdorff(old, now) <= 0.03 + READ
    runs = {n for run in result.report.runs for n in before[run.first_line - 1 : run.last_line]}
    others = [row for row, number in zip(original.splitlines(), before, strict=True) if number not in runs]
    assert others == [row for row, number in zip(result.text.splitlines(), after, strict=True) if number not in runs]


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize("cycle", ["G81", "G84"])
@pytest.mark.parametrize("compensated", [False, True])
def test_holes_between_runs(dmu50: Machine, cycle: str, compensated: bool, tmp_path: Path) -> None:
    """Cycles stay as they are unless their holes are compensated."""
    holes = f"G99 {cycle} X310. Y210. Z-230. R-215. F120.\nX320.\n/X330.\nX340.\nG80\n"
    source = tmp_path / "c.nc"
    source.write_text(program_of(circle()).replace("M30", f"G0 Z-190.\n{holes}G0 Z-190.\nM30"))
    result = twin.refit(
        source, dmu50, options=Options(tolerance_mm=0.02, tool_length_mm=120.0), compensated=compensated
    )
    assert result.report.complete
    assert result.report.blocks_out < 0.5 * result.report.blocks
    assert (holes in result.text) is not compensated


# -------------------------------------------------------------------- tool vectors, reversals, and a check that can fail


@pytest.mark.parametrize("compensated", [False, True])
def test_tool_vectors(dmu50: Machine, compensated: bool, tmp_path: Path) -> None:
    t = np.linspace(0.0, 1.0, 301)
    tilt = 0.2 + 0.1 * t
    rows = np.stack([30.0 * t, 10.0 * np.sin(3.0 * t), 60.0 + 0.0 * t, np.sin(tilt), 0.0 * t, np.cos(tilt)], axis=1)
    names = ("X", "Y", "Z", "A3=", "B3=", "C3=")
    body = "".join(" ".join(f"{n}{v:.7f}" for n, v in zip(names, row, strict=True)) + "\n" for row in rows)
    source = tmp_path / "v.mpf"
    source.write_text(f"G90 G21\nTRAORI\nG0 X0 Y0 Z60 B10 C0\nG1 F500\n{body}TRAFOOF\nM30\n")
    options = Options(tolerance_mm=0.02, tool_length_mm=120.0)
    result = twin.refit(source, dmu50, options=options, compensated=compensated)
    pattern = r"X(\S+) Y(\S+) Z(\S+) A3=(\S+) B3=(\S+) C3=(\S+)"
    found = np.array(re.findall(pattern, result.text), dtype=float)
    assert len(found) < 40
    assert result.report.complete
    assert np.linalg.norm(found[:, 3:], axis=1) == pytest.approx(1.0, abs=1e-6)  # seven decimals
    if not compensated:
        assert hausdorff(rows[:, :3], found[:, :3]) <= 0.02 + READ
        assert np.abs(found[:, 3] - np.interp(found[:, 0], rows[:, 0], rows[:, 3])).max() < 0.02 / 120.0 + 1e-6


def test_reversals_are_taken_up_and_the_path_kept(dmu50: Machine, tmp_path: Path) -> None:
    data = yaml.safe_load((URDF / "dmu50.calibration.yaml").read_text())
    data["effects"] = [{"effect": "reversal", "where": "X", "parameters": {"size": -6.0}}]
    (tmp_path / "c.yaml").write_text(yaml.safe_dump(data))
    source = tmp_path / "c.nc"
    source.write_text(program_of(circle()))
    options = Options(tolerance_mm=0.02, tool_length_mm=120.0)
    result = twin.refit(source, dmu50, Calibration.load(tmp_path / "c.yaml", dmu50), options=options)
    assert result.report.compensation is not None
    assert result.report.compensation.reversals[0].taken_up >= 1
    assert result.report.complete
    run = result.report.runs[0]
    assert run.machine_um <= result.report.shares.compensation + result.report.shares.rounding


@pytest.mark.slow
def test_a_path_out_of_tolerance_is_reported(dmu50: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """The final check is independent of the fit: blocks moved by 30 µm are reported as 30 µm off, whatever the fit reports."""
    from twin.compensation.fewer_blocks import runs

    original = runs.few_blocks

    def shifted(*arguments: Any) -> Any:
        found = original(*arguments)
        if found is None:
            return None
        words = np.array(found[0])
        words[:-1, 2] += 0.03
        return words, found[1], found[2]

    monkeypatch.setattr(runs, "few_blocks", shifted)
    report = refitted(dmu50, program_of(circle()), 0.01).report
    assert not report.complete
    assert report.not_met[0].line == 4
    assert report.runs[0].total_um == pytest.approx(np.hypot(30.0, 5.0), abs=6.0)
    assert "not met: 1" in report.to_text()
