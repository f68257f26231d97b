"""Compiled code compared with NumPy, Pinocchio and the C library; the cache of libraries and its checks."""

from __future__ import annotations

import ctypes
import dataclasses
import math
import os
import platform
import stat
import subprocess
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from tests.model.errors import random_calibration
from tests.tool.test_kinematics import random_commands
from twin.compute import along as batch
from twin.compute.native import compiler, solver
from twin.compute.native.compiler import Compiler, CompilerError, solver_description
from twin.compute.native.solver import Batch, BatchOutcome, InverseProblem, NumpySolver, Solver
from twin.compute.native.tape import Tape, UnknownOperationError
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects import Reversal
from twin.tool.forward import Kinematics, Poses
from twin.tool.inverse import Inverse, Solution, Status

TINY = 'extern "C" int answer() { return 42; }\n'

compiled = pytest.mark.skipif(compiler.find_compiler() is None, reason="no C++ compiler here")


@pytest.fixture(scope="session")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return one cache for all tests that only solve."""
    return tmp_path_factory.mktemp("cache")


def spoilt(rows: int, axes: int) -> BatchOutcome:
    return BatchOutcome(
        np.full((rows, axes), 7e7), np.full(rows, 7e7), np.full(rows, 7e7), np.full(rows, 77, np.uint8), 0
    )


@pytest.fixture
def eager(libraries: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile for any number of poses."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(libraries))
    monkeypatch.delenv(compiler.SWITCH_VARIABLE, raising=False)
    monkeypatch.setattr(compiler, "WORTH_COMPILING", 0)
    monkeypatch.setattr(compiler, "_failed", {})
    # Fill the result arrays with invalid values: fresh memory is full of zeros, and zero means converged.
    monkeypatch.setattr(BatchOutcome, "empty", staticmethod(spoilt))


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a cache folder of the test's own, which does not exist yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    return tmp_path / "home" / "twin"


def hard(machine: Machine, nominal: Kinematics, n: int, rng: np.random.Generator) -> tuple[Poses, np.ndarray]:
    """Return poses over the whole range, at its limits and near singularities, some not finite or far too large."""
    q = random_commands(machine, n, rng)
    limits = machine.limits / machine.scale[:, None]
    for k, axis in enumerate(np.flatnonzero(np.isfinite(limits[:, 0]))):
        q[2 * k * 20 : (2 * k + 1) * 20, axis], q[(2 * k + 1) * 20 : (2 * k + 2) * 20, axis] = limits[axis]
    for axis in machine.rotary:
        # Zero is where the rotary axes' own singularities lie on all three machines.
        inside = np.clip(rng.normal(size=n // 20) * 0.1, *limits[axis])
        q[rng.choice(np.arange(n // 4, n // 2), n // 20, replace=False), axis] = inside
    found = nominal.forward(q)
    point, rotation, start = found.point_mm.copy(), found.rotation.copy(), q.copy()
    point[n - 1, 0], point[n - 2, 2], rotation[n - 3, 1, 2], start[n - 4, 0], start[n - 5, 1] = (
        np.nan, np.inf, np.nan, -np.inf, np.nan,
    )  # fmt: skip
    rotation[n - 6] = 0.0
    point[n - 7] += 900.0
    if machine.rotary:
        start[n - 8, machine.rotary[-1]] += 360.0 * 20_000
    return Poses(point, rotation), start


def both(inverse: Inverse, target: Poses, start: np.ndarray, **given: object) -> tuple[Solution, Solution]:
    """Return the solutions by compiled code and without it."""
    fast = inverse.solve(target, start, **given)  # type: ignore[arg-type]
    assert inverse._solver._native is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(compiler.SWITCH_VARIABLE, "0")
        again = Inverse(inverse.kinematics, rotary_limit_deg=inverse.rotary_limit_deg)
        return fast, again.solve(target, start, **given)  # type: ignore[arg-type]


def assert_alike(fast: Solution, plain: Solution) -> None:
    assert np.array_equal(fast.status, plain.status)
    assert np.array_equal(np.isnan(fast.positions), np.isnan(plain.positions))
    assert np.array_equal(np.isinf(fast.point_residual_mm), np.isinf(plain.point_residual_mm))
    there = np.isfinite(plain.point_residual_mm) & (plain.point_residual_mm < 1.0)
    # Tolerance in mm and degrees; both stop within a tenth of it. At a singularity differences are magnified: both reach the target to
    # 1e-12 mm, and one pose in a million differs by 2.5e-9 mm.
    promise = np.where(plain.where(Status.SINGULAR), 1e-8, 1e-9)[:, None]
    assert np.nanmax((np.abs(fast.positions - plain.positions) / promise)[there]) <= 1.0
    assert np.abs(fast.orientation_residual_rad[there] - plain.orientation_residual_rad[there]).max() <= 1e-12
    good = fast.where(Status.CONVERGED) | fast.where(Status.SINGULAR)
    assert fast.point_residual_mm[good].max() <= 2e-9


@pytest.mark.slow
@compiled
@pytest.mark.usefixtures("eager")
@pytest.mark.parametrize("name", ["dmu50", "trunnion_ac", "xyzbc_trunnion"])
def test_compiled_and_plain_give_the_same(name: str) -> None:
    """Compare every status and every position, on all machines, with all kinds of numbers."""
    machine = Machine.load(name)
    rng = np.random.default_rng(21)
    nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=80.0)
    inverse = Inverse(Kinematics(machine, random_calibration(machine, rng), tool_length_mm=80.0))
    target, start = hard(machine, nominal, 6000, rng)
    for rotary in (True, False, rng.uniform(size=6000) < 0.5):
        fast, plain = both(inverse, target, start, rotary=rotary)
        assert_alike(fast, plain)
    assert all(np.any(plain.where(status)) for status in Status)
    assert np.all(plain.where(Status.OUT_OF_RANGE)[-7:])


@compiled
@pytest.mark.usefixtures("eager")
def test_no_pose_is_lost(dmu50: Machine, calibration: Calibration) -> None:
    """Poses of a block finish early, late or not at all; `spoilt` reveals outputs that were never written."""
    rng = np.random.default_rng(35)
    q = random_commands(dmu50, 600_000, rng)
    target = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=100.0).forward(q)
    found = Inverse(Kinematics(dmu50, calibration, tool_length_mm=100.0)).solve(target, q)
    assert found.point_residual_mm.max() <= 2e-9
    # Half a degree of C at the far corner of the table is 3 mm.
    assert np.abs(found.positions - q).max() < 5.0
    assert 0.02 < np.mean(found.where(Status.SINGULAR)) < 0.06


@compiled
@pytest.mark.slow
@pytest.mark.usefixtures("eager")
def test_a_million_poses_are_the_same(dmu50: Machine, calibration: Calibration) -> None:
    rng = np.random.default_rng(22)
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=100.0)
    target, start = hard(dmu50, nominal, 1_000_000, rng)
    assert_alike(*both(Inverse(Kinematics(dmu50, calibration, tool_length_mm=100.0)), target, start))


@compiled
@pytest.mark.usefixtures("eager")
def test_pinocchio_confirms(dmu50: Machine, calibration: Calibration) -> None:
    """Pinocchio's kinematics at the compiled commands gives the targets."""
    rng = np.random.default_rng(23)
    real = Kinematics(dmu50, calibration, tool_length_mm=100.0)
    q = random_commands(dmu50, 500, rng)
    target = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=100.0).forward(q)
    inverse = Inverse(real)
    found = inverse.solve(target, q)
    assert inverse._solver._native is not None
    data = dmu50.model.createData()
    for i in np.flatnonzero(found.where(Status.CONVERGED)):
        errors = real.error_frames(found.positions[i])[0]
        pin.framesForwardKinematics(dmu50.model, data, dmu50.configuration(found.positions[i] * dmu50.scale, errors))
        pose = data.oMf[dmu50.work_frame].actInv(data.oMf[dmu50.tool_frame])
        point = (pose.translation - 0.1 * pose.rotation[:, 2]) * 1e3
        assert np.abs(point - target.point_mm[i]).max() <= 1e-9
        assert np.abs(pose.rotation[:, 2] - target.axis[i]).max() <= 1e-12


@compiled
@pytest.mark.usefixtures("eager")
def test_one_pose_many_poses_and_threads_give_the_same_bits(dmu50: Machine, calibration: Calibration) -> None:
    n = compiler.PORTION + 3001
    rng = np.random.default_rng(24)
    target, start = hard(dmu50, Kinematics(dmu50, Calibration.zero(dmu50)), n, rng)
    inverse = Inverse(Kinematics(dmu50, calibration))
    many = inverse.solve(target, start)
    for rows in (slice(0, 1), slice(5, 8), slice(1023, 1026), slice(n // 4, n // 2), slice(n - 9, n)):
        few = inverse.solve(Poses(target.point_mm[rows], target.rotation[rows]), start[rows])
        assert np.array_equal(few.positions, many.positions[rows], equal_nan=True)
        assert np.array_equal(few.status, many.status[rows])
    assert len(inverse.solve(Poses(target.point_mm[:0], target.rotation[:0]), start[:0]).status) == 0


@compiled
@pytest.mark.usefixtures("eager")
def test_arrays_of_any_make(dmu50: Machine, calibration: Calibration) -> None:
    """Column-major, strided and single-precision arrays are read correctly."""
    rng = np.random.default_rng(25)
    target, start = hard(dmu50, Kinematics(dmu50, Calibration.zero(dmu50)), 400, rng)
    inverse = Inverse(Kinematics(dmu50, calibration))
    plain = inverse.solve(target, start)
    odd = inverse.solve(
        Poses(np.asfortranarray(target.point_mm), np.asfortranarray(target.rotation)),
        np.repeat(np.asfortranarray(start), 2, axis=0)[::2],
    )
    assert np.array_equal(plain.positions, odd.positions, equal_nan=True)
    rough = inverse.solve(target, start.astype(np.float32).astype(float))
    assert np.nanmax(np.abs(rough.positions - plain.positions)[rough.where(Status.CONVERGED)]) <= 1e-8


@pytest.mark.slow
@compiled
@pytest.mark.usefixtures("eager")
def test_a_directed_machine(dmu50: Machine, calibration: Calibration) -> None:
    rng = np.random.default_rng(26)
    directed = dataclasses.replace(calibration, extra=(Reversal(dmu50.by_name["Y"], 6.0),))
    inverse = Inverse(Kinematics(dmu50, directed))
    target, start = hard(dmu50, Kinematics(dmu50, Calibration.zero(dmu50)), 2000, rng)
    sides = rng.integers(-1, 2, start.shape).astype(float)
    fast, plain = both(inverse, target, start, approach=sides)
    assert_alike(fast, plain)
    # With the rotary axes fixed, Y alone compensates half of the reversal, to the product of two small numbers.
    known, unknown = (inverse.solve(target, start, rotary=False, approach=side) for side in (sides, None))
    good = known.where(Status.CONVERGED) & unknown.where(Status.CONVERGED)
    assert known.positions[good, 1] - unknown.positions[good, 1] == pytest.approx(-0.003 * sides[good, 1], abs=2e-5)


@pytest.fixture(params=[NumpySolver, pytest.param(Solver, marks=compiled)])
def solve(request: pytest.FixtureRequest, eager: None) -> Callable[[InverseProblem, Batch], BatchOutcome]:
    """Return a function that solves with NumPy or with compiled code."""

    def solved(problem: InverseProblem, batch: Batch) -> BatchOutcome:
        chosen = request.param(problem)
        outcome = chosen.solve(batch)
        assert isinstance(chosen, NumpySolver) or chosen._native is not None
        return outcome

    return solved


def tilted(dmu50: Machine, calibration: Calibration) -> tuple[InverseProblem, Batch]:
    """Return the problem of a machine with errors, and nominal poses with B = 40° that start at their own commands."""
    inverse = Inverse(Kinematics(dmu50, calibration, tool_length_mm=100.0))
    q = np.array([[250.0, 225.0, -200.0, 40.0, c] for c in np.linspace(0.0, 350.0, 64)])
    target = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=100.0).forward(q)
    return inverse._solver.problem, Batch(q, target.point_mm, target.axis, None, np.full(len(q), True))


def test_a_pose_farther_than_the_tolerance_is_not_called_reached(
    dmu50: Machine, calibration: Calibration, solve: Callable[[InverseProblem, Batch], BatchOutcome]
) -> None:
    """A tolerance finer than rounding is missed by many poses inside every range; each of them says so."""
    problem, batch = tilted(dmu50, calibration)
    fine = dataclasses.replace(problem, tolerance=1e-17)
    found = solve(fine, batch)
    missed = found.distance * problem.mm > 2.0 * fine.tolerance
    assert missed.sum() > len(missed) / 2 and found.distance.max() < 1e-9
    assert np.array_equal(found.code == solver.OUT_OF_RANGE, missed)


@pytest.mark.parametrize("side", [0, 1])
def test_a_rotary_axis_stops_at_its_limit(
    dmu50: Machine, calibration: Calibration, side: int, solve: Callable[[InverseProblem, Batch], BatchOutcome]
) -> None:
    """The whole orientation lies behind the limit: the axis stays before it, and the linear axes reach the point."""
    problem, batch = tilted(dmu50, calibration)
    free = solve(problem, batch)
    assert np.all(free.code == solver.CONVERGED)
    b = free.positions[:, 3]
    middle, outward = float(np.median(b)), 2 * side - 1
    limits = problem.limits.copy()
    limits[0, side] = np.radians(middle)
    beyond = outward * b > outward * middle
    assert 0 < beyond.sum() < len(b)
    start = batch.start.copy()
    start[:, 3] = middle - outward * 0.01
    found = solve(dataclasses.replace(problem, limits=limits), dataclasses.replace(batch, start=start))
    assert np.array_equal(found.code == solver.SINGULAR, beyond)
    assert found.positions[~beyond] == pytest.approx(free.positions[~beyond], abs=1e-8)
    assert found.distance.max() <= 2e-9


@compiled
@pytest.mark.usefixtures("eager")
def test_other_numbers_need_no_other_code(dmu50: Machine) -> None:
    """A calibration with curves of the same orders, another tool and another limit are solved by the same library."""
    rng = np.random.default_rng(27)
    sources = set()
    for length, limit in ((0.0, 0.5), (80.0, 0.2)):
        real = Kinematics(dmu50, random_calibration(dmu50, rng), tool_length_mm=80.0 + length)
        sources.add(Inverse(real, rotary_limit_deg=limit)._solver._source)
    assert len(sources) == 1


@compiled
def test_sine_and_cosine(cache: Path) -> None:
    """Compare with Python's, over small, ordinary and the largest angles: within two roundings of one."""
    tool = compiler.find_compiler()
    assert tool is not None
    source = (Path(solver.__file__).parent / "simd.hpp").read_text() + (
        'extern "C" void run(long n, const double *x, double *s, double *c, double *f) { for (long i = 0; i < n; i += W) {'
        "V v; __builtin_memcpy(&v, x + i, sizeof v); Turn t = sincos(v); V w = vfloor(v);"
        "__builtin_memcpy(s + i, &t.s, sizeof v); __builtin_memcpy(c + i, &t.c, sizeof v);"
        "__builtin_memcpy(f + i, &w, sizeof v); } }"
    )
    rng = np.random.default_rng(28)
    x = np.concatenate(
        [rng.uniform(-r, r, 4000) for r in (1e-8, 1.0, 10.0, 1e5, 1.6e6)]
        + [np.arange(-400, 400) * (math.pi / 4.0), np.arange(-100.0, 100.0), np.full(8, np.nan), np.full(8, np.inf)]
    )
    s, c, f = np.empty_like(x), np.empty_like(x), np.empty_like(x)
    library = compiler.stored_library(source, tool)
    library.run(ctypes.c_long(len(x)), *(ctypes.c_void_p(a.ctypes.data) for a in (x, s, c, f)))
    there = np.isfinite(x)
    assert np.abs(s - [math.sin(v) if math.isfinite(v) else math.nan for v in x])[there].max() <= 2.3e-16
    assert np.abs(c - [math.cos(v) if math.isfinite(v) else math.nan for v in x])[there].max() <= 2.3e-16
    assert np.array_equal(f[there], np.floor(x[there]))
    assert np.all(np.isnan(s[~there])) and np.all(np.isnan(c[~there]))


@compiled
def test_arcsine_and_arctangent(cache: Path) -> None:
    """Compare with the C library's, over small and large arguments: within two roundings."""
    tool = compiler.find_compiler()
    assert tool is not None
    source = (Path(solver.__file__).parent / "simd.hpp").read_text() + (
        'extern "C" void run(long n, const double *x, const double *y, double *s, double *t) {'
        "for (long i = 0; i < n; i += W) { V a, b; __builtin_memcpy(&a, x + i, sizeof a); __builtin_memcpy(&b, y + i, sizeof b);"
        "V u = vasin(a), v = vatan2(a, b); __builtin_memcpy(s + i, &u, sizeof u); __builtin_memcpy(t + i, &v, sizeof v); } }"
    )
    rng = np.random.default_rng(36)
    x = np.concatenate([rng.uniform(-r, r, 4000) for r in (1e-300, 1e-9, 1e-3, 6e-3, 2e-2, 1.0)] + [[0.0, -0.0] * 4])
    y = rng.normal(size=x.shape)
    s, t = np.empty_like(x), np.empty_like(x)
    compiler.stored_library(source, tool).run(
        ctypes.c_long(len(x)), *(ctypes.c_void_p(a.ctypes.data) for a in (x, y, s, t))
    )
    assert np.all(np.abs(s - np.arcsin(x)) <= 4.5e-16 * np.abs(np.arcsin(x)))
    assert np.all(np.abs(t - np.arctan2(x, y)) <= 4.5e-16 * np.abs(np.arctan2(x, y)))


def test_a_tape_is_its_function() -> None:
    """Compare with CasADi: all operations, conditions with not-a-number in the unused branch, multiples of an angle."""
    x = ca.SX.sym("x", 4)
    values = [
        ca.if_else(x[0] < 0.0, 1.0, ca.sqrt(x[0])),
        ca.fmin(x[1], 3.0) / ca.fmax(ca.fabs(x[2]), 0.5),
        ca.floor(x[3] / 0.3) + (-x[0]) ** 3 + x[1] ** 2 + 2.0 * x[2] + 1.0 / (2.0 + x[3] * x[3]),
        *(ca.sin(k * x[3]) * ca.cos((k + 1) * x[3]) for k in range(1, 8)),
        ca.cos((x[3] * (180.0 / math.pi)) * (math.pi / 180.0)),
        ca.if_else(x[1] <= x[2], x[1], x[2]),
        ca.asin(ca.fmin(ca.fabs(x[0]) / 4.0, 1.0)) + ca.atan2(x[1], x[2]),
        ca.jacobian(ca.fmax(0.0, x[0] - 0.2) * x[1] + ca.fmin(x[2], 0.1), x).T,
        x[0] < x[1],
    ]
    function = ca.Function("f", [x], [ca.vertcat(*values[:5]), ca.vertcat(*values[5:])])
    tape = Tape(function)
    rng = np.random.default_rng(29)
    columns = rng.normal(size=(4, 3000)) * 2.0
    is_logical = np.concatenate([np.asarray(part) for part in function(columns)])
    # Eight multiples of an angle, a rounding each.
    assert np.abs(tape(list(columns)) - is_logical).max() <= 8 * 4e-16 * np.abs(is_logical).max()
    assert sum(kind in ("sin", "cos") for kind, _, _ in tape.nodes) == 2
    with pytest.raises(UnknownOperationError):
        Tape(ca.Function("g", [x], [ca.erf(x)]))


@pytest.mark.parametrize("switch", ["0", pytest.param("1", marks=compiled)])
@pytest.mark.usefixtures("eager")
def test_very_many_rows(dmu50: Machine, calibration: Calibration, monkeypatch: pytest.MonkeyPatch, switch: str) -> None:
    """Compare both evaluations of more rows than CasADi is used for with CasADi's; not-a-number is preserved."""
    monkeypatch.setenv(compiler.SWITCH_VARIABLE, switch)
    n = 2 * compiler.PORTION + 5 if switch == "1" else 3 * batch.MANY + 5
    q = random_commands(dmu50, n, np.random.default_rng(33)) * dmu50.scale
    q[7, 3], q[11, 0], q[13, 4] = np.nan, np.inf, 7e5
    real = Kinematics(dmu50, calibration, tool_length_mm=60.0)
    found = [np.concatenate(real.reached(q), axis=1)]
    found.append(np.concatenate(real.reached(np.delete(q, [11, 13], axis=0)), axis=1))
    assert (real._forward._row_function._library is not None) == (switch == "1")
    monkeypatch.setattr(batch, "MANY", n + 1)
    is_logical = np.concatenate(real.reached(q), axis=1)
    assert np.array_equal(np.isnan(found[0]), np.isnan(is_logical))
    # Metres and cosines of at most one, some hundred successive roundings.
    assert np.nanmax(np.abs(found[0] - is_logical)) <= 1e-14
    assert np.nanmax(np.abs(found[1] - np.delete(is_logical, [11, 13], axis=0))) <= 1e-14


def test_a_function_with_an_operation_not_known_here() -> None:
    x = ca.SX.sym("x", 2)
    function = batch.BatchFunction(ca.Function("f", [x], [ca.erf(x[0]) + x[1]]))
    rows = np.random.default_rng(34).normal(size=(batch.MANY, 2))
    assert function(rows)[0][:, 0] == pytest.approx([math.erf(a) + b for a, b in rows], abs=1e-15)


# Cache and its checks.


def counting(folder: Path, *, does: str = 'exec c++ "$@"') -> Compiler:
    """Return a compiler that writes a line for each compilation."""
    script = folder / "counting"
    script.write_text(f'#!/bin/sh\necho called >> "{folder}/calls"\n{does}\n')
    script.chmod(0o700)
    return Compiler((str(script),), "counting 1.0")


def calls(folder: Path) -> int:
    log = folder / "calls"
    return len(log.read_text().splitlines()) if log.exists() else 0


@compiled
def test_compiled_once(cache: Path, tmp_path: Path) -> None:
    tool = counting(tmp_path)
    assert compiler.stored_library(TINY, tool).answer() == 42
    assert compiler.stored_library(TINY, tool).answer() == 42
    assert calls(tmp_path) == 1
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    assert all(not path.stat().st_mode & 0o022 for path in cache.iterdir())
    assert not list(cache.glob(".twin-*"))
    # Another source, another compiler: another library.
    assert compiler.key(TINY, tool) != compiler.key(TINY + "\n", tool)
    assert compiler.key(TINY, tool) != compiler.key(TINY, Compiler(tool.command, "counting 1.1"))


def test_a_library_is_of_its_compiler_its_flags_and_its_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """With one home on several computers, code for another processor is never loaded."""
    tool = Compiler(("c++",), "c++ 1.0")
    own = compiler.key(TINY, tool)
    assert own == compiler.key(TINY, Compiler(("c++",), "c++ 1.0"))
    assert own != compiler.key(TINY, Compiler(("c++", "-m32"), "c++ 1.0"))
    with monkeypatch.context() as patch:
        patch.setattr(compiler, "processor", lambda: "another one")
        assert compiler.key(TINY, tool) != own
    for flags in (compiler.FLAGS[:-1], (*compiler.FLAGS, "-ffast-math")):
        with monkeypatch.context() as patch:
            patch.setattr(compiler, "FLAGS", flags)
            assert compiler.key(TINY, tool) != own


@compiled
@pytest.mark.parametrize("harm", ["truncated", "changed", "no note", "writeable by others", "a link", "empty note"])
def test_what_is_harmed_is_built_anew(cache: Path, tmp_path: Path, harm: str) -> None:
    tool = counting(tmp_path)
    name = compiler.key(TINY, tool)
    compiler.stored_library(TINY, tool)
    target, note = cache / f"{name}.so", cache / f"{name}.sha256"
    # Replace the file instead of changing it: this process has it mapped.
    content = target.read_bytes()
    target.unlink()
    target.write_bytes(content[: len(content) // 2] if harm == "truncated" else content + b"!" * (harm == "changed"))
    target.chmod(0o602 if harm == "writeable by others" else 0o600)
    if harm == "no note":
        note.unlink()
    elif harm == "empty note":
        note.write_text("")
    elif harm == "a link":
        target.rename(tmp_path / "elsewhere.so")
        target.symlink_to(tmp_path / "elsewhere.so")
    assert compiler.cached_library(name) is None
    assert compiler.stored_library(TINY, tool).answer() == 42
    assert calls(tmp_path) == 2
    assert compiler.cached_library(name) is not None


@compiled
def test_what_belongs_to_somebody_else_is_not_loaded(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool = counting(tmp_path)
    compiler.stored_library(TINY, tool)
    before = {path.name: path.read_bytes() for path in cache.iterdir()}
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)
    assert compiler.cached_library(compiler.key(TINY, tool)) is None
    assert compiler.stored_library(TINY, tool).answer() == 42
    assert calls(tmp_path) == 2
    assert {path.name: path.read_bytes() for path in cache.iterdir()} == before


@compiled
@pytest.mark.parametrize("obstacle", ["a file", "read-only"])
def test_a_home_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, obstacle: str) -> None:
    """The problem is solved nevertheless, and no file remains."""
    home = tmp_path / "home"
    if obstacle == "a file":
        home.write_text("")
    else:
        home.mkdir(mode=0o500)
        # The superuser may write anywhere: simulate the error for other users.
        monkeypatch.setattr(Path, "mkdir", _refused)
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    room = tmp_path / "tmp"
    os.mkdir(room)
    monkeypatch.setattr("tempfile.tempdir", str(room))
    tool = counting(tmp_path)
    assert compiler.stored_library(TINY, tool).answer() == 42
    assert calls(tmp_path) == 1
    assert not list(room.iterdir())


def _refused(path: Path, *args: object, **options: object) -> None:
    raise PermissionError(13, "Permission denied", str(path))


@compiled
def test_two_processes_at_once(cache: Path, tmp_path: Path) -> None:
    """Both get the library, and only one builds it."""
    tool = counting(tmp_path, does='sleep 1\nexec c++ "$@"')
    script = (
        "from twin.compute.native import compiler\nfrom twin.compute.native.compiler import Compiler\n"
        f"print(compiler.stored_library({TINY!r}, Compiler({tool.command!r}, {tool.version!r})).answer())"
    )
    running = [
        subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    outputs = [process.communicate(timeout=120) for process in running]
    assert [out.strip() for out, _ in outputs] == ["42", "42"], outputs
    assert calls(tmp_path) == 1


@compiled
def test_what_killed_builds_left_is_removed(cache: Path, tmp_path: Path) -> None:
    cache.mkdir(parents=True)
    cache.chmod(0o700)
    gone = subprocess.Popen(["true"])
    gone.wait()
    old, new = (cache / f".twin-{pid}-00ff-{platform.node()}" for pid in (gone.pid, os.getpid()))
    for left in (old, new):
        left.mkdir()
        (left / "made.so").write_text("half")
    compiler.stored_library(TINY, counting(tmp_path))
    assert not old.exists() and new.exists()


def test_a_compiler_that_fails_is_said_once(
    dmu50: Machine, calibration: Calibration, eager: None, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = counting(
        tmp_path, does='case "$1" in --version) echo broken 1.0;; *) echo "error: no disc" >&2; exit 1;; esac'
    )
    monkeypatch.setenv("CXX", script.command[0])
    real = Kinematics(dmu50, calibration)
    q = random_commands(dmu50, 200, np.random.default_rng(30))
    with pytest.warns(RuntimeWarning, match="no disc") as said:
        target = real.forward(q)
        first = Inverse(real).solve(target, q)
        second = Inverse(real).solve(target, q)
    assert len(said) == 1
    assert np.all(first.where(Status.CONVERGED) & second.where(Status.CONVERGED))
    assert solver_description() == f"NumPy ({script.command[0]}: error: no disc)"
    with pytest.raises(CompilerError, match="no disc"):
        compiler.stored_library(TINY, script)
    assert not list(cache.glob(".twin-*"))


def test_no_compiler_and_switched_off(
    dmu50: Machine, calibration: Calibration, eager: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither gives a message except in `twin info`."""
    real = Kinematics(dmu50, calibration)
    q = random_commands(dmu50, 200, np.random.default_rng(31))
    target = real.forward(q)
    for variables, description in (
        ({"PATH": str(tmp_path), "CXX": ""}, "NumPy (no C++ compiler found)"),
        ({compiler.SWITCH_VARIABLE: "0"}, "NumPy (TWIN_NATIVE=0)"),
    ):
        with monkeypatch.context() as patch, warnings.catch_warnings():
            warnings.simplefilter("error")
            for name, value in variables.items():
                patch.setenv(name, value)
            inverse = Inverse(real)
            assert np.all(inverse.solve(target, q).where(Status.CONVERGED))
            assert inverse._solver._native is None
            assert solver_description() == description


@compiled
def test_a_compiler_that_miscompiles_is_not_believed(
    dmu50: Machine, calibration: Calibration, eager: None, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """NumPy's check of the first poses finds one wrong sign in the sine."""
    script = tmp_path / "wrong"
    script.write_text(
        '#!/bin/sh\ncase "$1" in --version) echo wrong 1.0; exit;; esac\n'
        'sed "s/-1.66666666666666324348e-01/-1.66666666666666324348e-02/; s/- 1.66666666666666324348e-01/- 1.6e-01/" | exec c++ "$@"\n'
    )
    script.chmod(0o700)
    real = Kinematics(dmu50, calibration)
    q = random_commands(dmu50, 300, np.random.default_rng(32))
    target = real.forward(q)
    monkeypatch.setenv("CXX", str(script))
    with pytest.warns(RuntimeWarning, match="wrong"):
        found = Inverse(real).solve(target, q)
    assert np.all(found.where(Status.CONVERGED))
    assert np.abs(real.forward(found.positions).point_mm - target.point_mm).max() <= 1e-9


@pytest.mark.slow
def test_info_says_which_way(tmp_path: Path) -> None:
    settings = {"XDG_CACHE_HOME": str(tmp_path), "COLUMNS": "200"}
    lines = {}
    for switch in ("0", "1"):
        done = subprocess.run(
            [sys.executable, "-m", "twin.cli", "info"],
            env=os.environ | settings | {compiler.SWITCH_VARIABLE: switch},
            capture_output=True,
            text=True,
            check=True,
        )
        lines[switch] = next(line for line in done.stdout.splitlines() if line.startswith("inverse "))
    assert lines["0"] == "inverse       NumPy (TWIN_NATIVE=0)"
    expected = "NumPy (no C++ compiler found)" if compiler.find_compiler() is None else "compiled from "
    assert lines["1"].startswith(f"inverse       {expected}")


def test_a_portion_counts_for_the_whole_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether code is compiled depends on the work, not on the portions in which it is done; other threads are not concerned."""
    monkeypatch.delenv(compiler.SWITCH_VARIABLE, raising=False)
    rows = compiler.WORTH_COMPILING // 10
    with compiler.equal_portions(10):
        assert compiler.worth_compiling(rows) and not compiler.worth_compiling(rows - 1)
        with compiler.equal_portions(5):
            assert compiler.worth_compiling(rows // 5) and not compiler.worth_compiling(rows // 5 - 1)
        with ThreadPoolExecutor(1) as other:
            assert not other.submit(compiler.worth_compiling, rows).result()
    assert not compiler.worth_compiling(rows)
