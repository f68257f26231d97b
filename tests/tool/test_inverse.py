"""Inverse kinematics with errors: exact where possible, with a status elsewhere, and never an exception within a batch."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.model.errors import random_calibration
from tests.tool.test_kinematics import random_commands
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.tool.forward import Kinematics, Poses
from twin.tool.inverse import Branches, Inverse, Status, Steps, _bounded_move

POSES = 10_000


def inner_commands(machine: Machine, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return random commands far enough from the limits of linear axes for a correction of some mm."""
    q = random_commands(machine, n, rng)
    for i in machine.linear:
        axis = machine.axes[i]
        assert axis.lower is not None and axis.upper is not None
        q[:, i] = np.clip(q[:, i], axis.lower + 8.0, axis.upper - 8.0)
    return q


def test_reaches_ten_thousand_poses(dmu50: Machine) -> None:
    """Errors to 1 mm and 1 mrad: every pose converges except near B = 0 and B = 180°, where C or B cannot correct."""
    rng = np.random.default_rng(11)
    real = Kinematics(dmu50, random_calibration(dmu50, rng), tool_length_mm=100.0)
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=100.0)
    q = inner_commands(dmu50, POSES, rng)
    target = nominal.forward(q)
    solution = Inverse(real).solve(target, q)
    converged, singular = solution.where(Status.CONVERGED), solution.where(Status.SINGULAR)
    assert np.all(converged | singular)
    assert solution.point_residual_mm.max() <= 1e-9
    assert solution.orientation_residual_rad[converged].max() <= 1e-12
    # 1 mrad over sin(tilt) is within 0.5 degrees once the tilt passes some 10 degrees, B some 15.
    assert np.all(np.minimum(q[singular, 3], 180.0 - q[singular, 3]) < 30.0)
    again = real.forward(solution.positions[converged])
    assert np.abs(again.point_mm - target.point_mm[converged]).max() <= 1e-9
    assert np.abs(solution.positions - q)[:, 3:].max() <= 0.5 + 1e-9


@pytest.mark.parametrize("name", ["dmu50", "trunnion_ac", "xyzbc_trunnion"])
def test_a_step_has_the_derivatives_of_the_residual(name: str) -> None:
    """Matrices of Newton's step, from twists, compared with central differences of the residual in `check`, which uses no derivatives.

    They are compared at the solution, where the residual is zero and its derivatives are those of the step. `twin.tool.inverse`
    omits the second term of Exp's derivative, an angular error (to 1 mrad here) times a slope (to 20 mrad per radian): 1e-5 of an
    axis's motion.
    """
    machine = Machine.load(name)
    rng = np.random.default_rng(17)
    real = Kinematics(machine, random_calibration(machine, rng), tool_length_mm=150.0)
    steps = Steps(real, 0.01)
    linear, rotary = list(machine.linear), list(machine.rotary)
    for q in inner_commands(machine, 20, rng) * machine.scale:
        pose = real.forward(q / machine.scale)
        point, axis = pose.point_mm[0] * 1e-3, pose.axis[0]

        def left(at: np.ndarray, point: np.ndarray = point, axis: np.ndarray = axis) -> np.ndarray:
            """Return tip less goal, and the tool axis perpendicular to the target, at one position."""
            found = steps.check(at, point, axis)
            return np.concatenate([np.array(found[4]).ravel(), np.array(found[5]).ravel()])

        by = np.stack([(left(q + h) - left(q - h)) / 2e-6 for h in 1e-6 * np.eye(len(q))], axis=1)
        flat, matrices = np.array(steps.turn(q, point, axis)[2]).ravel(), []
        for shape in ((3, 3), (3, len(rotary)), (2, 3), (len(rotary), 2)):
            matrices.append(flat[: np.prod(shape)].reshape(shape, order="F"))
            flat = flat[np.prod(shape) :]
        inverse, slope, coupling, turns = matrices
        np.testing.assert_allclose(inverse @ by[:3, linear], np.eye(3), atol=3e-5)
        np.testing.assert_allclose(inverse @ by[:3, rotary], slope, atol=3e-5)
        np.testing.assert_allclose(by[3:, linear], coupling, atol=3e-5)
        system = by[3:, rotary] - coupling @ slope
        np.testing.assert_allclose(turns @ system @ turns, turns, atol=3e-4 * np.abs(turns).max() ** 2)


@pytest.mark.parametrize("axes", [1, 2])
def test_a_limited_correction_against_the_singular_value_decomposition(axes: int) -> None:
    """Each singular direction in full up to the limit, beyond it less by the cube; nothing without influence."""
    rng = np.random.default_rng(18)
    for _ in range(60):
        matrix, right, limit = rng.normal(size=(2, axes)), rng.normal(size=2), rng.uniform(0.1, 1.0)
        matrix[:, 0] *= rng.choice([1.0, 1e-3, 0.0])
        left, sizes, directions = np.linalg.svd(matrix, full_matrices=False)
        wanted = np.zeros(axes)
        for u, sigma, v in zip(left.T, sizes, directions, strict=True):
            if sigma > 1e-12:
                move = -float(u @ right) / sigma
                wanted += v * (move if abs(move) <= limit else limit * (limit / move) ** 3)
        found = np.array(ca.DM(_bounded_move(ca.SX(matrix), ca.SX(right), limit))).ravel()
        assert found == pytest.approx(wanted, abs=1e-9)


def test_linear_axes_only_keep_the_rotary_positions(dmu50: Machine) -> None:
    rng = np.random.default_rng(12)
    real = Kinematics(dmu50, random_calibration(dmu50, rng))
    q = inner_commands(dmu50, 2000, rng)
    target = Kinematics(dmu50, Calibration.zero(dmu50)).forward(q)
    solution = Inverse(real).solve(target, q, rotary=False)
    assert np.all(solution.where(Status.CONVERGED))
    assert np.array_equal(solution.positions[:, 3:], q[:, 3:] * dmu50.scale[3:] / dmu50.scale[3:])
    assert solution.point_residual_mm.max() <= 1e-9
    # Alone they have a solver of their own, with only the functions of the linear axes; beside other poses they have not.
    moves = np.arange(len(q)) == 7
    mixed = Inverse(real).solve(target, q, rotary=moves)
    assert np.array_equal(mixed.positions[~moves], solution.positions[~moves])
    assert np.array_equal(mixed.code[~moves], solution.code[~moves])


@given(seed=st.integers(0, 2**32 - 1), b=st.floats(3.0, 177.0), c=st.floats(-720.0, 720.0))
def test_forward_undoes_inverse(dmu50: Machine, seed: int, b: float, c: float) -> None:
    rng = np.random.default_rng(seed)
    real = Kinematics(dmu50, random_calibration(dmu50, rng, size=50.0), tool_length_mm=50.0)
    q = inner_commands(dmu50, 1, rng)
    q[0, 3:] = b, c
    reached = real.forward(q)
    nearby = q + np.array([0.1, -0.1, 0.1, 0.02, -0.02])
    solution = Inverse(real).solve(reached, nearby)
    assert solution.status[0] is Status.CONVERGED
    assert np.abs(solution.positions - q).max() <= 1e-8  # the tool axis holds C by sin(tilt) ≥ 0.037 at 1e-12 rad


def test_c_stays_continuous_through_the_singularity(dmu50: Machine, calibration: Calibration) -> None:
    """B down to 0 and up again: the correction of C is bounded, vanishes at B = 0, and never jumps."""
    real = Kinematics(dmu50, calibration, tool_length_mm=100.0)
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=100.0)
    b = np.abs(np.linspace(-8.0, 8.0, 3201))
    q = np.column_stack([np.tile([250.0, 225.0, -200.0], (len(b), 1)), b, np.linspace(20.0, 30.0, len(b))])
    limit = 0.3
    solution = Inverse(real, rotary_limit_deg=limit).solve(nominal.forward(q), q)
    correction = solution.positions[:, 4] - q[:, 4]
    assert np.abs(correction).max() <= limit + 1e-9
    assert np.abs(np.diff(correction)).max() <= 0.05 * limit  # steps of 0.005° in B
    at_zero = np.argmin(b)
    assert abs(correction[at_zero]) <= 0.01 * limit
    assert solution.status[at_zero] is Status.SINGULAR
    assert solution.orientation_residual_rad[at_zero] > 0.0
    assert solution.point_residual_mm.max() <= 1e-9
    assert np.all(solution.positions[:, 3] >= 0.0)
    assert solution.status[0] is Status.CONVERGED


def test_statuses_not_exceptions(dmu50: Machine, calibration: Calibration) -> None:
    inverse = Inverse(Kinematics(dmu50, calibration))
    q = np.array([[250.0, 225.0, -200.0, 40.0, 10.0]] * 4)
    good = Kinematics(dmu50, Calibration.zero(dmu50)).forward(q)
    point = good.point_mm.copy()
    point[1] = np.nan
    point[2] += [900.0, 0.0, 0.0]
    start = q.copy()
    start[3, 0] = np.inf
    solution = inverse.solve(Poses(point, good.rotation), start)
    assert [status.value for status in solution.status] == ["converged", "out of range", "out of range", "out of range"]
    assert np.isinf(solution.point_residual_mm[1])
    with pytest.raises(InputError, match="start"):
        inverse.solve(good, q[:, :3])


def test_one_pose_or_many_give_the_same(dmu50: Machine, calibration: Calibration) -> None:
    """Chunks and padding change no bit of the result."""
    rng = np.random.default_rng(13)
    real = Kinematics(dmu50, calibration)
    q = inner_commands(dmu50, 1500, rng)
    many = real.forward(q)
    for i in (0, 1023, 1024, 1499):
        one = real.forward(q[i])
        assert np.array_equal(one.point_mm[0], many.point_mm[i])


def test_branches_of_the_dmu50(dmu50: Machine) -> None:
    """Both solutions point the tool the same way; the nearest one in range is found, whole turns of C included."""
    nominal = Kinematics(dmu50, Calibration.zero(dmu50))
    branches = Branches(nominal)
    rng = np.random.default_rng(14)
    q = inner_commands(dmu50, 500, rng)
    axis = nominal.forward(q).axis
    solutions = branches.all(axis)
    for k in range(2):
        both = q.copy()
        both[:, 3:] = solutions[:, k]
        # Near B = 0 the closed form loses half its digits: it is a start for Newton, not an answer.
        assert np.abs(nominal.forward(both).axis - axis).max() <= 1e-7
    found = branches.nearest(solutions, q[:, 3:] + [0.3, -0.3])
    assert np.abs(found - q[:, 3:]).max() <= 1e-6


def test_upright_tool_keeps_c(dmu50: Machine) -> None:
    branches = Branches(Kinematics(dmu50, Calibration.zero(dmu50)))
    upright = branches.all(np.array([[0.0, 0.0, 1.0]]))
    (found,) = branches.nearest(upright, np.array([[10.0, 417.0]]))
    assert found == pytest.approx([0.0, 417.0], abs=1e-6)
    below = branches.all(np.array([[0.0, 0.6, -0.8]]))
    assert np.isnan(branches.nearest(below, np.zeros((1, 2)))).all()


def test_both_branches_exist_and_each_is_kept() -> None:
    """On a trunnion whose B tilts both ways every pose has two solutions; the solver stays on the branch of its start."""
    machine = Machine.load("xyzbc_trunnion")
    rng = np.random.default_rng(15)
    real = Kinematics(machine, random_calibration(machine, rng, size=100.0), tool_length_mm=60.0)
    nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=60.0)
    branches = Branches(nominal)
    rotary, linear = list(machine.rotary), list(machine.linear)
    q = np.zeros((300, 5))
    q[:, linear] = rng.uniform([-60, -60, 140], [60, 60, 260], (300, 3))
    q[:, rotary] = np.column_stack([rng.uniform(20, 60, 300) * rng.choice([-1, 1], 300), rng.uniform(-170, 170, 300)])
    target = nominal.forward(q)
    solutions = branches.all(target.axis)
    for k in range(2):
        start = q.copy()
        start[:, rotary] = solutions[:, k]
        # The same point with the rotary axes on this branch: the nominal linear axes for it.
        start = Inverse(nominal).solve(target, start, rotary=False).positions.copy()
        solution = Inverse(real).solve(target, start)
        inside = (
            (start >= machine.limits[:, 0] / machine.scale) & (start <= machine.limits[:, 1] / machine.scale)
        ).all(axis=1)
        assert np.count_nonzero(inside) > 50
        assert np.all(solution.where(Status.CONVERGED)[inside])
        assert np.abs(solution.positions - start)[inside][:, rotary].max() < 0.5
        assert np.abs(real.forward(solution.positions[inside]).point_mm - target.point_mm[inside]).max() <= 1e-9
    apart = np.abs(solutions[:, 0, 0] - solutions[:, 1, 0])
    assert apart.min() > 30.0


@pytest.mark.parametrize("name", ["dmu50", "xyzbc_trunnion"])
@pytest.mark.parametrize("window", [1, 3, 64])
def test_positions_along_a_path_are_those_found_one_by_one(
    name: str, window: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Turns of C, the pole, jumps to the other branch, and a vector without a solution."""
    monkeypatch.setattr("twin.tool.inverse.FIRST_WINDOW", window)
    machine = Machine.load(name)
    branches = Branches(Kinematics(machine, Calibration.zero(machine)))
    rng = np.random.default_rng(16)
    for spread in (0.02, 0.5, 3.0):
        tilt, turn = np.abs(np.cumsum(rng.normal(0, spread * 0.2, 300))) % 1.2, np.cumsum(rng.normal(0.1, spread, 300))
        tilt[100:110] = 0.0
        axis = np.column_stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        axis[280] = [0.0, 0.6, -0.8]
        solutions, offset = branches.all(axis), np.array([0.0, 12.5])
        found, before = [], np.array([3.0, 400.0])
        for solution in solutions:
            (there,) = branches.nearest(solution[None], (before + offset)[None]) - offset
            if np.isnan(there).any():
                break
            before = there
            found.append(before)
        assert len(found) == 280
        np.testing.assert_array_equal(branches.along(solutions, np.array([3.0, 400.0]), offset), found)


@pytest.mark.parametrize("c_range", ["unlimited", "[-185, 185]", "[-30, 700]"])
def test_the_nearest_position_has_the_smallest_largest_travel(c_range: str, tmp_path: Path) -> None:
    """Compare with all solutions and whole turns within the ranges, by the larger of the two axes' travels, not their sum."""
    source = Machine.load("xyzbc_trunnion")
    text = source.path.read_text().replace("range: unlimited", f"range: {c_range}")
    (tmp_path / "m.yaml").write_text(text.replace("urdf: xyzbc_trunnion.urdf", f"urdf: {source.urdf}"))
    machine = Machine.load(tmp_path / "m.yaml")
    branches = Branches(Kinematics(machine, Calibration.zero(machine)))
    rng = np.random.default_rng(17)
    tilt, turn = rng.uniform(0.05, 0.6, 400), rng.uniform(-np.pi, np.pi, 400)
    axis = np.column_stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    solutions = branches.all(axis)
    before = np.column_stack([rng.uniform(-30.0, 30.0, 400), rng.uniform(-700.0, 700.0, 400)])
    limits = (machine.limits / machine.scale[:, None])[list(machine.rotary)]
    turns = 360.0 * np.arange(-4, 5)
    candidates = np.stack([(solutions[:, k] + [0.0, turn]) for k in (0, 1) for turn in turns], axis=1)
    travel = np.abs(candidates - before[:, None, :])
    within = ((candidates >= limits[:, 0] - 1e-6) & (candidates <= limits[:, 1] + 1e-6)).all(axis=2)
    largest = np.where(within, travel.max(axis=2), np.inf)
    found = branches.nearest(solutions, before)
    assert np.abs(found - before).max(axis=1) == pytest.approx(largest.min(axis=1), abs=1e-9)
    by_sum = np.where(within, travel.sum(axis=2), np.inf)
    assert np.count_nonzero(by_sum.argmin(axis=1) != largest.argmin(axis=1)) > 2  # the two rules differ
