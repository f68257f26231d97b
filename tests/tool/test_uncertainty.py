"""Uncertainty of the tool point compared with an independent formulation and with Monte Carlo; unknown covariances."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import yaml
from scipy import stats

from tests.model.errors import random_calibration
from tests.tool.sampled import sampled
from tests.truth.machine import TruthMachine
from twin import cli
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects.entries import effect_named
from twin.numerics.covariance import Covariance
from twin.tool.forward import Kinematics
from twin.tool.population import numerical_tolerance
from twin.tool.uncertainty import (
    POSES_PER_STEP,
    PartialErrors,
    ToolUncertainty,
    error_budget,
    errors_in,
    radius_95,
    random_approach,
    state_at,
    volume,
)

LENGTH = 120.0


def names_of(calibration: Calibration) -> tuple[str, ...]:
    return tuple(parameter.name for effect in calibration.effects for parameter in effect.parameters)


def with_covariance(calibration: Calibration, rng: np.random.Generator, u: float) -> Calibration:
    """Return the calibration with standard uncertainties of about ``u`` µm or µrad, all parameters correlated."""
    names = names_of(calibration)
    drawn = rng.normal(size=(len(names), len(names) + 20)) * u / np.sqrt(len(names))
    return replace(calibration, joint=Covariance(names, read_only(drawn @ drawn.T)))


@pytest.fixture(scope="module")
def uncertain(dmu50: Machine) -> Calibration:
    rng = np.random.default_rng(20)
    return with_covariance(random_calibration(dmu50, rng, 100.0), rng, 2.0)


def nudged(truth: TruthMachine, name: str, by: float) -> TruthMachine:
    """Return the truth machine with one parameter of its file changed."""
    other = copy.deepcopy(truth)
    entry, _, index = name.partition("[")
    if index:
        other.curves[entry]["coefficients"][int(index[:-1])] += by
    else:
        table = other.squareness if entry in other.squareness else other.location
        table[entry] += by
    return other


@pytest.mark.slow
def test_first_order_against_a_second_formulation(dmu50: Machine, uncertain: Calibration, tmp_path: Path) -> None:
    """J by central differences of an independent machine, parameter by parameter, and J Σ Jᵀ written out."""
    uncertain.save(tmp_path / "c.yaml")
    truth = TruthMachine(tmp_path / "c.yaml", LENGTH)
    q = volume(dmu50, 6, seed=3)
    found = ToolUncertainty(Kinematics(dmu50, uncertain, tool_length_mm=LENGTH)).at(q)
    assert uncertain.joint is not None and found.complete
    names = uncertain.joint.names
    columns = np.empty((len(q), 6, len(names)))
    for k, name in enumerate(names):
        plus, minus = nudged(truth, name, 1.0), nudged(truth, name, -1.0)
        for i, row in enumerate(q):
            a, b = plus.pose(row), minus.pose(row)
            turn = a[:3, :3] @ b[:3, :3].T
            columns[i, :3, k] = (a[:3, 3] - b[:3, 3]) * 1e3 / 2
            columns[i, 3:, k] = np.array([turn[2, 1], turn[0, 2], turn[1, 0]]) * 1e6 / 2
    wanted = columns @ uncertain.joint.matrix @ columns.transpose(0, 2, 1)
    scale = np.sqrt(np.einsum("nii->ni", wanted))
    # Differences: 1e-13 m of rounding over 1 µm, 1e-7; the third derivative over a step of 1e-6 is far below.
    assert np.abs((found.covariance - wanted) / (scale[:, :, None] * scale[:, None, :])).max() < 1e-6
    assert found.standard_um == pytest.approx(scale[:, :3], rel=1e-6)


def test_first_order_against_monte_carlo(dmu50: Machine, uncertain: Calibration) -> None:
    tool = ToolUncertainty(Kinematics(dmu50, uncertain, tool_length_mm=LENGTH))
    q = volume(dmu50, 4, seed=5)
    first = tool.at(q)
    trials = 100_000
    drawn = sampled(tool, q, np.random.default_rng(6), trials)
    assert drawn.validated == (True,) * len(q)
    spread = np.sqrt(np.einsum("nii->ni", first.covariance))
    noise = 1.0 / np.sqrt(trials)
    # Five standard errors of a covariance's entry, √(1 + ρ²) in units of the two standard deviations, and of a mean.
    apart = (drawn.covariance - first.covariance) / (spread[:, :, None] * spread[:, None, :])
    assert np.abs(apart).max() < 5 * np.sqrt(2.0) * noise
    assert np.abs(drawn.mean / spread).max() < 5 * noise
    # The 95 % quantile of a length: its own error is 2 % of a standard deviation at 1e4 draws, 0.6 % here; U is up to 0.54 % large.
    assert np.abs(drawn.radius_um / first.expanded_um - 1).max() < 0.01
    once, again = (sampled(tool, q[:1], np.random.default_rng(6), 1000) for _ in range(2))
    assert np.array_equal(again.interval_um, once.interval_um)


def test_where_first_order_is_not_sufficient_it_is_not_validated(dmu50: Machine) -> None:
    """The spindle tilts by 20 mrad (u) with a tool of 300 mm: the tip rises by the square of the angle, zero to first order."""
    calibration = Calibration(
        dmu50,
        "test",
        MappingProxyType({}),
        MappingProxyType({}),
        MappingProxyType({"E_A0B": 0.0}),
        Covariance(("E_A0B",), read_only(np.array([[2e4**2]]))),
    )
    tool = ToolUncertainty(Kinematics(dmu50, calibration, tool_length_mm=300.0))
    rng = np.random.default_rng(7)
    coarse = sampled(tool, [250.0, 225.0, 0.0, 0.0, 0.0], rng, 10_000)
    assert coarse.validated == (False,)
    assert (coarse.difference_um > coarse.tolerance_um).any()
    small = replace(calibration, joint=Covariance(("E_A0B",), read_only(np.array([[1.0]]))))
    tool = ToolUncertainty(Kinematics(dmu50, small, tool_length_mm=300.0))
    assert sampled(tool, [250.0, 225.0, 0.0, 0.0, 0.0], rng, 200_000).validated == (True,)
    # Two digits require limits to 0.5 … 5 % of u, and a thousand trials give them to 8 %.
    assert sampled(tool, [250.0, 225.0, 0.0, 0.0, 0.0], rng, 1000, digits=2).validated == (None,)


def test_numerical_tolerance() -> None:
    """JCGM 101, 7.9.2, examples 1 and 2: u = 0.00035 g to two digits and to one."""
    assert numerical_tolerance(np.array(0.00035), 2) == pytest.approx(0.5e-5)
    assert numerical_tolerance(np.array(0.00035), 1) == pytest.approx(0.5e-4)
    assert numerical_tolerance(np.array([9.96, 0.0]), 2) == pytest.approx([0.5, 0.0])


@pytest.mark.parametrize("directions", [1, 2, 3])
def test_radius_is_exact_for_equal_directions(directions: int) -> None:
    covariance = np.diag([4.0] * directions + [0.0] * (3 - directions))
    exact = 2.0 * np.sqrt(stats.chi2.ppf(0.95, directions))
    assert radius_95(covariance[None])[0] == pytest.approx(exact, rel=4e-5)  # of the polynomial


def test_radius_covers_95_percent() -> None:
    """Random covariances of every shape, including needles and discs."""
    rng = np.random.default_rng(8)
    for _ in range(30):
        directions = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        root = directions * 10.0 ** rng.uniform(-2, 1, size=3)
        radius = radius_95((root @ root.T)[None])[0]
        length = np.linalg.norm(rng.standard_normal((40_000, 3)) @ root.T, axis=1)
        # 0.15 % of the approximation, and five standard errors of 0.11 % of the draws.
        assert abs(np.mean(length <= radius) - 0.95) < 0.01
    assert radius_95(np.zeros((1, 3, 3)))[0] == 0.0


def test_fully_correlated_errors_cancel(dmu50: Machine) -> None:
    """Spindle and axis C shifted by the same unknown amount along x: no effect between tool and work at B = 0."""
    names = ("E_X0C", "E_XX[0]")
    tied = Covariance(names, read_only(np.full((2, 2), 9.0)))
    base = random_calibration(dmu50, np.random.default_rng(9), 1e-3)  # in effect none: nothing else is turned
    calibration = replace(
        base,
        curves=MappingProxyType({"E_XX": base.curves["E_XX"]}),
        squareness=MappingProxyType({}),
        location=MappingProxyType({"E_X0C": 0.0}),
    )
    q = [[250.0, 225.0, -200.0, 0.0, c] for c in (0.0, 77.0)] + [[250.0, 225.0, -200.0, 180.0, 0.0]]

    def expanded(joint: Covariance) -> np.ndarray:
        return ToolUncertainty(Kinematics(dmu50, replace(calibration, joint=joint))).at(q).expanded_um

    both = expanded(tied)
    assert both[:2].max() < 1e-6  # rounding in the square root of eps · 9 µm²
    # B = 180° turns C's own frame about the tilted axis, and x there to −x: the two shifts add, 6 µm instead of 0.
    assert both[2] == pytest.approx(1.96 * 6.0, rel=1e-4)
    apart = expanded(Covariance(names, read_only(9.0 * np.eye(2))))
    assert apart == pytest.approx(1.96 * 3.0 * np.sqrt(2.0), rel=1e-4)


def test_no_covariance_is_unknown_and_not_zero(dmu50: Machine, calibration: Calibration) -> None:
    tool = ToolUncertainty(Kinematics(dmu50, calibration))
    found = tool.at([250.0, 225.0, -200.0, 30.0, 0.0])
    assert not found.known and not found.complete
    assert np.isnan(found.covariance).all() and np.isnan(found.expanded_um).all()
    assert np.isnan(found.axis_expanded_urad).all()
    named = {*calibration.curves, *calibration.squareness, *calibration.location}
    assert set(found.without_uncertainty) == named
    over = tool.over_volume(50).to_dict()
    assert over["known"] is False and over["rms_um"] is None and over["expanded_um"] is None
    assert json.loads(json.dumps(over, allow_nan=False)) == over


def test_errors_without_covariance_are_named(dmu50: Machine, uncertain: Calibration) -> None:
    assert uncertain.joint is not None
    some = replace(uncertain, joint=uncertain.joint.where(lambda name: name not in ("E_XX[2]", "E_C0Y")))
    found = ToolUncertainty(Kinematics(dmu50, some)).at([250.0, 225.0, -200.0, 30.0, 0.0])
    assert found.without_uncertainty == ("E_XX[2]", "E_C0Y")
    assert found.known and not found.complete
    rows = {row.name: row.peak_u for row in error_budget(dmu50, some)[0]}
    assert np.isnan(rows["E_XX"]) and np.isnan(rows["E_C0Y"])
    assert rows["E_A0Z"] == pytest.approx(np.sqrt(some.covariance.of(["E_A0Z"]).matrix[0, 0]))
    # Two parameters of a power curve, by hand: u² = s00 + 2 u s01 + u² s11 …, largest over the domain.
    names = [f"E_XY[{k}]" for k in range(6)]
    matrix = some.covariance.of(names).matrix
    u = np.linspace(-1, 1, 2001)[:, None] ** np.arange(6)
    assert rows["E_XY"] == pytest.approx(np.sqrt(np.einsum("nk,kl,nl->n", u, matrix, u).max()), rel=1e-4)


def test_a_map_over_the_volume(dmu50: Machine, uncertain: Calibration) -> None:
    tool = ToolUncertainty(Kinematics(dmu50, uncertain, tool_length_mm=LENGTH))
    grid = tool.on_grid((3, 2, 2), {"B": 90.0})
    assert grid.positions.shape == (12, 5)
    assert {tuple(row) for row in grid.positions[:, :3]} == {
        (x, y, z) for x in (0.0, 250.0, 500.0) for y in (0.0, 450.0) for z in (-400.0, 0.0)
    }
    assert set(grid.positions[:, 3]) == {90.0} and set(grid.positions[:, 4]) == {0.0}
    alone = np.array([tool.at(row).expanded_um[0] for row in grid.positions])
    assert grid.uncertainty.expanded_um == pytest.approx(alone, rel=1e-12)
    data = json.loads(json.dumps(grid.to_dict(), allow_nan=False))
    assert data["rms_um"] == pytest.approx(np.sqrt(np.mean(alone**2)))
    assert data["max_um"] == pytest.approx(alone.max())
    assert list(data["where"].values()) == pytest.approx(grid.positions[np.argmax(alone)].tolist())
    assert tool.over_volume().rms_um == pytest.approx(grid.rms_um, rel=0.5)  # of one size, neither a bound of the other
    for counts, rotary, words in (((3, 2), {}, "X, Y, Z"), ((2, 2, 2), {"X": 1.0}, "B, C")):
        with pytest.raises(InputError, match=words):
            tool.on_grid(counts, rotary)


def test_many_poses_give_the_same_as_one(dmu50: Machine, uncertain: Calibration) -> None:
    """Across the boundaries of the steps in which poses are computed, each pose with its own directions of approach.

    The reversal is large and uncertain: its size changes the derivatives, its sign the correlation with the other errors.
    """
    assert uncertain.joint is not None
    lost = (effect_named("reversal", "Y", {"size": 40.0}, dmu50), effect_named("reversal", "B", {"size": 900.0}, dmu50))
    names = (*uncertain.joint.names, "reversal:Y.size", "reversal:B.size")
    # Correlated with the first errors, so that the sign of the approach shows.
    root = np.zeros((len(names), len(names)))
    root[:-2, :-2] = np.linalg.cholesky(uncertain.joint.matrix)
    root[-2:, :3] = [[3.0, 2.0, 4.0], [30.0, 50.0, 20.0]]
    calibration = replace(uncertain, extra=lost, joint=Covariance(names, read_only(root @ root.T)))
    tool = ToolUncertainty(Kinematics(dmu50, calibration, tool_length_mm=LENGTH))
    q = volume(dmu50, 2 * POSES_PER_STEP + 300)
    sides = random_approach(q)
    # No two poses a step or a chunk apart have the same directions.
    for apart in (256, POSES_PER_STEP):
        assert np.any(sides[apart:] != sides[:-apart], axis=1).mean() > 0.9
    many = tool.at(q, sides)
    ends = [
        end + k
        for end in (0, 256, POSES_PER_STEP, POSES_PER_STEP + 256, 2 * POSES_PER_STEP, len(q))
        for k in range(-4, 4)
    ]
    for i in (i for i in ends if 0 <= i < len(q)):
        alone = tool.at(q[i], sides[i])
        assert many.covariance[i] == pytest.approx(alone.covariance[0], rel=1e-9, abs=1e-12), i
        assert many.expanded_um[i] == pytest.approx(alone.expanded_um[0], rel=1e-9), i
        assert many.axis[i] == pytest.approx(alone.axis[0], abs=1e-12), i
    with pytest.raises(ValueError, match="read-only"):
        many.covariance[0] = 0.0


def test_a_rank_one_covariance_gives_no_negative_variance(dmu50: Machine, uncertain: Calibration) -> None:
    names = names_of(uncertain)
    shape = np.random.default_rng(10).normal(size=len(names))
    tied = replace(uncertain, joint=Covariance(names, read_only(np.outer(shape, shape))))
    found = ToolUncertainty(Kinematics(dmu50, tied)).at(volume(dmu50, 500))
    assert np.einsum("nii->ni", found.covariance).min() >= 0.0
    assert np.isfinite(found.expanded_um).all()
    largest = np.linalg.eigvalsh(found.covariance[:, :3, :3])
    assert (largest[:, 1] <= 1e-9 * largest[:, 2]).all()  # one number moves every point along a line


def test_the_covariance_of_a_curve_is_used(dmu50: Machine, tmp_path: Path) -> None:
    """A file with a covariance for one curve only: it is used, and the other curves are named."""
    path = tmp_path / "c.yaml"
    curve = {"unit": "um", "domain": [0, 500], "basis": "power", "coefficients": [1.0, 2.0]}
    data = {
        "schema": "twin.calibration/1",
        "machine": dmu50.name,
        "source": "a test",
        "curves": {"E_XX": {**curve, "covariance": [[4.0, 0.0], [0.0, 9.0]]}, "E_YX": curve},
    }
    path.write_text(yaml.safe_dump(data))
    found = ToolUncertainty(Kinematics(dmu50, Calibration.load(path, dmu50))).at([500.0, 225.0, -200.0, 0.0, 0.0])
    assert found.without_uncertainty == ("E_YX",)
    assert found.standard_um[0] == pytest.approx([np.sqrt(13.0), 0.0, 0.0], abs=1e-9)


def test_info_prints_the_uncertainty_at_the_tool(
    dmu50: Machine, uncertain: Calibration, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def printed(*arguments: str) -> str:
        with pytest.raises(SystemExit) as stopped:
            cli.main(["info", *arguments])
        assert stopped.value.code == 0
        return capsys.readouterr().out

    assert "uncertainty of the tool point: unknown" in printed()
    assert uncertain.joint is not None
    some = replace(uncertain, joint=uncertain.joint.where(lambda name: not name.startswith("E_XX")))
    some.save(tmp_path / "c.yaml")
    text = printed("-c", str(tmp_path / "c.yaml"), "--tool-length", "120")
    over = ToolUncertainty(Kinematics(dmu50, some, tool_length_mm=LENGTH)).over_volume()
    assert f"U at least {over.rms_um:.2f} µm RMS, {over.max_um:.2f} µm largest" in text
    assert "not included (no covariance in the calibration): E_XX" in text
    assert "peak u" in text


def test_errors_of_effects_are_those_of_the_kinematics(dmu50: Machine, uncertain: Calibration) -> None:
    real, q = Kinematics(dmu50, uncertain), volume(dmu50, 40)
    sides = random_approach(q)
    found = errors_in(state_at(dmu50, q, sides, real.conditions), uncertain.effects, dmu50, len(q))
    assert found == pytest.approx(real.error_frames(q, sides).reshape(40, -1), abs=1e-15)


def test_poses_with_some_errors_are_those_of_the_calibration_with_them_alone(
    dmu50: Machine, uncertain: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin.tool.uncertainty.ROWS", 90)
    with_reversal = replace(uncertain, extra=(effect_named("reversal", "Y", {"size": 5.0}, dmu50),))
    q = volume(dmu50, 40)
    sides = random_approach(q)
    names = [effect.name for effect in with_reversal.effects]
    selections = [{names[0]}, {names[-1]}, set(names[::2]), set(), set(names)]
    partial = PartialErrors(Kinematics(dmu50, with_reversal, tool_length_mm=LENGTH), q, sides)
    expected = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=LENGTH).forward(q)
    for some, (nominal, found) in zip(selections, partial.poses(selections), strict=True):
        assert nominal.point_mm == pytest.approx(expected.point_mm, abs=1e-10)
        assert some or np.array_equal(found.point_mm, nominal.point_mm)
        alone = Kinematics(dmu50, with_reversal.where(some.__contains__), tool_length_mm=LENGTH).forward(q, sides)
        assert found.point_mm == pytest.approx(alone.point_mm, abs=1e-10)
        assert found.rotation == pytest.approx(alone.rotation, abs=1e-13)


def test_the_uncertainty_of_the_tool_axis_is_that_of_its_turned_direction(
    dmu50: Machine, uncertain: Calibration
) -> None:
    """A rotation vector ω moves the axis a by ω × a: one column of the lever for each unit vector."""
    found = ToolUncertainty(Kinematics(dmu50, uncertain, tool_length_mm=LENGTH)).at(volume(dmu50, 20, seed=8))
    for i, axis in enumerate(found.axis):
        lever = np.stack([np.cross(unit, axis) for unit in np.eye(3)], axis=1)
        expected = radius_95((lever @ found.covariance[i, 3:, 3:] @ lever.T)[None])[0]
        assert found.axis_expanded_urad[i] == pytest.approx(expected, rel=1e-9)
    assert np.ptp(found.axis[:, :2]) > 1.0, "the axis is tilted, so that every element of the lever counts"
