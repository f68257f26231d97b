"""`twin evaluate`: a real stage with another program's report, and tables with known errors computed without `twin`."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.conftest import beside
from tests.real import stage
from tests.standards import motions
from twin import cli
from twin.machine.machine import Machine
from twin.measurement.instruments.points import AT960
from twin.measurement.table import Measurements
from twin.standards import EvaluationResult
from twin.standards.linear_axes import _approaches


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["evaluate", *map(str, arguments)])
    return int(stopped.value.code or 0), capsys.readouterr().out


def values(found: EvaluationResult, name: str, kind: str = "") -> dict[str, float]:
    (test,) = found.named(name, kind)
    return {one.key: one.value for one in test.values}


# --- ISO 230-2 --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("columns", ["approach", "order", "order without time"])
def test_stage_agrees_with_the_report_of_another_program(tmp_path: Path, axis: str, columns: str) -> None:
    """The report's E and R are not those of ISO 230-2 (see `tests.standards.test_evaluation_iso230_2`); all other values agree.

    It calls forward the approaches from above; `tests.real.stage` says how that is known. Its numbers are rounded to 0.01 µm, its
    readings too, so that A with four s may differ by a few of these.
    """
    folder = beside("data", "real", "stage-iso230-2")
    machine = Machine.load(stage.write_machine(tmp_path))
    table = stage.write_table(folder, axis, tmp_path / "run.csv")
    lines = [line.split(",") for line in table.read_text().splitlines()]
    if columns != "approach":
        gone = [lines[0].index("approach_X")] + ([lines[0].index("time_s")] if columns != "order" else [])
        table.write_text("\n".join(",".join(c for i, c in enumerate(line) if i not in gone) for line in lines) + "\n")
    found = twin.evaluate(Measurements.load(table, machine), machine)
    ours = values(found, "X", "positioning")
    report = dict(
        re.findall(r"^\**(\w+) = [^\n]*\n\n\**\1 = (\S+) \[mm\]", (folder / stage.REPORTS[axis]).read_text(), re.M)
    )
    theirs = {key: float(text) * 1e3 for key, text in report.items()}
    same = {"A": "A", "M": "M", "B": "B", "B_mean": "B_avg"}
    for symbol in "AER":
        same |= {f"{symbol}_forward": f"{symbol}_bwd", f"{symbol}_backward": f"{symbol}_fwd"}
    assert {key: abs(ours[key]) for key in same} == pytest.approx({key: theirs[n] for key, n in same.items()}, abs=0.03)
    assert ours["B_mean"] < 0.0, "arriving from below, the slide is lower"
    # The report takes R as the larger unidirectional one; the standard as the largest of its own column R(i).
    assert theirs["R"] == max(theirs["R_fwd"], theirs["R_bwd"]) < ours["R"]
    assert ours["E"] >= max(ours["E_forward"], ours["E_backward"]) and ours["E"] > theirs["E"] + 1.0
    derived = any("approach of X" in text for text in found.assumptions)
    assert derived == (columns != "approach")
    assert not any("4.3" in text for text in found.tests[0].remarks)


@pytest.fixture(scope="module")
def lines(dmu50: Machine, tmp_path_factory: pytest.TempPathFactory) -> tuple[EvaluationResult, dict[str, np.ndarray]]:
    """Runs of X, Y and Z with known straightness, squareness, reversal and noise, seen from a tracker at an unknown place."""
    rng = np.random.default_rng(8)
    x = np.linspace(0.0, 500.0, 11)

    def of_x(q: np.ndarray, side: np.ndarray, number: np.ndarray) -> np.ndarray:
        noise = rng.normal(0.0, 1e-3, (len(q), 3)) * [1.0, 0.0, 0.0]
        e = np.zeros((len(q), 3))
        e[:, 0] = 5e-3 * np.sin(q / 80.0) + 2e-3 * side
        e[:, 1] = 4e-3 * (q / 250.0 - 1.0) ** 2  # a bow
        e[:, 2] = 3e-3 * np.cos(2.0 * np.pi * q / 500.0)
        return e + noise

    def of_y(q: np.ndarray, side: np.ndarray, number: np.ndarray) -> np.ndarray:
        return np.column_stack([-60e-6 * q, 0.0 * q, 0.0 * q])  # E_C0Y = 60 µrad: E_XY −= y E_C0Y

    def of_z(q: np.ndarray, side: np.ndarray, number: np.ndarray) -> np.ndarray:
        return np.column_stack(
            [25e-6 * q, 35e-6 * q, 0.0 * q]
        )  # E_B0Z = 25: E_XZ += z E_B0Z; E_A0Z = −35: E_YZ −= z E_A0Z

    parts = [
        motions.straight_run(0, x, 5, of_x),
        motions.straight_run(1, np.linspace(0.0, 450.0, 7), 2, of_y),
        motions.straight_run(2, np.linspace(-400.0, 0.0, 7), 1, of_z),
    ]
    q, points, side = (np.concatenate([part[k] for part in parts]) for k in range(3))
    folder = tmp_path_factory.mktemp("lines")
    sign = [int(value) for value in side]
    known = {f"u_{name}_mm": ["0.001"] * len(q) for name in "xyz"}
    which = np.repeat([0, 1, 2], [len(part[0]) for part in parts])
    columns = {
        f"approach_{name}": [s if k == i else 0 for s, k in zip(sign, which, strict=True)]
        for i, name in enumerate("XYZ")
    }
    table = motions.write(folder / "lines.csv", q, motions.seen(points), **columns, **known)
    data = Measurements.load(table, dmu50)
    first = parts[0]
    return twin.evaluate(data, dmu50), {"q": first[0][:, 0], "read": first[1][:, 0] + 250.0, "side": first[2]}


def test_positioning_by_a_second_formulation(lines: tuple[EvaluationResult, dict[str, np.ndarray]]) -> None:
    """The formulae of ISO 230-2 written out by target, with Python's own statistics."""
    from statistics import fmean, stdev

    found, truth = lines
    ours = values(found, "X", "positioning")
    deviation = (truth["read"] - truth["q"]) * 1e3
    mean: dict[tuple[float, float], float] = {}
    s: dict[tuple[float, float], float] = {}
    for target in np.unique(truth["q"]):
        for side in (1.0, -1.0):
            runs = [
                float(d)
                for d, q, way in zip(deviation, truth["q"], truth["side"], strict=True)
                if (q, way) == (target, side)
            ]
            mean[target, side], s[target, side] = fmean(runs), stdev(runs)
    targets = np.unique(truth["q"])
    reversal = {t: mean[t, 1.0] - mean[t, -1.0] for t in targets}
    edges = {side: [mean[t, side] + k * s[t, side] for t in targets for k in (2, -2)] for side in (1.0, -1.0)}
    middles = [(mean[t, 1.0] + mean[t, -1.0]) / 2.0 for t in targets]
    expected = {
        "A": max(edges[1.0] + edges[-1.0]) - min(edges[1.0] + edges[-1.0]),
        "A_forward": max(edges[1.0]) - min(edges[1.0]),
        "A_backward": max(edges[-1.0]) - min(edges[-1.0]),
        "E": max(mean.values()) - min(mean.values()),
        "E_forward": max(mean[t, 1.0] for t in targets) - min(mean[t, 1.0] for t in targets),
        "E_backward": max(mean[t, -1.0] for t in targets) - min(mean[t, -1.0] for t in targets),
        "M": max(middles) - min(middles),
        "R": max(max(2 * s[t, 1.0] + 2 * s[t, -1.0] + abs(reversal[t]), 4 * s[t, 1.0], 4 * s[t, -1.0]) for t in targets),
        "R_forward": max(4 * s[t, 1.0] for t in targets),
        "R_backward": max(4 * s[t, -1.0] for t in targets),
        "B": max(map(abs, reversal.values())),
        "B_mean": fmean(reversal.values()),
    }  # fmt: skip
    # The line through the points is tilted by up to 3e-5 against the axis: 500 mm · (3e-5)² / 2.
    assert ours == pytest.approx(expected, abs=1e-3)
    assert ours["B_mean"] == pytest.approx(4.0, abs=3.0 * np.sqrt(2.0 / 55.0))


def test_assumptions_are_those_of_evaluated_runs(dmu50: Machine, tmp_path: Path) -> None:
    """Without a column for the direction of approach: X is evaluated; the target does not follow Y, which is therefore not."""

    def follows(q: np.ndarray, side: np.ndarray, number: np.ndarray) -> np.ndarray:
        return np.zeros((len(q), 3))

    def stands(q: np.ndarray, side: np.ndarray, number: np.ndarray) -> np.ndarray:
        return np.column_stack([0.0 * q, -q, 0.0 * q])

    targets = np.linspace(0.0, 400.0, 5)
    for y, axes in ((follows, "X, Y"), (stands, "X")):
        parts = [motions.straight_run(0, targets, 2, follows), motions.straight_run(1, targets, 2, y)]
        q, points = (np.concatenate([part[k] for part in parts]) for k in range(2))
        data = Measurements.load(motions.write(tmp_path / "two.csv", q, motions.seen(points)), dmu50)
        found = twin.evaluate(data, dmu50)
        columns = ", ".join(f"approach_{name}" for name in axes.split(", "))
        assert found.assumptions == (
            f"direction of approach of {axes} from the order of the rows of each round: the table has no column {columns}",
        )
        assert any(one.test.startswith("Y: positioning") for one in found.not_evaluated) == (y is stands)


def test_one_cycle_gives_no_repeatability(lines: tuple[EvaluationResult, dict[str, np.ndarray]]) -> None:
    """X runs five times, Y twice, to and fro, and Z once."""
    for name, cycles in zip("XYZ", (2, 1, 1), strict=True):
        (test,) = lines[0].named(name, "positioning")
        assert any("a single cycle" in text for text in test.remarks) == (cycles == 1)
        assert all(np.isfinite(one.value) == (cycles > 1) for one in test.values if one.key in ("R", "A")), test.values


def test_cycles_of_targets_by_hand() -> None:
    """As many cycles as every target has in both directions; a target that lacks a direction is left out, and so is a short side."""
    q = np.array([0.0, 0.0, 0.0, 0.0, 10.0, 10.0, 10.0, 10.0, 10.0, 20.0])
    side = np.array([1.0, 1.0, -1.0, -1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0])
    notes: list[str] = []
    targets, up, down = _approaches(q, np.arange(10.0), side, notes)
    assert targets.tolist() == [0.0, 10.0] and up.tolist() == [[0.0, 1.0], [4.0, 5.0]]
    assert down.tolist() == [[2.0, 3.0], [7.0, 8.0]]
    assert notes == [
        "targets without all directions of approach are left out: 20",
        "2 approaches of each target are used; some targets have more",
    ]
    notes = []
    targets, up, down = _approaches(q[:7], np.arange(7.0), side[:7], notes)
    assert targets.tolist() == [0.0, 10.0] and up.tolist() == [[0.0, 1.0], [4.0, 5.0]] and down.shape == (2, 0)
    assert [text.split(":")[0] for text in notes] == [
        "approaches from the other direction are left out",
        "2 approaches of each target are used; some targets have more",
    ]


def test_straightness_and_squareness(lines: tuple[EvaluationResult, dict[str, np.ndarray]]) -> None:
    found, _ = lines
    # The bow 4 µm (u² on −1 … 1): its end-point line and its minimum zone are horizontal, 4 µm wide.
    bow = values(found, "E_YX")
    assert bow["E_YX_EP"] == pytest.approx(4.0, abs=0.01) and bow["E_YX_MZ"] == pytest.approx(4.0, abs=0.01)
    u = np.linspace(-1.0, 1.0, 11)
    line = 4.0 * u**2 - np.polyval(np.polyfit(u, 4.0 * u**2, 1), u)
    assert bow["E_YX"] == pytest.approx(np.ptp(line), abs=0.01)
    assert values(found, "E_ZX")["E_ZX_MZ"] == pytest.approx(6.0, abs=0.01)
    expected = {"E_C0Y": 60.0, "E_B0Z": 25.0, "E_A0Z": -35.0}
    for name, value in expected.items():
        assert values(found, name)[name] == pytest.approx(value, abs=0.05)
    assert values(found, "E_XY")["E_XY"] == pytest.approx(0.0, abs=0.01), "a slope is not a straightness error"


def test_uncertainty_of_means(lines: tuple[EvaluationResult, dict[str, np.ndarray]]) -> None:
    """u = 1 µm a reading, five cycles: B is the difference of two means, so 1 µm · √(2/5); U is 1.96 times that."""
    found, _ = lines
    (test,) = found.named("X", "positioning")
    by_key = {one.key: one for one in test.values}
    assert by_key["B"].u == pytest.approx(np.sqrt(2.0 / 5.0)) and by_key["R_forward"].u == pytest.approx(
        4.0 / np.sqrt(8.0)
    )
    # s of five readings: 1/√8; two edges, two means, or 2 s↑ + 2 s↓ + |B|; B̄ is a mean over eleven targets.
    edge_u, mean_u = np.sqrt(2.0 * (1.0 / 5.0 + 4.0 / 8.0)), np.sqrt(2.0 / 5.0)
    expected = dict.fromkeys(("A", "A_forward", "A_backward"), edge_u)
    expected |= dict.fromkeys(("E", "E_forward", "E_backward", "B"), mean_u) | {"B_mean": mean_u / np.sqrt(11.0)}
    expected |= {"M": 1.0 / np.sqrt(5.0), "R": np.sqrt(8.0 / 8.0 + 2.0 / 5.0), "R_backward": 4.0 / np.sqrt(8.0)}
    assert {key: by_key[key].u for key in expected} == pytest.approx(expected)
    (bow,) = found.named("E_YX")
    assert [one.u for one in bow.values] == pytest.approx([np.sqrt(2.0 / 10.0)] * 3), "ten readings at each position"
    assert "does not contain the scale error" in found.uncertainty
    # By simulation: the same readings with new noise of 1 µm. B is a maximum over targets: its spread is smaller, not larger.
    draws = np.random.default_rng(2).normal(0.0, 1.0, (4000, 2, 11, 5)).mean(axis=3)
    assert (draws[:, 0] - draws[:, 1]).std() == pytest.approx(by_key["B"].u, rel=0.02)
    assert np.ptp(draws[:, 0], axis=1).std() < by_key["E"].u
    # An edge of A is x̄ + 2s; s of five normal readings has the standard deviation 0.34 µm, 1/√8 = 0.35 in linear propagation.
    five = np.random.default_rng(3).normal(0.0, 1.0, (20_000, 2, 5))
    edge = five.mean(axis=2) + 2.0 * five.std(axis=2, ddof=1) * [1.0, -1.0]
    assert (edge[:, 0] - edge[:, 1]).std() == pytest.approx(by_key["A"].u, rel=0.05)


@pytest.mark.parametrize(
    ("sign", "cycles", "missing"), [(1, 1, ("R", "A")), (-1, 3, ())], ids=["one cycle", "three cycles, length falls"]
)
def test_lengths_along_the_axis(
    dmu50: Machine, tmp_path: Path, sign: int, cycles: int, missing: tuple[str, ...]
) -> None:
    targets = np.array([0.0, 100.0, 200.0, 400.0])
    q = motions.there_and_back(targets, cycles)
    side = np.tile(np.repeat([1.0, -1.0], 4), cycles)
    read = sign * (q + 3e-5 * q + 5e-3 * (side > 0)) + 12.0
    points = np.column_stack([read, *np.full((2, len(q)), np.nan)])
    data = Measurements.load(motions.write(tmp_path / "m.csv", motions.positions(len(q), X=q), points), dmu50)
    found = twin.evaluate(data, dmu50, tolerances={"R": 1.0})
    ours = values(found, "X")
    assert ours["B"] == pytest.approx(5.0, abs=1e-6) and ours["E"] == pytest.approx(17.0, abs=1e-6)
    assert ours["E_forward"] == pytest.approx(12.0, abs=1e-6) and ours["M"] == pytest.approx(12.0, abs=1e-6)
    assert all(np.isnan(ours[key]) for key in missing)
    text = " ".join(found.tests[0].remarks)
    assert "4 targets, at least 5 required" in text and f"{cycles} cycles, 5 required" in text
    assert not found.met, "R is not determined, or 5 µm"
    assert found.to_dict()["tests"][0]["values"]["E_um"] == pytest.approx(17.0, abs=1e-6)


def test_length_across_the_axis_is_refused_in_words(dmu50: Machine, tmp_path: Path) -> None:
    q = motions.there_and_back(np.linspace(0.0, 400.0, 5), 2)
    points = np.column_stack([np.hypot(q, 600.0), *np.full((2, len(q)), np.nan)])
    data = Measurements.load(motions.write(tmp_path / "m.csv", motions.positions(len(q), X=q), points), dmu50)
    found = twin.evaluate(data, dmu50)
    assert not found.tests
    assert any("not along the axis" in one.why for one in found.not_evaluated)


# --- circles ----------------------------------------------------------------------------------------------------------------

RADIUS = 100.0
GAMMA = 50e-6
BACKLASH = 6e-3


def circle(sense: float) -> tuple[np.ndarray, np.ndarray]:
    """Return commands of X and Y and the real positions: squareness γ and a reversal of X."""
    theta = np.radians(sense * np.arange(0.0, 361.0, 2.0))
    q = np.column_stack([250.0 + RADIUS * np.cos(theta), 225.0 + RADIUS * np.sin(theta)])
    moving = np.sign(np.round(-np.sin(theta + sense * np.radians(0.5)), 12)) * sense
    real = q + np.column_stack([GAMMA * (q[:, 1] - 225.0) - BACKLASH / 2.0 * moving, np.zeros(len(q))])
    return q, real


@pytest.mark.parametrize("instrument", ["tracker", "ball bar"])
def test_circle(dmu50: Machine, tmp_path: Path, instrument: str) -> None:
    paths = [circle(1.0), circle(-1.0)]
    feed_in = np.column_stack([np.linspace(250.0, 340.0, 4), np.full(4, 225.0)])
    commands = np.vstack([feed_in, paths[0][0], paths[1][0]])
    real = np.vstack([feed_in, paths[0][1], paths[1][1]])
    q = motions.positions(len(commands), X=commands[:, 0], Y=commands[:, 1])
    if instrument == "tracker":
        points = motions.seen(np.column_stack([real, np.full(len(real), 5.0)]) - motions.HOME)
        table = motions.write(tmp_path / "m.csv", q, points)
    else:
        length = np.hypot(*(real - [250.0, 225.0]).T)
        points = np.column_stack([length, *np.full((2, len(q)), np.nan)])
        table = motions.write(tmp_path / "m.csv", q, points, station_carrier=["work"] * len(q))
    found = twin.evaluate(Measurements.load(table, dmu50), dmu50)
    ours = values(found, "XY")
    angle = np.radians(np.arange(0.0, 361.0, 2.0))
    difference = [np.hypot(*(path - [250.0, 225.0]).T) for _, path in paths]
    # The second path runs backwards through the same angles.
    h = np.abs(difference[0] - difference[1][::-1]).max() * 1e3
    assert ours["H"] == pytest.approx(h, abs=0.02) and 0.9 * BACKLASH * 1e3 < h <= BACKLASH * 1e3 + 1e-6
    for way, radius in zip(("forward", "backward"), difference, strict=True):
        waves = np.column_stack(
            [np.ones_like(angle), np.cos(angle), np.sin(angle) * (1.0 if way == "forward" else -1.0)]
        )
        left = radius - waves @ np.linalg.lstsq(waves, radius, rcond=None)[0]
        assert ours[f"G_{way}"] <= np.ptp(left) * 1e3 + 0.05, "the minimum zone is at most the least-squares one"
        assert ours[f"G_{way}"] > 0.85 * np.ptp(left) * 1e3
        assert ours[f"G_{way}"] > RADIUS * GAMMA * 1e3 * 0.9
    assert ours["G_b"] >= ours["G"] and abs(ours["D"]) < 0.1
    (test,) = found.named("XY", "circular")
    assert any("not checked against the text" in text for text in test.remarks)
    assert "radius 100.000 mm" in test.place
    assert not found.named("X") and not found.named("Y"), "the feed-in is not a positioning run with two directions"


def test_circles_that_follow_each_other(dmu50: Machine, tmp_path: Path) -> None:
    """Two feeds at radius 100 mm and one at 60 mm, without a break and with commands rounded to 1 µm: three tests."""
    parts = [(100.0, 1000.0, 3.0), (100.0, 4000.0, 9.0), (60.0, 1000.0, 5.0)]
    theta = np.radians(np.concatenate([np.arange(0.0, 361.0, 3.0), np.arange(360.0, -1.0, -3.0)]))
    q = np.vstack([[250.0, 225.0] + r * np.column_stack([np.cos(theta), np.sin(theta)]) for r, _, _ in parts])
    wave = np.concatenate([1e-3 * size / 2.0 * np.cos(3.0 * theta) for _, _, size in parts])
    centred = q - [250.0, 225.0]
    points = np.column_stack([centred * (1.0 + wave / np.hypot(*centred.T))[:, None], np.zeros(len(q))])
    commands = motions.positions(len(q), X=np.round(q[:, 0], 3), Y=np.round(q[:, 1], 3))
    feeds = np.repeat([feed for _, feed, _ in parts], len(theta))
    times = range(len(q))  # equal readings without a time would count as copied rows
    table = motions.write(tmp_path / "m.csv", commands, motions.seen(points), feed_mm_min=list(feeds), time_s=times)
    found = twin.evaluate(Measurements.load(table, dmu50), dmu50)
    assert [one.kind for one in found.tests] == ["circular"] * 3
    for test, (radius, feed, size) in zip(found.tests, parts, strict=True):
        assert f"radius {radius:.3f} mm" in test.place and f"feed {feed:g} mm/min" in test.place
        # Rounded commands move the angles by some 10 µrad, not the radii.
        assert {one.key: one.value for one in test.values}["G_b"] == pytest.approx(size, abs=0.02)


@pytest.mark.parametrize(
    ("zero", "length", "expected"),
    [(0.0, None, 0.0), (0.0, 100.004, -4.0), (-100.0, 100.004, 0.0), (-100.0, None, np.nan)],
)
def test_length_of_a_ball_bar(
    dmu50: Machine, tmp_path: Path, zero: float, length: float | None, expected: float
) -> None:
    """Readings are lengths, or changes of length; the calibrated nominal length of the bar shifts D and F, and nothing else."""
    commands, real = (np.vstack(both) for both in zip(circle(1.0), circle(-1.0), strict=True))
    bar = np.hypot(*(real - [250.0, 225.0]).T)
    points = np.column_stack([bar + zero, *np.full((2, len(bar)), np.nan)])
    q = motions.positions(len(bar), X=commands[:, 0], Y=commands[:, 1])
    table = motions.write(tmp_path / "m.csv", q, points, station_carrier=["work"] * len(q))
    ours = values(twin.evaluate(Measurements.load(table, dmu50), dmu50, length_mm=length), "XY")
    # Squareness and reversal leave the mean radius at 100 mm; a change of length counts from the nominal length of the bar.
    assert ours["D"] == pytest.approx(expected, abs=0.1, nan_ok=True)
    assert np.isnan(ours["F_max_forward"]) == np.isnan(expected)
    assert ours["H"] > 5.0 and ours["G_b"] > 5.0


# --- rotary axes and interpolation ----------------------------------------------------------------------------------------------


def test_rotary_positioning_and_error_motion(dmu50: Machine, tmp_path: Path) -> None:
    """A target on the table at 200 mm while C turns, there and back: a wave and a reversal of its angle, a face motion."""
    c = motions.there_and_back(np.arange(0.0, 360.0, 30.0), 2)
    side = np.tile(np.repeat([1.0, -1.0], 12), 2)
    angle = c + np.degrees(40e-6 * np.sin(np.radians(3.0 * c)) + 10e-6 * side)
    points = motions.to_machine(np.tile([200.0, 0.0, 30.0], (len(c), 1)), np.zeros(len(c)), angle)
    points[:, 2] += 2e-3 * np.cos(np.radians(2.0 * c))
    data = Measurements.load(
        motions.write(
            tmp_path / "m.csv",
            motions.positions(len(c), C=c),
            motions.seen(points),
            carrier="work",
            time_s=range(len(c)),
            **{f"u_{letter}_mm": ["0.0005"] * len(c) for letter in "xyz"},
        ),
        dmu50,
    )
    found = twin.evaluate(data, dmu50)
    # 0.5 µm a coordinate: at 200 mm an angle to 2.5 µrad, a mean of two readings to 2.5/√2; a range is the difference of two.
    (angle_test,), (face_test,) = found.named("C", "positioning"), found.named("C face")
    assert {one.key: one.u for one in angle_test.values}["B"] == pytest.approx(2.5, rel=1e-3)
    assert [one.u for one in face_test.values] == pytest.approx([0.5 * np.sqrt(2.0)] * len(face_test.values))
    ours = values(found, "C", "positioning")
    assert ours["B"] == pytest.approx(20.0, abs=0.05) and ours["B_mean"] == pytest.approx(20.0, abs=0.05)
    assert ours["E_forward"] == pytest.approx(80.0, abs=0.1) and ours["E"] == pytest.approx(100.0, abs=0.1)
    assert ours["R_forward"] == pytest.approx(0.0, abs=0.01)
    face = values(found, "C face")
    assert face["residual_synchronous"] == pytest.approx(4.0, abs=0.02)
    assert values(found, "C radial")["synchronous"] == pytest.approx(0.0, abs=0.02)


def test_error_motion_of_a_centred_target(dmu50: Machine, tmp_path: Path) -> None:
    """A sphere near the axis of C, read by an R-test on the base: radial and axial motion, eccentricity removed."""
    c = np.tile(np.arange(0.0, 360.0, 15.0), 2)
    theta = np.radians(c)
    turn = np.repeat([0.0, 1.0], 24)
    points = np.column_stack(
        [
            0.02 * np.cos(theta) + 3e-3 * np.cos(2.0 * theta),
            -0.02 * np.sin(theta),
            1e-3 * np.cos(theta) + 5e-4 * turn,
        ]
    )
    data = Measurements.load(
        motions.write(tmp_path / "m.csv", motions.positions(len(c), C=c), points, carrier="work"), dmu50
    )
    found = twin.evaluate(data, dmu50)
    assert values(found, "E_XC")["synchronous"] == pytest.approx(6.0, abs=1e-6)
    assert values(found, "E_YC")["synchronous"] == pytest.approx(0.0, abs=1e-6)
    axial = values(found, "E_ZC")
    assert axial["synchronous"] == pytest.approx(2.0, abs=1e-6) and axial["asynchronous"] == pytest.approx(
        0.5, abs=1e-6
    )


def test_a_target_that_the_axis_does_not_turn_shows_no_error_motion(dmu50: Machine, tmp_path: Path) -> None:
    """A reflector at the spindle, read from the base, while the table turns: the readings are noise, not an error motion of C."""
    c = np.tile(np.arange(0.0, 360.0, 30.0), 2)
    points = np.random.default_rng(1).normal(0.0, 1e-3, (24, 3)) + np.array([100.0, 200.0, 300.0])
    found = twin.evaluate(
        Measurements.load(motions.write(tmp_path / "m.csv", motions.positions(24, C=c), points), dmu50), dmu50
    )
    assert found.tests == ()
    assert any(one.test.startswith("C:") and "turns neither" in one.why for one in found.not_evaluated)


@pytest.mark.parametrize(("moved", "name"), [("B", "BK1"), ("C", "BK2"), ("BC", "BK4")])
@pytest.mark.parametrize("given", ["R-test", "ball bar", "touch probe"])
def test_kinematic_tests(dmu50: Machine, tmp_path: Path, moved: str, name: str, given: str) -> None:
    """The ball follows a point of the table: X, Y, Z from the closed form, with and without the place of the ball in the table."""
    t = np.linspace(0.0, 1.0, 25)
    b = 60.0 * t if "B" in moved else np.zeros(25)
    c = 180.0 * t if "C" in moved else np.zeros(25)
    ball = motions.to_machine(np.tile([60.0, 20.0, 90.0], (25, 1)), b, c)
    q = motions.positions(25, B=b, C=c)
    q[:, :3] = ball + motions.HOME + [0.0, 0.0, 120.0]  # a tool of 120 mm
    error = 1e-3 * np.column_stack([5.0 * np.sin(7.0 * t), 8.0 * t**2, 0.0 * t])
    columns = {"station_carrier": ["work"] * 25}
    points, carrier = error + np.array([1.0, -2.0, 3.0]), "tool"
    if given == "ball bar":
        points = np.column_stack([100.0 + error[:, 1], *np.full((2, 25), np.nan)])
    elif given == "touch probe":
        q[:, :3] += error
        points, carrier, columns = np.zeros((25, 3)), "work", {"station_carrier": ["tool"] * 25}
    found = twin.evaluate(
        Measurements.load(motions.write(tmp_path / "m.csv", q, points, carrier=carrier, **columns), dmu50), dmu50
    )
    (test,) = [one for one in found.tests if one.kind == "kinematic"]
    assert test.name.startswith(name), test.name
    assert any("not verified" in text for text in test.remarks)
    ours = {one.key: one.value for one in test.values}
    if given == "R-test":
        assert ours == pytest.approx({f"range_{k}": np.ptp(error[:, i]) * 1e3 for i, k in enumerate("xyz")}, abs=1e-6)
    elif given == "ball bar":
        assert ours == pytest.approx({"range_length": 8.0}, abs=1e-6)
    else:
        # The place of the sphere is fitted to the same positions by least squares and absorbs a part of the errors.
        assert isinstance(test.detail, np.ndarray)
        spread = (error - error.mean(axis=0)) * 1e3
        assert 0.1 * np.sum(spread**2) < np.sum(test.detail**2) <= np.sum(spread**2)
        assert ours == pytest.approx({f"range_{k}": np.ptp(test.detail[:, i]) for i, k in enumerate("xyz")})


def test_short_runs_that_follow_each_other_are_all_found(dmu50: Machine, tmp_path: Path) -> None:
    """X, Y, Z, B and C one after the other in one round, each once through five targets, with nothing between them."""
    ends = {"X": (0.0, 400.0), "Y": (0.0, 400.0), "Z": (-400.0, 0.0), "B": (0.0, 120.0), "C": (0.0, 240.0)}
    q = np.vstack([motions.positions(5, **{name: np.linspace(*reach, 5)}) for name, reach in ends.items()])
    work = motions.to_machine(np.tile([150.0, 60.0, 40.0], (25, 1)), q[:, 3], q[:, 4])
    tool = q[:, :3] - motions.HOME
    tables = []
    for name, points, carrier in (("tool", tool, "tool"), ("table", work, "work")):
        path = motions.write(tmp_path / f"{name}.csv", q, motions.seen(points), carrier=carrier)
        path.write_text(path.read_text().replace(",K,", f",{name},"))
        tables.append(Measurements.load(path, dmu50))
    found = twin.evaluate(Measurements.join(tables), dmu50)
    positioning = {one.name: one for one in found.tests if one.kind == "positioning"}
    assert set(positioning) == set("XYZBC")
    for one in positioning.values():
        assert {value.key: value.value for value in one.values}["E_forward"] == pytest.approx(0.0, abs=1e-3)
    assert {one.name for one in found.tests if one.kind == "squareness"} == {"E_C0Y", "E_B0Z", "E_A0Z"}
    assert not [one for one in found.tests if one.kind in ("kinematic", "circular")]


def test_kinematic_test_with_repeated_readings(dmu50: Machine, tmp_path: Path) -> None:
    c = np.repeat(np.linspace(0.0, 180.0, 12), 2)
    q = motions.positions(24, C=c)
    q[:, :3] = motions.to_machine(np.tile([60.0, 20.0, 90.0], (24, 1)), 0.0 * c, c) + motions.HOME
    points = 1e-3 * np.column_stack([np.arange(24.0), np.zeros(24), np.ones(24)])
    found = twin.evaluate(
        Measurements.load(motions.write(tmp_path / "m.csv", q, points, station_carrier=["work"] * 24), dmu50), dmu50
    )
    (test,) = found.tests
    assert test.name == "BK2 (XYC)" and test.values[0].value == pytest.approx(23.0)


def test_a_point_that_moves_is_no_kinematic_test(dmu50: Machine, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    q = np.column_stack(
        [rng.uniform(low, high, 30) for low, high in ((0, 500), (0, 450), (-400, 0), (0, 90), (0, 360))]
    )
    found = twin.evaluate(
        Measurements.load(motions.write(tmp_path / "m.csv", q, rng.uniform(0, 500, (30, 3))), dmu50), dmu50
    )
    assert found.tests == ()
    missing = {one.test for one in found.not_evaluated}
    assert {"X, Y, Z, B, C: positioning", "circular", "squareness", "kinematic (ISO 10791-6)"} <= missing


# --- tolerances, files --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of X with E 10 µm, B 2 µm, marked as simulated, with uncertainties of 0.5 µm."""
    targets = np.linspace(0.0, 400.0, 5)
    q = motions.there_and_back(targets, 5)
    side = np.tile(np.repeat([1.0, -1.0], 5), 5)
    read = q + 8e-3 * q / 400.0 + 1e-3 * side
    points = np.column_stack([read, *np.full((2, len(q)), np.nan)])
    path = tmp_path_factory.mktemp("table") / "m.csv"
    return motions.write(
        path, motions.positions(len(q), X=q), points, comment="simulated readings", u_x_mm=["0.0005"] * len(q)
    )


@pytest.mark.parametrize(
    ("tolerances", "status", "said"),
    [
        (("E=12", "B=3"), 0, "conformity is proven"),
        (("E=10.2",), 0, "UNDECIDED"),
        (("E=9.8",), 3, "UNDECIDED"),
        (("X:E=8",), 3, "nonconformity is proven"),
        (("E=12", "H=5"), 3, "NOT EVALUATED"),
        (("Y:E=12",), 3, "NOT EVALUATED"),
        (("E↑=8.1",), 0, "margin is within U"),
        (("E↑=12",), 0, "PASS"),
        ((), 0, "positioning"),
    ],
)
def test_tolerances(
    capsys: pytest.CaptureFixture[str], table: Path, tolerances: tuple[str, ...], status: int, said: str
) -> None:
    found, out = run(capsys, table, *(["--tolerance", *tolerances] if tolerances else []))
    assert found == status and said in " ".join(out.split()), out


def test_files_carry_the_warning_and_the_numbers(
    capsys: pytest.CaptureFixture[str], table: Path, tmp_path: Path
) -> None:
    page, report = tmp_path / "t.html", tmp_path / "t.json"
    status, out = run(capsys, table, "--tolerance", "E=9", "--html", page, "--json", report)
    assert status == 3 and "SIMULATED READINGS" in out
    html, found = page.read_text(), json.loads(report.read_text())
    assert (
        "SIMULATED READINGS" in html and "<svg" not in html.split("<img")[0] and "http:" not in html.split("<body>")[0]
    )
    assert "FAIL" in html and "ISO 230-2:2014" in html and html.count("<img") == 1
    assert found["schema"] == "twin.evaluation/1" and found["warnings"][0]["name"] == "simulated_readings"
    (test,) = found["tests"]
    assert test["values"]["E_um"] == pytest.approx(10.0, abs=1e-6) and test["values"]["B_um"] == pytest.approx(
        2.0, abs=1e-6
    )
    assert {"A_um", "A_forward_um", "E_um", "R_um", "M_um", "B_um", "B_mean_um"} <= set(test["values"])
    assert len(test["detail"]["forward"]) == 5
    (check,) = found["tolerances"]
    assert check["met"] is False and check["conformity"] == "nonconforming" and check["limit"] == 9.0
    assert found["met"] is False


def test_page_draws_every_kind_of_test(dmu50: Machine, tmp_path: Path) -> None:
    """One direction of approach, a circle, a turn of C and an interpolated motion of X, Y and C, in tables of their own."""
    up = np.linspace(0.0, 400.0, 5)
    lengths = np.column_stack([up * (1.0 + 1e-5), *np.full((2, 5), np.nan)])
    commands, real = circle(1.0)
    flat = np.column_stack([real, np.zeros(len(real))])
    c = np.arange(0.0, 360.0, 15.0)
    ball = motions.to_machine(np.tile([60.0, 20.0, 90.0], (24, 1)), 0.0 * c, c)
    follow = motions.positions(24, C=c)
    follow[:, :3] = ball + motions.HOME + [0.0, 0.0, 120.0]
    wave = 1e-3 * np.column_stack([np.sin(np.radians(2.0 * c + k)) for k in range(3)])
    parts = {
        "length": (motions.positions(5, X=up), lengths, "base"),
        "circle": (motions.positions(len(real), X=commands[:, 0], Y=commands[:, 1]), motions.seen(flat), "base"),
        "turn": (motions.positions(24, C=c), wave, "work"),
        "follow": (follow, wave, "work"),
    }  # fmt: skip
    data = Measurements.join(
        [
            Measurements.load(
                motions.write(
                    tmp_path / f"{name}.csv", q, points, station=[name] * len(q), station_carrier=[side] * len(q)
                ),
                dmu50,
            )
            for name, (q, points, side) in parts.items()
        ]
    )
    found = twin.evaluate(data, dmu50)
    kinds = [one.kind for one in found.tests]
    assert kinds == ["positioning", *["rotary error motion"] * 3, "circular", "kinematic"], kinds
    page = twin.evaluation_html(found)
    assert page.count("<img") == 6 and "not checked against the text" in page and "not verified" in page
    assert {one.name for one in found.tests} == {"X", "E_XC", "E_YC", "E_ZC", "XY", "BK2 (XYC)"}


@pytest.mark.parametrize("entry", ["A", "A=", "=3", "A=x", "A=-1", "A=inf"])
def test_tolerances_that_cannot_be_read(capsys: pytest.CaptureFixture[str], table: Path, entry: str) -> None:
    assert run(capsys, table, "--tolerance", entry)[0] == 2


def test_instrument_gives_the_uncertainty_that_the_table_lacks(dmu50: Machine, table: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(line.rpartition(",")[0] for line in table.read_text().splitlines()[1:]) + "\n")
    data = Measurements.load(bare, dmu50)
    unknown, known = twin.evaluate(data, dmu50, tolerances={"E": 12}), twin.evaluate(data, dmu50, instrument=AT960)
    assert unknown.checks[0].met and unknown.checks[0].conformity == "unknown" and unknown.uncertainty == ""
    assert all(np.isfinite(one.u) for one in known.tests[0].values) and "tracker" in known.uncertainty
