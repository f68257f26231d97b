"""Blockwise inner products equal those computed from full signatures, with any points held out and for any number of points."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.battery import Searcher, _doubted, basis_of
from tests.truth import hidden
from tests.truth.hidden import Hidden
from twin._common.arrays import read_only
from twin.diagnosis import diagnose, signature_products
from twin.diagnosis import patterns as pattern_scores
from twin.diagnosis.candidates.candidate import effect_columns
from twin.diagnosis.cross_validation import choose_folds
from twin.diagnosis.forms import FALSE_ALARM_RATE, SAMPLED_POINTS
from twin.diagnosis.likelihood import scan_patterns
from twin.diagnosis.patterns import Pattern, PatternScores
from twin.diagnosis.problem import Problem, Products
from twin.diagnosis.readings import readings
from twin.diagnosis.signature_products import PointBlock, Signatures
from twin.machine.machine import Machine
from twin.measurement.observation import machine_state
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.numerics.covariance import Covariance

EFFECTS = (Hidden("reversal", "Y", {"size": 6.0}), Hidden("squareness", "E_A0Z", {"angle": 12.0}))


def measured(machine: Machine, folder: Path, poses: int, seed: int = 3) -> Measurements:
    rng = np.random.default_rng(seed)
    plan = hidden.rounded(hidden.plan(rng, poses=poses, same=False))
    read = hidden.noisy(hidden.points(plan, EFFECTS), rng, "isotropic", 3e-3)
    return Measurements.load(hidden.write(folder / "measured.csv", plan, read, u_mm=3e-3), machine)


def split(problem: Problem) -> np.ndarray:
    """(n,) the part each reading is held out with."""
    found = choose_folds(problem.network.data, problem.network.machine, ())
    assert found is not None
    return found.fold


@pytest.fixture(scope="module")
def searched(dmu50: Machine, tmp_path_factory: pytest.TempPathFactory) -> tuple[Problem, Searcher]:
    """Return a problem of some 900 points with an uncertain calibration, and its search."""
    data = measured(dmu50, tmp_path_factory.mktemp("data"), 40)
    placed = readings(data, dmu50, _doubted(Calibration.default(dmu50)))
    task = placed.without(placed.bad)
    return task.problem, Searcher(task)


@pytest.fixture(scope="module")
def whole(searched: tuple[Problem, Searcher]) -> np.ndarray:
    """Return all signatures (3n, columns) at all points."""
    problem, searcher = searched
    return problem.signature(searcher.candidates.products.columns)


def close(found: np.ndarray, truth: np.ndarray, size: np.ndarray | float) -> None:
    assert np.abs(found - truth).max() <= 1e-11 * np.max(size)


def test_inner_products_with_vectors_by_part(searched: tuple[Problem, Searcher], whole: np.ndarray) -> None:
    problem, searcher = searched
    parts = split(problem)
    rng = np.random.default_rng(1)
    vectors = rng.standard_normal((len(parts), 3, 70))
    found = Signatures(problem.view, searcher.candidates.products.columns, parts).along(
        lambda block: vectors[block.rows]
    )
    assert len(found) == parts.max() + 1 > 1
    for part, own in enumerate(found):
        rows = np.repeat(parts == part, 3)
        close(own, whole[rows].T @ vectors.reshape(-1, 70)[rows], np.linalg.norm(whole))
    some = np.sort(rng.choice(len(parts), 100, replace=False))
    few = searcher.candidates.products.signatures.along(lambda block: vectors[block.rows], some)
    rows = (3 * some[:, None] + np.arange(3)).ravel()
    close(few[0], whole[rows].T @ vectors.reshape(-1, 70)[rows], np.linalg.norm(whole))


def test_inner_products_with_interpolated_waves(
    searched: tuple[Problem, Searcher], whole: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Values that are too many to be cached are interpolated between nodes, with an error of 1e-12 of the largest."""
    problem, searcher = searched
    monkeypatch.setattr(signature_products, "LARGEST_CACHE", 0)
    columns = searcher.candidates.products.columns
    signatures = Signatures(problem.view, columns, split(problem))
    assert signatures._interpolated
    rng = np.random.default_rng(6)
    for width in (3, 70):
        vectors = rng.standard_normal((len(problem.view.rows), 3, width))
        found = signatures.along(lambda block, own=vectors: own[block.rows]).sum(axis=0)
        close(found, whole.T @ vectors.reshape(-1, width), np.linalg.norm(whole))
    some = np.arange(0, len(columns), 29)
    found = signatures.at(PointBlock(problem.view, slice(None)), some.tolist())
    close(found.reshape(len(whole), -1), whole[:, some], np.abs(whole).max())


def test_inner_products_within_forms(searched: tuple[Problem, Searcher], whole: np.ndarray) -> None:
    _, searcher = searched
    candidates = searcher.candidates
    for columns, blocks in zip(candidates._columns, candidates.products.within, strict=True):
        for own, block in zip(columns[::17], blocks[::17], strict=True):
            close(block, whole[:, own].T @ whole[:, own], np.abs(block).max() + 1e-30)


def test_projection_of_set_up_and_calibration(searched: tuple[Problem, Searcher], whole: np.ndarray) -> None:
    """Against an orthonormal basis of the whole matrix by singular values: the definition."""
    problem, searcher = searched
    nuisance, prior = problem.nuisance, (problem.nuisances.prior @ problem.nuisances.coordinates)
    some = whole[:, ::97]
    for out in (None, *range(3)):
        gone = np.zeros(len(problem.view.rows), dtype=bool) if out is None else split(problem) == out
        keep = np.where(np.repeat(gone, 3), 0.0, 1.0)
        part = problem if out is None else problem.without(gone)
        assert part is not None
        u, values, _ = np.linalg.svd(np.concatenate([nuisance * keep[:, None], prior]), full_matrices=False)
        basis = u[: len(nuisance), values > 1e-9 * values[0]]
        kept = some * keep[:, None]
        truth = kept.T @ kept - (basis.T @ kept).T @ (basis.T @ kept)
        size = np.linalg.norm(kept, axis=0).max() ** 2
        found = part.products(searcher.candidates.products.columns[::97])
        assert np.abs(found.gram - truth).max() <= 1e-10 * size
        assert np.abs(part.inner(some) - truth).max() <= 1e-10 * size
        residual = problem.residual * keep
        slope = kept.T @ residual - (basis.T @ kept).T @ (basis.T @ residual)
        assert np.abs(found.slope - slope).max() <= 1e-9 * np.linalg.norm(residual) * np.sqrt(size)
        assert part.chi2 == pytest.approx(residual @ residual - np.sum((basis.T @ residual) ** 2), rel=1e-9)


def test_a_doubt_too_small_to_show_is_not_lost(dmu50: Machine, searched: tuple[Problem, Searcher]) -> None:
    """A direction determined by the prior alone does not prevent holding readings out."""
    problem, _ = searched
    doubted = _doubted(Calibration.default(dmu50))
    assert doubted.joint is not None
    matrix = np.array(doubted.joint.matrix)
    matrix[::2] *= 1e-9
    matrix[:, ::2] *= 1e-9
    small = replace(doubted, joint=Covariance(doubted.joint.names, read_only(matrix)))
    again = Problem(problem.network, problem.setup, small)
    for part in range(3):
        assert again.without(split(problem) == part) is not None


@pytest.mark.parametrize("which", ["a part", "any points"])
def test_inner_products_without_some_points(searched: tuple[Problem, Searcher], whole: np.ndarray, which: str) -> None:
    problem, searcher = searched
    parts = split(problem)
    products = Products(problem, searcher.candidates.products.columns, searcher.candidates._columns, parts=parts)
    gone = np.flatnonzero(parts == 1)
    if which == "any points":
        gone = np.sort(np.random.default_rng(2).choice(len(parts), 60, replace=False))
    left = products.without(gone)
    rows = np.repeat(~np.isin(np.arange(len(parts)), gone), 3)
    columns = np.arange(0, whole.shape[1], 211)
    size = np.linalg.norm(whole) ** 2
    close(left.cross(columns), whole[rows][:, columns].T @ whole[rows], size)
    close(left.on_basis(problem.root), problem.root.T @ (basis_of(problem)[rows].T @ whole[rows]), size)
    close(left.by_residual, whole[rows].T @ problem.residual[rows], size)


def test_replacing_a_column(searched: tuple[Problem, Searcher], whole: np.ndarray) -> None:
    problem, searcher = searched
    candidates = searcher.candidates
    products = Products(problem, candidates.products.columns, candidates._columns)
    alone = np.array([candidates.forms[i].columns[0] for i in candidates._rows[0][:2]])
    products.cross(np.array([0, 5, 9]))
    products.replace(alone[:1], [products.columns[int(alone[1])]])
    changed = np.array(whole)
    changed[:, alone[0]] = whole[:, alone[1]]
    asked = np.array([0, int(alone[0]), 9])
    close(products.cross(asked), changed[:, asked].T @ changed, np.linalg.norm(whole) ** 2)
    assert not np.array_equal(changed, whole) or alone[0] == alone[1]


def test_columns_equal_the_derivatives_of_their_effects(searched: tuple[Problem, Searcher]) -> None:
    """Columns evaluated together agree with the effects, parameter by parameter."""
    problem, searcher = searched
    machine, data = problem.network.machine, problem.network.data
    state, block = machine_state(data, machine), PointBlock(problem.view, slice(None))
    seen = set()
    for candidate in searcher.task.catalogue.candidates:
        if candidate.build is None:
            continue
        for variant in (candidate.variants[0], candidate.variants[-1]):
            # Decreasing: a load then has its centre within the possible range.
            values = np.linspace(1.3, 0.7, len(variant.columns))
            effects = candidate.build(values, variant.fixed)
            own = Signatures(problem.view, variant.columns).at(block)
            found = own @ (values / np.array([column.scale for column in variant.columns]))
            truth = np.zeros_like(found)
            for effect in effects:
                columns = effect_columns(effect, machine, state)
                at = 6 * next(
                    i
                    for i, f in enumerate(machine.frames)
                    if (f.axis, f.role) == (effect.frame.axis, effect.frame.role)
                )
                for i, part in effect.components(state).items():
                    truth += problem.view.by_error[:, :, at + i] * (np.broadcast_to(part, len(found))[:, None] * 1e-6)
                assert len(columns) == len(effect.parameters)
            assert np.abs(found - truth).max() <= 1e-9 * max(np.abs(truth).max(), 1e-12), (candidate.key, variant.fixed)
            seen.add(candidate.effect)
    assert {"pitch_error", "harmonic", "positioning", "thermal_drift", "misplaced", "reversal"} <= seen


@pytest.mark.slow
def test_the_price_of_the_search_from_some_of_the_points(dmu50: Machine, tmp_path: Path) -> None:
    """For more points than it was estimated from, it is as on other data of that kind."""
    levels = []
    for poses in (SAMPLED_POINTS // 6 - 120, SAMPLED_POINTS // 3):
        data = measured(dmu50, tmp_path, poses)
        placed = readings(data, dmu50, Calibration.default(dmu50))
        task = placed.without(placed.bad)
        levels.append(Searcher(task).candidates.level)
    assert min(levels) >= FALSE_ALARM_RATE
    assert levels[0] == pytest.approx(levels[1], rel=0.5)


MEMORY = """
import sys
from pathlib import Path
from tests.benchmarks.timing import peak_mb
from twin.diagnosis import diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
machine = Machine.load("dmu50")
found = diagnose(Measurements.load(Path(sys.argv[1]), machine), machine)
print(peak_mb(), *(f"{c.effect}:{c.where}" for c in found.causes))
"""


@pytest.mark.slow
def test_memory_grows_at_most_in_proportion_to_the_points(dmu50: Machine, tmp_path: Path) -> None:
    """Less than 12 kB for each point (10.7 kB measured); signatures of all forms would take 150 kB."""
    peaks = []
    for poses in (2_000, 16_000):
        measured(dmu50, tmp_path, poses)
        output = subprocess.run(
            [sys.executable, "-c", MEMORY, str(tmp_path / "measured.csv")],
            check=True,
            capture_output=True,
            text=True,
            cwd=Path(__file__).resolve().parents[2],
        ).stdout.split()
        assert {"reversal:Y", "squareness:E_A0Z"} == set(output[1:])
        peaks.append(float(output[0]))
    assert peaks[1] < 2000.0
    assert (peaks[1] - peaks[0]) * 1024.0 / (6 * 14_000) < 12.0


@pytest.mark.slow
def test_many_points_are_diagnosed_as_few(dmu50: Machine, tmp_path: Path) -> None:
    """With more points than a block or the sample for the level: the same names, sizes within their uncertainty."""
    found = diagnose(measured(dmu50, tmp_path, 1_000), dmu50)
    assert {(cause.effect, cause.where) for cause in found.causes} == {effect.key for effect in EFFECTS}
    for cause in found.causes:
        (size,) = cause.parameters
        truth = next(
            iter(next(effect for effect in EFFECTS if effect.key == (cause.effect, cause.where)).numbers.values())
        )
        assert abs(size.value - truth) < 3.0 * size.u
    assert found.gain is not None and found.gain.held_out is not None
    assert found.gain.held_out.after_um == pytest.approx(3.0, rel=0.02)


def dense_scores(problem: Problem, pattern: Pattern, causes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (3, m) φᵀMr and (3, m, m) φᵀMφ with M as a matrix, the causes projected out of it."""
    rows = np.arange(len(problem.residual))
    keep = ~np.isin(rows // 3, problem.held_out)
    basis = np.where(keep[:, None], basis_of(problem) @ problem.root, 0.0)
    m = np.diag(keep.astype(float)) - basis @ basis.T
    m -= m @ causes @ np.linalg.pinv(causes.T @ m @ causes, rcond=1e-10) @ causes.T @ m
    functions = [problem.signature(pattern.columns(99, [i])) for i in range(3)]
    return np.stack([f.T @ m @ problem.residual for f in functions]), np.stack([f.T @ m @ f for f in functions])


@pytest.mark.slow
@pytest.mark.parametrize("held_out", [False, True])
def test_scores_of_patterns_beside_an_uncertain_calibration(searched: tuple[Problem, Searcher], held_out: bool) -> None:
    """With the calibration's uncertainty the projection is not idempotent; a cause beside it is projected out all the same."""
    problem, searcher = searched
    part = problem.without(split(problem) == 1) if held_out else problem
    assert part is not None
    form = next(one for one in searcher.candidates.forms if one.key == ("reversal", "Y"))
    scores = PatternScores(part, [form], searcher.patterns)
    for pattern in searcher.patterns[:40:13]:
        slope, gram = scores.of(pattern)
        true_slope, true_gram = dense_scores(part, pattern, part.signature(form.variant.columns))
        size = np.abs(true_gram).max()
        assert np.abs(gram - true_gram).max() <= 1e-9 * size
        assert np.abs(slope - true_slope).max() <= 1e-9 * np.sqrt(size) * np.linalg.norm(part.residual)


def test_a_sample_gives_the_same_significant_patterns(
    searched: tuple[Problem, Searcher], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scores are those of all readings; of the mean and variance for noise alone, a third of the readings gives nine tenths."""
    problem, searcher = searched
    whole = scan_patterns(problem, searcher.patterns, (), np.inf)
    of_whole = PatternScores(problem, (), searcher.patterns)
    monkeypatch.setattr(pattern_scores, "READINGS_SAMPLED", 300)
    some = scan_patterns(problem, searcher.patterns, (), np.inf)
    of_some = PatternScores(problem, (), searcher.patterns)
    for pattern in searcher.patterns[::11]:
        (slope, gram), (all_slope, all_gram) = of_some.of(pattern), of_whole.of(pattern)
        assert np.allclose(slope, all_slope, rtol=1e-9, atol=1e-9 * np.abs(all_slope).max())
        assert np.linalg.eigvalsh(gram).min() >= -1e-9 * np.abs(gram).max()
        assert np.trace(gram, axis1=1, axis2=2) == pytest.approx(np.trace(all_gram, axis1=1, axis2=2), rel=0.2)
    # Those evaluated exactly have the same p-value, and the most significant ones are among them.
    exact = {id(one.pattern): one.log_p for one in whole[:4]}
    assert [exact.get(id(one.pattern)) for one in some[:4]] == pytest.approx([one.log_p for one in some[:4]], rel=1e-9)
