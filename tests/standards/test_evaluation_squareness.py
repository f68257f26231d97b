"""Squareness: its sign compared with rotated axes and with the machine model, its uncertainty with simulated data."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.standards.iso230_1 import SquarenessError, Straightness, squareness, straightness
from twin.tool.forward import Kinematics

PAIRS = {"E_C0Y": ("E_YX", "E_XY"), "E_B0Z": ("E_ZX", "E_XZ"), "E_A0Z": ("E_ZY", "E_YZ")}
SMALL = st.floats(-100.0, 100.0)


def rotation(vector_urad: tuple[float, float, float]) -> np.ndarray:
    """Return a rotation matrix by Rodrigues' formula."""
    vector = np.array(vector_urad) * 1e-6
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def between(name: str, path: dict[str, np.ndarray], u_um: float | None = None, **more: float) -> SquarenessError:
    """Return the squareness from points (n, 3) in mm of every axis's motion, measured by one instrument."""
    measured: list[Straightness] = []
    for motion in PAIRS[name]:
        along, across = "XYZ".index(motion[3]), "XYZ".index(motion[2])
        points = path[motion[3]]
        measured.append(straightness(points[:, along], points[:, across] * 1e3, name=motion, u_um=u_um))
    return squareness(measured[0], measured[1], **more)  # type: ignore[arg-type]


@given(c=SMALL, b=SMALL, a=SMALL, setup=st.tuples(SMALL, SMALL, SMALL))
def test_axes_turned_in_space(c: float, b: float, a: float, setup: tuple[float, float, float]) -> None:
    """Axis directions rotated right-handed, measured by a tilted instrument: the squarenesses are found."""
    directions = {
        "X": np.array([1.0, 0.0, 0.0]),
        "Y": rotation((0.0, 0.0, c)) @ [0.0, 1.0, 0.0],
        "Z": rotation((a, b, 0.0)) @ [0.0, 0.0, 1.0],
    }
    askew = rotation(setup)
    travel = np.linspace(0.0, 400.0, 9)[:, None]
    path = {axis: travel * (askew @ direction) for axis, direction in directions.items()}
    for name, expected in (("E_C0Y", c), ("E_B0Z", b), ("E_A0Z", a)):
        # Small angles: neglected are products of two of them, at most some 10 × 1e-4 × 1e-4 rad = 0.1 µrad.
        assert between(name, path).value_urad == pytest.approx(expected, abs=0.1)


def test_the_machine_model_has_the_same_sign(dmu50: Machine) -> None:
    """The tool in the table's frame while one axis moves: the evaluation gives the model's squareness."""
    put = {"E_C0Y": 40.0, "E_B0Z": -25.0, "E_A0Z": 60.0}
    calibration = replace(Calibration.zero(dmu50), squareness=MappingProxyType(put))
    model = Kinematics(dmu50, calibration, tool_length_mm=0.0)
    names = [axis.name for axis in dmu50.axes]
    path = {}
    for axis in "XYZ":
        at = names.index(axis)
        q = np.tile([250.0 if n == "X" else 225.0 if n == "Y" else -200.0 if n == "Z" else 0.0 for n in names], (7, 1))
        q[:, at] = np.linspace(dmu50.axes[at].lower or 0.0, dmu50.axes[at].upper or 0.0, 7)
        path[axis] = model.forward(q).point_mm
    for name, value in put.items():
        assert between(name, path).value_urad == pytest.approx(value, abs=0.01)  # products of two: 60² × 1e-6 µrad


def curves(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    path = {}
    for i, axis in enumerate("XYZ"):
        points = rng.normal(0.0, 0.002, (11, 3))
        points[:, i] = np.linspace(0.0, 500.0, 11)
        path[axis] = points
    return path


def test_uncertainty_is_the_spread_over_many_measurements() -> None:
    rng = np.random.default_rng(2301)
    path, u_um, draws = curves(1), 0.8, 1500
    stated = between("E_C0Y", path, u_um)
    values = []
    for _ in range(draws):
        noisy = {axis: points + rng.normal(0.0, u_um * 1e-3, points.shape) for axis, points in path.items()}
        # The axis's position is not what is uncertain.
        for i, axis in enumerate("XYZ"):
            noisy[axis][:, i] = path[axis][:, i]
        values.append(between("E_C0Y", noisy).value_urad)
    assert stated.u_urad is not None
    # The spread of 1500 draws is known to 1/√3000 = 1.8 %; four times that.
    assert np.std(values, ddof=1) == pytest.approx(stated.u_urad, rel=0.073)
    assert np.mean(values) == pytest.approx(stated.value_urad, abs=4.0 * stated.u_urad / np.sqrt(draws))
    alone = [line.u_slope_urad for line in (straightness(path["X"][:, 0], path["X"][:, 1], u_um=u_um).least_squares,)]
    assert stated.u_urad == pytest.approx(np.sqrt(2.0) * alone[0], rel=1e-12)  # both axes have the same positions


def test_every_kind_of_line() -> None:
    path = curves(3)
    datum, other = (
        straightness(path[n[3]][:, "XYZ".index(n[3])], path[n[3]][:, "XYZ".index(n[2])] * 1e3, name=n)
        for n in PAIRS["E_A0Z"]
    )
    for i, kind in enumerate(("least squares", "end point", "minimum zone")):
        found = squareness(datum, other, line=kind)  # type: ignore[arg-type]
        slopes = (datum.lines[i].slope_urad, other.lines[i].slope_urad)
        assert (found.datum_slope_urad, found.slope_urad) == slopes
        assert found.value_urad == -sum(slopes)
        assert (found.name, found.u_urad, found.line) == ("E_A0Z", None, kind)


@pytest.mark.parametrize(
    ("first", "second", "more", "words"),
    [
        ("E_XY", "E_YX", {}, "datum axis first"),
        ("E_YX", "E_XZ", {}, "E_YX and E_XY"),
        ("", "", {}, "one plane"),
        ("E_YX", "E_XY", {"line": "middle"}, "least squares, end point, minimum zone"),
    ],
)
def test_bad_input(first: str, second: str, more: dict[str, float], words: str) -> None:
    datum, other = (straightness([0, 1, 2], [0, 1, 0], name=name) for name in (first, second))
    with pytest.raises(InputError, match=words):
        squareness(datum, other, **more)  # type: ignore[arg-type]
