"""Comparison of two calibrations: changes, their significance, and their effect at the tool."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from statsmodels.stats.multitest import multipletests
from typer.testing import CliRunner

import twin
from twin.cli.commands import app
from twin.controls import ControlSection, TableEntry
from twin.model.effects.entries import effect_named
from twin.monitoring.pairs import (
    FALSE_ALARMS,
    FALSE_ALARMS_OF_A_TEST,
    holm_adjusted,
    joint_covariance,
    pair_errors,
    simultaneous_factor,
    smallest_set,
    whiten,
)
from twin.numerics.covariance import Covariance
from twin.tool.uncertainty import ToolUncertainty, volume

MACHINE = twin.Machine.load("dmu50")
LOCATIONS = {"E_X0B": 0.0, "E_X0C": 3.0, "E_A0C": -12.0}
SQUARENESS = {"E_C0Y": 22.0, "E_A0Z": -31.0, "E_B0Z": 18.0}
CURVES = {
    "E_XX": ((0.0, 500.0), "power", (0.0, 11.4, 2.0, -1.0)),
    "E_YY": ((0.0, 450.0), "power", (0.0, 3.0, 2.0)),
    "E_ZZ": ((-400.0, 0.0), "power", (0.0, 5.0, 2.0)),
    "E_BX": ((0.0, 500.0), "power", (0.0, 4.0, 8.0)),
    "E_ZC": ((0.0, 360.0), "fourier", (0.0, 3.2, -1.1)),
}


def made(
    *,
    curves: Mapping[str, tuple[tuple[float, float], str, tuple[float, ...]]] = CURVES,
    squareness: Mapping[str, float] = SQUARENESS,
    location: Mapping[str, float] = LOCATIONS,
    u: float | None = 0.5,
    mixing: int | None = None,
) -> twin.Calibration:
    """Return a calibration with standard uncertainty u of every number, correlated at random if a seed is given."""
    found = twin.Calibration(
        MACHINE,
        "by hand",
        MappingProxyType(
            {
                name: twin.Curve(name, "um" if name[2] in "XYZ" else "urad", domain, basis, coefficients)
                for name, (domain, basis, coefficients) in curves.items()
            }
        ),
        MappingProxyType(dict(squareness)),
        MappingProxyType(dict(location)),
    )
    if u is None:
        return found
    names = tuple(number.name for effect in found.effects for number in effect.parameters)
    matrix = np.eye(len(names))
    if mixing is not None:
        root = np.eye(len(names)) + 0.8 * np.random.default_rng(mixing).standard_normal((len(names), len(names)))
        matrix = root @ root.T
        scale = np.sqrt(np.diag(matrix))
        matrix = matrix / np.outer(scale, scale)
    return replace(found, joint=Covariance(names, u**2 * matrix))


def drawn(truth: twin.Calibration, rng: np.random.Generator) -> twin.Calibration:
    """Return a simulated calibration: the true numbers plus a draw from their covariance."""
    covariance = truth.covariance
    off = dict(
        zip(
            covariance.names,
            np.linalg.cholesky(covariance.matrix) @ rng.standard_normal(len(covariance.names)),
            strict=True,
        )
    )
    curves = {
        name: replace(
            curve, coefficients=tuple(float(c + off[f"{name}[{k}]"]) for k, c in enumerate(curve.coefficients))
        )
        for name, curve in truth.curves.items()
    }
    return replace(
        truth,
        curves=MappingProxyType(curves),
        squareness=MappingProxyType({name: float(v + off[name]) for name, v in truth.squareness.items()}),
        location=MappingProxyType({name: float(v + off[name]) for name, v in truth.location.items()}),
    )


def significance_without_tool(first: twin.Calibration, second: twin.Calibration) -> tuple[bool, bool, tuple[str, ...]]:
    """Return the three tests without the tool: all together, error by error, smallest set."""
    pairs, _ = pair_errors(first, second)
    white = whiten(
        np.concatenate([pair.change for pair in pairs]), joint_covariance(pairs, (first.covariance, second.covariance))
    )
    own = holm_adjusted([whiten(pair.change, pair.covariance).p_value for pair in pairs])
    found = smallest_set(pairs, white, [MACHINE.by_name[pair.axis].linear for pair in pairs])
    return (
        white.p_value <= FALSE_ALARMS_OF_A_TEST,
        min(own) <= FALSE_ALARMS_OF_A_TEST,
        tuple(pairs[one.pair].name for one in found.culprits),
    )


def test_a_squareness_alone_is_named_with_its_geometric_effect_at_the_tool() -> None:
    older, newer = made(), made(squareness={**SQUARENESS, "E_C0Y": 34.0})
    newer = replace(newer, joint=Covariance(newer.joint.names, newer.joint.matrix * 1.21)) if newer.joint else newer
    found = twin.compare(older, newer, tool_length_mm=120.0, poses=60)
    assert found.verdict == "changed"
    (one,) = found.culprits.errors
    assert one.name == "E_C0Y" and one.largest == pytest.approx(12.0, abs=1e-9)
    # All other errors agree and are uncorrelated with it, so u is the root of both variances.
    assert one.u == pytest.approx(0.5 * np.sqrt(2.21), rel=1e-9)
    # E_XY −= y·E_C0Y: the tool is displaced by 12 µrad times Y's position, whatever the other axes do (contract §1); other errors
    # rotate that by about 1e-5.
    y = np.abs(volume(MACHINE, 60)[:, 1])
    assert found.tool.everything.max_um == pytest.approx(12e-3 * y.max(), rel=1e-4)
    assert found.tool.everything.rms_um == pytest.approx(12e-3 * np.sqrt(np.mean(y**2)), rel=1e-4)
    assert found.tool.everything_aligned.rms_um < found.tool.everything.rms_um
    assert found.tool.left.as_it_is.max_um == pytest.approx(found.tool.everything.max_um, rel=1e-3)
    assert "Only the squareness E_C0Y changed, by +12.0" in found.meaning[0]
    back = twin.compare(newer, older, tool_length_mm=120.0, poses=60)
    assert back.culprits.errors[0].largest == pytest.approx(-12.0, abs=1e-9)
    assert back.tool.everything.max_um == pytest.approx(found.tool.everything.max_um, rel=1e-9)


def test_alignment_removes_a_shift_and_a_rotation_only() -> None:
    from twin.monitoring.tool import Alignment

    rng = np.random.default_rng(3)
    points = rng.uniform(-200.0, 200.0, (50, 3))
    shift, turn = rng.standard_normal(3), rng.standard_normal(3) * 1e-2
    alignment = Alignment(points)
    assert np.abs(alignment.removed(shift + np.cross(turn, points))).max() < 1e-12
    noise = rng.standard_normal((50, 3))
    left = alignment.removed(noise)
    # The residual contains no rigid motion: both normal equations of the least-squares fit hold.
    assert np.abs(left.sum(axis=0)).max() < 1e-12
    assert np.abs(np.cross(points, left).sum(axis=0)).max() < 1e-9


@settings(max_examples=30)
@given(
    coefficients=st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=7),
    low=st.floats(0.0, 200.0),
    high=st.floats(300.0, 500.0),
)
def test_the_same_curve_in_another_basis_has_not_changed(coefficients: list[float], low: float, high: float) -> None:
    """Bernstein for power, and the same polynomial over a part of the range (numpy's own change of variable)."""
    whole = twin.Curve("E_XX", "um", (0.0, 500.0), "power", tuple(coefficients), np.eye(len(coefficients)))
    part = np.polynomial.Polynomial(coefficients, domain=[0.0, 500.0]).convert(domain=[low, high])
    small = replace(whole, domain=(low, high), coefficients=tuple([*part.coef, *[0.0] * 9][: len(coefficients)]))
    base = made(u=None)
    one = replace(base, curves=MappingProxyType({"E_XX": whole}))
    for curve in (whole.written("bernstein", len(coefficients) + 1), small):
        (pair,) = (
            p for p in pair_errors(one, replace(one, curves=MappingProxyType({"E_XX": curve})))[0] if p.name == "E_XX"
        )
        # Rounding of the conversions, of numbers up to 70.
        assert np.abs(pair.values).max() < 1e-10
        assert pair.positions[0] == pytest.approx(curve.domain[0]) and pair.positions[-1] == pytest.approx(
            curve.domain[1]
        )


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31))
def test_change_and_uncertainty_are_those_of_the_functions(seed: int) -> None:
    """Against the two curves evaluated separately, with different degrees, and u propagated separately."""
    rng = np.random.default_rng(seed)
    curves = []
    for count in (4, 6):
        root = rng.standard_normal((count, count))
        curves.append(
            twin.Curve("E_XX", "um", (0.0, 500.0), "power", tuple(rng.standard_normal(count).tolist()), root @ root.T)
        )
    base = made(u=None)
    one, two = (replace(base, curves=MappingProxyType({"E_XX": curve})) for curve in curves)
    pair = pair_errors(one, two)[0][0]
    q = pair.positions
    assert pair.values == pytest.approx(curves[1](q) - curves[0](q), abs=1e-11)
    u = np.polynomial.polynomial.polyvander((q - 250.0) / 250.0, 5)
    expected = sum(
        np.einsum("gi,ij,gj->g", u[:, :n], c.covariance, u[:, :n]) for n, c in zip((4, 6), curves, strict=True)
    )
    assert np.einsum("gi,ij,gj->g", pair.shape, pair.covariance, pair.shape) == pytest.approx(expected, rel=1e-9)
    assert float(pair.change @ pair.change) == pytest.approx(float(np.mean(pair.values**2)), rel=1e-9)


def test_a_band_holds_the_whole_curve_in_nineteen_of_twenty_cases() -> None:
    """a cos θ + b sin θ, both of variance v: the largest is √(a² + b²), by Rayleigh beyond √(−2 ln 0.05) √v in 5 %; a constant 1.96."""
    one = twin.Curve("E_ZC", "um", (0.0, 360.0), "fourier", (0.0, 3.0, 1.0), np.diag([0.0, 0.5, 0.5]))
    base = replace(made(u=None), squareness=MappingProxyType({}), location=MappingProxyType({}))
    sides = [
        replace(base, curves=MappingProxyType({"E_ZC": replace(one, coefficients=c)}))
        for c in ((0.0, 3.0, 1.0), (0.0, 3.5, 1.0))
    ]
    (error,) = twin.compare(*sides, poses=20).errors
    rayleigh = np.sqrt(-2.0 * np.log(0.05))
    # 4,000 draws: a standard error of 1 % of the quantile.
    assert error.u == pytest.approx(1.0) and error.band == pytest.approx(rayleigh, rel=0.04)
    assert simultaneous_factor(np.ones((7, 1)), np.eye(1)) == pytest.approx(1.96, rel=0.04)


def test_an_unlimited_axis_is_compared_over_the_turn_for_any_domain() -> None:
    one = made(curves={"E_ZC": ((0.0, 360.0), "fourier", (0.0, 3.0, 1.0))}, squareness={}, location={})
    two = made(curves={"E_ZC": ((-180.0, 180.0), "fourier", (0.0, 3.0, 1.0, 2.0, 0.0))}, squareness={}, location={})
    pair = pair_errors(one, two)[0][0]
    assert pair.values == pytest.approx(2.0 * np.cos(2.0 * np.deg2rad(pair.positions)), abs=1e-12)


def false_alarms(draws: int, mixings: tuple[int | None, ...]) -> int:
    """Return the number of false alarms in a number of comparisons per seed of correlation, over the three tests without the tool."""
    alarms = 0
    for mixing in mixings:
        truth = made(mixing=mixing)
        rng = np.random.default_rng(100 + (mixing or 0))
        for _ in range(draws):
            together, own, named = significance_without_tool(drawn(truth, rng), drawn(truth, rng))
            alarms += together or own or bool(named)
    return alarms


@pytest.mark.slow
def test_unchanged_machines_raise_a_false_alarm_in_at_most_one_comparison_of_twenty() -> None:
    # Three quarters of 5 % are 7.5 of 200, standard deviation 2.7; limit three of these above, and at least one alarm.
    assert 1 <= false_alarms(100, (None, 1)) <= 200 * FALSE_ALARMS * 0.75 + 3.0 * 2.7


def test_a_small_change_is_detected_if_the_uncertainty_allows_it() -> None:
    """5 µrad of squareness, u = 0.5 µrad each: seven standard uncertainties, named as the only error in nine of ten cases."""
    truth = made(mixing=4)
    changed = replace(truth, squareness=MappingProxyType({**SQUARENESS, "E_B0Z": 23.0}))
    rng = np.random.default_rng(7)
    named = [significance_without_tool(drawn(truth, rng), drawn(changed, rng))[2] for _ in range(40)]
    assert sum("E_B0Z" in names for names in named) >= 38
    assert sum(names == ("E_B0Z",) for names in named) >= 36


def test_a_change_at_the_detection_limit_is_found_in_nineteen_of_twenty() -> None:
    truth = made(mixing=5)
    found = twin.compare(truth, drawn(truth, np.random.default_rng(2)), poses=20)
    size = {name: size for name, size, _ in found.culprits.shows_from}["E_A0Z"]
    changed = replace(truth, squareness=MappingProxyType({**SQUARENESS, "E_A0Z": SQUARENESS["E_A0Z"] + size}))
    rng = np.random.default_rng(11)
    seen = sum(bool(significance_without_tool(drawn(truth, rng), drawn(changed, rng))[2]) for _ in range(60))
    # 57 expected, standard deviation 1.7; other errors named in its place only add to it.
    assert seen >= 52


def test_directions_without_variance_are_reported_and_not_tested() -> None:
    """A constant without an uncertainty in both is neither significant nor zero."""
    matrix = np.diag([0.0, 0.2, 0.3])
    one = twin.Curve("E_XX", "um", (0.0, 500.0), "power", (0.0, 5.0, 1.0), matrix)
    base = replace(made(u=None), squareness=MappingProxyType({}), location=MappingProxyType({}))
    sides = [
        replace(base, curves=MappingProxyType({"E_XX": replace(one, coefficients=c)}))
        for c in ((0.0, 5.0, 1.0), (10.0, 5.1, 1.0))
    ]
    found = twin.compare(*sides, poses=20)
    (error,) = found.errors
    assert error.without_variance == pytest.approx(10.0, rel=1e-3) and error.significant is False
    assert found.verdict == "unchanged" and found.unjudged == ("E_XX",)
    white = whiten(np.array([10.0, 0.1, 0.0]), 2.0 * matrix)
    assert white.rank == 2 and white.chi2 == pytest.approx(0.1**2 / 0.4)


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_rounding_of_a_singular_covariance_is_no_direction_with_a_variance(unit: float) -> None:
    """Two numbers of which only the sum has a variance, to 1e-10; a difference up to a thousandth of it is rounding of the numbers."""
    size = unit * np.sqrt(2.0 * np.array([1.0, 9.0]))
    both = np.array([[1.0, 1.0], [1.0, 1.0]])
    for rounded, rank in ((1e-10, 1), (1e-6, 2)):
        covariance = (both - rounded * (1.0 - np.eye(2))) * np.outer(size, size)
        found = whiten(2.0 * size, covariance)
        assert found.rank == rank and found.chi2 == pytest.approx(4.0, rel=1e-5)
        np.testing.assert_allclose(found.without_variance, 0.0, atol=1e-12)
    apart = np.array([1.0, -1.0])
    for share, left in ((7e-4, 0.0), (8e-4, 8e-4)):
        found = whiten((2.0 + share * apart) * size, both * np.outer(size, size))
        assert found.rank == 1 and found.chi2 == pytest.approx(4.0, rel=1e-9)
        np.testing.assert_allclose(found.without_variance, left * apart * size, atol=1e-12)


def test_nothing_is_significant_without_uncertainties() -> None:
    older, newer = made(u=None), made(squareness={**SQUARENESS, "E_C0Y": 500.0})
    found = twin.compare(older, newer, poses=20)
    assert found.verdict == "unknown" and not found.seen_by
    assert {error.significant for error in found.errors} == {None}
    assert np.isnan(found.tool.everything.u_max_um) and found.tool.judged is None
    assert found.tool.left.enough(1e9) is None
    assert set(found.unjudged) == {error.name for error in found.errors}


def test_an_error_in_only_one_calibration_is_listed_and_not_taken_as_zero() -> None:
    older = made()
    newer = replace(
        made(location={name: v for name, v in LOCATIONS.items() if name != "E_X0C"}),
        extra=(effect_named("reversal", "Y", {"size": 4.0}, MACHINE),),
    )
    found = twin.compare(older, newer, poses=20)
    assert {one.name: one.given_by for one in found.not_compared} == {"E_X0C": "first", "reversal:Y": "second"}
    assert found.unjudged == ("E_X0C", "reversal:Y")
    assert "E_X0C" not in {error.name for error in found.errors}


def test_equal_coefficients_over_another_range_are_another_curve() -> None:
    """E_XX = 11.4 u + … over 500 mm and over 480 mm differ; over the same range nothing changed, without rounding."""
    one = made(curves={"E_XX": CURVES["E_XX"]}, squareness={}, location={})
    other = made(curves={"E_XX": ((0.0, 480.0), *CURVES["E_XX"][1:])}, squareness={}, location={})
    (same,), _ = pair_errors(one, one)
    (changed,), _ = pair_errors(one, other)
    assert not np.any(same.change)
    q, shapes = changed.positions, changed.shape @ changed.change
    curves = [side.curves["E_XX"] for side in (one, other)]
    assert shapes == pytest.approx(curves[1](q) - curves[0](q), abs=1e-9)
    assert np.abs(shapes).max() > 0.3


def test_effects_are_compared_by_their_numbers_a_wave_by_its_shape() -> None:
    def with_wave(amplitude: float, phase: float, size: float) -> twin.Calibration:
        extra = (
            effect_named("pitch_error", "X", {"amplitude": amplitude, "period": 10.0, "phase": phase}, MACHINE),
            effect_named("reversal", "Y", {"size": size}, MACHINE),
        )
        base = replace(made(u=None, curves={}, squareness={}, location={}), extra=extra)
        names = tuple(number.name for effect in extra for number in effect.parameters)
        return replace(base, joint=Covariance(names, np.diag([0.04, 1e-6, 0.01, 0.09])))

    found = twin.compare(with_wave(2.0, 0.5, 5.0), with_wave(-2.0, 0.5 + np.pi, 9.0), poses=20)
    wave, reversal = found.errors
    assert abs(wave.largest) < 1e-12 and wave.significant is False
    assert reversal.largest == pytest.approx(4.0) and reversal.significant is True
    assert [error.name for error in found.culprits.errors] == ["reversal:Y"]
    # Approach directions are random: plus or minus half of 4 µm at every pose.
    assert found.tool.everything.rms_um == pytest.approx(2.0, rel=1e-6)


def test_the_same_constant_as_another_error_is_no_change_of_the_machine() -> None:
    """X's zero off by 10 µm, or B's line with all it carries by −10 µm: the same for any measurement of the tool against the work."""
    curves = dict(CURVES)
    curves["E_XX"] = ((0.0, 500.0), "power", (10.0, 11.4, 2.0, -1.0))
    found = twin.compare(made(curves=curves), made(location={**LOCATIONS, "E_X0B": -10.0}), poses=40)
    # In one datum both have identical numbers.
    assert found.tool.everything.max_um < 1e-3
    assert found.verdict == "unchanged"
    assert {error.name: error.largest for error in found.errors}["E_X0B"] == pytest.approx(0.0, abs=1e-3)


def test_other_numbers_with_the_same_effect_at_the_tool_are_no_change_of_the_machine() -> None:
    """X's zero off by 10 µm as an effect, which no datum touches, and B's line moved with it: the tool stays where it was."""

    def with_zero(offset: float, place: float) -> twin.Calibration:
        base = made(location={**LOCATIONS, "E_X0B": place})
        extra = (effect_named("zero_offset", "X", {"offset": offset}, MACHINE),)
        own = Covariance((extra[0].parameters[0].name,), np.eye(1) * 0.25)
        return replace(base, extra=extra, joint=Covariance.of_blocks([base.covariance, own]))

    found = twin.compare(with_zero(0.0, 0.0), with_zero(10.0, 10.0), poses=40)
    assert found.tool.everything.max_um < 1e-3
    assert found.verdict == "reworded"
    assert "the tool did not" in found.meaning[0]


def test_words_follow_what_the_changes_have_in_common() -> None:
    scaled = {
        name: (domain, basis, (c[0], c[1] + 23e-3 * (domain[1] - domain[0]) / 2.0, *c[2:]))
        if name[2:] in ("XX", "YY", "ZZ")
        else v
        for name, v in CURVES.items()
        for domain, basis, c in (v,)
    }
    text = " ".join(twin.compare(made(), made(curves=scaled), poses=20).meaning)
    assert "All scales changed alike" in text and "X +23" in text
    knocked = {**CURVES, "E_ZZ": ((-400.0, 0.0), "power", (0.0, 13.0, 2.0))}
    text = " ".join(
        twin.compare(
            made(), made(curves=knocked, squareness={**SQUARENESS, "E_A0Z": -22.0, "E_B0Z": 4.0}), poses=20
        ).meaning
    )
    assert "All changes are at one axis, Z" in text
    found = twin.compare(made(), drawn(made(), np.random.default_rng(1)), poses=20, tolerance_mm=1.0)
    assert found.verdict == "unchanged" and "the older one remains valid" in found.meaning[0]
    assert found.good_enough is True and found.tool.left.enough(0.1) is not True


def test_the_remaining_error_is_that_of_the_older_commands_on_the_newer_machine() -> None:
    """Compared with commands solved and executed pose by pose."""
    older, newer = made(), made(squareness={**SQUARENESS, "E_A0Z": 20.0})
    found = twin.compare(older, newer, tool_length_mm=120.0, poses=30)
    q = volume(MACHINE, 30)
    meant = twin.Kinematics(MACHINE, twin.Calibration.zero(MACHINE), tool_length_mm=120.0).forward(q)
    solved = twin.Inverse(twin.Kinematics(MACHINE, older, tool_length_mm=120.0)).solve(meant, q)
    good = ~solved.where(twin.Status.OUT_OF_RANGE)
    reached = twin.Kinematics(MACHINE, newer, tool_length_mm=120.0).forward(solved.positions[good])
    distance = np.linalg.norm(reached.point_mm - meant.point_mm[good], axis=1) * 1e3
    assert found.tool.left.as_it_is.max_um == pytest.approx(distance.max(), rel=1e-9)
    assert found.tool.left.poses == np.count_nonzero(good)


def test_calibrations_under_different_control_tables_are_refused(tmp_path: Path) -> None:
    table = TableEntry(tmp_path / "a", "siemens", ("L-POS",), "0" * 64)
    under = ControlSection("remaining", (table,))
    other = ControlSection("remaining", (replace(table, sha256="1" * 64),))
    with pytest.raises(twin.InputError, match="tables"):
        twin.compare(made(), replace(made(), control=under))
    with pytest.raises(twin.InputError, match="different tables"):
        twin.compare(replace(made(), control=under), replace(made(), control=other))
    found = twin.compare(replace(made(), control=under), replace(made(), control=under), poses=20)
    assert found.verdict == "same" and "same tables" in found.notices[0]


def test_one_statement_on_one_error() -> None:
    """Two squareness errors of high correlation: each alone is within its uncertainty, the one that explains both is not.

    Given that E_A0Z did not change, E_C0Y changed by d₁ − ρ d₂ with u √(2 (1 − ρ²)) (conditional normal distribution).
    """
    u, rho, change = 15.0, 0.99, np.array([28.0, 12.0])
    covariance = Covariance(("E_C0Y", "E_A0Z"), u**2 * np.array([[1.0, rho], [rho, 1.0]]))
    one, two = (
        replace(
            twin.Calibration.zero(MACHINE),
            squareness={"E_C0Y": factor * change[0], "E_A0Z": factor * change[1]},
            joint=covariance,
        )
        for factor in (0.0, 1.0)
    )
    found = twin.compare(one, two, poses=50)
    by_itself = {error.name: error for error in found.errors}
    assert by_itself["E_C0Y"].largest == pytest.approx(28.0) and not by_itself["E_C0Y"].significant
    stated = {error.name: error for error in found.stated}
    assert stated["E_C0Y"].largest == pytest.approx(change[0] - rho * change[1])
    assert stated["E_C0Y"].u == pytest.approx(u * np.sqrt(2.0 * (1.0 - rho**2)))
    assert stated["E_C0Y"].significant and not stated["E_A0Z"].significant
    text = found.to_text()
    assert "+16.1 ± 5.9" in text and "+16.1 ± 5.9" in found.to_html() and "28.0" not in text.split("each error;")[1]


@pytest.mark.slow
def test_the_command_prints_and_writes_the_comparison(tmp_path: Path) -> None:
    older, newer, report = tmp_path / "a.yaml", tmp_path / "b.yaml", tmp_path / "r.json"
    made().save(older)
    made(squareness={**SQUARENESS, "E_C0Y": 34.0}).save(newer)
    run = CliRunner().invoke(app, ["compare", str(older), str(newer), "--json", str(report), "--tolerance", "0.02"])
    assert run.exit_code == 0 and "CHANGED" in run.output and "E_C0Y" in run.output
    written = json.loads(report.read_text())
    assert written["schema"] == "twin.monitoring/1" and written["verdict"] == "changed"
    assert [error["error"] for error in written["fewest"]["errors"]] == ["E_C0Y"]
    assert written["first_compensating_second"]["good_enough"] is True
    run = CliRunner().invoke(app, ["compare", str(older), str(newer), "--tolerance", "0.0001"])
    assert run.exit_code == 3 and "not good enough" in run.output, "proven to exceed the tolerance"
    made(u=None).save(older)
    run = CliRunner().invoke(app, ["compare", str(older), str(newer)])
    assert run.exit_code == 3 and "UNKNOWN" in run.output


@pytest.mark.slow
def test_false_alarms_of_many_comparisons() -> None:
    # 33.75 of 900, standard deviation 5.7: two of these above.
    assert 5 <= false_alarms(300, (None, 1, 2)) <= 33.75 + 2.0 * 5.7


@pytest.mark.slow
def test_all_four_tests_together_raise_at_most_one_false_alarm_in_twenty() -> None:
    truth = made(mixing=6)
    rng = np.random.default_rng(21)
    alarms = sum(
        twin.compare(drawn(truth, rng), drawn(truth, rng), poses=40).verdict != "unchanged" for _ in range(200)
    )
    # At most 10 expected, standard deviation 3.1.
    assert alarms <= 10 + 3 * 3.1


def test_draws_do_not_depend_on_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws at the tool in steps of 20 and in one: the same machines, the same limits and probabilities, of every class."""
    generators: dict[int, list[tuple[ToolUncertainty, np.random.Generator]]] = {}

    def drawn_alike(tool: ToolUncertainty, rng: np.random.Generator, count: int) -> np.ndarray:
        own = generators.setdefault(id(rng), [])
        known = next((one for one in own if one[0] is tool), None)
        if known is None:
            own.append(known := (tool, np.random.default_rng(len(own))))
        return tool.factor @ known[1].standard_normal((count, tool.factor.shape[1])).T

    monkeypatch.setattr(ToolUncertainty, "draw", drawn_alike)
    monkeypatch.setattr("twin.monitoring.tool.DRAWS", 60)
    few = {name: CURVES[name] for name in ("E_XX", "E_BX")}
    older, newer = (made(curves=few, mixing=k, location={"E_X0C": float(k)}) for k in (3, 4))
    found = []
    for step in (20, 60):
        generators.clear()
        monkeypatch.setattr("twin.monitoring.tool.DRAWS_A_STEP", step)
        tool = twin.compare(older, newer, tool_length_mm=120.0, poses=20).tool
        sizes = [tool.everything, tool.everything_aligned, tool.judged, *tool.by_class.values()]
        found.append([(one.u_max_um, one.limit_um, one.p_value) for one in sizes])
        found[-1].append((tool.left.u_max_um, tool.left.upper_95_um, tool.left.lower_95_um))
    assert len(found[0]) > 4
    np.testing.assert_allclose(found[0], found[1], rtol=1e-5)


def test_an_effect_without_its_temperature_leaves_no_verdict_on_the_tool() -> None:
    def warm(coefficient: float) -> twin.Calibration:
        base = made()
        extra = (effect_named("thermal_expansion", "X", {"coefficient": coefficient}, MACHINE),)
        name = extra[0].parameters[0].name
        own = base.covariance
        return replace(base, extra=extra, joint=Covariance.of_blocks([own, Covariance((name,), np.eye(1) * 0.04)]))

    found = twin.compare(warm(8.0), warm(11.0), poses=20, tolerance_mm=1.0)
    assert found.verdict == "changed" and found.culprits.errors[0].name == "thermal_expansion:X"
    assert found.good_enough is None and np.isnan(found.tool.everything.u_max_um)
    assert found.unjudged == ("thermal_expansion:X",)
    given = twin.Conditions({"X": 30.0})
    found = twin.compare(warm(8.0), warm(11.0), poses=20, tolerance_mm=1.0, conditions=given)
    # 3 µm/(m·K) over 10 K and up to 0.5 m.
    x = volume(MACHINE, 20)[:, 0]
    assert found.tool.everything.max_um == pytest.approx(3.0 * 10.0 * x.max() * 1e-3, rel=1e-3)
    assert found.good_enough is True and not found.unjudged


def test_p_values_are_adjusted_as_holm_did() -> None:
    """The same as statsmodels, for p-values in any order, with equal ones and with some near one."""
    rng = np.random.default_rng(3)
    for count in (1, 2, 7, 30):
        p_values = np.round(rng.uniform(0.0, 1.0, count) ** 4, 3)
        assert holm_adjusted(p_values.tolist()) == pytest.approx(multipletests(p_values, method="holm")[1].tolist())
