"""All curve bases: values, derivatives, CasADi against NumPy, calibration files, sums, conversions; and splines with knots.

Truth is `numpy.polynomial`, `scipy.interpolate` and sines written out; no formula of the package.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from types import MappingProxyType

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import BPoly, BSpline

from twin._common.errors import InputError
from twin.compute.native.tape import Tape
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects import ErrorMotion
from twin.model.motion_curve import Curve, sum_of_curves
from twin.monitoring import compare
from twin.numerics.covariance import Covariance
from twin.numerics.curves import BASES, POWER, Basis, CurveSpace, bases_for, basis_named, conversion
from twin.numerics.curves.bases import CubicSpline
from twin.tool.forward import Kinematics

DOMAIN = (0.0, 360.0)
KNOTS = (0.0, 30.0, 95.0, 100.0, 250.0, 360.0)
MEMBERS = [basis(KNOTS) if basis.takes_knots else basis() for basis in BASES]
COUNTS = {basis: [n for n in range(1, 14) if basis.count_problem(n, rotary=True) is None] for basis in MEMBERS}
CASES = [(basis, count) for basis in MEMBERS for count in COUNTS[basis]]
NAMES = [f"{basis.name}-{count}" for basis, count in CASES]
EPS = float(np.finfo(float).eps)
every_case = pytest.mark.parametrize(("basis", "count"), CASES, ids=NAMES)
every_basis = pytest.mark.parametrize("basis", MEMBERS, ids=lambda basis: basis.name)


def reference(basis: Basis, q: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return the curve's values by another formula."""
    u = 2.0 * (q - DOMAIN[0]) / (DOMAIN[1] - DOMAIN[0]) - 1.0
    match basis.name:
        case "power":
            return np.polynomial.polynomial.polyval(u, coefficients)
        case "bernstein":
            return BPoly(coefficients[:, None], DOMAIN)(q)
        case "fourier":
            total = np.full_like(q, coefficients[0])
            for n, (a, b) in enumerate(coefficients[1:].reshape(-1, 2), 1):
                total += (complex(a, -b) * np.exp(1j * n * np.radians(q))).real
            return total
        case "cubic_spline":
            return BSpline(np.r_[[KNOTS[0]] * 3, KNOTS, [KNOTS[-1]] * 3], coefficients, 3)(q)
    raise AssertionError(f"no reference for {basis.name}")


def drawn(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng([count, seed]).standard_normal(count)


def inside(count: int = 97) -> np.ndarray:
    """Return positions that are not knots, and both ends."""
    return np.concatenate([[DOMAIN[0]], np.linspace(DOMAIN[0] + 0.37, DOMAIN[1] - 0.41, count), [DOMAIN[1]]])


def calibration_of(machine: Machine, *curves: Curve) -> Calibration:
    nothing: MappingProxyType[str, float] = MappingProxyType({})
    return Calibration(machine, "a test", MappingProxyType({curve.name: curve for curve in curves}), nothing, nothing)


def test_names_are_different_and_found() -> None:
    assert len({basis.name for basis in BASES}) == len(BASES)
    for basis in BASES:
        assert basis_named(basis.name) is basis
        assert basis.formula.endswith(".")
    with pytest.raises(InputError, match="no such basis") as caught:
        basis_named("cubic_splin")
    assert caught.value.nearest == "cubic_spline"


@every_case
def test_values(basis: Basis, count: int) -> None:
    coefficients, q = drawn(count), inside()
    found = basis.value(q, DOMAIN, tuple(coefficients))
    # Rounding of a sum whose functions are at most one.
    assert found == pytest.approx(reference(basis, q, coefficients), abs=50 * EPS * np.abs(coefficients).sum())
    functions = np.stack(basis.functions(q, DOMAIN, count), axis=1)
    assert functions.shape == (len(q), count)
    assert functions @ coefficients == pytest.approx(found, abs=1e-13)


@every_case
def test_casadi_is_numpy_and_its_derivative_that_of_differences(basis: Basis, count: int) -> None:
    coefficients, q, h = tuple(drawn(count)), inside()[1:-1], 1e-3
    symbol = ca.SX.sym("q")
    curve = basis.value(symbol, DOMAIN, coefficients)
    function = ca.Function("e", [symbol], [curve, ca.jacobian(curve, symbol)])
    value, slope = (np.array(part).ravel() for part in function(q[None]))
    assert value == pytest.approx(basis.value(q, DOMAIN, coefficients), abs=1e-13)
    forward, back = (basis.value(q + step, DOMAIN, coefficients) for step in (h, -h))
    # A third derivative of at most some 10^4 a turn³ and rounding over h.
    assert slope == pytest.approx((forward - back) / (2.0 * h), abs=1e-6)
    taped = Tape(function)([q])
    assert taped[0] == pytest.approx(value, abs=1e-12)
    assert taped[1] == pytest.approx(slope, abs=1e-12)


@every_basis
def test_counts_and_orders(basis: Basis) -> None:
    assert COUNTS[basis]
    assert basis.count_problem(0, rotary=True) is not None
    for count in COUNTS[basis]:
        groups = basis.groups(1, count)
        assert [k for group in groups for k in group] == list(range(1, count))
        assert basis.order(count) >= 0
        assert basis.largest(count) == count


def test_what_identify_tries() -> None:
    tried = {
        kind: [basis.name for basis in bases_for(rotary=kind != "travel", endless=kind == "turns")]
        for kind in ("travel", "part of a turn", "turns")
    }
    assert tried == {"travel": ["power"], "part of a turn": ["power", "fourier"], "turns": ["fourier"]}


@every_case
def test_a_calibration_file_keeps_every_digit(basis: Basis, count: int, dmu50: Machine, tmp_path: Path) -> None:
    root = np.random.default_rng(count).standard_normal((count, count))
    curve = Curve(
        "E_XC", "um", DOMAIN, basis.name, tuple(drawn(count)), root @ root.T, "a test", True, knots=basis.knots
    )
    path = tmp_path / "c.yaml"
    calibration_of(dmu50, curve).save(path)
    loaded = Calibration.load(path, dmu50)
    read = loaded.curves["E_XC"]
    assert read.covariance is not None
    assert replace(read, covariance=None) == replace(curve, covariance=None)
    assert np.array_equal(read.covariance, root @ root.T)
    assert read.family == basis
    assert loaded.to_yaml() == path.read_text()
    assert ("knots" in path.read_text()) is basis.takes_knots


@pytest.mark.parametrize(("basis", "other"), list(product(MEMBERS, MEMBERS)), ids=lambda basis: basis.name)
def test_a_sum_is_the_sum_or_refused(basis: Basis, other: Basis) -> None:
    """Add curves of every basis to every other, of any number of coefficients; refused only if the other cannot represent it."""
    one, two = drawn(COUNTS[basis][-1]), drawn(COUNTS[other][-1], seed=1)
    curve = Curve("E_XC", "um", DOMAIN, basis.name, tuple(one), knots=basis.knots)
    motion = ErrorMotion("E_XC", other, DOMAIN, tuple(two), wrapped=False)
    polynomials = {"power", "bernstein"}
    if basis != other and not {basis.name, other.name} <= polynomials:
        with pytest.raises(InputError, match="cannot be written in another basis"):
            sum_of_curves(curve, motion)
        return
    q = inside()
    total = sum_of_curves(curve, motion)
    assert total.basis == basis.name
    # Bernstein coefficients of degree 12 are up to 10^4 times those in powers.
    assert total(q) == pytest.approx(reference(basis, q, one) + reference(other, q, two), abs=1e-10)
    assert sum_of_curves(None, motion)(q) == pytest.approx(reference(other, q, two), abs=1e-12)


@every_basis
def test_a_constant_is_added_in_its_own_basis(basis: Basis) -> None:
    count = COUNTS[basis][-1]
    curve = Curve("E_XC", "um", DOMAIN, basis.name, tuple(drawn(count)), knots=basis.knots)
    constant = ErrorMotion("E_XC", basis if basis.nested else POWER, DOMAIN, (2.5,), wrapped=False)
    assert sum_of_curves(curve, constant)(inside()) == pytest.approx(curve(inside()) + 2.5, abs=1e-12)


@every_case
def test_conversions_are_the_same_curve(basis: Basis, count: int) -> None:
    for target in MEMBERS:
        matrix = conversion(basis, target, count, count)
        if matrix is not None:
            c = drawn(count)
            found = target.value(inside(), DOMAIN, tuple(matrix @ c))
            assert found == pytest.approx(reference(basis, inside(), c), abs=1e-12 * np.abs(matrix).sum())


def test_a_curve_of_no_basis_is_refused_with_its_line(dmu50: Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    head = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\ncurves:\n  E_XX:\n    unit: um\n"

    def refused(basis: str, knots: str, coefficients: str) -> InputError:
        knots = f"    knots: {knots}\n" if knots else ""
        path.write_text(f"{head}    domain: [0, 500]\n    basis: {basis}\n{knots}    coefficients: {coefficients}\n")
        with pytest.raises(InputError) as caught:
            Calibration.load(path, dmu50)
        return caught.value

    assert refused("powers", "", "[1]").line == 8
    assert "no entry `knots:`" in str(refused("power", "[0, 500]", "[1]"))
    for knots in ("[0, 200, 100, 500]", "[0, 100, 100, 500]", "[0]", "[0, .inf]"):
        error = refused("cubic_spline", knots, "[1, 2, 3, 4]")
        assert error.line == 9
    assert "2 to 500 increasing numbers" in str(refused("cubic_spline", "", "[1, 2, 3, 4]"))
    assert "knots from 0 to 500" in str(refused("cubic_spline", "[0, 400]", "[1, 2, 3, 4]"))
    error = refused("cubic_spline", "[0, 100, 500]", "[1, 2, 3, 4]")
    assert error.line == 10
    assert "5 coefficients, two more than there are knots" in str(error)


# --- cubic splines


def test_the_second_derivative_of_a_spline_is_continuous_and_its_span_a_cubic() -> None:
    basis = CubicSpline(KNOTS)
    symbol = ca.SX.sym("q")
    curve = basis.value(symbol, DOMAIN, tuple(drawn(basis.count)))
    parts = [curve]
    for _ in range(4):
        parts.append(ca.jacobian(parts[-1], symbol))
    function = ca.Function("e", [symbol], parts)
    near = 1e-9
    for knot in KNOTS[1:-1]:
        below, above = (np.array(ca.vertcat(*function(knot + side))).ravel() for side in (-near, near))
        # The third derivative, at most some 1e-2, times 2e-9; the third itself may jump.
        assert below[:3] == pytest.approx(above[:3], abs=1e-9)
    assert np.abs(np.array(function(inside()[None])[4])).max() < 1e-12


def test_knots_are_inserted_without_changing_the_curve() -> None:
    coarse, fine = CubicSpline(KNOTS), CubicSpline(tuple(sorted((*KNOTS, 60.0, 61.0, 300.0))))
    c = drawn(coarse.count)
    matrix = conversion(coarse, fine, coarse.count, fine.count)
    assert matrix is not None
    assert fine.value(inside(), DOMAIN, tuple(matrix @ c)) == pytest.approx(reference(coarse, inside(), c), abs=1e-12)
    assert conversion(fine, coarse, fine.count, coarse.count) is None
    motion = ErrorMotion("E_XC", CubicSpline((0.0, 77.0, 360.0)), DOMAIN, (1.0, 2.0, -1.0, 0.5, 3.0), wrapped=False)
    curve = Curve("E_XC", "um", DOMAIN, "cubic_spline", tuple(c), knots=KNOTS)
    total = sum_of_curves(curve, motion)
    assert total.knots == (0.0, 30.0, 77.0, 95.0, 100.0, 250.0, 360.0)
    truth = curve(inside()) + motion.basis.value(inside(), DOMAIN, motion.coefficients)
    assert total(inside()) == pytest.approx(truth, abs=1e-12)


@pytest.mark.parametrize("count", [1, 2, 4, 5])
def test_a_spline_takes_a_polynomial_up_to_its_degree(count: int) -> None:
    c = drawn(count)
    curve = Curve("E_XC", "um", DOMAIN, "cubic_spline", (0.0,) * 8, knots=KNOTS)
    motion = ErrorMotion("E_XC", POWER, DOMAIN, tuple(c), wrapped=False)
    if count > 4:
        with pytest.raises(InputError, match="cannot be written in another basis"):
            sum_of_curves(curve, motion)
    else:
        assert sum_of_curves(curve, motion)(inside()) == pytest.approx(reference(POWER, inside(), c), abs=1e-12)


def in_splines(calibration: Calibration) -> Calibration:
    """Return the same machine with a cubic spline for every linear axis, by least squares."""
    curves = dict(calibration.curves)
    for name, curve in calibration.curves.items():
        if curve.family == POWER:
            basis = CubicSpline(tuple(np.linspace(*curve.domain, 9).tolist()))
            q = np.linspace(*curve.domain, 300)
            found = np.linalg.lstsq(np.stack(basis.functions(q, curve.domain, 11), axis=1), curve(q), rcond=None)[0]
            curves[name] = replace(
                curve, basis=basis.name, coefficients=tuple(found.tolist()), covariance=None, knots=basis.knots
            )
    return replace(calibration, curves=MappingProxyType(curves), joint=None)


@pytest.mark.slow
def test_a_machine_in_splines_is_that_machine(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    """Written, read, symbolic and compiled curves agree with SciPy's splines."""
    path = tmp_path / "c.yaml"
    in_splines(calibration).save(path)
    read = Calibration.load(path, dmu50)
    assert {curve.basis for curve in read.curves.values()} == {"cubic_spline", "fourier"}
    q = np.random.default_rng(3).uniform([0, 0, -400, 0, 0], [500, 450, 0, 180, 360], (200, 5))
    one, other = (Kinematics(dmu50, c, tool_length_mm=120.0).forward(q) for c in (calibration, read))
    off = np.abs(one.point_mm - other.point_mm).max()
    # By how much the splines miss the polynomials, µm and µrad over 700 mm; nothing of it is rounding.
    missed = max(
        float(np.abs(curve(p) - read.curves[name](p)).max())
        for name, curve in calibration.curves.items()
        for p in [np.linspace(*curve.domain, 999)]
    )
    assert off < 18 * missed * 1e-3
    with pytest.raises(InputError, match="outside its domain"):
        read.curves["E_XX"](501.0)
    changes = compare(read, read, tool_length_mm=120.0)
    assert changes.verdict in ("same", "unknown")
    converted = read.in_datum("mean lines")
    again = Kinematics(dmu50, converted, tool_length_mm=120.0).forward(q)
    # The datum's own promise: 1 nm.
    assert np.abs(other.point_mm - again.point_mm).max() < 1e-6


@pytest.mark.slow
def test_knots_that_differ_are_compared_as_functions(dmu50: Machine) -> None:
    coarse, fine = CubicSpline((0.0, 500.0)), CubicSpline((0.0, 200.0, 500.0))
    matrix = conversion(coarse, fine, 4, 5)
    assert matrix is not None
    c, more = drawn(4), np.eye(4)
    one = Curve("E_XX", "um", (0.0, 500.0), coarse.name, tuple(c), more, knots=coarse.knots)
    two = Curve("E_XX", "um", (0.0, 500.0), fine.name, tuple(matrix @ c), matrix @ more @ matrix.T, knots=fine.knots)
    (change,) = compare(calibration_of(dmu50, one), calibration_of(dmu50, two), tool_length_mm=120.0).errors
    assert change.status == "known"
    assert abs(change.largest) < 1e-10
    assert change.notes == ()


def test_a_diagnosis_adds_to_a_spline(dmu50: Machine) -> None:
    curve = Curve(
        "E_XX", "um", (0.0, 500.0), "cubic_spline", (1.0, 0.0, 2.0, -1.0, 0.5), np.eye(5), knots=(0, 100, 500)
    )
    motion = ErrorMotion("E_XX", POWER, (0.0, 500.0), (0.0, 3.0, 1.0), wrapped=False)
    names = tuple(f"E_XX[{k}]" for k in range(3))
    whole = calibration_of(dmu50, curve).extended([motion], Covariance(names, np.diag([1.0, 4.0, 9.0])), "after")
    q = np.linspace(0.0, 500.0, 41)
    u = q / 250.0 - 1.0
    assert whole.curves["E_XX"](q) == pytest.approx(curve(q) + 3.0 * u + u**2, abs=1e-12)
    matrix = whole.covariance.of([f"E_XX[{k}]" for k in range(5)]).matrix
    functions = np.stack(curve.family.functions(q, (0.0, 500.0), 5), axis=1)
    variance = np.sum(functions**2, axis=1) + 1.0 + 4.0 * u**2 + 9.0 * u**4
    assert np.einsum("ij,jk,ik->i", functions, matrix, functions) == pytest.approx(variance, rel=1e-10)


def test_a_spline_is_no_space_of_an_estimate_but_has_orthonormal_functions() -> None:
    """`identify` does not use splines, but their functions orthonormalised over the domain exist."""
    space = CurveSpace("E_XC", CubicSpline(KNOTS), DOMAIN, 0, 8)
    q, w = space.grid()
    values = space.functions(q)
    # The rule is exact for polynomials; at knots it is good to its spacing.
    assert (w[:, None] * values).T @ values == pytest.approx(np.eye(8), abs=1e-9)
