"""Results do not hang on how a processor rounds: the last place of every input, and every command on another processor.

NumPy, BLAS and the C library choose among routines that round differently, so that the inputs of one and the same calculation differ in
their last places from one computer to another. A draw along eigenvectors, the larger of two equals and the sign of a vector are
no continuous functions of their inputs: the results differ altogether.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.identification.plans import volumetric
from tests.measurement.wen import nine_beams
from tests.model.errors import random_calibration
from twin._common.arrays import first_largest, read_only
from twin._common.families import INSTRUMENTS as FAMILY
from twin.machine.machine import Machine
from twin.measurement.contacts import _direction
from twin.measurement.instruments import INSTRUMENTS, Instrument
from twin.monitoring.pairs import simultaneous_factor
from twin.numerics.covariance import Covariance, symmetric_root
from twin.numerics.observability import Unknown, determinability
from twin.planning.design import Exchange
from twin.planning.task import LinearAim
from twin.standards.rotary_axes import _circle
from twin.thermal.fit import _directions
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty

POINTS = np.concatenate(
    [
        np.array([[2.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.3, 0.2, -2.2]]),
        np.random.default_rng(1).uniform(-3.0, 3.0, (40, 3)),
    ]
)
"""Points in a station's frame, metres: along an axis, in a plane, anywhere."""
ROUNDING = 1e-9
"""Largest relative change of a draw by a last place, 2e-16, of its inputs: the condition of the roots tested is far below 1e6."""


def moved(values: np.ndarray, towards: float) -> np.ndarray:
    """Return values that are all different in their last place, up for +inf and down for -inf."""
    return np.nextafter(values, towards)


@pytest.mark.parametrize("instrument", INSTRUMENTS, ids=lambda one: one.name)
@pytest.mark.parametrize("towards", [-np.inf, np.inf])
@pytest.mark.parametrize("coordinates", [[0], [1], [2], [0, 1, 2]], ids=str)
def test_a_reading_s_noise(instrument: Instrument, towards: float, coordinates: list[int]) -> None:
    """The last place of a coordinate, 4e-16 m, changes no reading by more than 1e-12 m: a millionth of the last digit printed."""
    near = POINTS.copy()
    near[:, coordinates] = moved(near[:, coordinates], towards)
    first, second = (instrument.noise(points, np.random.default_rng(7)) for points in (POINTS, near))
    assert np.abs(first).max() > 1e-8
    assert np.abs(second - first).max() < 1e-12


def test_every_instrument_of_the_family_is_tested() -> None:
    """The multi-axis interferometer is not in it: its noise is independent numbers times a standard deviation, without a covariance."""
    assert {one.name for one in INSTRUMENTS} == set(FAMILY)
    assert np.ndim(nine_beams().specification.columns) == 1


def repeated(rng: np.random.Generator, values: list[float]) -> np.ndarray:
    """Return a covariance with these eigenvalues."""
    basis = np.linalg.qr(rng.standard_normal((len(values), len(values))))[0]
    found = basis @ np.diag(values) @ basis.T
    return (found + found.T) / 2.0


@pytest.mark.parametrize(
    "values", [[1.0, 1.0, 1.0], [1.0, 1.0, 1e-3], [4.0, 4.0, 0.0], [1.0, 0.0, 0.0], [2.0, 1.0, 0.5]]
)
def test_the_symmetric_root(values: list[float]) -> None:
    """S S = Σ; the last place of Σ moves S by at most √(p·ε) (Powers and Størmer 1970), and by ε where no variance vanishes."""
    covariance = np.stack([repeated(np.random.default_rng(seed), values) for seed in range(20)])
    root = symmetric_root(covariance)
    assert np.abs(root @ root - covariance).max() < 1e-14
    assert np.abs(root - root.swapaxes(1, 2)).max() < 1e-14
    for towards in (-np.inf, np.inf):
        change = np.abs(symmetric_root(moved(covariance, towards)) - root).max()
        assert change < (1e-13 if min(values) > 0.0 else np.sqrt(3.0 * np.finfo(float).eps * max(values)) * 2.0)


def test_draws_have_the_covariance_of_the_root() -> None:
    """200,000 draws with two equal eigenvalues: each entry within five standard errors, √(2/n) of the largest variance."""
    covariance = repeated(np.random.default_rng(3), [9.0, 9.0, 0.25])
    draws = symmetric_root(covariance) @ np.random.default_rng(4).standard_normal((3, 200_000))
    assert np.abs(np.cov(draws) - covariance).max() < 5.0 * np.sqrt(2.0 / 200_000) * 9.0


def test_machines_drawn_from_a_calibration(dmu50: Machine) -> None:
    """Equal variances of all numbers: their correlation matrix has one eigenvalue only."""
    rng = np.random.default_rng(5)
    calibration = random_calibration(dmu50, rng, 20.0)
    names = tuple(p.name for effect in calibration.effects for p in effect.parameters)
    # Independent but for the last place.
    close = np.eye(len(names)) + np.finfo(float).eps * (lambda a: a + a.T)(
        rng.uniform(-1.0, 1.0, (len(names), len(names)))
    )
    drawn = [
        ToolUncertainty(
            Kinematics(dmu50, replace(calibration, joint=Covariance(names, read_only(matrix))), tool_length_mm=100.0)
        ).draw(np.random.default_rng(6), 50)
        for matrix in (np.eye(len(names)), close)
    ]
    assert np.abs(drawn[1] - drawn[0]).max() < ROUNDING


def test_a_simultaneous_band() -> None:
    shape = np.random.default_rng(9).standard_normal((50, 6))
    close = np.eye(6) + np.finfo(float).eps * repeated(np.random.default_rng(10), [1.0] * 5 + [9.0])
    turn = np.linalg.qr(np.random.default_rng(15).standard_normal((6, 6)))[0]  # another basis of the same functions
    for other in (simultaneous_factor(shape, close), simultaneous_factor(shape @ turn, np.eye(6))):
        assert other == pytest.approx(simultaneous_factor(shape, np.eye(6)), rel=ROUNDING)
    assert 1.96 < simultaneous_factor(shape, np.eye(6)) < np.sqrt(12.6) + 0.1  # between one point and Scheffé's χ²(6)


def test_null_directions_in_any_basis() -> None:
    """Three sums of three unknowns each are read: among equals, the first are named."""
    unknowns = [Unknown(f"p{i}", "", 1.0) for i in range(9)]
    jacobian = np.repeat(np.eye(3), 3, axis=1) * 1e6
    found = determinability(jacobian, unknowns)
    expected = [str(found.null_direction_of(f"p{i}")) for i in range(9)]
    for seed in range(5):
        turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((6, 6)))[0]
        spectrum = replace(found.spectrum, null_space=found.spectrum.null_space @ turn)
        other = replace(found, spectrum=spectrum)
        assert [str(other.null_direction_of(f"p{i}")) for i in range(9)] == expected
    assert expected[:3] == ["p0 +1 with p1 -1", "p1 +1 with p0 -1", "p2 +1 with p0 -1"]


def test_the_sign_of_a_direction() -> None:
    """The largest component is positive, of an eigenvector in a file and of a direction in a message."""
    covariance = repeated(np.random.default_rng(14), [5.0, 3.0, 2.0, 1.0])
    rows = _directions(covariance, np.ones(4))
    assert np.all(np.take_along_axis(rows, np.abs(rows).argmax(axis=1)[:, None], axis=1) > 0.0)
    assert np.abs(rows.T @ rows - covariance).max() < 0.05
    assert _direction(np.array([0.6, -0.8, 0.0])) == _direction(np.array([-0.6, 0.8, 0.0])) == "-0.60, 0.80, 0.00"


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_side_of_a_face_error_motion(sense: float, seed: int) -> None:
    """Positive where the angle rises anticlockwise, wherever the plane of the circle lies and however the turn is counted."""
    theta = np.arange(0.0, 360.0, 15.0)
    axial = 0.01 * np.cos(2.0 * np.radians(theta))
    turned = sense * np.radians(theta)
    frame = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    frame *= np.sign(np.linalg.det(frame))
    points = np.column_stack([100.0 * np.cos(turned), 100.0 * np.sin(turned), sense * axial]) @ frame.T
    assert _circle(points, theta)[2] == pytest.approx(axial, abs=1e-6)


def test_equally_informative_readings() -> None:
    """Every reading of a plan has a mirror image that is as good: the choice is the same, whatever the last place says."""
    rng = np.random.default_rng(11)
    rows = np.repeat(rng.normal(size=(30, 3, 6)), 2, axis=0)
    aim = LinearAim(rng.normal(size=(20, 3, 6)))
    first = np.random.default_rng(12).permutation(60)
    chosen = []
    for seed in range(6):
        off = 1.0 + 1e-15 * np.random.default_rng(seed).uniform(-1.0, 1.0, rows.shape)
        exchange = Exchange(np.eye(6), rows * off if seed else rows, np.ones(60), aim, most=1, among=60)
        chosen.append(exchange.choose(12, first, 3).tolist())
    assert all(one == chosen[0] for one in chosen)


def test_the_first_of_equals() -> None:
    assert first_largest(np.array([1.0, 3.0 - 1e-12, 3.0])) == 1
    assert first_largest(np.array([1.0, 2.0, 3.0])) == 2
    assert first_largest(np.array([-np.inf, -1.0, -1.0 + 1e-15])) == 1


# ---- two processors

FINGERPRINT = """
import hashlib, numpy
a = numpy.random.default_rng(0).uniform(-3.0, 3.0, (1000, 3))
print(hashlib.sha256(b"".join(x.tobytes() for x in (numpy.sin(a), numpy.exp(a), a @ a[:3], a.T @ a))).hexdigest())
"""
RUN = """
import sys
from twin.cli import main
for words in open(sys.argv[1]).read().splitlines():
    try:
        main(words.split())
    except SystemExit as ended:
        if ended.code not in (None, 0, 3):
            raise
"""
COMMANDS = """simulate plan.csv -o tracker.csv --seed 7
simulate plan.csv -o lengths.csv --seed 7 --instrument interferometer
simulate-run --layout nine_beams_x.yaml -o run.csv --positions 0,500,6 --rounds 1 --seed 7
compensate cone_frustum.nc -o frustum.nc --tool-length 120
plan -o planned.csv --minutes 30
identify tracker.csv -o mine.yaml --only E_X* --json identified.json
"""
TO_THE_LAST_DIGIT = ("tracker.csv", "lengths.csv", "run.csv", "frustum.nc", "planned.csv")
WITHIN_ROUNDING = ("identified.json",)
"""Written in full precision, from an iteration that ends when its steps are small: one in 10,000 is far below the uncertainty."""
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def other_processor() -> dict[str, str]:
    """Return the environment in which libraries take this processor for the simplest that they support.

    NumPy without the features that it dispatches on (AVX-512, AVX2, FMA), BLAS and the C library with the routines of a processor
    without them, compiled code without them.
    """
    core = np._core._multiarray_umath  # type: ignore[attr-defined]
    dispatched = [name for name in core.__cpu_dispatch__ if core.__cpu_features__.get(name)]
    found = {"NPY_DISABLE_CPU_FEATURES": " ".join(dispatched)} if dispatched else {}
    if platform.machine() in ("x86_64", "AMD64"):
        found["OPENBLAS_CORETYPE"] = "Nehalem"
        found["GLIBC_TUNABLES"] = "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"
        found["CXX"] = f"{os.environ.get('CXX') or 'c++'} -mno-avx512f -mno-avx2 -mno-fma"
    return found


def numbers_of(path: Path) -> tuple[str, np.ndarray]:
    """Return a file's text without its numbers, and the numbers."""
    text = path.read_text(encoding="utf-8")
    return NUMBER.sub("#", text), np.array([float(one) for one in NUMBER.findall(text)])


def test_another_processor_writes_the_same_files(dmu50: Machine, tmp_path: Path) -> None:
    """Simulated readings, programs and plans to the last digit; what is identified from them to 1e-4 of each number."""
    both = {"this": {}, "other": other_processor()}
    marks, plan = [], volumetric(dmu50, np.random.default_rng(13), 90, stations=2)
    for name, changed in both.items():
        folder = tmp_path / name
        folder.mkdir()
        plan.save(folder / "plan.csv", dmu50)
        (folder / "commands").write_text(COMMANDS, encoding="utf-8")
        environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), **changed}
        marks.append(
            subprocess.run([sys.executable, "-c", FINGERPRINT], env=environment, capture_output=True, check=True).stdout
        )
        subprocess.run(
            [sys.executable, "-c", RUN, "commands"], cwd=folder, env=environment, capture_output=True, check=True
        )
    if marks[0] == marks[1]:
        pytest.skip("the libraries of this computer have no second way to round")
    for name in TO_THE_LAST_DIGIT:
        assert (tmp_path / "this" / name).read_bytes() == (tmp_path / "other" / name).read_bytes(), name
    for name in WITHIN_ROUNDING:
        (words, first), (same, second) = (numbers_of(tmp_path / one / name) for one in both)
        assert words == same, name
        assert second == pytest.approx(first, rel=1e-4, abs=1e-6), name
