"""One linear axis under a multi-axis interferometer: compared with Pinocchio, with simulated truths, and with three reflectors."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin
import pytest

from twin import cli
from twin._common.errors import InputError
from twin.identification.axis_layout import AxisLayout, BeamReadings, carriage_poses, load_readings, simulate_run
from twin.identification.axis_run import axis_curves, error_motions, to_text
from twin.identification.thesis import three_point
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects import Reversal
from twin.model.motion_curve import Curve

LAYOUT = Path(__file__).resolve().parents[2] / "twin" / "samples" / "nine_beams_x.yaml"
FORTH = np.linspace(0.0, 500.0, 21)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return Machine.load("dmu50")


@pytest.fixture(scope="module")
def layout(machine: Machine) -> AxisLayout:
    return AxisLayout.load(LAYOUT, machine)


def run_of(rounds: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, sides and rounds of a run back and forth."""
    n = len(FORTH)
    return (
        np.tile(np.concatenate([FORTH, FORTH[::-1]]), rounds),
        np.tile(np.repeat([1.0, -1.0], n), rounds),
        np.repeat([str(k + 1) for k in range(rounds)], 2 * n),
    )


def drawn(machine: Machine, seed: int, axis: str = "X") -> Calibration:
    """Return six random curves of degree 2 to 5, some micrometres and tens of microradians."""
    rng = np.random.default_rng(seed)
    curves = {}
    lower, upper = machine.by_name[axis].lower, machine.by_name[axis].upper
    for i, letter in enumerate("XYZABC"):
        count = int(rng.integers(3, 7))
        size = 5.0 if i < 3 else 20.0
        name = f"E_{letter}{axis}"
        values = tuple(float(v) for v in rng.normal(size=count) * size)
        curves[name] = Curve(name, "um" if i < 3 else "urad", (lower or 0.0, upper or 0.0), "power", values)
    return dataclasses.replace(Calibration.zero(machine), curves=MappingProxyType(curves))


def fine(name: str, values: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return a curve in the datum: without its mean over the travel and, for a straightness, without its mean slope."""
    degree = 1 if name[2] in "YZ" else 0
    return values - np.polyval(np.polyfit(q, values, degree), q)


def without_datum(curve: Curve, q: np.ndarray) -> np.ndarray:
    """Return a power curve over 0 to 500 mm without its mean and, for a straightness, its mean slope: by Legendre polynomials."""
    legendre = np.polynomial.legendre.poly2leg(np.array(curve.coefficients))
    legendre[: 2 if curve.name[2] in "YZ" else 1] = 0.0
    return np.asarray(np.polynomial.legendre.legval((2.0 * q - 500.0) / 500.0, legendre))


def test_the_carriage_is_where_pinocchio_has_it(machine: Machine, layout: AxisLayout) -> None:
    """The whole chain of the machine, every error frame a free-flyer joint; X stands on an error-free base."""
    calibration = drawn(machine, 1)
    found = carriage_poses(layout, machine, calibration, FORTH)
    frame = next(f for f in machine.frames if (f.axis, f.role) == ("X", "motion"))
    data = machine.model.createData()

    def carriage(q: float) -> pin.SE3:
        errors = np.zeros((len(machine.frames), 6))
        for i, letter in enumerate("XYZABC"):
            errors[machine.frames.index(frame), i] = calibration.curves[f"E_{letter}X"](q) * 1e-6
        position = np.array([q * 1e-3, 0.225, -0.2, 0.0, 0.0])
        pin.forwardKinematics(machine.model, data, machine.configuration(position, errors))
        return data.oMi[frame.joint].copy() * pin.SE3(np.eye(3), layout.place)

    rest = carriage(layout.reference_mm).inverse()
    for q, pose in zip(FORTH, found, strict=True):
        real = rest * carriage(float(q))
        assert np.abs(real.translation - pose[:3]).max() < 1e-15
        assert np.abs(pin.log3(real.rotation) - pose[3:]).max() < 1e-15


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_exact_readings_give_the_motions_back(machine: Machine, layout: AxisLayout, axis: str) -> None:
    """For every linear axis; up to constants and, if the reference itself is tilted, the slope of a straightness."""
    own = machine.by_name[axis]
    assert own.lower is not None and own.upper is not None
    q = np.linspace(own.lower, own.upper, 15)
    direction = np.abs(np.array(own.direction))
    turned = dataclasses.replace(
        layout,
        axis=own,
        reference_mm=float(q[7]),
        # The outermost sources are further from their mirrors than the axis travels.
        beams=dataclasses.replace(layout.beams, source=layout.beams.source - 0.3 * direction),
    )
    calibration = drawn(machine, 2, axis)
    nothing = np.zeros(len(layout.installation_u))
    readings, _ = simulate_run(
        turned, machine, calibration, q, np.random.default_rng(0), installation=nothing, noise=False
    )
    found = error_motions(turned, readings)
    along = "XYZ"[int(np.argmax(direction))]
    for i, letter in enumerate("XYZABC"):
        name = f"E_{letter}{axis}"
        degree = 1 if letter in "XYZ" and letter != along else 0
        difference = found.values[:, i] - np.asarray(calibration.curves[name](q))
        left = difference - np.polyval(np.polyfit(q, difference, degree), q)
        # Errors of 50 µm and 100 µrad times each other: 5 nm, and as many nanoradians.
        assert np.abs(left).max() < 0.01


@pytest.mark.slow
def test_uncertainties_cover_the_truth(machine: Machine, layout: AxisLayout) -> None:
    """40 random machines and layouts: every curve at five positions compared with its standard uncertainty."""
    positions, side, rounds = run_of()
    at = np.linspace(20.0, 480.0, 5)
    scores, chances, shares = [], [], []
    for seed in range(40):
        calibration = drawn(machine, 100 + seed)
        rng = np.random.default_rng(seed)
        readings, _ = simulate_run(layout, machine, calibration, positions, rng, rounds=rounds, approach=side)
        motions = error_motions(layout, readings)
        found = axis_curves(motions, machine, source="a test")
        chances.append((motions.p_value, found.p_value))
        shares.append(np.mean(motions.u_installation / motions.u))
        for name, real in calibration.curves.items():
            curve = found.calibration.curves[name]
            basis = np.stack([((2.0 * at - 500.0) / 500.0) ** k for k in range(len(curve.coefficients))], axis=1)
            assert curve.covariance is not None
            u = np.sqrt(np.einsum("ai,ij,aj->a", basis, curve.covariance, basis))
            scores.append((np.asarray(curve(at)) - without_datum(real, at)) / u)
    z = np.array(scores)
    # 240 curves, the installation common to six of them: 40 independent draws. 95 % ± 3.5 %; mean square 1 ± 0.25.
    assert 0.90 < np.mean(np.abs(z) < 1.96) < 0.99
    assert 0.7 < np.mean(z**2) < 1.35
    # Both misfits are chi² where all is as stated: no p-value of 40 below 1e-4, their mean one half ± 0.14 (three standard errors).
    low = np.array(chances)
    assert low.min() > 1e-4
    assert np.abs(low.mean(axis=0) - 0.5).max() < 0.14
    assert np.mean(shares) > 0.7  # what no repeat takes away is most of it


def test_against_three_reflectors_on_the_same_positions(machine: Machine, layout: AxisLayout) -> None:
    """Without noise both agree; with the noise of beams and of a tracker at 2 m, the beams' angles are far better."""
    calibration = drawn(machine, 3)
    places = np.array([[0.10, -0.05, -0.03], [-0.08, 0.06, -0.07], [0.02, 0.11, -0.12]])

    def reflectors(noise_m: float, rng: np.random.Generator) -> np.ndarray:
        found = np.zeros((len(FORTH), 3, 3))
        for g, q in enumerate(FORTH):
            e = np.array([float(calibration.curves[f"E_{letter}X"](q)) for letter in "XYZABC"]) * 1e-6
            found[g] = places @ pin.exp3(e[3:]).T + e[:3] - places
        return found + rng.normal(size=found.shape) * noise_m

    def shape(values: np.ndarray) -> np.ndarray:
        return np.stack([fine(f"E_{n}X", values[:, i], FORTH) for i, n in enumerate("XYZABC")], axis=1)

    rng = np.random.default_rng(4)
    nothing = np.zeros(len(layout.installation_u))
    exact, _ = simulate_run(layout, machine, calibration, FORTH, rng, installation=nothing, noise=False)
    beams = shape(error_motions(layout, exact).values)
    three = shape(three_point(reflectors(0.0, rng), places, "X", equations="nine") * 1e6)
    assert np.abs(beams - three).max() < 0.02  # second order: 50 µm by 100 µrad

    noisy, _ = simulate_run(layout, machine, calibration, FORTH, rng)
    of_beams = shape(error_motions(layout, noisy).values) - beams
    # AT960 at 2 m: 15 + 6·2 µm across the beam at k = 2.
    of_three = shape(three_point(reflectors(13.5e-6, rng), places, "X", equations="nine") * 1e6) - three
    assert np.all(of_beams.std(axis=0)[3:] < 0.05 * of_three.std(axis=0)[3:])
    assert np.all(of_beams.std(axis=0)[:3] < 0.2 * of_three.std(axis=0)[:3])


def test_repeatability_beyond_the_noise_of_the_beams(machine: Machine, layout: AxisLayout) -> None:
    """A carriage with a repeatability of 0.5 µm and 1 µrad: it is found, and included by ``repeats``."""
    calibration = drawn(machine, 5)
    positions, side, rounds = run_of(5)
    rng = np.random.default_rng(6)
    poses = carriage_poses(layout, machine, calibration, positions)
    poses = poses + rng.normal(size=poses.shape) * ([0.5e-6] * 3 + [1e-6] * 3)
    change = layout.beams.readings(poses) + rng.normal(size=(len(poses), 9)) * layout.noise
    plain, _ = simulate_run(layout, machine, calibration, positions, rng, rounds=rounds, approach=side)
    readings = dataclasses.replace(plain, change_mm=change * 1e3)
    stated = error_motions(layout, readings)
    repeats = error_motions(layout, readings, spread="repeats")
    assert np.allclose(repeats.repeatability[3:], 1.0, rtol=0.2)
    # A turn about the carriage's point moves the error frame's origin, 0.1 m off, by 0.1 µm.
    assert np.allclose(repeats.repeatability[:3], 0.5, rtol=0.2)
    assert axis_curves(stated, machine, source="a test").p_value < 1e-6
    assert axis_curves(repeats, machine, source="a test").p_value > 1e-3
    curves = axis_curves(stated, machine, source="a test")
    assert "base the uncertainty on repeats" in to_text(layout, readings, stated, curves)
    with pytest.raises(InputError, match="seven more rows"):
        few, _ = simulate_run(layout, machine, calibration, FORTH, rng)
        error_motions(layout, few, spread="repeats")


def test_a_layout_that_is_not_as_stated_shows_in_the_misfit(machine: Machine, layout: AxisLayout) -> None:
    positions, side, rounds = run_of()
    wrong = np.zeros(len(layout.installation_u))
    wrong[layout.beams.installation.index("beam y2 x")] = 5e-3  # 25 times what is stated
    readings, _ = simulate_run(
        layout,
        machine,
        drawn(machine, 7),
        positions,
        np.random.default_rng(8),
        rounds=rounds,
        approach=side,
        installation=wrong,
    )
    motions = error_motions(layout, readings)
    assert motions.p_value < 1e-6
    assert "are not as stated" in to_text(layout, readings, motions, axis_curves(motions, machine, source="a test"))


def test_reversal_is_reported_and_not_part_of_the_curves(machine: Machine, layout: AxisLayout) -> None:
    plain = drawn(machine, 9)
    turned = dataclasses.replace(plain, extra=(Reversal(machine.by_name["X"], 3.0),))
    positions, side, rounds = run_of()
    answers = []
    for calibration in (plain, turned):
        readings, _ = simulate_run(
            layout, machine, calibration, positions, np.random.default_rng(10), rounds=rounds, approach=side
        )
        answers.append(axis_curves(error_motions(layout, readings), machine, source="a test"))
    value, u = answers[1].reversal["E_XX"]
    assert abs(value - 3.0) < 4.0 * u < 0.01
    assert all(abs(v) < 4.0 * s for name, (v, s) in answers[1].reversal.items() if name != "E_XX")
    before, after = (np.asarray(one.calibration.curves["E_XX"](FORTH)) for one in answers)
    assert np.abs(before - after).max() < 0.005


def test_the_calibration_is_saved_and_read_back(machine: Machine, layout: AxisLayout, tmp_path: Path) -> None:
    readings, _ = simulate_run(layout, machine, drawn(machine, 11), FORTH, np.random.default_rng(12))
    found = axis_curves(error_motions(layout, readings), machine, source="a test").calibration
    found.save(tmp_path / "x.yaml")
    again = Calibration.load(tmp_path / "x.yaml", machine)
    assert set(again.curves) == {f"E_{letter}X" for letter in "XYZABC"}
    assert all(np.array_equal(again.curves[name](FORTH), found.curves[name](FORTH)) for name in found.curves)
    assert found.joint is not None and again.joint is not None
    assert np.array_equal(again.joint.matrix, found.joint.matrix)
    # The installation is common to all six: they are not independent.
    scale = np.sqrt(np.diag(found.joint.matrix))
    first = [i for i, name in enumerate(found.joint.names) if not name.startswith("E_XX")]
    other = [i for i, name in enumerate(found.joint.names) if name.startswith("E_XX")]
    with np.errstate(invalid="ignore"):
        correlation = found.joint.matrix / np.outer(scale, scale)
    assert np.nanmax(np.abs(correlation[np.ix_(first, other)])) > 0.1


def test_readings_are_written_and_read_back(machine: Machine, layout: AxisLayout, tmp_path: Path) -> None:
    positions, side, rounds = run_of(1)
    readings, _ = simulate_run(
        layout,
        machine,
        drawn(machine, 13),
        positions,
        np.random.default_rng(14),
        rounds=rounds,
        approach=side,
    )
    change = np.round(readings.change_mm, 6) + 0.0  # simulated readings are written in nanometres
    change[3, 2] = np.nan
    readings = dataclasses.replace(readings, change_mm=change, time_s=np.arange(len(positions)) * 20.0)
    readings.save(tmp_path / "run.csv", layout, comment="a test")
    again = load_readings(tmp_path / "run.csv", layout)
    for field in ("position_mm", "change_mm", "approach", "time_s"):
        assert np.array_equal(getattr(again, field), getattr(readings, field), equal_nan=True)
    assert list(again.round) == list(readings.round)
    assert again.set_aside == () and again.simulated
    assert again.notices == ("the file says: simulated readings",)


def test_half_the_path_is_half_the_path(machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "layout.yaml"
    path.write_text(LAYOUT.read_text().replace("reference_mm: 250", "reading: displacement\nreference_mm: 250"))
    halved = AxisLayout.load(path, machine)
    whole = AxisLayout.load(LAYOUT, machine)
    runs = [
        simulate_run(one, machine, drawn(machine, 15), FORTH, np.random.default_rng(16), noise=False)[0]
        for one in (halved, whole)
    ]
    assert np.allclose(2.0 * runs[0].change_mm, runs[1].change_mm, rtol=0.0, atol=1e-12)
    assert halved.noise == 2.0 * whole.noise


@pytest.mark.parametrize(
    ("old", "new", "said", "line"),
    [
        ("axis: X", "axis: B", "not a linear axis of this machine", 5),
        ("reference_mm: 250", "reference_mm: 900", "outside the axis's range", 6),
        ("{mirror: y, source_mm: [-35", "{mirror: q, source_mm: [-35", "unknown mirror", 17),
        ("normal: [-1, 0, 0]", "normal: [0, 0, 0]", "the vector is zero", 9),
        ("normal: [-1, 0, 0]", "normal: [1, 0, 0]", "meets mirror x at too large an angle", 13),
        (
            "[0, 0, 1]}\nz2".replace("z2", "  z2"),
            "[0, 0, -1]}\n  z2",
            "beam z1 meets mirror z at too large an angle",
            19,
        ),
        ("[-500, 0, 40]", "[0, 0, 40]", "beam x1 starts behind", 13),
        ("noise_um: 0.005", "noise_um: 0", "greater than 0", 23),
        ("noise_um: 0.005", "noise_mm: 0.005", "noise_", 23),
        ("twin.interferometer/1", "twin.machine/1", "wrong kind of file", 3),
    ],
)
def test_layouts_that_do_not_fit(machine: Machine, tmp_path: Path, old: str, new: str, said: str, line: int) -> None:
    path = tmp_path / "layout.yaml"
    text = LAYOUT.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as refused:
        AxisLayout.load(path, machine)
    assert said in str(refused.value)
    assert (refused.value.file, refused.value.line) == (str(path), line)


def table(rows: list[str]) -> str:
    header = "X_mm," + ",".join(f"beam_{face}{k}_mm" for face in "xyz" for k in (1, 2, 3)) + ",approach"
    return "\n".join(["# by hand", header, *rows]) + "\n"


GOOD = "0,-500,-500,-500,0,0,0,0,0,0,1"


@pytest.mark.parametrize(
    ("text", "said", "line"),
    [
        (table([GOOD, GOOD.replace("-500", "x", 1)]), "beam_x1_mm is not a number", 4),
        (table([GOOD, GOOD[:-1] + "2"]), "approach is not a direction", 4),
        (table([GOOD, GOOD + ",1"]), "12 cells", 4),
        (table([GOOD]).replace("beam_z3_mm", "beam_z4_mm"), "column beam_z3_mm is missing", 2),
        (table([]), "no reading", None),
        (table(["900" + GOOD[1:]]), "the command of X is outside its range", 3),
        (table(["0,1,,,,,,,,,1"]), "fewer than 6 beams were read", 3),
        ("", "no header row", None),
    ],
)
def test_readings_that_do_not_fit(layout: AxisLayout, tmp_path: Path, text: str, said: str, line: int | None) -> None:
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        load_readings(path, layout)
    assert said in str(refused.value)
    assert (refused.value.file, refused.value.line) == (str(path), line)


def test_rows_that_cannot_be_used_are_named(layout: AxisLayout, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(table([GOOD, "nan" + GOOD[1:], GOOD]).replace("approach", "aproach"))
    found = load_readings(path, layout)
    assert [(note.line, note.text) for note in found.set_aside] == [
        (4, "a commanded position is missing or not finite")
    ]
    assert found.notices == ("column aproach is unknown and not used (did you mean approach?)",)


def test_too_few_positions(machine: Machine, layout: AxisLayout) -> None:
    readings, _ = simulate_run(layout, machine, drawn(machine, 17), FORTH[:3], np.random.default_rng(18))
    with pytest.raises(InputError, match="too few positions of X"):
        axis_curves(error_motions(layout, readings), machine, source="a test")


def test_readings_of_another_layout_are_refused(machine: Machine, layout: AxisLayout) -> None:
    """Beams of y and z swapped with those of x: no pose of the carriage agrees with them."""
    readings, _ = simulate_run(layout, machine, drawn(machine, 19), FORTH, np.random.default_rng(20))
    swapped: BeamReadings = dataclasses.replace(readings, change_mm=readings.change_mm[:, [3, 0, 1, 2, 4, 5, 6, 7, 8]])
    try:
        found = error_motions(layout, swapped)
    except InputError as error:
        assert "no pose of the carriage" in str(error)
    else:
        assert found.p_value == 0.0


def test_the_commands(machine: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, out, report = tmp_path / "run.csv", tmp_path / "x.yaml", tmp_path / "r.json"
    layout_name = "nine_beams_x.yaml"
    cli_run(["simulate-run", "--layout", layout_name, "--positions", "0,500,21", "-o", str(run), "--seed", "7"])
    cli_run(["axis-run", str(run), "--layout", layout_name, "-o", str(out), "--json", str(report)])
    said = capsys.readouterr().out
    assert "E_XX" in said and "simulated by twin" in said
    written = json.loads(report.read_text())
    assert (written["schema"], written["axis"], len(written["motions"])) == ("twin.axis_run/1", "X", 42)
    assert written["misfit"]["p_value"] > 1e-3
    found, truth = Calibration.load(out, machine), Calibration.default(machine)
    for name in found.curves:
        real = fine(name, np.asarray(truth.curves[name](FORTH)), FORTH)
        assert np.abs(fine(name, np.asarray(found.curves[name](FORTH)), FORTH) - real).max() < 4.0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["simulate-run", "-l", "nine_beams_x.yaml", "--positions", "0,500", "-o", "a.csv"], "from,to,count"),
        (["simulate-run", "-l", "nine_beams_x.yaml", "--positions", "0,900,5", "-o", "a.csv"], "0 to 500"),
        (["simulate-run", "-l", "none.yaml", "--positions", "0,500,5", "-o", "a.csv"], "no such layout"),
        (["axis-run", "none.csv", "-l", "nine_beams_x.yaml", "-o", "a.yaml"], "cannot be read"),
    ],
)
def test_commands_refuse_bad_usage(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli_run(arguments) == 2
    captured = capsys.readouterr().err
    assert said in captured and captured.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def cli_run(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as stopped:
        cli.main(arguments)
    return int(stopped.value.code or 0)
