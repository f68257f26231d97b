"""Monte Carlo machines compared with an independent implementation, with theory, and with another simulation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from tests.model.errors import random_calibration
from tests.tool.sampled import sampled
from tests.tool.test_uncertainty import LENGTH, nudged, with_covariance
from tests.truth.machine import TruthMachine
from twin import cli
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.compute.parallel import Workers
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.numerics.covariance import Covariance
from twin.tool.forward import Kinematics
from twin.tool.population import BINS, MACHINES_PER_STEP, TRIALS_PER_TASK, Counts, Draws, binned, draw_machines
from twin.tool.uncertainty import ToolUncertainty, random_approach, volume

HERE = Workers(1)


def draws_of(machine: Machine, calibration: Calibration, *, poses: int, seed: int = 1) -> Draws:
    q = volume(machine, poses)
    return Draws(machine, calibration, LENGTH, Conditions(), q, random_approach(q), seed)


def seen(draws: Draws, task: int, machines: int) -> tuple[np.ndarray, np.ndarray]:
    """Return deviations and lengths (4, poses, machines) and measures (4, machines) of the machines of one step."""
    values = np.full((4, len(draws.positions), machines), np.nan)

    def see(tile: slice, some: np.ndarray) -> None:
        values[:, tile] = some

    return values, draws.steps.run(task, machines, see)


@pytest.fixture(scope="module")
def uncertain(dmu50: Machine) -> Calibration:
    rng = np.random.default_rng(20)
    return with_covariance(random_calibration(dmu50, rng, 100.0), rng, 2.0)


def test_a_drawn_machine_against_a_second_formulation(dmu50: Machine, uncertain: Calibration, tmp_path: Path) -> None:
    """Evaluate four machines with kinematics that share no code: every point, and the statistics."""
    uncertain.save(tmp_path / "c.yaml")
    estimated = TruthMachine(tmp_path / "c.yaml", LENGTH)
    Calibration.zero(dmu50).save(tmp_path / "zero.yaml")
    as_drawn = TruthMachine(tmp_path / "zero.yaml", LENGTH)
    draws = draws_of(dmu50, uncertain, poses=40, seed=9)
    numbers = draws.tool.draw(np.random.default_rng(np.random.SeedSequence(9, spawn_key=(2,))), MACHINES_PER_STEP)
    values, measures = seen(draws, 2, 4)
    point_um, distance_um = values[:3], values[3]
    assert point_um.shape == (3, 40, 4) and distance_um.shape == (40, 4)
    assert distance_um == pytest.approx(np.linalg.norm(point_um, axis=0), rel=1e-12)
    for machine in range(4):
        drawn = estimated
        for name, by in zip(draws.tool.parameters, numbers[:, machine], strict=True):
            drawn = nudged(drawn, name, by)
        real = np.array([drawn.pose(row)[:3, 3] for row in draws.positions]) * 1e3
        off = real - np.array([estimated.pose(row)[:3, 3] for row in draws.positions]) * 1e3
        error = np.linalg.norm(real - np.array([as_drawn.pose(row)[:3, 3] for row in draws.positions]) * 1e3, axis=1)
        left = np.linalg.norm(off, axis=1)
        # Rounding of metres, 1e-10 µm, in a chain of ten links.
        assert np.abs(point_um[:, :, machine].T - off).max() < 1e-8
        wanted = [np.sqrt(np.mean(error**2)), error.max(), np.sqrt(np.mean(left**2)), left.max()]
        assert measures[:, machine] == pytest.approx(wanted, abs=1e-8)


@pytest.mark.slow
def test_against_exact_order_statistics_and_theory(dmu50: Machine, uncertain: Calibration) -> None:
    kinematics = Kinematics(dmu50, uncertain, tool_length_mm=LENGTH)
    trials = 100_000
    found = draw_machines(kinematics, trials=trials, poses=6, seed=4, workers=HERE)
    tool = ToolUncertainty(kinematics)
    sides = random_approach(found.positions)
    other = sampled(tool, found.positions, np.random.default_rng(5), trials, approach=sides)
    u = found.standard_um
    noise = 1.0 / np.sqrt(trials)
    # Standard error of a 2.5 % quantile of a normal distribution: 2.67 u/√n, of a difference of two √2 times that; five of them.
    assert np.abs((found.interval_um - other.interval_um) / u[:, :, None]).max() < 5 * np.sqrt(2.0) * 2.67 * noise
    # The same for a 95 % quantile of a length: at most 2.1 of its scale; for a standard deviation: 1/√2; for a mean: 1.
    assert np.abs(found.by_draws_um / other.radius_um - 1.0).max() < 5 * np.sqrt(2.0) * 2.1 * noise
    assert np.abs(u / tool.at(found.positions, sides).standard_um - 1.0).max() < 5 * noise / np.sqrt(2.0)
    assert np.abs(found.bias_um / u).max() < 5 * noise
    assert found.validated.count(False) == 0 and found.validated.count(True) >= 5
    assert found.difference_um[[one is True for one in found.validated]].max() <= found.tolerance_um.max()
    # The mean square over machines and poses is the mean trace: rms² + its variance over the machines.
    mean_square = np.mean(np.sum(u**2, axis=1))
    rms = found.compensated[0]
    assert rms.mean**2 < mean_square < rms.high**2 and rms.low < rms.mean < rms.high < rms.largest
    assert found.compensated[1].mean > rms.mean
    assert found.as_it_is[0].mean == pytest.approx(
        np.sqrt(np.mean(_squares(kinematics, found.positions, sides)) + mean_square), rel=0.02
    )  # the spread of the RMS over the machines, a few per cent of it, lowers the mean by half its square


def _squares(kinematics: Kinematics, q: np.ndarray, sides: np.ndarray) -> np.ndarray:
    zero = Kinematics(kinematics.machine, Calibration.zero(kinematics.machine), tool_length_mm=LENGTH)
    return np.sum((kinematics.forward(q, sides).point_mm - zero.forward(q).point_mm) ** 2, axis=1) * 1e6


def test_a_machine_does_not_depend_on_the_number_of_machines(dmu50: Machine, uncertain: Calibration) -> None:
    draws = draws_of(dmu50, uncertain, poses=40)
    (short, few), (long, more) = seen(draws, 0, 5), seen(draws, 0, 50)
    assert np.array_equal(short, long[:, :, :5])
    assert np.array_equal(few, more[:, :5])


def test_another_seed_gives_other_machines(dmu50: Machine, uncertain: Calibration) -> None:
    kinematics = Kinematics(dmu50, uncertain)
    more = TRIALS_PER_TASK + 1000  # two tasks
    one, same, other = (draw_machines(kinematics, trials=more, poses=5, seed=s, workers=HERE) for s in (1, 1, 2))
    assert json.dumps(one.to_dict()) == json.dumps(same.to_dict())
    assert one.machines == more
    assert not np.array_equal(one.by_draws_um, other.by_draws_um)


def test_where_first_order_is_not_sufficient(dmu50: Machine) -> None:
    """The table tilts by 20 mrad (u): 300 mm away a point also moves by the square of the angle, 300 mm · u²/2 = 60 µm on average."""
    covariance = Covariance(("E_A0B",), read_only(np.array([[2e4**2]])))
    none: MappingProxyType[str, float] = MappingProxyType({})
    calibration = Calibration(dmu50, "test", MappingProxyType({}), none, MappingProxyType({"E_A0B": 0.0}), covariance)
    kinematics = Kinematics(dmu50, calibration, tool_length_mm=300.0)
    found = draw_machines(kinematics, trials=20_000, poses=8, seed=1, workers=HERE)
    assert found.validated.count(False) >= 2
    # The same from sorted draws, pose by pose.
    other = sampled(ToolUncertainty(kinematics), found.positions, np.random.default_rng(7), 20_000)
    agree = [a is b for a, b in zip(found.validated, other.validated, strict=True) if None not in (a, b)]
    assert len(agree) >= 4 and all(agree)
    no = np.array([answer is False for answer in found.validated])
    assert (found.difference_um > found.tolerance_um).any(axis=1)[no].all()
    assert np.linalg.norm(found.bias_um, axis=1)[no].max() > 10.0
    fine = replace(calibration, joint=Covariance(("E_A0B",), read_only(np.array([[1.0]]))))
    small = draw_machines(Kinematics(dmu50, fine, tool_length_mm=300.0), trials=50_000, poses=4, seed=1, workers=HERE)
    assert False not in small.validated


def test_quantiles_from_counts() -> None:
    """Quantiles agree with those of the values to within a bin; outside the bins they are NaN."""
    values = np.sort(np.random.default_rng(3).normal(size=(2, 20_000)) * [[1.0], [5.0]], axis=1)
    lower, upper = np.array([-4.0, -20.0]), np.array([4.0, 20.0])
    edges = [np.linspace(low, high, BINS + 1) for low, high in zip(lower, upper, strict=True)]
    counts = np.array([np.histogram(row, [-np.inf, *edge, np.inf])[0] for row, edge in zip(values, edges, strict=True)])
    histogram = Counts(lower, upper, counts)
    for share in (0.025, 0.5, 0.95):
        wanted = np.quantile(values, share, axis=1)
        assert (np.abs(histogram.quantile(share) - wanted) < (upper - lower) / BINS).all()
    short = Counts(np.array([0.0]), np.array([1.0]), np.array([[30, *[0] * BINS, 70]]))
    assert np.isnan(short.quantile(0.2)[0]) and np.isnan(short.quantile(0.5)[0])


def test_the_command(
    dmu50: Machine, uncertain: Calibration, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def ended(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stopped:
            cli.main(["volume", *(str(argument) for argument in arguments)])
        captured = capsys.readouterr()
        return int(stopped.value.code or 0), captured.out, captured.err

    assert uncertain.joint is not None
    some = replace(uncertain, joint=uncertain.joint.where(lambda name: not name.startswith("E_XX")))
    some.save(tmp_path / "c.yaml")
    out = tmp_path / "v.json"
    few = ("--trials", 2000, "--poses", 5, "--seed", 3, "--workers", 1)
    status, text, _ = ended("-c", tmp_path / "c.yaml", "--tool-length", 120, *few, "--json", out)
    assert status == 0
    data = json.loads(out.read_text())
    kinematics = Kinematics(dmu50, Calibration.load(tmp_path / "c.yaml", dmu50), tool_length_mm=120.0)
    assert data == draw_machines(kinematics, trials=2000, poses=5, seed=3, workers=HERE).to_dict()
    assert f"{data['by_draws']['max_um']:.3f} µm" in text and "2000 machines" in text
    assert "no covariance in the calibration): E_XX" in text
    status, _, error = ended(*few)
    assert status == 2 and "dmu50.calibration.yaml" in error and "covariance" in error and error.count("\n") == 1
    for arguments, word in (
        (["--trials", 10], "1000 … "),
        (["--poses", 0], "1 …"),
        (["--seed", -1], "0 or more"),
        (["--workers", 0], "at least 1"),
        (["--json", tmp_path / "c.yaml"], "another file"),
    ):
        status, _, error = ended("-c", tmp_path / "c.yaml", *arguments)
        assert status == 2 and word in error, error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.yaml", "v.json"]


def test_a_calibration_without_uncertainties_is_refused(dmu50: Machine, calibration: Calibration) -> None:
    with pytest.raises(InputError, match="no machines can be drawn"):
        draw_machines(Kinematics(dmu50, calibration), trials=2000, poses=5, workers=HERE)


def test_statistics_are_those_of_the_machines_drawn(dmu50: Machine, uncertain: Calibration) -> None:
    """Means, standard deviations (n − 1) and maxima of 1500 machines, which are drawn in two steps, at poses in several tiles."""
    trials, poses = MACHINES_PER_STEP + 476, 40
    found = draw_machines(
        Kinematics(dmu50, uncertain, tool_length_mm=LENGTH), trials=trials, poses=poses, seed=6, workers=HERE
    )
    draws = draws_of(dmu50, uncertain, poses=poses, seed=6)
    parts: dict[int, list[np.ndarray]] = {}
    measures = draws.steps.run(0, trials, lambda tile, some: parts.setdefault(tile.start, []).append(some.copy()))
    assert len(parts) > 1 and all(len(steps) == 2 for steps in parts.values())
    values = np.concatenate([np.concatenate(parts[start], axis=2) for start in sorted(parts)], axis=1)
    assert values.shape == (4, poses, trials)
    np.testing.assert_allclose(found.bias_um, values[:3].mean(axis=2).T, atol=1e-9)
    np.testing.assert_allclose(found.standard_um, values[:3].std(axis=2, ddof=1).T, rtol=1e-9)
    squares = np.sum(values[:3] ** 2, axis=0)
    np.testing.assert_allclose(measures[2], np.sqrt(squares.mean(axis=0)), rtol=1e-9)
    np.testing.assert_allclose(measures[3], np.sqrt(squares.max(axis=0)), rtol=1e-9)
    for spread, row in zip((*found.as_it_is, *found.compensated), measures, strict=True):
        assert spread.mean == pytest.approx(row.mean(), rel=1e-9) and spread.largest == pytest.approx(row.max())
        low, high = np.quantile(row, [0.025, 0.975])
        assert [spread.low, spread.high] == pytest.approx([low, high], abs=0.02 * np.ptp(row))
    np.testing.assert_allclose(found.by_draws_um, np.quantile(values[3], 0.95, axis=1), rtol=0.01)


def test_counts_over_bins_are_those_of_a_histogram() -> None:
    rng = np.random.default_rng(4)
    lower, upper = np.array([[-3.0, 0.0], [10.0, -1e-3]]), np.array([[3.0, 1.0], [70.0, 2e-3]])
    values = lower[..., None] + (upper - lower)[..., None] * rng.uniform(-0.1, 1.1, (2, 2, 5000))
    found = binned(values, lower, upper)
    for place in np.ndindex(2, 2):
        edges = [-np.inf, *np.linspace(lower[place], upper[place], BINS + 1), np.inf]
        # A value within rounding of an edge may fall on either side of it.
        assert np.abs(found[place] - np.histogram(values[place], edges)[0]).sum() <= 2


def test_too_few_draws_do_not_decide(dmu50: Machine, uncertain: Calibration) -> None:
    """Two digits need limits to half a unit of the second digit, and a thousand draws give them to 8 %: neither yes nor no.

    First order is exact here to all digits that count, so that every no is wrong; it was one pose in four with two standard errors.
    """
    kinematics = Kinematics(dmu50, uncertain, tool_length_mm=LENGTH)
    answers = [
        answer
        for seed in range(8)
        for answer in draw_machines(kinematics, trials=1000, poses=5, seed=seed, digits=2, workers=HERE).validated
    ]
    # Five in a hundred at most, less than four of forty in 99.9 % of cases were they independent; poses of a seed are not.
    assert answers.count(True) == 0 and answers.count(False) <= 4
