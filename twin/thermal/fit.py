"""Fit a thermal model to a record and estimate its error on unseen data from parts of the record that were not fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.resources import one_blas_thread, silent
from twin._common.units import count_with_noun
from twin.thermal.evidence import (
    STEPS,
    Average,
    DrawnModels,
    Evidence,
    Inputs,
    TermCandidate,
    averaged,
    candidates,
    clusters,
    drivers,
    features,
    sensor_groups,
)
from twin.thermal.model import DisplacementModel, ThermalModel, ThermalTerm
from twin.thermal.record import ThermalRecord

CERTAIN: Final = 0.95
"""Share of the models above which an input has no alternatives."""
LISTED: Final = 1.0
"""Least contribution of a term that matters, in standard deviations of the residual."""


def input_name(term: TermCandidate) -> str:
    """Return the name of the input that a candidate follows."""
    if term.sensors:
        return term.sensors[0] if len(term.sensors) == 1 else f"group {', '.join(term.sensors)}"
    return "drift" if term.effect == "thermal_drift" else "speed"


def named_terms(
    displacement: str,
    candidates: Sequence[TermCandidate],
    x: np.ndarray,
    draws: DrawnModels,
    average: Average,
    factor: float,
) -> tuple[ThermalTerm, ...]:
    """Return the terms of a displacement, by falling contribution.

    ``x``: candidates over the fitted rows (n, candidates); ``factor``: factor of the standard uncertainties, from held-out data.
    """
    families: dict[tuple[str, str], list[int]] = {}
    for j, term in enumerate(candidates):
        families.setdefault((term.effect, input_name(term)), []).append(j)
    followed = [{input_name(candidates[j]) for j in model} for model in draws.models]
    found = []
    for (effect, name), members in families.items():
        index = np.array(members)
        weight = average.mean[index] ** 2 + np.diag(average.covariance)[index]
        if weight.sum() <= 0.0:
            continue
        weight = weight / weight.sum()
        tau = np.array([candidates[j].time_constant_s for j in members])
        centre = float(weight @ tau)
        moved = x[:, index] @ average.mean[index]
        share, others = _share(name, followed)
        contribution = float(moved.std())
        found.append(
            ThermalTerm(
                effect=effect,
                name=f"{displacement} by {name}" if candidates[members[0]].sensors else displacement,
                input=name,
                coefficient=float(average.mean[index].sum()),
                standard_uncertainty=factor * float(np.sqrt(max(average.covariance[np.ix_(index, index)].sum(), 0.0))),
                time_constant_s=centre,
                u_time_constant_s=float(np.sqrt(weight @ (tau - centre) ** 2)),
                exponent=float(weight @ [candidates[j].exponent for j in members])
                if effect.startswith("spindle")
                else None,
                share=share,
                alternatives=others,
                contribution_um=contribution,
                matters=contribution > LISTED * average.residual_um,
            )
        )
    return tuple(sorted(found, key=lambda term: -term.contribution_um))


def _share(name: str, followed: Sequence[set[str]]) -> tuple[float, tuple[str, ...]]:
    """Return the share of the models that follow an input, and the inputs that the others follow clearly more often."""
    having = [names for names in followed if name in names]
    lacking = [names for names in followed if name not in names]
    share = len(having) / len(followed)
    if not lacking or share > CERTAIN:
        return share, ()
    found = []
    for other in sorted({one for names in lacking for one in names}):
        without = sum(other in names for names in lacking) / len(lacking)
        beside = sum(other in names for names in having) / max(len(having), 1)
        if having and without > 0.3 and without > beside + 0.15:
            found.append((beside - without, other))
    return share, tuple(other for _, other in sorted(found))


# --- Fit a thermal model to a record and estimate its error on unseen data from parts of the record that were not fitted

PARTS: Final = 139
"""The record is averaged to some 140 rows: shorter changes are noise to the lags of the candidates."""
LEAST_ROWS: Final = 60
FORWARD_SHARES: Final = (0.4, 0.55, 0.7)
"""Shares of the record that are fitted to predict the rest."""
BLOCKS: Final = 5
"""Number of blocks of time of which each is left out once; the part before them, from whose start everything counts, never is."""
LONG_CHAIN: Final = 4
"""Length of the chain of the final fit, in those of the validation."""
KEPT_VARIANCE: Final = 0.99
"""Share of the variance of predictions that a model file keeps."""


@final
@dataclass(frozen=True)
class AveragedRecord:
    """A record in the form that is fitted, averaged to fewer rows; the white noise is that of the averages."""

    record: ThermalRecord
    terms: tuple[TermCandidate, ...]
    inputs: Inputs
    groups: tuple[tuple[str, ...], ...]
    together: tuple[tuple[int, ...], ...]
    x: np.ndarray
    y: np.ndarray
    time_s: np.ndarray
    noise_um: np.ndarray
    duration_s: float
    notices: tuple[str, ...]


Fitted = list[tuple[tuple[int, ...], DrawnModels]]
"""The displacements of every group, and their models."""


@final
@dataclass(frozen=True)
class HeldOutErrors:
    """Errors of models on averaged rows that they were not fitted to (displacements,).

    ``between``: (displacements, terms + 1, terms + 1) covariance of the coefficients by their changes without one block of time.
    """

    factor: np.ndarray
    blocks_um: np.ndarray
    forward_um: np.ndarray
    between: np.ndarray


def fit_thermal(
    record: ThermalRecord, *, validate: bool = True, seed: int = 0, progress: Callable[[str, float], None] = silent
) -> ThermalModel:
    """Fit a thermal model with few terms.

    The candidates are lags of each group of sensors, lags of the spindle speed and its square, both without lag, and a decaying drift.
    The prediction is the average over all subsets that the data allow (`twin.thermal.evidence`); its uncertainty counts what they
    disagree on. The terms sum the candidates of one input. Held-out blocks of time calibrate the uncertainty.

    Args:
        record: the record, with displacements.
        validate: whether the error on held-out blocks of time is found and calibrates the uncertainty.
        seed: random seed.
        progress: called with the stage and the share done.

    Raises:
        InputError: no displacement, too few rows, a displacement that does not vary, no sensor that varies and no speed.

    Examples:
        >>> time_s = np.arange(0.0, 21600.0, 300.0)
        >>> bed_degC = 20.0 + 2.0 * np.sin(time_s / 3000.0)
        >>> z_um = 6.0 * (bed_degC - 20.0) + np.random.default_rng(1).normal(0.0, 0.2, len(time_s))
        >>> rows = np.column_stack([time_s, bed_degC, z_um])
        >>> np.savetxt("day.csv", rows, delimiter=",", header="time_s,T_bed_degC,Z_um", comments="")
        >>> record = twin.ThermalRecord.load("day.csv")
        >>> model = twin.fit_thermal(record, validate=False)
        >>> model.predict(record).rms_um.round(1)  # residuals, µm
        array([0.2])

    References:
        - C. E. Rasmussen, C. K. I. Williams: Gaussian Processes for Machine Learning, MIT Press, 2006, eq. 2.43 to 2.45.
        - D. Madigan, J. York: Bayesian graphical models for discrete data, Int. Statist. Rev. 63 (1995) 215-232.
        - J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky: Bayesian model averaging: a tutorial, Statist. Sci. 14 (1999)
          382-417.
    """
    problem = _problem(record)
    progress("fitting", 0.0)
    with one_blas_thread():
        fitted = _fit(problem, np.arange(len(problem.x)), seed, steps=LONG_CHAIN * STEPS)
        held_out = _held_out(problem, seed, progress) if validate else None
        return _model(problem, fitted, held_out)


def _problem(record: ThermalRecord) -> AveragedRecord:
    if not record.displacements:
        raise InputError("no displacement", expected="columns <name>_um", file=record.path)
    if len(record) < LEAST_ROWS:
        raise InputError(
            count_with_noun(len(record), "row"), expected=f"at least {LEAST_ROWS} rows to fit", file=record.path
        )
    for k, name in enumerate(record.displacements):
        if np.ptp(record.displacement_um[:, k]) == 0.0:
            expected = "readings that vary; a constant reading suggests that the sensor does not work"
            raise InputError(f"displacement {name} is constant", expected=expected, file=record.path)
    length = max(1, len(record) // PARTS)
    groups, flat = sensor_groups(record, length)
    top = 0.0 if record.speed_rpm is None else float(record.speed_rpm.max())
    speeds = record.speed_rpm is not None and bool(np.ptp(record.speed_rpm) > 0.0)
    if not groups and not speeds:
        raise InputError("no input varies", expected="a temperature or the speed to vary", file=record.path)
    first = {name: float(record.temperature_degC[0, i]) for i, name in enumerate(record.sensors)}
    inputs = Inputs(first, top, float(record.time_s[0]))
    duration = float(np.ptp(record.time_s))
    terms = tuple(candidates(groups, speeds, duration))
    y = averaged(record.displacement_um, length)
    together = clusters(y, record.displacements)
    notices = [f"sensor {name} does not vary and is not used" for name in flat]
    return AveragedRecord(
        record,
        terms,
        inputs,
        tuple(groups),
        tuple(tuple(record.displacements.index(name) for name in group) for group in together),
        averaged(features(record, terms, inputs), length),
        y,
        averaged(record.time_s[:, None], length)[:, 0],
        np.diff(record.displacement_um, 2, axis=0).std(axis=0) / np.sqrt(6.0 * length),
        duration,
        (*record.notices, *notices),
    )


def _fit(problem: AveragedRecord, rows: np.ndarray, seed: int, *, steps: int = STEPS) -> Fitted:
    """Fit the averaged rows of these indices."""
    found: Fitted = []
    for group in problem.together:
        columns = list(group)
        evidence = Evidence(
            problem.x[rows],
            problem.y[np.ix_(rows, np.array(columns))],
            problem.time_s[rows],
            problem.terms,
            problem.noise_um[columns],
            problem.duration_s,
        )
        found.append((group, evidence.draw(np.random.default_rng(seed), steps)))
    return found


def _held_out(problem: AveragedRecord, seed: int, progress: Callable[[str, float], None]) -> HeldOutErrors:
    """Fit parts of the record and compare the errors on the rest with the uncertainty."""
    count = len(problem.x)
    folds = [np.arange(count) >= round(share * count) for share in FORWARD_SHARES]
    folds += [np.isin(np.arange(count), block) for block in np.array_split(np.arange(count), BLOCKS + 1)[1:]]
    top = _highest_speed_left_out(problem)
    if top is not None:
        folds.append(top)
    fitted = []
    for i, left_out in enumerate(folds):
        progress("validating", (i + 1) / (len(folds) + 1))
        fitted.append(_fit(problem, np.flatnonzero(~left_out), seed))
    forward, blocks = slice(0, len(FORWARD_SHARES)), slice(len(FORWARD_SHARES), len(FORWARD_SHARES) + BLOCKS)
    between = _between_parts(problem, fitted[blocks])
    found = [_errors(problem, one, left_out, between) for one, left_out in zip(fitted, folds, strict=True)]
    squares = np.array([(error**2).mean(axis=0) for error, _ in found])
    ratios = squares / np.array([variance.mean(axis=0) for _, variance in found])
    # Errors last for hours, so that each part that follows is about one reading of their size: the largest ratio is taken.
    factor = np.sqrt(ratios[forward].max(axis=0))
    held_out_um = np.sqrt(squares[blocks].mean(axis=0))
    return HeldOutErrors(factor, held_out_um, np.sqrt(squares[forward]), between)


def _between_parts(problem: AveragedRecord, fitted: Sequence[Fitted]) -> np.ndarray:
    """Return the covariance of the coefficients by the jackknife over blocks of time (displacements, terms + 1, terms + 1).

    A machine does not respond to every start of its spindle alike; the residuals of a fit, in which lags of many sensors follow the
    differences, do not show that. ``fitted``: models of the record without one of its blocks. H. R. Künsch, Ann. Statist. 17 (1989)
    1217-1241.
    """
    size = len(problem.terms) + 1
    between = np.empty((problem.y.shape[1], size, size))
    for number, group in enumerate(problem.together):
        for k, displacement in enumerate(group):
            means = np.array([one[number][1].averages[k].mean for one in fitted])
            away = means - means.mean(axis=0)
            between[displacement] = (len(away) - 1) / len(away) * away.T @ away
    return between


def _highest_speed_left_out(problem: AveragedRecord) -> np.ndarray | None:
    """Return the averaged rows from each start of the highest speed until another speed starts; None without two speeds."""
    speed = problem.record.speed_rpm
    if speed is None or len(np.unique(speed[speed > 0.0])) < 2:
        return None
    last, found = 0.0, np.zeros(len(speed), dtype=bool)
    for i, value in enumerate(speed):
        last = value if value > 0.0 else last
        found[i] = last == speed.max()
    length = len(speed) // len(problem.x)
    rows = averaged(found[:, None].astype(float), length)[:, 0] > 0.0
    return None if rows.mean() > 0.5 else rows


def _errors(
    problem: AveragedRecord,
    fitted: Fitted,
    rows: np.ndarray,
    between: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return measured minus predicted, and the variance expected, at averaged rows (m, displacements).

    ``between``: covariance of the coefficients that is added to that of the models.
    """
    x = np.c_[problem.x[rows], np.ones(int(rows.sum()))]
    error, variance = np.empty((len(x), problem.y.shape[1])), np.empty((len(x), problem.y.shape[1]))
    for group, draws in fitted:
        for displacement, average in zip(group, draws.averages, strict=True):
            error[:, displacement] = problem.y[rows, displacement] - x @ average.mean
            covariance = average.covariance if between is None else average.covariance + between[displacement]
            spread = np.einsum("ij,jk,ik->i", x, covariance, x)
            variance[:, displacement] = spread + average.residual_um**2
    return error, variance


def _model(problem: AveragedRecord, fitted: Fitted, held_out: HeldOutErrors | None) -> ThermalModel:
    record = problem.record
    found: dict[int, DisplacementModel] = {}
    for group, draws in fitted:
        for k, displacement in enumerate(group):
            found[displacement] = _displacement(problem, displacement, draws, k, held_out)
    used = [name for group in problem.groups for name in group]
    columns = [record.sensors.index(name) for name in used]
    values = record.temperature_degC[:, columns]
    all_features = features(record, problem.terms, problem.inputs)
    driven = drivers(record, problem.terms, problem.inputs)
    lag = driven - all_features
    drift = np.array([term.effect == "thermal_drift" for term in problem.terms])
    return ThermalModel(
        record.path,
        problem.terms,
        problem.inputs,
        tuple(found[k] for k in range(len(record.displacements))),
        read_only(np.stack([values.min(axis=0), values.max(axis=0)], axis=1) if used else np.empty((0, 2))),
        tuple(used),
        problem.groups,
        float(record.time_s[-1]),
        record.interval_s,
        read_only(all_features[-1]),
        read_only(driven[-1]),
        read_only(np.where(drift, 0.0, lag.std(axis=0))),
        problem.notices,
    )


def _displacement(
    problem: AveragedRecord, displacement: int, draws: DrawnModels, k: int, held_out: HeldOutErrors | None
) -> DisplacementModel:
    average = draws.averages[k]
    if held_out is not None:
        average = replace(average, covariance=average.covariance + held_out.between[displacement])
    name = problem.record.displacements[displacement]
    factor = 1.0 if held_out is None else float(held_out.factor[displacement])
    return DisplacementModel(
        name,
        named_terms(name, problem.terms, problem.x, draws, average, factor),
        read_only(average.mean),
        average.residual_um,
        float("nan") if held_out is None else float(held_out.blocks_um[displacement]),
        () if held_out is None else tuple(float(value) for value in held_out.forward_um[:, displacement]),
        factor,
        read_only(_directions(average.covariance, np.r_[problem.x.std(axis=0), 1.0])),
    )


def _directions(covariance: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return the fewest rows whose products sum to nearly the covariance, for candidates that vary by ``scale``.

    The largest component of each is positive, so that the sign in a file does not depend on the processor.
    """
    safe = np.maximum(scale, 1e-6)
    value, vector = np.linalg.eigh(covariance * np.outer(safe, safe))
    value, vector = np.maximum(value[::-1], 0.0), vector[:, ::-1]
    vector = vector * np.sign(np.take_along_axis(vector, np.abs(vector).argmax(axis=0)[None], axis=0))
    count = int(np.searchsorted(np.cumsum(value), KEPT_VARIANCE * value.sum())) + 1
    return (vector[:, :count] * np.sqrt(value[:count] / KEPT_VARIANCE)).T / safe
