"""Whether the calibration is still good: the error that its present deviations cause at the tool, over the volume."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin._common.arrays import read_only
from twin._common.progress import Progress, silent
from twin.comparison.tool import JudgedErrors, Remaining
from twin.comparison.tool import at_tool as change_at_tool
from twin.identification.constant_errors import constant_unknowns
from twin.machine.calibration import Calibration
from twin.machine.machine import Machine
from twin.watching.change import WatchedError
from twin.watching.check import Check, to_units

FALSE_ALARM_SHARE: Final = 0.05
"""For the test of the comparison, which the watch does not use."""


def levels(findings: Sequence[WatchedError], checks: Sequence[Check]) -> tuple[np.ndarray, np.ndarray]:
    """Return the deviations of the errors at the last check, and their covariance.

    The instrument's uncertainty of one check may be common to all checks, so it is not reduced by their number. The
    standard deviation between checks beyond it is.

    Returns:
        (k,) deviations and (k, k) covariance, µm, µrad and µm/m.
    """
    value = np.array([one.level for one in findings])
    found = np.zeros((len(findings), len(findings)))
    for i, one in enumerate(findings):
        for j, other in enumerate(findings):
            common = [
                checks[c].covariance[checks[c].errors.index(one.series.name), checks[c].errors.index(other.series.name)]
                for c in np.intersect1d(one.series.checks, other.series.checks)
            ]
            found[i, j] = float(np.mean(common)) if common else 0.0
        own = float(np.mean(one.series.u**2))
        between = max(one.repeatability**2 - own, 0.0) if np.isfinite(one.repeatability) else 0.0
        apart = np.abs(np.subtract.outer(np.arange(len(one.weights)), np.arange(len(one.weights))))
        found[i, i] += between * float(one.weights @ one.series.correlation**apart @ one.weights)
    return value, _positive(found)


def remaining_error(
    machine: Machine,
    findings: Sequence[WatchedError],
    checks: Sequence[Check],
    *,
    tool_length_mm: float | None,
    progress: Progress = silent,
) -> Remaining:
    """Return the error at the tool that remains if the calibration compensates the machine as the checks show it now.

    It contains the deviations of the errors that the checks determine, and their uncertainty; not those of the other errors.

    Raises:
        InputError: no pose of the machine can be evaluated.
    """
    value, covariance = levels(findings, checks)
    after = deviations(machine, {one.series.name: v for one, v in zip(findings, value, strict=True)}, covariance)
    names = [effect.name for effect in after.effects]
    judged = JudgedErrors(dict.fromkeys(names, "deviations"), names, FALSE_ALARM_SHARE, {}, True)
    before = Calibration.zero(machine)
    return change_at_tool(before, after, judged, tool_length_mm=tool_length_mm, progress=progress).left


def deviations(machine: Machine, by_name: Mapping[str, float], covariance: np.ndarray) -> Calibration:
    """Return deviations of constant errors as a calibration.

    Args:
        machine: the machine.
        by_name: deviations, µm, µrad and µm/m of a scale.
        covariance: (k, k) in that order.
    """
    unknowns = constant_unknowns(machine, machine.names)
    labels = [*(curve.name for curve in unknowns.curves), *unknowns.constants]
    at = [labels.index(name) for name in by_name]
    rate = np.zeros((len(unknowns), len(at)))
    rate[at, range(len(at))] = 1.0 / to_units(unknowns)[at]
    theta = rate @ np.array(list(by_name.values()))
    return unknowns.calibration(theta, at, "deviations", read_only(rate @ covariance @ rate.T))[0]


def _positive(matrix: np.ndarray) -> np.ndarray:
    """Return the nearest covariance without negative eigenvalues; checks of different kinds may leave some."""
    size = np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(size, size))
