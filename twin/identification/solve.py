"""Whitened nonlinear least squares, its rank judged by what is plausible, its covariance honest where the data are silent.

Every unknown is counted in its plausible size (a millimetre or milliradian for an error, `setup` for the rest). In these units a
direction in which the data say less than that is no finding: it is left where it was, and the covariance carries the plausible size
itself. That is the limit of a Gaussian prior that never pulls on what is measured (so that no residual is regularised away).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, final

import numpy as np

from twin.determinability import WEAKEST, Determinability, Spectrum, Unknown, decompose
from twin.effects import unit_of
from twin.identification.network import Network
from twin.identification.network import triangle as factor
from twin.identification.setup import SetUp
from twin.identification.unknowns import PLAUSIBLE, Column, Unknowns
from twin.units import MM, URAD

FIRM: Final = 1e9
"""Weight of a condition of the datum where it stands as one more reading."""
STEPS: Final = 50
PLAIN: Final = 6
"""Steps as Gauss and Newton have them, enough for a five-axis machine seen from everywhere. Where few axes leave a station or target
known hardly better than beforehand, the derivatives change over that uncertainty and such steps shrink by a tenth each, some to and
fro: from here on the last few say how."""
MEMORY: Final = 4
STILL: Final = 1e-4
"""A step that changes the whitened residuals by no more than this (root of the sum of squares) is the last: the errors of a machine
are small, the next step is a thousandth of it or less, and what is left 1e-7 of a standard uncertainty."""


@final
@dataclass(frozen=True)
class Solution:
    """An estimate.

    Attributes:
        theta: (columns,) µm and µrad.
        setup: stations and targets.
        triangle: (p + 1, p + 1) factor of [J | r] at the estimate.
        spectrum: directions (machine's and set-up's, plausible units) that the data determine, their singular values, and those
            directions that they do not; the datum's conditions respected.
        determined: how many numbers the readings settle: the trace of their share in the estimate.
        converged: whether the last step was still.
        steps: how many were taken.
    """

    theta: np.ndarray
    setup: SetUp
    triangle: np.ndarray
    spectrum: Spectrum
    determined: float
    converged: bool
    steps: int

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals."""
        return float(np.sum(self.triangle[:, -1] ** 2))

    def rank_of(self, columns: Sequence[int], datum: np.ndarray) -> int:
        """How many directions the data see of the set-up and some of the machine's columns, the datum's conditions kept."""
        machine = datum.shape[1]
        scale = self.spectrum.scale
        kept = [*columns, *range(machine, len(scale))]
        conditions = np.zeros((len(datum), len(scale)))
        conditions[:, :machine] = datum
        whole = np.concatenate([self.triangle[:, :-1] * scale, FIRM * conditions])[:, kept]
        return int(np.count_nonzero(np.linalg.svd(whole, compute_uv=False) > WEAKEST))

    def told(self, unknowns: Unknowns, readings: int) -> Determinability:
        """What the readings determine, with names, in the units users see.

        Args:
            unknowns: the machine's.
            readings: how many they are.
        """
        return Determinability(named(unknowns, self.setup), self.spectrum, WEAKEST, readings)


def named(unknowns: Unknowns, setup: SetUp) -> tuple[Unknown, ...]:
    """Every unknown number of a machine and its set-up, as it is to be read in a sentence.

    Args:
        unknowns: the machine's: µm and µrad.
        setup: stations and targets: metres and radians inside, mm and µrad outside.
    """
    found = [Unknown(_name(column, unknowns), unit_of(column.entity), PLAUSIBLE) for column in unknowns.columns]
    return (*found, *named_setup(setup))


def named_setup(setup: SetUp) -> tuple[Unknown, ...]:
    """The set-up's part of `named`."""
    found = []
    for name, size in zip(setup.names, setup.plausible, strict=True):
        unit, factor = ("urad", URAD) if " turn " in name else ("mm", MM)
        found.append(Unknown(name, unit, float(size) / factor, factor))
    return tuple(found)


def _name(column: Column, unknowns: Unknowns) -> str:
    curve = any(one.name == column.entity for one in unknowns.curves)
    return f"{column.entity} order {column.index}" if curve else column.entity


def solve(
    network: Network,
    theta: np.ndarray,
    setup: SetUp,
    weight: np.ndarray,
    *,
    precision: np.ndarray | None = None,
    steps: int = STEPS,
    triangle: np.ndarray | None = None,
) -> Solution:
    """Gauss-Newton from a start that fulfils the datum's conditions.

    Args:
        network: data and model.
        theta: machine's unknowns to start from, µm and µrad.
        setup: stations and targets to start from.
        weight: (n,) of each point.
        precision: (columns,) of the machine's unknowns about zero, one over µm² or µrad² (`twin.identification.remainder`); none
            if None.
        steps: at most.
        triangle: factor of [J | r] at the start, for whoever has it; found if None.
    """
    machine = len(network.unknowns)
    scale = np.concatenate([np.full(machine, PLAUSIBLE), setup.plausible])
    free = free_directions(network.unknowns.datum, machine, len(setup))
    root = np.zeros((machine, len(scale)))
    if precision is not None:
        root[:, :machine] = np.diag(np.sqrt(precision))
    taken, converged = 0, False
    wanted: list[np.ndarray] = []
    gone: list[np.ndarray] = []
    while True:
        found = factor(network, theta, setup, weight) if triangle is None else triangle
        triangle = None
        left, spectrum = decompose(np.concatenate([found[:, :-1], root]) * scale, scale, free=free)
        if taken < steps:
            along = left.T @ np.concatenate([found[:, -1], -root[:, :machine] @ theta])
            step = spectrum.directions @ (along / spectrum.strength)
            converged = bool(np.linalg.norm(along) <= STILL) or bool(np.abs(step).max(initial=0.0) < 1e-14)
            wanted.append(step)
            if taken >= PLAIN and not converged:
                step = _ahead(wanted, gone, spectrum)
            gone.append(step)
            step = step * scale
            theta, setup = theta + step[:machine], setup.moved(step[machine:])
            taken += 1
            if not converged:
                continue
            # The last step is too small to change the derivatives: only what is left of the readings moves.
            found = np.array(found)
            found[:, -1] -= found[:, :-1] @ step
        determined = float(np.sum((found[:, :-1] * scale @ (spectrum.directions / spectrum.strength)) ** 2))
        return Solution(theta, setup, found, spectrum, determined, converged, taken)


def _ahead(wanted: Sequence[np.ndarray], gone: Sequence[np.ndarray], spectrum: Spectrum) -> np.ndarray:
    """The step to where the last few, taken as straight in what they change, would want none (Anderson 1965; Walker and Ni 2011).

    Args:
        wanted: (p,) each, what Gauss and Newton wanted at the last places and want here.
        gone: (p,) each, the steps between these places.
        spectrum: here; its directions times their strength say what a step changes in the whitened residuals.
    """
    last = list(wanted)[-MEMORY - 1 :]
    more = np.stack([after - before for before, after in pairwise(last)], axis=1)
    way = np.stack(list(gone)[1 - len(last) :], axis=1)
    changes = spectrum.strength[:, None] * spectrum.directions.T
    share = np.linalg.lstsq(changes @ more, changes @ last[-1], rcond=1e-6)[0]
    return np.asarray(last[-1] - (way + more) @ share)


def free_directions(datum: np.ndarray, machine: int, setup: int) -> np.ndarray:
    """(p, p − conditions) orthonormal directions that keep the datum."""
    if len(datum) == 0:
        return np.eye(machine + setup)
    _, values, v = np.linalg.svd(datum, full_matrices=True)
    rank = int(np.count_nonzero(values > 1e-9 * values[0]))
    inside = v[rank:].T
    found = np.zeros((machine + setup, inside.shape[1] + setup))
    found[:machine, : inside.shape[1]] = inside
    found[machine:, inside.shape[1] :] = np.eye(setup)
    return found
