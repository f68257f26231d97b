"""Mistakes in a calibration: `twin diagnose` must name them in the terms of its author.

Made as the thesis makes them (listing 3.1 to 3.3): polynomials of degree 8 through eleven stops, without a constant; exchanged
curves; errors placed before the chain instead of at their joints. The truth machine (`tests.truth.hidden`) has the curves of the
default calibration, of degree 5 at most but for E_ZX.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from numpy.polynomial import polynomial

from tests.truth import hidden
from twin.diagnosis import Cause, Diagnosis, diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration

SIGMA_MM = 3e-3
STOPS = 11
DEGREE = 8


@pytest.fixture
def look(dmu50: Machine, tmp_path: Path):
    def measured(judged: Calibration, *, elsewhere: Mapping[str, str] | None = None, seed: int = 1) -> Diagnosis:
        rng = np.random.default_rng(seed)
        plan = hidden.rounded(hidden.plan(rng, poses=90))
        read = hidden.noisy(hidden.points(plan, elsewhere=elsewhere), rng, "isotropic", SIGMA_MM)
        return diagnose(
            Measurements.load(hidden.write(tmp_path / "m.csv", plan, read, u_mm=SIGMA_MM), dmu50), dmu50, judged
        )

    return measured


def fitted(
    calibration: Calibration, name: str, noise: np.ndarray | float = 0.0, *, constant: bool, up: float = 0.0
) -> tuple[float, ...]:
    """Return coefficients in u of a polynomial in q of degree 8 fitted to the true curve at eleven stops."""
    lo, hi = calibration.curves[name].domain
    q = np.linspace(lo, hi, STOPS)
    powers = np.vander(q / hi, DEGREE + 1, increasing=True)[:, 0 if constant else 1 :]
    c = np.linalg.lstsq(powers, calibration.curves[name](q) + up + noise, rcond=None)[0]
    u = np.linspace(-1.0, 1.0, 200)
    values = polynomial.polyval(((lo + hi) + u * (hi - lo)) / (2.0 * hi), c if constant else [0.0, *c])
    return tuple(float(v) for v in polynomial.polyfit(u, values, DEGREE))


def put(calibration: Calibration, curves: Mapping[str, Sequence[float]]) -> Calibration:
    new = {
        name: replace(curve, coefficients=tuple(curves.get(name, curve.coefficients)))
        for name, curve in calibration.curves.items()
    }
    return replace(calibration, curves=MappingProxyType(new))


def only(result: Diagnosis) -> Cause:
    assert result.unexplained is None
    (cause,) = result.causes
    return cause


@pytest.mark.slow
def test_a_dropped_constant(look, calibration: Calibration) -> None:
    """E_CX is −34 µrad at X = 0; a polynomial in X without a constant is zero there."""
    judged = put(calibration, {"E_CX": fitted(calibration, "E_CX", constant=False)})
    cause = only(look(judged))
    assert (cause.effect, cause.where) == ("angular_error_motion", "E_CX")
    assert "fitted without a constant term" in cause.evidence
    error = float(cause.evidence.split("the machine's error is ")[1].split(" ")[0])
    # λ is about 80: the size is known to an eighth; eleven stops give nearly the same as nine or thirteen.
    assert error == pytest.approx(float(calibration.curves["E_CX"](0.0)), rel=0.35)


@pytest.mark.slow
def test_a_polynomial_of_degree_8_that_swings_between_its_stops(look, calibration: Calibration) -> None:
    rng = np.random.default_rng(3)
    noise = {"E_XY": 3.0, "E_CX": 30.0}
    judged = put(
        calibration,
        {name: fitted(calibration, name, u * rng.standard_normal(STOPS), constant=True) for name, u in noise.items()},
    )
    result = look(judged)
    curves = {("straightness", "E_XY"), ("angular_error_motion", "E_CX")}
    # A slope of the one or a constant of the other would be a squareness.
    assert curves <= {(c.effect, c.where) for c in result.causes} <= curves | {("squareness", "E_C0Y")}
    for cause in (c for c in result.causes if c.effect != "squareness"):
        assert "polynomial of degree 8 oscillates" in cause.evidence
        # The machine's own curves have degree 5.
        assert int(cause.evidence.split("terms above degree ")[1].split(" ")[0]) in (4, 5)
    assert result.gain is not None
    assert result.gain.tool_after_um < 0.2 * result.gain.tool_before_um


@pytest.mark.slow
def test_a_sign_and_a_curve_that_is_corrected_twice(look, calibration: Calibration) -> None:
    turned = {"E_CX": [-c for c in calibration.curves["E_CX"].coefficients]}
    assert "wrong sign" in only(look(put(calibration, turned))).evidence
    halved = {"E_YY": [0.5 * c for c in calibration.curves["E_YY"].coefficients]}
    assert "2 times" in only(look(put(calibration, halved))).evidence


def test_a_curve_under_another_name(look, calibration: Calibration) -> None:
    """Two tilts of B have each other's names."""
    curves = dict(calibration.curves)
    curves["E_AB"], curves["E_CB"] = (
        replace(curves["E_CB"], name="E_AB"),
        replace(curves["E_AB"], name="E_CB"),
    )
    result = look(replace(calibration, curves=MappingProxyType(curves)))
    cause = only(result)
    assert (cause.effect, cause.where) == ("misplaced", "E_AB and E_CB exchanged")
    assert abs(cause.parameters[0].value - 1.0) < 3.0 * cause.parameters[0].u
    # Corrected by the cause found, E_AB has its true values, within the uncertainty of the share.
    q = np.linspace(0.0, 180.0, 91)
    for name in ("E_AB", "E_CB"):
        right, found = calibration.curves[name](q), result.extended.curves[name](q)
        size = float(np.abs(curves[name](q) - right).max())
        np.testing.assert_allclose(found, right, atol=3.0 * cause.parameters[0].u * size)


@pytest.mark.sample(1)  # of 2
@pytest.mark.parametrize(("axis", "where", "name"), [("C", "B", "C at B"), ("C", "base", "C at the base")])
def test_errors_at_the_wrong_joint(look, calibration: Calibration, axis: str, where: str, name: str) -> None:
    result = look(calibration, elsewhere={axis: where})
    cause = only(result)
    assert (cause.effect, cause.where) == ("misplaced", name)
    assert abs(cause.parameters[0].value - 1.0) < 3.0 * cause.parameters[0].u
    assert "instead of C's own joint" in cause.evidence
    assert result.gain is not None and result.gain.held_out is not None
    assert result.gain.held_out.after_um < result.gain.held_out.before_um
