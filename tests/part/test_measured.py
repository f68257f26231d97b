"""Measured parts as measurements, against a machine in plain numpy that cuts the bundled parts (`tests.truth.parts`)."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import twin
from tests.truth import parts as truth
from tests.truth.machine import TruthMachine, run_iso
from twin.compensation.programs.prepared import Options
from twin.measurement.table import Measurements
from twin.nc import read_program
from twin.part.features import PartDrawing
from twin.part.measured import import_part
from twin.part.measured_table import read_measured

U = 0.0015
"""mm, of a measured coordinate."""
OPTIONS = Options(tool_length_mm=120.0)
every = pytest.mark.parametrize("name", list(truth.TOOL))
PROGRAM, PART = (str(truth.SAMPLES / f"circle_diamond_square{suffix}") for suffix in (".nc", ".part.yaml"))


@pytest.fixture(scope="module")
def machine() -> twin.Machine:
    return twin.Machine.load("dmu50")


def imported(path: Path, name: str, machine: twin.Machine) -> Measurements:
    part = PartDrawing(truth.SAMPLES / f"{name}.part.yaml")
    return import_part(path, part, read_program(truth.SAMPLES / f"{name}.nc"), machine, OPTIONS).measurements


def along(at: truth.Probed, *effects: truth.Hidden) -> np.ndarray:
    """Return (n,) deviations along the normals."""
    return (truth.displacement(at, effects) * at.normal).sum(axis=1)


@every
def test_each_point_is_where_the_tool_was(name: str, machine: twin.Machine, tmp_path: Path) -> None:
    """Axis positions, directions of approach, normals, and the tool's point; times but for rapids, whose speed is not the same."""
    at = truth.probed(name)
    path = truth.write(tmp_path / "cmm.csv", at, np.zeros(len(at.q)), 1e-7, np.random.default_rng(1), moved=False)
    data = imported(path, name, machine)
    rows = np.arange(len(data)) if at.centre else data.lines - 2
    assert len(data) > 0.95 * len(at.q)
    assert data.positions[:, :3] == pytest.approx(at.q[rows], abs=2e-3)  # the programs' words have three decimals
    assert (data.approach[:, :3] == at.approach[rows]).all()
    tool = at.lever[rows] + [0.0, 0.0, -120.0]
    assert data.place_mm == pytest.approx(tool, abs=2e-3)
    if not at.centre:
        assert data.along == pytest.approx(at.normal[rows], abs=1e-3)
        assert np.abs(data.time_s - at.time[rows]).max() < 5.0
        assert np.nan_to_num(data.by_tool)[:, 0] == pytest.approx(at.by_radius[rows], abs=1e-4)


def test_what_lies_between_the_ways_of_a_ball_is_higher(machine: twin.Machine, tmp_path: Path) -> None:
    """Points between the circles of the hemisphere: the envelope of a dense ball, evaluated by brute force, is a perfect part."""
    way = truth.path_of("hemisphere", 0.03)
    polar, turn = np.meshgrid(np.radians([22.4, 41.5, 63.7]), np.arange(0.3, 6.0, 0.7))
    n = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1).reshape(-1, 3)
    place = 40.0 * n + [0.0, 0.0, 20.0]
    left = []
    for p, normal in zip(place, n, strict=True):
        centre = way.tip[way.feeds] + [0.0, 0.0, 5.0] - p
        inside = (centre @ normal) ** 2 - (centre**2).sum(axis=1) + 25.0
        # Along the normal from the point to the ball's surface.
        left.append(np.min((centre @ normal)[inside > 0.0] - np.sqrt(inside[inside > 0.0])))
    assert max(left) > 0.003  # scallops of several micrometres
    with (tmp_path / "cmm.csv").open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow(["name", "x nom", "y nom", "z nom", "x ist", "y ist", "z ist", "unit: mm"])
        for p, normal, height in zip(place, n, left, strict=True):
            out.writerow(["Ball", *p, *(p + height * normal), ""])
    data = imported(tmp_path / "cmm.csv", "hemisphere", machine)
    on_tool = data.positions[:, :3] - truth.ZERO + data.place_mm + [0.0, 0.0, 120.0]
    residual = data.point_mm[:, 0] - (data.along * on_tool).sum(axis=1)
    assert np.abs(residual).max() < 1.0e-3


FORMS: dict[str, Callable[[str, np.ndarray, np.ndarray], list[list[object]]]] = {
    "points": lambda name, p, q: [[name, *p, *q]],
    "pc-dmis": lambda name, p, q: (
        [[name, axis, p[i], 0.05, -0.05, q[i], q[i] - p[i], 0.0] for i, axis in enumerate("XYZ")]
        + [[name, "D", 108.0, 0.05, -0.05, 108.01, 0.01, 0.0]]
    ),
    "calypso": lambda name, p, q: [[f"{axis}-Wert_{name}", q[i], p[i], 0.05, -0.05] for i, axis in enumerate("XYZ")],
}
HEADS = {
    "points": ["Element", *(f"{axis} Soll" for axis in "XYZ"), *(f"{axis} Ist" for axis in "XYZ")],
    "pc-dmis": ["Feature", "AX", "NOMINAL", "+TOL", "-TOL", "MEAS", "DEV", "OUTTOL"],
    "calypso": ["Name", "Istwert", "Nennwert", "Ob. Tol", "Unt. Tol"],
}


def exported(path: Path, form: str, at: truth.Probed, dev: np.ndarray) -> Path:
    rows: list[list[object]] = []
    for i, name in enumerate(at.feature):
        rows += FORMS[form](str(name), at.place[i].round(6), (at.place[i] + dev[i] * at.normal[i]).round(6))
    head = HEADS[form]
    if path.suffix == ".xlsx":
        import openpyxl

        book = openpyxl.Workbook()
        for row in [["Part 1", "units: mm"], [], head, *rows]:
            book.active.append([one if isinstance(one, str) else float(one) for one in row])  # type: ignore[arg-type]
        book.save(path)
        return path
    with path.open("w", newline="") as file:
        out = csv.writer(file, delimiter=";" if form == "calypso" else ",")
        out.writerow(head)
        comma = form == "calypso"
        out.writerows(
            [
                [f"{one:.6f}".replace(".", ",") if comma and not isinstance(one, str) else one for one in row]
                for row in rows
            ]
        )
    return path


@pytest.mark.parametrize("form", list(FORMS))
@pytest.mark.parametrize("suffix", [".csv", ".xlsx"])
def test_tables_of_measuring_programs_give_the_same_points(form: str, suffix: str, tmp_path: Path) -> None:
    at = truth.probed("circle_diamond_square")
    dev = 1e-3 * np.random.default_rng(2).normal(size=len(at.q))
    table = read_measured(exported(tmp_path / f"cmm{suffix}", form, at, dev))
    assert [point.feature for point in table.points] == at.feature.tolist()
    assert np.array([point.nominal_mm for point in table.points]) == pytest.approx(at.place, abs=1e-6)
    measured = at.place + dev[:, None] * at.normal
    assert np.array([point.measured_mm for point in table.points]) == pytest.approx(measured, abs=1e-6)
    assert len(table.notes) == (form == "pc-dmis")  # diameters are not used


def changed(rows: list[list[str]], row: int, column: int, value: str) -> list[list[str]]:
    rows[row][column] = value
    return rows


BAD = [
    ("a feature that the part does not have", lambda rows: changed(rows, 5, 0, "Q9"), 6, "no such feature"),
    ("a measured point of another frame", lambda rows: changed(rows, 5, 4, "-70.1"), 6, "from its nominal place"),
    ("a nominal point off the surface", lambda rows: changed(changed(rows, 5, 1, "-79"), 5, 4, "-79"), 6, "from the nominal surface"),
    ("no number", lambda rows: changed(rows, 7, 5, "lost"), 8, "not a number"),
    ("a missing coordinate", lambda rows: changed(rows, 7, 5, ""), 8, "a coordinate is missing"),
    ("inches", lambda rows: [rows[0], *([r[0], *(str(float(v) / 25.4) for v in r[1:7]), r[7]] for r in rows[1:])], 2, "in inches"),
    ("another unit in the header", lambda rows: [[one.replace("[mm]", "[inch]") for one in rows[0]], *rows[1:]], 2, "surface"),
    ("two columns for one thing", lambda rows: [[*rows[0], "meas x"], *([*r, "1"] for r in rows[1:])], 1, "two columns for measured x"),
    ("no column of features", lambda rows: [["Q", *rows[0][1:]], *rows[1:]], 1, "no column for the feature"),
    ("too few points", lambda rows: rows[:4], 4, "show nothing of the machine"),
    ("above where the program cut", lambda rows: changed(changed(rows, 5, 3, "55.1"), 5, 6, "55.1"), 6, "cuts S1 nowhere near"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "line", "said"), [one[1:] for one in BAD], ids=[one[0] for one in BAD])
def test_what_cannot_be_meant_is_refused_with_its_line(
    change: Callable[[list[list[str]]], list[list[str]]], line: int, said: str, machine: twin.Machine, tmp_path: Path
) -> None:
    at = truth.probed("circle_diamond_square")
    path = truth.write(tmp_path / "cmm.csv", at, np.zeros(len(at.q)), 1e-4, np.random.default_rng(1), moved=False)
    rows = change(list(csv.reader(path.read_text().splitlines())))
    path.write_text("".join(",".join(row) + "\n" for row in rows))
    arguments = [
        str(path),
        "-o",
        str(tmp_path / "out.csv"),
        "--program",
        PROGRAM,
        "--features",
        PART,
        "--tool-length",
        "120",
    ]
    from twin.cli.commands import app

    found = CliRunner().invoke(app, ["import", *arguments])
    with pytest.raises(twin.InputError) as refused:
        imported(path, "circle_diamond_square", machine)
    assert said in str(refused.value)
    assert f"{path}:{line}" in str(refused.value)
    assert found.exit_code == 2 or found.exception is not None
    assert not (tmp_path / "out.csv").exists()


def test_the_centre_of_a_milled_bore_is_refused(machine: twin.Machine, tmp_path: Path) -> None:
    """The points of its wall were cut at different positions of the axes: their mean is no place of the machine."""
    (tmp_path / "cmm.csv").write_text("feature,nom x,nom y,meas x,meas y\nBore,0,0,0.001,0.002\n")
    with pytest.raises(twin.InputError, match="a tool went around"):
        imported(tmp_path / "cmm.csv", "circle_diamond_square", machine)


def test_the_squareness_of_a_cut_part_is_that_of_the_machine(machine: twin.Machine, tmp_path: Path) -> None:
    """Three parts with noise: the mean of the normalised deviations, and their standard deviation."""
    at = truth.probed("plate_of_holes")
    dev = along(at, ("squareness", "E_C0Y", {"angle": 40.0}))
    z = []
    for seed in range(3):
        data = imported(
            truth.write(tmp_path / "cmm.csv", at, dev, U, np.random.default_rng(seed)), "plate_of_holes", machine
        )
        found = twin.identify(data, machine, wanted=lambda name: name == "E_C0Y").calibration
        z.append((found.squareness["E_C0Y"] - 40.0) / np.sqrt(found.covariance.matrix[0, 0]))
    assert abs(np.mean(z)) < 3.0 / np.sqrt(3.0)
    assert np.std(z) < 2.0


def test_a_worn_tool_is_not_an_error_of_the_machine(machine: twin.Machine, tmp_path: Path) -> None:
    """A tool 30 µm too small everywhere, and a part turned by 1 mrad, leave nothing; the estimate says so."""
    at = truth.probed("circle_diamond_square")
    dev = -0.03 * at.by_radius
    turned = (np.cross([0.0, 0.0, 1e-3], at.place) * at.normal).sum(axis=1)
    path = truth.write(tmp_path / "cmm.csv", at, dev + turned, U, np.random.default_rng(3), moved=False)
    data = imported(path, "circle_diamond_square", machine)
    assert twin.diagnose(data, machine, twin.Calibration.zero(machine)).verdict == "consistent"
    found = twin.identify(data, machine, wanted=lambda name: name == "E_C0Y").to_dict()["tools"]["T1"]["radius"]
    assert abs(found["value_um"] + 30.0) < 4.0 * found["u_um"] < 4.0


def test_a_tool_that_gives_way_is_not_an_error_of_the_machine(machine: twin.Machine, tmp_path: Path) -> None:
    """Deflected by 8 µm a millimetre of engagement, 0.2 to 1.5 mm from wall to wall: nothing is left if the table gives that."""
    at = truth.probed("circle_diamond_square")
    engaged = {name: 0.2 + 0.13 * k for k, name in enumerate(dict.fromkeys(at.feature.tolist()))}
    width = np.array([engaged[name] for name in at.feature])
    path = truth.write(tmp_path / "cmm.csv", at, 0.008 * width, U, np.random.default_rng(3))
    head, *rows = path.read_text().splitlines()
    lines = [f"{head},engagement_mm", *(f"{row},{one:.3f}" for row, one in zip(rows, width, strict=True))]
    path.write_text("\n".join(lines) + "\n")
    given = imported(path, "circle_diamond_square", machine)
    assert twin.diagnose(given, machine, twin.Calibration.zero(machine)).verdict == "consistent"


def test_commands_from_a_plan_of_parts_to_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The points that are planned can be measured, and the table of them imported; options that belong together are asked for."""
    from twin.cli.commands import app

    monkeypatch.chdir(tmp_path)
    run = CliRunner()
    planned = run.invoke(app, ["plan", "--part", "plate_of_holes.nc", "--tool-length", "120", "-o", "points.csv"])
    assert planned.exit_code == 0, planned.output
    head, *rows = csv.reader((tmp_path / "points.csv").read_text().splitlines())
    rng = np.random.default_rng(4)
    measured = [[*row[:7], *(f"{float(v) + U * rng.normal():.5f}" for v in row[1:4])] for row in rows]
    (tmp_path / "cmm.csv").write_text("".join(",".join(row) + "\n" for row in [head, *measured]))
    options = ["--program", "plate_of_holes.nc", "--features", "plate_of_holes.part.yaml", "--tool-length", "120"]
    found = run.invoke(app, ["import", "cmm.csv", "-o", "part.csv", *options, "--json", "i.json"])
    assert found.exit_code == 0, found.output
    assert len(Measurements.load("part.csv", twin.Machine.load("dmu50"))) == 84
    wrong = run.invoke(app, ["import", "cmm.csv", "-o", "x.csv", "--program", "plate_of_holes.nc"])
    assert isinstance(wrong.exception, twin.InputError) and "belong together" in str(wrong.exception)


def test_a_cone_cut_with_five_axes_is_that_of_the_machine(machine: twin.Machine, tmp_path: Path) -> None:
    """The bundled cone frustum on the illustrative machine, by its pose in numpy: the positions, and nothing left with its calibration.

    Points at the ends of blocks: a flank of radius 10 touches the cone at P = tip + 12 mm · axis − 10 mm · n, with n the normal of the
    cone on the side of the tip. The program itself is off by up to 30 µm, as on the part.
    """
    cone = yaml.safe_load((truth.SAMPLES / "cone_frustum.part.yaml").read_text())["features"]["Cone"]
    base, u, half = np.array(cone["point"]), np.array(cone["direction"]), np.radians(15.0)
    real = TruthMachine(Path(machine.path).parent / "dmu50.calibration.yaml", 120.0)
    blocks = run_iso((truth.SAMPLES / "cone_frustum.nc").read_text())
    rows, positions = [], []
    for code, q in blocks[10:-10:4]:
        nominal = real.pose(q, real=False)
        tip, axis = nominal[:3, 3], nominal[:3, 2]
        away = tip - base - (tip - base) @ u * u
        n = np.cos(half) * away / np.linalg.norm(away) + np.sin(half) * u
        if code != "G1" or abs(n @ axis) > 1e-3:
            continue
        at = tip + 12.0 * axis - 10.0 * n
        beside = at - base - (at - base) @ u * u
        off = (np.linalg.norm(beside) - (81.032 / 2.0 - (at - base) @ u * np.tan(half))) * np.cos(half)
        moved = (real.pose(q) @ np.linalg.solve(nominal, np.append(at, 1.0)))[:3]
        rows.append(["Cone", *(at - off * n), *(at - off * n + (off + (moved - at) @ n) * n)])
        positions.append(q)
    assert len(rows) > 60
    rng = np.random.default_rng(5)
    noisy = [[row[0], *row[1:4], *(np.array(row[4:]) + U * rng.normal(size=3)), U] for row in rows]
    (tmp_path / "cmm.csv").write_text(
        "name,nom x,nom y,nom z,ist x,ist y,ist z,u [mm]\n" + "".join(",".join(map(str, row)) + "\n" for row in noisy)
    )
    data = imported(tmp_path / "cmm.csv", "cone_frustum", machine)
    assert len(data) > 0.9 * len(rows)
    found = data.positions - np.array(positions)[data.lines - 2]
    assert np.abs(found).max() < 0.3  # mm and degrees: the point of a twisted line contact is not sharp along the way
    off_mm = [np.linalg.norm(np.array(row[4:]) - row[1:4]) for row in rows]
    assert max(off_mm) > 0.02
    assert twin.diagnose(data, machine, twin.Calibration.default(machine)).verdict == "consistent"


CAUSES: tuple[truth.Hidden, ...] = (
    ("reversal", "X", {"size": 1.0}),
    ("reversal", "Y", {"size": 1.0}),
    ("squareness", "E_C0Y", {"angle": 1.0}),
    ("pitch_error", "X", {"amplitude": 1.0, "period": 13.0, "phase": 0.5}),
    ("pitch_error", "Y", {"amplitude": 1.0, "period": 8.0, "phase": 1.5}),
    ("positioning", "E_XX", {"c1": 1.0}),
    ("positioning", "E_YY", {"c2": 1.0}),
    ("thermal_drift", "X", {"amplitude": 1.0, "time_constant": 100.0}),
    ("straightness", "E_YX", {"c2": 1.0}),
)
LAMBDA = 60.0
DRAWS = 8


def of_strength(at: truth.Probed, cause: truth.Hidden, strength: float) -> np.ndarray | None:
    """Return the deviations of a cause of strength λ; None if it would have to be larger than any machine's."""
    effect, where, numbers = cause
    first = next(iter(numbers))
    unit = truth.strength(at, along(at, cause), U)
    size = np.sqrt(strength / unit) if unit > 1e-9 else np.inf
    return along(at, (effect, where, {**numbers, first: size})) if size < 200.0 else None


@pytest.mark.sample(2)
@every
@pytest.mark.parametrize("cause", CAUSES, ids=[f"{one[0]} {one[1]}" for one in CAUSES])
def test_a_cause_is_named_or_stands_in_its_group(
    name: str, cause: truth.Hidden, machine: twin.Machine, tmp_path: Path
) -> None:
    """At λ = 60, in at least 95 % over all (one of eight draws may miss); unless the part hardly shows it."""
    at = truth.probed(name)
    dev = of_strength(at, cause, LAMBDA)
    few = name == "plate_of_holes" and cause[0] == "pitch_error"  # at seven positions it is any curve
    if dev is None or few:
        pytest.skip("this part does not show it")
    draws = DRAWS if cause[0] in ("positioning", "straightness") else 4
    hits = 0
    for seed in range(draws):
        data = imported(
            truth.write(tmp_path / "cmm.csv", at, dev, U, np.random.default_rng(1000 + seed)), name, machine
        )
        said = twin.diagnose(data, machine, twin.Calibration.zero(machine)).to_dict()
        named = [
            [(c["effect"], c["where"]), *((e.get("effect"), e.get("where")) for e in c["equivalent"])]
            for c in said["causes"]
        ]
        hits += any(cause[:2] in group for group in named)
    assert hits >= draws - 1


@pytest.mark.slow
@every
def test_a_perfect_machine_has_no_cause(name: str, machine: twin.Machine, tmp_path: Path) -> None:
    """Sixty parts with noise alone: at most 5 % alarms, and what that allows by chance."""
    at, alarms = truth.probed(name), 0
    for seed in range(60):
        path = truth.write(tmp_path / "cmm.csv", at, np.zeros(len(at.q)), U, np.random.default_rng(100 + seed))
        alarms += (
            twin.diagnose(imported(path, name, machine), machine, twin.Calibration.zero(machine)).verdict
            != "consistent"
        )
    assert alarms <= 6


@pytest.mark.slow
@every
def test_a_pattern_of_no_axis_stays_unexplained(name: str, machine: twin.Machine, tmp_path: Path) -> None:
    """Plane waves across the part, oblique to the axes, λ = 300."""
    at, unexplained = truth.probed(name), 0
    for seed in range(12):
        rng = np.random.default_rng(5000 + seed)
        way = rng.normal(size=(3, 2))
        way /= np.linalg.norm(way, axis=1)[:, None]
        phase, length = rng.uniform(0.0, 6.28, 3), rng.uniform(25.0, 60.0, 3)
        dev = np.sin(2.0 * np.pi * (at.place[:, :2] @ way.T) / length + phase).sum(axis=1)
        dev *= np.sqrt(300.0 / truth.strength(at, dev, U))
        data = imported(truth.write(tmp_path / "cmm.csv", at, dev, U, np.random.default_rng(seed)), name, machine)
        unexplained += twin.diagnose(data, machine, twin.Calibration.zero(machine)).verdict == "unexplained"
    assert unexplained >= 11


def test_the_bundled_parts_are_those_of_their_script() -> None:
    from twin.samples.parts import contents

    for name, text in contents().items():
        assert (truth.SAMPLES / name).read_text() == text
        assert not name.endswith(".yaml") or yaml.safe_load(text)["schema"] == "twin.part/1"


def test_what_a_part_shows_is_what_its_points_depend_on(machine: twin.Machine) -> None:
    """The plate of holes shows the squareness of X and Y, and no error of Z or of the rotary axes."""
    from twin.planning.parts import compare_parts

    path = truth.SAMPLES / "plate_of_holes.nc"
    (only,) = compare_parts(
        [(path, path.with_suffix(".part.yaml"))], machine, twin.Calibration.default(machine), OPTIONS
    ).parts
    names = {one.name for one in only.errors}
    assert "E_C0Y" in names and not any(name[3] in "BC" for name in names if name[2] != "C")
    assert 0.0 < only.after_um < only.before_um
    assert only.readings == 84
