"""Forecasts of a part's tolerances, against a machine in plain numpy that cuts it (`tests.truth.machine`), and its own fits."""

from __future__ import annotations

import copy
import json
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.optimize import linprog, minimize
from scipy.stats import ks_2samp

import twin
from tests.cli.commands import status
from tests.reporting.test_translation import left_in_english
from tests.truth.machine import LOADER, RANGES, TruthMachine
from twin.compensation.programs.prepared import Options
from twin.nc import read_program
from twin.numerics.covariance import Covariance
from twin.part.contact import contacts
from twin.part.features import PartDrawing, PlaneFeature, ToolShape
from twin.part.forecast import Conformity, ForecastTolerance, Judge, PartForecast, forecast
from twin.part.improvements import PlaceSearch
from twin.part.made import Draw, Maker, PartPlace
from twin.part.zones import FeaturePoints

LENGTH = 120.0
ZERO = np.array([250.0, 225.0, -280.0])
"""Axis positions at which the tip stands in the centre of the table's surface."""
HOLES = ((-60.0, -45.0), (60.0, -45.0), (60.0, 45.0), (-60.0, 45.0))
RADIUS, BORE, BALL, SPHERE = 5.0, 40.0, 4.0, 30.0
TOP, DEPTH = 40.0, 20.0


def face() -> list[np.ndarray]:
    """Tips along lines over the top, 120 × 90 mm."""
    lines = np.linspace(-45.0, 45.0, 10)
    return [
        np.array([x, y, TOP]) for k, y in enumerate(lines) for x in ((-60.0, 60.0) if k % 2 == 0 else (60.0, -60.0))
    ]


def hemisphere() -> list[np.ndarray]:
    """Tips of a ball-nose tool on circles of a hemisphere on the top."""
    found = []
    for angle in np.radians([15.0, 35.0, 55.0, 75.0]):
        for turn in np.radians(np.arange(0.0, 361.0, 2.0)):
            n = np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
            found.append((SPHERE / 2 + BALL) * n + [0.0, 0.0, TOP - BALL])
    return found


def blocks(tips: list[np.ndarray]) -> str:
    """G1 blocks to tips, entered by a rapid."""
    words = [" ".join(f"{axis}{value:.6f}" for axis, value in zip("XYZ", tip + ZERO, strict=True)) for tip in tips]
    return "".join([f"G0 {words[0]}\n", *(f"G1 {word} F900\n" for word in words)])


def program() -> str:
    holes = "".join(f"G0 X{x + 250:g} Y{y + 225:g} Z-200\nG1 Z{TOP - DEPTH - 280:g}\nG0 Z-200\n" for x, y in HOLES)
    bore = "".join(
        f"G1 Z{z - 280:g}\nG3 X{250 + BORE / 2 - RADIUS:g} Y225 I{-(BORE / 2 - RADIUS):g} J0\n"
        for z in (35.0, 30.0, 25.0, 20.0)
    )
    approach = f"G0 X{250 + BORE / 2 - RADIUS:g} Y225 Z-200\n"
    return f"G90 G21 G17 G94\nB0 C0\n{blocks(face())}{holes}{approach}{bore}G0 Z-100\n{blocks(hemisphere())}G0 Z-100\nM30\n"


PART = f"""schema: twin.part/1
part: test plate
units: mm
zero: table
tools:
  - {{number: 1, diameter: {2 * RADIUS:g}, cutting_length: 1}}
  - {{number: 2, diameter: 8}}
  - {{number: 3, diameter: {2 * BALL:g}, corner_radius: {BALL:g}}}
features:
  A: {{kind: plane, point: [0, 0, {TOP:g}], normal: [0, 0, 1], within: [[-60, -45, 30], [60, 45, 50]], tool: 1, lines: [3, 30]}}
HOLES
  Bore: {{kind: hole, point: [0, 0, {TOP:g}], depth: 20, diameter: {BORE:g}, tool: 1, lines: [31, 60]}}
  Ball: {{kind: sphere, centre: [0, 0, {TOP:g}], diameter: {SPHERE:g}, tool: 3, lines: [50, 900]}}
tolerances:
  - {{kind: flatness, of: A, zone: 0.02}}
  - {{kind: position, of: [H0, H1, H2, H3], zone: 0.1, datums: [A]}}
  - {{kind: perpendicularity, of: H0, zone: 0.1, datums: [A]}}
  - {{kind: roundness, of: Bore, zone: 0.02}}
  - {{kind: profile, of: Ball, zone: 0.1, datums: [A, H0, H2]}}
"""


def write(folder: Path) -> tuple[Path, Path]:
    """Write program and part."""
    features = "".join(
        f"  H{k}: {{kind: hole, point: [{x:g}, {y:g}, {TOP:g}], depth: {DEPTH:g}, diameter: 8, tool: 2}}\n"
        for k, (x, y) in enumerate(HOLES)
    )
    (folder / "part.yaml").write_text(PART.replace("HOLES\n", features))
    (folder / "part.nc").write_text(program())
    return folder / "part.nc", folder / "part.yaml"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[PartForecast, TruthMachine, Path]:
    folder = tmp_path_factory.mktemp("part")
    path, features = write(folder)
    machine = twin.Machine.load("dmu50")
    calibration = twin.Calibration.default(machine)
    found = forecast(PartDrawing(features), read_program(path), machine, calibration, Options(tool_length_mm=LENGTH))
    return found, TruthMachine(machine.path.parent / "dmu50.calibration.yaml", LENGTH), features


def tips(truth: TruthMachine, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the real tips and axes at programmed tips."""
    poses = [truth.pose(np.append(one + ZERO, [0.0, 0.0])) for one in at]
    return np.array([pose[:3, 3] for pose in poses]), np.array([pose[:3, 2] for pose in poses])


def between(points: list[np.ndarray], step: float = 2.0) -> np.ndarray:
    """Points along a polyline."""
    found = [points[0][None]]
    for a, b in pairwise(points):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        found.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(found)


def smallest(columns: np.ndarray, values: np.ndarray) -> float:
    """Return the smallest largest deviation, by a linear programme."""
    ones = np.ones((len(values), 1))
    found = linprog(
        np.append(np.zeros(columns.shape[1]), 1.0),
        np.vstack([np.hstack([-columns, -ones]), np.hstack([columns, -ones])]),
        np.concatenate([-values, values]),
        bounds=(None, None),
    )
    return float(found.fun)


def of(found: PartForecast, kind: str) -> Conformity:
    return next(one.before for one in found.tolerances if one.tolerance.kind == kind)


def face_of(truth: TruthMachine) -> np.ndarray:
    """Return the coefficients of the least-squares plane of the top, z over (1, x, y), raised to its highest point."""
    at = between(face())
    z = tips(truth, at)[0][:, 2] - TOP
    columns = np.column_stack([np.ones(len(at)), at[:, :2]])
    plane = np.linalg.lstsq(columns, z, rcond=None)[0]
    plane[0] += (z - columns @ plane).max()
    return plane


def holes_of(truth: TruthMachine) -> np.ndarray:
    """Return the real axis points (4, n, 3) of the holes."""
    depth = np.linspace(TOP, TOP - DEPTH, 9)
    return np.array([tips(truth, np.column_stack([np.full(9, x), np.full(9, y), depth]))[0] for x, y in HOLES])


def flatness_of(truth: TruthMachine, step: float = 2.0) -> float:
    at = between(face(), step)
    z = tips(truth, at)[0][:, 2]
    return 2e3 * smallest(np.column_stack([np.ones(len(at)), at[:, :2]]), z - TOP)


def test_flatness_is_that_of_the_cut_plane(made: tuple[PartForecast, TruthMachine, Path]) -> None:
    found, truth, _ = made
    assert of(found, "flatness").value_um == pytest.approx(flatness_of(truth), rel=0.03)


def position_of(truth: TruthMachine) -> float:
    """Return the position of the holes, µm: the pattern may move in the plane of A, whose normal its axes follow."""
    plane, axes = face_of(truth), holes_of(truth)
    nominal = np.array([[(x, y)] * 9 for x, y in HOLES], dtype=float)
    height = axes[:, :, 2] - TOP
    lateral = axes[:, :, :2] - nominal + height[:, :, None] * plane[1:]  # seen along the normal of A

    def largest(move: np.ndarray) -> float:
        turned = np.stack([-nominal[:, :, 1], nominal[:, :, 0]], axis=-1) * move[2] * 1e-3
        return float(np.linalg.norm(lateral - move[:2] * 1e-3 - turned, axis=2).max())

    start = np.append(lateral.reshape(-1, 2).mean(axis=0) * 1e3, 0.0)
    exact = {"xatol": 1e-7, "fatol": 1e-9, "maxiter": 6000}
    return 2e3 * min(minimize(largest, start + d, method="Nelder-Mead", options=exact).fun for d in np.eye(3))


def test_position_of_a_pattern_is_that_of_the_drilled_holes(made: tuple[PartForecast, TruthMachine, Path]) -> None:
    found, truth, _ = made
    assert of(found, "position").value_um == pytest.approx(position_of(truth), rel=0.03)


def test_perpendicularity_is_that_of_the_drilled_hole(made: tuple[PartForecast, TruthMachine, Path]) -> None:
    found, truth, _ = made
    plane, axes = face_of(truth), holes_of(truth)[0]
    lateral = axes[:, :2] - HOLES[0] + (axes[:, 2:] - TOP) * plane[1:]
    best = minimize(
        lambda c: np.linalg.norm(lateral - c * 1e-3, axis=1).max(), lateral.mean(axis=0) * 1e3, method="Nelder-Mead",
        options={"xatol": 1e-7, "fatol": 1e-10},
    ).fun  # fmt: skip
    assert of(found, "perpendicularity").value_um == pytest.approx(2e3 * best, rel=0.03, abs=0.05)


def test_roundness_is_that_of_the_bore(made: tuple[PartForecast, TruthMachine, Path]) -> None:
    """The wall is the envelope of the tool's edge: for each direction the farthest point of a dense circle of the tool."""
    found, truth, _ = made
    worst = 0.0
    for z in (35.0, 30.0, 25.0, 20.0):
        turn = np.radians(np.arange(0.0, 360.0, 5.0))
        way = np.column_stack([np.cos(turn), np.sin(turn)])
        at = np.column_stack([(BORE / 2 - RADIUS) * way, np.full(len(turn), z)])
        edge = tips(truth, at)[0][:, :2] + RADIUS * way
        radius = np.linalg.norm(edge, axis=1)
        worst = max(worst, 2e3 * smallest(np.column_stack([way, np.ones(len(way))]), radius))
    assert of(found, "roundness").value_um == pytest.approx(worst, rel=0.05, abs=0.05)


def test_profile_of_a_sphere_is_that_of_the_ball(made: tuple[PartForecast, TruthMachine, Path]) -> None:
    """From datums: A, the axis of one hole, and the direction to another; the tool's envelope by a dense half ball."""
    found, truth, _ = made
    at = between(hemisphere(), 0.3)
    programmed = np.linalg.norm(at - np.array([0.0, 0.0, TOP - BALL]), axis=1) - BALL - SPHERE / 2
    at = at[np.abs(programmed) < 0.02]  # not on the ways from one circle to the next
    point, axis = tips(truth, at)
    centre = point + BALL * axis
    off = np.linalg.norm(centre - [0.0, 0.0, TOP], axis=1) - BALL - SPHERE / 2
    n = (centre - [0.0, 0.0, TOP]) / np.linalg.norm(centre - [0.0, 0.0, TOP], axis=1)[:, None]
    plane, holes = face_of(truth), holes_of(truth)
    turn = np.array([plane[2], -plane[1], 0.0])
    shift = np.array([0.0, 0.0, plane[0]])

    def lateral(k: int) -> np.ndarray:
        nominal = np.column_stack([np.full(9, HOLES[k][0]), np.full(9, HOLES[k][1]), np.linspace(TOP, TOP - DEPTH, 9)])
        moved = shift + np.cross(turn, nominal - [0.0, 0.0, TOP])
        return (holes[k] - nominal - moved)[:, :2].mean(axis=0)

    first, second = lateral(0), lateral(2)
    way = np.array(HOLES[2]) - HOLES[0]
    across = np.array([-way[1], way[0]])
    about = float((second - first) @ across / (across @ across))
    p = np.array([*HOLES[0], 0.0])
    contact = centre - BALL * n
    rigid = shift + np.cross(turn, contact - [0.0, 0.0, TOP]) + [*first, 0.0] + np.cross([0.0, 0.0, about], contact - p)
    expected = 2e3 * np.abs(off - (rigid * n).sum(axis=1)).max()
    assert of(found, "profile").value_um == pytest.approx(expected, rel=0.05)


def test_the_compensated_program_makes_what_the_drawing_says(made: tuple[PartForecast, TruthMachine, Path]) -> None:
    found, _, _ = made
    after = [one.after.value_um for one in found.tolerances if one.after is not None]
    assert len(after) == len(found.tolerances)
    assert max(after[:4]) < 2.0
    assert after[4] < 8.0  # chords of 2°: the program itself is 2.7 µm inside, twice of which counts
    assert all(np.isnan(one.before.probability) for one in found.tolerances)  # a calibration without uncertainty
    assert "its uncertainty is not known" in found.to_text()
    assert json.loads(json.dumps(found.to_dict()))["tolerances"][0]["before"]["probability"] is None


def test_each_error_counts_as_the_machine_without_it(
    made: tuple[PartForecast, TruthMachine, Path], tmp_path: Path
) -> None:
    found, _, _ = made
    row = next(one for one in found.tolerances if one.tolerance.kind == "flatness")
    name, lost = row.by_error[0]
    without = TruthMachine(twin.Machine.load("dmu50").path.parent / "dmu50.calibration.yaml", LENGTH)
    for group in (without.curves, without.squareness, without.location):
        group.pop(name, None)
    assert row.before.value_um - lost == pytest.approx(flatness_of(without), rel=0.05, abs=0.05)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("point: [0, 0, 40], normal", "point: [0, 0, 44], normal", 10, "no block of the program makes the feature A"),
        ("datums: [A]}", "datums: [Q]}", 19, "no such feature"),
        ("of: H0, zone: 0.1, datums: [A]", "of: H0, zone: 0.1, datums: []", 20, "without a datum"),
        ("kind: roundness, of: Bore", "kind: roundness, of: A", 21, "roundness of a plane"),
        ("kind: perpendicularity, of: H0", "kind: parallelism, of: H0", 20, "not those of parallelism"),
        (
            "normal: [0, 0, 1], within",
            "normal: [0, 0, 1], made: elsewhere, within",
            18,
            "that this program does not make",
        ),
        ("units: mm", "units: inch", 3, "units"),
        ("corner_radius: 4", "corner_radius: 5", 8, "a corner radius larger than the tool's"),
        ("of: [H0, H1, H2, H3], zone", "of: H0, zone", 19, "do not fix the part"),
        ("kind: roundness, of: Bore", "kind: roundness, of: H1", 12, "by its own shape"),
    ],
)
def test_what_the_file_cannot_mean_is_refused_with_its_line(
    tmp_path: Path, old: str, new: str, line: int, said: str
) -> None:
    path, features = write(tmp_path)
    text = features.read_text()
    assert old in text
    features.write_text(text.replace(old, new, 1))
    machine = twin.Machine.load("dmu50")
    with pytest.raises(twin.InputError) as refused:
        forecast(
            PartDrawing(features),
            read_program(path),
            machine,
            twin.Calibration.default(machine),
            Options(tool_length_mm=LENGTH),
        )
    assert said in str(refused.value)
    assert f"{features}:{line}" in str(refused.value)


def test_yaml_of_the_part_is_plain() -> None:
    assert yaml.safe_load(PART.replace("HOLES\n", ""))["schema"] == "twin.part/1"


def test_a_flat_bottom_that_is_hardly_tilted_cuts_at_its_tip() -> None:
    """A compensated tool is not tilted back exactly: its contact stays at the tip, and not at an edge 5 mm away."""
    plane = PlaneFeature(kind="plane", point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))
    tip, axis = np.array([[3.0, 4.0, 0.0]]), np.array([[2e-4, 0.0, np.sqrt(1.0 - 4e-8)]])
    found = contacts(plane, ToolShape(number=1, diameter=10.0), tip, axis, 0.02)
    assert found.place_mm == pytest.approx(tip, abs=1e-9)
    found = contacts(plane, ToolShape(number=1, diameter=10.0), tip, axis * [100.0, 1.0, 1.0], 0.2)
    assert found.place_mm[0, 0] == pytest.approx(8.0, abs=0.01)  # 20 mrad: its lowest point


DRILLED_THEN_BORED = """G90 G21 G17 G94
B0 C0
T1 M6
G43 H1
G0 X250 Y225 Z-220
G1 Z-261 F200
G0 Z-220
T2 M6
G43 H2
G0 X252.5 Y225
G1 Z-245 F200
G3 I-2.5 J0
G1 Z-250
G3 I-2.5 J0
G1 Z-255
G3 I-2.5 J0
G0 Z-220
M30
"""
BORED = """schema: twin.part/1
units: mm
tools:
  - {{number: 1, diameter: 15, length: {0}}}
  - {{number: 2, diameter: 10, length: {1}, cutting_length: 1}}
features:
  A: {{kind: plane, point: [250, 225, -240], normal: [0, 0, 1], made: elsewhere}}
  B: {{kind: plane, point: [250, 175, -240], normal: [0, -1, 0], made: elsewhere}}
  C: {{kind: plane, point: [200, 225, -240], normal: [-1, 0, 0], made: elsewhere}}
  H: {{kind: hole, point: [250, 225, -240], depth: 20, diameter: 15}}
tolerances:
  - {{kind: position, of: H, zone: 0.2, datums: [A, B, C]}}
"""


@pytest.mark.parametrize(("drill", "mill"), [(150.0, 95.0), (120.0, 120.0)], ids=["two lengths", "one length"])
def test_a_bored_hole_is_the_second_tools_whatever_drilled_it(tmp_path: Path, drill: float, mill: float) -> None:
    """The part's zero is the program's, to which the control adds the length of each tool; tools of one length are two tools."""
    (tmp_path / "part.nc").write_text(DRILLED_THEN_BORED)
    (tmp_path / "part.yaml").write_text(BORED.format(drill, mill))
    machine = twin.Machine.load("dmu50")
    part, program = PartDrawing(tmp_path / "part.yaml"), read_program(tmp_path / "part.nc")
    found = forecast(part, program, machine, twin.Calibration.default(machine))
    assert not found.features["H"].drilled
    assert (found.features["H"].tool, found.features["H"].lines) == ("2", (11, 16))
    worst = np.linalg.norm(bored_centres_um(mill), axis=1).max()
    assert found.tolerances[0].before.value_um == pytest.approx(2.0 * worst, rel=0.02)


def bored_centres_um(mill: float) -> np.ndarray:
    """Return the centres (3, 2) of the bore at its three depths, from its nominal axis."""
    truth = TruthMachine(twin.Machine.load("dmu50").path.parent / "dmu50.calibration.yaml", mill)
    turn = np.radians(np.arange(0.0, 360.0, 5.0))
    way = np.column_stack([np.cos(turn), np.sin(turn)])
    found = []
    for z in (-245.0, -250.0, -255.0):
        at = np.column_stack([2.5 * way + [250.0, 225.0], np.full(len(turn), z + mill), np.zeros((len(turn), 2))])
        edge = np.array([truth.pose(q)[:2, 3] for q in at]) + 5.0 * way
        columns = np.column_stack([way, np.ones(len(way))])
        found.append(np.linalg.lstsq(columns, np.linalg.norm(edge, axis=1), rcond=None)[0][:2] * 1e3)
    return np.array(found)


def test_a_warm_part_shrinks_towards_its_zero(tmp_path: Path) -> None:
    """At 25 °C, 12 µm/(m·K): the bore 250, 225 mm from the zero lies 15 and 13.5 µm nearer to it at 20 °C."""
    (tmp_path / "part.nc").write_text(DRILLED_THEN_BORED)
    warm = "temperature: {degC: 25, u_K: 0, expansion_um_m_K: 12}\nfeatures:"
    (tmp_path / "part.yaml").write_text(BORED.format(150, 95).replace("features:", warm))
    machine = twin.Machine.load("dmu50")
    arguments = read_program(tmp_path / "part.nc"), machine, twin.Calibration.default(machine)
    row = forecast(PartDrawing(tmp_path / "part.yaml"), *arguments).tolerances[0]
    expected = 2.0 * np.linalg.norm(bored_centres_um(95.0) - [15.0, 13.5], axis=1).max()
    assert row.before.value_um == pytest.approx(expected, rel=0.02)
    assert row.after is not None and row.after.value_um == pytest.approx(2.0 * np.hypot(15.0, 13.5), rel=0.05)
    (tmp_path / "part.yaml").write_text(
        BORED.format(150, 95).replace("features:", "temperature: {degC: 25}\nfeatures:")
    )
    with pytest.raises(twin.InputError, match="without a coefficient of expansion"):
        PartDrawing(tmp_path / "part.yaml")


def test_a_zero_that_moves_with_the_tool_is_refused(tmp_path: Path) -> None:
    """Without G43 the words are positions of the axes: the tip of a longer tool stands elsewhere."""
    (tmp_path / "part.nc").write_text(re.sub("G43 H.\n", "", DRILLED_THEN_BORED))
    (tmp_path / "part.yaml").write_text(BORED.format(150, 95))
    machine = twin.Machine.load("dmu50")
    with pytest.raises(twin.InputError, match="the program's zero is not one place"):
        forecast(
            PartDrawing(tmp_path / "part.yaml"),
            read_program(tmp_path / "part.nc"),
            machine,
            twin.Calibration.default(machine),
        )


def on_the_ball() -> list[str]:
    """Points of the hemisphere in the middle of the program's chords, with their normals, as rows of a part's file."""
    found = []
    for angle in np.radians([15.0, 35.0, 55.0, 75.0]):
        for turn in np.radians(np.arange(5.0, 360.0, 10.0)):
            n = np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
            found.append(", ".join(f"{v:.6f}" for v in (*(SPHERE / 2 * n + [0.0, 0.0, TOP]), *n)))
    return found


def test_free_form_points_of_a_sphere_have_its_profile(
    made: tuple[PartForecast, TruthMachine, Path], tmp_path: Path
) -> None:
    """The sphere's profile was compared with the machine in numpy; at its points the free-form surface is the same."""
    found, _, _ = made
    path, features = write(tmp_path)
    points = f"{{kind: points, points: [{', '.join(f'[{row}]' for row in on_the_ball())}], tool: 3, lines: [50, 900]}}"
    text = re.sub(r"(?m)^  Ball: .*$", f"  Ball: {points}", features.read_text())
    features.write_text(text)
    machine = twin.Machine.load("dmu50")
    arguments = machine, twin.Calibration.default(machine), Options(tool_length_mm=LENGTH)
    free = forecast(PartDrawing(features), read_program(path), *arguments)
    assert of(free, "profile").value_um == pytest.approx(of(found, "profile").value_um, rel=0.05)
    assert free.features["Ball"].points == 4 * 36
    assert free.features["Ball"].program_um < 3.0  # its chords
    features.write_text(text.replace("kind: profile", "kind: roundness").replace(", datums: [A, H0, H2]", ""))
    with pytest.raises(twin.InputError, match="roundness of free-form points"):
        PartDrawing(features)


def test_the_profile_along_a_path_is_that_of_its_flank(tmp_path: Path) -> None:
    """A wall along X, 5 mm right of the tool's axis: the machine in numpy leaves material where its axis is displaced along +y."""
    (tmp_path / "part.nc").write_text("B0 C0\nG0 X200 Y225 Z-260\nG1 X300 F500\nG0 Z-200\nM30\n")
    (tmp_path / "part.yaml").write_text(
        re.sub("(?s)  H: .*", "", BORED.format(LENGTH, LENGTH))
        + "  Wall: {kind: points, side: right, lines: [3, 3], tool: 2}\n"
        + "tolerances:\n  - {kind: profile, of: Wall, zone: 0.2, datums: [A, B, C]}\n"
    )
    text = (tmp_path / "part.yaml").read_text()
    (tmp_path / "part.yaml").write_text(re.sub(r", length: \S+?(?=[,}])", "", text))
    machine = twin.Machine.load("dmu50")
    arguments = read_program(tmp_path / "part.nc"), machine, twin.Calibration.default(machine)
    part = PartDrawing(tmp_path / "part.yaml")
    row = forecast(part, *arguments, Options(tool_length_mm=LENGTH)).tolerances[0]
    truth = TruthMachine(machine.path.parent / "dmu50.calibration.yaml", LENGTH)
    off = [truth.pose(np.array([x, 225.0, -260.0, 0.0, 0.0]))[1, 3] for x in np.linspace(200.0, 300.0, 101)]
    assert row.before.value_um == pytest.approx(2e3 * np.abs(off).max(), rel=0.02)
    assert row.after is not None and row.after.value_um < 3.0
    assert part.features["Wall"].samples()[:, 1] == pytest.approx(220.0)


def test_a_better_place_is_better_when_it_is_cut_there(
    made: tuple[PartForecast, TruthMachine, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The machine in numpy cuts the same program at the place that the search returns, within its axis ranges."""
    _, truth, features = made
    machine = twin.Machine.load("dmu50")
    part, calibration = PartDrawing(features), twin.Calibration.default(machine)
    program = read_program(features.with_name("part.nc"))
    found = forecast(part, program, machine, calibration, Options(tool_length_mm=LENGTH), place=True).better_place
    assert found is not None and found.turn_deg == 0.0
    here = position_of(truth), flatness_of(truth)
    monkeypatch.setattr(sys.modules[__name__], "ZERO", ZERO + found.shift_mm)
    for tip in (*face(), *hemisphere()):
        assert all(RANGES[axis][0] <= q <= RANGES[axis][1] for axis, q in zip("XYZ", tip + ZERO, strict=True))
    gains = {one.title.split()[0]: one for one in found.gains}
    assert (gains["position"].here_um, gains["flatness"].here_um) == pytest.approx(here, rel=0.03)
    there = position_of(truth), flatness_of(truth)
    assert (gains["position"].there_um, gains["flatness"].there_um) == pytest.approx(there, rel=0.05, abs=0.1)
    assert there[0] < 0.7 * here[0]


def test_a_turned_part_is_cut_by_the_turned_axis(made: tuple[PartForecast, TruthMachine, Path]) -> None:
    """Part and C turned by 90°: the holes of the machine in numpy, seen in the turned part, lie where the search says."""
    _, truth, features = made
    machine = twin.Machine.load("dmu50")
    part, calibration = PartDrawing(features), twin.Calibration.default(machine)
    maker = Maker(part, machine, calibration, Options(tool_length_mm=LENGTH), (100, 5))
    run = maker.run(*read_program(features.with_name("part.nc")))
    search = PlaceSearch(
        maker, Judge(part).values_um, maker.made(run, compensated=False, zero_mm=np.zeros(3)), run, np.zeros(3)
    )
    (turning,) = search._turning(90.0)
    assert turning is not None and machine.names[turning[0]] == "C"
    (cut,) = search._cuts["H1"]
    many, place = search._at(cut, 90.0, turning, np.array([[5.0, -3.0, 10.0]]))
    poses = np.array([truth.pose(q)[:3, 3] for q in many.q])
    seen = (poses - [5.0, -3.0, 10.0]) @ place.turn
    expected = ((seen - many.found.place_mm) * many.found.normal).sum(axis=1) * 1e3
    none = Draw.none()
    assert maker.displaced(part.features["H1"], many, place, none).deviation_um[:, 0] == pytest.approx(
        expected, abs=0.02
    )
    assert np.abs(expected).max() > 5.0


def test_measuring_an_error_again_leaves_what_the_others_cause(
    made: tuple[PartForecast, TruthMachine, Path],
) -> None:
    """Two independent uncertain errors: without that of the larger one, the forecast is that of a calibration that knows it."""
    _, _, features = made
    machine = twin.Machine.load("dmu50")
    exact = twin.Calibration.default(machine)
    names, sizes = ("E_C0Y", "E_B0Z", "E_A0Z"), np.diag([300.0, 60.0, 40.0]) ** 2
    part, program = PartDrawing(features), read_program(features.with_name("part.nc"))
    part.tolerances = tuple(one for one in part.tolerances if one.kind == "position")

    def row(count: int) -> ForecastTolerance:
        known = replace(
            exact,
            joint=Covariance(names[:count] if count == 3 else names[1:], sizes if count == 3 else sizes[1:, 1:]),
        )
        return forecast(part, program, machine, known, Options(tool_length_mm=LENGTH)).tolerances[0]

    part.tolerances = (part.tolerances[0].model_copy(update={"zone": 0.01}),)
    found, left = row(3), row(2)
    assert found.remeasured is not None and found.remeasured.errors[0] == "E_C0Y"
    assert found.after is not None and left.after is not None
    assert found.remeasured.upper_um == pytest.approx(left.after.upper_um, rel=0.15, abs=0.2)
    assert found.remeasured.upper_um < 0.5 * found.after.upper_um


def test_the_page_is_for_three_readers_in_two_languages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One row a tolerance with its probability in words, what to do, which blocks; and what is not contained, on every printed page."""
    (tmp_path / "part.nc").write_text(DRILLED_THEN_BORED)
    (tmp_path / "part.yaml").write_text(BORED.format(150, 95))
    page, scene = tmp_path / "page.html", tmp_path / "scene.html"
    command = ("forecast", tmp_path / "part.nc", "--features", tmp_path / "part.yaml")
    assert status(*command, "-o", page, "--scene", scene) == 3
    text = page.read_text()
    for words in (
        "open: the value is within the zone, its uncertainty is not known",
        "give the calibration its uncertainty",
        "<td>H<td>2<td>11 – 16",
        "Not contained: deflection",
    ):
        assert words in text
    assert "@top-center" in text and "<circle" in text
    assert "feature not held" in scene.read_text()
    assert left_in_english(tmp_path, capsys, *command, to="-o") == set()


@pytest.mark.parametrize(
    ("probability", "words"),
    [
        (0.999, "held, practically certain (>99 %)"),
        (0.96, "held, very likely (96 %)"),
        (0.6, "open, rather held (60 %)"),
        (0.2, "open, rather not held (20 %)"),
        (0.03, "not held, very likely (3 %)"),
        (0.0, "not held, practically certain (<1 %)"),
    ],
)
def test_a_probability_is_said_in_words(probability: float, words: str) -> None:
    assert Conformity(5.0, 8.0, probability).words(10.0) == words


def moved(entries: dict, names: Sequence[str], values: np.ndarray) -> dict:
    """Return the entries of a calibration file with some of its errors changed."""
    found = copy.deepcopy(entries)
    for name, value in zip(names, values, strict=True):
        error, _, number = name.partition("[")
        if number:
            coefficients = found["curves"][error]["coefficients"]
            coefficients[int(number[:-1])] = float(coefficients[int(number[:-1])]) + float(value)
        else:
            group = found.setdefault("squareness" if error in ("E_C0Y", "E_A0Z", "E_B0Z") else "location", {})
            group[error] = group.get(error, 0.0) + float(value)
    return found


def quick_position_of(truth: TruthMachine) -> float:
    """Return `position_of` by a linear programme: circles as polygons of 64 sides, 0.1 % above at most."""
    plane, axes = face_of(truth), holes_of(truth)
    nominal = np.array([[(x, y)] * 9 for x, y in HOLES], dtype=float)
    lateral = (axes[:, :, :2] - nominal + (axes[:, :, 2] - TOP)[:, :, None] * plane[1:]).reshape(-1, 2) * 1e3
    turned = np.stack([-nominal[:, :, 1], nominal[:, :, 0]], axis=-1).reshape(-1, 2) / 100.0
    angle = np.arange(32) * (np.pi / 32.0)
    ways = np.column_stack([np.cos(angle), np.sin(angle)])
    columns = np.concatenate([np.column_stack([np.tile(way, (len(lateral), 1)), turned @ way]) for way in ways])
    return 2.0 * smallest(columns, np.concatenate([lateral @ way for way in ways]))


@pytest.mark.slow
def test_stated_and_observed_conformity_agree(tmp_path: Path) -> None:
    """Reliability over 300 calibrations: of each, a machine is drawn from its covariance, and cut in numpy.

    For zones of five sizes the calibration states a probability, and the machine holds them or does not. In five classes of stated
    probability, the observed share is the stated one: within 3 % on average over all, within 8 % in each (of 300 draws, a share has a
    standard deviation of up to 3 %).
    """
    machine = twin.Machine.load("dmu50")
    twin.judge(twin.thesis_plan.plan(machine), machine).calibration.save(tmp_path / "known.yaml")
    entries = yaml.load((tmp_path / "known.yaml").read_text(), Loader=LOADER)
    path, features = write(tmp_path)
    part = PartDrawing(features)
    known = twin.Calibration.load(tmp_path / "known.yaml", machine)
    first = Maker(part, machine, known, Options(tool_length_mm=LENGTH), (300, 5))
    made = first.made(first.run(*read_program(path)), compensated=False, zero_mm=np.zeros(3))
    uncertainty = twin.ToolUncertainty(twin.Kinematics(machine, known, tool_length_mm=LENGTH), errors="identified")
    rng = np.random.default_rng(300)
    stated, held = [], []
    for own, missed in zip(uncertainty.draw(rng, 300).T, uncertainty.draw(rng, 300).T, strict=True):
        (tmp_path / "stated.yaml").write_text(yaml.safe_dump(moved(entries, uncertainty.parameters, own)))
        (tmp_path / "real.yaml").write_text(yaml.safe_dump(moved(entries, uncertainty.parameters, own + missed)))
        truth = TruthMachine(tmp_path / "real.yaml", LENGTH)
        calibration = twin.Calibration.load(tmp_path / "stated.yaml", machine)
        maker = Maker(part, machine, calibration, Options(tool_length_mm=LENGTH), (300, 5))
        needed = {name: cuts for name, cuts in made.cuts.items() if name in ("A", "H0", "H1", "H2", "H3")}
        surface = {
            name: FeaturePoints.joined(
                [maker.displaced(part.features[name], cut, PartPlace.at(np.zeros(3)), maker.draw) for cut in cuts]
            )
            for name, cuts in needed.items()
        }
        axes = maker.axes(surface)
        for tolerance, actual in zip(
            part.tolerances[:2], (flatness_of(truth, 6.0), quick_position_of(truth)), strict=True
        ):
            values = np.max([*Judge(part).values_um(tolerance, surface, axes).values()], axis=0)[1:]
            for zone in (2.0, 4.0, 6.0, 9.0, 12.0) if tolerance.kind == "flatness" else (10.0, 20.0, 30.0, 40.0, 55.0):
                stated.append(float(np.mean(values <= zone)))
                held.append(float(actual <= zone))
    p, seen = np.array(stated), np.array(held)
    classes = np.clip((p * 5.0).astype(int), 0, 4)
    off = np.array([abs(p[classes == k].mean() - seen[classes == k].mean()) for k in range(5)])
    print(
        [
            (round(p[classes == k].mean(), 3), round(seen[classes == k].mean(), 3), int((classes == k).sum()))
            for k in range(5)
        ]
    )
    assert (off * np.bincount(classes, minlength=5)).sum() / len(p) < 0.03
    assert off.max() < 0.08


@pytest.mark.slow
def test_machines_of_the_covariance_hold_a_tolerance_as_often_as_is_stated(tmp_path: Path) -> None:
    """Machines drawn from a calibration's covariance cut the part in numpy: flatness and position are distributed as stated.

    Kolmogorov-Smirnov test of 200 machines against the 1000 of the forecast, and the share of machines within each of five zones within
    3 % and its own sampling error.
    """
    machine = twin.Machine.load("dmu50")
    expected = twin.judge(twin.thesis_plan.plan(machine), machine).calibration
    expected.save(tmp_path / "known.yaml")
    known = twin.Calibration.load(tmp_path / "known.yaml", machine)
    path, features = write(tmp_path)
    part = PartDrawing(features)
    maker = Maker(part, machine, known, Options(tool_length_mm=LENGTH), (1000, 5))
    run = maker.run(*read_program(path))
    made = maker.made(run, compensated=False, zero_mm=np.zeros(3))
    stated = {
        one.kind: np.max([*Judge(part).values_um(one, made.surface, made.axis).values()], axis=0)[1:]
        for one in part.tolerances[:2]
    }
    uncertainty = twin.ToolUncertainty(twin.Kinematics(machine, known, tool_length_mm=LENGTH))
    drawn = uncertainty.draw(np.random.default_rng(6), 200)
    cut = {"flatness": [], "position": []}
    for deviations in drawn.T:
        truth = TruthMachine(tmp_path / "known.yaml", LENGTH)
        for name, value in zip(uncertainty.parameters, deviations, strict=True):
            error, _, number = name.partition("[")
            if number:
                coefficients = truth.curves[error]["coefficients"]
                coefficients[int(number[:-1])] = float(coefficients[int(number[:-1])]) + value
            else:
                group = truth.squareness if error in ("E_C0Y", "E_A0Z", "E_B0Z") else truth.location
                group[error] = group.get(error, 0.0) + value
        cut["flatness"].append(flatness_of(truth, 6.0))
        cut["position"].append(position_of(truth))
    for kind, values in cut.items():
        assert ks_2samp(values, stated[kind]).pvalue > 0.01
        for share in (0.5, 0.68, 0.8, 0.9, 0.95):
            observed = np.mean(np.array(values) <= np.quantile(stated[kind], share))
            assert abs(observed - share) < 0.03 + 2.0 * np.sqrt(share * (1.0 - share) / 200.0)
